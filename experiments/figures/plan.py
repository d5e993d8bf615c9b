"""Plan of the junction: where the units are, and what ground they look at."""

import math
from collections.abc import Collection, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch, Polygon
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from shapely.ops import unary_union

from geometry.actors import PlacedActor
from geometry.arrays import FloatArray
from geometry.notes import assumed_sites
from geometry.scene import Lane, Scene, thing_footprint
from placement.candidates import CandidatePose, above_ground, is_ring
from placement.layout import Layout
from placement.setting import Setting
from scenarios.runs import Run

from ..language import mark, tr
from ..results.numbers import layout_words, shortened
from . import labels
from .axes import (
    BLUE,
    CLASS_STYLES,
    GREY,
    UNIT_COLOURS,
    VERMILION,
    WIDTH_IN,
    Style,
    literal,
    new_axes,
    show_square,
)
from .outlines import blind_footprint, ground_footprint

# Where nobody drives.
_GROUND = "#f4f2ee"
_GREY_DOTS: Style = {"facecolor": "#f2f2f2", "edgecolor": "#8a8a8a"}
PARKED_STYLE: Style = _GREY_DOTS | {"linewidth": 0.7, "hatch": "...."}
_RING: Style = {"marker": "o", "markerfacecolor": "white", "markeredgecolor": "#444444"}
SITE_STYLE: Style = _RING | {
    "markersize": 4.0,
    "markeredgewidth": 0.9,
    "linestyle": "none",
}
ASSUMED_STYLE: Style = SITE_STYLE | {"marker": "D", "markeredgecolor": VERMILION}
"""Of sites that the map does not have, or not there."""
_LINE_STYLES = ("-", "--", "-.", ":")
_LEGEND_ROW_IN = 0.17
# Letters that the legend has room for.
_MAX_NAME = 38
# Name, dashes, width.
_PATHS: dict[str, tuple[str, Any, float]] = {
    "vut": (mark("car under test (VUT)"), "-", 1.3),
    "pedestrian": (mark("pedestrian, to the collision point"), (0, (1.2, 1.2)), 1.8),
    "cyclist": (mark("cyclist, to the collision point"), (0, (5.0, 2.0)), 1.2),
    "motorcyclist": (
        mark("motorcyclist, to the collision point"),
        (0, (5.0, 2.0, 1.2, 2.0)),
        1.2,
    ),
    "car": (mark("other car, to the collision point"), (0, (9.0, 3.0)), 1.2),
}
_FOUND: Style = {"markerfacecolor": BLUE, "markeredgecolor": "black"}
_EXISTING: Style = {"markerfacecolor": GREY}
_OTHER: Style = {"markerfacecolor": "white", "markeredgecolor": "#555555"}
_CROSS: Style = {"marker": "X", "markerfacecolor": "black", "markeredgecolor": "white"}
_IMPACT_STYLE: Style = _CROSS | {"markersize": 4.5, "linestyle": "none"}
_ROUND_MARKER: Style = {"marker": "o", "linestyle": "none"}
# Looking east; the last point closes the outline.
_DART = np.array([[1.0, 0.0], [-0.8, 0.6], [-0.45, 0.0], [-0.8, -0.6], [1.0, 0.0]])
# Half its length.
_DART_POINTS = 5.5
_LANE_COLOURS = {"parking": "#ececec", "bus": "#e6d3c8"}
_HALF_SIZE_M = 45.0
_MARGIN_M = 5.0


def draw_scene(axes: Axes, scene: Scene) -> None:
    """Draw lanes, crosswalks, sites and things.

    What comes later goes on top up to zorder 6.5.
    """
    axes.set_facecolor(_GROUND)
    for lane in scene.lanes:
        colour = _LANE_COLOURS.get(lane.kind, "#dedede")
        edge: Style = {"edgecolor": "white", "linewidth": 0.8}
        axes.add_patch(Polygon(_lane_polygon(lane), facecolor=colour, zorder=1, **edge))
    axes.add_patch(
        Polygon(scene.outline_m, facecolor="#dedede", edgecolor="none", zorder=1)
    )
    for island_m in scene.islands_m:
        style: Style = {"facecolor": _GROUND, "edgecolor": "white", "linewidth": 0.8}
        axes.add_patch(Polygon(island_m, zorder=1.1, **style))
    for ends in scene.crosswalks_m:
        # Grey below the white bars: next to the road they would not be seen on a white
        # ground.
        axes.plot(
            *ends.T, color="#8c8c8c", linewidth=6.0, solid_capstyle="butt", zorder=1.8
        )
        axes.plot(
            *ends.T, color="white", linewidth=5.0, linestyle=(0, (0.6, 0.6)), zorder=1.9
        )
    for index, instance in enumerate(scene.instances):
        if instance.class_name in CLASS_STYLES:
            path = _outline(thing_footprint(scene, index))
            axes.add_patch(
                PathPatch(path, zorder=6.5, **CLASS_STYLES[instance.class_name])
            )
    doubts = assumed_sites(scene.notes)
    for is_assumed, style in ((False, SITE_STYLE), (True, ASSUMED_STYLE)):
        sites = [
            s.position_m[:2] for s in scene.sites if (s.id in doubts) is is_assumed
        ]
        axes.plot(*np.array(sites).reshape(-1, 2).T, zorder=5, **style)


def draw_parked(axes: Axes, bodies: Iterable[PlacedActor]) -> None:
    """Draw bodies that belong to single cases.

    What they cover, and each once its outline.
    """
    corners = [one.footprint_m for one in {body.key: body for body in bodies}.values()]
    if not corners:
        return
    # All in one: a hatch takes as long as a hundred outlines.
    covered = _outline(unary_union([shapely.Polygon(ring) for ring in corners]))
    axes.add_patch(PathPatch(covered, zorder=2.2, **PARKED_STYLE))
    outlines = Path.make_compound_path(*(_ring(ring) for ring in corners))
    axes.add_patch(
        PathPatch(outlines, zorder=2.2, **PARKED_STYLE | {"fill": False, "hatch": ""})
    )


def _outline(shape: shapely.Geometry) -> Path:
    """Polygons as a path, courtyards left out."""
    return Path.make_compound_path(
        *(
            _ring(np.asarray(ring.coords)[:-1])
            for part in getattr(shape, "geoms", [shape])
            if part.geom_type == "Polygon"
            for ring in (part.exterior, *part.interiors)
            if len(ring.coords)
        )
    )


def _ring(corners: FloatArray) -> Path:
    return Path(np.concatenate([corners, corners[:1]]), closed=True)


def _lane_polygon(lane: Lane) -> FloatArray:
    # Half the width to the left and to the right of the centreline, there and back.
    direction = np.gradient(lane.centreline_m, axis=0)
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
    left = 0.5 * lane.width_m * np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    polygon: FloatArray = np.concatenate(
        [lane.centreline_m + left, (lane.centreline_m - left)[::-1]]
    )
    return polygon


def plot_plan(
    setting: Setting,
    layout: Layout,
    *,
    others: Sequence[Layout] = (),
    existing: Collection[str] = (),
    half_size_m: float | None = None,
    max_range_m: float = 35.0,
    width_in: float = WIDTH_IN,
    axes: Axes | None = None,
) -> Axes:
    """Plan of the junction with a layout.

    Where its units are and what ground they look at.

    Parameters
    ----------
    setting : Setting
        Junction and runs.
    layout : Layout
        Drawn with labels and fields of view.
    others : sequence of Layout
        Drawn lighter, without fields of view.
    existing : collection of str
        Ids of units of the layout that are mounted already: their marks are grey.
    half_size_m : float, optional
        Half the side of the square that is shown, around the middle of the junction; by
        default 45, or what shows all units and places along the arms. [m]
    max_range_m : float
        Fields of view end here; the camera itself sees farther. [m]
    width_in : float
        Of a new figure. [inch]
    axes : Axes, optional
        Where to draw; by default in a new figure.

    Returns
    -------
    axes : Axes
        In metres, north up.
    """
    entries = _plan_legend(setting, layout, others, existing)
    if width_in < WIDTH_IN:
        n_columns = 1
    else:
        n_columns = 2
    if axes is None:
        n_rows = -(-len(entries) // n_columns)
        axes = new_axes(width_in, width_in + 0.05 + _LEGEND_ROW_IN * n_rows)
        # What is left over is below the legend.
        axes.set_anchor("N")
    scene, outline = setting.scene, setting.scene.outline_m
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    feet = np.array([unit.pose.position_m[:2] for unit in layout.units])
    # Large enough for every place where somebody is hit, and for all units.
    if half_size_m is None:
        places = np.concatenate(
            [[run.vru_position_m[-1] for run in setting.runs], feet]
        )
        half_size_m = max(
            _HALF_SIZE_M, float(np.abs(places - middle).max(initial=0.0)) + _MARGIN_M
        )
    # From below: the junction, what is driven, other layouts, and the one it is about.
    draw_scene(axes, scene)
    draw_parked(axes, [body for run in setting.runs for body in run.obstruction])
    _draw_paths(axes, setting.runs)
    for unit in [unit for other in others for unit in other.units]:
        axes.plot(*unit.pose.position_m[:2], zorder=7, **_camera_marker(unit), **_OTHER)
    _draw_units(axes, layout, scene, max_range_m, existing)
    show_square(axes, middle, half_size_m)
    # Labels come last, where they hide nothing that is drawn.
    names = [
        *labels.unit_names(layout, scene),
        *labels.arm_names(scene, middle, half_size_m),
    ]
    # Approximate ends of the units' arrows.
    yaw = np.radians([unit.pose.yaw_deg for unit in layout.units])
    length_m = 0.6 * labels.ARROW_POINTS * 2.0 * half_size_m / (60.0 * width_in)
    tips = feet + length_m * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    marks_m = np.concatenate([feet, tips])
    labels.draw_labels(
        axes, [*names, *labels.position_names(setting.runs)], marks_m=marks_m
    )
    axes.set_xlabel(tr("east (m)"))
    axes.set_ylabel(tr("north (m)"))
    _draw_compass(axes, middle, half_size_m)
    below: Style = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.54 / width_in)}
    axes.legend(handles=entries, ncols=n_columns, fontsize=8, frameon=False, **below)
    return axes


def _draw_paths(axes: Axes, runs: Sequence[Run]) -> None:
    firsts = {
        (run.case.name, run.approach, run.position): run for run in reversed(runs)
    }
    # Lines with gaps are drawn in one go.
    gap = np.full((1, 2), np.nan)
    ways: dict[str, list[FloatArray]] = {name: [gap] for name in _PATHS}
    for run in firsts.values():
        vru = run.case.vru.class_name
        ways["vut"] += [run.vut_position_m, gap]
        ways[vru if vru in ways else "pedestrian"] += [run.vru_position_m, gap]
    for name, parts in ways.items():
        axes.plot(*np.concatenate(parts).T, zorder=3, **_path_style(name))
    impacts = np.array([run.vru_position_m[-1] for run in firsts.values()]).reshape(
        -1, 2
    )
    axes.plot(*impacts.T, zorder=4, **_IMPACT_STYLE)


def _path_style(name: str) -> Style:
    _, dashes, width = _PATHS[name]
    return {"color": "black", "linestyle": dashes, "linewidth": width}


def _draw_units(
    axes: Axes,
    layout: Layout,
    scene: Scene,
    max_range_m: float,
    existing: Collection[str],
) -> None:
    n_units = len(layout.units)
    for index, unit in enumerate(layout.units):
        colour = UNIT_COLOURS[index % len(UNIT_COLOURS)]
        level = above_ground(unit, scene)
        corners = ground_footprint(level, max_range_m=max_range_m)
        if len(corners):
            shape = ring_path(corners, blind_footprint(level, max_range_m=max_range_m))
            ground = PathPatch(
                shape, facecolor=colour, alpha=0.6 / (n_units + 3.0), zorder=2.5
            )
            line: Style = {"linestyle": _LINE_STYLES[index % len(_LINE_STYLES)]}
            if n_units <= labels.MAX_LABELLED_UNITS:
                line["linewidth"] = 1.2
            else:
                line["linewidth"] = 0.4
            axes.add_patch(ground)
            axes.add_patch(
                PathPatch(shape, fc="none", edgecolor=colour, zorder=6, **line)
            )
        rank = sum(labels.looks_alike(unit, other) for other in layout.units[:index])
        style = _camera_marker(unit, rank) | _FOUND | {"markerfacecolor": colour}
        if unit.id in existing:
            style |= _EXISTING
        axes.plot(*unit.pose.position_m[:2], zorder=8, gid=f"unit:{unit.id}", **style)


def _camera_marker(unit: CandidatePose, rank: int = 0) -> Style:
    """A dart that points where the camera looks, the next ones before it.

    A disc: all round.
    """
    if is_ring(unit.sensor):
        return {**_ROUND_MARKER, "markersize": 10.0}
    yaw = math.radians(unit.pose.yaw_deg)
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    ahead = _DART + [1.0 + 2.0 * rank, 0.0]
    # matplotlib scales a marker by its largest coordinate.
    size = 2.0 * _DART_POINTS * float(np.abs(ahead @ turn).max())
    return {
        "marker": Path(ahead @ turn, closed=True),
        "linestyle": "none",
        "markersize": size,
    }


def _draw_compass(axes: Axes, middle_m: FloatArray, half_size_m: float) -> None:
    east, north = middle_m + half_size_m * np.array([0.91, 0.76])
    arrow = {"arrowstyle": "-|>", "facecolor": "black", "linewidth": 1.4}
    letter: Style = {
        "fontsize": 11,
        "fontweight": "bold",
        "ha": "center",
        "va": "center",
    }
    letter |= {"path_effects": [labels.HALO], "zorder": 10}
    tip = (east, north + 0.18 * half_size_m)
    axes.annotate(tr("N"), xy=tip, xytext=(east, north), arrowprops=arrow, **letter)
    length_m = 10.0
    x, y = middle_m - 0.95 * half_size_m
    bar: Style = {
        "color": "black",
        "linewidth": 4.0,
        "solid_capstyle": "butt",
        "zorder": 11,
    }
    halo = [withStroke(linewidth=6.0, foreground="white")]
    axes.plot([x, x + length_m], [y, y], path_effects=halo, **bar)
    text: Style = {
        "fontsize": 9,
        "path_effects": [labels.HALO],
        "zorder": 11,
        "va": "bottom",
    }
    axes.text(x + 0.5 * length_m, y + 1.2, f"{length_m:g} m", ha="center", **text)


def _plan_legend(
    setting: Setting,
    layout: Layout,
    others: Sequence[Layout],
    existing: Collection[str],
) -> list[Any]:
    line = partial(Line2D, [], [])
    bodies = {"vut", *(run.case.vru.class_name for run in setting.runs)}
    paths = [
        line(label=tr(_PATHS[name][0]), **_path_style(name))
        for name in _PATHS
        if name in bodies
    ]
    camera: Style = {
        "marker": Path(_DART, closed=True),
        "linestyle": "none",
        "markersize": 8.0,
    }
    few = len(layout.units) <= labels.MAX_LABELLED_UNITS
    what = mark("{layout}: camera and its view")
    if not few:
        what = mark("{layout}: cameras and their views")
    own = shortened(layout_words(layout.name), _MAX_NAME)
    rings = [is_ring(unit.sensor) for unit in layout.units]
    if all(rings):
        units = []
    else:
        units = [line(label=literal(tr(what, layout=own)), **_FOUND, **camera)]
    if any(rings):
        label = literal(tr("{layout}: LiDAR that scans all round", layout=own))
        units.append(line(label=label, markersize=8.0, **_FOUND, **_ROUND_MARKER))
    if existing:
        grey = _FOUND | camera | _EXISTING
        units.append(line(label=tr("existing: mounted already"), **grey))
    for name in dict.fromkeys(other.name for other in others):
        label = literal(
            tr("{layout}: camera", layout=shortened(layout_words(name), _MAX_NAME))
        )
        units.append(line(label=label, **_OTHER, **camera))
    shown = {instance.class_name for instance in setting.scene.instances} - {
        "traffic light"
    }
    things = [
        Patch(label=tr(name), **CLASS_STYLES[name])
        for name in CLASS_STYLES
        if name in shown
    ]
    if any(run.obstruction for run in setting.runs):
        things.append(
            Patch(label=tr("parked vehicle or wall of some cases"), **PARKED_STYLE)
        )
    doubts = assumed_sites(setting.scene.notes)
    sites = [line(label=tr("pole or mast: possible site"), **SITE_STYLE)]
    if doubts:
        is_all = all(one.id in doubts for one in setting.scene.sites)
        assumed = line(label=tr("assumed site: not mapped there"), **ASSUMED_STYLE)
        if is_all:
            sites = [assumed]
        else:
            sites = [*sites, assumed]
    label = tr("collision point")
    if len({run.position for run in setting.runs}) > 1:
        label = tr("collision point; metres before (\N{MINUS SIGN}), behind (+)")
    return [*units, *paths, line(label=label, **_IMPACT_STYLE), *sites, *things]


def ring_path(*outlines_m: FloatArray) -> Path:
    """Open outlines, (n, 2), as one shape.

    The inside of the second is a hole in the first.
    """
    rings = [
        Path(np.vstack([corners, corners[:1]])[:: -1 if index else 1], closed=True)
        for index, corners in enumerate(outlines_m)
        if len(corners)
    ]
    return Path.make_compound_path(*rings)
