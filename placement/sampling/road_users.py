"""Road users who move otherwise than a case says: faster, from a nearer start, another way."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from geometry.arrays import FloatArray, freeze
from geometry.scene import Scene
from scenarios.aeb import AebRule, last_brake_time_s
from scenarios.encounters import Encounter, first_contact_s
from scenarios.obstructions import is_way_free
from scenarios.paths import MPS_PER_KMH, Motion, MovedPath, rotated, travel_time_s
from scenarios.runs import Run

from .uncertainty import RoadUsers

_MAX_EARLY_S = 0.3  # of a contact before the impact: more is another impact, somewhere else


def draw_road_users(
    runs: Sequence[Run],
    users: RoadUsers,
    rule: AebRule,
    rng: Callable[..., np.random.Generator],
    scene: Scene,
) -> tuple[tuple[Run, ...], int]:
    """Runs of one sampled world, and how many road users move as planned because they must.

    `rng` gives each encounter its generator: a run is the same in all weathers, and does not depend
    on others. Speed, start, heading and way are drawn evenly within their limits, measured speeds
    and starts as often as measured. The planned way stays where something stands in the other one,
    the planned motion where the drawn one leads to no impact at the planned place.
    """
    changed: dict[int, Run | None] = {}
    drawn, n_kept = [], 0
    for run in runs:
        key = id(run.encounter)  # one and the same in all weathers
        if key not in changed:
            place = (run.case.name, run.approach, run.position, run.vut_speed_kmh)
            both = (run.case.vru_speed_kmh,) if run.case.pairs_kmh else ()
            changed[key] = _draw_one(run, users, rule, rng("road user", *place, *both), scene)
        other = changed[key]
        n_kept += other is None
        drawn.append(run if other is None else _like(run, other))
    return tuple(drawn), n_kept


def _draw_one(
    run: Run, users: RoadUsers, rule: AebRule, random: np.random.Generator, scene: Scene
) -> Run | None:
    encounter = run.encounter
    planned_mps = encounter.vru_motion.speed_mps
    faster_mps = random.uniform(*users.speed_kmh(encounter.vru.class_name)) * MPS_PER_KMH
    nearer_share = random.uniform(0.0, users.start_nearer_share)
    turn_deg = random.uniform(*users.heading_deg.get(run.case.family, (0.0, 0.0)))
    aside_m = random.uniform(*users.path_m.get(run.case.family, (0.0, 0.0)))
    is_steady = planned_mps > 0.0 and np.isinf(encounter.vru_motion.brake_time_s)
    start_mps2 = None
    if is_steady:
        speed_mps = planned_mps + faster_mps
        measured = users.measured.get(encounter.vru.class_name)
        if measured is not None and run.case.recorded is None:
            speed_kmh, start_mps2 = measured.draw(random, planned_mps / MPS_PER_KMH)
            speed_mps = speed_kmh * MPS_PER_KMH + faster_mps
    else:  # who stands or brakes does what the case is about
        speed_mps, nearer_share = planned_mps, 0.0
    if turn_deg or aside_m:
        other = change_motion(
            run,
            rule,
            speed_mps=speed_mps,
            nearer_share=nearer_share,
            turn_deg=_sense(run) * turn_deg,
            aside_m=aside_m,
            start_mps2=start_mps2,
        )
        if other is not None:
            motion = other.encounter.vru_motion
            if is_way_free(encounter.vru, motion, scene, run.obstruction):
                return other
    return change_motion(
        run, rule, speed_mps=speed_mps, nearer_share=nearer_share, start_mps2=start_mps2
    )


def _sense(run: Run) -> float:
    """Of a turn: 1 = counter-clockwise; -1 where traffic keeps left, all else being mirrored."""
    if run.case.kind != "crossing":
        return 1.0
    _, north = rotated([1.0, 0.0], float(run.vru_yaw_deg[-1] - run.vut_yaw_deg[-1]))
    return 1.0 if (north > 0.0) == (run.case.vru_side == "near") else -1.0


def change_motion(
    run: Run,
    rule: AebRule,
    *,
    speed_mps: float,
    nearer_share: float = 0.0,
    turn_deg: float = 0.0,
    aside_m: float = 0.0,
    start_mps2: float | None = None,
) -> Run | None:
    """A run whose road user is faster or slower, starts nearer to the impact, or comes otherwise.

    Its way from rest to the impact is shorter by `nearer_share`, turned about the impact by
    `turn_deg`, counter-clockwise, then `aside_m` farther to its left. With `start_mps2` it sets off
    so, else over the planned distance. The VUT keeps its way; both are at the impact as planned.
    Frames are those of the planned run; the last brake time is computed anew. None: the bodies do
    not touch, or long before, somewhere else.
    """
    encounter, vru = run.encounter, run.encounter.vru_motion
    if speed_mps < 0.0 or (speed_mps == 0.0 and vru.speed_mps > 0.0):
        return None
    motion, gains_m = vru, vru.acceleration_distance_m
    if start_mps2 is not None and gains_m > 0.0:
        gains_m = 0.5 * speed_mps**2 / start_mps2
    if speed_mps != vru.speed_mps or nearer_share or gains_m != vru.acceleration_distance_m:
        whole_m = float(vru.distance_m(0.0))
        ahead_m = nearer_share * whole_m
        travel_s = travel_time_s(
            whole_m - ahead_m,
            speed_mps=speed_mps,
            acceleration_distance_m=gains_m,
        )
        motion = Motion(
            path=MovedPath(path=vru.path, ahead_m=ahead_m) if ahead_m else vru.path,
            speed_mps=speed_mps,
            start_time_s=-travel_s,
            acceleration_distance_m=gains_m,
        )
    if turn_deg or aside_m:
        there_m, yaw_deg = vru.path.at(vru.distance_m(0.0))
        shift_m = there_m - rotated(there_m, turn_deg)
        shift_m = shift_m + rotated([0.0, aside_m], float(yaw_deg) + turn_deg)
        east_m, north_m = shift_m.tolist()
        path = MovedPath(path=motion.path, turn_deg=turn_deg, shift_m=(east_m, north_m))
        motion = replace(motion, path=path)
    changed = replace(encounter, vru_motion=motion)
    early_s = first_contact_s(changed)
    if not abs(early_s) <= _MAX_EARLY_S:
        return None
    changed = replace(
        changed,
        vut_motion=_later(changed.vut_motion, -early_s),
        vru_motion=_later(changed.vru_motion, -early_s),
    )
    last_s = last_brake_time_s(changed, rule)
    return replace(run, **_moved(changed, run.time_s), last_brake_time_s=last_s)


def _later(motion: Motion, seconds: float) -> Motion:
    return replace(
        motion,
        start_time_s=motion.start_time_s + seconds,
        brake_time_s=motion.brake_time_s + seconds,
    )


def _moved(encounter: Encounter, time_s: FloatArray) -> dict[str, Any]:
    """Fields of a run that follow from its motions."""
    vut, vru = encounter.vut_motion, encounter.vru_motion
    vut_position, vut_yaw = vut.path.at(vut.distance_m(time_s))
    vru_distance = vru.distance_m(time_s)
    vru_position, vru_yaw = vru.path.at(vru_distance)
    return {
        "encounter": encounter,
        "vut_position_m": freeze(vut_position),
        "vut_yaw_deg": freeze(vut_yaw),
        "vru_position_m": freeze(vru_position),
        "vru_yaw_deg": freeze(vru_yaw),
        "vru_shape": freeze(encounter.vru.shape_index(vru_distance)),
    }


_MOVED = (
    *("encounter", "vut_position_m", "vut_yaw_deg", "vru_position_m", "vru_yaw_deg"),
    *("vru_shape", "last_brake_time_s"),
)


def _like(run: Run, other: Run) -> Run:
    """A run whose bodies move as in the same one in another weather."""
    return replace(run, **{name: getattr(other, name) for name in _MOVED})
