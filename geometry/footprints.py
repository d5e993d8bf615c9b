"""Oriented rectangles on the road plane: corners and distance."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .arrays import FloatArray


def footprint_corners(
    centre_m: ArrayLike, yaw_deg: ArrayLike, *, length_m: float, width_m: float
) -> FloatArray:
    """Corners of oriented rectangles, (..., 4, 2), counter-clockwise from front left.

    `centre_m` is (..., 2); the length points along `yaw_deg`, counter-clockwise from
    east.
    """
    centre = np.asarray(centre_m, dtype=np.float64)
    yaw = np.radians(np.asarray(yaw_deg, dtype=np.float64))[..., None]
    ahead = 0.5 * length_m * np.array([1.0, -1.0, -1.0, 1.0])
    left = 0.5 * width_m * np.array([1.0, 1.0, -1.0, -1.0])
    east = ahead * np.cos(yaw) - left * np.sin(yaw)
    north = ahead * np.sin(yaw) + left * np.cos(yaw)
    return centre[..., None, :] + np.stack([east, north], axis=-1)


def footprint_separation(corners_a_m: ArrayLike, corners_b_m: ArrayLike) -> FloatArray:
    """Largest gap in metres between two rectangles along any of their sides' normals.

    Corners are (..., 4, 2), in order around each rectangle. By the separating axis
    theorem they touch at zero or less: minus the depth of the overlap. Of rectangles
    that do not touch it is a lower bound of their distance, and equal to it unless two
    corners face.

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
    # Two sides of each rectangle suffice: the others are parallel to them.
    sides = [
        (side[..., 0], side[..., 1])
        for corners in (a, b)
        for at in (0, 1)
        for side in [corners[..., at + 1, :] - corners[..., at, :]]
    ]
    separation = np.full(np.broadcast(apart_east, apart_north).shape, -np.inf)
    # Each side is the normal of its neighbour.
    for normal_east, normal_north in sides:
        apart = np.abs(apart_east * normal_east + apart_north * normal_north)
        for side_east, side_north in sides:
            apart = apart - 0.5 * np.abs(
                side_east * normal_east + side_north * normal_north
            )
        # The largest gap along any normal counts.
        np.maximum(
            separation, apart / np.hypot(normal_east, normal_north), out=separation
        )
    return separation


@dataclass(frozen=True, slots=True, kw_only=True)
class FootprintSizes:
    """Full lengths and widths of two rectangles, a and b.

    Arrays of them are the sizes of as many pairs.
    """

    length_a_m: float | FloatArray
    width_a_m: float | FloatArray
    length_b_m: float | FloatArray
    width_b_m: float | FloatArray


def gaps_between(
    offset_m: ArrayLike,
    yaw_a_deg: ArrayLike,
    yaw_b_deg: ArrayLike,
    *,
    sizes: FootprintSizes,
) -> FloatArray:
    """Gaps between two rectangles along their own axes, (4, ...), in metres.

    The first two are along length and width of a, the last two along those of
    b.

    Negative where they overlap; the largest is what :func:`footprint_separation` finds
    from corners, several times as slowly. `offset_m` (..., 2) leads from the middle of
    a to the middle of b.
    """
    offset = np.asarray(offset_m, dtype=np.float64)
    yaw_a = np.radians(np.asarray(yaw_a_deg, dtype=np.float64))
    yaw_b = np.radians(np.asarray(yaw_b_deg, dtype=np.float64))
    east = offset[..., 0]
    north = offset[..., 1]
    cos_a = np.cos(yaw_a)
    sin_a = np.sin(yaw_a)
    cos_b = np.cos(yaw_b)
    sin_b = np.sin(yaw_b)
    # What the sides of one throw onto the normals of the other depends on the angle
    # between them.
    along = np.abs(cos_a * cos_b + sin_a * sin_b)
    across = np.abs(sin_a * cos_b - cos_a * sin_b)
    length_a = 0.5 * sizes.length_a_m
    width_a = 0.5 * sizes.width_a_m
    length_b = 0.5 * sizes.length_b_m
    width_b = 0.5 * sizes.width_b_m
    # Distances of the middles along the four axes, then less what both bodies take
    # up.
    gaps = np.empty((4, *np.broadcast(east, along).shape))
    np.abs(east * cos_a + north * sin_a, out=gaps[0, ...])
    np.abs(north * cos_a - east * sin_a, out=gaps[1, ...])
    np.abs(east * cos_b + north * sin_b, out=gaps[2, ...])
    np.abs(north * cos_b - east * sin_b, out=gaps[3, ...])
    gaps[0] -= length_a + length_b * along + width_b * across
    gaps[1] -= width_a + length_b * across + width_b * along
    gaps[2] -= length_b + length_a * along + width_a * across
    gaps[3] -= width_b + length_a * across + width_a * along
    return gaps
