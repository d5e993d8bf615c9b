"""How much each run counts."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray

from .runs import Run


def weight_per_run(runs: Sequence[Run]) -> FloatArray:
    """Equal weight for every run, as in the study.

    Parameters
    ----------
    runs : sequence of Run
        At least one.

    Returns
    -------
    weight : (n_runs,) float
        Sums to 1.
    """
    return np.full(len(runs), 1.0 / len(runs))


def weight_share(mask: ArrayLike, weight: ArrayLike) -> float:
    """Weight of some runs / weight of all.

    Parameters
    ----------
    mask : (n_runs,) bool
        The runs that count.
    weight : (n_runs,) float
        At least 0.

    Returns
    -------
    share : float
        0 .. 1, exactly 1 where all runs with weight count; NaN if there is no weight at all.

    Examples
    --------
    >>> weight_share([True] * 49, [1.0 / 49.0] * 49)
    1.0
    """
    weights = np.asarray(weight, dtype=np.float64)
    total = math.fsum(weights)
    counted = math.fsum(weights[np.asarray(mask, dtype=bool)])
    return counted / total if total > 0.0 else math.nan
