"""The front as a figure: shares over the number of units or money."""

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from ..figures.axes import BLUE, VERMILION, WIDTH_IN, Style, finish_axes, new_figure
from ..language import mark, tr
from .front import FrontPointRecord, FrontRecord, stage_of

_SETTLED = "#ececec"
# Told apart by marker and dashes as well as by colour.
_SOLID: Style = {"color": BLUE, "marker": "o", "linestyle": "-"}
_DASHED: Style = {"color": VERMILION, "marker": "s", "linestyle": (0, (4, 2))}
_CURVES: dict[str, Style] = {
    "apr": {"label": mark("APR")} | _SOLID,
    "apr_one_failed": {"label": mark("APR when the most needed unit fails")} | _DASHED,
}


def plot_front(front: FrontRecord) -> Axes:
    """APR and APR when one unit fails against units or euros.

    Filled markers are layouts found. Open ones are bounds that no layout exceeds, where
    they are higher; a bar spans the gap. Where nothing grows any more, the ground is
    grey.
    """
    figure = new_figure(WIDTH_IN, 3.4)
    shares: Axes = figure.add_subplot()
    handles = _draw(shares, front)
    shares.set_ylabel(tr("share of the runs avoided (%)"), fontsize=8)
    shares.set_ylim(-4.0, 104.0)
    if front.by == "units":
        x_label = tr("units")
    else:
        x_label = tr("cost (EUR)")
    shares.set_xlabel(x_label, fontsize=8)
    if not front.is_proven:
        style: Style = {
            "mfc": "none",
            "mec": "black",
            "mew": 1.4,
            "ms": 9.0,
            "linestyle": "none",
        }
        label = tr("not proven: upper bound for any layout")
        handles.append(Line2D([], [], marker="o", label=label, **style))
    if front.settled is not None:
        handles.append(
            Patch(facecolor=_SETTLED, label=tr("proven: no further improvement"))
        )
    place: Style = {"loc": "outside upper center", "ncols": 2}
    figure.legend(handles=handles, fontsize=8, frameon=False, **place)
    return shares


def _draw(axes: Axes, front: FrontRecord) -> list[Any]:
    """Draw the curves; returns the entries of the legend."""
    points = front.points
    by_units = front.by == "units"
    x = np.array(
        [float(point.units) if by_units else point.cost_eur for point in points]
    )
    if by_units:
        end = float(x[-1]) + 0.4
    else:
        end = 1.15 * max(float(x[-1]), 1.0)
    handles: list[Any] = []
    if front.settled is not None:
        axes.axvspan(front.settled, end, color=_SETTLED, zorder=0, lw=0, gid="settled")
    for order, (name, style) in enumerate(_CURVES.items()):
        values = 100.0 * np.array([getattr(point, name) for point in points])
        bounds = 100.0 * np.array([_bound(point, name) for point in points])
        is_open = bounds > values + 1.0e-7
        # The later curve's markers are smaller: where both coincide, both are seen.
        size = 8.0 - 3.0 * order
        colour = style["color"]
        line: Style = {"color": colour, "linestyle": style["linestyle"], "lw": 1.6}
        mark: Style = {"marker": style["marker"], "linestyle": "none"}
        if by_units:
            axes.plot(x, values, zorder=2 + order, **line)
        else:
            # The last layout is the best for more money, too.
            steps: Style = line | {"drawstyle": "steps-post"}
            axes.plot(
                np.append(x, end),
                np.append(values, values[-1]),
                zorder=2 + order,
                **steps,
            )
        mark |= {"mfc": colour, "mec": "white", "mew": 0.6}
        axes.plot(x, values, ms=size, zorder=4 + order, gid=name, **mark)
        if is_open.any():
            at = x[is_open]
            low = values[is_open]
            high = bounds[is_open]
            axes.vlines(at, low, high, color=colour, lw=7.0, alpha=0.3)
            mark |= {"mfc": "none", "mec": colour, "mew": 1.4, "ms": size + 4.0}
            axes.plot(at, high, zorder=8 + order, gid=f"{name} bound", **mark)
        label = {"marker": style["marker"], "ms": size, "label": tr(style["label"])}
        handles.append(Line2D([], [], **label, **line))
    if by_units:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(float(x[0]) - 0.4 if by_units else -0.02 * end, end)
    finish_axes(axes, grid="y")
    return handles


def _bound(point: FrontPointRecord, name: str) -> float:
    """Bound of a stage; the value itself where it was not optimised."""
    stage = stage_of(point, name)
    if stage is None:
        return float(getattr(point, name))
    if stage.bound is None:
        return math.inf
    return stage.bound
