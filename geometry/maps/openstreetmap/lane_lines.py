"""Lines of lanes: cross-sections laid along the streets.

A street is cut at the breaks between its edges. Each strip of a
cross-section becomes a part on each stretch, and parts that continue each
other become one lane. Where carriageways part or merge, the ends of their
lanes are bent towards each other. Lanes of a ramp or slip road begin beside
the lane of the road that it leaves, or go on from lanes that end there.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import shapely
from scipy.spatial import cKDTree

from ...arrays import FloatArray
from ...lines import along_m, cross, points_at, unit
from ...scene import RoadUser
from ..source_map import MapLane
from .elements import DEFAULTS
from .junctions import Reach
from .network import (
    Street,
    Strip,
    axis_points,
    closed_to,
    has_no_knot,
    speed_limit_kmh,
    stations_between,
)

# Between the end of one carriageway and the lane it leads into.
_BESIDE_END_M = 12.0
_MIN_LENGTH_M = 0.5
# Kinds of lanes that are numbered together, from the kerb.
_DRIVEN = ("driving", "bus")
# Pieces of a lane whose ends are as near as this are one after the other.
_SAME_POINT_M = 0.5
# Cosine of the angle between them.
_SAME_WAY = 0.5
_BEND_M = 15.0
# Along a branch and the road that it leaves, which tells their directions.
_DIRECTION_M = 10.0
_JUST_BEYOND_M = 0.1
# As far as a branch is led beside the road that it leaves.
_BESIDE_M = 120.0
# Id of a lane, and whether its begin is meant.
_LaneEnd = tuple[str, bool]
# Lanes side by side by their common name, and whether their starts.
_Group = tuple[str, bool]


class _Part(NamedTuple):
    """A lane on one part of a street.

    Attributes
    ----------
    strip : Strip
        Strip of the cross-section that the lane follows.
    span_m : (float, float)
        Begin and end of the part along the street. [m]
    own_left_m : (float, float)
        The middle of the strip at both ends, to the left of the street. [m]
    ends_left_m : (float, float)
        The lane's middle there, where it meets what lies beyond. [m]
    level : int
        Layer of the edge; 0: on the ground.
    limit_kmh : float or None
        Speed limit; None: the tags give none. [km/h]
    is_two_way : bool
        Cars drive in both directions here.
    road_class : str
        Value of the tag ``highway``.
    closed_to : tuple of RoadUser
        Who may not use the road.
    """

    strip: Strip
    span_m: tuple[float, float]
    own_left_m: tuple[float, float]
    ends_left_m: tuple[float, float]
    level: int
    limit_kmh: float | None
    is_two_way: bool
    road_class: str
    closed_to: tuple[RoadUser, ...]


# Id of a lane, and its parts one after the other.
_Piece = tuple[str, list[_Part]]


def build_lanes(reaches: Sequence[Reach]) -> tuple[MapLane, ...]:
    """Lanes of all streets outside junctions, one for each strip.

    If the number of lanes of a direction changes, all of them end, and the
    following ones begin at the same points.

    Parameters
    ----------
    reaches : sequence of Reach
        Parts of streets that have lanes.

    Returns
    -------
    lanes : tuple of MapLane
        Centrelines run in driving direction.
    """
    branches = {one.end: one for one in _branches(reaches)}
    dropped = {one.dropped_at: one.n_lanes for one in branches.values() if one.is_drop}
    found: list[tuple[MapLane, bool]] = []
    settled: set[_LaneEnd] = set()
    for at, reach in enumerate(reaches):
        for lane, is_two_way in _street_lanes(reach, at, dropped):
            for is_begin in (True, False):
                branch = branches.get((at, is_begin))
                if branch is None or lane.kind != "driving":
                    continue
                beside = _beside(lane, branch, is_begin=is_begin)
                if beside is not None:
                    lane = beside
                    settled.add((lane.id, is_begin))
            found.append((lane, is_two_way))
    two_way = {lane.id for lane, is_two_way in found if is_two_way}
    lanes = [lane for lane, _ in found]
    # Lanes that go on into a branch stay, too.
    for lane in lanes:
        for is_begin in (True, False):
            if (lane.id, is_begin) not in settled:
                continue
            tip = _tip(lane, is_begin=is_begin)
            for other in lanes:
                away_m = np.hypot(*(_tip(other, is_begin=not is_begin) - tip)[:2])
                if other.kind == lane.kind and away_m <= _SAME_POINT_M:
                    settled.add((other.id, not is_begin))
    return tuple(_lead_on(lanes, two_way, settled))


# ---------- ramps and slip roads
class _Branch(NamedTuple):
    """End of a one-way road beside the lanes of another one that passes there.

    Attributes
    ----------
    end : (int, bool)
        Index of its reach, and whether cars drive away from this end.
    road : Street
        The road that passes.
    station_m : float
        Where, along that road. [m]
    is_forward : bool
        Cars of both drive along that road, not against it.
    strips : tuple of Strip
        Lanes of the road beside which it leads, from the kerb.
    side : float
        +1 to the left of that road, -1 to its right.
    is_at_kerb : bool
        It leads beside the kerb lane, not beside the other edge.
    n_lanes : int
        Its own lanes.
    is_drop : bool
        They go on from the road's lanes next to the kerb, which end here.
    dropped_at : (int, int, bool)
        Index of the road's reach, of its break there, and `is_forward`.
    drop_m : tuple of float
        Middles of the lanes that end, from the kerb, to the left of the road. [m]
    """

    end: tuple[int, bool]
    road: Street
    station_m: float
    is_forward: bool
    strips: tuple[Strip, ...]
    side: float
    is_at_kerb: bool
    n_lanes: int
    is_drop: bool
    dropped_at: tuple[int, int, bool]
    drop_m: tuple[float, ...]


def _branches(reaches: Sequence[Reach]) -> Iterator[_Branch]:
    """Ends of one-way roads at nodes that another road passes the same way."""
    passing: dict[int, tuple[int, float]] = {}
    for at, reach in enumerate(reaches):
        street = reach.street
        pairs = zip(street.rows[1:-1].tolist(), street.stations_m[1:-1], strict=True)
        for row, station_m in pairs:
            if reach.begin_m < station_m < reach.end_m:
                passing[row] = (at, float(station_m))
    for at, reach in enumerate(reaches):
        street = reach.street
        directions = frozenset.union(*(one.directions for one in street.sections))
        if len(directions) != 1 or street.parts[0][0].is_service:
            continue
        (runs_along,) = directions
        for index, junction in ((0, reach.from_junction), (-1, reach.to_junction)):
            row = int(street.rows[index])
            if junction or row not in passing:
                continue
            branch = _branch(reaches, at, index, runs_along, *passing[row])
            if branch is not None:
                yield branch


def _branch(
    reaches: Sequence[Reach],
    at: int,
    index: int,
    runs_along: bool,
    road_at: int,
    station_m: float,
) -> _Branch | None:
    """A branch, or None if the other road leads another way.

    Parameters
    ----------
    reaches : sequence of Reach
        Parts of streets that have lanes.
    at, index : int
        The one-way road, and 0 for its begin, -1 for its end.
    runs_along : bool
        Cars drive from its begin to its end.
    road_at : int
        The road that passes there.
    station_m : float
        Where. [m]
    """
    own = reaches[at].street
    road = reaches[road_at].street
    is_away = runs_along == (index == 0)
    near_m = 0.0
    far_m = _DIRECTION_M
    if index == -1:
        near_m = own.length_m
        far_m = own.length_m - _DIRECTION_M
    (near, far), _ = axis_points(own, [near_m, far_m])
    way = unit(far - near)
    (before, after), _ = axis_points(
        road, [station_m - _DIRECTION_M, station_m + _DIRECTION_M]
    )
    along = unit(after - before)
    # Seen from the node, the branch lies on the side to which the road goes on, or
    # from which it comes.
    lies_ahead = bool(way @ along > 0.0)
    if abs(way @ along) < _SAME_WAY:
        return None
    is_forward = lies_ahead == is_away
    beyond_m = station_m + _JUST_BEYOND_M
    behind_m = station_m - _JUST_BEYOND_M
    near_at_m = behind_m
    far_at_m = beyond_m
    if lies_ahead:
        near_at_m = beyond_m
        far_at_m = behind_m
    strips = road.lanes_at(near_at_m, is_forward=is_forward)
    others = road.lanes_at(far_at_m, is_forward=is_forward)
    if not strips or not others:
        return None
    side = float(np.sign(cross(along, way)))
    lefts = [strip.left_m for strip in strips]
    is_at_kerb = side * lefts[0] >= side * lefts[-1]
    is_oneway = len(road.section_at(near_at_m).directions) == 1
    if not is_at_kerb and not is_oneway:
        # Between the directions of a road there is no room for it.
        return None
    own_lanes = own.sections[index].lanes(is_forward=runs_along)
    n_lanes = len(own_lanes)
    part = road.part_at(beyond_m)
    is_break = abs(float(road.breaks_m[part]) - station_m) < _JUST_BEYOND_M
    is_drop = is_break and is_at_kerb and len(others) == len(strips) + n_lanes
    return _Branch(
        end=(at, is_away),
        road=road,
        station_m=station_m,
        is_forward=is_forward,
        strips=strips,
        side=side,
        is_at_kerb=is_at_kerb or len(lefts) == 1,
        n_lanes=n_lanes,
        is_drop=is_drop,
        dropped_at=(road_at, part, is_forward),
        drop_m=tuple(strip.left_m for strip in others[:n_lanes]),
    )


def _beside(lane: MapLane, branch: _Branch, *, is_begin: bool) -> MapLane | None:
    """Lane of a branch that begins, or ends, beside the lanes of the road there.

    It stays beside them until its own road has left them.

    Parameters
    ----------
    lane : MapLane
        As its own road has it.
    branch : _Branch
        The end of its road.
    is_begin : bool
        The lane begins there.

    Returns
    -------
    lane : MapLane or None
        None: it ends elsewhere, or its road never leaves the other one.
    """
    if (is_begin and lane.from_junction) or (not is_begin and lane.to_junction):
        return None
    number = int(lane.id.rpartition(" ")[2])
    # Away from where the roads meet.
    line = lane.centreline_m
    if not is_begin:
        line = line[::-1]
    sign = 1.0
    if branch.is_forward != is_begin:
        sign = -1.0
    stations = branch.station_m + sign * np.arange(0.0, _BESIDE_M, 1.0)
    middle, across = axis_points(branch.road, stations)
    away_m = np.hypot(*(middle[0] - line[0, :2]))
    if away_m > _BESIDE_END_M:
        return None
    if branch.is_drop and number < len(branch.drop_m):
        tip = middle[0] + branch.drop_m[number] * across[0]
        moved = _bent(line, np.append(tip, line[0, 2]))
    else:
        strip = branch.strips[0 if branch.is_at_kerb else -1]
        nth = number
        if branch.is_at_kerb:
            nth = branch.n_lanes - 1 - number
        aside_m = 0.5 * strip.width_m + (nth + 0.5) * lane.width_m
        edge = middle + (strip.left_m + branch.side * aside_m) * across
        crossing = shapely.intersection(
            shapely.LineString(edge), shapely.LineString(line[:, :2])
        )
        places = shapely.get_coordinates(crossing)
        if not len(places):
            return None
        edge_line = shapely.LineString(edge)
        own_line = shapely.LineString(line[:, :2])
        # The last place where its road leaves the other one.
        at_m = shapely.line_locate_point(own_line, shapely.points(places))
        leaves_m = float(at_m.max())
        place = places[int(at_m.argmax())]
        along_edge_m = shapely.line_locate_point(edge_line, shapely.Point(place))
        kept = edge[along_m(edge) < along_edge_m - _SAME_POINT_M]
        first = np.vstack([edge[:1], kept[1:], place])
        heights = np.full((len(first), 1), line[0, 2])
        rest = line[along_m(line) > leaves_m + _SAME_POINT_M]
        moved = np.vstack([np.hstack([first, heights]), rest])
    if not is_begin:
        moved = moved[::-1]
    return replace(lane, centreline_m=moved)


def _street_lanes(
    reach: Reach, at_reach: int, dropped: Mapping[tuple[int, int, bool], int]
) -> Iterator[tuple[MapLane, bool]]:
    """Lanes of one street, and whether cars drive both ways at their end.

    Walks along the parts of the street. A lane stays open as long as the next
    part has the same strip and the same number of lanes; otherwise it ends and
    a new one begins.

    Parameters
    ----------
    reach : Reach
        Part of the street that has lanes.
    at_reach : int
        Its index.
    dropped : mapping of (int, int, bool) to int
        Lanes next to the kerb that lead into a branch, or come from it, by index
        of the reach, of the part behind the break there, and direction.

    Yields
    ------
    lane : (MapLane, bool)
        A lane, and whether the street is two-way at its last part.
    """
    street = reach.street
    breaks = pairwise(street.breaks_m)
    spans = [(max(low, reach.begin_m), min(high, reach.end_m)) for low, high in breaks]
    parts = [index for index, (low, high) in enumerate(spans) if high - low > 1e-3]
    parts, spans = _without_stubs(parts, spans, reach)
    # Lanes that the next part may continue, and those that have ended.
    open_pieces: dict[tuple[str, str, int], _Piece] = {}
    done: list[_Piece] = []
    for at, index in enumerate(parts):
        edge, is_along = street.parts[index]
        section = street.sections[index]
        is_two_way = len(section.directions) > 1
        low_m, high_m = spans[index]
        before: tuple[Strip, ...] = ()
        if at:
            before = street.strips_at(parts[at - 1], low_m)
        after: tuple[Strip, ...] = ()
        if at + 1 < len(parts):
            after = street.strips_at(parts[at + 1], high_m)
        at_low = street.strips_at(index, low_m)
        at_high = street.strips_at(index, high_m)
        # One part of a lane for each strip across this part of the street.
        following: dict[tuple[str, str, int], _Piece] = {}
        for strip, strip_high in zip(at_low, at_high, strict=True):
            n_begin = dropped.get((at_reach, index, strip.is_forward), 0)
            n_end = dropped.get((at_reach, index + 1, strip.is_forward), 0)
            begin_m, is_continued = _at_break(strip, at_low, before, n_begin)
            end_m, _ = _at_break(strip_high, at_high, after, n_end)
            key = strip.kind, strip.place, strip.number
            limit_kmh = speed_limit_kmh(
                edge.tags,
                is_forward=strip.is_forward == is_along,
            )
            part = _Part(
                strip=strip,
                span_m=spans[index],
                own_left_m=(strip.left_m, strip_high.left_m),
                ends_left_m=(begin_m, end_m),
                level=edge.level,
                limit_kmh=limit_kmh,
                is_two_way=is_two_way,
                road_class=edge.tags["highway"],
                closed_to=closed_to(edge.tags),
            )
            piece: _Piece | None = None
            if is_continued:
                piece = open_pieces.pop(key, None)
            if piece is None:
                lane_id = f"{edge.id} {strip.kind} {strip.place} {strip.number}"
                piece = (lane_id, [])
            _, own_parts = piece
            own_parts.append(part)
            following[key] = piece
        done += open_pieces.values()
        open_pieces = following
    done += open_pieces.values()
    for name, found in done:
        lane = _lane(name, found, reach)
        if lane is not None:
            yield lane, found[-1].is_two_way


def _without_stubs(
    parts: Sequence[int],
    spans: Sequence[tuple[float, float]],
    reach: Reach,
) -> tuple[list[int], list[tuple[float, float]]]:
    """Parts of a street that have lanes of their own, and their stations.

    A way that is cut in two just outside a junction, as at a crosswalk, leaves
    a stub there: the lanes of the part beyond it run on to the junction, unless
    that is driven in other directions.

    Parameters
    ----------
    parts : sequence of int
        Indices of the street's parts, ascending.
    spans : Sequence[tuple[float, float]]
        Begin and end of every part along the street. [m]
    reach : Reach
        The street's part with lanes.

    Returns
    -------
    kept : list of int
        Indices of the parts that stay.
    whole : list of (float, float)
        Begin and end of every part, where parts that stay include the stubs
        next to them. [m]
    """
    least_m = DEFAULTS["cross_section"]["stub_m"]
    kept = list(parts)
    whole = list(spans)
    sections = reach.street.sections

    def is_stub(near: int, beyond: int) -> bool:
        is_short = bool(np.ptp(whole[near]) < least_m)
        is_alike = sections[near].directions == sections[beyond].directions
        return is_short and is_alike

    # Merge stubs at the begin, then those at the end, into the part beyond them.
    for junction, tip, beyond in (
        (reach.from_junction, 0, 1),
        (reach.to_junction, -1, -2),
    ):
        while junction and len(kept) > 1 and is_stub(kept[tip], kept[beyond]):
            stub_low, stub_high = whole[kept.pop(tip)]
            low, high = whole[kept[tip]]
            whole[kept[tip]] = (min(stub_low, low), max(stub_high, high))
    return kept, whole


def _at_break(
    strip: Strip,
    own: Sequence[Strip],
    others: Sequence[Strip],
    n_dropped: int,
) -> tuple[float, bool]:
    """Middle of a lane at a break, and whether the lane simply continues.

    Parameters
    ----------
    strip : Strip
        The lane.
    own : sequence of Strip
        Strips on its side of the break.
    others : sequence of Strip
        Strips on the other side; empty: the street ends.
    n_dropped : int
        So many lanes next to the kerb are there on one side alone: a branch has them
        on the other.

    Returns
    -------
    left_m : float
        Middle at the break, to the left of the street. [m]
    is_continued : bool
        The other side has the same lane.
    """

    def alike(side: Sequence[Strip], kinds: Sequence[str]) -> list[Strip]:
        """Strips of some kinds at the lane's place, from the kerb."""
        found = [one for one in side if one.kind in kinds and one.place == strip.place]
        return sorted(found, key=lambda one: one.number)

    there = alike(others, [strip.kind])
    if not there:
        return strip.left_m, False
    if strip.kind != "driving":
        match = [one for one in there if one.number == strip.number]
        same_left_m = strip.left_m
        if match:
            same_left_m = match[0].left_m
        return 0.5 * (strip.left_m + same_left_m), bool(match)
    here = alike(own, ["driving"])
    # Where a bus lane becomes one for cars, the lanes beside it go straight on.
    here_all = alike(own, _DRIVEN)
    there_all = alike(others, _DRIVEN)
    if len(here_all) == len(there_all):
        both = [
            pair
            for pair in zip(here_all, there_all, strict=True)
            if pair[0].kind == pair[1].kind == "driving"
        ]
        if both:
            here = [one for one, _ in both]
            there = [other for _, other in both]
    if n_dropped and abs(len(here) - len(there)) == n_dropped:
        shifted = strip.number + n_dropped
        if len(here) > len(there):
            shifted = strip.number - n_dropped
        if shifted < 0:
            return strip.left_m, False
        return 0.5 * (strip.left_m + there[shifted].left_m), False
    # With fewer lanes on the other side, the last ones meet the last one there.
    numbers = [one.number for one in here]
    at = int(np.argmin(np.abs(np.array(numbers) - strip.number)))
    at = min(at, len(there) - 1)
    middle_left_m = 0.5 * (here[at].left_m + there[at].left_m)
    is_same = strip.number == here[at].number == there[at].number
    return middle_left_m, is_same and len(here) == len(there)


def _lane(name: str, parts: Sequence[_Part], reach: Reach) -> MapLane | None:
    """Lane along parts of a street, or None if it is too short to be one.

    Each part runs straight between short tapers towards the middles at both of
    its ends.

    Parameters
    ----------
    name : str
        Id of the lane.
    parts : sequence of _Part
        Its parts, one after the other.
    reach : Reach
        The street's part with lanes.

    Returns
    -------
    lane : MapLane or None
        The lane, in driving direction.
    """
    taper = DEFAULTS["cross_section"]["taper"]
    # Stations, and how far left of the street.
    points_of_lefts: list[tuple[float, float]] = []
    for part in parts:
        low, high = part.span_m
        begin_left, end_left = part.ends_left_m
        low_left, high_left = part.own_left_m
        half = 0.5 * (high - low)
        first = min(max(taper * abs(begin_left - low_left), 1.0), half)
        last = min(max(taper * abs(end_left - high_left), 1.0), half)
        # Between the tapers the lane may shift along the whole part.
        shift = (high_left - low_left) / max(high - low, 1e-9)
        points_of_lefts += [
            (low, begin_left),
            (low + first, low_left + first * shift),
            (high - last, high_left - last * shift),
            (high, end_left),
        ]
    stations, lefts = zip(*points_of_lefts, strict=True)
    begin_m = parts[0].span_m[0]
    end_m = parts[-1].span_m[1]
    if end_m - begin_m < _MIN_LENGTH_M:
        return None
    heights = _heights(parts)
    # Points are needed at tapers and ramps, besides the bends of the street.
    extra: list[float] = []
    if not np.ptp(lefts) < 1e-9:
        extra = list(stations)
    if any(part.level for part in parts):
        extra += [station for station, _ in heights]
    at = stations_between(reach.street, begin_m, end_m, extra)
    middle, across = axis_points(reach.street, at)
    left_m = np.interp(at, stations, lefts)
    line = middle + left_m[:, None] * across
    is_kept = has_no_knot(line, middle)
    at = at[is_kept]
    line = line[is_kept]
    if len(line) < 2 or np.hypot(*(line[-1] - line[0])) < 1e-3:
        return None
    lengths = [part.span_m[1] - part.span_m[0] for part in parts]
    height_stations, height_m = np.transpose(heights)
    points = np.column_stack([line, np.interp(at, height_stations, height_m)])
    # Only a lane that reaches the end of the street's reach touches the junction.
    from_junction = ""
    if begin_m <= reach.begin_m + 1e-6:
        from_junction = reach.from_junction
    to_junction = ""
    if end_m >= reach.end_m - 1e-6:
        to_junction = reach.to_junction
    is_forward = parts[0].strip.is_forward
    if not is_forward:
        points = points[::-1]
        from_junction, to_junction = to_junction, from_junction
    # As of `speed_limit_kmh`.
    last_part = parts[-1 if is_forward == bool(to_junction) else 0]
    return MapLane(
        id=name,
        kind=parts[0].strip.kind,
        width_m=float(
            np.average([part.strip.width_m for part in parts], weights=lengths)
        ),
        centreline_m=points,
        from_junction=from_junction,
        to_junction=to_junction,
        speed_limit_kmh=last_part.limit_kmh,
        road_class=last_part.road_class,
        closed_to=last_part.closed_to,
        turns=parts[-1 if is_forward else 0].strip.turns,
    )


def _heights(parts: Sequence[_Part]) -> list[tuple[float, float]]:
    """Stations and heights of a lane: bridges and tunnels with short ramps.

    Parameters
    ----------
    parts : sequence of _Part
        The lane's parts, one after the other.

    Returns
    -------
    heights : list of (float, float)
        Station and height, ascending by station. [m]
    """
    heights: list[tuple[float, float]] = []
    step_m = DEFAULTS["cross_section"]["level_m"]
    for before, part, after in zip(
        [parts[0], *parts],
        parts,
        [*parts[1:], parts[-1]],
        strict=False,
    ):
        low, high = part.span_m
        level = part.level
        run = min(10.0, 0.5 * (high - low))
        heights += [
            (low, 0.5 * step_m * (before.level + level)),
            (low + run, step_m * level),
        ]
        heights += [
            (high - run, step_m * level),
            (high, 0.5 * step_m * (level + after.level)),
        ]
    return heights


def _lead_on(
    lanes: Sequence[MapLane], two_way: Set[str], settled: Set[_LaneEnd]
) -> list[MapLane]:
    """Lanes whose ends meet where carriageways part or merge.

    Parameters
    ----------
    lanes : sequence of MapLane
        Lanes of all streets.
    two_way : Set[str]
        Ids of the lanes of two-way streets: their ends stay, and those of
        one-way carriageways move.
    settled : set of (str, bool)
        Ids of lanes, and whether their begins are meant: these ends stay, too, and
        nothing is bent towards them.

    Returns
    -------
    led : list of MapLane
        The same lanes, in order.
    """
    led = list(lanes)
    # Group the open ends of lanes side by side, from the kerb.
    groups: dict[_Group, list[int]] = defaultdict(list)
    for index, lane in enumerate(lanes):
        if lane.kind == "driving":
            name = lane.id.rpartition(" ")[0]
            for is_begin, junction in (
                (True, lane.from_junction),
                (False, lane.to_junction),
            ):
                if not junction and (lane.id, is_begin) not in settled:
                    groups[name, is_begin].append(index)
    for members in groups.values():
        members.sort(key=lambda index: int(lanes[index].id.rpartition(" ")[2]))
    moved: dict[tuple[int, bool], FloatArray] = {}

    def place(index: int, other: int) -> FloatArray:
        """Where the end of a lane and the start of another one meet."""
        known = moved.get((index, False), moved.get((other, True)))
        if known is not None:
            return known
        own_tip = _tip(lanes[index], is_begin=False)
        other_tip = _tip(lanes[other], is_begin=True)
        own_stays = lanes[index].id in two_way
        other_stays = lanes[other].id in two_way
        if own_stays == other_stays:
            return 0.5 * (own_tip + other_tip)
        if other_stays:
            return other_tip
        return own_tip

    # Choose the meeting points, the nearest groups first.
    for ends, begins in _meeting_groups(lanes, groups):
        for number in range(max(len(ends), len(begins))):
            one = ends[min(number, len(ends) - 1)]
            other = begins[min(number, len(begins) - 1)]
            point = place(one, other)
            moved.setdefault((one, False), point)
            moved.setdefault((other, True), point)
    # Bend the lanes towards them.
    for (index, is_begin), point in moved.items():
        points = led[index].centreline_m
        if is_begin:
            line = _bent(points, point)
        else:
            line = _bent(points[::-1], point)[::-1]
        led[index] = replace(led[index], centreline_m=line)
    return led


def _meeting_groups(
    lanes: Sequence[MapLane],
    groups: Mapping[_Group, Sequence[int]],
) -> Iterator[tuple[Sequence[int], Sequence[int]]]:
    """Ends and begins of groups of lanes that go on into each other.

    A group is the set of lanes side by side. Each group is linked to the
    nearest one that lies ahead; groups that meet already are left out.

    Parameters
    ----------
    lanes : sequence of MapLane
        Lanes of all streets.
    groups : Mapping[_Group, Sequence[int]]
        Indices of lanes side by side, from the kerb, by their common name and
        whether their starts are meant.

    Yields
    ------
    pair : (sequence of int, sequence of int)
        Lanes that end, and lanes that begin there, the nearest first.
    """
    keys = list(groups)
    tips = [
        np.array([_tip(lanes[index], is_begin=key[1]) for index in groups[key]])
        for key in keys
    ]
    of_tip = np.repeat(np.arange(len(keys)), [len(points) for points in tips])
    if not len(of_tip):
        return
    tree = cKDTree(np.concatenate(tips))
    links: dict[tuple[int, int], float] = {}
    for one, key in enumerate(keys):
        # Groups of the other kind whose tips are near, with the smallest gap.
        found: dict[int, float] = {}
        for tip in tips[one]:
            for at in tree.query_ball_point(tip, _BESIDE_END_M):
                other = int(of_tip[at])
                if keys[other][1] != key[1] and keys[other][0] != key[0]:
                    gap_m = float(np.hypot(*(tree.data[at] - tip)[:2]))
                    found[other] = min(gap_m, found.get(other, np.inf))
        # Of those that lead the same way, the nearest one is linked.
        own = _ahead(lanes[groups[key][0]], key[1])
        ahead: dict[int, float] = {}
        for other, gap_m in found.items():
            first_lane = lanes[groups[keys[other]][0]]
            way = _ahead(first_lane, not key[1])
            if own @ way > _SAME_WAY:
                ahead[other] = gap_m
        if ahead:
            other = min(ahead, key=ahead.__getitem__)
            if key[1]:
                link = (other, one)
            else:
                link = (one, other)
            links[link] = ahead[other]
    for (end, begin), _ in sorted(links.items(), key=lambda item: item[1]):
        is_met = [
            bool((np.hypot(*(others - tip)[:, :2].T) <= _SAME_POINT_M).any())
            for own, others in ((tips[end], tips[begin]), (tips[begin], tips[end]))
            for tip in own
        ]
        if not all(is_met):
            yield groups[keys[end]], groups[keys[begin]]


def _tip(lane: MapLane, *, is_begin: bool) -> FloatArray:
    """First or last point of a lane, (3,)."""
    if is_begin:
        return np.asarray(lane.centreline_m[0])
    return np.asarray(lane.centreline_m[-1])


def _ahead(lane: MapLane, is_begin: bool) -> FloatArray:
    """Unit vector in driving direction at an end of a lane, (2,)."""
    points = lane.centreline_m[:, :2]
    if is_begin:
        return unit(points[1] - points[0])
    return unit(points[-1] - points[-2])


def _bent(points_m: FloatArray, begin_m: FloatArray) -> FloatArray:
    """Line that begins at another point and soon joins the old one.

    Parameters
    ----------
    points_m : (n, 3) float
        The line. [m]
    begin_m : (3,) float
        The new first point. [m]

    Returns
    -------
    line_m : (k, 3) float
        It runs straight to a point 15 m along the old line, then follows that.
        [m]
    """
    along = along_m(points_m)
    run = np.minimum(_BEND_M, along[-1])
    joint_m = points_at(points_m, run)
    rest_m = points_m[along > run + _SAME_POINT_M]
    return np.vstack([begin_m, joint_m, rest_m])
