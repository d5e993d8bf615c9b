"""Figure of APR against latency, with the parts of a latency budget below."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from placement.latency import LatencyBudget, LatencyCurve

from ..results.numbers import percent
from .axes import BLUE, GREY, VERMILION, WIDTH_IN, Style, finish_axes, literal, new_figure

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

    Parameters
    ----------
    curves : mapping of str to LatencyCurve
        By sensing party: "vut", "rsu_all", "vut_and_rsus", and the units by id.
    budget : LatencyBudget
        Best, mean and worst total, part by part.
    max_latency_s : float
        Right end. [s]

    Returns
    -------
    axes : list of Axes
        Two pairs in a new figure, in milliseconds; the lower one has a scale of its own.
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
        axes.annotate(
            f"{left:.4g} ms",
            xy=(left, row),
            xytext=(3.0, 0.0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
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
