"""``place-rsus latency``: evaluate a layout once, read its APR off for every latency."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import asdict as fields_of
from msgspec.structs import replace as replace_fields

from geometry.errors import InputError, Unquoted
from geometry.scene_files import load_scene
from placement.compute import Compute
from placement.evaluator import evaluate_layout
from placement.latency import (
    MAX_LATENCY_S,
    LatencyBudget,
    LatencyCurve,
    apr_by_latency,
    fixed_latency,
    load_latency_budget,
)
from placement.layout import Layout, check_layout
from placement.question import Question
from placement.setting import build_setting

from ..figures.axes import to_png
from ..figures.latency import plot_latency
from ..progress import WRITING, StageProgress
from ..results.csv_text import csv_text
from ..results.drives import build_drives_record, versions
from ..results.folders import check_folder, write_files
from ..results.latencies import (
    APR_LEVELS,
    LatencyResult,
    build_budget_record,
    build_curve_record,
)
from ..results.record import build_unit_records

if TYPE_CHECKING:
    import pandas as pd

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
) -> LatencyResult:
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

    Raises
    ------
    InputError
        The budget is unknown or given twice, a
        unit hangs inside something, or `out` cannot be written.
    """
    chosen = pick_budget(question, budget)
    if out is not None:
        check_folder(out)
        progress.kept = f"nothing was written to {out}"
    progress("setting", 0, 0)
    setting = build_setting(question, load_scene(question.scene), compute=compute)
    check_layout(layout, setting.scene)
    evaluation = evaluate_layout(layout, setting, compute=compute)
    curves = apr_by_latency(evaluation, setting.rule, vut_latency_s=vut_latency_s)
    shown_s = _default_max_s(curves, chosen) if max_latency_s is None else max_latency_s
    result = LatencyResult(
        name=layout.name,
        layout=build_unit_records(layout, setting.scene),
        runs=evaluation.axis.n_runs,
        budget=build_budget_record(chosen),
        max_latency_s=shown_s,
        parties={
            name: build_curve_record(curve, chosen, shown_s) for name, curve in curves.items()
        },
        vut_latency_s=vut_latency_s,
        **fields_of(build_drives_record(setting)),
        seconds={},
        versions=versions(),
    )
    if out is not None:
        progress(WRITING, 0, 0)
        axes, _ = plot_latency(curves, chosen, max_latency_s=shown_s)
        csv = csv_text(latency_table(curves, max_latency_s=shown_s))
        write_files(out, {CSV_NAME: csv.encode(), PNG_NAME: to_png(axes)})
        progress.kept = f"the results are in {out}"
    return replace_fields(result, seconds=progress.finish())


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


def latency_table(curves: Mapping[str, LatencyCurve], *, max_latency_s: float) -> "pd.DataFrame":
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
    import pandas as pd

    return pd.DataFrame(rows)


def _default_max_s(curves: Mapping[str, LatencyCurve], budget: LatencyBudget) -> float:
    """As far as the budget reaches, and on to where the RSUs' APR falls, unless that is far off."""
    falls_s = curves["rsu_all"].longest_latency_s(APR_LEVELS[-1])
    reach_s = max(budget.worst_s, min(falls_s, _MOST_SHOWN_S - _STEP_SHOWN_S))
    shown_s = _STEP_SHOWN_S * (int(reach_s / _STEP_SHOWN_S + _ROUNDING) + 1)
    return max(_LEAST_SHOWN_S, round(shown_s, 9))
