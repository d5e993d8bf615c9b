"""How much each run counts."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray
from geometry.errors import InputError

from .exposure_files import weight_from_csv
from .rating import RATING, weight_by_rating
from .runs import Run

_BY_WORD = ("run", "case", RATING)


def weigh(runs: Sequence[Run], how: str) -> FloatArray:
    """Weights by the word of a user.

    Parameters
    ----------
    runs : sequence of Run
        At least one.
    how : str
        "run": every run the same, as in the study; "case": every case the same;
        "euroncap-rating-2026": by Euro NCAP's points, see
        :func:`scenarios.rating.weight_by_rating`; else a CSV file, see
        :func:`scenarios.exposure_files.weight_from_csv`.

    Returns
    -------
    weight : (n_runs,) float
        Sums to 1.

    Raises
    ------
    InputError
        The word is unknown and no file, or the weights do not fit the runs.
    MissingExtraError
        What the word needs is not installed.
    """
    if how == "run":
        return weight_per_run(runs)
    if how == "case":
        return weight_per_case(runs)
    if how == RATING:
        return weight_by_rating(runs)
    path = Path(how)
    if not how or not path.exists():
        raise InputError("--weights", how, f"{', '.join(_BY_WORD)}, or a CSV file that exists")
    return weight_from_csv(path, runs)


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


def weight_per_case(runs: Sequence[Run]) -> FloatArray:
    """Equal weight for every case, and within a case for every run.

    Parameters
    ----------
    runs : sequence of Run
        At least one.

    Returns
    -------
    weight : (n_runs,) float
        Sums to 1.
    """
    names = [run.case.name for run in runs]
    return np.array([1.0 / names.count(name) for name in names]) / len(set(names))


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
