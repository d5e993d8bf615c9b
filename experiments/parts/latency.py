"""APR against latency: a layout is judged once, its APR read off for every latency."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
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

from ..figures.axes import (
    BLUE,
    GREY,
    VERMILION,
    WIDTH_IN,
    Style,
    finish_axes,
    literal,
    new_figure,
    to_png,
    write_beside,
)
from ..progress import WRITING, StageProgress
from ..results.drives import DrivesRecord, build_drives_record, versions
from ..results.folders import check_folder, write_files
from ..results.numbers import percent
from ..results.record import Record, UnitRecord, build_unit_records
from ..results.tables import csv_text

if TYPE_CHECKING:
    import pandas as pd

# ---------- the value


SHOWN_LATENCIES_S = (0.0, 0.025, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
APR_LEVELS = (1.0, 0.95, 0.9)


class LongestLatency(Record, frozen=True, kw_only=True):
    """Longest latency that leaves an APR: infinite if it never falls below.

    Minus infinity if it is less with none; in JSON both are null, and "is_reached" tells them
    apart.
    """

    apr: float
    latency_s: float
    is_reached: bool


class AprAt(Record, frozen=True, kw_only=True):
    """APR at a latency; of a step, up to it."""

    latency_s: float
    apr: float


class PartyLatency(Record, frozen=True, kw_only=True):
    """A party's APR: over all latencies of the budget, at its mean and worst, and every step."""

    expected: float
    at_mean: float
    at_worst: float
    longest: tuple[LongestLatency, ...]
    steps: tuple[AprAt, ...]
    at: tuple[AprAt, ...]


class LatencyResult(DrivesRecord, frozen=True, kw_only=True):
    """A layout's APR against latency, by sensing party: what ``--json`` prints."""

    name: str
    layout: tuple[UnitRecord, ...]
    runs: int
    budget: LatencyBudget
    max_latency_s: float
    parties: dict[str, PartyLatency]
    vut_latency_s: float | None
    seconds: dict[str, float]
    versions: dict[str, str]


def summarise_curve(
    curve: LatencyCurve, budget: LatencyBudget, max_latency_s: float
) -> PartyLatency:
    """A curve as numbers, with some round latencies up to `max_latency_s`."""
    longest = [(level, curve.longest_latency_s(level)) for level in APR_LEVELS]
    shown_s = [latency_s for latency_s in SHOWN_LATENCIES_S if latency_s <= max_latency_s]
    return PartyLatency(
        expected=curve.expected_apr(budget),
        at_mean=float(curve.apr(budget.mean_s)),
        at_worst=float(curve.apr(budget.worst_s)),
        longest=tuple(
            LongestLatency(apr=level, latency_s=latency_s, is_reached=latency_s >= 0.0)
            for level, latency_s in longest
        ),
        steps=_pairs(*curve.steps()),
        at=_pairs(shown_s, curve.apr(shown_s)),
    )


def _pairs(latencies_s: Iterable[float], aprs: Iterable[float]) -> tuple[AprAt, ...]:
    return tuple(
        AprAt(latency_s=float(latency_s), apr=float(apr))
        for latency_s, apr in zip(latencies_s, aprs, strict=True)
    )


# ---------- the job, and the table


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

    The budget is the question's latency, or what :func:`placement.latency.load_latency_budget`
    finds by its name; for `vut_latency_s` see :func:`placement.latency.apr_by_latency`. Shown up to
    `max_latency_s`, by default as far as the budget reaches and the RSUs' APR falls. Raises
    InputError if the budget is unknown or given twice, a unit is inside something, or `out` cannot
    be written.
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
        budget=chosen,
        max_latency_s=shown_s,
        parties={name: summarise_curve(curve, chosen, shown_s) for name, curve in curves.items()},
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
    """The budget that a user named, or the one latency of a question; not both."""
    if question.latency_s is None:
        return load_latency_budget(*([] if budget is None else [budget]), where="--budget")
    if budget is not None:
        raise InputError("--latency", Unquoted("it beside --budget"), "one of them")
    if question.latency_s > MAX_LATENCY_S:
        raise InputError("--latency", question.latency_s, f"at most {MAX_LATENCY_S:g} seconds")
    return fixed_latency(question.latency_s)


def latency_table(curves: Mapping[str, LatencyCurve], *, max_latency_s: float) -> "pd.DataFrame":
    """Every step of every curve up to a latency.

    Columns party, above_s, until_s, apr: the APR for latencies above the one and up to the other; a
    party's first row holds for 0, too.
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


# ---------- the figure


_MS = 1000.0
_LEAST_BAR_S = 0.001  # a budget may be nothing at all
_SHADE = "#e4e4e4"
# Told apart by dashes and width as well as by colour; the later ones lie on top.
_STYLES: Mapping[str, Style] = {
    "rsu_all": {"label": "all RSUs", "color": BLUE, "linestyle": "-", "lw": 3.0},
    "vut_and_rsus": {
        "label": "VUT and RSUs",
        "color": "black",
        "linestyle": (0, (5, 2)),
        "lw": 1.4,
    },
    "vut": {"label": "VUT alone", "color": VERMILION, "linestyle": (0, (1.5, 1.5)), "lw": 1.8},
}
_FILLS = ("#4d4d4d", "#d9d9d9", "#8c8c8c", "#f2f2f2", "#b3b3b3")
_HATCHES = ("", "//", "", "xx", "..", "\\\\", "++", "oo")


def plot_latency(
    curves: Mapping[str, LatencyCurve], budget: LatencyBudget, *, max_latency_s: float
) -> list[Axes]:
    """APR of the sensing parties as steps, the budget's range shaded, its parts as bars below.

    Two pairs of axes in a new figure, in milliseconds; the lower one has a scale of its own.
    """
    n_rows = 1 if _is_fixed(budget) else 2
    height = 3.9 + 0.3 * n_rows + 0.17 * ((len(budget.parts) + 2) // 3)
    figure = new_figure(WIDTH_IN, height)
    upper, lower = figure.subplots(2, 1, height_ratios=[8.0, n_rows])
    handles = _draw_curves(upper, curves, budget, max_latency_s)
    _draw_parts(lower, budget)
    style: Style = {"ncols": 3, "fontsize": 8, "frameon": False}
    figure.legend(handles=handles, loc="outside upper center", **style)
    figure.legend(handles=_part_patches(budget), loc="outside lower center", **style)
    return [upper, lower]


def _is_fixed(budget: LatencyBudget) -> bool:
    return budget.best_s == budget.worst_s


def _draw_curves(
    axes: Axes, curves: Mapping[str, LatencyCurve], budget: LatencyBudget, max_latency_s: float
) -> list[Any]:
    """Draw what is above; returns the entries of the legend."""
    units = [name for name in curves if name not in (*_STYLES, "vam", "all_sources")]
    handles: list[Any] = []
    for name, style in _STYLES.items():
        _draw_steps(axes, curves[name], max_latency_s, gid=name, **style, zorder=4)
        expected = percent(curves[name].expected_apr(budget))
        words = style["label"] + (
            f": {expected}" if _is_fixed(budget) else f": {expected} expected"
        )
        handles.append(Line2D([], [], **(style | {"label": words})))
    for name in units:
        _draw_steps(axes, curves[name], max_latency_s, gid=name, color=GREY, lw=0.7, zorder=2)
    handles.append(Line2D([], [], color=GREY, lw=0.7, label="each RSU alone"))
    best, mean, worst = (_MS * value for value in (budget.best_s, budget.mean_s, budget.worst_s))
    axes.axvline(mean, color="black", lw=0.8, zorder=3, gid="mean")
    label = "the budget's latency" if _is_fixed(budget) else "the budget's mean"
    handles.append(Line2D([], [], color="black", lw=0.8, label=label))
    if not _is_fixed(budget):
        axes.axvspan(best, worst, color=_SHADE, lw=0.0, zorder=0, gid="budget")
        handles.append(Patch(facecolor=_SHADE, label="from its least to its most"))
    axes.set_xlim(0.0, _MS * max_latency_s)
    axes.set_ylim(-0.03, 1.03)
    axes.set_yticks(np.linspace(0.0, 1.0, 6), [f"{share:.0f} %" for share in range(0, 101, 20)])
    finish_axes(
        axes,
        x="latency from the frame to the onset of braking (ms)",
        y="accidents prevented (APR)",
        size=9,
        grid="y",
    )
    return handles


def _draw_steps(axes: Axes, curve: LatencyCurve, max_latency_s: float, **style: Any) -> None:
    until, apr = curve.steps()
    n_shown = 1 + int(np.searchsorted(until, max_latency_s))
    edges = _MS * np.concatenate([[0.0], np.minimum(until[:n_shown], max_latency_s)])
    # A value holds up to and with its edge on the right.
    shown = apr[:n_shown]
    axes.step(edges, np.concatenate([shown[:1], shown]), where="pre", **(style | {"label": None}))


def _draw_parts(axes: Axes, budget: LatencyBudget) -> None:
    """Stacked bars: the parts on average, and at their worst."""
    rows = {"mean": [0.5 * (part.low_s + part.high_s) for part in budget.parts]}
    if _is_fixed(budget):
        rows = {"always": rows["mean"]}
    else:
        rows["worst"] = [part.high_s for part in budget.parts]
    for row, (name, lengths_s) in enumerate(rows.items()):
        left = 0.0
        for index, length_s in enumerate(lengths_s):
            axes.barh(
                row,
                _MS * length_s,
                left=left,
                height=0.62,
                edgecolor="black",
                linewidth=0.6,
                gid=f"{name}: {budget.parts[index].name}",
                **_fill(index),
            )
            left += _MS * length_s
        write_beside(axes, f"{left:.4g} ms", (left, row), away_pt=(3.0, 0.0))
    axes.set_xlim(0.0, 1.15 * _MS * max(budget.worst_s, _LEAST_BAR_S))
    axes.set_yticks(range(len(rows)), list(rows), fontsize=8)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    words = literal(f"parts of the latency budget {budget.name} (ms)")
    finish_axes(axes, x=words, size=9, hidden=("top", "right", "left"))


def _part_patches(budget: LatencyBudget) -> list[Patch]:
    return [
        Patch(
            edgecolor="black",
            linewidth=0.6,
            label=literal(f"{part.name}, {range_ms(part.low_s, part.high_s)}"),
            **_fill(index),
        )
        for index, part in enumerate(budget.parts)
    ]


def _fill(index: int) -> Style:
    return {
        "facecolor": _FILLS[index % len(_FILLS)],
        "hatch": _HATCHES[index % len(_HATCHES)],
    }


def range_ms(low_s: float, high_s: float) -> str:
    """A range of seconds in milliseconds.

    Examples
    --------
    >>> range_ms(0.0, 0.1), range_ms(0.025, 0.025)
    ('0 to 100 ms', '25 ms')
    """
    low, high = (f"{_MS * value:.4g}" for value in (low_s, high_s))
    return f"{high} ms" if low == high else f"{low} to {high} ms"
