"""Roundabouts in maps that have lanes through their junctions.

Formats such as OpenDRIVE and Lanelet2 draw a roundabout as junctions with pieces of
its ring between them. These become one junction, with lanes from each entry to all
exits. The islands are what the lanes lead around.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import shapely

from ..arrays import FloatArray
from ..lines import apart, length_m
from ..scene import area_of
from .source_map import MapJunction, MapLane, SourceMap, polygons_of, unique_id

_SAME_POINT_M = 0.5
# Between two junctions of a ring, and all around it: 80 m and more to the middle.
_MAX_PIECE_M = 200.0
_MAX_AROUND_M = 700.0
_MAX_JUNCTIONS = 12
# 4 pi area / perimeter^2: 1 of a circle, 0.79 of a square block of houses.
_ROUND = 0.85
# Between surfaces of lanes drawn a little apart.
_GAP_M = 0.25
_LEAST_ISLAND_M2 = 3.0
# How far lanes lead around an island: none much against traffic, one of them so far.
_MOST_AGAINST_DEG = 15.0
_LEAST_AROUND_DEG = 200.0
# Ways from one entry.
_MAX_WAYS = 200


def with_roundabouts(source: SourceMap) -> SourceMap:
    """A map whose roundabouts are one junction each, with their islands.

    Parameters
    ----------
    source : SourceMap
        It has lanes through its junctions.

    Returns
    -------
    whole : SourceMap
        The same map where it has no roundabout.
    """
    for ring in _rings(source):
        source = _merged(source, ring)
    of_junction: dict[str, list[MapLane]] = defaultdict(list)
    for lane in source.connections:
        of_junction[lane.from_junction].append(lane)
    junctions = []
    for junction in source.junctions:
        islands_m = find_islands(of_junction[junction.id], keeps_left=source.keeps_left)
        junctions.append(replace(junction, islands_m=islands_m))
    return replace(source, junctions=tuple(junctions))


def find_islands(
    connections: Sequence[MapLane], *, keeps_left: bool
) -> tuple[FloatArray, ...]:
    """Islands that the lanes through a junction lead around.

    Parameters
    ----------
    connections : sequence of MapLane
        Lanes through one junction.
    keeps_left : bool
        Traffic keeps left.

    Returns
    -------
    islands_m : tuple of (n, 2) float
        Outlines. Empty: it is no roundabout, some lane turns across. [m]
    """
    driven = [lane for lane in connections if lane.kind == "driving"]
    strips = [_strip(lane) for lane in driven]
    islands = []
    for part in polygons_of(_joined(strips)):
        for hole in part.interiors:
            island = shapely.Polygon(hole)
            if island.area < _LEAST_ISLAND_M2:
                continue
            centre = shapely.get_coordinates(island.centroid)[0]
            turned_deg = np.array([_around_deg(lane, centre) for lane in driven])
            if keeps_left:
                turned_deg = -turned_deg
            is_led_around = turned_deg.max() >= _LEAST_AROUND_DEG
            if is_led_around and turned_deg.min() >= -_MOST_AGAINST_DEG:
                islands.append(np.asarray(hole.coords)[:-1])
    return tuple(islands)


def _strip(lane: MapLane) -> Any:
    """Surface of a lane, a shapely geometry."""
    line = shapely.LineString(lane.centreline_m[:, :2])
    return line.buffer(0.5 * lane.width_m, cap_style="flat")


def _joined(surfaces: Sequence[Any]) -> Any:
    """Surfaces as one, without the gaps between those drawn a little apart."""
    wide = shapely.buffer(np.array(surfaces, dtype=object), _GAP_M, join_style="mitre")
    return shapely.union_all(wide).buffer(-_GAP_M, join_style="mitre")


def _around_deg(lane: MapLane, centre_m: FloatArray) -> float:
    """Angle through which a lane leads around a point, counter-clockwise."""
    east, north = (lane.centreline_m[:, :2] - centre_m).T
    angle = np.unwrap(np.arctan2(north, east))
    return float(np.degrees(angle[-1] - angle[0]))


# ---------- junctions around one ring
def _rings(source: SourceMap) -> Iterator[tuple[str, ...]]:
    """Ids of the junctions of each roundabout, in the direction of traffic."""
    links = _links(source)
    one_way: dict[str, list[str]] = defaultdict(list)
    for begin, end in links:
        if (end, begin) not in links:
            one_way[begin].append(end)
    used: set[str] = set()
    for start in list(one_way):
        paths: list[tuple[str, ...]] = [(start,)]
        while paths and start not in used:
            path = paths.pop()
            for following in one_way[path[-1]]:
                if following == start and _is_ring(source, path, links):
                    used.update(path)
                    yield path
                    break
                is_new = following not in path and following not in used
                if is_new and len(path) < _MAX_JUNCTIONS:
                    paths.append((*path, following))


def _links(source: SourceMap) -> dict[tuple[str, str], list[MapLane]]:
    """Short lanes from one junction to another, by the ids of both."""
    links: dict[tuple[str, str], list[MapLane]] = defaultdict(list)
    for lane in source.lanes:
        ends = (lane.from_junction, lane.to_junction)
        if lane.kind != "driving" or not all(ends) or ends[0] == ends[1]:
            continue
        if length_m(lane.centreline_m) <= _MAX_PIECE_M:
            links[ends].append(lane)
    return dict(links)


def _is_ring(
    source: SourceMap,
    path: Sequence[str],
    links: Mapping[tuple[str, str], Sequence[MapLane]],
) -> bool:
    """True if lanes lead smoothly round from junction to junction, back to the first.

    Parameters
    ----------
    source : SourceMap
        The map.
    path : sequence of str
        Ids of junctions, one after the other.
    links : mapping of (str, str) to sequence of MapLane
        See :func:`_links`.
    """
    pairs = [*zip(path, [*path[1:], path[0]], strict=True)]
    lines = []
    for at, pair in enumerate(pairs):
        lane = links[pair][0]
        following = links[pairs[(at + 1) % len(pairs)]]
        through = [
            one
            for one in source.connections
            if one.from_junction == pair[1]
            and _follows(lane, one)
            and any(_follows(one, other) for other in following)
        ]
        if not through:
            return False
        lines += [lane.centreline_m[:, :2], through[0].centreline_m[:, :2]]
    ring = shapely.Polygon(np.concatenate(lines))
    if ring.length > _MAX_AROUND_M or not ring.is_valid:
        return False
    is_round = 4.0 * np.pi * ring.area >= _ROUND * ring.length**2
    return bool(is_round and ring.exterior.is_ccw != source.keeps_left)


def _follows(before: MapLane, after: MapLane) -> bool:
    """True if a lane begins where another one ends."""
    apart_m = after.centreline_m[0, :2] - before.centreline_m[-1, :2]
    return bool(np.hypot(*apart_m) <= _SAME_POINT_M)


def _merged(source: SourceMap, ring: Sequence[str]) -> SourceMap:
    """A map in which the junctions of a roundabout are one.

    Parameters
    ----------
    source : SourceMap
        The map.
    ring : sequence of str
        Ids of the junctions.

    Returns
    -------
    merged : SourceMap
        The junction has the id of the first one in the file.
    """
    members = [one for one in source.junctions if one.id in ring]
    name = members[0].id
    inner = []
    outer = []
    for lane in source.lanes:
        is_piece = lane.from_junction in ring and lane.to_junction in ring
        if is_piece and lane.from_junction != lane.to_junction:
            inner.append(lane)
        else:
            outer.append(lane)
    through = [one for one in source.connections if one.from_junction in ring]
    pieces = [*(lane for lane in inner if lane.kind == "driving"), *through]

    def renamed(junction: str) -> str:
        if junction in ring:
            return name
        return junction

    lanes = [
        replace(
            lane,
            from_junction=renamed(lane.from_junction),
            to_junction=renamed(lane.to_junction),
        )
        for lane in outer
    ]
    entries = [one for one in lanes if one.to_junction == name]
    exits = [one for one in lanes if one.from_junction == name]
    connections = [one for one in source.connections if one.from_junction not in ring]
    taken = Counter(one.id for one in connections)
    for entry in entries:
        for exit_id, chain in _ways_from(entry, pieces, exits).items():
            line = np.concatenate([piece.centreline_m for piece in chain])
            lane_id = unique_id(f"{entry.id} to {exit_id}", taken)
            width_m = min(piece.width_m for piece in chain)
            connections.append(
                MapLane(
                    id=lane_id,
                    kind="driving",
                    width_m=width_m,
                    centreline_m=apart(line, 1e-6),
                    from_junction=name,
                    to_junction=name,
                )
            )
    surfaces = [area_of(one.outline_m) for one in members]
    surfaces += [_strip(piece) for piece in inner]
    whole = max(polygons_of(_joined(surfaces)), key=lambda part: part.area)
    names = [street for one in members for street in one.name.split(" / ")]
    merged = MapJunction(
        id=name,
        name=" / ".join(dict.fromkeys(filter(None, names))),
        outline_m=np.asarray(whole.exterior.coords)[:-1],
        height_m=float(np.mean([one.height_m for one in members])),
        roads=_arm_roads(members, inner),
    )
    junctions = []
    for one in source.junctions:
        if one is members[0]:
            junctions.append(merged)
        elif one.id not in ring:
            junctions.append(one)
    return replace(
        source,
        lanes=tuple(lanes),
        connections=tuple(connections),
        junctions=tuple(junctions),
    )


def _ways_from(
    entry: MapLane, pieces: Sequence[MapLane], exits: Sequence[MapLane]
) -> dict[str, list[MapLane]]:
    """The shortest chain of pieces from a lane to each exit, by the exit's id."""
    found: dict[str, list[MapLane]] = {}
    waiting = [[piece] for piece in pieces if _follows(entry, piece)]
    n_ways = 0
    while waiting and n_ways < _MAX_WAYS:
        n_ways += 1
        waiting.sort(key=_length_of, reverse=True)
        chain = waiting.pop()
        for leaving in exits:
            if leaving.kind == entry.kind and _follows(chain[-1], leaving):
                found.setdefault(leaving.id, chain)
        waiting += [
            [*chain, piece]
            for piece in pieces
            if piece not in chain and _follows(chain[-1], piece)
        ]
    return found


def _length_of(chain: Sequence[MapLane]) -> float:
    """Length of lanes one after the other, in metres."""
    return sum(length_m(piece.centreline_m) for piece in chain)


def _arm_roads(
    members: Sequence[MapJunction], inner: Sequence[MapLane]
) -> tuple[Any, ...]:
    """Roads that lead to the junctions of a ring, without the ring's own."""
    if not inner:
        return ()
    ring = shapely.union_all(
        [shapely.LineString(lane.centreline_m[:, :2]) for lane in inner]
    )
    return tuple(
        road
        for one in members
        for road in one.roads
        if ring.distance(shapely.Point(road.point_m + 2.0 * road.direction))
        > 0.5 * max(lane.width_m for lane in inner)
    )
