"""Road users who move otherwise than a case says: faster or slower, from a start that is nearer."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray, freeze
from scenarios.aeb import AebRule, last_brake_time_s
from scenarios.encounters import Encounter, first_contact_s
from scenarios.paths import MPS_PER_KMH, Motion, Path, travel_time_s
from scenarios.runs import Run

from .uncertainty import RoadUsers

_MAX_EARLY_S = 0.3  # of a contact before the impact: more is another impact, somewhere else


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathFrom:
    """A path that begins farther on."""

    path: Path
    ahead_m: float  # by so much

    @property
    def max_turn_rad_per_m(self) -> float:
        """As of the whole path, in rad/m."""
        return self.path.max_turn_rad_per_m

    @property
    def max_turn_change_rad_per_m2(self) -> float:
        """As of the whole path, in rad/m^2."""
        return self.path.max_turn_change_rad_per_m2

    def at(self, distance_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """See :meth:`scenarios.paths.Path.at`."""
        return self.path.at(np.asarray(distance_m, dtype=np.float64) + self.ahead_m)


def draw_road_users(
    runs: Sequence[Run],
    users: RoadUsers,
    rule: AebRule,
    rng: Callable[..., np.random.Generator],
) -> tuple[tuple[Run, ...], int]:
    """Runs of one sampled world, and how many road users move as planned because they must.

    `rng` gives each encounter its generator: a run is the same in all weathers, and does not depend
    on the other runs. Speed and start are drawn evenly within their limits. Where the drawn motion
    leads to no impact at the planned place - whom the VUT follows is as fast as it - the planned
    one stays.
    """
    changed: dict[int, Run | None] = {}
    drawn, n_kept = [], 0
    for run in runs:
        key = id(run.encounter)  # one and the same in all weathers
        if key not in changed:
            place = (run.case.name, run.approach, run.position, run.vut_speed_kmh)
            low_kmh, high_kmh = users.speed_kmh(run.encounter.vru.class_name)
            random = rng("road user", *place)
            faster_kmh = random.uniform(low_kmh, high_kmh)
            changed[key] = change_motion(
                run,
                rule,
                speed_mps=run.encounter.vru_motion.speed_mps + faster_kmh * MPS_PER_KMH,
                nearer_share=random.uniform(0.0, users.start_nearer_share),
            )
        other = changed[key]
        n_kept += other is None
        drawn.append(run if other is None else _like(run, other))
    return tuple(drawn), n_kept


def change_motion(
    run: Run, rule: AebRule, *, speed_mps: float, nearer_share: float = 0.0
) -> Run | None:
    """A run whose road user is faster or slower, and starts nearer to the impact.

    It keeps its way, and the VUT its own; both are at the impact as planned. Frames are those of
    the planned run; who is slower is already on its way in the first one. The last brake time is
    computed anew. None: the bodies do not touch, or long before, somewhere else.

    Parameters
    ----------
    run : Run
        As planned.
    rule : AebRule
        How the VUT brakes.
    speed_mps : float
        Of the road user, once it is reached. [m/s]
    nearer_share : float
        By which its way from rest to the impact is shorter. 0 .. 1
    """
    if speed_mps <= 0.0:
        return None
    encounter, vru = run.encounter, run.encounter.vru_motion
    whole_m = float(vru.distance_m(0.0))
    ahead_m = nearer_share * whole_m
    travel_s = travel_time_s(
        whole_m - ahead_m,
        speed_mps=speed_mps,
        acceleration_distance_m=vru.acceleration_distance_m,
    )
    motion = Motion(
        path=PathFrom(path=vru.path, ahead_m=ahead_m) if ahead_m else vru.path,
        speed_mps=speed_mps,
        start_time_s=-travel_s,
        acceleration_distance_m=vru.acceleration_distance_m,
    )
    changed = replace(encounter, vru_motion=motion)
    early_s = first_contact_s(changed)
    if abs(early_s) > _MAX_EARLY_S:
        return None
    changed = replace(
        changed,
        vut_motion=_later(changed.vut_motion, -early_s),
        vru_motion=_later(changed.vru_motion, -early_s),
    )
    last_s = last_brake_time_s(changed, rule)
    return replace(run, **_moved(changed, run.time_s), last_brake_time_s=last_s)


def _later(motion: Motion, seconds: float) -> Motion:
    return replace(motion, start_time_s=motion.start_time_s + seconds)


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
