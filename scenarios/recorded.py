"""Recorded encounters as they are replayed: two ways that were taken, at constant speeds."""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import dist, isfinite
from typing import Annotated

from msgspec import Meta

from geometry.actors import Actor
from geometry.errors import InputError, Unquoted

from .courses import follow_way
from .encounters import Encounter, first_contact_s
from .paths import CoursePath, Motion

_LONGEST_M = 1000.0
_MAX_EARLY_S = 0.3  # of a contact before the impact: more is another impact, somewhere else


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedWay:
    """A way as it was taken, and when."""

    # of the middle of the body; goes straight on before and after them. World frame. [m]
    points_m: Annotated[tuple[tuple[float, float], ...], Meta(min_length=2)]
    yaw_deg: float  # direction in which it goes straight on
    # when the body is at the last point; the impact is at 0. [s]
    end_s: Annotated[float, Meta(ge=-60.0, le=60.0)]

    def __post_init__(self) -> None:
        length_m = sum(dist(*ends) for ends in pairwise(self.points_m))
        if not 0.0 < length_m <= _LONGEST_M or not isfinite(self.yaw_deg):
            got = Unquoted(f"{length_m:g} m towards {self.yaw_deg:g} degrees")
            raise InputError("", got, f"a way of at most {_LONGEST_M:g} m with a direction")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedEncounter:
    """Two recorded ways that lead to an impact at time 0 if nobody reacts."""

    vut: RecordedWay
    vru: RecordedWay
    known_s: float  # both are recorded for so long before the impact

    def as_recorded(
        self, *, vut: Actor, vut_speed_mps: float, vru: Actor, vru_speed_mps: float
    ) -> Encounter:
        """The bodies on their ways at constant speeds, at the times that the ways say."""
        return Encounter(
            vut=vut,
            vut_motion=_motion(self.vut, vut_speed_mps, self.known_s),
            vru=vru,
            vru_motion=_motion(self.vru, vru_speed_mps, self.known_s),
        )

    def encounter(
        self, *, vut: Actor, vut_speed_mps: float, vru: Actor, vru_speed_mps: float
    ) -> Encounter | None:
        """The same with the impact at time 0; None: they do not touch about then."""
        found = self.as_recorded(
            vut=vut, vut_speed_mps=vut_speed_mps, vru=vru, vru_speed_mps=vru_speed_mps
        )
        early_s = first_contact_s(found)
        if not abs(early_s) <= _MAX_EARLY_S:
            return None
        vut_motion, vru_motion = (
            replace(motion, start_time_s=motion.start_time_s - early_s)
            for motion in (found.vut_motion, found.vru_motion)
        )
        return replace(found, vut_motion=vut_motion, vru_motion=vru_motion)


def _motion(way: RecordedWay, speed_mps: float, known_s: float) -> Motion:
    course = follow_way(way.points_m, way.yaw_deg)
    start_m = course.station_of(way.points_m[0]) if speed_mps > 0.0 else 0.0
    start_s = way.end_s + start_m / speed_mps if speed_mps > 0.0 else -known_s
    return Motion(
        path=CoursePath(course=course, start_m=start_m), speed_mps=speed_mps, start_time_s=start_s
    )
