"""Twins of runs: the same encounters without a collision.

A car that brakes in a twin brakes for nothing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from geometry.actors import footprint_sizes
from geometry.arrays import FloatArray, freeze
from geometry.footprints import FootprintSizes, gaps_between

from .decision import DecisionRule
from .runs import Run

Kind = Literal["stops", "aside", "turns off"]
MAIN_KINDS: tuple[Kind, ...] = ("stops", "aside")
"""Twins that are nearest to the run itself; each run has one of them at most."""
# From one place of the car's way to the next, and how far behind the impact it ends.
_CAR_STEP_M = 0.5
_CAR_BEYOND_M = 25.0
# Of the road user's way: a first look, then a closer one.
_LOOK_M = 0.25
_CLOSER_M = 0.01
# Whoever walks aside is moved by so much at most.
_MOST_ASIDE_M = 6.0
_LEAST_ASIDE_M = 0.01
_TOLERANCE_M = 1.0e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Twin:
    """A run in which nobody comes near to the car's way.

    Attributes
    ----------
    run : Run
        As the one that it belongs to, but for the road user's places.
    of_run : int
        Number of that one.
    kind : {"stops", "aside", "turns off"}
        What the road user does.
    """

    run: Run
    of_run: int
    kind: Kind


def build_twins(runs: Sequence[Run], rule: DecisionRule) -> list[Twin]:
    """Twins of runs, up to two each.

    Whoever would cross the car's way "stops" before it, at the rule's clearance; in a
    second twin it "turns off" and moves as the car does, beside it. Whoever moves along
    the car's way moves "aside" of it, as far away. A twin is left out whose road user
    would already stand too near, would come too near, or would walk into what is
    parked.
    """
    twins = []
    for number, run in enumerate(runs):
        way = _CarWay(run)
        found: dict[Kind, Run | None] = {}
        stop_m = None
        if run.case.kind != "longitudinal":
            stop_m = _find_stop_m(run, way, rule.clearance_m)
        if stop_m is None:
            found["aside"] = _walking_aside(run, way, rule.clearance_m)
        else:
            found["stops"] = _stopping(run, stop_m, rule.stop_mps2)
            found["turns off"] = _turning_off(run, way, stop_m, rule.clearance_m)
        for kind, twin in found.items():
            if twin is not None:
                twins.append(Twin(run=twin, of_run=number, kind=kind))
    return twins


class _CarWay:
    """Where a run's car is, from its first frame to well behind the impact.

    Nobody brakes.
    """

    def __init__(self, run: Run) -> None:
        motion = run.encounter.vut_motion
        first_m = float(motion.distance_m(run.time_s[0]))
        last_m = float(motion.distance_m(0.0)) + _CAR_BEYOND_M
        n_places = math.ceil((last_m - first_m) / _CAR_STEP_M) + 1
        along_m = np.linspace(first_m, last_m, n_places)
        self.position_m, self.yaw_deg = motion.path.at(along_m)
        self._sizes = footprint_sizes(run.encounter.vut, run.encounter.vru)

    def gap_m(self, position_m: FloatArray, yaw_deg: FloatArray) -> FloatArray:
        """Least gap between the road user at places (n, 2) and the way, (n,)."""
        return _least_gap_m(
            self.position_m, self.yaw_deg, position_m, yaw_deg, self._sizes
        )


def _least_gap_m(
    one_m: FloatArray,
    one_yaw_deg: FloatArray,
    other_m: FloatArray,
    other_yaw_deg: FloatArray,
    sizes: FootprintSizes,
) -> FloatArray:
    """Least gap of bodies at places (n, 2) to another one at any of its, (n,)."""
    gaps = gaps_between(
        other_m[:, None] - one_m, one_yaw_deg, other_yaw_deg[:, None], sizes=sizes
    )
    least: FloatArray = gaps.max(axis=0).min(axis=1)
    return least


def _find_stop_m(run: Run, way: _CarWay, clearance_m: float) -> float | None:
    """How far the road user may go along its way; None: not a step."""
    motion = run.encounter.vru_motion
    last_m = float(motion.distance_m(0.0))
    first_m = float(motion.distance_m(run.time_s[0]))
    for step_m in (_LOOK_M, _CLOSER_M):
        along_m = np.arange(first_m, last_m + step_m, step_m)
        near = np.flatnonzero(way.gap_m(*motion.path.at(along_m)) < clearance_m)
        if len(near) == 0:
            return last_m
        if near[0] == 0:
            return None
        first_m = float(along_m[near[0] - 1])
        last_m = float(along_m[near[0]])
    return first_m


def _stopping(run: Run, stop_m: float, deceleration_mps2: float) -> Run:
    """The run whose road user slows down and stands from `stop_m` on.

    It moves as in the run until it has to slow down. Where it would have to be slower
    from the first frame on, it is.
    """
    motion = run.encounter.vru_motion
    time_s = run.time_s
    along_m = motion.distance_m(time_s)
    speed_mps = np.gradient(along_m, time_s)
    is_late = along_m + speed_mps**2 / (2.0 * deceleration_mps2) >= stop_m
    if is_late.any():
        first = int(is_late.argmax())
        # Distance left = deceleration / 2 * (time left)^2.
        left_m = max(stop_m - along_m[first], 0.0)
        left_s = math.sqrt(2.0 * left_m / deceleration_mps2)
        to_stop_s = np.maximum(left_s - (time_s[first:] - time_s[first]), 0.0)
        slowed_m = stop_m - 0.5 * deceleration_mps2 * to_stop_s**2
        along_m = np.concatenate([along_m[:first], slowed_m])
    position_m, yaw_deg = motion.path.at(along_m)
    return _with_road_user(run, position_m, yaw_deg, along_m)


def _turning_off(
    run: Run, way: _CarWay, stop_m: float, clearance_m: float
) -> Run | None:
    """The run whose road user goes along the car's way, beside where it would stop.

    It is there at the time of the impact, at its own speed. None: it would come too
    near, or walk into what is parked.
    """
    motion = run.encounter.vru_motion
    place_m, _ = motion.path.at(np.array([stop_m]))
    nearest = int(np.hypot(*(way.position_m - place_m).T).argmin())
    yaw_deg = float(way.yaw_deg[nearest])
    ahead, left = _ahead_and_left(yaw_deg)
    along_m = motion.distance_m(run.time_s)
    position_m = place_m + (along_m - along_m[-1])[:, None] * ahead
    side = math.copysign(1.0, float((place_m[0] - way.position_m[nearest]) @ left))
    yaw = np.full(len(position_m), yaw_deg)
    return _moved_aside(run, way, position_m, yaw, [side * left], clearance_m)


def _walking_aside(run: Run, way: _CarWay, clearance_m: float) -> Run | None:
    """The run whose road user moves as it does, but so far aside; None: no room."""
    _, left = _ahead_and_left(float(run.vut_yaw_deg[-1]))
    offset_m = run.vru_position_m[-1] - run.vut_position_m[-1]
    # First to the side on which it is.
    side = math.copysign(1.0, float(offset_m @ left))
    sides = [side * left, -side * left]
    return _moved_aside(
        run, way, run.vru_position_m, run.vru_yaw_deg, sides, clearance_m
    )


def _ahead_and_left(yaw_deg: float) -> tuple[FloatArray, FloatArray]:
    yaw = math.radians(yaw_deg)
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    return ahead, np.array([-ahead[1], ahead[0]])


def _moved_aside(
    run: Run,
    way: _CarWay,
    position_m: FloatArray,
    yaw_deg: FloatArray,
    sides: Sequence[FloatArray],
    clearance_m: float,
) -> Run | None:
    """The run with its road user at places (n, 2), moved aside until they are clear.

    The first side that has room is taken.
    """
    for side in sides:
        aside_m = 0.0
        while aside_m <= _MOST_ASIDE_M:
            moved_m = position_m + aside_m * side
            missing_m = clearance_m - float(way.gap_m(moved_m, yaw_deg).min())
            if missing_m > _TOLERANCE_M:
                # A metre aside is a metre of clearance at most.
                aside_m += max(missing_m, _LEAST_ASIDE_M)
            elif _is_blocked(run, moved_m, yaw_deg):
                aside_m += _LOOK_M
            else:
                along_m = run.encounter.vru_motion.distance_m(run.time_s)
                return _with_road_user(run, moved_m, yaw_deg, along_m)
    return None


def _is_blocked(run: Run, position_m: FloatArray, yaw_deg: FloatArray) -> bool:
    """True if a road user at places (n, 2) would walk into what is parked."""
    for parked in run.obstruction:
        sizes = footprint_sizes(parked.actor, run.encounter.vru)
        there_m = parked.pose.position_m[None, :2]
        there_deg = np.array([parked.pose.yaw_deg])
        gap_m = _least_gap_m(there_m, there_deg, position_m, yaw_deg, sizes)
        if gap_m.min() <= 0.0:
            return True
    return False


def _with_road_user(
    run: Run, position_m: FloatArray, yaw_deg: FloatArray, along_m: FloatArray
) -> Run:
    """A run with other places of its road user, and its gait."""
    return replace(
        run,
        vru_position_m=freeze(np.array(position_m)),
        vru_yaw_deg=freeze(np.array(yaw_deg)),
        vru_shape=freeze(run.encounter.vru.shape_index(along_m)),
    )
