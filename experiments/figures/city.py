"""Figures of a city: its map with what each junction gets, and its front."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from geometry.arrays import FloatArray
from geometry.maps.georeferences import transform
from geometry.maps.junctions import Surveyed
from geometry.maps.source_map import SourceMap

from ..results.city import CityJunctionRecord, CityResult
from .axes import BLUE, VERMILION, WIDTH_IN, Style, finish_axes, literal, new_axes
from .labels import Label, draw_labels

_MAX_TRIANGLES = 400_000
_ROADS, _BUILDINGS = "#b8b8b8", "#e9e9e9"
_AREA_PT2 = (70.0, 380.0)  # of the smallest and the largest circle
_MAX_NAMED = 12
_BEYOND = 0.08
_LEAST_M = 120.0
_HALO = withStroke(linewidth=2.5, foreground="white")


def plot_city_map(
    maps: Sequence[SourceMap],
    positions_m: Sequence[FloatArray],
    result: CityResult,
    *,
    axes: Axes | None = None,
) -> Axes:
    """Streets and buildings of the maps, and what each junction gets.

    Parameters
    ----------
    maps : sequence of SourceMap
        The one in whose coordinates `positions_m` are is the first.
    positions_m : sequence of (2,) float
        Of the junctions of `result`.

    Returns
    -------
    axes : Axes
        Circles are as large as what is gained, and the darker, the more units; their numbers stand
        in them. A small open circle gets nothing, a cross was not done.
    """
    places = np.array(positions_m).reshape(-1, 2)
    low, high = places.min(axis=0), places.max(axis=0)
    half = 0.5 * np.maximum(high - low, _LEAST_M) * (1.0 + 2.0 * _BEYOND) + 60.0
    middle = 0.5 * (low + high)
    if axes is None:
        height_in = float(np.clip(WIDTH_IN * half[1] / half[0], 3.2, 8.5))
        axes = new_axes(WIDTH_IN, height_in + 0.5)
    for source in maps:
        _draw_map(axes, source, maps[0].crs, middle - half, middle + half)
    _draw_junctions(axes, places, result.junctions)
    axes.set_aspect("equal")
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_xticks([])
    axes.set_yticks([])
    _draw_scale(axes, middle, half)
    return axes


def plot_junctions(maps: Sequence[SourceMap], surveyed: Sequence[Surveyed]) -> Axes:
    """Streets and buildings of maps with all junctions of the first, numbered in their order.

    The figure is the larger, the more there are. Names that would lie on others are left out; where
    a junction has none, its id stands.
    """
    places = np.array([one.junction.position_m for one in surveyed]).reshape(-1, 2)
    low, high = places.min(axis=0), places.max(axis=0)
    half = 0.5 * np.maximum(high - low, _LEAST_M) * (1.0 + 2.0 * _BEYOND) + 60.0
    middle = 0.5 * (low + high)
    width_in = WIDTH_IN * float(np.clip(np.sqrt(len(surveyed) / _FEW), 1.0, _MOST_WIDTHS))
    shape = float(np.clip(half[1] / half[0], 0.4, 1.6))
    axes = new_axes(width_in, width_in * shape)
    for source in maps:
        _draw_map(axes, source, maps[0].crs, middle - half, middle + half)
    axes.set_aspect("equal")
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_xticks([])
    axes.set_yticks([])
    axes.plot(*places.T, "o", markersize=11.0, color=BLUE, zorder=5)
    for number, (x, y) in enumerate(places, start=1):
        style: Style = {
            "color": "white",
            "fontsize": 6.0,
            "ha": "center",
            "va": "center",
            "zorder": 6,
        }
        axes.annotate(str(number), (x, y), zorder=6, **style)
    names = [
        Label(
            text=one.junction.name or one.junction.id,
            point_m=(float(x), float(y)),
            toward_deg=0.0,
            gap=7.0,
            size=6.5,
            is_kept=False,
        )
        for one, (x, y) in zip(surveyed, places, strict=True)
    ]
    draw_labels(axes, names, marks_m=places)
    _draw_scale(axes, middle, half)
    return axes


_FEW, _MOST_WIDTHS = 12, 3.0


def _draw_map(axes: Axes, source: SourceMap, crs: str, low: FloatArray, high: FloatArray) -> None:
    def here(points: FloatArray) -> FloatArray:
        if source.crs and crs and source.crs != crs:
            return transform(points[:, :2], source.crs, crs)
        return points[:, :2]

    faces = []
    for thing in source.things:
        if thing.class_name != "building" or not len(thing.triangles):
            continue
        points = here(thing.vertices_m)
        if (points.max(axis=0) < low).any() or (points.min(axis=0) > high).any():
            continue
        faces.append(points[thing.triangles])
    if faces and sum(map(len, faces)) <= _MAX_TRIANGLES:
        corners = np.concatenate(faces)
        axes.add_collection(
            PolyCollection(
                list(corners), facecolor=_BUILDINGS, edgecolor=_BUILDINGS, lw=0.2, zorder=1
            )
        )
    lines = [here(lane.centreline_m) for lane in source.lanes if lane.kind == "driving"]
    axes.add_collection(LineCollection(lines, colors=_ROADS, linewidths=0.7, zorder=2))


def _draw_junctions(
    axes: Axes, places: FloatArray, junctions: Sequence[CityJunctionRecord]
) -> None:
    gain = np.array([max(one.gain, 0.0) for one in junctions])
    units = np.array([one.units for one in junctions])
    failed = np.array([bool(one.reason) for one in junctions])
    served = units > 0
    nothing = ~served & ~failed
    most = max(int(units.max(initial=1)), 1)
    # Light to dark: a lightness that falls evenly is read without colours, too.
    shades = colormaps["cividis_r"]
    size = _AREA_PT2[0] + (_AREA_PT2[1] - _AREA_PT2[0]) * gain / max(gain.max(initial=0.0), 1e-12)
    order = np.flatnonzero(served)[np.argsort(-size[served], kind="stable")]
    handles: list[Any] = []
    for index in order:
        axes.scatter(
            places[index, 0],
            places[index, 1],
            s=size[index],
            color=shades(0.15 + 0.85 * units[index] / most),
            edgecolor="black",
            linewidth=0.6,
            zorder=5,
            gid=f"junction {junctions[index].id}",
        )
        axes.annotate(
            str(units[index]),
            tuple(places[index]),
            fontsize=6.5,
            ha="center",
            va="center",
            zorder=7,
            color="white" if units[index] > 0.45 * most else "black",
        )
    for count in sorted(set(units[served].tolist())):
        handles.append(
            Line2D(
                [],
                [],
                linestyle="none",
                marker="o",
                ms=7.0,
                mfc=shades(0.15 + 0.85 * count / most),
                mec="black",
                mew=0.6,
                label=f"{count} unit{'s' if count > 1 else ''}",
            )
        )
    if nothing.any():
        style: dict[str, Any] = {"marker": "o", "mfc": "white", "mec": "#444444", "mew": 0.9}
        axes.plot(*places[nothing].T, linestyle="none", ms=4.0, zorder=4, **style)
        handles.append(Line2D([], [], linestyle="none", ms=4.0, label="nothing", **style))
    if failed.any():
        style = {"marker": "x", "mec": VERMILION, "mew": 1.4}
        axes.plot(*places[failed].T, linestyle="none", ms=5.0, zorder=4, **style)
        handles.append(Line2D([], [], linestyle="none", ms=5.0, label="not done", **style))
    for rank, index in enumerate(order[:_MAX_NAMED], start=1):
        axes.annotate(
            literal(f"{rank}"),
            tuple(places[index]),
            xytext=(0.6 * np.sqrt(size[index]) + 1.0, 4.0),
            textcoords="offset points",
            fontsize=7.5,
            fontweight="bold",
            color=BLUE,
            path_effects=[_HALO],
            zorder=8,
        )
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.01),
        ncols=min(max(len(handles), 1), 6),
        fontsize=7.5,
        frameon=False,
    )


def _draw_scale(axes: Axes, middle: FloatArray, half: FloatArray) -> None:
    """A bar of a round length in the corner, and north."""
    length = 10.0 ** np.floor(np.log10(half[0]))
    length *= next(step for step in (5.0, 2.0, 1.0) if step * length <= 0.6 * half[0] or step == 1)
    x, y = middle[0] - 0.95 * half[0], middle[1] - 0.95 * half[1]
    axes.plot([x, x + length], [y, y], color="black", lw=2.0, zorder=9, path_effects=[_HALO])
    axes.annotate(
        f"{length:g} m, north is up",
        (x, y),
        xytext=(0.0, 3.0),
        textcoords="offset points",
        fontsize=7,
        zorder=9,
        path_effects=[_HALO],
    )


def plot_city_front(result: CityResult, *, axes: Axes | None = None) -> Axes:
    """Prevented accidents against money or units: who joins, and where the budget ends.

    Each dot is a step at which a junction gets more, and its choice is the best for what it takes.
    Between two dots other choices are best; made of the layouts found, none is above the line. The
    diamond is the choice for the budget; above it, the bound where that is higher.
    """
    axes = axes or new_axes(WIDTH_IN, 3.2)
    by_cost = result.by == "cost"
    x = [0.0, *(step.taken for step in result.front)]
    y = [100.0 * result.apr_before, *(100.0 * step.apr for step in result.front)]
    axes.plot(x, y, color=BLUE, lw=1.0, zorder=2)
    axes.plot(x, y, linestyle="none", marker="o", ms=3.5, color=BLUE, zorder=3, gid="steps")
    taken = result.cost_eur if by_cost else float(result.units)
    stage = result.stages[0]
    axes.plot(
        [taken],
        [100.0 * stage.objective],
        linestyle="none",
        marker="D",
        ms=7.5,
        mfc=VERMILION,
        mec="black",
        mew=0.6,
        zorder=5,
        label="chosen",
        gid="chosen",
    )
    if stage.bound is not None and stage.gap:
        axes.vlines(taken, 100.0 * stage.objective, 100.0 * stage.bound, color=VERMILION, lw=2.0)
        axes.plot(
            [taken],
            [100.0 * stage.bound],
            linestyle="none",
            marker="_",
            ms=12.0,
            mec=VERMILION,
            mew=2.0,
            label="no choice is above",
        )
    budget = result.budget_eur if by_cost else result.budget_units
    if budget is not None:
        axes.axvline(budget, color="black", lw=0.8, linestyle=(0, (2, 2)), label="budget")
    axes.set_ylim(0.0, 104.0)
    axes.set_xlim(left=0.0)
    label = "cost of units and sites (EUR)" if by_cost else "new units"
    finish_axes(axes, x=label, y="accidents prevented (%)", grid="y")
    if by_cost:
        axes.xaxis.set_major_formatter(lambda value, _position: f"{value:,.0f}")
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    return axes


def plot_junction_front(
    points: Sequence[tuple[float, float, int]],
    steps: Sequence[tuple[float, float]],
    *,
    chosen: int,
    axes: Axes | None = None,
) -> Axes:
    """APR against money at one junction: points (euros, APR, units), bounds, the one chosen."""
    axes = axes or new_axes(WIDTH_IN, 2.8)
    end = 1.1 * max(max(point[0] for point in points), 1.0)
    x = [start for start, _ in steps] + [end]
    y = [100.0 * bound for _, bound in steps]
    if y:
        axes.plot(
            x,
            [*y, y[-1]],
            drawstyle="steps-post",
            color="#777777",
            lw=1.0,
            linestyle=(0, (3, 2)),
            label="no layout is above",
        )
    axes.plot(
        [point[0] for point in points],
        [100.0 * point[1] for point in points],
        linestyle="none",
        marker="o",
        ms=5.0,
        color=BLUE,
        label="layouts",
        gid="points",
    )
    for cost, apr, units in points:
        axes.annotate(
            str(units),
            (cost, 100.0 * apr),
            xytext=(0.0, -9.0),
            textcoords="offset points",
            ha="center",
            fontsize=6.5,
        )
    axes.plot(
        [points[chosen][0]],
        [100.0 * points[chosen][1]],
        linestyle="none",
        marker="D",
        ms=7.5,
        mfc=VERMILION,
        mec="black",
        mew=0.6,
        label="chosen",
    )
    axes.set_ylim(-8.0, 104.0)
    axes.set_xlim(-0.03 * end, end)
    finish_axes(axes, x="cost (EUR); below each point its units", y="APR (%)", grid="y")
    axes.xaxis.set_major_formatter(lambda value, _position: f"{value:,.0f}")
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    return axes
