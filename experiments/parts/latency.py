"""APR against latency.

A layout is evaluated once, its APR found for every latency.
"""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from msgspec.structs import asdict as fields_of

from geometry.errors import InputError, Unquoted
from geometry.scene_sources import load_scene
from placement.compute import Compute
from placement.evaluator import evaluate_layout
from placement.latency import (
    MAX_LATENCY_S,
    LatencyBudget,
    fixed_latency,
    load_latency_budget,
)
from placement.latency_curves import apr_by_latency
from placement.layout import Layout, check_layout
from placement.question import Question
from placement.setting import build_setting

from ..figures.axes import (
    BLUE,
    VERMILION,
    WIDTH_IN,
    Style,
    finish_axes,
    literal,
    new_axes,
    to_png,
)
from ..language import mark, tr
from ..progress import StageProgress
from ..results.drives import DrivesRecord, build_drives_record, versions
from ..results.folders import expect_files, save_files
from ..results.record import Record, UnitRecord, build_unit_records
from ..results.tables import records_csv

CSV_NAME = "latency.csv"
PNG_NAME = "latency.png"
APR_LEVELS = (1.0, 0.95, 0.9)
STEP_S = 0.005
_LEAST_SHOWN_S = 0.5
# Ratios of rounded sums.
_SAME_SHARE = 1.0e-12
# Told apart by dashes and width as well as by colour.
_STYLES: Mapping[str, Style] = {
    "rsu_all": {"label": mark("all RSUs"), "color": BLUE, "linestyle": "-", "lw": 3.0},
    "vut_and_rsus": {
        "label": mark("VUT and RSUs"),
        "color": "black",
        "linestyle": "--",
        "lw": 1.4,
    },
    "vut": {
        "label": mark("VUT alone"),
        "color": VERMILION,
        "linestyle": ":",
        "lw": 1.8,
    },
}


class PartyLatency(Record, frozen=True, kw_only=True):
    """A party's APR by latency, and at the budget's least, mean and most."""

    at_best: float
    at_mean: float
    at_worst: float
    apr: tuple[float, ...]

    def longest_s(self, latencies_s: tuple[float, ...], level: float) -> float:
        """Longest latency shown with an APR of at least `level`.

        -inf: none, inf: every one.
        """
        holds = np.array(self.apr) >= level - _SAME_SHARE
        return (-math.inf, *latencies_s[:-1], math.inf)[
            int(np.argmin(np.append(holds, False)))
        ]


class LatencyResult(DrivesRecord, frozen=True, kw_only=True):
    """A layout's APR against latency, by sensing party.

    What ``--json`` prints.
    """

    name: str
    layout: tuple[UnitRecord, ...]
    runs: int
    budget: LatencyBudget
    latencies_s: tuple[float, ...]
    parties: dict[str, PartyLatency]
    vut_latency_s: float | None
    seconds: dict[str, float]
    versions: dict[str, str]


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
    """APR of every sensing party against latency.

    Table and figure to `out` if asked to.

    Parameters
    ----------
    question : Question
        What is driven. Its latency, if it has one, is the budget.
    layout : Layout
        Evaluated once.
    budget : str, optional
        See :func:`placement.latency.load_latency_budget`; by default the study's.
    vut_latency_s : float, optional
        See :func:`placement.latency_curves.apr_by_latency`. [s]
    max_latency_s : float, optional
        Shown up to here; by default as far as the budget reaches, and the RSUs' APR
        falls. [s]
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
    expect_files(out, progress)
    progress(mark("setting"), 0, 0)
    setting = build_setting(question, load_scene(question.scene), compute=compute)
    check_layout(layout, setting.scene)
    evaluation = evaluate_layout(layout, setting, compute=compute)
    if max_latency_s is None:
        shown_s = max(chosen.worst_s, _LEAST_SHOWN_S)
    else:
        shown_s = max_latency_s
    latencies_s = tuple(
        STEP_S * step for step in range(int(shown_s / STEP_S + 1.0e-6) + 1)
    )
    asked_s = [chosen.best_s, chosen.mean_s, chosen.worst_s, *latencies_s]
    found = apr_by_latency(
        evaluation, setting.rule, asked_s, vut_latency_s=vut_latency_s
    )
    parties = {
        name: PartyLatency(at_best=best, at_mean=mean, at_worst=worst, apr=tuple(apr))
        for name, (best, mean, worst, *apr) in (
            (key, apr.tolist()) for key, apr in found.items()
        )
    }
    result = LatencyResult(
        name=layout.name,
        layout=build_unit_records(layout, setting.scene),
        runs=evaluation.axis.n_runs,
        budget=chosen,
        latencies_s=latencies_s,
        parties=parties,
        vut_latency_s=vut_latency_s,
        **fields_of(build_drives_record(setting)),
        seconds={},
        versions=versions(),
    )

    def files(done: LatencyResult) -> dict[str, str | bytes]:
        rows = [
            {"latency_s": latency_s}
            | {name: party.apr[index] for name, party in done.parties.items()}
            for index, latency_s in enumerate(latencies_s)
        ]
        png = to_png(plot_latency(latencies_s, done.parties, chosen))
        return {CSV_NAME: records_csv(rows), PNG_NAME: png}

    return save_files(result, out, progress, files)


def pick_budget(question: Question, budget: str | None) -> LatencyBudget:
    """The budget that a user named, or the one number of ``--latency``.

    Raises
    ------
    InputError
        Both are given, or the budget is not what it should be.
    """
    if question.latency_s is None:
        return load_latency_budget(
            *([] if budget is None else [budget]), where="--budget"
        )
    if budget is not None:
        raise InputError("--latency", Unquoted("it beside --budget"), "one of them")
    if question.latency_s > MAX_LATENCY_S:
        raise InputError(
            "--latency", question.latency_s, f"at most {MAX_LATENCY_S:g} seconds"
        )
    return fixed_latency(question.latency_s)


def plot_latency(
    latencies_s: tuple[float, ...],
    parties: Mapping[str, PartyLatency],
    budget: LatencyBudget,
) -> Axes:
    """APR of the sensing parties in milliseconds, the budget's range shaded.

    In a new figure.
    """
    axes = new_axes(WIDTH_IN, 3.9)
    shown_ms = [1000.0 * latency_s for latency_s in latencies_s]
    for name, party in parties.items():
        style = _STYLES.get(name, {"color": "#999999", "lw": 0.7})
        if "label" in style:
            style = {**style, "label": tr(style["label"])}
        axes.plot(shown_ms, [100.0 * apr for apr in party.apr], gid=name, **style)
    words = literal(tr("budget {name}: mean and range", name=budget.name))
    axes.axvline(1000.0 * budget.mean_s, color="black", lw=0.8, gid="mean", label=words)
    axes.axvspan(
        1000.0 * budget.best_s, 1000.0 * budget.worst_s, color="#e4e4e4", zorder=0
    )
    axes.set_ylim(-3.0, 103.0)
    axes.legend(fontsize=8, frameon=False)
    x = tr("latency from the frame to the onset of braking (ms)")
    y = tr("accidents prevented (APR, %)")
    finish_axes(axes, x=x, y=y, size=9, grid="y")
    return axes
