"""Crosswalks: lines on which pedestrians cross roads."""

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
import shapely
from shapely import LineString
from shapely.geometry.base import BaseGeometry

from ...arrays import FloatArray
from ..source_map import Omissions
from .elements import DEFAULTS, Elements
from .network import Edge, Network, known_runs, level

_FOOTWAYS = ("footway", "path", "pedestrian")
_PARALLEL = 0.8  # cosine: two lines that differ more are not one crosswalk
_LEAST_M = 0.5  # of a footway on a carriageway


def find_crosswalks(network: Network, elements: Elements, omissions: Omissions) -> FloatArray:
    """Lines (n, 2, 2) on which pedestrians cross the carriageways of roads.

    Where a mapped footway leads over roads there is a straight line over each of them, along the
    footway's direction on the carriageway; otherwise a line runs across the road at the mapped
    point. All end a little beyond the kerbs. Crossings without a road are noted.
    """
    limits = DEFAULTS["crosswalk"]
    taken = _Lines(limits["same_m"])
    covered: set[int] = set()  # nodes that lie on a mapped footway over a road
    tree = shapely.STRtree([shapely.linestrings(edge.points_m) for edge in network.edges])
    for way in elements.ways:
        if way.tags.get("footway") != "crossing" or way.tags.get("highway") not in _FOOTWAYS:
            continue
        for rows in known_runs(way.rows, network.positions_m):
            walk = LineString(network.positions_m[rows])
            edges = [
                network.edges[index]
                for index in tree.query(walk, predicate="intersects").tolist()
                if network.edges[index].level == level(way.tags)
            ]
            lines = [
                line
                for line in _over_roads(walk, edges)
                if 1.0 < np.hypot(*(line[1] - line[0])) <= limits["max_length_m"]
            ]
            if not lines:
                omissions.add("crossings", f"way {way.id}", "no road for cars below it")
                continue
            covered.update(rows.tolist())
            for line in lines:
                taken.add(line)
    at_row = _edges_at(network)
    for row, tags in elements.node_tags.items():
        if tags.get("highway") != "crossing" or tags.get("crossing") == "no":
            continue
        if row in covered or row not in at_row:
            continue
        taken.add(_across(network, row, at_row[row], limits["beyond_kerb_m"]))
    return np.array(taken.lines).reshape(-1, 2, 2)


def _over_roads(walk: LineString, edges: Sequence[Edge]) -> Iterator[FloatArray]:
    """A line (2, 2) over each road that a footway crosses, from beyond one kerb to the other.

    Carriageways that are crossed one after the other in one direction are one road's.
    """
    limits = DEFAULTS["crosswalk"]
    joined: list[tuple[LineString, BaseGeometry]] = []  # parts of the footway, and carriageways
    crossed = [
        (part, area)
        for edge in edges
        for area in [LineString(edge.points_m).buffer(0.5 * edge.section.width_m, cap_style="flat")]
        for part in _parts_over(walk, edge, area)
    ]
    crossed.sort(key=lambda pair: walk.project(shapely.Point(pair[0].coords[0])))
    for part, carriageway in crossed:
        if joined and (
            part.distance(joined[-1][0]) <= limits["median_m"]
            and abs(_direction(part) @ _direction(joined[-1][0])) > _PARALLEL
        ):
            before, area = joined.pop()
            whole = LineString([before.coords[0], part.coords[-1]])
            part, carriageway = whole, area.union(carriageway)
        joined.append((part, carriageway))
    for part, carriageway in joined:
        yield _from_kerb_to_kerb(part, carriageway, limits["beyond_kerb_m"])


def _parts_over(walk: LineString, edge: Edge, carriageway: BaseGeometry) -> Iterator[LineString]:
    """Stretches of a footway on a carriageway that meet the road's axis."""
    axis = LineString(edge.points_m)
    on_road = shapely.line_merge(shapely.intersection(walk, carriageway))
    for part in shapely.get_parts(on_road):
        if isinstance(part, LineString) and part.length > _LEAST_M and part.distance(axis) < 1e-6:
            is_along = walk.project(shapely.Point(part.coords[0])) <= walk.project(
                shapely.Point(part.coords[-1])
            )
            yield part if is_along else part.reverse()


def _direction(line: LineString) -> FloatArray:
    begin, end = np.asarray(line.coords)[[0, -1], :2]
    unit: FloatArray = (end - begin) / max(float(np.hypot(*(end - begin))), 1e-9)
    return unit


def _from_kerb_to_kerb(part: LineString, carriageway: BaseGeometry, beyond_m: float) -> FloatArray:
    """The straight line through a footway's ends on a carriageway, beyond the kerbs.

    A footway that is mapped only as far as the middle of the road is led on to the other kerb.
    """
    begin, along = np.asarray(part.coords)[0, :2], _direction(part)
    reach_m = 2.0 * DEFAULTS["crosswalk"]["max_length_m"]
    ray = LineString([begin - reach_m * along, begin + reach_m * along])
    stations = [
        np.sort((shapely.get_coordinates(piece) - begin) @ along)
        for piece in shapely.get_parts(shapely.intersection(ray, carriageway))
    ]
    own = [ends for ends in stations if ends[0] < part.length and ends[-1] > 0.0]
    low, high = min(ends[0] for ends in own), max(ends[-1] for ends in own)
    return begin + np.array([[low - beyond_m], [high + beyond_m]]) * along


def _edges_at(network: Network) -> dict[int, tuple[int, int]]:
    """An edge through each node of the roads, and which of its points lies there."""
    found: dict[int, tuple[int, int]] = {}
    for index, edge in enumerate(network.edges):
        for at, row in enumerate(edge.rows.tolist()):
            if row not in found or network.edges[found[row][0]].is_service:
                found[row] = (index, at)
    return found


def _across(network: Network, row: int, place: tuple[int, int], beyond_m: float) -> FloatArray:
    """A line from kerb to kerb and a little farther, square to the road at one of its nodes."""
    index, at = place
    edge = network.edges[index]
    points = edge.points_m
    before = points[max(at - 1, 0)]
    after = points[min(at + 1, len(points) - 1)]
    ends = network.ends.get(row, ())
    if len(ends) == 2 and {one for one, _ in ends} != {index}:
        # The way ends here and another goes on: the road bends between them.
        other, is_start = next(end for end in ends if end[0] != index)
        beyond = network.edges[other].points_m[1 if is_start else -2]
        before, after = (beyond, after) if at == 0 else (before, beyond)
    steps = [
        step / np.hypot(*step)
        for step in (points[at] - before, after - points[at])
        if np.hypot(*step) > 1e-6
    ]
    along = np.sum(steps, axis=0)
    if np.hypot(*along) < 1e-6:
        along = steps[0]
    along = along / np.hypot(*along)
    half_m = 0.5 * edge.section.width_m + beyond_m
    left = np.array([-along[1], along[0]])
    line: FloatArray = points[at] + half_m * np.stack([-left, left])
    return line


class _Lines:
    """Crosswalks so far, indexed by place."""

    def __init__(self, same_m: float) -> None:
        self.lines: list[FloatArray] = []
        self._same_m = same_m
        self._by_cell: dict[tuple[int, int], list[FloatArray]] = {}

    def add(self, line_m: FloatArray) -> None:
        """Add a line unless it is there already, mapped in another way."""
        middle = line_m.mean(axis=0)
        east, north = (int(one) for one in np.floor(middle / self._same_m))
        for cell in product((east - 1, east, east + 1), (north - 1, north, north + 1)):
            if any(self._is_same(line_m, other) for other in self._by_cell.get(cell, ())):
                return
        self.lines.append(line_m)
        self._by_cell.setdefault((east, north), []).append(line_m)

    def _is_same(self, one: FloatArray, other: FloatArray) -> bool:
        apart_m = np.hypot(*(one.mean(axis=0) - other.mean(axis=0)))
        step, other_step = one[1] - one[0], other[1] - other[0]
        cosine = abs(step @ other_step) / (np.hypot(*step) * np.hypot(*other_step))
        return bool(apart_m <= self._same_m and cosine > _PARALLEL)
