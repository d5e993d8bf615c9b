"""All sets that little money buys, gone through one by one.

Where sites or units are dear, most sets of two or three poses cost too much: those that do not are
few even among thousands of poses.
"""

import numpy as np

from geometry.arrays import BoolArray, IntArray

from .bitsets import best_row, exceeds, set_values, union_apr, unions_of
from .limits import COST_TOLERANCE_EUR, Limits, are_allowed, costs_eur
from .presolve import ReducedProblem
from .problem import TOLERANCE

_MAX_GROWN = 20_000_000  # sets that are looked at for their price alone
_PART_SETS = 1 << 14


def best_affordable(
    reduced: ReducedProblem, *, least_apr: float, max_sets: int
) -> tuple[IntArray | None, bool]:
    """Best of all sets within limits of money, where they are few.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from; the APR is its first objective.
    least_apr : float
        Of a set that is at hand: those with less are not looked at further.
    max_sets : int
        Give up if there are more sets to go through.

    Returns
    -------
    units : (n,) int or None
        The best set; None: given up, or none has that APR.
    is_complete : bool
        Whether all sets were gone through.
    """
    sizes = affordable_sets(reduced.limits, max_sets=max_sets)
    if sizes is None:
        return None, False
    best: IntArray | None = None
    best_value = np.empty(0)
    for sets in sizes:
        for part in np.array_split(sets, max(1, -(-len(sets) // _PART_SETS))):
            part = part[union_apr(reduced, unions_of(reduced, part)) >= least_apr - TOLERANCE]
            if not len(part):
                continue
            values = set_values(reduced, part)
            row = best_row(values)
            if best is None or exceeds(values[row], best_value):
                best, best_value = part[row], values[row]
    return best, True


def affordable_sets(limits: Limits, *, max_sets: int) -> list[IntArray] | None:
    """All sets within limits, by their size.

    Returns
    -------
    sizes : list of (n_sets, n_units) int
        Sets of 1, 2, .. poses, ascending; None if there are more sets than asked for, or too many
        to find out.
    """
    poses = np.flatnonzero(~limits.is_forbidden)
    grown: IntArray = poses[:, None]
    grown = grown[_may_grow(limits, grown)]
    sizes: list[IntArray] = []
    n_sets = 0
    for n_units in range(1, limits.max_units + 1):
        sets = grown[are_allowed(limits, grown)]
        n_sets += len(sets)
        if n_sets > max_sets:
            return None
        sizes.append(sets)
        if n_units == limits.max_units or not len(grown):
            break
        if len(grown) * len(poses) > _MAX_GROWN:
            return None
        # A later pose than the last one: every set comes up once.
        first, later = np.nonzero(poses[None, :] > grown[:, -1:])
        grown = np.column_stack([grown[first], poses[later]])
        grown = grown[_may_grow(limits, grown)]
    return sizes


def _may_grow(limits: Limits, sets: IntArray) -> BoolArray:
    """Which sets fit into sites and money; what is forced may still be missing."""
    sites = limits.site_index[sets]
    n_beside = (sites[:, :, None] == sites[:, None, :]).sum(axis=2)
    fits: BoolArray = (n_beside <= limits.site_capacity[sites]).all(axis=1)
    if limits.budget_eur is not None:
        fits &= costs_eur(limits, sets) <= limits.budget_eur + COST_TOLERANCE_EUR
    return fits
