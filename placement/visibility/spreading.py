"""The loop that spreads points over a body."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.kernels import kernel

Array = NDArray[Any]


@kernel
def farthest_samples(samples: Array, first: Array, n: int) -> Array:
    """Indices (n,) of samples (m, 3): one by one the farthest from all points so far.

    The points `first` (k, 3) are there from the beginning.
    """
    distance = np.empty(len(samples))
    for i in range(len(samples)):
        distance[i] = np.inf
    chosen = np.empty(n, np.int64)
    for step in range(len(first) + n):
        if step < len(first):
            point = first[step]
        else:
            farthest = 0
            for i in range(1, len(samples)):
                if distance[i] > distance[farthest]:
                    farthest = i
            chosen[step - len(first)] = farthest
            point = samples[farthest]
        for i in range(len(samples)):
            x, y, z = samples[i, 0] - point[0], samples[i, 1] - point[1], samples[i, 2] - point[2]
            distance[i] = min(distance[i], np.sqrt(x * x + y * y + z * z))
    return chosen
