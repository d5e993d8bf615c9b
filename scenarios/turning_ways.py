"""Ways of the VUT into another arm: the protocol's curve, or along the lanes of the map."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geometry.actors import Actor
from geometry.errors import InputError
from geometry.junction import Line, lane_length_m
from geometry.scene import Lane

from .courses import Course, follow_connection, follow_lane, join_by_turn
from .paths import Path, TowedPath, TurnPath
from .staging import CannotCarryError
from .turns import Turn
from .ways import CurvedWay, StraightWay, Way, check_straight, straight_line


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turning:
    """A VUT's way into another arm."""

    entry_lane: Lane
    entry: Line  # where the turn begins
    exit_way: Way
    turn_m: float  # its length
    path_with: Callable[[float], Path]  # some metres before it
    is_straight: bool  # but for the turn
    bend_per_m: float  # largest curvature of the turn


_AFTER_TURN_M = 10.0  # by then the VUT has met the VRU


def on_straights(entry_lane: Lane, exit_lane: Lane, turn: Turn, vut: Actor) -> Turning:
    """The protocol's curve between the straight lines of two lanes."""
    entry = straight_line(entry_lane, is_in=True)
    exit_line = straight_line(exit_lane, is_in=False)
    angle_deg = abs((exit_line.yaw_deg - entry.yaw_deg + 180.0) % 360.0 - 180.0)
    try:
        turn = turn.turned_by(angle_deg)
        corner = entry.crossing_with(exit_line)
    except (InputError, np.linalg.LinAlgError):
        raise CannotCarryError(f"the arms meet at {angle_deg:.0f} degrees") from None
    before_corner_m = float(entry.coordinates(corner)[0]) - turn.tangent_m
    after_corner_m = float(exit_line.coordinates(corner)[0]) + turn.tangent_m
    _check_within(entry_lane, -before_corner_m, "begin")
    _check_within(exit_lane, after_corner_m, "end")
    exit_way = StraightWay(line=exit_line)
    check_straight(exit_way, exit_lane, after_corner_m + _AFTER_TURN_M, is_in=False)

    def path_with(straight_m: float) -> TurnPath:
        return TurnPath(
            start_m=entry.at(before_corner_m - straight_m),
            yaw_deg=entry.yaw_deg,
            straight_m=straight_m,
            turn=turn,
            wheelbase_m=vut.wheelbase_m,
            front_axle_ahead_m=vut.front_axle_ahead_m,
        )

    return Turning(
        entry_lane=entry_lane,
        entry=entry,
        exit_way=exit_way,
        turn_m=turn.length_m,
        path_with=path_with,
        is_straight=True,
        bend_per_m=1.0 / turn.radius_m,
    )


def on_lanes(entry_lane: Lane, exit_lane: Lane, turn: Turn, vut: Actor) -> Turning:
    """The protocol's curve between two lanes that bend."""
    entry = follow_lane(entry_lane.centreline_m, is_in=True)
    exit_course = follow_lane(exit_lane.centreline_m, is_in=False)
    try:
        course, turn = join_by_turn(entry, exit_course, turn)
    except (InputError, np.linalg.LinAlgError):
        raise CannotCarryError(
            f"no turn of {turn.radius_m:g} m leads from lane {entry_lane.id} into {exit_lane.id}"
        ) from None
    _check_within(entry_lane, -entry.station_of(course.tangent(0.0).point_m), "begin")
    end = course.tangent(turn.length_m)
    _check_within(exit_lane, exit_course.station_of(end.point_m), "end")
    return _towed(entry_lane, exit_course, course, turn.length_m, vut)


def along_connection(entry_lane: Lane, connection: Lane, exit_lane: Lane, vut: Actor) -> Turning:
    """Along the junction's own lane between two others."""
    course = follow_connection(
        entry_lane.centreline_m,
        connection.centreline_m,
        exit_lane.centreline_m,
        is_origin_behind=False,
    )
    exit_course = follow_lane(exit_lane.centreline_m, is_in=False)
    return _towed(entry_lane, exit_course, course, lane_length_m(connection), vut)


def _towed(
    entry_lane: Lane, exit_course: Course, course: Course, turn_m: float, vut: Actor
) -> Turning:
    def path_with(straight_m: float) -> TowedPath:
        return TowedPath(
            course=course,
            start_m=-straight_m,
            wheelbase_m=vut.wheelbase_m,
            front_axle_ahead_m=vut.front_axle_ahead_m,
        )

    return Turning(
        entry_lane=entry_lane,
        entry=course.tangent(0.0),
        exit_way=CurvedWay(course=exit_course),
        turn_m=turn_m,
        path_with=path_with,
        is_straight=False,
        bend_per_m=course.between(0.0, turn_m).max_bend_per_m,
    )


def _check_within(lane: Lane, in_lane_m: float, what: str) -> None:
    if in_lane_m > lane_length_m(lane):
        raise CannotCarryError(f"the turn would {what} beyond the mapped lane {lane.id}")
