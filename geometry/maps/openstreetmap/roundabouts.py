"""Ways around roundabouts: lanes from each entry to the exits of the other arms.

A way follows its arm, rounds the kerb into the ring, follows the ring in the
direction of traffic, and rounds the kerb into the arm by which it leaves. The
lanes of the ring run beside a smooth closed line through its nodes.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from itertools import count
from typing import Any, NamedTuple

import numpy as np
import shapely

from ...arrays import FloatArray
from ...lines import along_m, apart, cross, length_m, points_at, unit
from ...scene import area_of, paved_area
from ..source_map import MapJunction, MapLane, polygons_of
from .elements import DEFAULTS
from .junctions import Ring, StreetArm, group_arms
from .network import Street, Strip, axis_points, stations_between, surface
from .rings import RingError, Stretch, find_stretches, ring_axis, ring_of

_STEP_M = 0.5
# A way is led straight on beyond its end to find where it meets the ring.
_AHEAD_M = 60.0
# Parts of the ring before and behind a way that are looked at.
_MARGIN_SHARE = 0.24
# Ways that meet at less need no rounding.
_STRAIGHT_ON_DEG = 10.0
# Of the radius of a corner, from try to try.
_TIGHTER = 0.85
# Nearer points are one.
_APART_M = 0.1
# Over which a lane shifts aside.
_SHIFT_M = 10.0
# A lane that a way begins with lies so near to its strip.
_SAME_LANE_M = 3.0
# Half a car, and how far it may be beyond the rounded outline.
_HALF_CAR_M = 0.9
_TOLERANCE_M = 0.3
# Smaller islands are none.
_LEAST_ISLAND_M2 = 3.0
_AGAINST = "a roundabout whose ring runs against the side of traffic"
_NO_ISLAND = "a roundabout whose ring leaves no room for an island"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Loop:
    """The ring as a closed line in driving direction.

    Attributes
    ----------
    axis : Any
        Area within the line through its nodes, a shapely polygon.
    lanes_m : tuple of (n, 2) float
        Closed middles of its lanes, from the outer kerb. [m]
    width_m : float
        Of a lane. [m]
    islands_m : tuple of (n, 2) float
        What it leads around. [m]
    """

    axis: Any
    lanes_m: tuple[FloatArray, ...]
    width_m: float
    islands_m: tuple[FloatArray, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Mouth:
    """An arm with its lanes from the kerb, by their numbers there.

    Attributes
    ----------
    arm : StreetArm
        The street away from the junction.
    group : int
        Number of the road that it is part of.
    lanes_in, lanes_out : dict of int to MapLane
        Lanes into the junction and out of it.
    """

    arm: StreetArm
    group: int
    lanes_in: dict[int, MapLane]
    lanes_out: dict[int, MapLane]

    @property
    def row(self) -> int:
        """Row of the node at which the arm begins."""
        return int(self.arm.street.rows[0])


def lay_roundabouts(
    rings: Sequence[Ring],
    junctions: Sequence[MapJunction],
    lanes: Sequence[MapLane],
    *,
    keeps_left: bool,
) -> tuple[list[MapJunction], list[MapLane]]:
    """Islands of roundabouts, and the lanes that lead around them.

    Parameters
    ----------
    rings : sequence of Ring
        The map's roundabouts.
    junctions : sequence of MapJunction
        All junctions.
    lanes : sequence of MapLane
        Lanes outside junctions.
    keeps_left : bool
        Traffic keeps left.

    Returns
    -------
    junctions : list of MapJunction
        In the same order. Roundabouts have islands, or a fault where their ways
        cannot be laid.
    connections : list of MapLane
        From the ends of lanes to the begins of others.
    """
    of_id = {junction.id: junction for junction in junctions}
    connections: list[MapLane] = []
    for ring in rings:
        junction = of_id[ring.junction]
        try:
            whole, ways = _lay(ring, junction, lanes, keeps_left=keeps_left)
        except RingError as error:
            of_id[ring.junction] = replace(junction, fault=str(error))
            continue
        connections += ways
        of_id[ring.junction] = whole
    return [of_id[junction.id] for junction in junctions], connections


def _lay(
    ring: Ring,
    junction: MapJunction,
    lanes: Sequence[MapLane],
    *,
    keeps_left: bool,
) -> tuple[MapJunction, list[MapLane]]:
    """A roundabout with its islands, and the lanes around it.

    Raises
    ------
    RingError
        They cannot be laid.
    """
    stretches = list(find_stretches(ring.inside))
    loop = _build_loop(stretches, keeps_left=keeps_left)
    mouths = _mouths(ring, lanes, keeps_left=keeps_left)
    ways: list[MapLane] = []
    surfaces = [area_of(junction.outline_m)]
    for one in mouths:
        for other in mouths:
            if one.group == other.group or not one.lanes_in or not other.lanes_out:
                continue
            for way, legs in _ways(one, other, stretches, loop, keeps_left=keeps_left):
                way = replace(way, from_junction=junction.id, to_junction=junction.id)
                ways.append(way)
                surfaces += legs
    # Where carriageways part, the road is as wide as the lanes that part there.
    outline = max(polygons_of(shapely.union_all(surfaces)), key=lambda one: one.area)
    outline_m = np.asarray(shapely.simplify(outline.exterior, 0.02).coords)[:-1]
    paved = paved_area(outline_m, loop.islands_m)
    roads = [surface(mouth.arm.street, 0.0, mouth.arm.mouth_m) for mouth in mouths]
    free = shapely.union_all([paved, *roads]).buffer(_TOLERANCE_M)
    shapely.prepare(free)
    for way in ways:
        line = shapely.LineString(way.centreline_m)
        if not shapely.contains(free, line.buffer(_HALF_CAR_M, cap_style="flat")):
            raise RingError(f"a roundabout whose way {way.id} leaves the carriageway")
    return replace(junction, outline_m=outline_m, islands_m=loop.islands_m), ways


# ---------- the ring
def _build_loop(stretches: Sequence[Stretch], *, keeps_left: bool) -> _Loop:
    """The ring of a roundabout.

    Raises
    ------
    RingError
        It is not closed, not the only one, runs the wrong way round, or leaves no
        room.
    """
    ring = ring_of(stretches)
    axis = ring_axis(ring)
    is_clockwise = not axis.exterior.is_ccw
    if is_clockwise != keeps_left:
        raise RingError(_AGAINST)
    sections = [section for one in ring for section in one.street.sections]
    # Where the number of lanes changes, those that lead all the way round count.
    section = min(sections, key=lambda one: len(one.lanes(is_forward=True)))
    strips = section.lanes(is_forward=True)
    lanes_m = []
    for strip in strips:
        inwards_m = strip.left_m
        if is_clockwise:
            inwards_m = -strip.left_m
        middle = axis.buffer(-inwards_m, quad_segs=32)
        if middle.geom_type != "Polygon" or middle.is_empty:
            raise RingError(_NO_ISLAND)
        line_m = np.asarray(middle.exterior.coords)
        if middle.exterior.is_ccw == is_clockwise:
            line_m = line_m[::-1]
        lanes_m.append(line_m)
    inner = axis.buffer(-0.5 * max(one.width_m for one in sections), quad_segs=32)
    crossing = [
        surface(one.street, 0.0, one.street.length_m)
        for one in stretches
        if not one.is_ring
    ]
    rest = inner.difference(shapely.union_all(crossing))
    islands_m = tuple(
        np.asarray(shapely.simplify(part.exterior, 0.02).coords)[:-1]
        for part in polygons_of(rest)
        if part.area >= _LEAST_ISLAND_M2
    )
    if not islands_m:
        raise RingError(_NO_ISLAND)
    return _Loop(
        axis=axis,
        lanes_m=tuple(lanes_m),
        width_m=min(strip.width_m for strip in strips),
        islands_m=islands_m,
    )


# ---------- arms and the lanes at their mouths
def _mouths(ring: Ring, lanes: Sequence[MapLane], *, keeps_left: bool) -> list[_Mouth]:
    """Arms of a roundabout with the lanes of the map that begin or end there."""
    mouths = []
    for number, group in enumerate(group_arms(ring.arms)):
        for index in group:
            arm = ring.arms[index]
            mouths.append(_Mouth(arm=arm, group=number, lanes_in={}, lanes_out={}))
    for is_in in (True, False):
        for lane in lanes:
            junction, tip_m = lane.from_junction, lane.centreline_m[0, :2]
            if is_in:
                junction, tip_m = lane.to_junction, lane.centreline_m[-1, :2]
            if lane.kind != "driving" or junction != ring.junction:
                continue
            places = []
            for at, mouth in enumerate(mouths):
                for number, place_m in _places(mouth.arm, is_in=is_in):
                    away_m = float(np.hypot(*(place_m - tip_m)))
                    places.append((away_m, at, number))
            away_m, at, number = min(places, default=(np.inf, 0, 0))
            if away_m <= _SAME_LANE_M:
                found = mouths[at].lanes_in if is_in else mouths[at].lanes_out
                found[number] = lane
    return mouths


def _places(arm: StreetArm, *, is_in: bool) -> Iterator[tuple[int, FloatArray]]:
    """Number from the kerb and middle (2,) of each lane at an arm's mouth."""
    (middle,), (across,) = axis_points(arm.street, [arm.mouth_m])
    for strip in arm.street.lanes_at(arm.mouth_m, is_forward=not is_in):
        yield strip.number, middle + strip.left_m * across


# ---------- ways from arm to arm
def _ways(
    one: _Mouth,
    other: _Mouth,
    stretches: Sequence[Stretch],
    loop: _Loop,
    *,
    keeps_left: bool,
) -> Iterator[tuple[MapLane, list[Any]]]:
    """Lanes from one arm into another, none of which crosses another one.

    With them comes the surface of the ways between their arms and the ring.

    Raises
    ------
    RingError
        A way is too tight.
    """
    route = _route(one, other, stretches, keeps_left=keeps_left)
    if route is None:
        return
    on_ring = [at for at, stretch in enumerate(route) if stretch.is_ring]
    links_in = route
    links_out: list[Stretch] = []
    if on_ring:
        links_in = route[: on_ring[0]]
        links_out = route[on_ring[-1] + 1 :]
    arm_in = one.arm.street.reversed()
    way_in = _chained([arm_in, *(link.street for link in links_in)])
    way_out = _chained([*(link.street for link in links_out), other.arm.street])
    begin_m = arm_in.length_m - one.arm.mouth_m
    end_m = way_out.length_m - other.arm.street.length_m + other.arm.mouth_m
    for before, after, ring_lane in _lane_pairs(one, other, len(loop.lanes_m)):
        entry = one.lanes_in[before]
        leaving = other.lanes_out[after]
        name = f"{entry.id} to {leaving.id}"
        span_in_m = (begin_m, way_in.length_m)
        leg_in = _leg(way_in, span_in_m, before, keeps_left=keeps_left)
        leg_out = _leg(way_out, (0.0, end_m), after, keeps_left=keeps_left)
        if on_ring:
            middle_m = loop.lanes_m[ring_lane]
            line_m = _around(leg_in, middle_m, leg_out, name)
        else:
            line_m = _joined(leg_in, leg_out, name)
        tips_m = (entry.centreline_m[-1, :2], leaving.centreline_m[0, :2])
        line_m = _between(line_m, *tips_m)
        legs = []
        for links, leg, lane in (
            (links_in, leg_in, entry),
            (links_out, leg_out, leaving),
        ):
            if links:
                line = shapely.LineString(leg.line_m)
                legs.append(line.buffer(0.5 * lane.width_m, cap_style="flat"))
        way = MapLane(
            id=name,
            kind="driving",
            width_m=min(entry.width_m, leaving.width_m, loop.width_m),
            centreline_m=np.column_stack([line_m, np.zeros(len(line_m))]),
        )
        yield way, legs


def _route(
    one: _Mouth,
    other: _Mouth,
    stretches: Sequence[Stretch],
    *,
    keeps_left: bool,
) -> list[Stretch] | None:
    """The shortest way through the junction, or None if there is none.

    Short cuts from one place of the ring to another are not taken. Between arms
    that meet the ring at the same node it is empty where the next one lies beside
    the kerb, else once around.
    """
    if one.row == other.row:
        ahead = -one.arm.direction
        aside = cross(ahead, other.arm.direction)
        if (aside > 0.0) == keeps_left:
            return []
    on_ring = {one.begin for one in stretches if one.is_ring}
    leading: dict[int, list[Stretch]] = defaultdict(list)
    for stretch in stretches:
        if stretch.is_ring or not {stretch.begin, stretch.end} <= on_ring:
            leading[stretch.begin].append(stretch)
    numbers = count()
    waiting: list[tuple[float, int, int, list[Stretch]]] = []

    def look_on(row: int, far_m: float, path: list[Stretch]) -> None:
        for stretch in leading[row]:
            next_m = far_m + stretch.street.length_m
            longer = [*path, stretch]
            heappush(waiting, (next_m, next(numbers), stretch.end, longer))

    look_on(one.row, 0.0, [])
    seen: set[int] = set()
    while waiting:
        far_m, _, row, path = heappop(waiting)
        if row == other.row:
            return path
        if row not in seen:
            seen.add(row)
            look_on(row, far_m, path)
    return None


def _lane_pairs(
    one: _Mouth, other: _Mouth, n_ring: int
) -> Iterator[tuple[int, int, int]]:
    """Numbers of a lane in, a lane out, and the lane of the ring between them.

    All count from the kerb, so that ways of one arm into another do not cross.
    Where lanes are more on one side, the last ones share.

    Yields
    ------
    numbers : (int, int, int)
        Of the lane in, the lane out, and the lane of the ring.
    """
    for ring_lane in range(n_ring):
        before = _of_ring(one.lanes_in, ring_lane, n_ring)
        # Where the arm has fewer lanes, the last one takes in those of the ring.
        after = _of_ring(other.lanes_out, ring_lane, n_ring)
        after = after or [max(other.lanes_out)]
        if not before:
            continue
        for at in range(max(len(before), len(after))):
            first = before[min(at, len(before) - 1)]
            second = after[min(at, len(after) - 1)]
            yield first, second, ring_lane


def _of_ring(lanes: Mapping[int, MapLane], ring_lane: int, n_ring: int) -> list[int]:
    """Numbers of an arm's lanes that lead to or from a lane of the ring.

    To the innermost one those lead for which the ring has no lane of their own.
    """
    if ring_lane == n_ring - 1:
        return [number for number in sorted(lanes) if number >= ring_lane]
    return [number for number in sorted(lanes) if number == ring_lane]


# ---------- lines
class _Leg(NamedTuple):
    """A way between an arm's mouth and the ring.

    Attributes
    ----------
    line_m : (n, 2) float
        In driving direction. [m]
    radius_m : float
        With which it rounds the kerb. [m]
    """

    line_m: FloatArray
    radius_m: float


def _chained(streets: Sequence[Street]) -> Street:
    """Streets one after the other as one."""
    return Street(parts=tuple(part for street in streets for part in street.parts))


def _leg(
    street: Street, span_m: tuple[float, float], number: int, *, keeps_left: bool
) -> _Leg:
    """Middle of a lane along a street, between two stations.

    Parameters
    ----------
    street : Street
        In driving direction.
    span_m : (float, float)
        Begin and end along it. [m]
    number : int
        Of the lane, from the kerb; where there are fewer, the last one counts.
    keeps_left : bool
        Traffic keeps left.

    Returns
    -------
    leg : _Leg
        Its lane shifts aside next to where the cross-section changes.
    """
    begin_m, end_m = span_m
    stations: list[float] = []
    lefts: list[float] = []
    radius_m = 0.0
    for index, section in enumerate(street.sections):
        low = max(begin_m, float(street.breaks_m[index]))
        high = min(end_m, float(street.breaks_m[index + 1]))
        strips = section.lanes(is_forward=True)
        if high - low < 1e-3 or not strips:
            continue
        strip = strips[min(number, len(strips) - 1)]
        half_m = 0.5 * (high - low)
        before_m, after_m = (
            min(_shift_m(street, index, beside), half_m)
            for beside in (index - 1, index + 1)
        )
        stations += [low + before_m, high - after_m]
        lefts += (strip.left_m + street.left_m(index, stations[-2:])).tolist()
        radius_m = DEFAULTS["roundabout"]["corner_m"] + _from_kerb_m(
            section.width_m, strip, keeps_left=keeps_left
        )
    at = stations_between(street, begin_m, end_m, stations)
    middle, across = axis_points(street, at)
    left_m = np.interp(at, stations, lefts)
    return _Leg(middle + left_m[:, None] * across, radius_m)


def _shift_m(street: Street, index: int, beside: int) -> float:
    """Length over which lanes of a part shift towards those of the one beside it.

    Where carriageways part, those of both directions stay, and the others shift.
    """
    if not 0 <= beside < len(street.sections):
        return 0.0
    is_two_way = len(street.sections[index].directions) > 1
    if is_two_way == (len(street.sections[beside].directions) > 1):
        return 0.5 * _SHIFT_M
    if is_two_way:
        return 0.0
    return 2.0 * _SHIFT_M


def _from_kerb_m(width_m: float, strip: Strip, *, keeps_left: bool) -> float:
    """Distance of a lane's middle from the kerb of its side, in metres."""
    if keeps_left:
        return 0.5 * width_m - strip.left_m
    return 0.5 * width_m + strip.left_m


def _around(leg_in: _Leg, ring_m: FloatArray, leg_out: _Leg, name: str) -> FloatArray:
    """Line along a way to the ring, around it and along the way out of it.

    Where the rounded kerbs of both meet before the ring, it does not reach the ring.

    Parameters
    ----------
    leg_in, leg_out : _Leg
        To the ring, and away from it.
    ring_m : (n, 2) float
        A lane of the ring, closed. [m]
    name : str
        Of the lane.

    Returns
    -------
    line_m : (k, 2) float
        In driving direction. [m]

    Raises
    ------
    RingError
        It would be too tight.
    """
    whole_m = length_m(ring_m)
    enters_m = _met_m(ring_m, leg_in.line_m[-1])
    driven_m = (_met_m(ring_m, leg_out.line_m[0]) - enters_m) % whole_m
    leaves_m = enters_m + driven_m
    # Looked at are half of the ring and a margin, so that ways meet it once.
    half_m = 0.5 * whole_m
    margin_m = _MARGIN_SHARE * whole_m
    into_m = _opened(ring_m, enters_m - margin_m, enters_m + half_m)
    out_of_m = _opened(ring_m, leaves_m - half_m, leaves_m + margin_m)
    first = _corner(
        leg_in.line_m, into_m, leg_in.radius_m, near_m=leg_in.line_m[-1], name=name
    )
    last = _corner(
        out_of_m, leg_out.line_m, leg_out.radius_m, near_m=leg_out.line_m[0], name=name
    )
    begin_m = enters_m - margin_m + first.after_m
    end_m = leaves_m - half_m + last.before_m
    if begin_m > end_m:
        return _joined(leg_in, leg_out, name)
    begin = leg_in.line_m[along_m(leg_in.line_m) < first.before_m]
    end = leg_out.line_m[along_m(leg_out.line_m) > last.after_m]
    between = _opened(ring_m, begin_m, end_m)
    return np.concatenate([begin, first.arc_m, between, last.arc_m, end])


def _opened(ring_m: FloatArray, begin_m: float, end_m: float) -> FloatArray:
    """Part of a closed line between two stations, which may lie beyond its ends."""
    n_points = max(2, int((end_m - begin_m) / _STEP_M) + 1)
    stations = np.linspace(begin_m, end_m, n_points)
    return points_at(ring_m, stations % length_m(ring_m))


def _met_m(ring_m: FloatArray, point_m: FloatArray) -> float:
    """Station of a ring that is nearest to a point, in metres."""
    return _station_m(shapely.LineString(ring_m), point_m)


def _joined(leg_in: _Leg, leg_out: _Leg, name: str) -> FloatArray:
    """Line along one way and on along another, with the corner rounded."""
    radius_m = max(leg_in.radius_m, leg_out.radius_m)
    corner = _corner(
        leg_in.line_m, leg_out.line_m, radius_m, near_m=leg_in.line_m[-1], name=name
    )
    begin = leg_in.line_m[along_m(leg_in.line_m) < corner.before_m]
    end = leg_out.line_m[along_m(leg_out.line_m) > corner.after_m]
    return np.concatenate([begin, corner.arc_m, end])


class _Corner(NamedTuple):
    """An arc that leads from one line into another.

    Attributes
    ----------
    before_m : float
        Station of the first line at which it begins. [m]
    after_m : float
        Station of the second line at which it ends. [m]
    arc_m : (n, 2) float
        Its points. [m]
    """

    before_m: float
    after_m: float
    arc_m: FloatArray


def _corner(
    before_m: FloatArray,
    after_m: FloatArray,
    radius_m: float,
    *,
    near_m: FloatArray,
    name: str,
) -> _Corner:
    """The arc between two lines that would meet at an angle.

    Its middle lies where lines beside both of them, a radius away, meet. Where the
    arc does not fit between the ends of the lines, its radius is smaller.

    Parameters
    ----------
    before_m : (n, 2) float
        Line into the corner; it goes straight on beyond its end. [m]
    after_m : (k, 2) float
        Line out of it; it comes straight to its begin. [m]
    radius_m : float
        Largest radius. [m]
    near_m : (2,) float
        Of the places where the lines meet the one nearest to this counts. [m]
    name : str
        Of the lane.

    Returns
    -------
    corner : _Corner
        Stations count along the lines as they are given.

    Raises
    ------
    RingError
        No radius fits.
    """
    beyond_m = before_m[-1] + _AHEAD_M * unit(before_m[-1] - before_m[-2])
    ahead_m = after_m[0] - _AHEAD_M * unit(after_m[1] - after_m[0])
    before = shapely.LineString(np.vstack([before_m, beyond_m]))
    after = shapely.LineString(np.vstack([ahead_m, after_m]))
    places = shapely.get_coordinates(shapely.intersection(before, after))
    if not len(places):
        places = shapely.get_coordinates(shapely.shortest_line(before, after))
    place = places[np.hypot(*(places - near_m).T).argmin()]
    meets_m = [_station_m(line, place) for line in (before, after)]
    ways = [
        _way_at(line, at) for line, at in zip((before, after), meets_m, strict=True)
    ]
    turn = float(np.arctan2(cross(*ways), ways[0] @ ways[1]))
    if abs(turn) < np.radians(_STRAIGHT_ON_DEG):
        return _Corner(meets_m[0], meets_m[1] - _AHEAD_M, place[None])
    least_m = DEFAULTS["roundabout"]["least_radius_m"]
    most_m = _AHEAD_M + length_m(after_m)
    while radius_m >= least_m:
        sideways_m = np.sign(turn) * radius_m
        beside = [shapely.offset_curve(line, sideways_m) for line in (before, after)]
        middles = shapely.get_coordinates(shapely.intersection(*beside))
        fitting = []
        for middle in middles:
            begin_m = _station_m(before, middle)
            end_m = _station_m(after, middle)
            is_there = 0.0 < begin_m <= meets_m[0] and meets_m[1] <= end_m < most_m
            if is_there:
                run_m = meets_m[0] - begin_m + end_m - meets_m[1]
                fitting.append((run_m, begin_m, end_m, middle))
        if fitting:
            _, begin_m, end_m, middle = min(fitting, key=lambda one: one[0])
            ends = [_point_at(before, begin_m), _point_at(after, end_m)]
            arc_m = _arc(middle, *ends, is_left=turn > 0.0)
            return _Corner(begin_m, end_m - _AHEAD_M, arc_m)
        radius_m *= _TIGHTER
    why = f"a roundabout whose way {name} is tighter than {least_m:g} m"
    raise RingError(why)


def _station_m(line: Any, point_m: FloatArray) -> float:
    """Station of a line that is nearest to a point, in metres."""
    return float(shapely.line_locate_point(line, shapely.Point(point_m)))


def _point_at(line: Any, station_m: float) -> FloatArray:
    """Point (2,) of a line at a station."""
    point = shapely.line_interpolate_point(line, station_m)
    place_m: FloatArray = shapely.get_coordinates(point)[0]
    return place_m


def _way_at(line: Any, station_m: float) -> FloatArray:
    """Unit vector along a line at a station, (2,)."""
    begin = _point_at(line, max(station_m - 0.5 * _STEP_M, 0.0))
    return unit(_point_at(line, station_m + 0.5 * _STEP_M) - begin)


def _arc(
    middle_m: FloatArray, begin_m: FloatArray, end_m: FloatArray, *, is_left: bool
) -> FloatArray:
    """Points (n, 2) around a middle from one point to another, in metres."""
    angles = [np.arctan2(*(point - middle_m)[::-1]) for point in (begin_m, end_m)]
    turned = (angles[1] - angles[0]) % (2.0 * np.pi)
    if not is_left:
        turned -= 2.0 * np.pi
    radius_m = float(np.hypot(*(begin_m - middle_m)))
    n_points = max(3, int(abs(turned) * radius_m / _STEP_M) + 1)
    at = angles[0] + np.linspace(0.0, turned, n_points)
    return np.asarray(middle_m + radius_m * np.stack([np.cos(at), np.sin(at)], axis=1))


def _between(line_m: FloatArray, begin_m: FloatArray, end_m: FloatArray) -> FloatArray:
    """Line that begins and ends at the ends of other lanes.

    Parameters
    ----------
    line_m : (n, 2) float
        Its ends lie near. [m]
    begin_m, end_m : (2,) float
        Where it begins and ends. [m]

    Returns
    -------
    line_m : (n, 2) float
        Shifted within 10 m of its ends. [m]
    """
    line = apart(line_m, _APART_M)
    along = along_m(line)
    first = np.clip(1.0 - along / _SHIFT_M, 0.0, 1.0)[:, None]
    last = np.clip(1.0 - (along[-1] - along) / _SHIFT_M, 0.0, 1.0)[:, None]
    shifted = line + first * (begin_m - line[0]) + last * (end_m - line[-1])
    # The exact ends stand for what lies next to them.
    to_ends_m = [np.hypot(*(shifted - tip).T) for tip in (begin_m, end_m)]
    is_inside = np.minimum(*to_ends_m) > _APART_M
    return np.vstack([begin_m, shifted[is_inside], end_m])
