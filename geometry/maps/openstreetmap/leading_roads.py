"""Roads that lead to a junction, by the network around it and the tags of its ways alone."""

from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np
import shapely

from ...arrays import FloatArray
from ...scene import LeadingRoad
from .elements import DEFAULTS
from .network import End, Network

_BEYOND_M = 1.0  # of the outline, which is rounded
_AHEAD_M = 10.0  # over which a direction is taken


def find_leading_roads(
    network: Network, rows: Iterable[int], outline_m: FloatArray
) -> tuple[LeadingRoad, ...]:
    """Ways that leave a junction and go on.

    The network is walked from the junction's nodes until its ways leave the outline. Those that end
    nowhere less than a stub's length beyond it are no roads. Lanes are those of the tags at the
    stub's length.
    """
    area = shapely.make_valid(shapely.Polygon(outline_m)).buffer(_BEYOND_M)
    shapely.prepare(area)
    waiting = deque(rows)
    seen = set(waiting)
    done: set[int] = set()
    found: list[LeadingRoad] = []
    while waiting:
        for end in network.ends.get(waiting.popleft(), ()):
            if end[0] in done:
                continue
            left_at = _leaves_at(network, end, area)
            if left_at is None:  # both its ends lie inside
                done.add(end[0])
                far = int(network.edges[end[0]].rows[-1 if end[1] else 0])
                if far not in seen:
                    seen.add(far)
                    waiting.append(far)
            else:
                found += _road(network, end, left_at)
    return tuple(found)


def _points(network: Network, end: End) -> FloatArray:
    """Nodes of an edge from one of its ends, (n, 2)."""
    points = network.edges[end[0]].points_m
    return points if end[1] else points[::-1]


def _directions(network: Network, end: End) -> frozenset[bool]:
    """Directions in which cars drive on an edge: True is away from an end of it."""
    return frozenset(one == end[1] for one in network.edges[end[0]].section.directions)


def _leaves_at(network: Network, end: End, area: shapely.Geometry) -> float | None:
    """Distance along an edge at which it leaves an area for good; None: it ends inside."""
    line = shapely.LineString(_points(network, end))
    if shapely.intersects(area, shapely.Point(line.coords[-1])):
        return None
    inside = line.intersection(area)
    tips = shapely.get_coordinates(inside)
    if not len(tips):
        return 0.0
    return float(shapely.line_locate_point(line, shapely.points(tips)).max())


def _road(network: Network, end: End, left_at_m: float) -> Iterator[LeadingRoad]:
    least_m = DEFAULTS["cross_section"]["stub_m"]
    points = _points(network, end)
    line = shapely.LineString(points)
    begin, ahead = (
        np.array(shapely.line_interpolate_point(line, left_at_m + on_m).coords[0])
        for on_m in (0.0, _AHEAD_M)
    )
    way, rest_m = end, line.length - left_at_m
    passed = {end[0]}
    while rest_m < least_m:  # the way beyond a node where it is only cut in two
        index, is_start = way
        row = int(network.edges[index].rows[-1 if is_start else 0])
        others = [one for one in network.ends[row] if one[0] not in passed]
        if len(network.ends[row]) == 1:
            return  # a stub
        if len(others) != 1 or _directions(network, others[0]) != _directions(network, way):
            break
        way = others[0]
        passed.add(way[0])
        rest_m += shapely.LineString(_points(network, way)).length
    edge = network.edges[way[0]]
    if (step := np.hypot(*(ahead - begin))) < 1e-6:
        ahead, step = points[-1], np.hypot(*(points[-1] - points[-2]))
        begin = points[-2]
    counts = {out: len(edge.section.lanes(is_forward=out == way[1])) for out in (True, False)}
    if any(counts.values()):
        yield LeadingRoad(
            name=edge.name or f"way {edge.way_id}",
            point_m=np.array(shapely.line_interpolate_point(line, left_at_m).coords[0]),
            direction=(ahead - begin) / step,
            lanes_in=counts[False],
            lanes_out=counts[True],
        )
