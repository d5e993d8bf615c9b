"""The player: runs as its script reads them, in whole centimetres and milliseconds, packed bits."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray, IntArray
from geometry.catalogue import sensor_kind
from geometry.errors import InputError, Unquoted
from geometry.footprints import footprint_corners
from geometry.junction import build_junction
from geometry.scene import Lane, Scene, thing_footprint
from placement.candidates import CandidatePose, above_ground, is_ring
from placement.evaluation import Evaluation
from placement.layout import Layout
from placement.setting import Setting
from scenarios.runs import Run

from ..figures.axes import describe_run, unit_labels
from ..figures.plan import CLASS_STYLES
from ..figures.views import GroundViews
from ..results.tables import margin_s, parties
from .view_3d import (
    COLOURS,
    DASHES,
    describe_unit,
    lane_area,
    to_base64,
    to_script_json,
    view_part,
)

# ---------- which runs are worth watching


SHOWN_ABOVE = "shown above"
LEAST_TIME = "least time to spare"
NOT_AVOIDED = "not avoided"
ONE_PER_CASE = "one of each case"
ALL_OTHERS = "all others"


def choose_runs(
    evaluation: Evaluation, *, first_runs: Sequence[str] = (), max_runs: int = 24
) -> list[tuple[int, str]]:
    """Runs for the player, and why each is there.

    Pairs of the index of a run, and one of ``SHOWN_ABOVE``, ``LEAST_TIME``, ``NOT_AVOIDED`` and
    ``ONE_PER_CASE``, in this order. Each of the last three gets a third of what is left, or more
    where the others do not need theirs. `first_runs` are ids of runs that come first; unknown ones
    are left out. Raises InputError if `max_runs` is below 1.
    """
    if max_runs < 1:
        raise InputError("max_runs", max_runs, "at least 1")
    axis = evaluation.axis
    index_of = {run_id: index for index, run_id in enumerate(axis.run_ids)}
    chosen = {
        index_of[run_id]: SHOWN_ABOVE for run_id in dict.fromkeys(first_runs) if run_id in index_of
    }
    chosen = dict([*chosen.items()][:max_runs])
    margin = margin_s(evaluation.headline, axis)
    is_avoided = evaluation.headline.is_avoided
    order: IntArray = np.argsort(margin, kind="stable")
    order = order[np.argsort(axis.weight[order] <= 0.0, kind="stable")]  # without weight: last
    missed = _cases_in_turn(order[~is_avoided[order]][::-1], axis.cases)
    groups = {
        LEAST_TIME: [int(index) for index in order[is_avoided[order]]],
        NOT_AVOIDED: missed,
        ONE_PER_CASE: _first_of_each(order, [*zip(axis.cases, axis.weathers, strict=True)]),
    }
    share = -(-(max_runs - len(chosen)) // len(groups))
    for quota in (share, max_runs):
        for group, members in groups.items():
            free = [index for index in members if index not in chosen]
            taken = sum(name == group for name in chosen.values())
            for index in free[: min(quota - taken, max_runs - len(chosen))]:
                chosen[index] = group
    names = [SHOWN_ABOVE, *groups]
    return sorted(chosen.items(), key=lambda item: names.index(item[1]))


def _first_of_each(order: IntArray, kinds: Sequence[object]) -> list[int]:
    """The first run of each kind, kinds as they first appear among all runs."""
    first: dict[object, int] = {}
    for index in order:
        first.setdefault(kinds[index], int(index))
    return [first[kind] for kind in dict.fromkeys(kinds)]


def _cases_in_turn(order: IntArray, cases: Sequence[str]) -> list[int]:
    """Runs so that one of each case comes before the second of any."""
    seen: dict[str, int] = {}
    ranks = []
    for index in order:
        seen[cases[index]] = seen.get(cases[index], 0) + 1
        ranks.append(seen[cases[index]])
    return [int(index) for index in order[np.argsort(ranks, kind="stable")]]


# ---------- what the template needs


_MAX_BYTES = 1_500_000  # of records: some four hundred runs of a dozen units


def interactive_part(
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    max_runs: int = 24,
    first_runs: Sequence[str] = (),
) -> dict[str, Any] | None:
    """Values for ``templates/interactive.html.j2``.

    The first evaluation is the subject. Of the others, all units together are a row of the heatmap,
    and sensors are in the 3-D view. At most `max_runs` runs stand out in the list; all others
    follow as long as they fit.

    "n_runs", "player_json", "view_json", "note" (what the 3-D view leaves out), "plotly_gzip"
    (empty where the package plotly is missing: no 3-D view). None if no run has the frames that
    were evaluated. Raises InputError if there is no evaluation, or `max_runs` is not positive.
    """
    if not evaluations:
        raise InputError("evaluations", Unquoted("none"), "at least one")
    subject = next(iter(evaluations.values()))
    by_id = {run.id: run for run in setting.runs}
    chosen = choose_runs(subject, first_runs=first_runs, max_runs=max_runs)
    outstanding = {index for index, _ in chosen}
    others = [index for index in range(subject.axis.n_runs) if index not in outstanding]
    records: list[dict[str, Any]] = []
    n_bytes = 0
    for index, group in [*chosen, *((index, ALL_OTHERS) for index in others)]:
        run = by_id.get(subject.axis.run_ids[index])
        if run is None or not all(is_playable(run, item) for item in evaluations.values()):
            continue
        if group == ALL_OTHERS and n_bytes > _MAX_BYTES:
            break
        records.append(run_record(run, evaluations, group=group))
        n_bytes += len(to_script_json(records[-1]))
    if not records:
        return None
    units_m = np.array([unit.pose.position_m[:2] for unit in subject.layout.units])
    player = {
        "plan": plan_record(setting.scene, units_m),
        "units": [
            record | {"view": view}
            for record, view in zip(
                unit_records(subject.layout, setting.scene),
                view_paths(subject.layout.units, GroundViews(setting)),
                strict=True,
            )
        ],
        "parties": party_records(evaluations),
        "runs": records,
    }
    other_layouts = [item.layout for item in [*evaluations.values()][1:]]
    return {
        "n_runs": len(records),
        "n_all": subject.axis.n_runs,
        "player_json": to_script_json(player),
        **view_part(setting.scene, subject.layout, other_layouts),
    }


def pack_bits(bits: ArrayLike) -> str:
    """Rows of bits, each padded to whole bytes, the first bit highest, in base64.

    `bits` is (n_rows, n); the player's script gives it back.
    """
    return to_base64(np.packbits(np.asarray(bits, dtype=bool), axis=1))


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
    subject, *_ = evaluations.values()
    labels = unit_labels(subject.layout)
    kinds = {**dict.fromkeys(subject.units, "unit"), "vut": "vut", "rsu_all": "rsu_all"}
    return [
        *(
            {"name": labels.get(key, _PARTY_NAMES.get(key, key)), "kind": kinds.get(key, "other")}
            for key in parties(subject)
        ),
        *({"name": f"{name}: all RSUs", "kind": "other"} for name in [*evaluations][1:]),
    ]


def run_record(run: Run, evaluations: Mapping[str, Evaluation], *, group: str) -> dict[str, Any]:
    """A run with what every party detects.

    Times in milliseconds (None: never), positions in centimetres, headings in tenths of a degree.
    "bits": see :func:`pack_bits`, a row per party.
    """
    subject, *others = evaluations.values()
    axis = subject.axis
    index = axis.run_ids.index(run.id)
    judged = [(subject, verdict) for verdict in parties(subject).values()]
    judged += [(other, other.rsu_all) for other in others]
    rows = [(item, verdict, item.axis.run_ids.index(run.id)) for item, verdict in judged]
    detected = [verdict.detected[item.axis.frames_of(at)] for item, verdict, at in rows]
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
        "bits": pack_bits(np.array(detected)),
        "confirmed": [_milliseconds(one.confirmation_time_s[at]) for _, one, at in rows],
        "onset": [_milliseconds(one.onset_time_s[at]) for _, one, at in rows],
        "avoided": [bool(one.is_avoided[at]) for _, one, at in rows],
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
    """True if an evaluation has the run on the very frames on which it is driven."""
    axis = evaluation.axis
    if run.id not in axis.run_ids:
        return False
    times_s = axis.time_s[axis.frames_of(axis.run_ids.index(run.id))]
    return len(times_s) == len(run.time_s) and bool(np.allclose(times_s, run.time_s, atol=1.0e-6))


def _last_place(run: Run) -> list[int] | None:
    """Place of the car at the last moment to brake; None where no braking helps."""
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
