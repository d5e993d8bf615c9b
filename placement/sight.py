"""Free lines of sight from a mount to points, past its own housing, bracket and pole."""

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray, FloatArray
from geometry.raycast import RayCaster

_SHORT_OF_M = 0.05  # rays end a little before the point


def is_in_sight(
    caster: RayCaster, mount_m: ArrayLike, points_m: FloatArray, *, near_m: float
) -> BoolArray:
    """Which points nothing hides from a mount.

    Parameters
    ----------
    caster : RayCaster
        What could hide them, in the same frame as the points.
    mount_m : (3,) float
        Where the sensor is. [m]
    points_m : (n, 3) float
        What is looked at. [m]
    near_m : float
        What is nearer hides nothing: the pole that carries the sensor, see
        :class:`geometry.sensors.CameraModel`. [m]

    Returns
    -------
    is_in_sight : (n,) bool
        False for points nearer than `near_m`, too.
    """
    mount = np.asarray(mount_m, dtype=np.float64)
    ways = points_m - mount
    lengths = np.linalg.norm(ways, axis=1)
    is_far = lengths > near_m + _SHORT_OF_M
    directions = ways / np.maximum(lengths, 1.0e-9)[:, None]
    starts = mount + near_m * directions
    vectors = directions * np.maximum(lengths - near_m - _SHORT_OF_M, 0.0)[:, None]
    is_free: BoolArray = ~caster.is_blocked(starts.astype(np.float32), vectors.astype(np.float32))
    is_seen: BoolArray = is_free & is_far
    return is_seen
