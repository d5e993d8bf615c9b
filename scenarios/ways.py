"""Ways of road users along lanes and through the junction.

Ways are straight or bent, and lead into other arms.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import shapely

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import InputError
from geometry.junction import (
    Arm,
    Junction,
    Line,
    arm_mouth,
    curve_between,
    lane_length_m,
    lane_line,
)
from geometry.lines import along_m, length_m, points_at
from geometry.phrases import Phrase
from geometry.scene import Lane
from geometry.scene import Turn as Movement

from . import courses
from .paths import CoursePath, Path, StraightPath, TowedPath, TurnPath
from .staging import DO_NOT_MEET, CannotCarryError, NoRoadError, load_way_rules

# Of a lane next to the junction, which gives its direction.
STRAIGHT_M = 50.0
_MAX_STEPS = 60
_MEETS_M = 1.0e-3
# In lanes that are narrower than the VUT, by the map.
_LEAST_FREE_M = 0.1
# Of a way along a roundabout, before and behind it.
_EDGE_M = 40.0
# Between looks for where two ways cross.
_CROSSING_STEP_M = 0.25
# Between the lanes, of the curve that has their directions.
_CUT_OFF_M = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StraightWay:
    """Along a straight line, whose point is the origin of stations.

    Stations count along a way from the lane's mouth, ahead in the way's direction.
    """

    line: Line

    def tangent(self, station_m: float) -> Line:
        """The straight line that touches it; its point is at the station."""
        return Line(point_m=self.line.at(station_m), direction=self.line.direction)

    def direction(self, station_m: float) -> Line:
        """As :meth:`tangent`; but its point may be any on it."""
        return self.line

    def crossing(self, line: Line) -> tuple[float, FloatArray]:
        """Station and point (2,) where it crosses a line, nearest to the mouth.

        Raises
        ------
        CannotCarryError
            It does not cross the line.
        """
        try:
            point = self.line.crossing_with(line)
        except np.linalg.LinAlgError:
            raise CannotCarryError(DO_NOT_MEET) from None
        return float(self.line.coordinates(point)[0]), point

    def point(self, station_m: float, left_m: float) -> FloatArray:
        """The point some metres to the left of a station, (2,)."""
        return self.line.at(station_m, left_m)

    def station_of(self, point_m: FloatArray) -> float:
        """Station of its point that is nearest to a point (2,)."""
        return float(self.line.coordinates(point_m)[0])

    def offset(
        self, left_m: float, station_m: float, *, back_m: float, ahead_m: float = np.inf
    ) -> "tuple[Way, float]":
        """The way some metres to the left, and a station on that way.

        The station is where `station_m` of this way lies.

        It is needed so far back from the station and so far ahead; beyond it may go
        straight.
        """
        beside = Line(
            point_m=self.line.at(station_m, left_m), direction=self.line.direction
        )
        return StraightWay(line=beside), 0.0

    def vut_path(self, station_m: float, vut: Actor) -> Path:
        """A vehicle's path from a station on.

        It begins with the middle of the vehicle's footprint there.
        """
        return self.vru_path(station_m)

    def vru_path(self, station_m: float) -> Path:
        """Path of a pedestrian or cyclist that begins at a station."""
        return StraightPath(start_m=self.line.at(station_m), yaw_deg=self.line.yaw_deg)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurvedWay:
    """Along a course; its methods are those of :class:`StraightWay`."""

    course: courses.Course

    def tangent(self, station_m: float) -> Line:
        """See :meth:`StraightWay.tangent`."""
        return self.course.tangent(station_m)

    def direction(self, station_m: float) -> Line:
        """See :meth:`StraightWay.direction`."""
        return self.course.tangent(station_m)

    def crossing(self, line: Line) -> tuple[float, FloatArray]:
        """See :meth:`StraightWay.crossing`."""
        stations = self.course.crossings_m(line)
        if not len(stations):
            raise CannotCarryError(DO_NOT_MEET)
        station = float(stations[np.argmin(np.abs(stations))])
        return station, self.course.at(station)[0]

    def point(self, station_m: float, left_m: float) -> FloatArray:
        """See :meth:`StraightWay.point`."""
        return self.course.tangent(station_m).at(0.0, left_m)

    def station_of(self, point_m: FloatArray) -> float:
        """See :meth:`StraightWay.station_of`."""
        return self.course.station_of(point_m)

    def offset(
        self, left_m: float, station_m: float, *, back_m: float, ahead_m: float = np.inf
    ) -> "tuple[Way, float]":
        """See :meth:`StraightWay.offset`."""
        try:
            end_m = min(station_m + ahead_m, self.course.end_m)
            near = self.course.between(station_m - back_m, end_m)
            course = near.offset(left_m)
        except InputError:
            why = Phrase(
                "the lane curves too sharply for a path {distance:.1f} m beside it",
                distance=abs(left_m),
            )
            raise CannotCarryError(why) from None
        return CurvedWay(course=course), course.station_of(
            self.point(station_m, left_m)
        )

    def vut_path(self, station_m: float, vut: Actor) -> Path:
        """See :meth:`StraightWay.vut_path`."""
        return TowedPath(
            course=self.course,
            start_m=station_m + vut.front_axle_ahead_m,
            wheelbase_m=vut.wheelbase_m,
            front_axle_ahead_m=vut.front_axle_ahead_m,
        )

    def vru_path(self, station_m: float) -> Path:
        """See :meth:`StraightWay.vru_path`."""
        return CoursePath(course=self.course, start_m=station_m)


Way = StraightWay | CurvedWay


def straight_line(lane: Lane, *, is_in: bool) -> Line:
    """Straight line along a lane next to the junction, through its mouth."""
    return lane_line(lane, is_in=is_in, length_m=STRAIGHT_M)[0]


# Cached, since every run of an arm asks for the same lanes.
@lru_cache(maxsize=1024)
def off_line_m(lane: Lane, *, is_in: bool, length_m: float) -> float:
    """Most that a lane leaves its straight line, in metres.

    A length from the lane's mouth counts.
    """
    # the mouth comes first
    if is_in:
        points = lane.centreline_m[::-1]
    else:
        points = lane.centreline_m
    along = along_m(points)
    end_m = np.clip(length_m, 0.0, along[-1])[None]
    near = np.concatenate([points[along <= end_m], points_at(points, end_m)])
    line = straight_line(lane, is_in=is_in)
    return float(np.abs(line.coordinates(near)[:, 1]).max())


def is_bent(lane: Lane, *, is_in: bool) -> bool:
    """True if a lane leaves its straight line."""
    bend_m = off_line_m(lane, is_in=is_in, length_m=lane_length_m(lane))
    return bend_m > load_way_rules().max_lane_bend_m


def check_straight(
    way: Way, lane: Lane, driven_m: float, *, is_in: bool = True
) -> None:
    """Raise if a straight way leaves its lane within some metres from the mouth."""
    bend_m = off_line_m(lane, is_in=is_in, length_m=driven_m)
    if isinstance(way, StraightWay) and bend_m > load_way_rules().max_lane_bend_m:
        raise CannotCarryError(
            Phrase(
                "lane {lane} is not straight: {distance:.1f} m off its line",
                lane=lane.id,
                distance=bend_m,
            )
        )


def free_aside_m(vut: Actor, *lanes: Lane) -> float:
    """Distance that the VUT's middle may leave that of its lanes, in m.

    It does so to take a bend.
    """
    room_m = 0.5 * (min(lane.width_m for lane in lanes) - vut.width_m)
    return float(np.clip(room_m, _LEAST_FREE_M, load_way_rules().max_ease_aside_m))


def lane_way(lane: Lane, *, is_in: bool, length_m: float) -> Way:
    """The way along a lane, in its driving direction.

    It is straight where the lane is so far.
    """
    if (
        off_line_m(lane, is_in=is_in, length_m=length_m)
        <= load_way_rules().max_lane_bend_m
    ):
        return StraightWay(line=straight_line(lane, is_in=is_in))
    return CurvedWay(course=courses.follow_lane(lane.centreline_m, is_in=is_in))


def way_across(
    entry: Lane, leaving: Lane, connection: Lane | None, *, free_m: float | None = None
) -> tuple[Way, float]:
    """The way from a lane straight on into a lane out of the junction.

    The second result is its begin.

    Stations count from the mouth of the lane out of it; its begin is that at which
    the first lane begins. Straight, where all its lanes stay on the first one's
    line; else along the lanes' bends, and between them on the junction's own lane
    `connection`, or, where the map has none, on a cubic curve with the lanes'
    directions at its ends. With `free_m` it is the gentlest that leaves the lanes'
    middles by no more, and such a curve by no more than a metre.

    Raises
    ------
    CannotCarryError
        The lane out of the junction does not lie ahead.
    """
    chains = [entry.centreline_m, leaving.centreline_m]
    if connection is not None:
        chains.insert(1, connection.centreline_m)
    line = straight_line(entry, is_in=True)
    # Straight where no lane leaves the line of the first one.
    aside_m = np.abs(line.coordinates(np.concatenate(chains))[:, 1]).max()
    if aside_m <= load_way_rules().max_lane_bend_m:
        mouth_m = float(line.coordinates(leaving.centreline_m[0])[0])
        way = StraightWay(line=Line(point_m=line.at(mouth_m), direction=line.direction))
        return way, -mouth_m - lane_length_m(entry)
    if connection is None:
        between = _curve_between(entry, leaving)
    else:
        between = connection.centreline_m
    before = entry.centreline_m
    after = leaving.centreline_m
    if free_m is not None:
        if connection is None:
            aside_m = _CUT_OFF_M
        else:
            aside_m = free_m
        room_m = [free_m, aside_m, free_m]
        course = courses.follow_gently([before, between, after], room_m, origin=2)
    elif connection is None:
        course = courses.follow_lanes([np.concatenate([before, between]), after])
    else:
        course = courses.follow_connection(
            before, between, after, is_origin_behind=True
        )
    across_m = length_m(between)
    return CurvedWay(course=course), -across_m - lane_length_m(entry)


def _curve_between(entry: Lane, leaving: Lane) -> FloatArray:
    """Points (n, 2) from the end of a lane to the begin of another one."""
    before = courses.follow_lane(entry.centreline_m, is_in=True).tangent(0.0)
    after = courses.follow_lane(leaving.centreline_m, is_in=False).tangent(0.0)
    begin = replace(before, point_m=entry.centreline_m[-1])
    end = replace(after, point_m=leaving.centreline_m[0])
    try:
        return curve_between(begin, end)
    except ValueError:
        why = Phrase(
            "lane {lane} does not lie ahead of lane {other}",
            lane=leaving.id,
            other=entry.id,
        )
        raise CannotCarryError(why) from None


def reversed_way(way: Way) -> Way:
    """Way driven the other way; the origin of stations stays."""
    if isinstance(way, CurvedWay):
        return CurvedWay(course=way.course.reversed())
    line = way.tangent(0.0)
    return StraightWay(line=Line(point_m=line.point_m, direction=-line.direction))


def meeting_m(one: Way, other: Way) -> tuple[float, float]:
    """Stations at which two ways cross nearest to their origins.

    Raises
    ------
    CannotCarryError
        They do not cross.
    """
    station = other_station = 0.0
    for _ in range(_MAX_STEPS):
        other_station, _ = other.crossing(one.tangent(station))
        new, _ = one.crossing(other.tangent(other_station))
        if abs(new - station) < _MEETS_M:
            return new, other_station
        station = new
    raise CannotCarryError(DO_NOT_MEET)


# ---------- arms
_LEADS = {
    "left": Phrase("to the left"),
    "right": Phrase("to the right"),
    "through": Phrase("straight on"),
}
# As geometry.junction joins lanes.
_SAME_POINT_M = 0.5

# Into the junction, through it, out of it.
Joint = tuple[Lane, Lane | None, Lane]


def arm_at(junction: Junction, vut_line: Line, *, to_left: bool) -> Arm | None:
    """The arm to a side of the VUT; None: there is none.

    It is the one about at a right angle, or else nearest to that.
    """
    if to_left:
        side = vut_line.left
    else:
        side = -vut_line.left
    rules = load_way_rules()
    for skew_deg, far_m in (
        (rules.max_skew_deg, 50.0),
        (rules.max_turn_skew_deg, 15.0),
    ):
        best = None
        best_cosine = np.cos(np.radians(skew_deg))
        for arm in junction.arms.values():
            cosine = float(_outwards(arm, far_m) @ side)
            if cosine >= best_cosine:
                best = arm
                best_cosine = cosine
        if best is not None:
            return best
    return None


def arm_ahead(junction: Junction, approach: Arm, vut_line: Line) -> Arm | None:
    """The arm into which the VUT would drive straight on; None if there is none."""
    best = None
    best_cosine = np.cos(np.radians(load_way_rules().max_skew_deg))
    for arm in junction.arms.values():
        cosine = float(_outwards(arm, 15.0) @ vut_line.direction)
        is_in_line = arm is not approach and cosine >= best_cosine
        mouths = [lane.centreline_m[-1] for lane in arm.lanes_in]
        mouths += [lane.centreline_m[0] for lane in arm.lanes_out]
        ahead_m, left_m = vut_line.coordinates(np.array(mouths)).T
        # One of its lanes begins or ends no farther aside than ahead.
        if is_in_line and (np.abs(left_m) <= ahead_m).any():
            best = arm
            best_cosine = cosine
    return best


def _outwards(arm: Arm, length_m: float) -> FloatArray:
    """Direction in which an arm leads away from the junction, (2,)."""
    if arm.lanes_in:
        lanes, is_in = (arm.lanes_in, True)
    else:
        lanes, is_in = (arm.lanes_out, False)
    line, _ = lane_line(lanes[0], is_in=is_in, length_m=length_m)
    if is_in:
        return -line.direction
    return line.direction


def straight_lane(junction: Junction, arm: Arm) -> Lane:
    """The lane at the kerb from which cars drive straight on.

    Where none may, it is the lane at the kerb.
    """
    ahead = arm_ahead(junction, arm, straight_line(arm.entry_lanes[0], is_in=True))
    if ahead is not None and ahead.exit_lanes:
        with suppress(NoRoadError):
            return joints(junction, arm, ahead, "through")[0][0]
    return arm.entry_lanes[0]


def joints(
    junction: Junction, arm: Arm, target: Arm, movement: Movement
) -> list[Joint]:
    """Lanes by which cars may drive from one arm into another, the usual ones first.

    From the kerb, to the left from the axis. Where the map has lanes through the
    junction, those that it joins. Else lanes that are marked for the movement, or
    without any those that bear no marking; straight on the exit lane that is most
    in line comes first.

    Raises
    ------
    NoRoadError
        No lane leads there, by the lanes through the junction or by the
        markings.
    """
    if movement == "left":
        step = -1
    else:
        step = 1
    before = arm.entry_lanes[::step]
    after = target.exit_lanes[::step]
    if _has_connections(junction):
        pairs = [(lane, other) for lane in before for other in after]
        every = [
            (lane, junction.connection(lane, other), other) for lane, other in pairs
        ]
        joined: list[Joint] = [one for one in every if one[1] is not None]
        if not joined:
            raise NoRoadError(
                Phrase(
                    "the map has no lane from the {arm} to the {other}",
                    arm=Phrase(arm.name),
                    other=Phrase(target.name),
                )
            )
        return joined
    # Lanes that are marked for the movement come before lanes without markings.
    marked = [lane for lane in before if movement in lane.turns]
    free = marked or [lane for lane in before if not lane.turns]
    if not free:
        raise NoRoadError(
            Phrase(
                "according to its markings, no lane from the {arm} leads {where}",
                arm=Phrase(arm.name),
                where=_LEADS[movement],
            )
        )
    if movement != "through":
        return [(lane, None, other) for lane in free for other in after]
    found: list[Joint] = []
    for lane in free:
        line = straight_line(lane, is_in=True)
        aside_m = [
            abs(float(line.coordinates(other.centreline_m[0])[1])) for other in after
        ]
        found += [
            (lane, None, after[index]) for index in np.argsort(aside_m, kind="stable")
        ]
    return found


def edge_way(junction: Junction, passed: Arm, outside_m: float) -> CurvedWay:
    """The way of cyclists along the edge of a roundabout, across one of its arms.

    Traffic keeps right. It leads beside the lanes from the arm before that one into
    the arm behind it, in the direction of traffic.

    Parameters
    ----------
    junction : Junction
        A roundabout.
    passed : Arm
        The arm that it crosses.
    outside_m : float
        From the edge of the lanes. [m]

    Raises
    ------
    NoRoadError
        No lane passes the arm.
    CannotCarryError
        The lanes bend too sharply.
    """
    middle = np.mean([island.mean(axis=0) for island in junction.islands_m], axis=0)
    bearings = {}
    for arm in junction.arms.values():
        east, north = arm_mouth(arm) - middle
        bearings[arm.name] = np.arctan2(north, east)
    # Counter-clockwise from the arm, the next one comes first.
    others = sorted(
        (arm for arm in junction.arms.values() if arm.name != passed.name),
        key=lambda arm: (bearings[arm.name] - bearings[passed.name]) % (2.0 * np.pi),
    )
    leaving = [arm for arm in others if arm.exit_lanes]
    entered = [arm for arm in reversed(others) if arm.entry_lanes]
    if not leaving or not entered or leaving[0] is entered[0]:
        raise NoRoadError(
            Phrase(
                "no lane of the roundabout passes the {arm} arm",
                arm=Phrase(passed.name),
            )
        )
    before, connection, after = joints(junction, entered[0], leaving[0], "right")[0]
    assert connection is not None
    chains = (lane.centreline_m for lane in (before, connection, after))
    course = courses.follow_connection(*chains, is_origin_behind=False)
    width_m = max(before.width_m, connection.width_m)
    beside_m = -(0.5 * width_m + outside_m)
    reach_m = lane_length_m(connection)
    whole = CurvedWay(course=course)
    way, _ = whole.offset(beside_m, 0.0, back_m=_EDGE_M, ahead_m=reach_m + _EDGE_M)
    assert isinstance(way, CurvedWay)
    return way


def last_crossing(path: Path, way: CurvedWay, length_m: float) -> float:
    """Station of a way where a vehicle's path crosses it last.

    Parameters
    ----------
    path : Path
        Of the vehicle.
    way : CurvedWay
        The way.
    length_m : float
        So much of the path counts. [m]

    Raises
    ------
    CannotCarryError
        They do not cross.
    """
    distances = np.arange(0.0, length_m + _CROSSING_STEP_M, _CROSSING_STEP_M)
    positions, _ = path.at(distances)
    driven = shapely.LineString(positions)
    stride = round(_CROSSING_STEP_M / 0.01)
    ridden = shapely.LineString(way.course.points_m[::stride])
    points = shapely.get_coordinates(shapely.intersection(driven, ridden))
    if not len(points):
        raise CannotCarryError(DO_NOT_MEET)
    at_m = shapely.line_locate_point(driven, shapely.points(points))
    return way.station_of(points[int(np.argmax(at_m))])


def _has_connections(junction: Junction) -> bool:
    """True if the map has lanes through the junction itself.

    Lanes through others around it do not count.
    """
    if not junction.connections:
        return False
    begins = np.array([lane.centreline_m[0] for lane in junction.connections])
    tips = [
        lane.centreline_m[-1]
        for arm in junction.arms.values()
        for lane in arm.entry_lanes
    ]
    return any(
        bool((np.hypot(*(begins - tip).T) <= _SAME_POINT_M).any()) for tip in tips
    )


# ---------- turns into another arm
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turning:
    """A VUT's way into another arm.

    Attributes
    ----------
    entry_lane : Lane
        The lane by which it comes.
    entry : Line
        Line through the place where the turn begins.
    exit_way : Way
        The way on which it leaves the junction.
    turn_m : float
        Length of the turn. [m]
    path_with : callable of float to Path
        The VUT's path that begins so many metres before the turn.
    is_straight : bool
        The way is straight except in the turn.
    """

    entry_lane: Lane
    entry: Line
    exit_way: Way
    turn_m: float
    path_with: Callable[[float], Path]
    is_straight: bool


# By then the VUT has met the VRU.
_AFTER_TURN_M = 10.0


def on_straights(
    entry_lane: Lane, exit_lane: Lane, turn: courses.Turn, vut: Actor
) -> Turning:
    """The protocol's curve between the straight lines of two lanes."""
    entry = straight_line(entry_lane, is_in=True)
    exit_line = straight_line(exit_lane, is_in=False)
    angle_deg = abs((exit_line.yaw_deg - entry.yaw_deg + 180.0) % 360.0 - 180.0)
    try:
        turn = turn.turned_by(angle_deg)
        corner = entry.crossing_with(exit_line)
    except (InputError, np.linalg.LinAlgError):
        raise CannotCarryError(
            Phrase("the arms meet at {angle:.0f} degrees", angle=angle_deg)
        ) from None
    before_corner_m = float(entry.coordinates(corner)[0]) - turn.tangent_m
    after_corner_m = float(exit_line.coordinates(corner)[0]) + turn.tangent_m
    _check_within(entry_lane, -before_corner_m, _BEGINS_BEYOND)
    _check_within(exit_lane, after_corner_m, _ENDS_BEYOND)
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
    )


def on_lanes(
    entry_lane: Lane, exit_lane: Lane, turn: courses.Turn, vut: Actor
) -> Turning:
    """The protocol's curve between two lanes that bend."""
    entry = courses.follow_lane(entry_lane.centreline_m, is_in=True)
    exit_course = courses.follow_lane(exit_lane.centreline_m, is_in=False)
    try:
        course, turn = courses.join_by_turn(entry, exit_course, turn)
    except (InputError, np.linalg.LinAlgError):
        why = Phrase(
            "no turn of {radius:g} m leads from lane {lane} into {other}",
            radius=turn.radius_m,
            lane=entry_lane.id,
            other=exit_lane.id,
        )
        raise CannotCarryError(why) from None
    _check_within(
        entry_lane, -entry.station_of(course.tangent(0.0).point_m), _BEGINS_BEYOND
    )
    end = course.tangent(turn.length_m)
    _check_within(exit_lane, exit_course.station_of(end.point_m), _ENDS_BEYOND)
    return _towed(entry_lane, exit_course, course, turn.length_m, vut)


def along_connection(
    entry_lane: Lane, connection: Lane, exit_lane: Lane, vut: Actor
) -> Turning:
    """Along the junction's own lane between two others."""
    chains = (lane.centreline_m for lane in (entry_lane, connection, exit_lane))
    course = courses.follow_connection(*chains, is_origin_behind=False)
    exit_course = courses.follow_lane(exit_lane.centreline_m, is_in=False)
    return _towed(entry_lane, exit_course, course, lane_length_m(connection), vut)


def _towed(
    entry_lane: Lane,
    exit_course: courses.Course,
    course: courses.Course,
    turn_m: float,
    vut: Actor,
) -> Turning:
    """A turn whose path the VUT's front axle follows."""

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
    )


_BEGINS_BEYOND = Phrase("the turn would begin beyond the mapped lane {lane}")
_ENDS_BEYOND = Phrase("the turn would end beyond the mapped lane {lane}")


def _check_within(lane: Lane, in_lane_m: float, why: Phrase) -> None:
    if in_lane_m > lane_length_m(lane):
        raise CannotCarryError(Phrase(why.template, lane=lane.id))
