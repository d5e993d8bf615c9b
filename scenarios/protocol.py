"""Cases laid on the approaches of any junction, by the rules of the protocol."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import InputError, check_one_of
from geometry.junction import Arm, Junction, Line, lane_length_m
from geometry.scene import Lane

from .cases import Case
from .courses import follow_gently, follow_lane, pick_turn
from .obstructions import hide
from .paths import MPS_PER_KMH, travel_time_s
from .positions import AT_ZERO, Position, is_bound
from .staging import (
    CannotCarryError,
    NoRoadError,
    Settle,
    Staging,
    find_meeting,
    first_that_fits,
    impact_offset_m,
    load_obstruction_rules,
    load_way_rules,
    set_off,
)
from .ways import (
    CurvedWay,
    Joint,
    StraightWay,
    Turning,
    Way,
    along_connection,
    arm_ahead,
    arm_at,
    check_straight,
    free_aside_m,
    is_bent,
    joints,
    lane_way,
    meeting_m,
    on_lanes,
    on_straights,
    reversed_way,
    straight_lane,
    straight_line,
    way_across,
)


def stage_by_protocol(
    case: Case,
    junction: Junction,
    approach: str,
    *,
    vut_speed_kmh: float,
    vut: Actor,
    position: Position = AT_ZERO,
    settle: Settle = lambda staging: staging,
) -> Staging:
    """Lay a case on an approach of a junction, or raise why its lanes do not allow it.

    The run begins when the VRU sets off; turning: also 1 s before the VUT enters the curve. The VUT
    comes along its lane, round its bends, and straight on backwards where the map ends. It drives
    in the lane at the kerb; before a left turn, in the one at the road's axis; where the map has
    connecting lanes, in the next one from there with which such a lane begins. It turns along that
    one, or on the protocol's curve where there is none, or it bends too sharply for the speed.
    Pedestrians cross at right angles to the VUT's lane where it meets the arm's crosswalk; a VRU
    that moves ahead of the VUT is reached there. Cyclists ride on the arm's cycleway where it has
    one.

    At other positions all of this lies so far along the VUT's way, before or behind: on the lane by
    which it comes, or on the one straight ahead by which it leaves. Behind the junction it drives
    along the connecting lane, or straight where the lanes are in line, else on a smooth line from
    one into the other. Raises CannotCarryError: the lanes do not allow it; the text says why.
    NoRoadError: the road that the case needs does not exist. InputError: there is no such arm.
    """
    check_one_of("approach", approach, junction.arms)
    arm = junction.arms[approach]
    if not arm.entry_lanes:
        raise NoRoadError(f"no lane leads into the junction from the {approach}")
    if position != AT_ZERO and is_bound(case):
        raise CannotCarryError("the case is bound to the junction: it has no other positions")
    if case.kind == "turning":
        return first_that_fits(_turnings(case, junction, arm, vut_speed_kmh, vut), settle)
    lay = _lay_crossing if case.kind == "crossing" else _lay_longitudinal
    places = (
        _places_behind(junction, arm, position, vut)
        if position.is_behind
        else _places_before(case, junction, arm, position, vut)
    )

    def staged(place: Callable[[], _Place]) -> Callable[[], Staging]:
        return lambda: lay(case, junction, place(), vut_speed_kmh, vut)

    return first_that_fits((staged(place) for place in places), settle)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Place:
    """Where along the VUT's way a case is laid."""

    way: Way
    crosswalk: Line
    entry_lane: Lane
    followed: Lane  # the same, with what is assumed before it
    begin_m: float  # station at which the mapped lanes begin
    end_m: float  # and end
    ahead_m: float  # so far ahead of the crosswalk the VUT meets the VRU
    is_checked: bool  # the way is known to follow its lanes

    def meeting_point(self) -> tuple[float, FloatArray]:
        """Station and point (2,) at which the VUT's way and a crossing VRU's meet.

        Raises NoRoadError where no lane of the map lies.
        """
        station_m, point_m = self.way.crossing(self.crosswalk)
        if self.ahead_m == 0.0:
            return station_m, point_m
        station_m += self.ahead_m
        if not self.begin_m <= station_m <= self.end_m:
            raise NoRoadError("the mapped lane does not reach so far")
        return station_m, self.way.tangent(station_m).point_m

    def check_straight(self, driven_m: float) -> None:
        """Raise if a straight way leaves the lane within some metres before the meeting point."""
        if not self.is_checked:
            check_straight(self.way, self.followed, driven_m - self.ahead_m)


def _places_before(
    case: Case, junction: Junction, arm: Arm, position: Position, vut: Actor
) -> Iterator[Callable[[], _Place]]:
    """Places on the arm from which the VUT comes, the protocol's first.

    Where the lane bends, also along its bends; where the corner leaves no kerb to park at before
    the crosswalk, nearest before it.
    """
    lane = straight_lane(junction, arm) if is_bound(case) else arm.entry_lanes[0]
    followed = junction.followed(lane)

    def at(way: Callable[[], Way], before_m: float = 0.0) -> Callable[[], _Place]:
        return lambda: _Place(
            way=way(),
            crosswalk=arm.crosswalk,
            entry_lane=lane,
            followed=followed,
            begin_m=-lane_length_m(lane),
            end_m=np.inf,
            ahead_m=position.ahead_m - before_m,
            is_checked=False,
        )

    ways: list[Callable[[], Way]] = [lambda: StraightWay(line=straight_line(lane, is_in=True))]
    if is_bent(followed, is_in=True):
        free_m = free_aside_m(vut, followed)
        ways.append(lambda: CurvedWay(course=follow_lane(followed.centreline_m, is_in=True)))
        ways.append(
            lambda: CurvedWay(course=follow_gently([followed.centreline_m], [free_m], origin=1))
        )
    yield from (at(way) for way in ways)
    if position == AT_ZERO and case.obstruction and case.obstruction.kind == "beside-vut":
        rules = load_obstruction_rules()
        for before_m in np.arange(1.0, rules.max_before_m + 0.5).tolist():
            yield from (at(way, before_m) for way in ways)


def _places_behind(
    junction: Junction, arm: Arm, position: Position, vut: Actor
) -> Iterator[Callable[[], _Place]]:
    """Places on the arm straight ahead, by lane from the kerb, then along gentler ways."""
    ahead = arm_ahead(junction, arm, straight_line(arm.entry_lanes[0], is_in=True))
    if ahead is None or not ahead.exit_lanes:
        raise NoRoadError("no lane leads straight on out of the junction")

    def at(joint: Joint, *, is_gentle: bool) -> Callable[[], _Place]:
        def place() -> _Place:
            entry, connection, leaving = joint
            entry = junction.followed(entry)
            across = way_across(
                entry,
                leaving,
                connection,
                max_bend_m=load_way_rules().max_lane_bend_m,
                free_m=free_aside_m(vut, entry, leaving) if is_gentle else None,
            )
            return _Place(
                way=across.way,
                crosswalk=ahead.crosswalk,
                entry_lane=across.entry,
                followed=across.entry,
                begin_m=across.begin_m,
                end_m=lane_length_m(across.leaving),
                ahead_m=position.ahead_m,
                is_checked=True,
            )

        return place

    found = joints(junction, arm, ahead, "through")
    for is_gentle in (False, True):
        yield from (at(joint, is_gentle=is_gentle) for joint in found)


# ---------- crossing and longitudinal cases
def _lay_crossing(
    case: Case, junction: Junction, place: _Place, vut_speed_kmh: float, vut: Actor
) -> Staging:
    vut_way = place.way
    vut_m, vru_way, vru_m = _crossing(case, junction, place)
    vru_line = vru_way.tangent(vru_m)
    # Far enough back for any gap between the lines; the impact lies near their crossing.
    behind_m = 2.0 * (vut.length_m + case.vru.length_m)
    meeting = find_meeting(
        case,
        vut=vut,
        vut_path=vut_way.vut_path(vut_m - behind_m, vut),
        vru_line=vru_line,
        search_m=(0.0, 2.0 * behind_m),
    )
    travel_m = _travel_m(case, meeting.vru_distance_m)
    begin_s = -_travel_s(case, travel_m)
    driven_m = -begin_s * vut_speed_kmh * MPS_PER_KMH
    place.check_straight(driven_m)
    encounter = set_off(
        case,
        vut=vut,
        vut_path=vut_way.vut_path(vut_m - behind_m + meeting.vut_distance_m - driven_m, vut),
        vut_start_s=begin_s,
        vut_speed_kmh=vut_speed_kmh,
        vru_path=vru_way.vru_path(vru_m + (meeting.vru_distance_m - travel_m)),
        vru_travel_m=travel_m,
    )
    if case.obstruction is None:
        return Staging(encounter=encounter, obstruction=())
    return hide(
        encounter, case.obstruction, vut_way=vut_way, vut_m=vut_m, vru_way=vru_way, vru_m=vru_m
    )


def _crossing(case: Case, junction: Junction, place: _Place) -> tuple[float, Way, float]:
    """The VRU's way, and the stations of the VUT's and of it at which they cross."""
    vut_way = place.way
    assert case.vru_line is not None
    is_near = case.vru_side == "near"
    if case.vru_line.along == "crosswalk":
        vut_m, point = place.meeting_point()
        if place.ahead_m != 0.0:
            _check_no_junction(junction, point)
        left = vut_way.direction(vut_m).left
        line = Line(point_m=point, direction=left if is_near else -left)
        return vut_m, StraightWay(line=line), 0.0
    side = arm_at(junction, vut_way.tangent(0.0), to_left=not is_near)
    if side is None or not side.entry_lanes:
        raise NoRoadError(f"no lane leads into the junction from the {case.vru_side} side")
    lane, left_m = _cyclists_lane(case, side)
    ridden_m = _travel_m(case, 0.0)
    middle = lane_way(
        lane, is_in=True, length_m=ridden_m, max_bend_m=load_way_rules().max_lane_bend_m
    )
    return _meet(vut_way, middle.offset(left_m, 0.0, back_m=ridden_m)[0])


_IN_JUNCTION_M = 1.0  # from the middle of a lane through it


def _check_no_junction(junction: Junction, point_m: FloatArray) -> None:
    """Raise if a point along an arm lies in another junction's middle."""
    import shapely

    point = shapely.Point(point_m)
    own = [lane.centreline_m[-1] for arm in junction.arms.values() for lane in arm.lanes_in]
    for lane in junction.connections:
        begin = lane.centreline_m[0]
        is_own = any(np.hypot(*(tip - begin)) < _IN_JUNCTION_M for tip in own)
        if not is_own and shapely.LineString(lane.centreline_m).distance(point) < _IN_JUNCTION_M:
            raise NoRoadError("another junction lies there: nobody crosses in its middle")


def _across(line: Line, direction: FloatArray) -> StraightWay:
    return StraightWay(line=Line(point_m=line.point_m, direction=direction))


def _meet(vut_way: Way, vru_way: Way) -> tuple[float, Way, float]:
    """Station of the VUT's way, the VRU's way and its station, where the two cross."""
    if isinstance(vut_way, StraightWay) and isinstance(vru_way, StraightWay):
        _, point = vru_way.crossing(vut_way.line)
        line = Line(point_m=point, direction=vru_way.line.direction)
        return float(vut_way.line.coordinates(line.point_m)[0]), StraightWay(line=line), 0.0
    vut_m, vru_m = meeting_m(vut_way, vru_way)
    return vut_m, vru_way, vru_m


def _cyclists_lane(case: Case, side: Arm) -> tuple[Lane, float]:
    """The lane along which cyclists come from an arm, and how far left of its middle they ride."""
    assert case.vru_line is not None
    if side.cycleways_in:
        return side.cycleways_in[0], 0.0
    outer, left_m = side.entry_lanes[0], case.vru_line.left_m
    if case.vru_line.lane == "inner" and len(side.entry_lanes) > 1:
        # Not at the road's axis, with traffic on both sides.
        return outer, load_way_rules().cyclist_inside_kerb_m - 0.5 * outer.width_m
    most_m = max(0.0, 0.5 * (outer.width_m - case.vru.width_m))  # narrow lanes
    return outer, min(left_m, most_m)


def _lay_longitudinal(
    case: Case, junction: Junction, place: _Place, vut_speed_kmh: float, vut: Actor
) -> Staging:
    vut_way = place.way
    impact_m, _ = place.meeting_point()
    travel_m = _travel_m(case, 0.0)
    before_lane_m = travel_m + 0.5 * case.vru.length_m - impact_m + place.begin_m
    if before_lane_m > 0.0 and not junction.is_led_on(place.entry_lane):
        if place.ahead_m != 0.0:  # one reason for many positions
            raise CannotCarryError("the VRU would set off before the mapped lane begins")
        raise CannotCarryError(
            f"the VRU would set off {before_lane_m:.1f} m before the mapped lane begins"
        )
    begin_s = -_travel_s(case, travel_m)
    driven_m = -begin_s * vut_speed_kmh * MPS_PER_KMH
    place.check_straight(max(travel_m, driven_m))
    gap_m = 0.5 * (vut.length_m + case.vru.length_m)
    vru_way, vru_m = vut_way.offset(impact_offset_m(case, vut), impact_m, back_m=travel_m)
    encounter = set_off(
        case,
        vut=vut,
        vut_path=vut_way.vut_path(impact_m - gap_m - driven_m, vut),
        vut_start_s=begin_s,
        vut_speed_kmh=vut_speed_kmh,
        vru_path=vru_way.vru_path(vru_m + (0.0 - travel_m)),
        vru_travel_m=travel_m,
    )
    return Staging(encounter=encounter, obstruction=())


# ---------- turning cases
def _turnings(
    case: Case, junction: Junction, arm: Arm, vut_speed_kmh: float, vut: Actor
) -> Iterator[Callable[[], Staging]]:
    """The VUT's ways into another arm: along the junction's lanes, then on the protocol's curve."""
    is_far = case.turn == "far"
    entry = straight_line(arm.entry_lanes[-1 if is_far else 0], is_in=True)
    target = arm_at(junction, entry, to_left=is_far)
    if target is None or not target.exit_lanes:
        raise NoRoadError(f"no lane leads out of the junction on the {case.turn} side")
    try:
        turn = pick_turn(case.turn, vut_speed_kmh)
    except InputError as error:
        raise CannotCarryError(str(error)) from None
    found = joints(junction, arm, target, "left" if is_far else "right")

    def lay(turning: Callable[[], Turning]) -> Callable[[], Staging]:
        return lambda: _lay_turn(case, junction, arm, target, turning(), vut_speed_kmh, vut)

    for before, connection, after in found:
        before = junction.followed(before)
        if connection is not None:
            yield lay(partial(along_connection, before, connection, after, vut))
    for before, _, after in found:
        before = junction.followed(before)
        yield lay(partial(on_straights, before, after, turn, vut))
        if is_bent(before, is_in=True) or is_bent(after, is_in=False):
            yield lay(partial(on_lanes, before, after, turn, vut))


def _lay_turn(
    case: Case,
    junction: Junction,
    arm: Arm,
    target: Arm,
    turning: Turning,
    vut_speed_kmh: float,
    vut: Actor,
) -> Staging:
    vru_way, vru_m = _turning_way(case, junction, arm, target, turning)
    meeting = find_meeting(
        case,
        vut=vut,
        vut_path=turning.path_with(0.0),
        vru_line=vru_way.tangent(vru_m),
        search_m=(0.0, turning.turn_m + lane_length_m(target.exit_lanes[0])),
    )
    travel_m = _travel_m(case, meeting.vru_distance_m)
    speed_mps = vut_speed_kmh * MPS_PER_KMH
    begin_s = -max(
        _travel_s(case, travel_m),
        meeting.vut_distance_m / speed_mps + load_way_rules().start_before_curve_s,
    )
    straight_m = -begin_s * speed_mps - meeting.vut_distance_m
    if turning.is_straight:
        check_straight(StraightWay(line=turning.entry), turning.entry_lane, straight_m)
    encounter = set_off(
        case,
        vut=vut,
        vut_path=turning.path_with(straight_m),
        vut_start_s=begin_s,
        vut_speed_kmh=vut_speed_kmh,
        vru_path=vru_way.vru_path(vru_m + (meeting.vru_distance_m - travel_m)),
        vru_travel_m=travel_m,
    )
    return Staging(encounter=encounter, obstruction=())


def _turning_way(
    case: Case, junction: Junction, arm: Arm, target: Arm, turning: Turning
) -> tuple[Way, float]:
    """The VRU's way, and its station where it crosses the lane into which the VUT turns."""
    assert case.vru_line is not None
    entry = turning.entry
    direction = entry.direction if case.vru_direction == "same" else -entry.direction
    if case.vru_line.along == "crosswalk":
        exit_m, point = turning.exit_way.crossing(target.crosswalk)
        exit_line = turning.exit_way.direction(exit_m)
        along = float(direction @ exit_line.direction)
        if abs(along) > np.sin(np.radians(load_way_rules().max_skew_deg)):
            # Askew: across the lane, not along the other one.
            direction = exit_line.left * np.sign(direction @ exit_line.left)
        return StraightWay(line=Line(point_m=point, direction=direction)), 0.0
    ridden_m = _travel_m(case, 0.0)
    kerb = _kerb(case, arm)
    beside = straight_line(kerb.lane, is_in=kerb.is_in)
    line = Line(point_m=beside.at(0.0, kerb.left_m), direction=direction)
    way = _ridden_lane(case, junction, arm, entry)
    if turning.is_straight and _is_along(way, line, ridden_m, load_way_rules().max_kerb_step_m):
        way = StraightWay(line=line)
    _, way, vru_m = _meet(turning.exit_way, way)
    return way, vru_m


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Kerb:
    """A line next to a lane."""

    lane: Lane
    is_in: bool
    left_m: float  # of the lane's middle, in its driving direction


def _kerb(case: Case, arm: Arm) -> _Kerb:
    """Where cyclists ride next to the VUT's approach road, on the side to which it turns."""
    assert case.vru_line is not None
    outside_m = case.vru_line.left_m
    if case.turn == "near":
        lane, is_in, side = arm.lanes_in[0], True, -1.0
        cycleways = arm.cycleways_in
    elif arm.lanes_out:
        lane, is_in, side = arm.lanes_out[0], False, -1.0
        cycleways = arm.cycleways_out
    else:  # a one-way road: the kerb is to the left of its lanes
        lane, is_in, side = arm.lanes_in[-1], True, 1.0
        cycleways = ()
    if cycleways:
        return _Kerb(lane=cycleways[0], is_in=is_in, left_m=0.0)
    return _Kerb(lane=lane, is_in=is_in, left_m=side * (0.5 * lane.width_m + outside_m))


def _ridden_lane(case: Case, junction: Junction, arm: Arm, entry: Line) -> Way:
    """The way along the kerb of the arm from which the cyclist comes."""
    assert case.vru_line is not None
    rules = load_way_rules()
    if case.vru_direction == "same":
        kerb = _kerb(case, arm)
        is_against = not kerb.is_in
    else:
        ahead = arm_ahead(junction, arm, entry)
        lanes = () if ahead is None else ahead.lanes_in if case.turn == "far" else ahead.lanes_out
        if ahead is None or not lanes:
            raise NoRoadError("no lane lies ahead from which the cyclist could come")
        is_against = case.turn == "near"
        cycleways = ahead.cycleways_out if is_against else ahead.cycleways_in
        left_m = -(0.5 * lanes[0].width_m + case.vru_line.left_m)
        kerb = _Kerb(lane=lanes[0], is_in=not is_against, left_m=left_m)
        if cycleways:
            kerb = _Kerb(lane=cycleways[0], is_in=not is_against, left_m=0.0)
    ridden_m = _travel_m(case, 0.0)
    way = lane_way(kerb.lane, is_in=kerb.is_in, length_m=ridden_m, max_bend_m=rules.max_lane_bend_m)
    left_m = kerb.left_m
    if is_against:
        way, left_m = reversed_way(way), -left_m
    return way.offset(left_m, 0.0, back_m=ridden_m)[0]


def _is_along(way: Way, line: Line, ridden_m: float, tolerance_m: float) -> bool:
    """True if a way stays on a line, from the mouth back to where the VRU sets off."""
    stations = np.linspace(-ridden_m, 0.0, 20)
    points = np.array([way.tangent(float(station)).point_m for station in stations])
    return bool((np.abs(line.coordinates(points)[:, 1]) <= tolerance_m).all())


# ---------- the VRU's way
def _travel_m(case: Case, vru_distance_m: float) -> float:
    """The VRU's way from rest to the impact; `vru_distance_m`: its middle past the line's point."""
    if case.steady_distance_m is not None:
        return case.acceleration_distance_m + case.steady_distance_m
    assert case.start_distance_m is not None
    travel_m = case.start_distance_m + vru_distance_m + case.vru_reference_m
    if travel_m <= 0.0:
        raise CannotCarryError("the VUT would come to the VRU's way before the VRU sets off")
    return travel_m


def _travel_s(case: Case, travel_m: float) -> float:
    return travel_time_s(
        travel_m,
        speed_mps=case.vru_speed_kmh * MPS_PER_KMH,
        acceleration_distance_m=case.acceleration_distance_m,
    )
