"""Margins to the last moment by case, speed and direction, in milliseconds and in metres."""

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from geometry.arrays import BoolArray, FloatArray
from placement.evaluation import Evaluation, Verdict
from scenarios.runs import FrameAxis

from ..figures.axes import PALETTE, WIDTH_IN, Style, literal, new_figure, write_beside
from ..language import mark, tr, trn
from ..results.numbers import NOTHING, number
from ..results.tables import HEADS_OF_GROUPS, GroupedBy, groups_by, margin_s
from .section import Section, Table, build_picture

MAX_COLUMNS = 4
"""Panels that fit side by side."""

_MS = 1000.0
# the scale is linear up to here on both sides of zero, logarithmic beyond
_LINEAR_MS = 500.0
_TICKS_MS = (-10_000.0, -1000.0, 0.0, 1000.0, 10_000.0)
_LANE_IN = 0.095
_LEAST_ROW_IN = 0.24
_TOP_ROWS = 0.7  # for words
_LABEL_WIDTH = 24
# Told apart without colour, too.
_STYLES = tuple(zip("o^sXDvP", (*PALETTE, "#000000"), strict=True))
VUT_NAME = mark("VUT alone")
_MARGINS_BY: dict[GroupedBy, str] = {
    "case": mark("Margins to the last moment by case"),
    "speed": mark("Margins to the last moment by speed of the car"),
    "direction": mark(
        "Margins to the last moment by direction from which the car comes"
    ),
}
_MPS_PER_KMH = 1.0 / 3.6
_MAX_UNFOLDED = 16  # rows of a table that is unfolded from the start


def plot_margins(
    parties: Sequence[tuple[str, Verdict]], axis: FrameAxis
) -> tuple[Axes, ...]:
    """Margins of several parties side by side, on one scale: a mark for each run that counts.

    A row for each case. Right of zero: time to spare; left: too late, at the edge:
    never. A marker and a lane per approach; filled where the run is avoided.
    """
    cases = [*dict.fromkeys(axis.cases)]
    approaches = [*dict.fromkeys(axis.approaches)]
    row_in = max(_LEAST_ROW_IN, _LANE_IN * len(approaches))
    figure = new_figure(WIDTH_IN, 1.5 + (len(cases) + _TOP_ROWS) * row_in)
    panels: list[Axes] = [
        *figure.subplots(1, len(parties), sharey=True, squeeze=False)[0]
    ]
    from_arms = [tr("from: {arm}", arm=tr(name)) for name in approaches]
    labels = [literal(textwrap.fill(words, _LABEL_WIDTH)) for words in from_arms]
    hollow = _mark(0, is_filled=False) | {"markeredgecolor": "black"}
    handles = [
        *(
            Line2D([], [], label=label, **_mark(order))
            for order, label in enumerate(labels)
        ),
        Line2D([], [], label=tr("hollow: not avoided"), **hollow),
    ]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=3, fontsize=8, frameon=False
    )
    margins_ms = _MS * np.concatenate(
        [margin_s(verdict, axis) for _, verdict in parties]
    )
    finite_ms = margins_ms[np.isfinite(margins_ms)]
    low_ms = min(-_MS, float(finite_ms.min(initial=0.0)))
    high_ms = max(_MS, float(finite_ms.max(initial=0.0)))
    counts = axis.weight > 0.0
    for panel, (name, verdict) in zip(panels, parties, strict=True):
        panel.set_xscale("symlog", linthresh=_LINEAR_MS, linscale=0.8)
        _draw_margins(panel, verdict, axis, cases, approaches)
        panel.set_xlim(2.5 * low_ms, 1.5 * high_ms)  # marks at the left edge have room
        n_avoided = int((verdict.is_avoided & counts).sum())
        n_runs = int(counts.sum())
        head = literal(textwrap.fill(name, max(12, 64 // len(parties))))
        avoided = tr("{n} of {all} avoided", n=n_avoided, all=n_runs)
        panel.set_title(f"{head}\n{avoided}", fontsize=8)
    for panel in panels[1:]:
        panel.tick_params(axis="y", labelleft=False)
    return tuple(panels)


def _draw_margins(
    axes: Axes,
    verdict: Verdict,
    axis: FrameAxis,
    cases: list[str],
    approaches: list[str],
) -> None:
    margin_ms = _MS * margin_s(verdict, axis)
    lane = 0.8 / len(approaches)
    row = np.array([cases.index(case) for case in axis.cases], dtype=np.float64)
    axes.axvspan(-1.0e9, 0.0, facecolor="#e8e8e8", zorder=0)
    axes.axvline(0.0, color="black", linewidth=1.2, zorder=2)
    for index, approach in enumerate(approaches):
        y = row + lane * (index - 0.5 * (len(approaches) - 1))
        drawn = np.array([name == approach for name in axis.approaches]) & (
            axis.weight > 0.0
        )
        for is_filled in (False, True):
            mask = drawn & (verdict.is_avoided == is_filled)
            style = _mark(index, is_filled)
            known = mask & np.isfinite(margin_ms)
            never = mask & ~np.isfinite(margin_ms)
            axes.plot(margin_ms[known], y[known], **style)
            if never.any():  # at the edge, wherever that is in the end
                edge = np.full(int(never.sum()), 0.03)
                axes.plot(edge, y[never], transform=axes.get_yaxis_transform(), **style)
    for between in range(len(cases)):
        axes.axhline(between - 0.5, color="#bbbbbb", linewidth=0.5, zorder=1)
    axes.set_ylim(len(cases) - 0.5, -0.5 - _TOP_ROWS)
    axes.set_yticks(range(len(cases)), [literal(case) for case in cases], fontsize=8)
    ticks = [f"{tick:.0f}".replace("-", "\N{MINUS SIGN}") for tick in _TICKS_MS]
    axes.set_xticks(_TICKS_MS, ticks, fontsize=7, rotation=45)
    axes.set_xticks([], minor=True)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(tr("margin (ms)"), fontsize=8)
    for words, side, away_pt in (
        (tr("too late"), "right", -3.0),
        (tr("to spare"), "left", 3.0),
    ):
        at = (0.0, -0.5 - _TOP_ROWS)
        write_beside(
            axes, words, at, away_pt=(away_pt, -2.0), ha=side, va="top", fontsize=7
        )


def _mark(number: int, is_filled: bool = True) -> Style:
    marker, colour = _STYLES[number % len(_STYLES)]
    edge = {"markeredgecolor": "black", "markeredgewidth": 0.3}
    if not is_filled:
        edge = {"markeredgecolor": colour, "markeredgewidth": 0.9}
    face = {
        "marker": marker,
        "markersize": 3.6,
        "markerfacecolor": colour if is_filled else "white",
    }
    return face | edge | {"linestyle": "none", "zorder": 4}


def margin_m(verdict: Verdict, axis: FrameAxis) -> FloatArray:
    """Distance to spare of the VUT when it begins to brake.

    Shape (n_runs,), along the VUT's path, from where braking sets in to where it must
    set in at the latest. Negative: it is past that place by so much. Minus infinity:
    never confirmed, or no braking avoids. [m]

    Notes
    -----
    Until it brakes the VUT keeps its speed v (Euro NCAP, AEB/LSS VRU systems test
    protocol: a constant test speed), so in a margin t it covers v t, the distance in
    uniform motion. On a turn this is the length of the arc, not of the chord.
    """
    metres: FloatArray = margin_s(verdict, axis) * (axis.vut_speed_kmh * _MPS_PER_KMH)
    return metres


@dataclass(frozen=True, slots=True, kw_only=True)
class MarginSummary:
    """Margins of a group of runs; what there is none of is NaN. Each smallest is of its own run."""

    n_runs: int
    n_avoided: int
    smallest_s: float  # this and the next three: of the avoided runs
    smallest_m: float
    median_s: float
    median_m: float
    n_never: int  # not avoided: never confirmed
    n_lost: int  # not avoided: lost again before the last moment
    worst_late_s: float  # of those not avoided in which braking sets in
    worst_late_m: float


def summarise_margins(
    verdict: Verdict, axis: FrameAxis, run_mask: BoolArray | None = None
) -> MarginSummary:
    """Margins of some runs, (n_runs,) bool, without those of weight 0."""
    mask = (axis.weight > 0.0) & (True if run_mask is None else run_mask)
    avoided = verdict.is_avoided & mask
    sets_in = np.isfinite(verdict.onset_time_s)
    is_lost = ~sets_in & np.isfinite(verdict.confirmation_time_s)
    seconds = margin_s(verdict, axis)
    metres = margin_m(verdict, axis)
    missed_with_hope = ~verdict.is_avoided & mask & np.isfinite(axis.last_brake_time_s)
    late = missed_with_hope & sets_in
    return MarginSummary(
        n_runs=int(mask.sum()),
        n_avoided=int(avoided.sum()),
        smallest_s=_of(np.min, seconds[avoided]),
        smallest_m=_of(np.min, metres[avoided]),
        median_s=_of(np.median, seconds[avoided]),
        median_m=_of(np.median, metres[avoided]),
        n_never=int((missed_with_hope & ~sets_in & ~is_lost).sum()),
        n_lost=int((missed_with_hope & is_lost).sum()),
        worst_late_s=_of(np.max, -seconds[late]),
        worst_late_m=_of(np.max, -metres[late]),
    )


def _of(measure: Callable[[FloatArray], Any], values: FloatArray) -> float:
    if len(values):
        return float(measure(values))
    return math.nan


def _parties(evaluations: Mapping[str, Evaluation]) -> list[tuple[str, Verdict]]:
    """Every layout, then the car alone; a layout may be called as that is."""
    subject = next(iter(evaluations.values()))
    layouts = [(name, item.headline) for name, item in evaluations.items()]
    return [*layouts, (tr(VUT_NAME), subject.vut)]


def margin_tables(evaluations: Mapping[str, Evaluation]) -> list[Table]:
    """Margins by case, by speed and by direction, to unfold.

    In each, a row per group and layout, and one for the car alone; the first group is
    all runs.
    """
    axis = next(iter(evaluations.values())).axis
    everything = (tr("all runs"), np.ones(axis.n_runs, dtype=bool))
    by: tuple[GroupedBy, ...] = ("case", "speed", "direction")
    tables = []
    for what in by:
        rows = [
            [tr(group), name, *_cells(summarise_margins(verdict, axis, mask))]
            for group, mask in (everything, *groups_by(axis, what))
            if (mask & (axis.weight > 0.0)).any()
            for name, verdict in _parties(evaluations)
        ]
        caption = tr(_MARGINS_BY[what])
        table = Table(
            caption=caption,
            columns=[
                tr(HEADS_OF_GROUPS[what]),
                tr("who"),
                tr("runs"),
                tr("smallest (ms)"),
                tr("smallest (m)"),
                tr("median (ms)"),
                tr("median (m)"),
                tr("not avoided"),
                tr("of these never confirmed, or lost again"),
                tr("worst too late by (ms)"),
                tr("worst too late by (m)"),
            ],
            rows=rows,
            numeric=range(2, 11),
            summary=caption,
            is_open=len(rows) <= _MAX_UNFOLDED,
        )
        tables.append(table)
    return tables


def _cells(summary: MarginSummary) -> list[str]:
    n_missed = summary.n_runs - summary.n_avoided
    n_unseen = summary.n_never + summary.n_lost
    return [
        str(summary.n_runs),
        number(summary.smallest_s * _MS, 0),
        number(summary.smallest_m, 1),
        number(summary.median_s * _MS, 0),
        number(summary.median_m, 1),
        str(n_missed),
        str(n_unseen) if n_missed else NOTHING,
        number(summary.worst_late_s * _MS, 0),
        number(summary.worst_late_m, 1),
    ]


def margin_notes(evaluations: Mapping[str, Evaluation]) -> list[str]:
    """Notes for readers of the tables; only those that apply."""
    axis = next(iter(evaluations.values())).axis
    notes = []
    n_without = int((axis.weight == 0.0).sum())
    if n_without:
        notes.append(
            trn(
                "Left out: {n} run of weight 0.",
                "Left out: {n} runs of weight 0.",
                n_without,
            )
        )
    n_hopeless = int((~np.isfinite(axis.last_brake_time_s) & (axis.weight > 0.0)).sum())
    if n_hopeless:
        notes.append(
            trn(
                "In {n} run no braking avoids the impact: there is no last "
                "moment, and they count as not avoided.",
                "In {n} runs no braking avoids the impact: there is no last "
                "moment, and they count as not avoided.",
                n_hopeless,
            )
        )
    is_lucky = any(
        (
            verdict.is_avoided & (margin_s(verdict, axis) < 0.0) & (axis.weight > 0.0)
        ).any()
        for _, verdict in _parties(evaluations)
    )
    if is_lucky:
        notes.append(
            tr(
                "A negative margin of an avoided run: braking came after the last "
                "moment, yet the car and the road user just missed each other."
            )
        )
    return notes


def margins_section(evaluations: Mapping[str, Evaluation]) -> Section:
    """Time and distance to spare of every layout; the first evaluation is the subject."""
    axis = next(iter(evaluations.values())).axis
    parties = _parties(evaluations)
    # The car has the last column, whatever does not fit.
    shown = [*parties[:-1][: MAX_COLUMNS - 1], parties[-1]]
    n_left = len(parties) - len(shown)
    caption = tr(
        "A mark for each run. Right of zero there is time to spare, left "
        "of it braking comes too late, by how much; at the left edge it "
        "never comes, or none avoids. Filled: avoided. The scale is "
        "logarithmic beyond 500 ms."
    )
    if n_left:
        caption += " " + tr("{n} more layouts are in the tables.", n=n_left)
    picture = build_picture(
        plot_margins(shown, axis)[0],
        title=tr("Margins to the last moment"),
        caption=caption,
        alt=tr(
            "Strips of marks, one per run, in a row for each case. The tables "
            "below have the numbers."
        ),
    )
    meaning = tr(
        "The margin is the time from the onset of braking to the last "
        "moment at which braking still avoids the impact. In metres it is "
        "the way that the car covers in that time at its speed: by so "
        "much farther from the collision, along its own path, it still is "
        "than it may be when it begins to brake. It is not the gap that "
        "is left once the car stands."
    )
    notes = [
        tr(
            "Smallest and median are those of the runs that are avoided; the "
            "smallest in milliseconds and the smallest in metres may be of "
            "different runs. “Worst too late by” is that of the runs in which "
            "the road user is confirmed, but too late."
        ),
        *margin_notes(evaluations),
    ]
    return Section(
        "margins",
        tr("Time and distance to spare"),
        [meaning, picture, " ".join(notes), *margin_tables(evaluations)],
    )
