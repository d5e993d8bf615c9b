"""Loop over LiDARs of one mount, entries and points: who has enough points on them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.kernels import kernel

Array = NDArray[Any]


@kernel
def count_echoes(
    rotations: Array,
    is_near: Array,
    first: Array,
    directions: Array,
    expected: Array,
    needed: Array,
    cos_across: float,
    sin_up: float,
    detected: Array,
) -> None:
    """Set `detected` (m, n_weathers, n_entries) where points that come back are as many as needed.

    Points from ``first[i]`` on belong to entry i. `directions` (k, 3) are unit vectors from the
    mount, `expected` (n_weathers, k) what comes back of each where beams are as dense as at the
    horizon: their density grows as the circles of latitude shrink. `rotations` (m, 3, 3) have the
    axes ahead, left and up as columns; `is_near` (m, n_entries): entries that may be in view. The
    field of view has half angles with this cosine across and this sine up, limits included.
    """
    n_weathers = len(expected)
    total = np.zeros(n_weathers)
    for row in range(len(rotations)):
        r = rotations[row]
        for entry in range(len(needed)):
            if not is_near[row, entry]:
                continue
            total[:] = 0.0
            for point in range(first[entry], first[entry + 1]):
                x, y, z = directions[point, 0], directions[point, 1], directions[point, 2]
                up = x * r[0, 2] + y * r[1, 2] + z * r[2, 2]
                if abs(up) > sin_up:
                    continue
                ahead = x * r[0, 0] + y * r[1, 0] + z * r[2, 0]
                left = x * r[0, 1] + y * r[1, 1] + z * r[2, 1]
                level = np.sqrt(ahead * ahead + left * left)
                if ahead < cos_across * level:
                    continue
                for weather in range(n_weathers):
                    total[weather] += expected[weather, point] / level
            for weather in range(n_weathers):
                detected[row, weather, entry] = total[weather] >= needed[entry]
