"""Rings of roundabouts as smooth closed lines."""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ...arrays import FloatArray
from ...lines import apart, length_m
from .elements import DEFAULTS
from .network import Street, surface

# Between points of the line, and nodes of a ring that are one.
_STEP_M = 0.5
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
    spline, _ = splprep(
        closed.T, s=len(nodes) * limits["smoothing_m"] ** 2, per=True, quiet=1
    )
    n_points = max(64, int(length_m(closed) / _STEP_M))
    share = np.linspace(0.0, 1.0, n_points, endpoint=False)
    return np.stack(splev(share, spline), axis=1)
