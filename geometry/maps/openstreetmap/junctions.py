"""Junctions of a network: nodes, arms, outlines, and roads that lead there.

Nodes where roads meet are joined to clusters, one for each junction. The
streets that leave a cluster are its arms; lanes begin at their mouths.
Forks of carriageways next to a cluster are taken into it, meetings that
nobody would call a junction are dropped, and the search starts again until
nothing changes.
"""

from collections import Counter, defaultdict, deque
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

import numpy as np
import shapely
from shapely import Point
from shapely.geometry.base import BaseGeometry

from ...arrays import FloatArray
from ...errors import clean_name
from ...junction import chained
from ...lines import unit
from ...scene import LeadingRoad, area_of
from ..source_map import MapJunction, polygons_of
from .elements import DEFAULTS, Elements, Tags
from .network import (
    Edge,
    End,
    Network,
    Street,
    carriageway_points,
    surface,
    trace_streets,
)
from .rings import roundabout_surface

_STEP_M = 0.5
# As geometry.junction groups lanes.
_SAME_ARM_COSINE = np.cos(np.radians(25.0))
_SAME_ARM_GAP_M = 12.0
# Two one-way roads that lie closer to one another than this are one road's.
_FORK_DEG = 60.0
_STUB_M: float = DEFAULTS["cross_section"]["stub_m"]
_STUB = f"it ends nowhere, less than {_STUB_M:g} m beyond a junction: no arm"
# Of taking in forks that lie within an outline; two are usual.
_MAX_ROUNDS = 6
# Edges of a street and which way it follows them.
_Path = tuple[tuple[str, bool], ...]
# Mouths of arms by the streets of a junction.
_Placed = dict[tuple[_Path, ...], list[float]]
# Of the outline, which is rounded.
_BEYOND_M = 1.0
# Beside the kerb of an arm, where a rounded corner is looked for.
_BESIDE_KERB_M = 0.1
# Over which lanes part.
_PART_M = 15.0
# Over which a direction is taken.
_AHEAD_M = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StreetArm:
    """Street that leaves a junction.

    Attributes
    ----------
    street : Street
        The street away from the junction, from its node.
    index : int
        Of the street, among all.
    is_begin : bool
        The street as listed begins here; otherwise it is turned round.
    mouth_m : float
        Distance from its node at which lanes begin. [m]
    """

    street: Street
    index: int
    is_begin: bool
    mouth_m: float = 0.0

    @property
    def direction(self) -> FloatArray:
        """Unit vector away from the junction where the arm begins, (2,)."""
        begin_m = min(self.mouth_m, max(self.street.length_m - 5.0, 0.0))
        (near, far), _ = carriageway_points(self.street, [begin_m, begin_m + 10.0])
        return unit(far - near)

    @property
    def mouth_point_m(self) -> FloatArray:
        """Where the street crosses the outline, (2,)."""
        (point,), _ = carriageway_points(self.street, [self.mouth_m])
        return np.asarray(point)

    @property
    def half_width_m(self) -> float:
        """Half the width of its carriageway at the mouth, in metres."""
        return 0.5 * self.street.section_at(self.mouth_m).width_m


def place_mouths(
    arms: Sequence[StreetArm], inside: Sequence[Street]
) -> list[StreetArm]:
    """Arms of a junction with the distance at which their lanes begin.

    They begin a corner beyond the point where their carriageways have left
    those of the others and of the streets `inside`; the carriageways of one arm
    begin side by side.

    Parameters
    ----------
    arms : sequence of StreetArm
        Arms of one junction.
    inside : sequence of Street
        Streets between nodes of the junction.

    Returns
    -------
    placed : list of StreetArm
        The same arms, in order.
    """
    limits = DEFAULTS["junction"]
    directions = [arm.direction for arm in arms]
    most_m = limits["max_mouth_m"]
    is_ring = is_roundabout(inside)
    surfaces = [
        surface(arm.street, 0.0, min(arm.street.length_m, most_m + 5.0)) for arm in arms
    ]
    middle = _surfaces_inside(inside)

    def is_in_way(one: int, other: int) -> bool:
        """True if one arm must begin beyond the carriageway of another one."""
        if one == other or directions[one] @ directions[other] < _SAME_ARM_COSINE:
            return one != other
        # Carriageways of one road may overlap.
        edge, is_along = arms[one].street.parts[0]
        beside, runs_along = arms[other].street.parts[0]
        is_pair = edge.is_oneway and beside.is_oneway and is_along != runs_along
        return not is_pair and (edge.name == "" or edge.name != beside.name)

    # Each arm on its own: a corner beyond the others' carriageways.
    placed = []
    for index, arm in enumerate(arms):
        others = [
            surfaces[other] for other in range(len(arms)) if is_in_way(index, other)
        ]
        in_way = shapely.union_all([*middle, *others])
        clear_m = _clear_from_m(arm.street, in_way) + limits["corner_m"]
        if is_ring:
            clear_m = _corner_end_m(arm.street, in_way, surfaces[index])
        mouth_m = min(clear_m, most_m)
        placed.append(replace(arm, mouth_m=mouth_m))
    # Carriageways of one arm: all as far out as the outermost of them.
    aligned = list(placed)
    for group in group_arms(placed):
        if len(group) == 1:
            continue
        mean = np.mean([placed[index].direction for index in group], axis=0)
        ahead_m = [float(placed[index].mouth_point_m @ mean) for index in group]
        for index, own_m in zip(group, ahead_m, strict=True):
            mouth_m = min(placed[index].mouth_m + max(ahead_m) - own_m, most_m + 10.0)
            aligned[index] = replace(placed[index], mouth_m=mouth_m)
    return aligned


def is_roundabout(inside: Iterable[Street]) -> bool:
    """True if one of the streets inside a junction is part of a roundabout's ring."""
    return any(edge.is_roundabout for street in inside for edge, _ in street.parts)


def _surfaces_inside(inside: Sequence[Street]) -> list[BaseGeometry]:
    """Road surfaces of the streets inside a junction; a roundabout's with islands."""
    if is_roundabout(inside):
        return [roundabout_surface(inside)]
    return [surface(street, 0.0, street.length_m) for street in inside]


def _corner_end_m(street: Street, ring: BaseGeometry, arm: BaseGeometry) -> float:
    """Distance at which the rounded kerbs between a roundabout and an arm end.

    Parameters
    ----------
    street : Street
        The arm.
    ring : BaseGeometry
        Surface of the ring and of its other arms.
    arm : BaseGeometry
        Surface of the arm.

    Returns
    -------
    distance_m : float
        From the street's begin. [m]
    """
    radius_m = DEFAULTS["roundabout"]["corner_m"]
    whole = ring.union(arm)
    rounded = whole.buffer(radius_m, quad_segs=16).buffer(-radius_m, quad_segs=16)
    shapely.prepare(rounded)
    limit_m = DEFAULTS["junction"]["max_mouth_m"]
    stations = np.arange(0.0, limit_m, _STEP_M)
    half_m = np.array([0.5 * street.section_at(one).width_m for one in stations])
    middle, across = carriageway_points(street, stations)
    is_rounded = np.zeros(len(stations), dtype=bool)
    for sign in (1.0, -1.0):
        beside = middle + sign * (half_m + _BESIDE_KERB_M)[:, None] * across
        is_rounded |= shapely.contains_xy(rounded, *beside.T)
    # A circle that leaves a line is so far beside it soon after its begin.
    run_m = float(np.sqrt(2.0 * radius_m * _BESIDE_KERB_M))
    clear = np.flatnonzero(~is_rounded & (stations > 0.0))
    if len(clear):
        return float(stations[clear[0]]) + run_m + _STEP_M
    return float(limit_m)


def group_arms(arms: Sequence[StreetArm]) -> list[list[int]]:
    """Groups of streets that lead the same way side by side: one arm each.

    Parameters
    ----------
    arms : sequence of StreetArm
        Arms of one junction.

    Returns
    -------
    groups : list of list of int
        Indices of `arms`.
    """
    directions = [arm.direction for arm in arms]
    points = [arm.mouth_point_m for arm in arms]

    def is_pair(one: int, other: int) -> bool:
        mean = directions[one] + directions[other]
        across_m = abs(float((points[other] - points[one]) @ [-mean[1], mean[0]]))
        reach_m = arms[one].half_width_m + arms[other].half_width_m + _SAME_ARM_GAP_M
        is_same_way = directions[one] @ directions[other] >= _SAME_ARM_COSINE
        return bool(is_same_way and across_m <= reach_m * np.hypot(*mean))

    return chained(len(arms), is_pair)


def _clear_from_m(street: Street, others: BaseGeometry) -> float:
    """Distance at which a street's cross-section leaves other surfaces.

    Parameters
    ----------
    street : Street
        The street.
    others : BaseGeometry
        Road surface of everything else in the junction.

    Returns
    -------
    distance_m : float
        From the street's begin; the largest allowed one if it never leaves
        them. [m]
    """
    limit_m = DEFAULTS["junction"]["max_mouth_m"]
    stations = np.arange(0.0, limit_m, _STEP_M)
    half = np.array([0.5 * street.section_at(one).width_m for one in stations])
    # Neighbours may touch.
    half -= 0.05
    middle, across = carriageway_points(street, stations)
    ends = [middle + sign * half[:, None] * across for sign in (1.0, -1.0)]
    shapely.prepare(others)
    is_touching = shapely.intersects(
        shapely.linestrings(np.stack(ends, axis=1)), others
    )
    # Where the streets meet.
    is_touching[0] = True
    clear = np.flatnonzero(~is_touching)
    if len(clear):
        return float(stations[clear[0]])
    return float(limit_m)


# ---------- nodes of junctions
@dataclass(slots=True)
class Clusters:
    """Nodes of junctions, joined step by step.

    Attributes
    ----------
    of_row : dict[int, int]
        Number of the junction, by row of the node.
    members : dict[int, list[int]]
        Rows of nodes, by number of the junction.
    """

    of_row: dict[int, int] = field(default_factory=dict)
    members: dict[int, list[int]] = field(default_factory=dict)

    def add(self, row: int, number: int | None = None) -> None:
        """Add a node to a junction, by default to a new one.

        Parameters
        ----------
        row : int
            Row of the node.
        number : int or None
            Number of the junction; None: a new one, named after the node.
        """
        if row not in self.of_row:
            if number is None:
                number = row
            self.of_row[row] = number
            self.members.setdefault(self.of_row[row], []).append(row)

    def join(self, one: int, other: int) -> None:
        """Make one junction of two.

        Parameters
        ----------
        one : int
            Number of the junction that stays.
        other : int
            Number of the junction that is merged into it.
        """
        if one != other:
            for row in self.members[other]:
                self.of_row[row] = one
            self.members[one] += self.members.pop(other)


def find_clusters(network: Network, *, staggered_m: float = 0.0) -> Clusters:
    """Nodes where roads meet, those of one junction together.

    A node counts if at least three roads on the ground meet there, or roads and
    yards at a signal, unless it is a mere fork.

    Parameters
    ----------
    network : Network
        Roads for cars.
    staggered_m : float
        Two side roads that meet a road from either side no farther apart than
        this are one junction. [m]

    Returns
    -------
    clusters : Clusters
        At least one node for each junction.
    """
    clusters = Clusters()
    for row, ends in network.ends.items():
        edges = [network.edges[index] for index, _ in ends]
        n_full = sum(not edge.is_service for edge in edges)
        tags = network.elements.node_tags.get(row, {})
        is_signal = tags.get("highway") == "traffic_signals"
        is_meeting = n_full >= 3 or (is_signal and n_full > 0 and len(edges) >= 3)
        is_on_ground = any(edge.level == 0 for edge in edges)
        if is_meeting and is_on_ground and not is_fork(network, ends):
            clusters.add(row)
    _join_roundabouts(network, clusters)
    _join_near(network, clusters, staggered_m)
    return clusters


def is_fork(network: Network, ends: tuple[End, ...]) -> bool:
    """True if one road splits into carriageways, or into road and ramp.

    Parameters
    ----------
    network : Network
        Roads for cars.
    ends : tuple of End
        Ends of the edges that meet at the node.

    Returns
    -------
    is_fork : bool
        Exactly three roads meet, two of them one-way and close to each other in
        direction.
    """
    ends = tuple(end for end in ends if not network.edges[end[0]].is_service)
    if len(ends) != 3 or any(network.edges[index].is_roundabout for index, _ in ends):
        return False
    bearings = {end: network.bearing_deg(end) for end in ends}

    def apart_deg(one: End, other: End) -> float:
        return abs((bearings[one] - bearings[other] + 180.0) % 360.0 - 180.0)

    # Try each end as the stem that splits into the two others.
    for stem in ends:
        one, other = (end for end in ends if end != stem)
        edges = [network.edges[end[0]] for end in (one, other, stem)]
        if not (edges[0].is_oneway and edges[1].is_oneway):
            continue
        off_stem_deg = min(apart_deg(one, stem), apart_deg(other, stem))
        if apart_deg(one, other) > _FORK_DEG or off_stem_deg < 90.0:
            continue
        is_split = not edges[2].is_oneway and one[1] != other[1]
        kinds = [edge.tags["highway"] for edge in edges]
        has_ramp = any(kind.endswith("_link") or kind == "motorway" for kind in kinds)
        is_ramp = one[1] == other[1] and has_ramp
        if is_split or is_ramp:
            return True
    return False


def _join_roundabouts(network: Network, clusters: Clusters) -> None:
    """Make one junction of the nodes of each ring and of what touches it."""
    # Edges of one ring share nodes: join those first.
    rings = Clusters()
    for edge in network.edges:
        if edge.is_roundabout and not edge.is_service:
            begin = int(edge.rows[0])
            end = int(edge.rows[-1])
            rings.add(begin)
            rings.add(end)
            rings.join(rings.of_row[begin], rings.of_row[end])
    for rows in rings.members.values():
        known = {clusters.of_row[row] for row in rows if row in clusters.of_row}
        numbers = sorted(known)
        most_m = DEFAULTS["junction"]["max_roundabout_m"]
        if numbers and _size_m(network, rows) <= most_m:
            for number in numbers[1:]:
                clusters.join(numbers[0], number)
            for row in rows:
                clusters.add(row, numbers[0])


def _size_m(network: Network, rows: Sequence[int]) -> float:
    """Diagonal of the box around some nodes, in metres."""
    width_m, height_m = np.ptp(network.elements.positions_m[rows], axis=0)
    return float(np.hypot(width_m, height_m))


def _join_near(network: Network, clusters: Clusters, staggered_m: float) -> None:
    """Join junctions that are linked by a short street.

    The shortest links are taken first. A junction never grows beyond its
    largest size, except around a roundabout. `staggered_m` is the longest link
    between two side roads on either side of a road.
    """
    limits = DEFAULTS["junction"]
    of_row = clusters.of_row
    # Streets between nodes of junctions that are short enough to join them.
    links = []
    for street in trace_streets(network, of_row.__contains__):
        begin = int(street.rows[0])
        end = int(street.rows[-1])
        if begin in of_row and end in of_row:
            # Whether it links the carriageways of another street, across its median.
            edges = [
                [network.edges[index] for index, _ in network.ends[at]]
                for at in (begin, end)
            ]
            names = [
                {one.name for one in here if one.is_oneway and one.name}
                for here in edges
            ]
            own_name = street.parts[0][0].name
            is_wide = bool(names[0] & names[1] - {own_name})
            at_rings = [any(one.is_roundabout for one in here) for here in edges]
            if all(at_rings):
                # Two roundabouts are two junctions.
                continue
            if any(at_rings):
                # What lies beyond a roundabout is a junction of its own.
                most_m = _STUB_M
            elif is_wide:
                most_m = limits["join_carriageways_m"]
            else:
                most_m = limits["join_m"]
            apart_m = staggered_m * _is_staggered(network, street)
            if street.length_m <= max(most_m, apart_m):
                links.append((street.length_m, begin, end))
    # The shortest links first, as long as junctions stay small enough.
    for _, begin, end in sorted(links):
        one = of_row[begin]
        other = of_row[end]
        if one == other:
            continue
        rows = clusters.members[one] + clusters.members[other]
        is_small = _size_m(network, rows) <= limits["max_size_m"]
        has_ring = any(
            network.edges[index].is_roundabout
            for row in rows
            for index, _ in network.ends[row]
        )
        if is_small or has_ring:
            clusters.join(one, other)


def _is_staggered(network: Network, street: Street) -> bool:
    """True if one side road leaves each end of a street, to either side."""
    first, is_along = street.parts[0]
    last, runs_along = street.parts[-1]
    sides = []
    for at, edge, is_first in ((0, first, is_along), (-1, last, not runs_along)):
        meeting = [
            (network.edges[one[0]], one) for one in network.ends[int(street.rows[at])]
        ]
        ends = [one for other, one in meeting if not other.is_service]
        others = [
            one for one in ends if (network.edges[one[0]], one[1]) != (edge, is_first)
        ]
        if len(ends) != 3 or len(others) != 2:
            return False
        own = next(one for one in ends if one not in others)
        ahead_deg = network.bearing_deg(own)
        turns_deg = [(network.bearing_deg(one) - ahead_deg) % 360.0 for one in others]
        sharpest_deg = max(turns_deg, key=lambda turn: abs(turn - 180.0))
        sides.append(sharpest_deg < 180.0)
    # To the same hand of who looks along the street from either end.
    return sides[0] == sides[1]


# ---------- junctions
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ring:
    """A junction around which traffic is led.

    Attributes
    ----------
    junction : str
        Its id.
    arms : tuple of StreetArm
        Streets that leave it.
    inside : tuple of Street
        Streets between its nodes: the ring, and ways that lead to it.
    """

    junction: str
    arms: tuple[StreetArm, ...]
    inside: tuple[Street, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reach:
    """Part of a street that has lanes, and the junctions at its ends.

    Attributes
    ----------
    street : Street
        The whole street.
    begin_m : float
        Station where lanes begin. [m]
    end_m : float
        Station where lanes end; there are none if it is not beyond the begin.
        [m]
    from_junction : str
        Id of the junction at the begin; empty: none.
    to_junction : str
        Id of the junction at the end; empty: none.
    """

    street: Street
    begin_m: float
    end_m: float
    from_junction: str = ""
    to_junction: str = ""


def find_junctions(
    network: Network,
    *,
    staggered_m: float = 0.0,
) -> tuple[list[Reach], list[MapJunction], list[Ring]]:
    """Streets with the reach of their lanes, all junctions, and roundabouts.

    Parameters
    ----------
    network : Network
        Roads for cars.
    staggered_m : float
        See :func:`find_clusters`. [m]

    Returns
    -------
    reaches : list of Reach
        Streets outside junctions.
    junctions : list of MapJunction
        Ascending by their ids, which are those of their lowest nodes.
    rings : list of Ring
        Junctions that are roundabouts.
    """
    elements = network.elements
    clusters = find_clusters(network, staggered_m=staggered_m)
    known: _Placed = {}
    for number_of_round in count():
        streets = trace_streets(network, clusters.of_row.__contains__)
        arms, inside = _arms_by_cluster(streets, clusters, known)
        stubs = _take_stubs(network, arms, inside)
        if number_of_round < _MAX_ROUNDS:
            around = {number for number in inside if is_roundabout(inside[number])}
            if _take_in_forks(network, clusters, arms, around):
                continue
        if not _drop_small(clusters, arms, elements):
            break
    for stub in stubs:
        elements.omissions.add("roads", f"way {stub.street.parts[0][0].way_id}", _STUB)
    nodes = elements.node_ids
    ids = {
        number: f"n{int(nodes[rows].min())}"
        for number, rows in clusters.members.items()
    }
    reaches = _reaches(network, streets, clusters, arms, ids)
    # Where streets are short, lanes begin nearer than the arms asked for.
    mouths: dict[tuple[int, bool], float] = {}
    for index, reach in reaches.items():
        mouths[index, True] = reach.begin_m
        mouths[index, False] = reach.street.length_m - reach.end_m
    junctions = []
    rings = []
    for number, here in arms.items():
        final = [replace(arm, mouth_m=mouths[arm.index, arm.is_begin]) for arm in here]
        rows = clusters.members[number]
        streets_inside = inside.get(number, [])
        outline = _outline(final, streets_inside, elements.positions_m[rows])
        name = _name(final, streets_inside)
        roads = find_leading_roads(network, rows, outline)
        junctions.append(
            MapJunction(id=ids[number], name=name, outline_m=outline, roads=roads)
        )
        if is_roundabout(streets_inside):
            arms_here = tuple(final)
            streets_here = tuple(streets_inside)
            rings.append(
                Ring(junction=ids[number], arms=arms_here, inside=streets_here)
            )
    junctions.sort(key=lambda junction: int(junction.id[1:]))
    return list(reaches.values()), junctions, rings


def _arms_by_cluster(
    streets: Sequence[Street],
    clusters: Clusters,
    known: _Placed,
) -> tuple[dict[int, list[StreetArm]], dict[int, list[Street]]]:
    """Arms of each junction and streets inside it, by its number.

    Parameters
    ----------
    streets : sequence of Street
        All streets, traced between the nodes of junctions.
    clusters : Clusters
        Nodes of junctions; changed in place.
    known : _Placed
        Mouths that were placed in earlier rounds, by the streets of a junction;
        extended.

    Returns
    -------
    arms : dict of int to list of StreetArm
        Streets that leave the junction.
    inside : dict of int to list of Street
        Streets that lead back to it.
    """
    limit_m = DEFAULTS["junction"]["max_size_m"]
    arms: dict[int, list[StreetArm]] = {number: [] for number in clusters.members}
    inside: dict[int, list[Street]] = defaultdict(list)
    for index, street in enumerate(streets):
        begin = clusters.of_row.get(int(street.rows[0]))
        end = clusters.of_row.get(int(street.rows[-1]))
        is_ring = all(edge.is_roundabout for edge, _ in street.parts)
        may_be_inside = street.length_m <= limit_m or is_ring
        if begin is not None and begin == end and may_be_inside:
            inside[begin].append(street)
            continue
        if begin is not None:
            arms[begin].append(StreetArm(street=street, index=index, is_begin=True))
        if end is not None:
            arms[end].append(
                StreetArm(street=street.reversed(), index=index, is_begin=False)
            )
    for number, here in arms.items():
        # Most junctions stay as they are from round to round.
        meeting = [*(arm.street for arm in here), *inside[number]]
        paths = []
        for street in meeting:
            path = tuple((edge.id, is_along) for edge, is_along in street.parts)
            paths.append(path)
        key = tuple(paths)
        if key not in known:
            placed_arms = place_mouths(here, inside[number])
            known[key] = [arm.mouth_m for arm in placed_arms]
        placed = zip(here, known[key], strict=True)
        arms[number] = [replace(arm, mouth_m=mouth_m) for arm, mouth_m in placed]
    return arms, inside


def _take_in_forks(
    network: Network,
    clusters: Clusters,
    arms: Mapping[int, Sequence[StreetArm]],
    rings: Container[int],
) -> bool:
    """Join forks next to a junction to it; True if there were any.

    These are forks in an arm before it begins, and those at the tip of a
    splitter island; next to one of the `rings` those soon after it begins, too,
    where lanes would have no room to part.
    """
    island_m = DEFAULTS["junction"]["island_m"]
    taken = []
    for number, here in arms.items():
        group_of: dict[int, int] = {}
        for at, group in enumerate(group_arms(here)):
            for index in group:
                group_of[index] = at
        # Streets that end at a fork, by its node.
        branches = {
            int(arm.street.rows[-1]): group_of[index]
            for index, arm in enumerate(here)
            if arm.street.length_m <= island_m
        }
        beyond_m = _BEYOND_M
        if number in rings:
            beyond_m = _PART_M
        for index, arm in enumerate(here):
            own = group_of[index]
            for row, station in zip(
                arm.street.rows.tolist(),
                arm.street.stations_m,
                strict=True,
            ):
                is_island = station <= island_m and branches.get(row, own) != own
                is_before_mouth = station <= arm.mouth_m + beyond_m
                is_free = row not in clusters.of_row
                is_near = is_free and (is_before_mouth or is_island)
                if is_near and is_fork(network, network.ends.get(row, ())):
                    taken.append((row, number))
    for row, number in taken:
        clusters.add(row, number)
    return bool(taken)


def _take_stubs(
    network: Network,
    arms: dict[int, list[StreetArm]],
    inside: dict[int, list[Street]],
) -> list[StreetArm]:
    """Move dead ends next to a junction from its arms into it.

    Parameters
    ----------
    network : Network
        Roads for cars.
    arms : dict[int, list[StreetArm]]
        Arms by junction; changed in place.
    inside : dict[int, list[Street]]
        Streets inside each junction; changed in place.

    Returns
    -------
    stubs : list of StreetArm
        What was moved.
    """
    stubs = []
    for number, here in arms.items():
        blind = [
            arm for arm in here if len(network.ends[int(arm.street.rows[-1])]) == 1
        ]
        ending = [arm for arm in blind if arm.street.length_m - arm.mouth_m < _STUB_M]
        inside[number] += [arm.street for arm in ending]
        arms[number] = [arm for arm in here if arm not in ending]
        stubs += ending
    return stubs


def _drop_small(
    clusters: Clusters,
    arms: Mapping[int, Sequence[StreetArm]],
    elements: Elements,
) -> bool:
    """Drop meetings of roads that are no junctions; True if there were any.

    Parameters
    ----------
    clusters : Clusters
        Nodes of junctions; changed in place.
    arms : Mapping[int, Sequence[StreetArm]]
        Arms by junction.
    elements : Elements
        Elements of the file.

    Returns
    -------
    has_dropped : bool
        The network must be traced again.
    """
    min_arms = DEFAULTS["junction"]["min_arms"]
    least_m = DEFAULTS["cross_section"]["min_road_m"]
    small = {}
    for number, here in arms.items():
        long = [arm for arm in here if arm.street.length_m >= least_m]
        nodes = (elements.node_tags.get(row, {}) for row in clusters.members[number])
        if len(group_arms(long)) < min_arms:
            small[number] = "fewer than three arms: roads merge or end"
        elif is_merge([arm.street.parts[0] for arm in here], nodes):
            small[number] = "motorways merge or part where nobody walks"
    for number, why in small.items():
        node = int(elements.node_ids[clusters.members[number]].min())
        elements.omissions.add("meetings of roads", f"node {node}", why)
        for row in clusters.members.pop(number):
            del clusters.of_row[row]
    return bool(small)


def _reaches(
    network: Network,
    streets: Sequence[Street],
    clusters: Clusters,
    arms: Mapping[int, Sequence[StreetArm]],
    ids: Mapping[int, str],
) -> dict[int, Reach]:
    """The part of each street that has lanes, by the street's index.

    Parameters
    ----------
    network : Network
        Roads for cars.
    streets : sequence of Street
        All streets.
    clusters : Clusters
        Nodes of junctions; changed in place.
    arms : Mapping[int, Sequence[StreetArm]]
        Arms by junction.
    ids : Mapping[int, str]
        Ids of junctions, by their numbers.

    Returns
    -------
    reaches : dict of int to Reach
        Streets inside junctions have none.
    """
    least_m = DEFAULTS["cross_section"]["min_road_m"]
    mouths = {
        (arm.index, arm.is_begin): arm.mouth_m for here in arms.values() for arm in here
    }
    reaches = {}
    for index, street in enumerate(streets):
        numbers = [clusters.of_row.get(int(street.rows[at])) for at in (0, -1)]
        # How far inside the street its lanes begin at either end.
        ends_m: list[float | None] = []
        for number, at in zip(numbers, (0, -1), strict=True):
            if number is None:
                ends_m.append(_road_beside_m(network, street, at))
            else:
                ends_m.append(mouths.get((index, at == 0)))
        from_m, to_m = ends_m
        if from_m is None or to_m is None:
            # Inside a junction.
            continue
        free_m = max(street.length_m - least_m, 0.0)
        # Two junctions so near that both get less.
        if (both_m := from_m + to_m) > free_m:
            from_m = from_m * free_m / both_m
            to_m = to_m * free_m / both_m
        names = []
        for number in numbers:
            if number is None:
                names.append("")
            else:
                names.append(ids[number])
        reaches[index] = Reach(
            street=street,
            begin_m=from_m,
            end_m=street.length_m - to_m,
            from_junction=names[0],
            to_junction=names[1],
        )
    return reaches


def _road_beside_m(network: Network, street: Street, at: int) -> float:
    """Half the width of the road that a yard leads into, in metres.

    Parameters
    ----------
    network : Network
        Roads for cars.
    street : Street
        The street.
    at : int
        0 for the start of the street, -1 for its end.

    Returns
    -------
    distance_m : float
        0 if the street is no yard. [m]
    """
    if not street.parts[at][0].is_service:
        return 0.0
    row = int(street.rows[at])
    others = [network.edges[index] for index, _ in network.ends[row]]
    half_widths_m = [0.5 * one.section.width_m for one in others if not one.is_service]
    return max(half_widths_m, default=0.0)


def _outline(
    arms: Sequence[StreetArm],
    inside: Sequence[Street],
    points_m: FloatArray,
) -> FloatArray:
    """Outline of a junction's road surface, up to where its arms begin.

    Islands inside it count as surface.

    Parameters
    ----------
    arms : sequence of StreetArm
        Arms of one junction.
    inside : sequence of Street
        Streets inside the junction.
    points_m : (n, 2) float
        Its nodes. [m]

    Returns
    -------
    outline_m : (k, 2) float
        Open ring, with rounded kerbs. [m]
    """
    corner_m = DEFAULTS["junction"]["corner_m"]
    if is_roundabout(inside):
        corner_m = DEFAULTS["roundabout"]["corner_m"]
    surfaces = _surfaces_inside(inside)
    surfaces += [surface(arm.street, 0.0, arm.mouth_m) for arm in arms]
    radius_m = min((arm.half_width_m for arm in arms), default=1.0)
    surfaces += [Point(point).buffer(radius_m, quad_segs=4) for point in points_m]
    whole = shapely.union_all(surfaces)
    # Kerbs are rounded, narrow islands belong to the surface.
    rounded = whole.buffer(corner_m, quad_segs=8).buffer(-corner_m, quad_segs=8)
    ends_m = [min(arm.mouth_m + 10.0, arm.street.length_m) for arm in arms]
    beyond = [
        surface(arm.street, arm.mouth_m, m) for arm, m in zip(arms, ends_m, strict=True)
    ]
    rest = rounded.union(whole).difference(shapely.union_all(beyond))
    smallest = Point(0.0, 0.0).buffer(1.0)
    polygon = max(polygons_of(rest), key=lambda part: part.area, default=smallest)
    return np.asarray(shapely.simplify(polygon.exterior, 0.02).coords)[:-1]


def _name(arms: Sequence[StreetArm], inside: Sequence[Street]) -> str:
    """Names of the streets that meet, the busiest first."""
    ranks: dict[str, int] = {}
    edges = [arm.street.parts[0][0] for arm in arms]
    counts = Counter(edge.name for edge in edges)
    edges += [edge for street in inside for edge, _ in street.parts]
    for edge in edges:
        if edge.name:
            rank = DEFAULTS["roads"][edge.tags["highway"]]["rank"]
            ranks[edge.name] = min(rank, ranks.get(edge.name, rank))
    return " / ".join(
        sorted(ranks, key=lambda name: (ranks[name], -counts[name], name))
    )


# ---------- where motorways merge or part
def is_merge(arms: Sequence[tuple[Edge, bool]], nodes: Iterable[Tags]) -> bool:
    """True if motorways or trunk roads merge or part, and nobody walks.

    Parameters
    ----------
    arms : Sequence[tuple[Edge, bool]]
        Edges that meet, and whether they lead away from the meeting.
    nodes : iterable of Tags
        Tags of the nodes of the meeting.

    Returns
    -------
    is_merge : bool
        Such a meeting is no junction.
    """
    edges = [(edge, edge.tags["highway"], is_away) for edge, is_away in arms]
    if not edges:
        return False
    for edge, *_ in edges:
        has_walkers = edge.tags.get("foot") in ("yes", "designated")
        has_sidewalk = edge.tags.get("sidewalk") in ("both", "left", "right", "yes")
        if edge.is_service or has_walkers or has_sidewalk:
            return False
    if any(tags.get("highway") in ("traffic_signals", "crossing") for tags in nodes):
        return False
    n_away = sum(is_away for *_, is_away in edges)
    fast = ("motorway", "motorway_link")
    is_fast = [
        kind in fast or edge.tags.get("motorroad") == "yes" for edge, kind, _ in edges
    ]
    is_oneway = all(edge.is_oneway for edge, *_ in edges)
    is_parting = min(n_away, len(edges) - n_away) <= 1 and is_oneway
    is_trunk = [highway in ("trunk", "trunk_link") for _, highway, _ in edges]
    is_fast_or_trunk = bool(np.logical_or(is_fast, is_trunk).all())
    return all(is_fast) or (is_parting and is_fast_or_trunk)


# ---------- roads that lead to a junction
def find_leading_roads(
    network: Network,
    rows: Iterable[int],
    outline_m: FloatArray,
) -> tuple[LeadingRoad, ...]:
    """Roads that leave a junction and go on.

    The network is walked from the junction's nodes until its ways leave the
    outline. Those that end nowhere less than a stub's length beyond it are no
    roads. Lanes are those of the tags at the stub's length.

    Parameters
    ----------
    network : Network
        Roads for cars.
    rows : iterable of int
        Rows of the junction's nodes.
    outline_m : (n, 2) float
        Its outline. [m]

    Returns
    -------
    roads : tuple of LeadingRoad
        With the numbers of lanes in and out.
    """
    area = area_of(outline_m).buffer(_BEYOND_M)
    shapely.prepare(area)
    waiting = deque(rows)
    seen = set(waiting)
    done: set[int] = set()
    found: list[LeadingRoad] = []
    while waiting:
        for end in network.ends.get(waiting.popleft(), ()):
            if end[0] in done:
                continue
            line = shapely.LineString(network.points_from(end))
            # Both its ends lie inside.
            if shapely.intersects(area, shapely.Point(line.coords[-1])):
                done.add(end[0])
                index, is_start = end
                rows_of_edge = network.edges[index].rows
                far = int(rows_of_edge[-1 if is_start else 0])
                if far not in seen:
                    seen.add(far)
                    waiting.append(far)
                continue
            tips = shapely.get_coordinates(line.intersection(area))
            located = shapely.line_locate_point(line, shapely.points(tips))
            left_at_m = 0.0
            if len(tips):
                left_at_m = float(located.max())
            found += _road(network, end, line, left_at_m)
    return tuple(found)


def _directions(network: Network, end: End) -> frozenset[bool]:
    """Directions in which cars drive on an edge: True is away from `end`."""
    return frozenset(one == end[1] for one in network.edges[end[0]].section.directions)


def _road(
    network: Network,
    end: End,
    line: Any,
    left_at_m: float,
) -> Iterator[LeadingRoad]:
    """The road on which an edge leaves a junction, unless it is a stub.

    Parameters
    ----------
    network : Network
        Roads for cars.
    end : End
        An edge, and whether its first node is meant.
    line : Any
        Line of the edge, a shapely LineString from `end`.
    left_at_m : float
        Distance along it at which it leaves the outline. [m]

    Yields
    ------
    road : LeadingRoad
        None if the way ends just beyond the junction or has no lane.
    """
    points = network.points_from(end)
    stations_m = [left_at_m, left_at_m + _AHEAD_M]
    point, ahead = shapely.get_coordinates(
        shapely.line_interpolate_point(line, stations_m)
    )
    way = end
    rest_m = line.length - left_at_m
    passed = {end[0]}
    # The way beyond a node where it is only cut in two.
    while rest_m < _STUB_M:
        index, is_start = way
        row = int(network.edges[index].rows[-1 if is_start else 0])
        others = [one for one in network.ends[row] if one[0] not in passed]
        if len(network.ends[row]) == 1:
            # A stub.
            return
        if len(others) != 1:
            break
        if _directions(network, others[0]) != _directions(network, way):
            break
        way = others[0]
        passed.add(way[0])
        rest_m += shapely.LineString(network.points_from(way)).length
    edge = network.edges[way[0]]
    begin = point
    step = np.hypot(*(ahead - begin))
    if step < 1e-6:
        begin = points[-2]
        ahead = points[-1]
        step = np.hypot(*(ahead - begin))
    is_outwards = way[1]
    n_in = len(edge.section.lanes(is_forward=not is_outwards))
    n_out = len(edge.section.lanes(is_forward=is_outwards))
    if n_in or n_out:
        yield LeadingRoad(
            name=clean_name(edge.name or f"way {edge.way_id}"),
            point_m=point,
            direction=(ahead - begin) / step,
            lanes_in=n_in,
            lanes_out=n_out,
        )
