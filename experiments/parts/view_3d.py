"""The scene in three dimensions, as traces for plotly.js."""

import base64
import gzip
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geometry.arrays import FloatArray, IntArray
from geometry.catalogue import Sensor, sensor_kind
from geometry.lidar import LidarModel
from geometry.poses import body_rotation
from geometry.scene import Lane, Scene
from geometry.terrain import Terrain, on_ground, terrain_of
from placement.candidates import CandidatePose, above_ground, is_ring
from placement.layout import Layout

from ..figures.axes import BLUE, GREEN, ORANGE, PINK, SKY, VERMILION, unit_labels
from ..figures.plan import CLASS_STYLES, ground_rings

COLOURS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY)
DASHES = ("", "7 4", "7 3 1.5 3", "1.5 3")
RANGE_M = 35.0
_POINTS_PER_SIDE = 8
_ABOVE_ROAD_M = 0.1  # or the road would hide parts of lines that lie on it
MAX_TRIANGLES = 60_000
_COLOURS = {"ground": "#ebe8e0", "lamp post": "#40404d"} | {
    name: str(style["facecolor"]) for name, style in CLASS_STYLES.items()
}
_ROAD_COLOUR = "#b5b5b8"
_ROAD_LIFT_M, _LINE_LIFT_M = 0.04, 0.08  # above the ground, so that neither flickers
_PIECE_M = 4.0  # of a road that is not flat
_WALL_SHADE, _SIDE_SHADE = 0.2, 0.4
_LIT_SIDE = np.array([0.9, 0.44])
_LEAST_HALF_M, _MOST_HALF_M = 40.0, 90.0
_LEAST_TOP_M, _MOST_TOP_M = 16.25, 60.25  # not just a roof's height, which would flicker
_MAX_LABELS = 40  # of more units, the key switches fields of view on
_DASHES_M: tuple[tuple[float, ...], ...] = ((), (1.6, 1.0), (1.8, 0.6, 0.4, 0.6), (0.4, 0.6))
_LABEL_PLACES = ("top left", "top right", "bottom left", "bottom right")  # units share poles
_MAX_STYLES = 12  # of units: as many pairs of colour and dash as there are


def view_record(
    scene: Scene, layout: Layout | None, others: Sequence[Layout] = ()
) -> dict[str, Any]:
    """Traces and layout of the 3-D view; without a layout, of the junction alone.

    "traces" for plotly.js; a mesh's "names" and "nameIndex" (of each vertex) are for the script,
    which makes hover texts of them. "middle" and "half" of the part that is shown, its "top"
    and "bottom" [m]. "note": what is left out, or an empty text.
    """
    middle = 0.5 * (scene.outline_m.min(axis=0) + scene.outline_m.max(axis=0))
    kept = nearest_triangles(scene, middle, MAX_TRIANGLES)
    units = () if layout is None else layout.units
    units_m = np.array([unit.pose.position_m for unit in units]).reshape(-1, 3)
    reach = np.abs(np.concatenate([scene.outline_m, units_m[:, :2]]) - middle).max() + 15.0
    half = float(np.clip(reach, _LEAST_HALF_M, _MOST_HALF_M))
    n_left_out = len(scene.triangles) - len(kept)
    terrain = terrain_of(scene)
    return {
        "traces": [
            *_meshes(scene, kept),
            _road(scene, terrain),
            _lane_lines(scene, terrain),
            *_fields_of_view(units, terrain),
            *(_sensors(layout, scene) if layout is not None else ()),
            *(_other_sensors(other, scene) for other in others),
        ],
        "middle": np.round(middle, 2).tolist(),
        "half": round(half, 2),
        "top": round(_top_m(scene, kept, units_m, middle, half), 2),
        "bottom": round(_bottom_m(terrain, middle, half), 2),
        "note": f"{n_left_out} of the scene's {len(scene.triangles)} triangles, those farthest "
        "from the junction, are left out here."
        if n_left_out
        else "",
    }


def unmarked(text: str) -> str:
    """A text in which plotly.js finds no markup: it reads what is in angle brackets as such."""
    return text.replace("<", "\N{SINGLE LEFT-POINTING ANGLE QUOTATION MARK}").replace(
        ">", "\N{SINGLE RIGHT-POINTING ANGLE QUOTATION MARK}"
    )


def _top_m(
    scene: Scene, kept: IntArray, units_m: FloatArray, middle_m: FloatArray, half_m: float
) -> float:
    """Above everything that is shown, but for towers."""
    vertices = scene.vertices_m[np.unique(scene.triangles[kept])]
    is_near = (np.abs(vertices[:, :2] - middle_m) <= half_m).all(axis=1)
    heights_m = np.concatenate([units_m[:, 2] + 2.5, vertices[is_near, 2]])
    return float(np.clip(heights_m.max() + 1.5, _LEAST_TOP_M, _MOST_TOP_M))


def _bottom_m(terrain: Terrain | None, middle_m: FloatArray, half_m: float) -> float:
    """Below everything that is shown."""
    if terrain is None:
        return -1.0
    east, north = (np.clip(line, *span) for line, span in _shown(terrain, middle_m, half_m))
    return float(terrain.at(np.stack(np.meshgrid(east, north), axis=-1)).min()) - 1.0


def _shown(
    terrain: Terrain, middle_m: FloatArray, half_m: float
) -> list[tuple[FloatArray, tuple[float, float]]]:
    lines = (terrain.east_m, terrain.north_m)
    return [
        (line, (float(middle - half_m), float(middle + half_m)))
        for line, middle in zip(lines, middle_m, strict=True)
    ]


def nearest_triangles(scene: Scene, middle_m: FloatArray, max_triangles: int) -> IntArray:
    """Triangles nearest to a point, in ascending order of their index.

    Indices into ``scene.triangles``; the distance of a triangle is that of the box around it.
    """
    n_triangles = len(scene.triangles)
    if n_triangles <= max_triangles:
        return np.arange(n_triangles)
    corners = scene.vertices_m[scene.triangles][..., :2] - middle_m
    outside = np.maximum(np.maximum(corners.min(axis=1), -corners.max(axis=1)), 0.0)
    nearest = np.argsort(np.hypot(*outside.T), kind="stable")[:max_triangles]
    kept: IntArray = np.sort(nearest)
    return kept


def _meshes(scene: Scene, kept: IntArray) -> list[dict[str, Any]]:
    """A mesh per class."""
    classes = np.array([thing.class_name for thing in scene.instances])
    traces = []
    for name, colour in _COLOURS.items():
        index = kept[classes[scene.triangle_instance[kept]] == name]
        if not len(index):
            continue
        # A vertex of two things becomes two, so that each has one name.
        things = np.repeat(scene.triangle_instance[index], 3).astype(np.int64)
        keys = scene.triangles[index].reshape(-1) * len(classes) + things
        unique, corner = np.unique(keys, return_inverse=True)
        shown, name_index = np.unique(unique % len(classes), return_inverse=True)
        trace = _mesh(name, colour, scene.vertices_m[unique // len(classes)], corner.reshape(-1, 3))
        trace["names"] = [unmarked(f"{name} {scene.instances[thing].id}") for thing in shown]
        trace["nameIndex"] = name_index.tolist()
        traces.append(trace)
    return traces


def _mesh(name: str, colour: str, vertices_m: FloatArray, triangles: IntArray) -> dict[str, Any]:
    kind = "u2" if len(vertices_m) < 1 << 16 else "u4"
    return {
        "type": "mesh3d",
        "name": name,
        "color": colour,
        # Own shades: plotly.js lights two halves of one flat roof differently.
        "intensity": to_plotly_array(np.rint(255.0 * _shades(vertices_m[triangles])), "u1"),
        "intensitymode": "cell",
        "cmin": 0,
        "cmax": 255,
        "colorscale": [[0, _darker(colour)], [1, colour]],
        "showscale": False,
        "lighting": {"ambient": 1, "diffuse": 0, "specular": 0, "fresnel": 0},
        "showlegend": True,
        **{
            axis: to_plotly_array(np.round(vertices_m[:, column], 2), "f4")
            for column, axis in enumerate("xyz")
        },
        **{
            corner: to_plotly_array(triangles[:, column], kind)
            for column, corner in enumerate("ijk")
        },
    }


def _shades(corners_m: FloatArray) -> FloatArray:
    """Brightness of triangles (n, 3, 3), 0 .. 1: flat ones most, walls by where they face.

    Which way a triangle winds does not matter.
    """
    normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1.0e-12)
    flat = np.abs(normals[:, 2])
    shades: FloatArray = _WALL_SHADE + (1.0 - _WALL_SHADE) * flat
    shades += _SIDE_SHADE * (1.0 - flat) * np.abs(normals[:, :2] @ _LIT_SIDE)
    return np.clip(shades, 0.0, 1.0)


def _darker(colour: str) -> str:
    parts = [round(0.5 * int(colour[start : start + 2], 16)) for start in (1, 3, 5)]
    return "#" + "".join(f"{part:02x}" for part in parts)


def _road(scene: Scene, terrain: Terrain | None) -> dict[str, Any]:
    import shapely

    road = road_area(scene).simplify(0.05)
    if terrain is not None:  # pieces so small that they lie on the ground
        west, south, east, north = road.bounds
        places = np.meshgrid(np.arange(west, east, _PIECE_M), np.arange(south, north, _PIECE_M))
        x, y = (place.ravel() for place in places)
        pieces = shapely.intersection(shapely.box(x, y, x + _PIECE_M, y + _PIECE_M), road)
        road = shapely.geometrycollections(pieces[shapely.area(pieces) > 0.0])
    area = shapely.constrained_delaunay_triangles(road)
    corners = [np.asarray(part.exterior.coords)[:3] for part in shapely.get_parts(area)]
    flat = np.array(corners).reshape(-1, 2)
    vertices = on_ground(flat, terrain) + [0.0, 0.0, _ROAD_LIFT_M]
    trace = _mesh("road", _ROAD_COLOUR, vertices, np.arange(len(flat)).reshape(-1, 3))
    return trace | {"hoverinfo": "skip"}


def _lane_lines(scene: Scene, terrain: Terrain | None) -> dict[str, Any]:
    import shapely

    lines = [np.asarray(lane_area(lane).exterior.coords) for lane in scene.lanes]
    lines += [np.vstack([scene.outline_m, scene.outline_m[:1]]), *scene.crosswalks_m]
    if terrain is not None:
        bent = shapely.segmentize([shapely.LineString(line) for line in lines], 0.5 * _PIECE_M)
        lines = [np.asarray(line.coords) for line in bent]
    points = [on_ground(line, terrain) + [0.0, 0.0, _LINE_LIFT_M] for line in lines]
    trace = _lines("lanes and crosswalks", points, colour="#ffffff", width=2)
    return trace | {"showlegend": False}  # white on white


def _lines(name: str, lines: Iterable[FloatArray], *, colour: str, width: float) -> dict[str, Any]:
    """Lines as one trace; gaps between them are None."""
    columns: dict[str, list[float | None]] = {"x": [], "y": [], "z": []}
    for line in lines:
        for column, values in enumerate(columns.values()):
            values += [*np.round(line[:, column], 2).tolist(), None]
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": name,
        **columns,
        "line": {"color": colour, "width": width},
        "hoverinfo": "skip",
    }


def dashes(line_m: FloatArray, pattern_m: Sequence[float]) -> list[FloatArray]:
    """Pieces of a line that a dash pattern leaves; plotly.js dashes by the eye's distance.

    A line and its pieces are (n, 3) corners; `pattern_m` has lengths of dash and gap by turns. [m]
    """
    steps = np.linalg.norm(np.diff(line_m, axis=0), axis=1)
    along = np.append(0.0, np.cumsum(steps))
    if not pattern_m or along[-1] <= 0.0:
        return [line_m]
    n_repeats = int(along[-1] / sum(pattern_m)) + 1
    ends = np.append(0.0, np.cumsum(np.tile(pattern_m, n_repeats)))
    pieces = []
    for start, end in zip(ends[::2], ends[1::2], strict=False):
        if start >= along[-1]:
            break
        inner = along[(along > start) & (along < end)]
        places = np.concatenate([[start], inner, [min(end, along[-1])]])
        pieces.append(np.stack([np.interp(places, along, column) for column in line_m.T], axis=1))
    return pieces


def _fields_of_view(
    units: Sequence[CandidatePose], terrain: Terrain | None
) -> list[dict[str, Any]]:
    """Borders of fields of view: a trace per style, however many units there are."""
    by_style: dict[int, list[FloatArray]] = {}
    is_dashed = len(units) <= _MAX_STYLES
    for index, unit in enumerate(units):
        lines = field_lines(unit, max_range_m=RANGE_M, terrain=terrain)
        by_style.setdefault(index % _MAX_STYLES, []).extend(lines)
    return [
        _lines(
            f"fields of view, up to {RANGE_M:g} m",
            # Of many units dashes would tell nothing, but make the page long.
            [
                piece
                for line in lines
                for piece in dashes(line, _DASHES_M[style % len(_DASHES_M)] if is_dashed else ())
            ],
            colour=COLOURS[style % len(COLOURS)],
            width=3,
        )
        | {"legendgroup": "fields of view", "showlegend": position == 0}
        | ({"visible": "legendonly"} if len(units) > _MAX_LABELS else {})
        for position, (style, lines) in enumerate(by_style.items())
    ]


_SYMBOLS = {"camera": "diamond", "lidar": "square"}
_KIND_NAMES = {"camera": "camera", "lidar": "LiDAR"}


def _sensors(layout: Layout, scene: Scene) -> list[dict[str, Any]]:
    """Points with labels: a trace per kind of sensor."""
    labels = unit_labels(layout)
    colours = {unit.id: COLOURS[index % len(COLOURS)] for index, unit in enumerate(layout.units)}
    traces = []
    for kind, symbol in _SYMBOLS.items():
        units = [unit for unit in layout.units if sensor_kind(unit.sensor) == kind]
        if not units:
            continue
        traces.append(
            _points(units, f"{layout.name}: {_KIND_NAMES[kind]}")
            | {
                "mode": "markers+text" if len(layout.units) <= _MAX_LABELS else "markers",
                "text": [unmarked(labels[unit.id]) for unit in units],
                "textposition": [
                    _LABEL_PLACES[index % len(_LABEL_PLACES)] for index in range(len(units))
                ],
                "textfont": {"size": 14, "color": "#000000"},
                "hovertext": [
                    unmarked(describe_unit(labels[unit.id], above_ground(unit, scene)))
                    for unit in units
                ],
                "marker": {
                    "symbol": symbol,
                    "size": 7,
                    "color": [colours[unit.id] for unit in units],
                    "line": {"color": "#000000", "width": 2},
                },
            }
        )
    return traces


def _other_sensors(layout: Layout, scene: Scene) -> dict[str, Any]:
    return _points(layout.units, f"{layout.name}: sensor") | {
        "mode": "markers",
        "hovertext": [
            unmarked(f"{layout.name}, {describe_unit(unit.id, above_ground(unit, scene))}")
            for unit in layout.units
        ],
        "marker": {"symbol": "circle-open", "size": 5, "color": "#333333"},
    }


def _points(units: Sequence[CandidatePose], name: str) -> dict[str, Any]:
    positions = np.round([unit.pose.position_m for unit in units], 2)
    return {
        "type": "scatter3d",
        "name": unmarked(name),
        "hoverinfo": "text",
        **{axis: positions[:, column].tolist() for column, axis in enumerate("xyz")},
    }


# ---------- units


def describe_unit(label: str, unit: CandidatePose) -> str:
    """A unit in words, for hovering; its height is that above the plane z = 0."""
    name = label if label == unit.id else f"{label}, {unit.id}"
    return (
        f"{name}: {sensor_kind(unit.sensor)} {unit.sensor.name}, "
        f"{unit.pose.position_m[2]:.1f} m high" + (", scans all round" * is_ring(unit.sensor))
    )


def field_lines(
    unit: CandidatePose, *, max_range_m: float, terrain: Terrain | None = None
) -> list[FloatArray]:
    """Lines that show a unit's field of view.

    Each is (n, 3), in metres, world frame: the border, and the edges from the sensor to its
    corners. Of a LiDAR that scans all round: where on the road its scan ends and begins, and four
    of its lowest beams. World frame. [m]
    """
    foot_m = on_ground(unit.pose.position_m[:2], terrain) * [0.0, 0.0, 1.0]
    level = replace(unit, pose=replace(unit.pose, position_m=unit.pose.position_m - foot_m))
    rings = ground_rings(level, max_range_m=max_range_m) if is_ring(unit.sensor) else ()
    borders = [on_ground(ring, terrain) + [0.0, 0.0, _ABOVE_ROAD_M] for ring in rings if len(ring)]
    borders = borders or [view_border(unit, max_range_m=max_range_m, terrain=terrain)]
    corners = borders[-1][:: len(borders[-1]) // 4]
    return [
        *(np.vstack([border, border[:1]]) for border in borders),
        *(np.stack([unit.pose.position_m, corner]) for corner in corners),
    ]


def view_border(
    unit: CandidatePose, *, max_range_m: float, terrain: Terrain | None = None
) -> FloatArray:
    """Ends of the rays through the border of a sensor's field of view.

    Shape (32, 3), in order around the border; every eighth is a corner. Rays end at `max_range_m`,
    or on the ground. World frame. [m]
    """
    directions = _border_directions(unit.sensor) @ (
        body_rotation(unit.pose.yaw_deg, unit.pose.pitch_deg).T
    )
    if terrain is not None:
        length = terrain.distances(unit.pose.position_m, directions, max_range_m=max_range_m)
        return unit.pose.position_m + length[:, None] * directions
    length = np.full(len(directions), max_range_m)
    falls = directions[:, 2] < -1.0e-9
    to_ground = -unit.pose.position_m[2] / directions[falls, 2]
    length[falls] = np.minimum(length[falls], np.maximum(to_ground, 0.0))
    ends: FloatArray = unit.pose.position_m + length[:, None] * directions
    return ends


def _border_directions(sensor: Sensor) -> FloatArray:
    """Unit vectors around the border, from the upper left corner on, (32, 3). Body frame."""
    step = np.linspace(-1.0, 1.0, _POINTS_PER_SIDE, endpoint=False)
    one = np.ones_like(step)
    across = np.concatenate([step, one, -step, -one])
    down = np.concatenate([-one, step, one, -step])
    half_width = math.radians(0.5 * sensor.horizontal_fov_deg)
    half_height = math.radians(0.5 * sensor.vertical_fov_deg)
    if isinstance(sensor, LidarModel):  # equal steps of angle
        azimuth, elevation = -across * half_width, -down * half_height
        directions: FloatArray = np.stack(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ],
            axis=1,
        )
        return directions
    directions = np.stack(
        [np.ones_like(across), -across * math.tan(half_width), -down * math.tan(half_height)],
        axis=1,
    )
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions


# ---------- roads


def lane_area(lane: Lane) -> Any:
    """Ground that a lane covers: a shapely polygon. World frame, metres."""
    import shapely

    return shapely.LineString(lane.centreline_m).buffer(0.5 * lane.width_m, cap_style="flat")


def road_area(scene: Scene) -> Any:
    """Lanes and the junction's inside: a shapely polygon or several. World frame, metres."""
    import shapely

    inside = shapely.make_valid(shapely.Polygon(scene.outline_m))
    return shapely.union_all([inside, *(lane_area(lane) for lane in scene.lanes)])


# ---------- values as text within a script


_ESCAPES = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026"}


def to_script_json(value: Any) -> str:
    r"""A value as JSON that no name in it can break out of.

    ASCII without ``<``, ``>`` and ``&``: U+2028, U+2029 and halves of surrogate pairs are escaped,
    too.

    References
    ----------
    .. [1] WHATWG, "HTML", section 4.12.1.3, "Restrictions for contents of script elements".

    Examples
    --------
    >>> to_script_json({"a": "</script>"})
    '{"a":"\\u003c/script\\u003e"}'
    """
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for sign, escaped in _ESCAPES.items():  # in JSON these stand in texts only
        text = text.replace(sign, escaped)
    return text


def to_base64(array: NDArray[Any]) -> str:
    """Bytes of an array, row by row, in base64."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def to_plotly_array(values: ArrayLike, kind: str) -> dict[str, str]:
    """An array as plotly.js reads it: kind and little-endian bytes in base64.

    `kind` is "f4", "u2", "u4" and so on.
    """
    return {"dtype": kind, "bdata": to_base64(np.asarray(values).astype(f"<{kind}"))}


# ---------- what the template needs


_PLOTLY_PACKAGE = "plotly"


def view_part(scene: Scene, layout: Layout | None, others: Sequence[Layout] = ()) -> dict[str, str]:
    """Values for ``templates/view_3d.html.j2``, which stands alone, too; the layout may be None."""
    view = view_record(scene, layout, others)
    return {
        "view_json": to_script_json(view),
        "note": view["note"],
        "plotly_gzip": packed_plotly(),
    }


@cache
def packed_plotly() -> str:
    """plotly.js as the page holds it, in base64 of gzip: a third of its size; may be empty."""
    source = plotly_script()
    # No time stamp, so that equal reports are equal files.
    return base64.b64encode(gzip.compress(source.encode(), mtime=0)).decode() if source else ""


def plotly_script() -> str:
    """Source of plotly.js as the package plotly brings it; empty where it is not installed."""
    try:
        from plotly.offline import get_plotlyjs
    except ModuleNotFoundError as error:
        if error.name != _PLOTLY_PACKAGE:
            raise
        return ""
    return str(get_plotlyjs())
