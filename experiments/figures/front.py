"""Figure of a front: what each further unit, or more money, buys."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from geometry.arrays import FloatArray
from placement.optimiser.front import Front

from .axes import BLUE, VERMILION, WIDTH_IN, Style, finish_axes, new_figure

_SETTLED = "#ececec"
_X_LABELS = {"units": "units", "cost": "cost (EUR)"}
# Told apart by marker and dashes as well as by colour.
_CURVES: dict[str, Style] = {
    "apr": {"label": "APR", "color": BLUE, "marker": "o", "linestyle": "-"},
    "apr_one_failed": {
        "label": "APR when the most needed unit fails",
        "color": VERMILION,
        "marker": "s",
        "linestyle": (0, (4, 2)),
    },
}
_TIMES: dict[str, Style] = {
    "smallest_margin_s": {"label": "smallest", "color": BLUE, "marker": "o", "linestyle": "-"},
    "mean_margin_s": {
        "label": "mean",
        "color": VERMILION,
        "marker": "s",
        "linestyle": (0, (4, 2)),
    },
}


def plot_front(front: Front, *, axes: Axes | None = None) -> Axes:
    """APR and APR when one unit fails against units or euros; times to spare where optimised.

    Parameters
    ----------
    front : Front
        To draw.
    axes : Axes, optional
        Where to draw shares, without times; by default in a figure of their own, with axes for
        the times to spare below these where they were optimised.

    Returns
    -------
    axes : Axes
        Of the shares. Filled markers are layouts found. Open ones are bounds that no layout
        exceeds, where they are higher; a bar spans the gap. Where nothing grows any more, the
        ground is grey.
    """
    if axes is not None:
        handles = _draw_shares(axes, front)
        axes.set_xlabel(_X_LABELS[front.by], fontsize=8)
        axes.legend(handles=[*handles, *_shades(front)], fontsize=8, frameon=False, loc="best")
        return axes
    has_times = front.stages == "all"
    figure = new_figure(WIDTH_IN, 4.9 if has_times else 3.4)
    panels = figure.subplots(
        2 if has_times else 1, 1, sharex=True, squeeze=False, height_ratios=[3, 2][: 1 + has_times]
    )[:, 0]
    handles = _draw_shares(panels[0], front)
    if has_times:
        times = _draw(panels[1], front, _TIMES, scale=1.0)
        panels[1].set_ylabel("time to spare (s)", fontsize=8)
        panels[1].set_ylim(bottom=min(0.0, panels[1].get_ylim()[0]))
        panels[1].legend(handles=times[:2], fontsize=8, frameon=False, loc="best")
    panels[-1].set_xlabel(_X_LABELS[front.by], fontsize=8)
    figure.legend(
        handles=[*handles, *_shades(front)],
        loc="outside upper center",
        ncols=2,
        fontsize=8,
        frameon=False,
    )
    shares: Axes = panels[0]
    return shares


def _draw_shares(axes: Axes, front: Front) -> list[Any]:
    """Draw what is avoided; returns the entries of the legend."""
    handles = _draw(axes, front, _CURVES, scale=100.0)
    axes.set_ylabel("share of the runs avoided (%)", fontsize=8)
    axes.set_ylim(-4.0, 104.0)
    return handles


def _draw(axes: Axes, front: Front, curves: dict[str, Style], *, scale: float) -> list[Any]:
    """Draw curves; returns the entries of the legend."""
    x = _positions(front)
    steps = "steps-post" if front.by == "cost" else "default"
    end = _right_end(x, front.by)
    handles: list[Any] = []
    if front.settled is not None:
        axes.axvspan(front.settled, end, color=_SETTLED, zorder=0, lw=0, gid="settled")
    for order, (name, style) in enumerate(curves.items()):
        values = scale * np.array([getattr(point.value, name) for point in front.points])
        bounds = scale * np.array(_bounds(front, name))
        is_open = bounds > values + 1.0e-9 * scale
        # The later curve's markers are smaller: where both coincide, both are seen.
        size = 8.0 - 3.0 * order
        drawn = {"color": style["color"], "linestyle": style["linestyle"]}
        line_x, line_y = x, values
        if front.by == "cost":  # the last layout is the best for more money, too
            line_x, line_y = np.append(x, end), np.append(values, values[-1])
        axes.plot(line_x, line_y, drawstyle=steps, lw=1.6, zorder=2 + order, **drawn)
        axes.plot(
            x,
            values,
            linestyle="none",
            marker=style["marker"],
            ms=size,
            mfc=style["color"],
            mec="white",
            mew=0.6,
            zorder=4 + order,
            gid=name,
        )
        if is_open.any():
            axes.vlines(
                x[is_open],
                values[is_open],
                bounds[is_open],
                color=style["color"],
                lw=7.0,
                alpha=0.3,
            )
            axes.plot(
                x[is_open],
                bounds[is_open],
                linestyle="none",
                marker=style["marker"],
                ms=size + 4.0,
                mfc="none",
                mec=style["color"],
                mew=1.4,
                zorder=8 + order,
                gid=f"{name} bound",
            )
        handles.append(
            Line2D([], [], marker=style["marker"], ms=size, label=style["label"], lw=1.6, **drawn)
        )
    if front.by == "units":
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(_left_end(x, front.by), end)
    finish_axes(axes, grid="y")
    return handles


def _shades(front: Front) -> list[Any]:
    """Entries of the legend for what is open, and for where nothing grows."""
    entries: list[Any] = []
    if not front.is_proven:
        style: Style = {"mfc": "none", "mec": "black", "mew": 1.4, "ms": 9.0}
        words = "open: bound that no layout exceeds"
        entries.append(Line2D([], [], linestyle="none", marker="o", label=words, **style))
    if front.settled is not None:
        entries.append(Patch(facecolor=_SETTLED, label="nothing grows any more: proven"))
    return entries


def _positions(front: Front) -> FloatArray:
    if front.by == "units":
        return np.array([float(point.units) for point in front.points])
    return np.array([point.value.cost_eur for point in front.points])


def _bounds(front: Front, name: str) -> Sequence[float]:
    """Bounds of a stage; the value itself where it was not optimised."""
    return [
        getattr(point.value, name) if stage is None else stage.bound
        for point in front.points
        for stage in [point.stage(name)]
    ]


def _left_end(x: FloatArray, by: str) -> float:
    return float(x[0]) - 0.4 if by == "units" else 0.0 - 0.02 * _right_end(x, by)


def _right_end(x: FloatArray, by: str) -> float:
    return float(x[-1]) + 0.4 if by == "units" else 1.15 * max(float(x[-1]), 1.0)
