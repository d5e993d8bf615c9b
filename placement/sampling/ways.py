"""What VUT and VRU sweep over, and what stands in their way."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.actors import Actor, PlacedActor
from geometry.arrays import BoolArray, FloatArray
from geometry.footprints import footprint_corners, footprint_separation
from scenarios.aeb import AebRule, braking_distance_m
from scenarios.braking import standstill_time_s
from scenarios.paths import Motion
from scenarios.runs import Run

_STEP_M = 0.25  # along a way, from one footprint to the next
_TOGETHER_M = 1.0e-3  # bodies nearer than this stand in one another

GroupKey = tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ways:
    """What the runs of one case from one approach sweep over, at any speed.

    Attributes
    ----------
    corners_m : (n, 4, 2) float
        Footprints of VUT and VRU, close to one another along their ways. World frame. [m]
    reach_m : (n,) float
        Nothing of a body between two footprints is farther than this from the nearer one. [m]
    parked_m : (m, 4, 2) float
        Footprints of the case's own obstructions. [m]
    """

    corners_m: FloatArray
    reach_m: FloatArray
    parked_m: FloatArray

    def blocks(self, corners_m: FloatArray, *, clearance_m: float) -> bool:
        """Whether a footprint, (4, 2), is nearer than this to a way, or in an obstruction."""
        apart_m = footprint_separation(self.corners_m, corners_m)
        if (apart_m <= clearance_m + self.reach_m).any():
            return True
        return bool((footprint_separation(self.parked_m, corners_m) <= _TOGETHER_M).any())


def group_key(run: Run) -> GroupKey:
    """Runs of one group have the same ways but for the speed."""
    return run.case.name, run.approach


def build_ways(runs: Sequence[Run], rule: AebRule) -> dict[GroupKey, Ways]:
    """Ways of runs by group.

    Parameters
    ----------
    runs : sequence of Run
        What is driven.
    rule : AebRule
        The VUT may brake as late as at the impact: its way ends where it then stands, and the
        VRU's where it then is.

    Returns
    -------
    ways : dict
        By :func:`group_key`.
    """
    groups: dict[GroupKey, list[Run]] = {}
    for run in runs:
        groups.setdefault(group_key(run), []).append(run)
    return {key: _build(members, rule) for key, members in groups.items()}


def footprint_of(placed: PlacedActor) -> FloatArray:
    """Corners of a body that stands somewhere, (4, 2), in metres."""
    return footprint_corners(
        placed.pose.position_m[:2],
        placed.pose.yaw_deg,
        length_m=placed.actor.length_m,
        width_m=placed.actor.width_m,
    )


def touches_any(corners_m: FloatArray, others_m: Sequence[FloatArray]) -> bool:
    """Whether a footprint touches one of others."""
    if not others_m:
        return False
    separation: BoolArray = footprint_separation(np.stack(others_m), corners_m) <= _TOGETHER_M
    return bool(separation.any())


def _build(runs: Sequence[Run], rule: AebRule) -> Ways:
    swept, reach = [], []
    # In all weathers the encounter is one and the same.
    for encounter in {id(run.encounter): run.encounter for run in runs}.values():
        speed_mps = encounter.vut_motion.speed_mps
        standstill_s = float(standstill_time_s(speed_mps, rule=rule))
        braking_m = float(braking_distance_m(standstill_s, speed_mps=speed_mps, rule=rule))
        vut_end_m = float(encounter.vut_motion.distance_m(0.0)) + braking_m
        vru_end_m = float(encounter.vru_motion.distance_m(standstill_s))
        for body, motion, end_m, turns in (
            (encounter.vut, encounter.vut_motion, vut_end_m, encounter.vut_reach),
            (encounter.vru, encounter.vru_motion, vru_end_m, encounter.vru_reach),
        ):
            corners = _sweep(body, motion, end_m)
            swept.append(corners)
            reach.append(np.full(len(corners), 0.5 * _STEP_M * turns))
    parked = {placed.key: placed for run in runs for placed in run.obstruction}
    return Ways(
        corners_m=np.concatenate(swept),
        reach_m=np.concatenate(reach),
        parked_m=np.array([footprint_of(placed) for placed in parked.values()]).reshape(-1, 4, 2),
    )


def _sweep(body: Actor, motion: Motion, end_m: float) -> FloatArray:
    distances = np.linspace(0.0, end_m, int(end_m / _STEP_M) + 2)
    position, yaw_deg = motion.path.at(distances)
    return footprint_corners(position, yaw_deg, length_m=body.length_m, width_m=body.width_m)
