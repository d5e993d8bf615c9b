"""What is left of sets of poses when units fail, or sites with everything that they carry.

By sites, several units may fail at once, those of one pole. Failing more never leaves more, so that
it is enough to let the sites of any n of the units fail: that is at most n sites, and any n sites
that carry units are among them.
"""

from collections.abc import Callable
from itertools import combinations

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from .limits import Limits


def least_left(
    limits: Limits, sets: IntArray, n_failures: int, value: Callable[[IntArray], FloatArray]
) -> FloatArray:
    """Smallest value that sets keep when so many units, or sites, of each fail, (n_sets,).

    `value` is that of sets, (n_sets, any) -> (n_sets,); nothing is worth 0.
    """
    n_units = sets.shape[1]
    if n_failures > n_units:
        return np.zeros(len(sets))
    smallest = np.full(len(sets), np.inf)
    for failed in combinations(range(n_units), n_failures):
        if limits.failing == "unit" or not failed:
            left = value(np.delete(sets, failed, axis=1))
        else:
            left = _value_without_sites(limits, sets, failed, value)
        smallest = np.minimum(smallest, left)
    return smallest


def _value_without_sites(
    limits: Limits,
    sets: IntArray,
    failed: tuple[int, ...],
    value: Callable[[IntArray], FloatArray],
) -> FloatArray:
    sites = limits.site_index[sets]
    works: BoolArray = np.ones(sets.shape, dtype=bool)
    for unit in failed:
        works &= sites != sites[:, unit : unit + 1]
    # Units that fail are replaced by one that works: each set keeps its size, and sees no more.
    first = np.take_along_axis(sets, works.argmax(axis=1)[:, None], axis=1)
    return np.where(works.any(axis=1), value(np.where(works, sets, first)), 0.0)


def least_left_with_each(
    limits: Limits,
    units: IntArray,
    n_failures: int,
    *,
    poses: IntArray,
    with_each: Callable[[IntArray], FloatArray],
    alone: Callable[[IntArray], float],
) -> FloatArray:
    """Smallest value that a set with each of some poses keeps when so many fail, (n_poses,).

    `with_each` is the value of a set with each of the poses, (n_poses,), `alone` that of a set.
    """
    at = np.arange(len(units)) if limits.failing == "unit" else limits.site_index[units]
    groups = np.unique(at)
    if n_failures > len(groups):
        return np.zeros(len(poses))
    smallest = np.full(len(poses), np.inf)
    for failed in combinations(groups.tolist(), n_failures):
        rest = units[~np.isin(at, failed)]
        left = with_each(rest)
        if limits.failing == "site":  # those that join a site that fails are lost with it
            is_lost = np.isin(limits.site_index[poses], failed)
            if is_lost.any():
                left = np.where(is_lost, alone(rest), left)
        smallest = np.minimum(smallest, left)
    if n_failures:  # the pose that has joined may be among those that fail
        for failed in combinations(groups.tolist(), n_failures - 1):
            smallest = np.minimum(smallest, alone(units[~np.isin(at, failed)]))
    return smallest
