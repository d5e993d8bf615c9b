"""Rectangles on the road plane: around points, and how far a point is from their edge."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from geometry.arrays import FloatArray


def smallest_rectangle(points_m: FloatArray) -> tuple[FloatArray, float, float, float]:
    """The oriented rectangle of least area around points.

    Parameters
    ----------
    points_m : (n, 2) float
        At least one. [m]

    Returns
    -------
    middle_m : (2,) float
        Its centre. [m]
    yaw_rad : float
        Direction of its longer side, counter-clockwise from east. [rad]
    length_m, width_m : float
        Full sides, the longer one first. [m]

    References
    ----------
    .. [1] H. Freeman, R. Shapira, "Determining the minimum-area encasing rectangle", 1975: one side
       lies along an edge of the convex hull.
    """
    try:
        hull = points_m[ConvexHull(points_m).vertices]
    except (QhullError, ValueError):  # all on a line, or a single point
        hull = points_m
    edges = np.roll(hull, -1, axis=0) - hull
    angles = np.unique(np.arctan2(edges[:, 1], edges[:, 0]).round(9))
    ahead = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    left = ahead[:, ::-1] * [-1.0, 1.0]
    along, across = hull @ ahead.T, hull @ left.T
    spans = np.stack([np.ptp(along, axis=0), np.ptp(across, axis=0)])
    best = int(np.argmin(spans.prod(axis=0)))
    middle = 0.5 * (
        (along[:, best].min() + along[:, best].max()) * ahead[best]
        + (across[:, best].min() + across[:, best].max()) * left[best]
    )
    length, width = spans[:, best].tolist()
    if length >= width:
        return middle, float(angles[best]), length, width
    return middle, float(angles[best] + 0.5 * np.pi), width, length


def rectangle_distance(points_m: FloatArray, rectangle: FloatArray) -> FloatArray:
    """Signed distance of points from the edge of a rectangle.

    Parameters
    ----------
    points_m : (..., 2) float
        Anywhere. [m]
    rectangle : (5,) float
        East and north of the middle, yaw in radians, half length, half width.

    Returns
    -------
    distance_m : (...) float
        Negative inside. [m]

    Examples
    --------
    >>> rectangle_distance(np.array([[0.0, 0.0], [5.0, 5.0]]), np.array([0.0, 0.0, 0.0, 2.0, 1.0]))
    array([-1.,  5.])
    """
    east, north, yaw, half_length, half_width = rectangle.tolist()
    x, y = points_m[..., 0] - east, points_m[..., 1] - north
    along = np.abs(x * np.cos(yaw) + y * np.sin(yaw)) - half_length
    across = np.abs(y * np.cos(yaw) - x * np.sin(yaw)) - half_width
    outside = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
    distance: FloatArray = outside + np.minimum(np.maximum(along, across), 0.0)
    return distance


def polygon_distance(points_m: FloatArray, polygon_m: FloatArray) -> FloatArray:
    """Signed distance of points from the edge of a polygon.

    Parameters
    ----------
    points_m : (..., 2) float
        Anywhere. [m]
    polygon_m : (n, 2) float
        Corners in order. [m]

    Returns
    -------
    distance_m : (...) float
        Negative inside (even-odd rule). [m]
    """
    x, y = points_m[..., 0], points_m[..., 1]
    square = np.full(x.shape, np.inf)
    is_inside = np.zeros(x.shape, dtype=bool)
    for (x0, y0), (x1, y1) in zip(
        polygon_m.tolist(), np.roll(polygon_m, -1, axis=0).tolist(), strict=True
    ):
        edge_x, edge_y = x1 - x0, y1 - y0
        length2 = edge_x**2 + edge_y**2
        if length2 == 0.0:
            continue
        share = np.clip(((x - x0) * edge_x + (y - y0) * edge_y) / length2, 0.0, 1.0)
        square = np.minimum(square, (x - x0 - share * edge_x) ** 2 + (y - y0 - share * edge_y) ** 2)
        if y0 != y1:
            is_between = (y0 > y) != (y1 > y)
            is_inside ^= is_between & (x < x0 + (y - y0) / (y1 - y0) * edge_x)
    distance: FloatArray = np.where(is_inside, -1.0, 1.0) * np.sqrt(square)
    return distance
