"""Pictures: the plan of a scene, and the junctions of a map."""

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patheffects import withStroke

from geometry.arrays import FloatArray
from geometry.frames import transform
from geometry.junction import build_junction
from geometry.lines import points_at
from geometry.maps.importing import Surveyed
from geometry.maps.source_map import SourceMap
from geometry.scene import Scene

from ..figures.axes import BLUE, WIDTH_IN, finish_axes, literal, new_axes, show_square
from ..figures.labels import TextLabel, arm_names, draw_labels
from ..figures.plan import draw_scene
from . import CAUSES

# Of buildings; more are not drawn.
_MAX_TRIANGLES = 400_000
_ROADS = "#b8b8b8"
_BUILDINGS = "#e9e9e9"
# Of the span of the junctions, around them.
_BEYOND = 0.08
_LEAST_M = 120.0
_NAMED_M = 45.0
# A street's name from a junction; and again.
_NAMED_AGAIN_M = 250.0
_FINEST_M = 0.5
# Of streets drawn in SVG: metres, and parts of its width.
_MOST_STEPS = 8000
HALO = withStroke(linewidth=2.5, foreground="white")


def plot_scene_plan(scene: Scene) -> Axes:
    """Plan of a scene, north up.

    A square of 90 m to 180 m with all things and sites.
    """
    junction = build_junction(scene)
    middle = 0.5 * (scene.outline_m.min(axis=0) + scene.outline_m.max(axis=0))
    half = _half_size_m(scene, middle)
    axes = new_axes(WIDTH_IN, WIDTH_IN)
    draw_scene(axes, scene)
    outline = np.vstack([scene.outline_m, scene.outline_m[:1]])
    axes.plot(*outline.T, color=BLUE, linewidth=1.4, zorder=3)
    for arm in junction.arms.values():
        for lanes, is_in in ((arm.lanes_in, True), (arm.lanes_out, False)):
            for lane in lanes:
                if lane.kind == "driving":
                    _draw_direction(axes, lane.centreline_m, is_in=is_in)
    show_square(axes, middle, half)
    places = np.array([site.position_m[:2] for site in scene.sites]).reshape(-1, 2)
    names = [
        TextLabel(
            text=site.id,
            point_m=(float(site.position_m[0]), float(site.position_m[1])),
            size=5.5,
            is_kept=False,
            style={"color": "#333333", "zorder": 8},
        )
        for site in scene.sites
    ]
    draw_labels(
        axes, [*arm_names(scene, middle, half), *names], marks_m=places, mark=2.5
    )
    finish_axes(axes, x="east (m)", y="north (m)", size=9, hidden=())
    axes.set_title(literal(scene.name), fontsize=10)
    return axes


def _half_size_m(scene: Scene, middle_m: FloatArray) -> float:
    is_thing = np.array([thing.class_name != "ground" for thing in scene.instances])
    corners = scene.vertices_m[scene.triangles[is_thing[scene.triangle_instance]]][
        ..., :2
    ]
    points = [
        corners.reshape(-1, 2),
        *(site.position_m[None, :2] for site in scene.sites),
    ]
    reach = np.abs(np.concatenate([scene.outline_m, *points]) - middle_m).max()
    return float(np.clip(reach + 5.0, 45.0, 90.0))


def _draw_direction(axes: Axes, points_m: FloatArray, *, is_in: bool) -> None:
    """An arrow along a lane, some metres from its mouth."""
    far, near = points_at(points_m[::-1] if is_in else points_m, np.array([9.0, 4.0]))
    if is_in:
        start, end = (far, near)
    else:
        start, end = (near, far)
    axes.annotate(
        "",
        xy=(end[0], end[1]),
        xytext=(start[0], start[1]),
        arrowprops={"arrowstyle": "-|>", "color": "#333333", "linewidth": 0.9},
        zorder=4,
    )


def build_street_map(
    maps: Sequence[SourceMap], places_m: FloatArray
) -> tuple[dict[str, Any], Callable[[FloatArray], FloatArray]]:
    """Driving lanes of maps as an SVG path.

    With room for places (n, 2) in the first map's system.

    And the function that takes points (..., 2 or 3) of that system to metres to the
    right and down from the map's upper left corner.
    """
    low = places_m.min(axis=0)
    high = places_m.max(axis=0)
    around = _BEYOND * (high - low) + _LEAST_M
    corner_m = np.array([low[0] - around[0], high[1] + around[1]])

    def place(points_m: FloatArray) -> FloatArray:
        return np.asarray(np.round((points_m[..., :2] - corner_m) * [1.0, -1.0], 1))

    size_m = np.round(high - low + 2.0 * around, 1)
    finest_m = max(_FINEST_M, size_m.max() / _MOST_STEPS)
    lines = (
        line_m for source in maps for line_m in _driving_lines(source, maps[0].crs)
    )
    ways = [
        shapely.simplify(shapely.LineString(place(line_m)), finest_m)
        for line_m in lines
    ]
    paths = (
        "L".join(f"{x:g},{y:g}" for x, y in shapely.get_coordinates(way))
        for way in ways
    )
    return {
        "size_m": size_m.tolist(),
        "streets": "".join(f"M{path}" for path in paths),
    }, place


def junction_map(
    maps: Sequence[SourceMap], surveyed: Sequence[Surveyed]
) -> dict[str, Any]:
    """The junctions of the first map to choose from, as JSON.

    On its streets with their names.

    Each has the cause for which it cannot be used, a key of ``CAUSES``, or none.
    """
    places = np.array([one.junction.position_m for one in surveyed]).reshape(-1, 2)
    streets, placed = build_street_map(maps[:1], places)
    names: dict[tuple[str, int, int], dict[str, Any]] = {}
    for road in (road for one in surveyed for road in one.junction.roads):
        x, y = placed(road.point_m + _NAMED_M * road.direction).tolist()
        turn_deg = -np.degrees(np.arctan2(road.direction[1], road.direction[0]))
        upright_deg = (turn_deg + 90.0) % 180.0 - 90.0
        place = {"name": road.name, "x": x, "y": y, "turn_deg": round(upright_deg)}
        if not re.fullmatch(r"(way|road) \S+", road.name):
            names.setdefault(
                (road.name, x // _NAMED_AGAIN_M, y // _NAMED_AGAIN_M), place
            )
    junctions = [
        {
            **{"id": one.junction.id, "name": one.junction.name, "x": x, "y": y},
            **{"arms": len(one.arms), "lanes": one.n_lanes},
            **{"signals": one.n_signals, "crossings": one.n_crossings},
            "cause": "" if one.n_driven else "no lane" if one.arms else "no road",
        }
        for one, (x, y) in zip(surveyed, placed(places).tolist(), strict=True)
    ]
    return {**streets, "names": [*names.values()], "junctions": junctions}


def _template(name: str) -> Any:
    from ..report.page import page_environment

    return page_environment().get_template(name)


def junction_chooser(shown: dict[str, Any]) -> str:
    """A :func:`junction_map` as HTML, for ``junction_map.js``.

    Texts in it are escaped.
    """
    return str(_template("junction_map.html.j2").module.chooser(shown, CAUSES))


def junctions_page(
    maps: Sequence[SourceMap], surveyed: Sequence[Surveyed], *, command: str
) -> str:
    """A page to choose one of the junctions of the first map.

    It loads nothing. `command` makes a scene of a junction whose id follows.
    """
    shown = {
        "name": maps[0].name,
        "shown": junction_map(maps, surveyed),
        "causes": CAUSES,
    }
    page: str = _template("junctions.html.j2").render(**shown, command=command)
    return page


def new_map_axes(
    maps: Sequence[SourceMap], places_m: FloatArray, *, width_in: float = WIDTH_IN
) -> Axes:
    """Axes with streets and buildings of maps around places.

    Places (n, 2) are in the first map's system.
    """
    low = places_m.min(axis=0)
    high = places_m.max(axis=0)
    half = 0.5 * np.maximum(high - low, _LEAST_M) * (1.0 + 2.0 * _BEYOND) + 60.0
    middle = 0.5 * (low + high)
    axes = new_axes(width_in, width_in * float(np.clip(half[1] / half[0], 0.4, 1.6)))
    for source in maps:
        _draw_map(axes, source, maps[0].crs, middle - half, middle + half)
    axes.set(aspect="equal", xticks=[], yticks=[])
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    _draw_scale(axes, middle, half)
    return axes


def _in_system(points: FloatArray, source: SourceMap, crs: str) -> FloatArray:
    """Points (n, 2 or 3) of a map in the system of another one, (n, 2)."""
    if source.crs and crs and source.crs != crs:
        return transform(points[:, :2], source.crs, crs)
    return points[:, :2]


def _driving_lines(source: SourceMap, crs: str) -> list[FloatArray]:
    """Centrelines (n, 2) of driving lanes in another map's system."""
    lanes = (lane for lane in source.lanes if lane.kind == "driving")
    return [_in_system(lane.centreline_m, source, crs) for lane in lanes]


def _draw_map(
    axes: Axes, source: SourceMap, crs: str, low: FloatArray, high: FloatArray
) -> None:
    faces = []
    for thing in source.things:
        if thing.class_name != "building" or not len(thing.triangles):
            continue
        points = _in_system(thing.vertices_m, source, crs)
        if (points.max(axis=0) < low).any() or (points.min(axis=0) > high).any():
            continue
        faces.append(points[thing.triangles])
    if faces and sum(map(len, faces)) <= _MAX_TRIANGLES:
        triangles = list(np.concatenate(faces))
        axes.add_collection(
            PolyCollection(triangles, color=_BUILDINGS, lw=0.2, zorder=1)
        )
    lines = _driving_lines(source, crs)
    axes.add_collection(LineCollection(lines, colors=_ROADS, linewidths=0.7, zorder=2))


def _draw_scale(axes: Axes, middle: FloatArray, half: FloatArray) -> None:
    """A bar of a round length in the corner, and north."""
    length = 10.0 ** np.floor(np.log10(half[0]))
    length *= next(
        step for step in (5.0, 2.0, 1.0) if step * length <= 0.6 * half[0] or step == 1
    )
    x = middle[0] - 0.95 * half[0]
    y = middle[1] - 0.95 * half[1]
    axes.plot(
        [x, x + length], [y, y], color="black", lw=2.0, zorder=9, path_effects=[HALO]
    )
    axes.annotate(
        f"{length:g} m, north is up",
        (x, y),
        xytext=(0.0, 3.0),
        textcoords="offset points",
        fontsize=7,
        zorder=9,
        path_effects=[HALO],
    )
