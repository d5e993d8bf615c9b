"""Cases laid on the approaches of any junction, by the rules of the protocol."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile

import numpy as np
import shapely

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import InputError, check_one_of
from geometry.junction import Arm, Junction, Line, lane_length_m, lane_line
from geometry.phrases import Phrase
from geometry.scene import Lane
from geometry.scene import Turn as Movement

from . import staging, ways
from .cases import Case
from .courses import follow_gently, follow_lane, pick_turn
from .encounters import Encounter, first_contact_s
from .obstructions import hide, park
from .paths import MPS_PER_KMH, Motion, Path, travel_time_s
from .positions import AT_ZERO, Position, is_bound
from .staging import CannotCarryError, NoRoadError, Staging


def stage_by_protocol(
    case: Case,
    junction: Junction,
    approach: str,
    *,
    vut_speed_kmh: float,
    vut: Actor,
    position: Position = AT_ZERO,
    settle: staging.Settle = lambda laid: laid,
) -> Staging:
    """Lay a case on an approach of a junction, or raise why its lanes do not allow it.

    The run begins when the VRU sets off; turning: also 1 s before the VUT enters the
    curve. The VUT comes along its lane, round its bends, and straight on backwards
    where the map ends. It drives in the lane at the kerb; before a left turn, in the
    one at the road's axis; where the map has connecting lanes, in the next one from
    there with which such a lane begins. It turns along that one, or on the protocol's
    curve where there is none, or it bends too sharply for the speed. A vehicle that is
    met comes by the lanes that lead straight on through the junction, at its speed.
    Pedestrians cross at right angles to the VUT's lane where it meets the arm's
    crosswalk; a VRU that moves ahead of the VUT is reached there. Cyclists ride on the
    arm's cycleway where it has one.

    At other positions all of this lies so far along the VUT's way, before or
    behind: on the lane by which it comes, or on the one straight ahead by which it
    leaves. Behind the junction it drives along the connecting lane, or straight
    where the lanes are in line, else on a smooth line from one into the other.

    Raises
    ------
    CannotCarryError
        The lanes do not allow it; the text says why.
    NoRoadError
        The road that the case needs does not exist.
    InputError
        There is no such arm.
    """
    check_one_of("approach", approach, junction.arms)
    if case.not_laid:
        raise NoRoadError(Phrase(case.not_laid))
    arm = junction.arms[approach]
    if not arm.entry_lanes:
        raise NoRoadError(
            Phrase(
                "no lane leads into the junction from the {arm}", arm=Phrase(approach)
            )
        )
    if position != AT_ZERO and is_bound(case):
        raise CannotCarryError(
            Phrase("the case exists only at the junction: it has no other positions")
        )
    asked = _Asked(
        case=case, junction=junction, arm=arm, vut=vut, vut_speed_kmh=vut_speed_kmh
    )
    # Each kind of case offers its stagings one by one; the first that fits is taken.
    if case.kind == "turning":
        return staging.first_that_fits(_turnings(asked), settle)
    is_met_head_on = case.kind == "longitudinal" and case.vru_direction == "opposite"
    # At a roundabout cyclists cross where the VUT's way bends towards the ring.
    is_edge_met = asked.is_at_ring and case.kind == "crossing" and is_bound(case)
    is_through = position.is_behind or is_met_head_on or is_edge_met
    if not position.is_behind:
        _check_parking(case, arm)
    if not position.is_behind and _is_met_on_arm(case):
        _check_open(case, arm, is_at_mouth=position == AT_ZERO)
    places = (_places_through if is_through else _places_before)(asked, position)
    if _comes_through(case):
        return staging.first_that_fits(_crossings(asked, places), settle)
    lay = _lay_crossing if case.kind == "crossing" else _lay_longitudinal
    return staging.first_that_fits(
        (partial(lay, asked, place) for place in places), settle
    )


_BESIDE_VUT = ("beside-vut", "beside-road")
# Road users, as people call them.
_PEOPLE = {
    "on foot": Phrase("pedestrians"),
    "bicycle": Phrase("cyclists"),
    "motorcycle": Phrase("motorcyclists"),
}


def _check_open(case: Case, *arms: Arm, is_at_mouth: bool = False) -> None:
    """Raise NoRoadError if the map closes an arm to whoever is met.

    `is_at_mouth`: pedestrians cross there, as they may if the map has a crosswalk.
    """
    user = case.road_user
    for arm in arms:
        may_cross = is_at_mouth and user == "on foot" and arm.has_own_crosswalk
        if user in arm.closed_to and not may_cross:
            raise NoRoadError(
                Phrase(
                    "the map marks the {arm} arm as closed to {users}",
                    arm=Phrase(arm.name),
                    users=_PEOPLE[user],
                )
            )


def _check_parking(case: Case, arm: Arm, *, beside: str = "") -> None:
    """Raise NoRoadError if cars would park on an arm that is closed to pedestrians.

    `beside` is the kind of obstruction that stands there; by default beside the VUT's
    way.
    """
    row = case.obstruction
    if row is None or row.kind not in (beside or _BESIDE_VUT):
        return
    if not row.wall_size_m and "on foot" in arm.closed_to:
        raise NoRoadError(
            Phrase(
                "no cars park on the {arm} arm because nobody may walk there",
                arm=Phrase(arm.name),
            )
        )


def _is_met_on_arm(case: Case) -> bool:
    """True if whoever is met crosses an arm, or moves along its lanes."""
    crosses = case.vru_line is not None and case.vru_line.along == "crosswalk"
    return crosses or case.kind == "longitudinal"


def _comes_through(case: Case) -> bool:
    """True if a vehicle is met that drives straight on through the junction."""
    return case.vru_line is not None and case.vru_line.along == "through"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Asked:
    """What is to be laid.

    Attributes
    ----------
    case : Case
        The case.
    junction : Junction
        The junction, where traffic keeps right.
    arm : Arm
        The arm from which the VUT comes.
    vut, vut_speed_kmh : Actor, float
        The VUT and its speed. [km/h]
    """

    case: Case
    junction: Junction
    arm: Arm
    vut: Actor
    vut_speed_kmh: float

    @property
    def is_at_ring(self) -> bool:
        """True if the junction is a roundabout."""
        return bool(self.junction.islands_m)

    @property
    def entry_line(self) -> Line:
        """The straight line along the VUT's lane at the kerb."""
        return ways.straight_line(self.arm.entry_lanes[0], is_in=True)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Place:
    """Where along the VUT's way a case is laid.

    Attributes
    ----------
    way : Way
        The VUT's way.
    crosswalk : Line
        The crosswalk from which the place counts.
    entry_lane : Lane
        The lane by which the VUT comes.
    followed : Lane
        The same, with what is assumed before it.
    begin_m, end_m : float
        Stations at which the mapped lanes begin and end. [m]
    ahead_m : float
        The VUT meets the VRU so far ahead of the crosswalk. [m]
    is_checked : bool
        The way is known to follow its lanes.
    near_buses_m, far_buses_m : float
        Width of the bus lanes at the kerb on the near side, and at the far one. [m]
    """

    way: ways.Way
    crosswalk: Line
    entry_lane: Lane
    followed: Lane
    begin_m: float
    end_m: float
    ahead_m: float
    is_checked: bool
    near_buses_m: float = 0.0
    far_buses_m: float = 0.0

    def meeting_point(self) -> tuple[float, FloatArray]:
        """Station and point (2,) where a crossing VRU is met.

        Raises
        ------
        NoRoadError
            No lane is there.
        """
        station_m, point_m = self.way.crossing(self.crosswalk)
        if self.ahead_m == 0.0:
            return station_m, point_m
        station_m += self.ahead_m
        if not self.begin_m <= station_m <= self.end_m:
            raise NoRoadError(Phrase("the mapped lane does not reach that far"))
        return station_m, self.way.tangent(station_m).point_m

    def check_straight(self, driven_m: float) -> None:
        """Raise if a straight way leaves the lane before the meeting point.

        Only the last `driven_m` metres before that point count.
        """
        if not self.is_checked:
            ways.check_straight(self.way, self.followed, driven_m - self.ahead_m)


# Or raises CannotCarryError.
_Lay = Callable[[], _Place]


def _places_before(asked: _Asked, position: Position) -> Iterator[_Lay]:
    """Places on the arm from which the VUT comes.

    The protocol's comes first, then those along a lane's bends.

    Where the corner leaves no kerb to park at before the crosswalk, nearest before it.
    """
    case = asked.case
    arm = asked.arm
    if is_bound(case):
        lane = ways.straight_lane(asked.junction, arm)
    else:
        lane = arm.entry_lanes[0]
    followed = asked.junction.followed(lane)

    def place(way: Callable[[], ways.Way], before_m: float = 0.0) -> _Place:
        return _Place(
            way=way(),
            crosswalk=arm.crosswalk,
            entry_lane=lane,
            followed=followed,
            begin_m=-lane_length_m(lane),
            end_m=np.inf,
            ahead_m=position.ahead_m - before_m,
            is_checked=False,
            near_buses_m=_kerb_buses_m(arm.lanes_in),
            far_buses_m=_kerb_buses_m(arm.lanes_out),
        )

    chain_m = followed.centreline_m
    lines: list[Callable[[], ways.Way]] = [
        lambda: ways.StraightWay(line=ways.straight_line(lane, is_in=True))
    ]
    if ways.is_bent(followed, is_in=True):
        free_m = ways.free_aside_m(asked.vut, followed)
        lines.append(lambda: ways.CurvedWay(course=follow_lane(chain_m, is_in=True)))
        lines.append(
            lambda: ways.CurvedWay(course=follow_gently([chain_m], [free_m], origin=1))
        )
    yield from (partial(place, way) for way in lines)
    if (
        position == AT_ZERO
        and case.obstruction
        and case.obstruction.kind == "beside-vut"
    ):
        most_m = staging.load_obstruction_rules().max_before_m
        for before_m in np.arange(1.0, most_m + 0.5).tolist():
            yield from (partial(place, way, before_m) for way in lines)


def _places_through(asked: _Asked, position: Position) -> Iterator[_Lay]:
    """Places on the way straight through.

    They count behind the junction from the crosswalk of the arm ahead.
    """
    arm = asked.arm
    ahead = ways.arm_ahead(asked.junction, arm, asked.entry_line)
    if ahead is None or not ahead.exit_lanes:
        raise NoRoadError(Phrase("no lane leads straight on out of the junction"))
    crosswalk = arm.crosswalk
    kerbs = (arm.lanes_in, arm.lanes_out)
    if position.is_behind:
        _check_parking(asked.case, ahead)
        if _is_met_on_arm(asked.case):
            is_at_mouth = position.ahead_m == 0.0
            _check_open(asked.case, ahead, is_at_mouth=is_at_mouth)
        crosswalk = ahead.crosswalk
        kerbs = (ahead.lanes_out, ahead.lanes_in)
    yield from _ways_through(
        asked.junction,
        arm,
        ahead,
        asked.vut,
        crosswalk=crosswalk,
        ahead_m=position.ahead_m,
        kerbs=kerbs,
    )


def _ways_through(
    junction: Junction,
    arm: Arm,
    ahead: Arm,
    body: Actor,
    *,
    crosswalk: Line | None = None,
    ahead_m: float = 0.0,
    kerbs: tuple[Sequence[Lane], Sequence[Lane]] = ((), ()),
) -> Iterator[_Lay]:
    """Ways of a vehicle from one arm straight on into another.

    They come by lane from the kerb. `kerbs` are the lanes from the near kerb, and
    those from the far one, where it is met.
    """

    def place(
        entry: Lane, connection: Lane | None, leaving: Lane, *, is_gentle: bool
    ) -> _Place:
        entry = junction.followed(entry)
        if is_gentle:
            free_m = ways.free_aside_m(body, entry, leaving)
        else:
            free_m = None
        way, begin_m = ways.way_across(entry, leaving, connection, free_m=free_m)
        return _Place(
            way=way,
            crosswalk=crosswalk or arm.crosswalk,
            entry_lane=entry,
            followed=entry,
            begin_m=begin_m,
            end_m=lane_length_m(leaving),
            ahead_m=ahead_m,
            is_checked=True,
            near_buses_m=_kerb_buses_m(kerbs[0]),
            far_buses_m=_kerb_buses_m(kerbs[1]),
        )

    found = ways.joints(junction, arm, ahead, "through")
    for is_gentle in (False, True):
        yield from (partial(place, *joint, is_gentle=is_gentle) for joint in found)


def _kerb_buses_m(lanes: Sequence[Lane]) -> float:
    """Width of the bus lanes next to the kerb, in metres; `lanes` come from there."""
    from_kerb = takewhile(lambda lane: lane.kind != "driving", lanes)
    return sum(lane.width_m for lane in from_kerb if lane.kind == "bus")


# ---------- crossing and longitudinal cases
# Of a lane, that tell where it leads.
_MOUTH_M = 15.0
# A corner that touches before the impact position is a tenth of a second early.
_MAX_EARLY_S = 0.3


def _side(asked: _Asked, line: Line) -> Arm:
    """The arm on the side from which the VRU comes."""
    side = ways.arm_at(asked.junction, line, to_left=asked.case.vru_side != "near")
    if side is None or not side.entry_lanes:
        raise NoRoadError(
            Phrase(
                "no lane leads into the junction from the {side} side",
                side=Phrase(asked.case.vru_side),
            )
        )
    return side


def _crossings(
    asked: _Asked, places: Iterable[_Lay]
) -> Iterator[Callable[[], Staging]]:
    """Crossings with a vehicle.

    They come by the lanes of the other road, then by the places of the VUT.
    """
    side = _side(asked, asked.entry_line)
    # What counts is how the other road leads into the junction, not where it comes
    # from.
    mouth, _ = lane_line(side.entry_lanes[0], is_in=True, length_m=_MOUTH_M)
    ahead = ways.arm_ahead(asked.junction, side, mouth)
    if ahead is None or not ahead.exit_lanes:
        raise NoRoadError(
            Phrase(
                "no road leads straight across from the {side} side",
                side=Phrase(asked.case.vru_side),
            )
        )
    _check_open(asked.case, side, ahead)
    every = tuple(places)
    for across in _ways_through(asked.junction, side, ahead, asked.case.vru):
        yield from (partial(_lay_crossing, asked, place, across) for place in every)


def _lay_crossing(asked: _Asked, laid: _Lay, across: _Lay | None = None) -> Staging:
    """A crossing; of a vehicle with its way, `across`."""
    place = laid()
    case = asked.case
    vut = asked.vut
    vut_way = place.way
    if across is None:
        vut_m, vru_way, vru_m = _crossing(asked, place)
    else:
        vut_m, vru_way, vru_m = _meet(vut_way, across().way)
    # Far enough back for any gap between the lines; the impact lies near their
    # crossing.
    behind_m = 2.0 * (vut.length_m + case.vru.length_m)
    vut_distance_m, vru_distance_m = staging.find_meeting(
        case,
        vut=vut,
        vut_path=vut_way.vut_path(vut_m - behind_m, vut),
        vru_line=vru_way.tangent(vru_m),
        search_m=(0.0, 2.0 * behind_m),
    )
    starts_at_kerb = case.vru_line is not None and case.vru_line.along == "crosswalk"
    buses_m = place.near_buses_m
    if case.vru_side == "far":
        buses_m = place.far_buses_m
    # Who sets off at the kerb has the bus lanes to cross, too.
    before_m = 0.0
    if starts_at_kerb and case.vru_side == "near" and case.start_distance_m is not None:
        before_m = buses_m
    travel_m = _travel_m(case, vru_distance_m + before_m)
    begin_s = -_travel_s(case, travel_m)
    driven_m = -begin_s * asked.vut_speed_kmh * MPS_PER_KMH
    place.check_straight(driven_m)
    vut_path = vut_way.vut_path(vut_m - behind_m + vut_distance_m - driven_m, vut)
    encounter = _set_off(
        asked, vut_path, begin_s, vru_way, vru_m + (vru_distance_m - travel_m)
    )
    obstruction = case.obstruction
    fastest_kmh = max(asked.vut_speed_kmh, case.vru_speed_kmh)
    if obstruction is None or fastest_kmh > obstruction.max_speed_kmh:
        return Staging(encounter=encounter, obstruction=())
    if obstruction.kind == "beside-road":
        row_way, bumper_m, side = _beside_road(asked, place, vut_m)
        return park(
            encounter, obstruction, row_way=row_way, bumper_m=bumper_m, side=side
        )
    hidden = hide(
        encounter,
        obstruction,
        vut_way=vut_way,
        vut_m=vut_m,
        vru_way=vru_way,
        vru_m=vru_m,
    )
    if obstruction.kind == "beside-vut":
        # Nobody parks on a bus lane: the kerb is beyond it.
        return replace(hidden, max_aside_m=hidden.max_aside_m + buses_m)
    return hidden


def _set_off(
    asked: _Asked,
    vut_path: Path,
    begin_s: float,
    vru_way: ways.Way,
    vru_m: float,
    *,
    vru_begin_s: float | None = None,
    brakes_s: float = np.inf,
) -> Encounter:
    """Encounter whose bodies first touch at time 0.

    Both set off at `begin_s`, or the VRU at its own time, from a station of its
    way; at `brakes_s` it brakes as the case says. Where the corner of a turning VUT
    would touch a moment before the impact position is reached, both set off that
    moment later.

    Raises
    ------
    CannotCarryError
        The bodies do not touch, or do so long before, somewhere else.
    """
    case, vru = asked.case, asked.case.vru
    if staging.is_vehicle(vru):
        vru_path = vru_way.vut_path(vru_m, vru)
    else:
        vru_path = vru_way.vru_path(vru_m)
    if vru_begin_s is None:
        vru_start_s = begin_s
    else:
        vru_start_s = vru_begin_s
    braking = {}
    if case.braking is not None:
        braking["deceleration_mps2"] = case.braking.deceleration_mps2
        braking["final_speed_mps"] = case.braking.final_speed_kmh * MPS_PER_KMH

    def later(seconds: float) -> Encounter:
        return Encounter(
            vut=asked.vut,
            vut_motion=Motion(
                path=vut_path,
                speed_mps=asked.vut_speed_kmh * MPS_PER_KMH,
                start_time_s=begin_s + seconds,
            ),
            vru=vru,
            vru_motion=Motion(
                path=vru_path,
                speed_mps=case.vru_speed_kmh * MPS_PER_KMH,
                start_time_s=seconds + vru_start_s,
                acceleration_distance_m=case.acceleration_distance_m,
                brake_time_s=seconds + brakes_s,
                **braking,
            ),
        )

    encounter = later(0.0)
    early_s = first_contact_s(encounter)
    if not np.isfinite(early_s):
        raise CannotCarryError(Phrase("the bodies do not touch"))
    if abs(early_s) > _MAX_EARLY_S:
        raise CannotCarryError(
            Phrase("the bodies would touch {time:.1f} s too early", time=-early_s)
        )
    return later(-early_s)


def _beside_road(
    asked: _Asked, place: _Place, vut_m: float
) -> tuple[ways.Way, float, float]:
    """The way along the lane next to which cars park.

    It is on the side from which a vehicle comes, in the direction of the VUT.

    The station of the first one's bumper; and +1 to the left of the lane, -1 to the
    right.
    """
    arm = asked.arm
    row = asked.case.obstruction
    assert row is not None
    bumper_m = vut_m - row.first_gap_m
    side = -1.0
    lane = arm.ridden_in[0]
    is_in = True
    if asked.case.vru_side == "far":
        side = 1.0
        if arm.ridden_out:
            lane, is_in = (arm.ridden_out[0], False)
        else:
            lane, is_in = (arm.ridden_in[-1], True)
    row_m = sum(body.length_m + row.between_gap_m for body in row.bodies)
    if is_in:
        followed = asked.junction.followed(lane)
    else:
        followed = lane
    way = ways.lane_way(followed, is_in=is_in, length_m=row_m + row.first_gap_m)
    if not is_in:
        way = ways.reversed_way(way)
    return way, way.station_of(place.way.point(bumper_m, 0.0)), side


def _crossing(asked: _Asked, place: _Place) -> tuple[float, ways.Way, float]:
    """The VRU's way, and the stations of the VUT's and of it at which they cross."""
    case = asked.case
    vut_way = place.way
    assert case.vru_line is not None
    if case.vru_line.along == "crosswalk":
        vut_m, point = place.meeting_point()
        if place.ahead_m != 0.0:
            _check_no_junction(asked.junction, point)
        left = vut_way.direction(vut_m).left
        line = Line(point_m=point, direction=left if case.vru_side == "near" else -left)
        return vut_m, ways.StraightWay(line=line), 0.0
    if asked.is_at_ring:
        return _across_edge(asked, place)
    side = _side(asked, vut_way.tangent(0.0))
    _check_open(case, side)
    _check_parking(case, side, beside="beside-vru")
    mouth, _ = lane_line(side.entry_lanes[0], is_in=True, length_m=_MOUTH_M)
    across = ways.arm_ahead(asked.junction, side, mouth)
    if across is not None:
        _check_open(case, across)
    lane, left_m = _cyclists_lane(case, side)
    ridden_m = _travel_m(case, 0.0)
    middle = ways.lane_way(lane, is_in=True, length_m=ridden_m)
    return _meet(vut_way, middle.offset(left_m, 0.0, back_m=ridden_m)[0])


def _across_edge(asked: _Asked, place: _Place) -> tuple[float, ways.Way, float]:
    """As :func:`_crossing`, of a cyclist who rides around a roundabout."""
    outside_m = staging.load_way_rules().ring_edge_m
    edge: ways.Way = ways.edge_way(asked.junction, asked.arm, outside_m)
    if asked.case.vru_side == "near":
        # Against the traffic of the ring.
        edge = ways.reversed_way(edge)
    assert isinstance(edge, ways.CurvedWay)
    # From before the mouth to where the ring has surely been reached.
    mouth_m = place.way.station_of(place.entry_lane.centreline_m[-1])
    path = place.way.vru_path(mouth_m - _EDGE_SEARCH_M)
    vru_m = ways.last_crossing(path, edge, 2.0 * _EDGE_SEARCH_M)
    vut_m = place.way.station_of(edge.point(vru_m, 0.0))
    return vut_m, edge, vru_m


# Along the VUT's way, to both sides of its lane's end.
_EDGE_SEARCH_M = 20.0
# From the middle of a lane through it.
_IN_JUNCTION_M = 1.0


def _check_no_junction(junction: Junction, point_m: FloatArray) -> None:
    """Raise if a point along an arm lies in another junction's middle."""
    point = shapely.Point(point_m)
    own = [
        lane.centreline_m[-1] for arm in junction.arms.values() for lane in arm.lanes_in
    ]
    for lane in junction.connections:
        begin = lane.centreline_m[0]
        is_own = any(np.hypot(*(tip - begin)) < _IN_JUNCTION_M for tip in own)
        if (
            not is_own
            and shapely.LineString(lane.centreline_m).distance(point) < _IN_JUNCTION_M
        ):
            raise NoRoadError(
                Phrase("another junction is there: nobody crosses in its middle")
            )


def _meet(vut_way: ways.Way, vru_way: ways.Way) -> tuple[float, ways.Way, float]:
    """Station of the VUT's way, the VRU's way and its station, where the two cross."""
    if isinstance(vut_way, ways.StraightWay) and isinstance(vru_way, ways.StraightWay):
        _, point = vru_way.crossing(vut_way.line)
        line = Line(point_m=point, direction=vru_way.line.direction)
        return (
            float(vut_way.line.coordinates(line.point_m)[0]),
            ways.StraightWay(line=line),
            0.0,
        )
    vut_m, vru_m = ways.meeting_m(vut_way, vru_way)
    return vut_m, vru_way, vru_m


def _cyclists_lane(case: Case, side: Arm) -> tuple[Lane, float]:
    """The lane along which cyclists come, and how far left they ride.

    The distance is from the middle of the lane, in metres.
    """
    assert case.vru_line is not None
    if side.cycleways_in:
        return side.cycleways_in[0], 0.0
    outer = side.ridden_in[0]
    left_m = case.vru_line.left_m
    if case.vru_line.lane == "inner" and len(side.ridden_in) > 1:
        # Not at the road's axis, with traffic on both sides.
        return (
            outer,
            staging.load_way_rules().cyclist_inside_kerb_m - 0.5 * outer.width_m,
        )
    # Narrow lanes.
    most_m = max(0.0, 0.5 * (outer.width_m - case.vru.width_m))
    return outer, min(left_m, most_m)


def _lay_longitudinal(asked: _Asked, laid: _Lay) -> Staging:
    """A VRU or a vehicle that moves ahead of the VUT, or towards it."""
    place = laid()
    case = asked.case
    vut = asked.vut
    vut_way = place.way
    impact_m, _ = place.meeting_point()
    travel_m, begin_s, brakes_s = _drive_ahead(case, asked.vut_speed_kmh)
    before_lane_m = travel_m + 0.5 * case.vru.length_m - impact_m + place.begin_m
    is_led_on = staging.is_vehicle(case.vru) or asked.junction.is_led_on(
        place.entry_lane
    )
    if before_lane_m > 0.0 and not is_led_on:
        # At other positions than 0 one reason for many of them.
        why = Phrase("the VRU would set off before the mapped lane begins")
        if place.ahead_m == 0.0:
            why = Phrase(
                "the VRU would set off {distance:.1f} m before the mapped lane begins",
                distance=before_lane_m,
            )
        raise CannotCarryError(why)
    driven_m = -begin_s * asked.vut_speed_kmh * MPS_PER_KMH
    place.check_straight(max(travel_m, driven_m))
    # At the impact the two touch nose to tail, or nose to nose.
    gap_m = 0.5 * (vut.length_m + case.vru.length_m)
    vru_way, vru_m = vut_way.offset(
        staging.impact_offset_m(case, vut), impact_m, back_m=travel_m
    )
    if case.vru_direction == "opposite":
        vru_way = ways.reversed_way(vru_way)
        vru_m = -vru_m
    vut_path = vut_way.vut_path(impact_m - gap_m - driven_m, vut)
    vru_m += 0.0 - travel_m
    encounter = _set_off(asked, vut_path, begin_s, vru_way, vru_m, brakes_s=brakes_s)
    return Staging(encounter=encounter, obstruction=())


def _drive_ahead(case: Case, vut_speed_kmh: float) -> tuple[float, float, float]:
    """Distance moved ahead up to the impact, start time and brake time.

    They are those of whoever is ahead of the VUT, in metres and seconds.

    One that brakes does so for longer than the protocol's last seconds where the gap is
    wide: the run begins a second before. Its time from then to the impact is that in
    which it falls behind its own speed, which is the VUT's, by the gap.
    """
    if case.braking is None:
        travel_m = _travel_m(case, 0.0)
        return travel_m, -_travel_s(case, travel_m), np.inf
    assert case.steady_time_s is not None
    speed_mps = case.vru_speed_kmh * MPS_PER_KMH
    gap_m = case.braking.headway_s * vut_speed_kmh * MPS_PER_KMH
    lost_mps = speed_mps - case.braking.final_speed_kmh * MPS_PER_KMH
    # The gap closes while the vehicle slows down, or at its final speed after that.
    slowing_s = lost_mps / case.braking.deceleration_mps2
    slowed_m = 0.5 * lost_mps * slowing_s
    if gap_m <= slowed_m:
        braking_s = float(np.sqrt(2.0 * gap_m / case.braking.deceleration_mps2))
    else:
        braking_s = slowing_s + (gap_m - slowed_m) / lost_mps
    before_s = max(case.steady_time_s, braking_s + 1.0)
    return speed_mps * before_s - gap_m, -before_s, -braking_s


# ---------- turning cases
def _turnings(asked: _Asked) -> Iterator[Callable[[], Staging]]:
    """The VUT's ways into another arm.

    Those along the junction's lanes come before those on the protocol's curve.
    """
    case = asked.case
    junction = asked.junction
    arm = asked.arm
    is_far = case.turn == "far"
    entry = ways.straight_line(arm.entry_lanes[-1 if is_far else 0], is_in=True)
    target = ways.arm_at(junction, entry, to_left=is_far)
    if target is None or not target.exit_lanes:
        raise NoRoadError(
            Phrase(
                "no lane leads out of the junction on the {side} side",
                side=Phrase(case.turn),
            )
        )
    if _is_met_on_arm(case):
        _check_open(case, target, is_at_mouth=True)
    else:
        # Whoever is met goes straight on past the turn, from either side.
        ahead = ways.arm_ahead(junction, arm, entry)
        _check_open(case, arm)
        if ahead is not None:
            _check_open(case, ahead)
    lines = _turnings_into(asked, target)
    if _comes_through(case):
        oncoming = tuple(_oncoming(asked, entry))
        for turning in lines:
            yield from (
                partial(_lay_turn_across, asked, turning, across) for across in oncoming
            )
    else:
        yield from (partial(_lay_turn, asked, target, turning) for turning in lines)


def _turnings_into(asked: _Asked, target: Arm) -> list[Callable[[], ways.Turning]]:
    """Turns from lane to lane.

    Those along the junction's own lanes come before those on the protocol's
    curve.
    """
    junction = asked.junction
    vut = asked.vut
    try:
        turn = pick_turn(asked.case.turn, asked.vut_speed_kmh)
    except InputError as error:
        raise CannotCarryError(error.words) from None
    movement: Movement = "left" if asked.case.turn == "far" else "right"
    joined = ways.joints(junction, asked.arm, target, movement)
    found = [
        (junction.followed(before), connection, after)
        for before, connection, after in joined
    ]
    lines: list[Callable[[], ways.Turning]] = [
        partial(ways.along_connection, before, connection, after, vut)
        for before, connection, after in found
        if connection is not None
    ]
    if asked.is_at_ring:
        # The protocol's curve would lead over the island.
        return lines
    for before, _, after in found:
        lines.append(partial(ways.on_straights, before, after, turn, vut))
        if ways.is_bent(before, is_in=True) or ways.is_bent(after, is_in=False):
            lines.append(partial(ways.on_lanes, before, after, turn, vut))
    return lines


def _lay_turn(asked: _Asked, target: Arm, turn: Callable[[], ways.Turning]) -> Staging:
    """A turn of the VUT across the way of a pedestrian or cyclist."""
    case = asked.case
    turning = turn()
    vru_way, vru_m = _turning_way(asked, target, turning)
    vut_distance_m, vru_distance_m = staging.find_meeting(
        case,
        vut=asked.vut,
        vut_path=turning.path_with(0.0),
        vru_line=vru_way.tangent(vru_m),
        search_m=(0.0, turning.turn_m + lane_length_m(target.exit_lanes[0])),
    )
    travel_m = _travel_m(case, vru_distance_m)
    vru_begin_s = -_travel_s(case, travel_m)
    vut_path, begin_s = _turned(asked, turning, vut_distance_m, -vru_begin_s)
    vru_m += vru_distance_m - travel_m
    encounter = _set_off(
        asked, vut_path, begin_s, vru_way, vru_m, vru_begin_s=vru_begin_s
    )
    return Staging(encounter=encounter, obstruction=())


def _turned(
    asked: _Asked, turning: ways.Turning, vut_distance_m: float, vru_s: float
) -> tuple[Path, float]:
    """The VUT's path through a turn, and when the run begins, in s.

    The path has a straight part before the turn.
    """
    speed_mps = asked.vut_speed_kmh * MPS_PER_KMH
    curve_s = vut_distance_m / speed_mps + staging.load_way_rules().start_before_curve_s
    begin_s = -max(vru_s, curve_s)
    straight_m = -begin_s * speed_mps - vut_distance_m
    if turning.is_straight:
        ways.check_straight(
            ways.StraightWay(line=turning.entry), turning.entry_lane, straight_m
        )
    return turning.path_with(straight_m), begin_s


def _oncoming(asked: _Asked, entry: Line) -> Iterator[_Lay]:
    """Ways of a vehicle that comes towards the VUT and drives straight on past it."""
    ahead = ways.arm_ahead(asked.junction, asked.arm, entry)
    if ahead is None or not ahead.entry_lanes:
        raise NoRoadError(Phrase("no lane leads towards the VUT from straight ahead"))
    if not asked.arm.exit_lanes:
        raise NoRoadError(
            Phrase(
                "no lane leads out of the junction to the {arm}",
                arm=Phrase(asked.arm.name),
            )
        )
    yield from _ways_through(asked.junction, ahead, asked.arm, asked.case.vru)


def _lay_turn_across(
    asked: _Asked, turn: Callable[[], ways.Turning], across: _Lay
) -> Staging:
    """A turn across the way of an oncoming vehicle.

    Its front is where the VUT's front axle will cross its way, when the VUT's front is
    short of there by what the vehicle is wide at 45 degrees, or where it is to meet the
    middle of that front, by nothing.
    """
    case = asked.case
    vut = asked.vut
    turning = turn()
    vru_way = across().way
    path = turning.path_with(0.0)
    search_m = turning.turn_m + vut.length_m
    crossing_m, vru_m = staging.find_crossing(vut, path, vru_way.tangent, search_m)
    if case.meets_corner:
        short_m = case.vru.width_m / np.sqrt(2.0)
    else:
        short_m = 0.0
    vut_distance_m = (
        crossing_m - (0.5 * vut.length_m - vut.front_axle_ahead_m) - short_m
    )
    vru_s = _travel_s(case, _travel_m(case, 0.0))
    vut_path, begin_s = _turned(asked, turning, vut_distance_m, vru_s)
    travel_m = -begin_s * case.vru_speed_kmh * MPS_PER_KMH
    vru_m = vru_m - case.vru_reference_m - travel_m
    encounter = _set_off(asked, vut_path, begin_s, vru_way, vru_m)
    return Staging(encounter=encounter, obstruction=())


def _turning_way(
    asked: _Asked, target: Arm, turning: ways.Turning
) -> tuple[ways.Way, float]:
    """The VRU's way, and its station at the lane into which the VUT turns.

    There the VRU crosses that lane.
    """
    case = asked.case
    entry = turning.entry
    rules = staging.load_way_rules()
    assert case.vru_line is not None
    if case.vru_direction == "same":
        direction = entry.direction
    else:
        direction = -entry.direction
    if case.vru_line.along == "crosswalk":
        exit_m, point = turning.exit_way.crossing(target.crosswalk)
        exit_line = turning.exit_way.direction(exit_m)
        along = float(direction @ exit_line.direction)
        if abs(along) > np.sin(np.radians(rules.max_skew_deg)):
            # Askew: across the lane, not along the other one.
            direction = exit_line.left * np.sign(direction @ exit_line.left)
        return ways.StraightWay(line=Line(point_m=point, direction=direction)), 0.0
    if asked.is_at_ring:
        return _ring_edge(asked, target, turning)
    ridden_m = _travel_m(case, 0.0)
    lane, is_in, left_m = _kerb(case, asked.arm)
    beside = ways.straight_line(lane, is_in=is_in)
    line = Line(point_m=beside.at(0.0, left_m), direction=direction)
    way = _ridden_lane(asked, entry)
    if turning.is_straight and _is_along(way, line, ridden_m, rules.max_kerb_step_m):
        way = ways.StraightWay(line=line)
    _, way, vru_m = _meet(turning.exit_way, way)
    return way, vru_m


def _ring_edge(
    asked: _Asked, target: Arm, turning: ways.Turning
) -> tuple[ways.Way, float]:
    """As :func:`_turning_way`, of a cyclist who rides around a roundabout.

    Who comes the VUT's way to its right, or towards it to its left, rides with the
    traffic of the ring.
    """
    case = asked.case
    assert case.vru_line is not None
    outside_m = max(case.vru_line.left_m, staging.load_way_rules().ring_edge_m)
    edge: ways.Way = ways.edge_way(asked.junction, target, outside_m)
    if (case.turn == "near") != (case.vru_direction == "same"):
        edge = ways.reversed_way(edge)
    assert isinstance(edge, ways.CurvedWay)
    exit_m = lane_length_m(target.exit_lanes[0])
    length_m = turning.turn_m + min(exit_m, _EDGE_SEARCH_M)
    return edge, ways.last_crossing(turning.path_with(0.0), edge, length_m)


def _kerb(case: Case, arm: Arm) -> tuple[Lane, bool, float]:
    """Where cyclists ride beside the approach road on the side of the turn.

    A lane, whether it leads into the junction, and metres to the left of its middle.
    """
    assert case.vru_line is not None
    side = -1.0
    cycleways = arm.cycleways_out
    if case.turn == "near":
        lane = arm.lanes_in[0]
        is_in = True
        cycleways = arm.cycleways_in
    elif arm.lanes_out:
        lane = arm.lanes_out[0]
        is_in = False
    else:
        # A one-way road: the kerb is to the left of its lanes.
        lane = arm.lanes_in[-1]
        is_in = True
        side = 1.0
        cycleways = ()
    if cycleways:
        return cycleways[0], is_in, 0.0
    return lane, is_in, side * (0.5 * lane.width_m + case.vru_line.left_m)


def _ridden_lane(asked: _Asked, entry: Line) -> ways.Way:
    """The way along the kerb of the arm from which the cyclist comes."""
    case = asked.case
    assert case.vru_line is not None
    if case.vru_direction == "same":
        lane, is_in, left_m = _kerb(case, asked.arm)
        is_against = not is_in
    else:
        ahead = ways.arm_ahead(asked.junction, asked.arm, entry)
        lanes = (
            ()
            if ahead is None
            else ahead.lanes_in
            if case.turn == "far"
            else ahead.lanes_out
        )
        if ahead is None or not lanes:
            raise NoRoadError(
                Phrase("no lane lies ahead from which the cyclist could come")
            )
        is_against = case.turn == "near"
        is_in = not is_against
        lane = lanes[0]
        left_m = -(0.5 * lanes[0].width_m + case.vru_line.left_m)
        if cycleways := ahead.cycleways_out if is_against else ahead.cycleways_in:
            lane = cycleways[0]
            left_m = 0.0
    ridden_m = _travel_m(case, 0.0)
    way = ways.lane_way(lane, is_in=is_in, length_m=ridden_m)
    if is_against:
        way = ways.reversed_way(way)
        left_m = -left_m
    return way.offset(left_m, 0.0, back_m=ridden_m)[0]


def _is_along(way: ways.Way, line: Line, ridden_m: float, tolerance_m: float) -> bool:
    """True if a way stays on a line, from the mouth back to where the VRU sets off."""
    stations = np.linspace(-ridden_m, 0.0, 20)
    points = np.array([way.tangent(float(station)).point_m for station in stations])
    return bool((np.abs(line.coordinates(points)[:, 1]) <= tolerance_m).all())


def _travel_m(case: Case, vru_distance_m: float) -> float:
    """The VRU's way from rest to the impact, in metres.

    `vru_distance_m` is how far its middle is past the line's point.

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
        raise CannotCarryError(
            Phrase("the VUT would reach the VRU's path before the VRU sets off")
        )
    return travel_m


def _travel_s(case: Case, travel_m: float) -> float:
    """Time that the VRU needs for its way to the impact, in seconds."""
    if case.vru_speed_kmh == 0.0:
        assert case.steady_time_s is not None
        return case.steady_time_s
    speed_mps = case.vru_speed_kmh * MPS_PER_KMH
    run_up_m = case.acceleration_distance_m
    return travel_time_s(
        travel_m, speed_mps=speed_mps, acceleration_distance_m=run_up_m
    )
