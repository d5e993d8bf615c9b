"""Oriented rectangles on the road plane: corners and distance."""

import numpy as np
from numpy.typing import ArrayLike

from .arrays import FloatArray


def footprint_corners(
    centre_m: ArrayLike, yaw_deg: ArrayLike, *, length_m: float, width_m: float
) -> FloatArray:
    """Corners of oriented rectangles, counter-clockwise from front left.

    Parameters
    ----------
    centre_m : (..., 2) float
        Centre. [m]
    yaw_deg : (...,) float
        Direction of the length, counter-clockwise from east. [deg]
    length_m, width_m : float
        Full size. [m]

    Returns
    -------
    corners_m : (..., 4, 2) float
        World frame. [m]
    """
    centre = np.asarray(centre_m, dtype=np.float64)
    yaw = np.radians(np.asarray(yaw_deg, dtype=np.float64))[..., None]
    ahead = 0.5 * length_m * np.array([1.0, -1.0, -1.0, 1.0])
    left = 0.5 * width_m * np.array([1.0, 1.0, -1.0, -1.0])
    east = ahead * np.cos(yaw) - left * np.sin(yaw)
    north = ahead * np.sin(yaw) + left * np.cos(yaw)
    corners: FloatArray = centre[..., None, :] + np.stack([east, north], axis=-1)
    return corners


def footprint_separation(corners_a_m: ArrayLike, corners_b_m: ArrayLike) -> FloatArray:
    """Largest gap between two rectangles along any of their sides' normals.

    Zero or less means that they touch: the separating axis theorem. For rectangles that do not
    touch it is a lower bound of their distance, and equal to it unless two corners face.

    Parameters
    ----------
    corners_a_m, corners_b_m : (..., 4, 2) float
        Corners in order around each rectangle; leading axes broadcast. [m]

    Returns
    -------
    separation_m : (...,) float
        Positive: apart; negative: minus the depth of the overlap. [m]

    Examples
    --------
    >>> a = footprint_corners([0.0, 0.0], 0.0, length_m=2.0, width_m=2.0)
    >>> b = footprint_corners([5.0, 0.0], 0.0, length_m=2.0, width_m=2.0)
    >>> float(footprint_separation(a, b).round(12))
    3.0
    """
    a = np.asarray(corners_a_m, dtype=np.float64)
    b = np.asarray(corners_b_m, dtype=np.float64)
    # Components one by one: numpy is slow along axes of length two and four.
    middles = [0.5 * (corners[..., 0, :] + corners[..., 2, :]) for corners in (a, b)]
    apart_east = middles[1][..., 0] - middles[0][..., 0]
    apart_north = middles[1][..., 1] - middles[0][..., 1]
    sides = [
        (side[..., 0], side[..., 1])
        for corners in (a, b)
        for side in (
            corners[..., 1, :] - corners[..., 0, :],
            corners[..., 2, :] - corners[..., 1, :],
        )
    ]
    separation = np.full(np.broadcast(apart_east, apart_north).shape, -np.inf)
    for normal_east, normal_north in sides:  # each side is the normal of its neighbour
        apart = np.abs(apart_east * normal_east + apart_north * normal_north)
        for side_east, side_north in sides:
            apart = apart - 0.5 * np.abs(side_east * normal_east + side_north * normal_north)
        np.maximum(separation, apart / np.hypot(normal_east, normal_north), out=separation)
    return separation
