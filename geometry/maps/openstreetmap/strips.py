"""Lines and areas beside a street."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from shapely import Polygon, make_valid
from shapely.geometry.base import BaseGeometry

from ...arrays import BoolArray, FloatArray
from .network import Street

_MAX_MITRE = 2.0  # at sharp bends lines beside a street are cut off


def points_beside(street: Street, stations_m: ArrayLike, left_m: ArrayLike) -> FloatArray:
    """Points beside a street.

    Parameters
    ----------
    street : Street
        Along which.
    stations_m : (n,) float
        How far along it; rising. [m]
    left_m : (n,) float
        How far to its left there. [m]

    Returns
    -------
    points_m : (n, 2) float
        At bends on the line that halves the angle. [m]
    """
    middle, across = axis_points(street, stations_m)
    beside: FloatArray = middle + np.asarray(left_m, dtype=np.float64).reshape(-1, 1) * across
    return beside


def axis_points(street: Street, stations_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Points of a street's axis, and what to add to them for each metre to the left; (n, 2)."""
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
    """Which points of a line beside a street stay, so that it runs as the street does, (n,).

    At sharp bends a line on the inner side would run back for a while; `middle` are the points of
    the street's axis beside which those of the line lie.
    """
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
    """Where a line beside a street needs points: begin, end, bends, and others between them."""
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
        stations = stations_between(street, low, high)
        middle, across = axis_points(street, stations)
        edges = [middle + sign * 0.5 * section.width_m * across for sign in (1.0, -1.0)]
        edges = [edge[has_no_knot(edge, middle)] for edge in edges]
        pieces.append(make_valid(Polygon(np.concatenate([edges[0], edges[1][::-1]]))))
    if not pieces:
        return Polygon()
    whole = pieces[0]
    for piece in pieces[1:]:
        whole = whole.union(piece)
    return whole
