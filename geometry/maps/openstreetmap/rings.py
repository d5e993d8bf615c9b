"""Rings of roundabouts as smooth closed lines."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ...arrays import FloatArray
from ...lines import along_m, apart, length_m, points_at
from .elements import DEFAULTS, Tags, numbered
from .network import (
    Edge,
    End,
    Network,
    Street,
    build_cross_section,
    network_of,
    surface,
)

# Between points of the line, and nodes of a ring that are one.
_STEP_M = 0.5
# Of its length, a road may lose so much to a mini-roundabout at each end.
_SHARE_OF_ROAD = 0.4
_LEAST_ROADS = 3
_MINI = "its ring is not mapped: a usual one is assumed around the node"
_NOT_CLOSED = "a roundabout whose ring is not closed in the map"
_BOTH_WAYS = "a roundabout whose ring is driven both ways"
_SEVERAL = "several roundabouts in one junction"


class RingError(Exception):
    """A roundabout cannot be laid; the text says what it is."""


class Stretch(NamedTuple):
    """A street inside the junction in driving direction.

    Attributes
    ----------
    begin, end : int
        Rows of its first and last node.
    street : Street
        The street.
    is_ring : bool
        It is part of the ring.
    """

    begin: int
    end: int
    street: Street
    is_ring: bool


def find_stretches(inside: Iterable[Street]) -> Iterator[Stretch]:
    """Streets inside a roundabout, once for each direction in which cars drive.

    Parameters
    ----------
    inside : iterable of Street
        Streets between the nodes of the junction.

    Yields
    ------
    stretch : Stretch
        A street in driving direction.

    Raises
    ------
    RingError
        The ring is driven both ways.
    """
    for street in inside:
        is_ring = all(edge.is_roundabout for edge, _ in street.parts)
        shared = frozenset.intersection(*(one.directions for one in street.sections))
        if is_ring and len(shared) != 1:
            raise RingError(_BOTH_WAYS)
        for is_forward in shared:
            driven = street
            if not is_forward:
                driven = street.reversed()
            begin = int(driven.rows[0])
            end = int(driven.rows[-1])
            yield Stretch(begin, end, driven, is_ring)


def ring_of(stretches: Iterable[Stretch]) -> list[Stretch]:
    """The parts of a roundabout's ring, one after the other.

    Parameters
    ----------
    stretches : iterable of Stretch
        Streets inside the junction.

    Returns
    -------
    ring : list of Stretch
        The last one ends where the first one begins.

    Raises
    ------
    RingError
        The ring is not closed, or not the only one.
    """
    parts = {one.begin: one for one in stretches if one.is_ring}
    first = next(iter(parts.values()))
    chain = [first]
    while chain[-1].end != first.begin:
        following = parts.get(chain[-1].end)
        if following is None or len(chain) > len(parts):
            raise RingError(_NOT_CLOSED)
        chain.append(following)
    if len(chain) < len(parts):
        raise RingError(_SEVERAL)
    return chain


def ring_axis(ring: Iterable[Stretch]) -> Any:
    """Area within the smooth line through the nodes of a ring.

    Parameters
    ----------
    ring : iterable of Stretch
        See :func:`ring_of`.

    Returns
    -------
    axis : Polygon
        Its outline runs in driving direction. [m]
    """
    nodes_m = np.concatenate([one.street.points_m[:-1] for one in ring])
    return shapely.Polygon(_round_line(nodes_m))


def roundabout_surface(inside: Iterable[Street]) -> BaseGeometry:
    """Road surface inside a roundabout, with its islands.

    Parameters
    ----------
    inside : iterable of Street
        Streets between its nodes.

    Returns
    -------
    area : BaseGeometry
        Where the ring cannot be laid, the surface of its streets. [m]
    """
    streets = list(inside)
    try:
        ring = ring_of(find_stretches(streets))
    except RingError:
        plain = [surface(street, 0.0, street.length_m) for street in streets]
        return shapely.union_all(plain)
    width_m = max(part.width_m for one in ring for part in one.street.sections)
    disc = ring_axis(ring).buffer(0.5 * width_m, quad_segs=32)
    others = [
        surface(street, 0.0, street.length_m)
        for street in streets
        if not all(edge.is_roundabout for edge, _ in street.parts)
    ]
    return shapely.union_all([disc, *others])


def _round_line(nodes_m: FloatArray) -> FloatArray:
    """Closed smooth line through the nodes of a ring.

    A circle, where they lie on one, else a periodic smoothing spline.

    Parameters
    ----------
    nodes_m : (n, 2) float
        Nodes in driving direction, each once. [m]

    Returns
    -------
    line_m : (k, 2) float
        In driving direction; not closed. [m]
    """
    limits = DEFAULTS["roundabout"]
    nodes = apart(nodes_m, _STEP_M)
    shape = shapely.Polygon(nodes)
    # Least squares: |p|^2 = 2 c p + (R^2 - |c|^2) is linear in c and the rest.
    middle = nodes.mean(axis=0)
    offset = nodes - middle
    terms = np.column_stack([2.0 * offset, np.ones(len(offset))])
    squares = (offset**2).sum(axis=1)
    (east, north, rest), *_ = np.linalg.lstsq(terms, squares, rcond=None)
    centre = np.array([east, north])
    radius_m = float(np.sqrt(max(rest + centre @ centre, 0.0)))
    off_m = np.abs(np.hypot(*(offset - centre).T) - radius_m)
    turn = 1.0
    if not shape.exterior.is_ccw:
        turn = -1.0
    if off_m.max() <= min(limits["max_off_circle_m"], 0.2 * radius_m):
        n_points = max(64, int(2.0 * np.pi * radius_m / _STEP_M))
        angle = turn * np.linspace(0.0, 2.0 * np.pi, n_points, endpoint=False)
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.asarray(middle + centre + radius_m * circle)
    # Takes a third of a second to import.
    from scipy.interpolate import splev, splprep

    closed = np.vstack([nodes, nodes[:1]])
    if len(nodes) < 4:
        return nodes
    spline: Any
    spline, _ = splprep(
        closed.T, s=len(nodes) * limits["smoothing_m"] ** 2, per=True, quiet=1
    )
    n_points = max(64, int(length_m(closed) / _STEP_M))
    share = np.linspace(0.0, 1.0, n_points, endpoint=False)
    return np.stack(splev(share, spline), axis=1)


# ---------- roundabouts that are mapped as a node
def open_mini_roundabouts(network: Network) -> Network:
    """A network in which mini-roundabouts are rings.

    Of a node ``highway=mini_roundabout`` at which at least three roads meet, each
    road ends at a ring around it. Where the roads are short, the ring is smaller.

    Parameters
    ----------
    network : Network
        As ways have it.

    Returns
    -------
    network : Network
        With rows for the nodes of the rings behind all others.
    """
    elements = network.elements
    rows = [
        row
        for row, ends in network.ends.items()
        if elements.node_tags.get(row, {}).get("highway") == "mini_roundabout"
        and len(_roads_at(network, ends)) >= _LEAST_ROADS
    ]
    if not rows:
        return network
    edges = list(network.edges)
    node_ids = elements.node_ids.tolist()
    positions = elements.positions_m.tolist()
    for row in rows:
        roads = _roads_at(network, network.ends[row])
        shortest_m = min(length_m(edges[index].points_m) for index, _ in roads)
        usual_m = DEFAULTS["roundabout"]["mini_radius_m"]
        radius_m = min(usual_m, _SHARE_OF_ROAD * shortest_m)
        middle = elements.positions_m[row]
        # Where each road meets the ring, and the new row there.
        places: list[tuple[float, int]] = []
        for end in roads:
            index, is_start = end
            points = network.points_from(end)
            at = points_at(points, np.array([radius_m]))[0]
            new = len(positions)
            node_ids.append(node_ids[row])
            positions.append(at.tolist())
            east, north = at - middle
            places.append((float(np.arctan2(north, east)), new))
            edges[index] = _cut_edge(edges[index], radius_m, at, new, is_start=is_start)
        places.sort(reverse=network.keeps_left)
        tags = _ring_tags([edges[index].tags for index, _ in roads])
        section, _ = build_cross_section(tags, _no_note, keeps_left=network.keeps_left)
        order = [new for _, new in places]
        for number, pair in enumerate(pairwise([*order, order[0]])):
            edge = Edge(
                id=numbered(f"n{node_ids[row]}", number),
                way_id=edges[roads[0][0]].way_id,
                rows=np.array(pair),
                points_m=np.array([positions[at] for at in pair]),
                tags=tags,
                section=section,
            )
            edges.append(edge)
        elements.omissions.add("mini-roundabouts", f"node {node_ids[row]}", _MINI)
    elements = replace(
        elements,
        node_ids=np.array(node_ids, dtype=elements.node_ids.dtype),
        positions_m=np.array(positions),
    )
    return network_of(edges, elements, keeps_left=network.keeps_left)


def _roads_at(network: Network, ends: Iterable[End]) -> list[End]:
    """Ends of roads at a node that are no yards."""
    return [end for end in ends if not network.edges[end[0]].is_service]


def _ring_tags(tags: Iterable[Tags]) -> Tags:
    """Tags of the ring of a mini-roundabout: the class of its busiest road."""
    ranks = DEFAULTS["roads"]
    busiest = min((one["highway"] for one in tags), key=lambda one: ranks[one]["rank"])
    return {"highway": busiest, "junction": "roundabout", "lanes": "1"}


def _no_note(why: str) -> None:
    """Take no note: the tags are our own."""


def _cut_edge(
    edge: Edge, cut_m: float, at_m: FloatArray, row: int, *, is_start: bool
) -> Edge:
    """Edge without its first metres, or its last ones.

    Parameters
    ----------
    edge : Edge
        The edge.
    cut_m : float
        What is taken off. [m]
    at_m : (2,) float
        Where it begins or ends then. [m]
    row : int
        Row of the node there.
    is_start : bool
        It is cut at its first node.
    """
    points = edge.points_m
    rows = edge.rows
    if not is_start:
        points = points[::-1]
        rows = rows[::-1]
    is_beyond = along_m(points) > cut_m + 1e-3
    points = np.vstack([at_m, points[is_beyond]])
    rows = np.append(row, rows[is_beyond])
    if not is_start:
        points = points[::-1]
        rows = rows[::-1]
    return replace(edge, points_m=points, rows=rows)
