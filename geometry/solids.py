"""Meshes of boxes and cylinders.

Numbers, and the order of corners and triangles, are those of ``trimesh.creation``,
which takes half a second to load.
"""

import numpy as np
from numpy.typing import ArrayLike

from .arrays import FloatArray, IntArray

# Corners of the unit cube, and its triangles, which point outwards.
_CUBE = np.array(
    [[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]
)
_CUBE_TRIANGLES = np.array(
    [
        *([1, 3, 0], [4, 1, 0], [0, 3, 2], [2, 4, 0], [1, 7, 3], [5, 1, 4]),
        *([5, 7, 1], [3, 7, 2], [6, 4, 2], [2, 7, 6], [6, 5, 4], [7, 5, 6]),
    ]
)


def box_mesh(size_m: ArrayLike) -> tuple[FloatArray, IntArray]:
    """Corners (8, 3) and triangles (12, 3) of a box around the origin.

    `size_m` (3,) are its lengths along x, y and z. [m]

    >>> box_mesh([2.0, 4.0, 6.0])[0][0].tolist()
    [-1.0, -2.0, -3.0]
    """
    corners = (_CUBE - 0.5) * np.asarray(size_m, dtype=np.float64)
    return corners, _CUBE_TRIANGLES.copy()


def cylinder_mesh(
    ends_m: ArrayLike, *, radius_m: float, n_sides: int
) -> tuple[FloatArray, IntArray]:
    """Corners (2 n + 2, 3) and triangles (4 n, 3) of a cylinder between two points.

    Parameters
    ----------
    ends_m : (2, 3) float
        Middles of its ends. [m]
    radius_m : float
        Of the circle around its corners. [m]
    n_sides : int
        Number n of its sides, at least 3.

    Returns
    -------
    corners_m : (2 n + 2, 3) float
        [m]
    triangles : (4 n, 3) int
        They point outwards.
    """
    ends = np.asarray(ends_m, dtype=np.float64)
    axis_m = ends[1] - ends[0]
    half_m = float(np.linalg.norm(axis_m)) / 2.0
    angle = np.linspace(0.0, 2.0 * np.pi, n_sides + 1)[:-1]
    rim = radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    # Corner 0 is the middle of the lower end, 3 that of the upper one; 1 and 2 are the
    # first side's, and the others follow in pairs.
    low = np.concatenate([[1], np.arange(4, 2 * n_sides + 2, 2)])
    high = np.concatenate([[2], np.arange(5, 2 * n_sides + 2, 2)])
    corners = np.zeros((2 * n_sides + 2, 3))
    corners[0, 2] = -half_m
    corners[3, 2] = half_m
    corners[low, :2] = rim
    corners[low, 2] = -half_m
    corners[high, :2] = rim
    corners[high, 2] = half_m
    triangles = []
    for side in range(n_sides):
        after = (side + 1) % n_sides
        triangles += [
            [low[side], 0, low[after]],
            [low[side], low[after], high[side]],
            [high[side], low[after], high[after]],
            [high[side], high[after], 3],
        ]
    # From the z axis to the axis of the cylinder, then to its middle.
    turn = np.eye(4)
    turn[:3, :3] = _turn_from_z(axis_m)
    move = np.eye(4)
    move[:3, 3] = ends[0] + axis_m * 0.5
    homogeneous = np.column_stack([corners, np.ones(len(corners))])
    placed = np.dot(np.dot(move, turn), homogeneous.T).T[:, :3]
    return placed, np.array(triangles)


def _turn_from_z(axis: FloatArray) -> FloatArray:
    """A rotation (3, 3) that takes the z axis to a direction (3,) of any length."""
    bases = [
        np.linalg.svd(vector.reshape(-1, 1))[0]
        for vector in (np.array([0.0, 0.0, 1.0]), axis)
    ]
    # Right-handed ones.
    for basis in bases:
        if np.linalg.det(basis) < 0.0:
            basis[:, -1] *= -1.0
    upright, tilted = bases
    return np.asarray(tilted.dot(upright.T))
