"""The ways of road users along a lane: straight on, or round its bends."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import InputError
from geometry.junction import Line, curve_between, lane_length_m, lane_line
from geometry.scene import Lane

from .courses import Course, follow_connection, follow_gently, follow_lane, follow_lanes
from .laying import load_way_rules
from .paths import CoursePath, Path, StraightPath, TowedPath
from .staging import CannotCarryError

STRAIGHT_M = 50.0  # of a lane next to the junction, which gives its direction
DO_NOT_MEET = "the VUT's way and the VRU's do not meet"
_MAX_STEPS = 60
_MEETS_M = 1.0e-3
_LEAST_FREE_M = 0.1  # in lanes that are narrower than the VUT, by the map
_CUT_OFF_M = 1.0  # between the lanes, of the curve that has their directions


class Way(Protocol):
    """A line that road users follow, through the junction and along the lane of an arm.

    Stations count along it from the lane's mouth, ahead in the way's direction.
    """

    def tangent(self, station_m: float) -> Line:
        """The straight line that touches it; its point is at the station."""
        ...

    def direction(self, station_m: float) -> Line:
        """As :meth:`tangent`; but its point may be any on it."""
        ...

    def crossing(self, line: Line) -> tuple[float, FloatArray]:
        """Station and point (2,) at which it crosses a straight line, nearest to the mouth.

        Raises
        ------
        CannotCarryError
            It does not.
        """
        ...

    def point(self, station_m: float, left_m: float) -> FloatArray:
        """The point some metres to the left of a station, (2,)."""
        ...

    def beside(
        self, left_m: float, station_m: float, *, back_m: float, ahead_m: float = np.inf
    ) -> "tuple[Way, float]":
        """The way some metres to the left of it, and where one of its stations lies on that way.

        It is needed so far back from the station and so far ahead; beyond it may go straight.
        """
        ...

    def vut_path(self, station_m: float, vut: Actor) -> Path:
        """A vehicle's path that begins with the middle of its footprint at a station."""
        ...

    def vru_path(self, station_m: float) -> Path:
        """Path of a pedestrian or cyclist that begins at a station."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StraightWay:
    """Along a straight line, whose point is the origin of stations."""

    line: Line

    def tangent(self, station_m: float) -> Line:
        """See :meth:`Way.tangent`."""
        return Line(point_m=self.line.at(station_m), direction=self.line.direction)

    def direction(self, station_m: float) -> Line:
        """See :meth:`Way.direction`."""
        return self.line

    def crossing(self, line: Line) -> tuple[float, FloatArray]:
        """See :meth:`Way.crossing`."""
        try:
            point = self.line.crossing_with(line)
        except np.linalg.LinAlgError:
            raise CannotCarryError(DO_NOT_MEET) from None
        return float(self.line.coordinates(point)[0]), point

    def point(self, station_m: float, left_m: float) -> FloatArray:
        """See :meth:`Way.point`."""
        return self.line.at(station_m, left_m)

    def beside(
        self, left_m: float, station_m: float, *, back_m: float, ahead_m: float = np.inf
    ) -> "tuple[Way, float]":
        """See :meth:`Way.beside`."""
        beside = Line(point_m=self.line.at(station_m, left_m), direction=self.line.direction)
        return StraightWay(line=beside), 0.0

    def vut_path(self, station_m: float, vut: Actor) -> Path:
        """See :meth:`Way.vut_path`."""
        return self.vru_path(station_m)

    def vru_path(self, station_m: float) -> Path:
        """See :meth:`Way.vru_path`."""
        return StraightPath(start_m=self.line.at(station_m), yaw_deg=self.line.yaw_deg)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurvedWay:
    """Along a course."""

    course: Course

    def tangent(self, station_m: float) -> Line:
        """See :meth:`Way.tangent`."""
        return self.course.tangent(station_m)

    def direction(self, station_m: float) -> Line:
        """See :meth:`Way.direction`."""
        return self.course.tangent(station_m)

    def crossing(self, line: Line) -> tuple[float, FloatArray]:
        """See :meth:`Way.crossing`."""
        stations = self.course.crossings_m(line)
        if not len(stations):
            raise CannotCarryError(DO_NOT_MEET)
        station = float(stations[np.argmin(np.abs(stations))])
        return station, self.course.at(station)[0]

    def point(self, station_m: float, left_m: float) -> FloatArray:
        """See :meth:`Way.point`."""
        return self.course.tangent(station_m).at(0.0, left_m)

    def beside(
        self, left_m: float, station_m: float, *, back_m: float, ahead_m: float = np.inf
    ) -> "tuple[Way, float]":
        """See :meth:`Way.beside`."""
        try:
            end_m = min(station_m + ahead_m, self.course.end_m)
            near = self.course.between(station_m - back_m, end_m)
            course = near.beside(left_m)
        except InputError:
            raise CannotCarryError(
                f"the lane bends too sharply for a way {abs(left_m):.1f} m beside it"
            ) from None
        return CurvedWay(course=course), course.station_of(self.point(station_m, left_m))

    def vut_path(self, station_m: float, vut: Actor) -> Path:
        """See :meth:`Way.vut_path`."""
        return TowedPath(
            course=self.course,
            start_m=station_m + vut.front_axle_ahead_m,
            wheelbase_m=vut.wheelbase_m,
            front_axle_ahead_m=vut.front_axle_ahead_m,
        )

    def vru_path(self, station_m: float) -> Path:
        """See :meth:`Way.vru_path`."""
        return CoursePath(course=self.course, start_m=station_m)


def straight_line(lane: Lane, *, is_in: bool) -> Line:
    """The straight line along the part of a lane next to the junction, through its mouth."""
    return lane_line(lane, is_in=is_in, length_m=STRAIGHT_M)[0]


def off_line_m(lane: Lane, *, is_in: bool, length_m: float) -> float:
    """How far a lane leaves its straight line, over a length from its mouth, in metres."""
    points = lane.centreline_m[::-1] if is_in else lane.centreline_m  # the mouth comes first
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    end_m = min(max(length_m, 0.0), float(along[-1]))
    end = np.array([np.interp(end_m, along, points[:, axis]) for axis in (0, 1)])
    near: FloatArray = np.concatenate([points[along <= end_m], end[None]])
    line = straight_line(lane, is_in=is_in)
    return float(np.abs(line.coordinates(near)[:, 1]).max())


def is_bent(lane: Lane, *, is_in: bool) -> bool:
    """Whether a lane leaves its straight line."""
    bend_m = off_line_m(lane, is_in=is_in, length_m=lane_length_m(lane))
    return bend_m > load_way_rules().max_lane_bend_m


def check_straight(way: Way, lane: Lane, driven_m: float, *, is_in: bool = True) -> None:
    """Raise if a straight way leaves its lane within some metres from the mouth."""
    bend_m = off_line_m(lane, is_in=is_in, length_m=driven_m)
    if isinstance(way, StraightWay) and bend_m > load_way_rules().max_lane_bend_m:
        raise CannotCarryError(f"lane {lane.id} is not straight: {bend_m:.1f} m off its line")


def free_aside_m(vut: Actor, *lanes: Lane) -> float:
    """How far the VUT's middle may leave that of its lanes to take a bend, in metres."""
    room_m = 0.5 * (min(lane.width_m for lane in lanes) - vut.width_m)
    return float(np.clip(room_m, _LEAST_FREE_M, load_way_rules().max_ease_aside_m))


def lane_way(lane: Lane, *, is_in: bool, length_m: float, max_bend_m: float) -> Way:
    """The way along a lane, in its driving direction: straight where the lane is, as far as asked.

    Straight means that it leaves its line by at most `max_bend_m` within `length_m` of its mouth.
    """
    if off_line_m(lane, is_in=is_in, length_m=length_m) <= max_bend_m:
        return StraightWay(line=straight_line(lane, is_in=is_in))
    return CurvedWay(course=follow_lane(lane.centreline_m, is_in=is_in))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WayAcross:
    """The way along a lane, through the junction, and along a lane by which it is left.

    Attributes
    ----------
    way : Way
        Its stations count from the mouth of the lane that leads out.
    entry, leaving : Lane
        The lanes.
    begin_m : float
        Station at which the first lane begins. [m]
    """

    way: Way
    entry: Lane
    leaving: Lane
    begin_m: float


def way_across(
    entry: Lane,
    leaving: Lane,
    connection: Lane | None,
    *,
    max_bend_m: float,
    free_m: float | None = None,
) -> WayAcross:
    """The way from a lane into the junction straight on into a lane out of it.

    Straight, where all its lanes stay within `max_bend_m` of the first one's line; else along the
    lanes' bends, and between them on the junction's own lane `connection`, or, where the map has
    none, on a cubic curve with the lanes' directions at its ends. With `free_m` it is the gentlest
    that leaves the lanes' middles by no more, and such a curve by no more than a metre.

    Raises
    ------
    CannotCarryError
        The lane out of the junction does not lie ahead.
    """
    chains = [entry.centreline_m, leaving.centreline_m]
    if connection is not None:
        chains.insert(1, connection.centreline_m)
    line = straight_line(entry, is_in=True)
    if np.abs(line.coordinates(np.concatenate(chains))[:, 1]).max() <= max_bend_m:
        mouth_m = float(line.coordinates(leaving.centreline_m[0])[0])
        way = StraightWay(line=Line(point_m=line.at(mouth_m), direction=line.direction))
        begin_m = -mouth_m - lane_length_m(entry)
        return WayAcross(way=way, entry=entry, leaving=leaving, begin_m=begin_m)
    between = _curve_between(entry, leaving) if connection is None else connection.centreline_m
    before, after = entry.centreline_m, leaving.centreline_m
    if free_m is not None:
        aside_m = _CUT_OFF_M if connection is None else free_m
        course = follow_gently([before, between, after], [free_m, aside_m, free_m], origin=2)
    elif connection is None:
        course = follow_lanes([np.concatenate([before, between]), after])
    else:
        course = follow_connection(before, between, after, is_origin_behind=True)
    across_m = float(np.hypot(*np.diff(between, axis=0).T).sum())
    return WayAcross(
        way=CurvedWay(course=course),
        entry=entry,
        leaving=leaving,
        begin_m=-across_m - lane_length_m(entry),
    )


def _curve_between(entry: Lane, leaving: Lane) -> FloatArray:
    """Points (n, 2) from the end of a lane to the begin of another one."""
    before = follow_lane(entry.centreline_m, is_in=True).tangent(0.0)
    after = follow_lane(leaving.centreline_m, is_in=False).tangent(0.0)
    try:
        return curve_between(
            replace(before, point_m=entry.centreline_m[-1]),
            replace(after, point_m=leaving.centreline_m[0]),
        )
    except ValueError:
        why = f"lane {leaving.id} does not lie ahead of lane {entry.id}"
        raise CannotCarryError(why) from None


def reversed_way(way: Way) -> Way:
    """The same way, driven the other way; the origin of stations stays."""
    if isinstance(way, CurvedWay):
        return CurvedWay(course=way.course.reversed())
    line = way.tangent(0.0)
    return StraightWay(line=Line(point_m=line.point_m, direction=-line.direction))


def meeting_m(one: Way, other: Way) -> tuple[float, float]:
    """Stations of two ways at which they cross nearest to their origins.

    Raises
    ------
    CannotCarryError
        They do not.
    """
    station = other_station = 0.0
    for _ in range(_MAX_STEPS):
        other_station, _ = other.crossing(one.tangent(station))
        new, _ = one.crossing(other.tangent(other_station))
        if abs(new - station) < _MEETS_M:
            return new, other_station
        station = new
    raise CannotCarryError(DO_NOT_MEET)
