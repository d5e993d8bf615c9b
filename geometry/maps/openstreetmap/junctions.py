"""Junctions of a network: which streets are their arms, their outlines and names."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
import shapely
from shapely import MultiPolygon, Point, Polygon
from shapely.geometry.base import BaseGeometry

from ...arrays import FloatArray
from ..model import MapJunction
from .arms import Arm, group_arms, place_mouths
from .clusters import Clusters, find_clusters, is_fork
from .defaults import DEFAULTS
from .elements import Elements
from .network import Network, Street, trace_streets
from .notes import Notes
from .strips import surface

_MAX_ROUNDS = 6  # of taking in forks that lie within an outline; two are usual


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reach:
    """The part of a street that has lanes, and the junctions at its ends.

    Attributes
    ----------
    street : Street
        All of it.
    begin_m, end_m : float
        Stations where lanes begin and end; nowhere if the end is not behind the begin. [m]
    from_junction, to_junction : str
        Ids; empty: none.
    """

    street: Street
    begin_m: float
    end_m: float
    from_junction: str = ""
    to_junction: str = ""


def find_junctions(
    network: Network, elements: Elements, notes: Notes
) -> tuple[list[Reach], list[MapJunction]]:
    """Where roads meet.

    Parameters
    ----------
    network : Network
        The roads.
    elements : Elements
        For tags and ids of nodes.
    notes : Notes
        Told of meetings of roads that have too few arms.

    Returns
    -------
    reaches : list of Reach
        All streets but those inside junctions.
    junctions : list of MapJunction
        In the order of their nodes' ids.
    """
    clusters = find_clusters(network, elements.node_tags)
    known: _Placed = {}
    for number_of_round in count():
        streets = trace_streets(network, clusters.of_row.__contains__)
        arms, inside = _arms_by_cluster(streets, clusters, known)
        if number_of_round < _MAX_ROUNDS and _take_in_forks(network, clusters, arms):
            continue
        if not _drop_small(clusters, arms, elements, notes):
            break
    ids = {
        number: f"n{min(int(elements.node_ids[row]) for row in rows)}"
        for number, rows in clusters.members.items()
    }
    reaches = _reaches(network, streets, clusters, arms, ids)
    mouths = {
        (index, is_begin): reach.begin_m if is_begin else reach.street.length_m - reach.end_m
        for index, reach in reaches.items()
        for is_begin in (True, False)
    }
    junctions = []
    for number, here in arms.items():
        final = [replace(arm, mouth_m=mouths[arm.index, arm.is_begin]) for arm in here]
        points = network.positions_m[clusters.members[number]]
        outline = _outline(final, inside.get(number, []), points)
        name = _name(final, inside.get(number, []))
        junctions.append(MapJunction(id=ids[number], name=name, outline_m=outline))
    order = sorted(range(len(junctions)), key=lambda index: int(junctions[index].id[1:]))
    return list(reaches.values()), [junctions[index] for index in order]


_Path = tuple[tuple[str, bool], ...]  # edges of a street and which way it follows them
_Placed = dict[tuple[_Path, ...], list[float]]  # mouths of arms by the streets of a junction


def _path(street: Street) -> _Path:
    return tuple((edge.id, is_along) for edge, is_along in street.parts)


def _arms_by_cluster(
    streets: Sequence[Street], clusters: Clusters, known: _Placed
) -> tuple[dict[int, list[Arm]], dict[int, list[Street]]]:
    limit_m = DEFAULTS["junction"]["max_size_m"]
    arms: dict[int, list[Arm]] = {number: [] for number in clusters.members}
    inside: dict[int, list[Street]] = defaultdict(list)
    for index, street in enumerate(streets):
        begin, end = (clusters.of_row.get(int(street.rows[at])) for at in (0, -1))
        is_ring = all(edge.is_roundabout for edge, _ in street.parts)
        if begin is not None and begin == end and (street.length_m <= limit_m or is_ring):
            inside[begin].append(street)
            continue
        if begin is not None:
            arms[begin].append(Arm(street=street, index=index, is_begin=True))
        if end is not None:
            arms[end].append(Arm(street=street.turned_round(), index=index, is_begin=False))
    for number, here in arms.items():
        # Most junctions stay as they are from round to round.
        key = tuple(_path(street) for street in (*(arm.street for arm in here), *inside[number]))
        if key not in known:
            known[key] = [arm.mouth_m for arm in place_mouths(here, inside[number])]
        arms[number] = [
            replace(arm, mouth_m=mouth_m) for arm, mouth_m in zip(here, known[key], strict=True)
        ]
    return arms, inside


def _take_in_forks(network: Network, clusters: Clusters, arms: Mapping[int, Sequence[Arm]]) -> bool:
    """Forks in an arm before it begins, and those at the tip of a splitter island, join in."""
    island_m = DEFAULTS["junction"]["island_m"]
    taken = []
    for number, here in arms.items():
        group_of = {
            index: group for group, members in enumerate(group_arms(here)) for index in members
        }
        # Streets that end at a fork, by its node.
        branches = {
            int(arm.street.rows[-1]): group_of[index]
            for index, arm in enumerate(here)
            if arm.street.length_m <= island_m
        }
        for index, arm in enumerate(here):
            for row, station in zip(arm.street.rows.tolist(), arm.street.stations_m, strict=True):
                ends = network.ends.get(row, ())
                if row in clusters.of_row or len(ends) < 3 or not is_fork(network, ends):
                    continue
                is_island = (
                    station <= island_m and branches.get(row, group_of[index]) != (group_of[index])
                )
                if station <= arm.mouth_m + 1.0 or is_island:
                    taken.append((row, number))
    for row, number in taken:
        clusters.add(row, number)
    return bool(taken)


def _drop_small(
    clusters: Clusters, arms: Mapping[int, Sequence[Arm]], elements: Elements, notes: Notes
) -> bool:
    """Meetings of roads that are none to somebody who drives there: two roads merge, or end."""
    min_arms, least_m = DEFAULTS["junction"]["min_arms"], DEFAULTS["cross_section"]["min_road_m"]
    small = []
    for number, here in arms.items():
        long = [arm for arm in here if arm.street.length_m >= least_m]
        if len(group_arms(long)) < min_arms:
            small.append(number)
    for number in small:
        node = min(int(elements.node_ids[row]) for row in clusters.members[number])
        notes.add("meetings of roads", f"node {node}", "fewer than three arms: roads merge or end")
        clusters.drop(number)
    return bool(small)


def _reaches(
    network: Network,
    streets: Sequence[Street],
    clusters: Clusters,
    arms: Mapping[int, Sequence[Arm]],
    ids: Mapping[int, str],
) -> dict[int, Reach]:
    """Which part of each street has lanes, by its index."""
    least_m = DEFAULTS["cross_section"]["min_road_m"]
    mouths = {(arm.index, arm.is_begin): arm.mouth_m for here in arms.values() for arm in here}
    reaches = {}
    for index, street in enumerate(streets):
        numbers = [clusters.of_row.get(int(street.rows[at])) for at in (0, -1)]
        if numbers[0] is not None and (index, True) not in mouths:
            continue  # inside a junction
        cuts = [
            mouths[index, is_begin]
            if number is not None
            else _road_beside_m(network, street, is_begin=is_begin)
            for number, is_begin in zip(numbers, (True, False), strict=True)
        ]
        free_m = max(street.length_m - least_m, 0.0)
        if sum(cuts) > free_m:  # two junctions so near that both get less
            cuts = [cut * free_m / sum(cuts) for cut in cuts]
        names = ["" if number is None else ids[number] for number in numbers]
        reaches[index] = Reach(
            street=street,
            begin_m=cuts[0],
            end_m=street.length_m - cuts[1],
            from_junction=names[0],
            to_junction=names[1],
        )
    return reaches


def _road_beside_m(network: Network, street: Street, *, is_begin: bool) -> float:
    """Half the width of the road into which a yard leads, where no junction is, in metres."""
    edge, _ = street.parts[0 if is_begin else -1]
    ends = network.ends[int(street.rows[0 if is_begin else -1])]
    others = [network.edges[index] for index, _ in ends]
    if not edge.is_service:
        return 0.0
    return max((0.5 * one.section.width_m for one in others if not one.is_service), default=0.0)


def _outline(arms: Sequence[Arm], inside: Sequence[Street], points_m: FloatArray) -> FloatArray:
    """Road surface of a junction up to where its arms begin."""
    corner_m = DEFAULTS["junction"]["corner_m"]
    surfaces = [surface(street, 0.0, street.length_m) for street in inside]
    surfaces += [surface(arm.street, 0.0, arm.mouth_m) for arm in arms]
    radius_m = min((arm.half_width_m for arm in arms), default=1.0)
    surfaces += [Point(point).buffer(radius_m, quad_segs=4) for point in points_m]
    whole = shapely.union_all(surfaces)
    # Kerbs are rounded, narrow islands belong to the surface.
    rounded = whole.buffer(corner_m, quad_segs=8).buffer(-corner_m, quad_segs=8)
    beyond = [
        surface(arm.street, arm.mouth_m, min(arm.mouth_m + 10.0, arm.street.length_m))
        for arm in arms
    ]
    rest = rounded.union(whole).difference(shapely.union_all(beyond))
    polygon = _largest(rest)
    ring = shapely.simplify(polygon.exterior, 0.02)
    outline: FloatArray = np.asarray(ring.coords)[:-1]
    return outline


def _largest(shape: BaseGeometry) -> Polygon:
    if isinstance(shape, Polygon) and not shape.is_empty:
        return shape
    parts = [part for part in getattr(shape, "geoms", []) if isinstance(part, Polygon)]
    if isinstance(shape, MultiPolygon) or parts:
        return max(parts, key=lambda part: part.area)
    return Point(0.0, 0.0).buffer(1.0)


def _name(arms: Sequence[Arm], inside: Sequence[Street]) -> str:
    """Names of the streets that meet, the busiest first."""
    ranks: dict[str, int] = {}
    counts: Counter[str] = Counter()
    edges = [arm.street.parts[0][0] for arm in arms]
    edges += [edge for street in inside for edge, _ in street.parts]
    for index, edge in enumerate(edges):
        if edge.name:
            rank = DEFAULTS["roads"][edge.tags["highway"]]["rank"]
            ranks[edge.name] = min(rank, ranks.get(edge.name, rank))
            counts[edge.name] += index < len(arms)
    return " / ".join(sorted(ranks, key=lambda name: (ranks[name], -counts[name], name)))
