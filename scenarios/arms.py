"""Which arm of a junction lies where for a VUT, and by which lanes it may drive there."""

from collections.abc import Iterator, Sequence

import numpy as np

from geometry.arrays import FloatArray
from geometry.junction import Arm, Junction, Line, lane_line
from geometry.scene import Lane, Turn

from .laying import load_way_rules
from .staging import NoRoadError
from .ways import straight_line

_LEADS = {"left": "to the left", "right": "to the right", "through": "straight on"}
_SAME_POINT_M = 0.5  # as geometry.junction joins lanes

Joint = tuple[Lane, Lane | None, Lane]  # into the junction, through it, out of it


def arm_at(junction: Junction, vut_line: Line, *, to_left: bool) -> Arm | None:
    """The arm to the left or right of the VUT; None if there is none.

    One about at a right angle, or else the one that is nearest to it.
    """
    side = vut_line.left if to_left else -vut_line.left
    rules = load_way_rules()
    for skew_deg, length_m in ((rules.max_skew_deg, 50.0), (rules.max_turn_skew_deg, 15.0)):
        best, best_cosine = None, np.cos(np.radians(skew_deg))
        for arm in junction.arms.values():
            cosine = float(_outwards(arm, length_m) @ side)
            if cosine >= best_cosine:
                best, best_cosine = arm, cosine
        if best is not None:
            return best
    return None


def arm_ahead(junction: Junction, approach: Arm, vut_line: Line) -> Arm | None:
    """The arm into which the VUT would drive straight on; None if there is none."""
    best, best_cosine = None, np.cos(np.radians(load_way_rules().max_skew_deg))
    for arm in junction.arms.values():
        cosine = float(_outwards(arm, 15.0) @ vut_line.direction)
        if arm is not approach and cosine >= best_cosine and _lies_ahead(arm, vut_line):
            best, best_cosine = arm, cosine
    return best


def _lies_ahead(arm: Arm, vut_line: Line) -> bool:
    """Whether one of an arm's lanes begins or ends no farther aside of a line than ahead."""
    mouths = [lane.centreline_m[-1] for lane in arm.lanes_in]
    mouths += [lane.centreline_m[0] for lane in arm.lanes_out]
    ahead_m, left_m = vut_line.coordinates(np.array(mouths)).T
    return bool((np.abs(left_m) <= ahead_m).any())


def _outwards(arm: Arm, length_m: float) -> FloatArray:
    """Direction in which an arm leads away from the junction, (2,)."""
    lanes, is_in = (arm.lanes_in, True) if arm.lanes_in else (arm.lanes_out, False)
    line, _ = lane_line(lanes[0], is_in=is_in, length_m=length_m)
    return -line.direction if is_in else line.direction


def straight_lane(junction: Junction, arm: Arm) -> Lane:
    """The lane at the kerb from which cars drive straight on; that at the kerb if none may."""
    ahead = arm_ahead(junction, arm, straight_line(arm.entry_lanes[0], is_in=True))
    if ahead is None or not ahead.exit_lanes:
        return arm.entry_lanes[0]
    try:
        return joints(junction, arm, ahead, "through")[0][0]
    except NoRoadError:
        return arm.entry_lanes[0]


def joints(junction: Junction, arm: Arm, target: Arm, movement: Turn) -> list[Joint]:
    """Lanes by which cars may drive from one arm into another, the usual ones first.

    From the kerb, to the left from the axis. Where the map has lanes through the junction, those
    that it joins. Else lanes that are marked for the movement, or without any those that bear no
    marking; straight on the exit lane that is most in line comes first.

    Raises
    ------
    NoRoadError
        No lane leads there, by the lanes through the junction or by the markings.
    """
    step = -1 if movement == "left" else 1
    before, after = arm.entry_lanes[::step], target.exit_lanes[::step]
    if _has_connections(junction):
        joined: list[Joint] = [
            (lane, connection, other)
            for lane in before
            for other in after
            if (connection := junction.connection(lane, other)) is not None
        ]
        if not joined:
            raise NoRoadError(f"by the map no lane leads from the {arm.name} to the {target.name}")
        return joined
    marked = [lane for lane in before if movement in lane.turns]
    free = marked or [lane for lane in before if not lane.turns]
    if not free:
        raise NoRoadError(f"by their markings no lane from the {arm.name} leads {_LEADS[movement]}")
    return [(lane, None, other) for lane in free for other in _in_order(lane, after, movement)]


def _in_order(lane: Lane, after: Sequence[Lane], movement: Turn) -> list[Lane]:
    if movement != "through":
        return list(after)
    line = straight_line(lane, is_in=True)
    return sorted(after, key=lambda other: abs(float(line.coordinates(other.centreline_m[0])[1])))


def _has_connections(junction: Junction) -> bool:
    """Whether the map has lanes through the junction itself, not only through others around it."""
    if not junction.connections:
        return False
    begins = np.array([lane.centreline_m[0] for lane in junction.connections])
    return any(
        bool((np.hypot(*(begins - tip).T) <= _SAME_POINT_M).any()) for tip in _entry_tips(junction)
    )


def _entry_tips(junction: Junction) -> Iterator[FloatArray]:
    for arm in junction.arms.values():
        for lane in arm.entry_lanes:
            yield lane.centreline_m[-1]
