"""A set of poses that meets a wish, if quick choice one by one finds one."""

import numpy as np

from geometry.arrays import BoolArray, IntArray

from ..optimiser import ReducedProblem, is_allowed
from ..optimiser.bitsets import set_values
from ..optimiser.greedy import forced_units
from ..optimiser.limits import fitting
from .rows import LACKING, QuickRows, descending

_MAX_ADDED = 12  # what is left when units fail takes too long to tell of more


def choose_greedily(reduced: ReducedProblem) -> IntArray:
    """Add poses one by one, that first which leaves the floors lacking least.

    Parameters
    ----------
    reduced : ReducedProblem
        Limits and floors. What comes after them does not matter.

    Returns
    -------
    units : (n_units,) int
        Poses of the reduced problem: no more than are needed, or all that greedy choice has found
        room for. They may lack something, see :func:`meets`.
    """
    quick = QuickRows(reduced)
    units = forced_units(reduced)
    most = min(reduced.limits.max_units, len(units) + _MAX_ADDED)
    while len(units) < most and not meets(reduced, units):
        fits = fitting(reduced.limits, units)
        if not _lacks_floors(reduced, units):  # a forced site, or any unit at all
            fits &= _at_missing_site(reduced, units)
        free = np.flatnonzero(fits)
        if not len(free):
            break
        units = np.append(units, free[descending(quick.with_each(units)[free])[0]])
    return units


def meets(reduced: ReducedProblem, units: IntArray) -> bool:
    """Whether a set of poses is within the limits and reaches the floors."""
    if not len(units) or not is_allowed(reduced.limits, units):
        return False
    return not _lacks_floors(reduced, units)


def _lacks_floors(reduced: ReducedProblem, units: IntArray) -> bool:
    return bool(set_values(reduced, units[None, :])[0, LACKING] < 0.0)


def _at_missing_site(reduced: ReducedProblem, units: IntArray) -> BoolArray:
    """Poses at sites that are still to carry a unit; all where there is no such site."""
    limits = reduced.limits
    missing = limits.is_forced_site.copy()
    missing[limits.site_index[units]] = False
    at_missing: BoolArray = missing[limits.site_index]
    return at_missing if missing.any() else ~at_missing
