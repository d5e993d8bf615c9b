"""Runs as the player's script reads them: whole centimetres and milliseconds, packed bits."""

import base64
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geometry.arrays import FloatArray
from geometry.catalogue import Sensor, sensor_kind
from geometry.footprints import footprint_corners
from geometry.junction import build_junction
from geometry.lidar import LidarModel
from geometry.poses import body_rotation
from geometry.scene import Lane, Scene, thing_footprint
from geometry.terrain import Terrain, on_ground
from placement.candidates import CandidatePose, above_ground, is_ring
from placement.evaluation import Evaluation, Verdict
from placement.layout import Layout
from scenarios.runs import Run

from ...figures.axes import BLUE, GREEN, ORANGE, PINK, SKY, VERMILION, describe_run, unit_labels
from ...figures.plan import CLASS_STYLES
from ...figures.sensors import ground_rings
from ...figures.views import GroundViews

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


def pack_bits(bits: ArrayLike) -> str:
    """Rows of bits, each padded to whole bytes, the first bit highest, in base64.

    `bits` is (n_rows, n); :func:`unpack_bits` and the player's script give it back.
    """
    return to_base64(np.packbits(np.asarray(bits, dtype=bool), axis=1))


def unpack_bits(text: str, *, n_rows: int, n: int) -> NDArray[np.bool_]:
    """Rows of bits, (n_rows, n), from :func:`pack_bits`."""
    data = np.frombuffer(base64.b64decode(text), dtype=np.uint8).reshape(n_rows, -1)
    return np.unpackbits(data, axis=1, count=n).astype(bool)


# ---------- runs


_PARTY_NAMES = {
    "vut": "VUT",
    "rsu_all": "all RSUs",
    "vut_and_rsus": "VUT and RSUs",
    "vam": "VAM",
    "all_sources": "all sources",
}


def party_records(evaluations: Mapping[str, Evaluation]) -> list[dict[str, str]]:
    """Who may detect, in the order of the bits of :func:`run_record`.

    Each has a name and a kind: "vut", "unit", "rsu_all" (the subject's) or "other". Of other
    layouts than the subject, the first one, only all units together count.
    """
    subject_name, subject = next(iter(evaluations.items()))
    labels = unit_labels(subject.layout)
    return [
        {"name": _PARTY_NAMES["vut"], "kind": "vut"},
        *({"name": labels[unit_id], "kind": "unit"} for unit_id in subject.units),
        {"name": _PARTY_NAMES["rsu_all"], "kind": "rsu_all"},
        {"name": _PARTY_NAMES["vut_and_rsus"], "kind": "other"},
        *({"name": _PARTY_NAMES.get(name, name), "kind": "other"} for name in subject.others),
        *(
            {"name": f"{name}: all RSUs", "kind": "other"}
            for name in evaluations
            if name != subject_name
        ),
    ]


def run_record(run: Run, evaluations: Mapping[str, Evaluation], *, group: str) -> dict[str, Any]:
    """A run with what every party detects.

    Times in milliseconds (None: never), positions in centimetres, headings in tenths of a degree.
    "bits": see :func:`pack_bits`, a row per party.
    """
    subject, *others = evaluations.values()
    axis = subject.axis
    index = axis.run_ids.index(run.id)
    parties: list[tuple[Evaluation, Verdict]] = [
        (subject, subject.vut),
        *((subject, verdict) for verdict in subject.units.values()),
        (subject, subject.rsu_all),
        (subject, subject.vut_and_rsus),
        *((subject, verdict) for verdict in subject.others.values()),
        *((other, other.rsu_all) for other in others),
    ]
    at = [item.axis.run_ids.index(run.id) for item, _ in parties]
    detected = np.array(
        [
            verdict.detected[item.axis.frames_of(position)]
            for (item, verdict), position in zip(parties, at, strict=True)
        ]
    )
    verdicts = [verdict for _, verdict in parties]
    return {
        "id": run.id,
        "group": group,
        "title": describe_run(axis, index),
        "case": run.case.title,
        "user": run.case.vru.class_name,
        "time": _milliseconds(run.time_s),
        "last": _milliseconds(run.last_brake_time_s),
        "lastPlace": _last_place(run),
        "car": _motion(run.vut_position_m, run.vut_yaw_deg),
        "road": _motion(run.vru_position_m, run.vru_yaw_deg),
        "carSize": _centimetres([run.encounter.vut.length_m, run.encounter.vut.width_m]),
        "roadSize": _centimetres([run.encounter.vru.length_m, run.encounter.vru.width_m]),
        "parked": [
            {
                "name": body.actor.name,
                "corners": _centimetres(
                    footprint_corners(
                        body.pose.position_m[:2],
                        body.pose.yaw_deg,
                        length_m=body.actor.length_m,
                        width_m=body.actor.width_m,
                    )
                ),
                "height": _centimetres(body.actor.height_m),
            }
            for body in run.obstruction
        ],
        **_on_slope(run),
        "bits": pack_bits(detected),
        "confirmed": [
            _milliseconds(verdict.confirmation_time_s[position])
            for verdict, position in zip(verdicts, at, strict=True)
        ],
        "onset": [
            _milliseconds(verdict.onset_time_s[position])
            for verdict, position in zip(verdicts, at, strict=True)
        ],
        "avoided": [
            bool(verdict.is_avoided[position])
            for verdict, position in zip(verdicts, at, strict=True)
        ],
    }


def _on_slope(run: Run) -> dict[str, Any]:
    """Heights of the ground below car, road user and parked bodies; nothing on the plane."""
    if run.terrain is None:
        return {}
    return {
        "carGround": _centimetres(run.terrain.at(run.vut_position_m)),
        "roadGround": _centimetres(run.terrain.at(run.vru_position_m)),
        "parkedGround": [_centimetres(body.pose.position_m[2]) for body in run.obstruction],
    }


def is_playable(run: Run, evaluation: Evaluation) -> bool:
    """Whether an evaluation has the run on the very frames on which it is driven."""
    axis = evaluation.axis
    if run.id not in axis.run_ids:
        return False
    times_s = axis.time_s[axis.frames_of(axis.run_ids.index(run.id))]
    return len(times_s) == len(run.time_s) and bool(np.allclose(times_s, run.time_s, atol=1.0e-6))


def _last_place(run: Run) -> list[int] | None:
    """Where the car is at the last moment to brake; None where no braking helps."""
    if not np.isfinite(run.last_brake_time_s):
        return None
    motion = run.encounter.vut_motion
    (place,) = motion.path.at(motion.distance_m([run.last_brake_time_s]))[0]
    cm: list[int] = _centimetres(place)
    return cm


def _motion(position_m: FloatArray, yaw_deg: FloatArray) -> dict[str, list[int]]:
    return {
        "x": _centimetres(position_m[:, 0]),
        "y": _centimetres(position_m[:, 1]),
        "yaw": np.rint(10.0 * yaw_deg).astype(int).tolist(),
    }


def _centimetres(values_m: ArrayLike) -> Any:
    return np.rint(100.0 * np.asarray(values_m)).astype(int).tolist()


def _milliseconds(values_s: ArrayLike) -> Any:
    """Whole milliseconds; None in place of an infinity (of single values only)."""
    values = np.asarray(values_s, dtype=np.float64)
    if values.ndim == 0 and not np.isfinite(values):
        return None
    return np.rint(1000.0 * values).astype(int).tolist()


# ---------- units


COLOURS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY)
DASHES = ("", "7 4", "7 3 1.5 3", "1.5 3")
RANGE_M = 35.0
_POINTS_PER_SIDE = 8
_ABOVE_ROAD_M = 0.1  # or the road would hide parts of lines that lie on it


def unit_records(layout: Layout, scene: Scene) -> list[dict[str, Any]]:
    """Units of a layout for the player: centimetres, tenths of a degree."""
    labels = unit_labels(layout)
    return [
        {
            "name": labels[unit.id],
            "title": describe_unit(labels[unit.id], unit),
            "kind": "ring" if is_ring(unit.sensor) else sensor_kind(unit.sensor),
            "place": np.rint(100.0 * unit.pose.position_m[:2]).astype(int).tolist(),
            "yaw": round(10.0 * unit.pose.yaw_deg),
            "colour": COLOURS[index % len(COLOURS)],
            "dash": DASHES[index % len(DASHES)],
        }
        for index, unit in enumerate(above_ground(unit, scene) for unit in layout.units)
    ]


def view_paths(units: Iterable[CandidatePose], views: GroundViews) -> list[str]:
    """Ground on which each unit can detect a road user, as SVG paths in centimetres."""
    return [svg_path(views.shape(unit)) for unit in units]


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
    """Where the rays through the border of a sensor's field of view end.

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


# ---------- the ground and what stands on it, as SVG paths


_MAX_HALF_M = 120.0  # farther things are never in the player's window
_LEAST_HALF_M = 30.0
_TOLERANCE_M = 0.1  # corners nearer than this to the line between their neighbours drop out
_LABEL_SHARE = 0.86


def plan_record(scene: Scene, unit_positions_m: FloatArray) -> dict[str, Any]:
    """The still part of the player's plan.

    The window holds the units, at `unit_positions_m`, (n, 2), too, unless they are very far.
    "middle" and "half" of the window, "classes" (name, colour, path), "sites", "crosswalks", "arms"
    (name, place). Centimetres.
    """
    import shapely

    middle = 0.5 * (scene.outline_m.min(axis=0) + scene.outline_m.max(axis=0))
    window = shapely.box(*(middle - _MAX_HALF_M), *(middle + _MAX_HALF_M))
    reach = np.abs(np.concatenate([scene.outline_m, unit_positions_m]) - middle).max() + 8.0
    half = float(np.clip(reach, _LEAST_HALF_M, 0.5 * _MAX_HALF_M))
    layers: list[tuple[str, str, Any]] = [
        ("parking lane", "#ececec", _areas(scene.lanes, "parking")),
        ("lane", "#dedede", _areas(scene.lanes, "driving")),
        ("junction", "#dedede", shapely.make_valid(shapely.Polygon(scene.outline_m))),
    ]
    for name, style in CLASS_STYLES.items():
        parts = [
            thing_footprint(scene, index)
            for index, thing in enumerate(scene.instances)
            if thing.class_name == name
        ]
        layers.append((name, str(style["facecolor"]), shapely.union_all(parts)))
    paths = [
        {"name": name, "colour": colour, "path": svg_path(shape.intersection(window))}
        for name, colour, shape in layers
    ]
    return {
        "middle": _centimetres(middle),
        "half": round(100.0 * half),
        "classes": [path for path in paths if path["path"]],
        "sites": _centimetres(
            np.array([site.position_m[:2] for site in scene.sites]).reshape(-1, 2)
        ),
        "crosswalks": _centimetres(scene.crosswalks_m),
        "arms": _arm_labels(scene, middle, half),
    }


def lane_area(lane: Lane) -> Any:
    """What a lane covers: a shapely polygon. World frame, metres."""
    import shapely

    return shapely.LineString(lane.centreline_m).buffer(0.5 * lane.width_m, cap_style="flat")


def road_area(scene: Scene) -> Any:
    """Lanes and the junction's inside: a shapely polygon or several. World frame, metres."""
    import shapely

    inside = shapely.make_valid(shapely.Polygon(scene.outline_m))
    return shapely.union_all([inside, *(lane_area(lane) for lane in scene.lanes)])


def _areas(lanes: Iterable[Lane], kind: str) -> Any:
    import shapely

    # Not put together: the white lines between lanes stay.
    areas = [lane_area(lane) for lane in lanes if lane.kind == kind]
    return shapely.geometrycollections(areas)


def svg_path(shape: Any) -> str:
    """Closed rings of all polygons of a shapely shape in metres, as an SVG path in centimetres."""
    import shapely

    parts = shapely.get_parts(shapely.get_parts(shape).tolist())
    rings = [
        ring
        for part in parts
        if part.geom_type == "Polygon" and not part.is_empty
        for simple in shapely.get_parts(part.simplify(_TOLERANCE_M))
        if simple.geom_type == "Polygon"
        for ring in (simple.exterior, *simple.interiors)
    ]
    return "".join(
        "M" + "L".join(f"{x} {y}" for x, y in _centimetres(np.asarray(ring.coords)[:-1])) + "Z"
        for ring in rings
        if len(ring.coords) > 3
    )


def _arm_labels(scene: Scene, middle_m: FloatArray, half_m: float) -> list[dict[str, Any]]:
    labels = []
    for arm in build_junction(scene).arms.values():
        mouths = [lane.centreline_m[-1] for lane in arm.lanes_in]
        mouths += [lane.centreline_m[0] for lane in arm.lanes_out]
        outward = np.mean(mouths, axis=0) - middle_m
        outward /= max(float(np.hypot(*outward)), 1.0e-9)
        place = middle_m + _LABEL_SHARE * half_m * outward
        labels.append({"name": arm.name, "place": _centimetres(place)})
    return labels
