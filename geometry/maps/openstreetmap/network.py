"""The roads of a map as a graph: edges between nodes where roads meet, and streets along them."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, pairwise

import numpy as np
from numpy.typing import ArrayLike
from shapely import Polygon, make_valid
from shapely.geometry.base import BaseGeometry

from ...arrays import BoolArray, FloatArray, IntArray
from ...lines import points_at, steps_m, true_runs
from .elements import DEFAULTS, Elements, Tags, Way, is_yes, numbered, reversed_tags
from .lanes import CrossSection, build_cross_section, is_oneway, runs_backward

_MAX_STRAIGHT_ON_DEG = 60.0  # a road goes on into another one that turns off by less
End = tuple[int, bool]  # an edge and whether its first node is meant
_ACCESS = ("motorcar", "motor_vehicle", "vehicle", "access")  # the most specific first
_MAX_MITRE = 2.0  # at sharp bends lines next to a street are cut off


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edge:
    """Part of a way for cars between two nodes where ways begin, end or meet."""

    id: str  # way and part: "w5", "w5.1"
    way_id: int
    rows: IntArray  # (n,), nodes; in a one-way road cars drive in their order
    points_m: FloatArray  # (n, 2), positions of the nodes
    tags: Tags  # of the way, in the order of nodes here
    section: CrossSection

    @property
    def is_service(self) -> bool:
        """A road to a yard, not one of the network."""
        return self.tags["highway"] == "service"

    @property
    def is_oneway(self) -> bool:
        """Cars drive it one way only."""
        return is_oneway(self.tags)

    @property
    def is_roundabout(self) -> bool:
        """Part of a roundabout's ring."""
        return self.tags.get("junction") in ("roundabout", "circular")

    @property
    def name(self) -> str:
        """Of its street; empty: none."""
        return self.tags.get("name") or self.tags.get("ref", "")

    @property
    def level(self) -> int:
        """Its layer; 0: on the ground."""
        return level(self.tags)


def level(tags: Tags) -> int:
    """Layer of a way; bridges and tunnels that name none lie one above and below the ground."""
    try:
        layer = int(tags.get("layer", "0"))
    except ValueError:
        layer = 0
    if layer:
        return int(np.clip(layer, -5, 5))
    tunnel = tags.get("tunnel")
    if is_yes(tunnel) and tunnel not in ("building_passage", "culvert"):
        return -1
    return 1 if is_yes(tags.get("bridge")) else 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Network:
    """Edges, and their ends by node row."""

    edges: tuple[Edge, ...]
    ends: Mapping[int, tuple[End, ...]]
    elements: Elements
    keeps_left: bool

    def bearing_deg(self, end: End) -> float:
        """Direction in which an edge leaves its node, over its first ten metres."""
        points = self.points_from(end)
        east, north = points_at(points, np.array(10.0)) - points[0]
        return float(np.degrees(np.arctan2(north, east)))

    def points_from(self, end: End) -> FloatArray:
        """Nodes of an edge from one of its ends, (n, 2)."""
        points = self.edges[end[0]].points_m
        return points if end[1] else points[::-1]


def is_for_cars(tags: Tags) -> bool:
    """A way that cars drive on as part of the network of roads, or to a yard."""
    return (
        tags.get("highway") in DEFAULTS["roads"]
        and tags.get("area") != "yes"
        and next((tags[key] for key in _ACCESS if key in tags), "yes") != "no"
        and tags.get("service") not in ("parking_aisle", "driveway", "drive-through", "slipway")
    )


def build_network(elements: Elements, *, keeps_left: bool) -> Network:
    """The roads for cars; ways with missing nodes and senseless tags are noted."""
    runs: list[tuple[Way, list[IntArray]]] = []
    for way in elements.ways:
        if is_for_cars(way.tags):
            runs.append((way, list(known_runs(way, elements))))
            if (way.rows < 0).any() or not runs[-1][1]:
                why = "partly left out: nodes are missing in the file, as at the edge of a cut-out"
                elements.omissions.add("roads", f"way {way.id}", why)
    n_uses = np.zeros(len(elements.positions_m), dtype=np.int64)
    for rows in chain.from_iterable(found for _, found in runs):
        np.add.at(n_uses, rows[1:-1], 1)
        np.add.at(n_uses, rows[[0, -1]], 2)  # edges end where ways do
    edges: list[Edge] = []
    for way, found in runs:
        if not found:
            continue
        tags, step = dict(way.tags), 1
        if runs_backward(way.tags):
            tags, step = reversed_tags(tags) | {"oneway": "yes", "oneway:turned": "yes"}, -1
        note = partial(elements.omissions.add, "ways", f"way {way.id}")
        section = build_cross_section(tags, note, keeps_left=keeps_left)
        parts = (
            rows[begin : end + 1]
            for rows in (run[::step] for run in found)
            for begin, end in pairwise(np.flatnonzero(n_uses[rows] > 1))
        )
        edges += [
            Edge(
                id=numbered(f"w{way.id}", number),
                way_id=way.id,
                rows=rows,
                points_m=elements.positions_m[rows],
                tags=tags,
                section=section,
            )
            for number, rows in enumerate(parts)
        ]
    ends: dict[int, tuple[End, ...]] = defaultdict(tuple)
    for index, edge in enumerate(edges):
        ends[int(edge.rows[0])] += ((index, True),)
        ends[int(edge.rows[-1])] += ((index, False),)
    return Network(edges=tuple(edges), ends=dict(ends), elements=elements, keeps_left=keeps_left)


def known_runs(way: Way, elements: Elements) -> Iterator[IntArray]:
    """Parts of a way whose nodes the file has, without nodes that lie where the last one did."""
    for begin, end in true_runs(way.rows >= 0):
        part = way.rows[begin:end]
        part = part[np.append(True, steps_m(elements.positions_m[part]) > 0.01)]
        if len(part) >= 2:
            yield part


def lines_of(way: Way, elements: Elements) -> Iterator[FloatArray]:
    """Lines (n, 2) of the parts of a way whose nodes the file has."""
    for rows in known_runs(way, elements):
        yield elements.positions_m[rows]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Street:
    """Edges one after the other, between two nodes where they stop."""

    # edges, and whether they are followed in the order of their nodes
    parts: tuple[tuple[Edge, bool], ...]
    points_m: FloatArray = field(init=False)  # (n, 2)
    rows: IntArray = field(init=False)  # (n,), nodes
    stations_m: FloatArray = field(init=False)  # (n,), distance of each point along the street
    normals: FloatArray = field(init=False)  # (n - 1, 2), unit vectors to the left between points
    breaks_m: FloatArray = field(init=False)  # (n_parts + 1,), begins and ends of parts
    # of each part, in the direction of the street
    sections: tuple[CrossSection, ...] = field(init=False)

    def __post_init__(self) -> None:
        points: list[FloatArray] = []
        rows: list[IntArray] = []
        for edge, is_along in self.parts:
            step = 1 if is_along else -1
            skip = 1 if points else 0
            points.append(edge.points_m[::step][skip:])
            rows.append(edge.rows[::step][skip:])
        joined = np.concatenate(points)
        steps = np.diff(joined, axis=0)
        lengths = np.hypot(*steps.T)
        stations = np.append(0.0, np.cumsum(lengths))
        last = np.cumsum([len(part) for part in points]) - 1
        sections = tuple(
            edge.section if is_along else edge.section.reversed() for edge, is_along in self.parts
        )
        for name, value in (
            ("points_m", joined),
            ("rows", np.concatenate(rows)),
            ("stations_m", stations),
            ("normals", np.column_stack([-steps[:, 1], steps[:, 0]]) / lengths[:, None]),
            ("breaks_m", np.append(0.0, stations[last])),
            ("sections", sections),
        ):
            object.__setattr__(self, name, value)

    @property
    def length_m(self) -> float:
        """From end to end."""
        return float(self.stations_m[-1])

    def reversed(self) -> "Street":
        """Street from its end to its start."""
        return replace(
            self, parts=tuple((edge, not is_along) for edge, is_along in self.parts[::-1])
        )

    def part_at(self, station_m: float) -> int:
        """Index of the part at a distance along the street."""
        if len(self.parts) == 1:
            return 0
        index = int(np.searchsorted(self.breaks_m, station_m, side="right")) - 1
        return min(max(index, 0), len(self.parts) - 1)

    def section_at(self, station_m: float) -> CrossSection:
        """Cross-section at a distance along the street."""
        return self.sections[self.part_at(station_m)]


def trace_streets(network: Network, stops: Callable[[int], bool]) -> list[Street]:
    """Streets to nodes that `stops(row)`; elsewhere roads go straight on, others end there."""
    partner: dict[End, End] = {}
    for row, ends in network.ends.items():
        if not stops(row):
            for one, other in pair_ends(network, ends):
                partner[one], partner[other] = other, one
    is_done = np.zeros(len(network.edges), dtype=bool)
    streets = []
    starts = [end for ends in network.ends.values() for end in ends if end not in partner]
    rest = [(index, True) for index in range(len(network.edges))]  # rings without an end
    for begin in starts + rest:
        if is_done[begin[0]]:
            continue
        parts = []
        end: End | None = begin
        while end is not None and not is_done[end[0]]:
            index, is_start = end
            is_done[index] = True
            parts.append((network.edges[index], is_start))
            end = partner.get((index, not is_start))
        streets.append(Street(parts=tuple(parts)))
    return streets


def pair_ends(network: Network, ends: tuple[End, ...]) -> Iterator[tuple[End, End]]:
    """Pairs of roads that continue each other at a node that is no junction."""
    if len(ends) == 2:
        yield ends[0], ends[1]
        return
    edges = network.edges
    bearings = {end: network.bearing_deg(end) for end in ends}
    choices = []
    for index, one in enumerate(ends):
        for other in ends[:index]:
            turn = abs((bearings[one] - bearings[other]) % 360.0 - 180.0)
            pair = [edges[one[0]], edges[other[0]]]
            n_service = sum(edge.is_service for edge in pair)
            n_links = sum(edge.tags["highway"].endswith("_link") for edge in pair)
            n_full = sum(not edges[end[0]].is_service for end in ends)
            is_allowed = turn <= _MAX_STRAIGHT_ON_DEG or (n_full == 2 and n_service == 0)
            # Two one-way roads that both lead here, or both away, do not follow each other.
            leads_on = not all(edge.is_oneway for edge in pair) or one[1] != other[1]
            if is_allowed and n_service != 1 and leads_on:
                choices.append((n_service, n_links, turn, one, other))
    used: set[End] = set()
    for *_, one, other in sorted(choices):
        if one not in used and other not in used:
            used |= {one, other}
            yield one, other


# ---------- lines and areas next to a street


def axis_points(street: Street, stations_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Points of a street's axis, and the step for each metre to the left; (n, 2)."""
    stations = np.asarray(stations_m, dtype=np.float64)
    stations = np.minimum(np.maximum(stations, 0.0), street.length_m)
    points, along, normals = street.points_m, street.stations_m, street.normals
    last = len(normals) - 1
    before = np.searchsorted(along, stations - 1e-6, side="right") - 1
    after = np.searchsorted(along, stations + 1e-6, side="right") - 1
    before, after = (np.minimum(np.maximum(one, 0), last) for one in (before, after))
    normal = normals[before] + normals[after]
    squared = np.maximum((normal * normal).sum(axis=1), 1e-9)
    across = normal * (2.0 / squared)[:, None]  # as long as the offsets of both sides need
    length = 2.0 / np.sqrt(squared)
    across *= np.minimum(1.0, _MAX_MITRE / length)[:, None]
    # Left of a segment is its normal: the segment itself is the normal turned back.
    steps_m = stations - along[before]
    middle = points[before] + steps_m[:, None] * normals[before][:, ::-1] * [1.0, -1.0]
    return middle, across


def has_no_knot(line_m: FloatArray, middle: FloatArray) -> BoolArray:
    """Which points of a line next to a street's axis `middle` run on as that does, (n,)."""
    is_kept = np.ones(len(line_m), dtype=bool)
    steps = np.einsum("ij,ij->i", np.diff(line_m, axis=0), np.diff(middle, axis=0))
    if (steps > 0.0).all():
        return is_kept
    last = 0
    for index in range(1, len(line_m)):
        step, along = line_m[index] - line_m[last], middle[index] - middle[last]
        if step @ along <= 1e-3 * np.hypot(*along):
            if index < len(line_m) - 1:
                is_kept[index] = False
                continue
            is_kept[last] = last == 0
        last = index
    return is_kept


def stations_between(
    street: Street, begin_m: float, end_m: float, extra: Sequence[float] = ()
) -> FloatArray:
    """Stations where a line next to a street needs points: begin, end, bends, and `extra` ones."""
    every = np.concatenate([street.stations_m, np.asarray(extra, dtype=np.float64)])
    inside = np.unique(every[(every > begin_m + 0.05) & (every < end_m - 0.05)])
    return np.concatenate([[begin_m], inside, [end_m]])


def surface(street: Street, begin_m: float, end_m: float) -> BaseGeometry:
    """Carriageway of a street between two stations, from kerb to kerb."""
    pieces: list[BaseGeometry] = []
    for index, section in enumerate(street.sections):
        low = max(begin_m, float(street.breaks_m[index]))
        high = min(end_m, float(street.breaks_m[index + 1]))
        if high - low < 1e-3:
            continue
        middle, across = axis_points(street, stations_between(street, low, high))
        edges = [middle + sign * 0.5 * section.width_m * across for sign in (1.0, -1.0)]
        edges = [edge[has_no_knot(edge, middle)] for edge in edges]
        pieces.append(make_valid(Polygon(np.concatenate([edges[0], edges[1][::-1]]))))
    if not pieces:
        return Polygon()
    whole = pieces[0]
    for piece in pieces[1:]:
        whole = whole.union(piece)
    return whole
