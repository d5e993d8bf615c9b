"""The player's data: runs as its script reads them.

In whole centimetres and milliseconds, and packed bits.
"""

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geometry.arrays import FloatArray
from geometry.catalogue import sensor_kind
from geometry.junction import build_junction
from geometry.scene import Lane, Scene, paved_area, thing_footprint
from placement.candidates import CandidatePose, above_ground, is_ring
from placement.evaluation import Evaluation
from placement.layout import Layout
from placement.setting import Setting
from scenarios.runs import Run

from ..figures.axes import CLASS_STYLES, UNIT_COLOURS, describe_run, unit_labels
from ..figures.views import GroundViews
from ..language import mark, tr
from ..results.cached import cached_part
from ..results.numbers import layout_words
from ..results.tables import margin_s, parties

DASHES = ("", "7 4", "7 3 1.5 3", "1.5 3")


SHOWN_ABOVE = mark("shown above")
NOT_AVOIDED = mark("not avoided")
AVOIDED = mark("avoided")
# Of records: some four hundred runs of a dozen units.
_MAX_BYTES = 1_500_000
_ESCAPES = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026"}
# Farther things are never in the player's window.
_MAX_HALF_M = 120.0
_LEAST_HALF_M = 30.0
# corners nearer than this to the line between their neighbours drop out
_TOLERANCE_M = 0.1
_LABEL_SHARE = 0.86


def interactive_part(
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    first_runs: Sequence[str] = (),
    cache_folder: Path | None = None,
) -> dict[str, Any]:
    """Values for ``templates/interactive.html.j2``.

    The first evaluation is the subject. Of the others, all units together are a row of
    the heatmap. Runs of `first_runs` come first, then those that are not avoided, then
    all others, each the later the more time is to spare, as many as fit: "n_runs" of
    "n_all". The page opens with the first of `first_runs`, else with a run that shows
    something: the one of those not avoided in which units detect most often.
    """
    n_runs, player_json = cached_part(
        cache_folder,
        "player",
        lambda: _build_player(setting, evaluations, first_runs),
        kind=tuple[int, str],
        made_from=(
            *(setting.scene, setting.runs, setting.axis),
            setting.table_detector.fingerprint(),
            *(evaluations, first_runs),
        ),
    )
    n_all = setting.axis.n_runs
    return {"n_runs": n_runs, "n_all": n_all, "player_json": player_json}


def _build_player(
    setting: Setting, evaluations: Mapping[str, Evaluation], first_runs: Sequence[str]
) -> tuple[int, str]:
    """Number of runs, and the player's data as JSON for a script."""
    subject = next(iter(evaluations.values()))
    axis = subject.axis
    units = subject.layout.units
    verdict = subject.headline
    firsts = [axis.run_ids.index(run_id) for run_id in dict.fromkeys(first_runs)]
    ordered = np.lexsort((margin_s(verdict, axis), verdict.is_avoided)).tolist()
    records: list[dict[str, Any]] = []
    shows: list[tuple[bool, bool, int]] = []
    n_bytes = 0
    for index in dict.fromkeys([*firsts, *ordered]):
        if verdict.is_avoided[index]:
            group = AVOIDED
        else:
            group = NOT_AVOIDED
        record = run_record(setting.runs[index], index, evaluations)
        records.append(
            record | {"group": tr(SHOWN_ABOVE if index in firsts else group)}
        )
        n_seen = int(verdict.detected[axis.frames_of(index)].sum())
        shows.append((n_seen > 0, group == NOT_AVOIDED, n_seen))
        n_bytes += len(to_script_json(records[-1]))
        if n_bytes > _MAX_BYTES:
            break
    first = 0
    if not firsts:
        first = shows.index(max(shows))
    views = GroundViews(setting)
    seen = [{"view": svg_path(views.shape(unit))} for unit in units]
    known = unit_records(subject.layout, setting.scene)
    player = {
        "plan": plan_record(setting.scene),
        "units": [record | view for record, view in zip(known, seen, strict=True)],
        "parties": party_records(evaluations),
        "runs": records,
        "first": first,
    }
    return len(records), to_script_json(player)


def to_script_json(value: Any) -> str:
    r"""A value as JSON that no name in it can break out of.

    ASCII without ``<``, ``>`` and ``&``: U+2028, U+2029 and halves of surrogate pairs
    are escaped, too.

    References
    ----------
    .. [1] WHATWG, "HTML", section 4.12.1.3, "Restrictions for contents of script
       elements".

    Examples
    --------
    >>> to_script_json({"a": "</script>"})
    '{"a":"\\u003c/script\\u003e"}'
    """
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    # In JSON these stand in texts only.
    for sign, escaped in _ESCAPES.items():
        text = text.replace(sign, escaped)
    return text


def to_base64(array: NDArray[Any]) -> str:
    """Bytes of an array, row by row, in base64."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def pack_bits(bits: ArrayLike) -> str:
    """Rows of bits in base64.

    Each is padded to whole bytes, the first bit the highest.

    `bits` is (n_rows, n); :func:`unpack_bits` and the player's script give it back.
    """
    return to_base64(np.packbits(np.asarray(bits, dtype=bool), axis=1))


_PARTIES = {
    "vut": mark("VUT"),
    "rsu_all": mark("all RSUs"),
    "vut_and_rsus": mark("VUT and RSUs"),
    "vam": mark("VAM"),
    "all_sources": mark("all sources"),
}


def party_records(evaluations: Mapping[str, Evaluation]) -> list[dict[str, str]]:
    """Who may detect, in the order of the bits of :func:`run_record`.

    Each has a name and a kind: "vut", "unit", "rsu_all" (the subject's) or "other". Of
    other layouts than the subject, the first one, only all units together count.
    """
    subject, *_ = evaluations.values()
    labels = unit_labels(subject.layout)
    kinds = {**dict.fromkeys(subject.units, "unit"), "vut": "vut", "rsu_all": "rsu_all"}
    return [
        *(
            {
                "name": labels.get(key) or tr(_PARTIES[key]),
                "kind": kinds.get(key, "other"),
            }
            for key in parties(subject)
        ),
        *(
            {
                "name": tr("{layout}: all RSUs", layout=layout_words(name)),
                "kind": "other",
            }
            for name in [*evaluations][1:]
        ),
    ]


def run_record(
    run: Run, index: int, evaluations: Mapping[str, Evaluation]
) -> dict[str, Any]:
    """A run with what every party detects.

    `index` is its place among those evaluated.

    Times in milliseconds (None: never), positions in centimetres, headings in tenths of
    a degree. "bits": see :func:`pack_bits`, a row per party.
    """
    subject, *others = evaluations.values()
    verdicts = [*parties(subject).values(), *(other.rsu_all for other in others)]
    frames = subject.axis.frames_of(index)
    vut = run.encounter.vut
    vru = run.encounter.vru
    motion = run.encounter.vut_motion
    # No braking helps.
    last_place: list[int] | None = None
    if np.isfinite(run.last_brake_time_s):
        (place,) = motion.path.at(motion.distance_m([run.last_brake_time_s]))[0]
        last_place = centimetres(place)
    return {
        "id": run.id,
        "title": describe_run(subject.axis, index),
        "case": tr(run.case.title),
        "user": run.case.vru.class_name,
        "time": _milliseconds(run.time_s),
        "last": _milliseconds(run.last_brake_time_s),
        "lastPlace": last_place,
        "car": _motion(run.vut_position_m, run.vut_yaw_deg),
        "road": _motion(run.vru_position_m, run.vru_yaw_deg),
        "carSize": centimetres([vut.length_m, vut.width_m]),
        "roadSize": centimetres([vru.length_m, vru.width_m]),
        "parked": [
            {"name": body.actor.name, "corners": centimetres(body.footprint_m)}
            for body in run.obstruction
        ],
        "bits": pack_bits(np.array([verdict.detected[frames] for verdict in verdicts])),
        "confirmed": [
            _milliseconds(verdict.confirmation_time_s[index]) for verdict in verdicts
        ],
        "onset": [_milliseconds(verdict.onset_time_s[index]) for verdict in verdicts],
        "avoided": [bool(verdict.is_avoided[index]) for verdict in verdicts],
    }


def _motion(position_m: FloatArray, yaw_deg: FloatArray) -> dict[str, list[int]]:
    return {
        "x": centimetres(position_m[:, 0]),
        "y": centimetres(position_m[:, 1]),
        "yaw": np.rint(10.0 * yaw_deg).astype(int).tolist(),
    }


def centimetres(values_m: ArrayLike) -> Any:
    """Metres as lists of whole centimetres."""
    return np.rint(100.0 * np.asarray(values_m)).astype(int).tolist()


def _milliseconds(values_s: ArrayLike) -> Any:
    """Whole milliseconds.

    None in place of an infinity (of single values only).
    """
    values = np.asarray(values_s, dtype=np.float64)
    if values.ndim == 0 and not np.isfinite(values):
        return None
    return np.rint(1000.0 * values).astype(int).tolist()


def unit_records(layout: Layout, scene: Scene) -> list[dict[str, Any]]:
    """Units of a layout for the player: centimetres, tenths of a degree."""
    labels = unit_labels(layout)

    def title(unit: CandidatePose) -> str:
        if labels[unit.id] == unit.id:
            name = unit.id
        else:
            name = f"{labels[unit.id]}, {unit.id}"
        kinds = {"camera": mark("camera"), "lidar": mark("lidar")}
        values = {
            "name": name,
            "kind": tr(kinds[sensor_kind(unit.sensor)]),
            "sensor": unit.sensor.name,
            "height": float(unit.pose.position_m[2]),
        }
        if is_ring(unit.sensor):
            return tr(
                "{name}: {kind} {sensor}, {height:.1f} m high, scans all round",
                **values,
            )
        return tr("{name}: {kind} {sensor}, {height:.1f} m high", **values)

    return [
        {
            "name": labels[unit.id],
            "title": title(unit),
            "kind": "ring" if is_ring(unit.sensor) else sensor_kind(unit.sensor),
            "place": centimetres(unit.pose.position_m[:2]),
            "yaw": round(10.0 * unit.pose.yaw_deg),
            "colour": UNIT_COLOURS[index % len(UNIT_COLOURS)],
            "dash": DASHES[index % len(DASHES)],
        }
        for index, unit in enumerate(above_ground(unit, scene) for unit in layout.units)
    ]


def plan_record(scene: Scene) -> dict[str, Any]:
    """The still part of a plan.

    "middle" and "half" of a window that holds the junction, "classes" (name, colour,
    path), "sites", "crosswalks", "arms" (name, place). Centimetres.
    """
    import shapely

    middle = 0.5 * (scene.outline_m.min(axis=0) + scene.outline_m.max(axis=0))
    window = shapely.box(*(middle - _MAX_HALF_M), *(middle + _MAX_HALF_M))
    reach = np.abs(scene.outline_m - middle).max() + 8.0
    half = float(np.clip(reach, _LEAST_HALF_M, 0.5 * _MAX_HALF_M))
    layers: list[tuple[str, str, Any]] = [
        ("parking lane", "#ececec", _areas(scene.lanes, "parking")),
        ("bus lane", "#e6d3c8", _areas(scene.lanes, "bus")),
        ("lane", "#dedede", _areas(scene.lanes, "driving")),
        ("junction", "#dedede", paved_area(scene.outline_m, scene.islands_m)),
    ]
    for name, style in CLASS_STYLES.items():
        numbers = [
            i for i, thing in enumerate(scene.instances) if thing.class_name == name
        ]
        parts = [thing_footprint(scene, number) for number in numbers]
        layers.append((name, str(style["facecolor"]), shapely.union_all(parts)))
    paths = [
        {"name": name, "colour": colour, "path": svg_path(shape.intersection(window))}
        for name, colour, shape in layers
    ]
    arms = []
    for arm in build_junction(scene).arms.values():
        mouths = [lane.centreline_m[-1] for lane in arm.lanes_in]
        mouths += [lane.centreline_m[0] for lane in arm.lanes_out]
        outward = np.mean(mouths, axis=0) - middle
        outward /= max(float(np.hypot(*outward)), 1.0e-9)
        place = middle + _LABEL_SHARE * half * outward
        arms.append({"name": tr(arm.name), "place": centimetres(place)})
    return {
        "middle": centimetres(middle),
        "half": round(100.0 * half),
        "classes": [path for path in paths if path["path"]],
        "sites": [centimetres(site.position_m[:2]) for site in scene.sites],
        "crosswalks": centimetres(scene.crosswalks_m),
        "arms": arms,
    }


def _areas(lanes: Iterable[Lane], kind: str) -> Any:
    import shapely

    # Not put together: the white lines between lanes stay.
    return shapely.geometrycollections(
        [
            shapely.LineString(lane.centreline_m).buffer(
                0.5 * lane.width_m, cap_style="flat"
            )
            for lane in lanes
            if lane.kind == kind
        ]
    )


def svg_path(shape: Any) -> str:
    """All polygons of a shapely shape as an SVG path of closed rings.

    The shape is in metres, the path in centimetres.
    """
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
        "M"
        + "L".join(f"{x} {y}" for x, y in centimetres(np.asarray(ring.coords)[:-1]))
        + "Z"
        for ring in rings
        if len(ring.coords) > 3
    )
