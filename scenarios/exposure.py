"""How much each run counts."""

from collections.abc import Sequence

import numpy as np

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
