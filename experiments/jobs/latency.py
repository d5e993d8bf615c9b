"""What ``place-rsus latency`` does: evaluate a layout once, read its APR off for every latency."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from geometry.errors import InputError, Unquoted
from geometry.scene_folders import find_scene
from placement.compute import Compute
from placement.evaluation import Evaluation
from placement.evaluator import evaluate_layout
from placement.latency import (
    MAX_LATENCY_S,
    LatencyBudget,
    LatencyCurve,
    apr_by_latency,
    fixed_latency,
    load_latency_budget,
)
from placement.layout import Layout, check_layout, layout_records
from placement.question import Question
from placement.setting import build_setting

from ..figures.axes import to_png
from ..figures.latency import plot_latency
from ..progress import WRITING, StageProgress
from ..results.drives import build_drives_record, versions
from ..results.record import to_plain
from .writing import check_folder, write_files

# ---------- what ``place-rsus latency`` does


TABLE_S = (0.0, 0.025, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
APR_LEVELS = (1.0, 0.95, 0.9)
CSV_NAME, PNG_NAME = "latency.csv", "latency.png"

_LEAST_SHOWN_S, _MOST_SHOWN_S = 0.5, 3.0
_STEP_SHOWN_S = 0.1
_ROUNDING = 1.0e-6


def run_latency(
    question: Question,
    *,
    layout: Layout,
    budget: str | None,
    vut_latency_s: float | None,
    max_latency_s: float | None,
    out: Path | None,
    compute: Compute,
    progress: StageProgress,
) -> dict[str, Any]:
    """APR of every sensing party against latency; table and figure to `out` if asked to.

    Parameters
    ----------
    question : Question
        What is driven. Its latency, if it has one, is the budget.
    layout : Layout
        Evaluated once.
    budget : str, optional
        See :func:`placement.latency.load_latency_budget`; by default the study's.
    vut_latency_s : float, optional
        See :func:`placement.latency.apr_by_latency`. [s]
    max_latency_s : float, optional
        Shown up to here; by default as far as the budget reaches, and the RSUs' APR falls. [s]
    out : Path, optional
        Folder that gets ``latency.csv`` and ``latency.png``; what else it holds stays.
    compute : Compute
        Seed and threads; its progress is `progress`.
    progress : StageProgress
        Is told the stages.

    Returns
    -------
    summary : dict
        See :func:`summarise_latency`.

    Raises
    ------
    InputError
        The budget is unknown or given twice, the phase of the frames depends on the latency, a
        unit hangs inside something, or `out` cannot be written.
    """
    chosen = pick_budget(question, budget)
    if question.phase != "aligned":
        raise InputError(
            "--phase", question.phase, "aligned: every latency is looked at on the same frames"
        )
    if out is not None:
        check_folder(out)
        progress.kept = f"nothing was written to {out}"
    progress("setting", 0, 0)
    setting = build_setting(question, find_scene(question.scene))
    check_layout(layout, setting.scene)
    evaluation = evaluate_layout(layout, setting, compute=compute)
    curves = apr_by_latency(evaluation, setting.rule, vut_latency_s=vut_latency_s)
    shown_s = _default_max_s(curves, chosen) if max_latency_s is None else max_latency_s
    summary = summarise_latency(evaluation, curves, chosen, max_latency_s=shown_s)
    summary |= {"vut_latency_s": vut_latency_s, **to_plain(build_drives_record(setting))}
    if out is not None:
        progress(WRITING, 0, 0)
        axes, _ = plot_latency(curves, chosen, max_latency_s=shown_s)
        csv = latency_table(curves, max_latency_s=shown_s).to_csv(index=False, lineterminator="\n")
        write_files(out, {CSV_NAME: csv.encode(), PNG_NAME: to_png(axes)})
        progress.kept = f"the results are in {out}"
    summary |= {"seconds": progress.finish(), "versions": versions()}
    return summary


def pick_budget(question: Question, budget: str | None) -> LatencyBudget:
    """The budget that a user named, or the one number of ``--latency``.

    Raises
    ------
    InputError
        Both are given, or the budget is not what it should be.
    """
    if question.latency_s is None:
        return load_latency_budget(*([] if budget is None else [budget]), where="--budget")
    if budget is not None:
        raise InputError("--latency", Unquoted("it beside --budget"), "one of them")
    if question.latency_s > MAX_LATENCY_S:
        raise InputError("--latency", question.latency_s, f"at most {MAX_LATENCY_S:g} seconds")
    return fixed_latency(question.latency_s)


def summarise_latency(
    evaluation: Evaluation,
    curves: Mapping[str, LatencyCurve],
    budget: LatencyBudget,
    *,
    max_latency_s: float,
) -> dict[str, Any]:
    """The numbers of all curves as one plain object.

    Parameters
    ----------
    evaluation : Evaluation
        Of the layout.
    curves : mapping of str to LatencyCurve
        By sensing party.
    budget : LatencyBudget
        Distribution of the latency.
    max_latency_s : float
        Up to where curves are shown. [s]

    Returns
    -------
    summary : dict
        "parties" has, for each: "expected", "at_mean" and "at_worst" (APR for the budget),
        "longest" (``{"apr", "latency_s"}``: infinite if the APR never falls below, minus infinity
        if it is less with none; in JSON both are null, and "is_reached" tells them apart), "steps"
        (``{"until_s", "apr"}``, see :meth:`placement.latency.LatencyCurve.steps`) and
        "at" (``{"latency_s", "apr"}``, some round latencies).
    """
    return {
        "name": evaluation.layout.name,
        "layout": layout_records(evaluation.layout),
        "runs": evaluation.axis.n_runs,
        "budget": {
            "name": budget.name,
            "best_s": budget.best_s,
            "mean_s": budget.mean_s,
            "worst_s": budget.worst_s,
            "parts": [asdict(part) for part in budget.parts],
        },
        "max_latency_s": max_latency_s,
        "parties": {
            name: _summarise_curve(curve, budget, max_latency_s) for name, curve in curves.items()
        },
    }


def latency_table(curves: Mapping[str, LatencyCurve], *, max_latency_s: float) -> pd.DataFrame:
    """Every step of every curve.

    Parameters
    ----------
    curves : mapping of str to LatencyCurve
        By sensing party.
    max_latency_s : float
        Steps beyond are left out. [s]

    Returns
    -------
    table : DataFrame
        Columns party, above_s, until_s, apr: the APR for latencies above the one and up to the
        other; a party's first row holds for 0, too.
    """
    rows = []
    for party, curve in curves.items():
        above_s = 0.0
        for until_s, apr in zip(*(values.tolist() for values in curve.steps()), strict=True):
            end_s = min(until_s, max_latency_s)
            rows.append({"party": party, "above_s": above_s, "until_s": end_s, "apr": apr})
            above_s = until_s
            if until_s >= max_latency_s:
                break
    return pd.DataFrame(rows)


def _summarise_curve(
    curve: LatencyCurve, budget: LatencyBudget, max_latency_s: float
) -> dict[str, Any]:
    shown_s = [latency_s for latency_s in TABLE_S if latency_s <= max_latency_s]
    longest = [(level, curve.longest_latency_s(level)) for level in APR_LEVELS]
    return {
        "expected": curve.expected_apr(budget),
        "at_mean": float(curve.apr(budget.mean_s)),
        "at_worst": float(curve.apr(budget.worst_s)),
        "longest": [
            {"apr": level, "latency_s": latency_s, "is_reached": latency_s >= 0.0}
            for level, latency_s in longest
        ],
        "steps": _records("until_s", *curve.steps()),
        "at": _records("latency_s", shown_s, curve.apr(shown_s)),
    }


def _records(key: str, latencies_s: Any, ratios: Any) -> list[dict[str, float]]:
    pairs = zip(latencies_s, ratios, strict=True)
    return [{key: float(latency_s), "apr": float(apr)} for latency_s, apr in pairs]


def _default_max_s(curves: Mapping[str, LatencyCurve], budget: LatencyBudget) -> float:
    """As far as the budget reaches, and on to where the RSUs' APR falls, unless that is far off."""
    falls_s = curves["rsu_all"].longest_latency_s(APR_LEVELS[-1])
    reach_s = max(budget.worst_s, min(falls_s, _MOST_SHOWN_S - _STEP_SHOWN_S))
    shown_s = _STEP_SHOWN_S * (int(reach_s / _STEP_SHOWN_S + _ROUNDING) + 1)
    return max(_LEAST_SHOWN_S, round(shown_s, 9))
