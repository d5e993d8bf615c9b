"""Cases laid on the approaches of any junction, by the rules of the protocol."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import InputError, check_one_of
from geometry.junction import Arm, Junction, Line, lane_length_m, lane_line
from geometry.scene import Lane

from .cases import Case
from .courses import Turn, follow_gently, follow_lane, pick_turn
from .obstructions import hide, park
from .paths import MPS_PER_KMH, Path, travel_time_s
from .positions import AT_ZERO, Position, is_bound
from .staging import (
    CannotCarryError,
    NoRoadError,
    Settle,
    Staging,
    find_crossing,
    find_meeting,
    first_that_fits,
    impact_offset_m,
    is_vehicle,
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
    WayAcross,
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
    one, or on the protocol's curve where there is none, or it bends too sharply for the speed. A
    vehicle that is met comes by the lanes that lead straight on through the junction, at its speed.
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
    if case.not_laid:
        raise NoRoadError(case.not_laid)
    arm = junction.arms[approach]
    if not arm.entry_lanes:
        raise NoRoadError(f"no lane leads into the junction from the {approach}")
    if position != AT_ZERO and is_bound(case):
        raise CannotCarryError("the case is bound to the junction: it has no other positions")
    if case.kind == "turning":
        return first_that_fits(_turnings(case, junction, arm, vut_speed_kmh, vut), settle)
    is_met_head_on = case.kind == "longitudinal" and case.vru_direction == "opposite"
    places = (
        _places_through(junction, arm, position, vut)
        if position.is_behind or is_met_head_on
        else _places_before(case, junction, arm, position, vut)
    )
    if _comes_through(case):
        return first_that_fits(_crossings(case, junction, arm, places, vut_speed_kmh, vut), settle)
    lay = _lay_crossing if case.kind == "crossing" else _lay_longitudinal

    def staged(place: Callable[[], _Place]) -> Callable[[], Staging]:
        return lambda: lay(case, junction, place(), vut_speed_kmh, vut)

    return first_that_fits((staged(place) for place in places), settle)


def _comes_through(case: Case) -> bool:
    """True if a vehicle is met that drives straight on through the junction."""
    return case.vru_line is not None and case.vru_line.along == "through"


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


def _places_through(
    junction: Junction, arm: Arm, position: Position, vut: Actor
) -> Iterator[Callable[[], _Place]]:
    """Places on the way straight through the junction, by lane from the kerb, then on gentler ways.

    Behind the junction they count from the crosswalk of the arm ahead.
    """
    ahead = arm_ahead(junction, arm, straight_line(arm.entry_lanes[0], is_in=True))
    if ahead is None or not ahead.exit_lanes:
        raise NoRoadError("no lane leads straight on out of the junction")
    crosswalk = ahead.crosswalk if position.is_behind else arm.crosswalk

    def at(across: Callable[[], WayAcross]) -> Callable[[], _Place]:
        def place() -> _Place:
            found = across()
            return _Place(
                way=found.way,
                crosswalk=crosswalk,
                entry_lane=found.entry,
                followed=found.entry,
                begin_m=found.begin_m,
                end_m=lane_length_m(found.leaving),
                ahead_m=position.ahead_m,
                is_checked=True,
            )

        return place

    yield from (at(across) for across in _ways_through(junction, arm, ahead, vut))


def _ways_through(
    junction: Junction, arm: Arm, ahead: Arm, body: Actor
) -> Iterator[Callable[[], WayAcross]]:
    """Ways of a vehicle from one arm straight on into another, by lane from the kerb."""

    def across(joint: Joint, *, is_gentle: bool) -> WayAcross:
        entry, connection, leaving = joint
        entry = junction.followed(entry)
        return way_across(
            entry,
            leaving,
            connection,
            max_bend_m=load_way_rules().max_lane_bend_m,
            free_m=free_aside_m(body, entry, leaving) if is_gentle else None,
        )

    found = joints(junction, arm, ahead, "through")
    for is_gentle in (False, True):
        yield from (partial(across, joint, is_gentle=is_gentle) for joint in found)


# ---------- crossing and longitudinal cases
_MOUTH_M = 15.0  # of a lane, that tell where it leads


def _crossings(
    case: Case,
    junction: Junction,
    arm: Arm,
    places: Iterable[Callable[[], _Place]],
    vut_speed_kmh: float,
    vut: Actor,
) -> Iterator[Callable[[], Staging]]:
    """Crossings with a vehicle, by the places of the VUT and the lanes of the other road."""
    is_near = case.vru_side == "near"
    side = arm_at(junction, straight_line(arm.entry_lanes[0], is_in=True), to_left=not is_near)
    if side is None or not side.entry_lanes:
        raise NoRoadError(f"no lane leads into the junction from the {case.vru_side} side")
    # What counts is how the other road leads into the junction, not where it comes from.
    mouth, _ = lane_line(side.entry_lanes[0], is_in=True, length_m=_MOUTH_M)
    ahead = arm_ahead(junction, side, mouth)
    if ahead is None or not ahead.exit_lanes:
        raise NoRoadError(f"no road leads straight across from the {case.vru_side} side")

    def lay(place: Callable[[], _Place], across: Callable[[], WayAcross]) -> Callable[[], Staging]:
        return lambda: _lay_crossing(
            case, junction, place(), vut_speed_kmh, vut, arm=arm, vru_way=across().way
        )

    every = tuple(places)
    for across in _ways_through(junction, side, ahead, case.vru):
        yield from (lay(place, across) for place in every)


def _lay_crossing(
    case: Case,
    junction: Junction,
    place: _Place,
    vut_speed_kmh: float,
    vut: Actor,
    *,
    arm: Arm | None = None,
    vru_way: Way | None = None,
) -> Staging:
    """A crossing; of a vehicle with its way, `vru_way`, and the arm from which the VUT comes."""
    vut_way = place.way
    if vru_way is None:
        vut_m, vru_way, vru_m = _crossing(case, junction, place)
    else:
        vut_m, vru_way, vru_m = _meet(vut_way, vru_way)
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
        vru_path=_path_of(case, vru_way, vru_m + (meeting.vru_distance_m - travel_m)),
        vru_start_s=begin_s,
    )
    obstruction = case.obstruction
    if obstruction is None or max(vut_speed_kmh, case.vru_speed_kmh) > obstruction.max_speed_kmh:
        return Staging(encounter=encounter, obstruction=())
    if obstruction.kind == "beside-road":
        assert arm is not None
        row_way, bumper_m, side = _beside_road(case, junction, arm, place, vut_m)
        return park(encounter, obstruction, row_way=row_way, bumper_m=bumper_m, side=side)
    return hide(encounter, obstruction, vut_way=vut_way, vut_m=vut_m, vru_way=vru_way, vru_m=vru_m)


def _beside_road(
    case: Case, junction: Junction, arm: Arm, place: _Place, vut_m: float
) -> tuple[Way, float, float]:
    """The lane next to which cars park on the side from which a vehicle comes.

    In the VUT's direction; the station of the first one's bumper; and +1 to the left of it, -1 to
    the right.
    """
    assert case.obstruction is not None
    bumper_m, side = vut_m - case.obstruction.first_gap_m, -1.0
    lane, is_in = arm.entry_lanes[0], True
    if case.vru_side == "far":
        side = 1.0
        lane, is_in = (arm.exit_lanes[0], False) if arm.exit_lanes else (arm.entry_lanes[-1], True)
    row_m = sum(body.length_m + case.obstruction.between_gap_m for body in case.obstruction.bodies)
    way = lane_way(
        junction.followed(lane) if is_in else lane,
        is_in=is_in,
        length_m=row_m + case.obstruction.first_gap_m,
        max_bend_m=load_way_rules().max_lane_bend_m,
    )
    if not is_in:
        way = reversed_way(way)
    return way, way.station_of(place.way.point(bumper_m, 0.0)), side


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
    travel_m, begin_s, brakes_s = _drive_ahead(case, vut_speed_kmh)
    before_lane_m = travel_m + 0.5 * case.vru.length_m - impact_m + place.begin_m
    if before_lane_m > 0.0 and not (is_vehicle(case.vru) or junction.is_led_on(place.entry_lane)):
        if place.ahead_m != 0.0:  # one reason for many positions
            raise CannotCarryError("the VRU would set off before the mapped lane begins")
        raise CannotCarryError(
            f"the VRU would set off {before_lane_m:.1f} m before the mapped lane begins"
        )
    driven_m = -begin_s * vut_speed_kmh * MPS_PER_KMH
    place.check_straight(max(travel_m, driven_m))
    gap_m = 0.5 * (vut.length_m + case.vru.length_m)
    vru_way, vru_m = vut_way.offset(impact_offset_m(case, vut), impact_m, back_m=travel_m)
    if case.vru_direction == "opposite":
        vru_way, vru_m = reversed_way(vru_way), -vru_m
    encounter = set_off(
        case,
        vut=vut,
        vut_path=vut_way.vut_path(impact_m - gap_m - driven_m, vut),
        vut_start_s=begin_s,
        vut_speed_kmh=vut_speed_kmh,
        vru_path=_path_of(case, vru_way, vru_m + (0.0 - travel_m)),
        vru_start_s=begin_s,
        vru_brakes_s=brakes_s,
    )
    return Staging(encounter=encounter, obstruction=())


def _drive_ahead(case: Case, vut_speed_kmh: float) -> tuple[float, float, float]:
    """How far whoever is ahead moves up to the impact, when the run begins, and when it brakes.

    One that brakes does so for longer than the protocol's last seconds where the gap is wide: the
    run begins a second before. Its time from then to the impact is that in which it falls behind
    its own speed, which is the VUT's, by the gap.
    """
    if case.braking is None:
        travel_m = _travel_m(case, 0.0)
        return travel_m, -_travel_s(case, travel_m), np.inf
    assert case.steady_time_s is not None
    speed_mps = case.vru_speed_kmh * MPS_PER_KMH
    gap_m = case.braking.headway_s * vut_speed_kmh * MPS_PER_KMH
    lost_mps = speed_mps - case.braking.final_speed_kmh * MPS_PER_KMH
    slowing_s = lost_mps / case.braking.deceleration_mps2
    slowed_m = 0.5 * lost_mps * slowing_s
    braking_s = (
        float(np.sqrt(2.0 * gap_m / case.braking.deceleration_mps2))
        if gap_m <= slowed_m
        else slowing_s + (gap_m - slowed_m) / lost_mps
    )
    before_s = max(case.steady_time_s, braking_s + 1.0)
    return speed_mps * before_s - gap_m, -before_s, -braking_s


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
    oncoming = tuple(_oncoming(case, junction, arm, entry)) if _comes_through(case) else (None,)

    def lay(
        turning: Callable[[], Turning], across: Callable[[], WayAcross] | None
    ) -> Callable[[], Staging]:
        if across is None:
            return lambda: _lay_turn(case, junction, arm, target, turning(), vut_speed_kmh, vut)
        return lambda: _lay_turn_across(case, turning(), across().way, vut_speed_kmh, vut)

    for turning in _turnings_between(found, turn, junction, vut):
        yield from (lay(turning, across) for across in oncoming)


def _turnings_between(
    found: Sequence[Joint], turn: Turn, junction: Junction, vut: Actor
) -> Iterator[Callable[[], Turning]]:
    """Turns from lane to lane: along the junction's own lanes, then on the protocol's curve."""
    for before, connection, after in found:
        if connection is not None:
            yield partial(along_connection, junction.followed(before), connection, after, vut)
    for before, _, after in found:
        before = junction.followed(before)
        yield partial(on_straights, before, after, turn, vut)
        if is_bent(before, is_in=True) or is_bent(after, is_in=False):
            yield partial(on_lanes, before, after, turn, vut)


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
        vru_path=_path_of(case, vru_way, vru_m + (meeting.vru_distance_m - travel_m)),
        vru_start_s=-_travel_s(case, travel_m),
    )
    return Staging(encounter=encounter, obstruction=())


def _oncoming(
    case: Case, junction: Junction, arm: Arm, entry: Line
) -> Iterator[Callable[[], WayAcross]]:
    """Ways of a vehicle that comes towards the VUT and drives straight on past it."""
    ahead = arm_ahead(junction, arm, entry)
    if ahead is None or not ahead.entry_lanes:
        raise NoRoadError("no lane leads towards the VUT from straight ahead")
    if not arm.exit_lanes:
        raise NoRoadError(f"no lane leads out of the junction to the {arm.name}")
    yield from _ways_through(junction, ahead, arm, case.vru)


def _lay_turn_across(
    case: Case, turning: Turning, vru_way: Way, vut_speed_kmh: float, vut: Actor
) -> Staging:
    """A turn across the way of an oncoming vehicle.

    Its front is where the VUT's front axle will cross its way, when the VUT's front is short of
    there by what the vehicle is wide at 45 degrees, or where it is to meet the middle of that
    front, by nothing.
    """
    path = turning.path_with(0.0)
    crossing_m, vru_m = find_crossing(vut, path, vru_way.tangent, turning.turn_m + vut.length_m)
    short_m = case.vru.width_m / np.sqrt(2.0) if case.meets_corner else 0.0
    vut_distance_m = crossing_m - (0.5 * vut.length_m - vut.front_axle_ahead_m) - short_m
    speed_mps = vut_speed_kmh * MPS_PER_KMH
    begin_s = -max(
        _travel_s(case, _travel_m(case, 0.0)),
        vut_distance_m / speed_mps + load_way_rules().start_before_curve_s,
    )
    straight_m = -begin_s * speed_mps - vut_distance_m
    if turning.is_straight:
        check_straight(StraightWay(line=turning.entry), turning.entry_lane, straight_m)
    travel_m = -begin_s * case.vru_speed_kmh * MPS_PER_KMH
    encounter = set_off(
        case,
        vut=vut,
        vut_path=turning.path_with(straight_m),
        vut_start_s=begin_s,
        vut_speed_kmh=vut_speed_kmh,
        vru_path=_path_of(case, vru_way, vru_m - case.vru_reference_m - travel_m),
        vru_start_s=begin_s,
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
def _path_of(case: Case, way: Way, station_m: float) -> Path:
    """The VRU's path along a way; a vehicle tows its rear axle."""
    return way.vut_path(station_m, case.vru) if is_vehicle(case.vru) else way.vru_path(station_m)


def _travel_m(case: Case, vru_distance_m: float) -> float:
    """The VRU's way from rest to the impact; `vru_distance_m`: its middle past the line's point.

    Of one that comes at its speed, from where the run begins.
    """
    if case.steady_time_s is not None:
        steady_m = case.steady_time_s * case.vru_speed_kmh * MPS_PER_KMH
        return case.acceleration_distance_m + steady_m
    if case.steady_distance_m is not None:
        return case.acceleration_distance_m + case.steady_distance_m
    assert case.start_distance_m is not None
    travel_m = case.start_distance_m + vru_distance_m + case.vru_reference_m
    if travel_m <= 0.0:
        raise CannotCarryError("the VUT would come to the VRU's way before the VRU sets off")
    return travel_m


def _travel_s(case: Case, travel_m: float) -> float:
    if case.vru_speed_kmh == 0.0:
        assert case.steady_time_s is not None
        return case.steady_time_s
    return travel_time_s(
        travel_m,
        speed_mps=case.vru_speed_kmh * MPS_PER_KMH,
        acceleration_distance_m=case.acceleration_distance_m,
    )
