"""Strips of margins to the last moment: a mark for each run, in a row for each case."""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from geometry.arrays import FloatArray
from placement.evaluation import Verdict
from scenarios.runs import FrameAxis

from .figures import (
    BLUE,
    GREEN,
    ORANGE,
    PINK,
    SKY,
    VERMILION,
    WIDTH_IN,
    literal,
    new_axes,
)
from .verdict_tables import margin_s

MAX_COLUMNS = 4
"""Panels that fit side by side."""

_DPI = 160
_MS = 1000.0
_LINEAR_MS = 500.0  # the scale is linear up to here on both sides of zero, logarithmic beyond
_TICKS_MS = (-10_000.0, -1000.0, 0.0, 1000.0, 10_000.0)
_LANE_IN, _LEAST_ROW_IN = 0.095, 0.24
_TOP_ROWS = 0.7  # for words
_LABEL_WIDTH = 24
_COLOURLESS = {"markeredgecolor": "black"}
# Told apart without colour, too.
_STYLES = (
    ("o", BLUE),
    ("^", VERMILION),
    ("s", GREEN),
    ("X", ORANGE),
    ("D", PINK),
    ("v", SKY),
    ("P", "#000000"),
)


def plot_margins(
    parties: Sequence[tuple[str, Verdict]], axis: FrameAxis, *, axes: Sequence[Axes] | None = None
) -> tuple[Axes, ...]:
    """Margins of several parties side by side.

    Parameters
    ----------
    parties : sequence of (str, Verdict)
        Display name and verdict, on the same runs; at least one, at most ``MAX_COLUMNS``.
    axis : FrameAxis
        Runs.
    axes : sequence of Axes, optional
        One per party, to draw into; by default those of a new figure.

    Returns
    -------
    axes : tuple of Axes
        One per party; see :func:`plot_margin_strip`. All have the same scale.
    """
    if axes is None:
        axes = _build_panels(len(parties), axis)
    low_ms, high_ms = _limits_ms([verdict for _, verdict in parties], axis)
    for column, (panel, (name, verdict)) in enumerate(zip(axes, parties, strict=True)):
        plot_margin_strip(verdict, axis, axes=panel)
        panel.set_xlim(low_ms, high_ms)
        counts = axis.weight > 0.0
        n_avoided, n_runs = int((verdict.is_avoided & counts).sum()), int(counts.sum())
        panel.set_title(
            literal(textwrap.fill(name, max(12, 64 // len(parties))))
            + f"\n{n_avoided} of {n_runs} avoided",
            fontsize=8,
        )
        if column:
            panel.tick_params(axis="y", labelleft=False)
    return tuple(axes)


def plot_margin_strip(verdict: Verdict, axis: FrameAxis, *, axes: Axes | None = None) -> Axes:
    """Margins of one party: a mark for each run that counts, in a row for each case.

    Parameters
    ----------
    verdict : Verdict
        Whose.
    axis : FrameAxis
        Runs.
    axes : Axes, optional
        To draw into; by default those of a new figure.

    Returns
    -------
    axes : Axes
        Right of zero: time to spare; left: too late, at the edge: never. A marker and a lane per
        approach; filled where the run is avoided.
    """
    cases, approaches = _words(axis)
    if axes is None:
        axes = new_axes(WIDTH_IN, _height_in(axis))
    low_ms, high_ms = _limits_ms([verdict], axis)
    margin_ms = _MS * margin_s(verdict, axis)
    drawn_ms: FloatArray = np.where(np.isfinite(margin_ms), margin_ms, -np.inf)
    lane = 0.8 / len(approaches)
    row = np.array([cases.index(case) for case in axis.cases], dtype=np.float64)
    counts = axis.weight > 0.0
    axes.set_xscale("symlog", linthresh=_LINEAR_MS, linscale=0.8)
    axes.set_xlim(low_ms, high_ms)
    axes.axvspan(-1.0e9, 0.0, facecolor="#e8e8e8", zorder=0)
    axes.axvline(0.0, color="black", linewidth=1.2, zorder=2)
    for number, approach in enumerate(approaches):
        y = row + lane * (number - 0.5 * (len(approaches) - 1))
        of_approach = np.array([name == approach for name in axis.approaches]) & counts
        for is_filled in (False, True):
            mask = of_approach & (verdict.is_avoided == is_filled)
            never = mask & ~np.isfinite(drawn_ms)
            axes.plot(drawn_ms[mask & ~never], y[mask & ~never], **_mark(number, is_filled))
            if never.any():  # at the edge, wherever that is in the end
                axes.plot(
                    np.full(int(never.sum()), 0.03),
                    y[never],
                    transform=axes.get_yaxis_transform(),
                    **_mark(number, is_filled),
                )
    for between in range(len(cases)):
        axes.axhline(between - 0.5, color="#bbbbbb", linewidth=0.5, zorder=1)
    axes.set_ylim(len(cases) - 0.5, -0.5 - _TOP_ROWS)
    axes.set_yticks(range(len(cases)), [literal(case) for case in cases], fontsize=8)
    axes.set_xticks(_TICKS_MS, [_thousands(tick) for tick in _TICKS_MS], fontsize=7, rotation=45)
    axes.set_xticks([], minor=True)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("margin (ms)", fontsize=8)
    for words, side, away_pt in (("too late", "right", -3.0), ("to spare", "left", 3.0)):
        axes.annotate(
            words,
            xy=(0.0, -0.5 - _TOP_ROWS),
            xytext=(away_pt, -2.0),
            textcoords="offset points",
            ha=side,
            va="top",
            fontsize=7,
        )
    return axes


def _build_panels(n_panels: int, axis: FrameAxis) -> list[Axes]:
    """Panels side by side in a new figure, with the legend of the approaches below."""
    figure = Figure(figsize=(WIDTH_IN, _height_in(axis)), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    panels: list[Axes] = [*figure.subplots(1, n_panels, sharey=True, squeeze=False)[0]]
    _, approaches = _words(axis)
    handles = [
        Line2D(
            [],
            [],
            label=literal(textwrap.fill(f"from: {approach}", _LABEL_WIDTH)),
            **_mark(number, is_filled=True),
        )
        for number, approach in enumerate(approaches)
    ]
    handles.append(
        Line2D([], [], label="hollow: not avoided", **(_mark(0, is_filled=False) | _COLOURLESS))
    )
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return panels


def _height_in(axis: FrameAxis) -> float:
    cases, approaches = _words(axis)
    return 1.5 + (len(cases) + _TOP_ROWS) * max(_LEAST_ROW_IN, _LANE_IN * len(approaches))


def _words(axis: FrameAxis) -> tuple[list[str], list[str]]:
    return list(dict.fromkeys(axis.cases)), list(dict.fromkeys(axis.approaches))


def _limits_ms(verdicts: Sequence[Verdict], axis: FrameAxis) -> tuple[float, float]:
    """Where the scale begins and ends, with room for the marks at its left edge."""
    margins_ms = _MS * np.concatenate([margin_s(verdict, axis) for verdict in verdicts])
    finite_ms = margins_ms[np.isfinite(margins_ms)]
    low_ms = min(-_MS, float(finite_ms.min(initial=0.0)))
    high_ms = max(_MS, float(finite_ms.max(initial=0.0)))
    return 2.5 * low_ms, 1.5 * high_ms


def _mark(number: int, is_filled: bool) -> dict[str, Any]:
    marker, colour = _STYLES[number % len(_STYLES)]
    return {
        "marker": marker,
        "markersize": 3.6,
        "markerfacecolor": colour if is_filled else "white",
        "markeredgecolor": colour if not is_filled else "black",
        "markeredgewidth": 0.9 if not is_filled else 0.3,
        "linestyle": "none",
        "zorder": 4,
    }


def _thousands(value: float) -> str:
    return f"{value:.0f}".replace("-", "\N{MINUS SIGN}")
