"""What each pose alone promises in every run: limits of true values, and sets that may beat them.

A window is seen as a whole only if one of the chosen poses sees its first frame. So no set
confirms a run earlier than the first window whose first frame one of its poses sees: what a set is
worth is at most the weighted best-of coverage of those promises (coverage.py). With fusion
"single" it is just that.
"""

from typing import Literal

import numpy as np

from geometry.arrays import FloatArray, IntArray

from .bitsets import best_row, exceeds, set_values, union_margins_s, unions_of
from .coverage import Coverage
from .lazy_greedy import lazy_greedy, swap
from .multipliers import first_multipliers, tighten
from .presolve import ReducedProblem
from .small_sets import MAX_POSES, MAX_UNITS, best_sets
from .supply import Supply

Worth = Literal["apr", "margins"]

_MAX_TRIPLES = 3e8
_MAX_SETS = 2_000_000  # that are evaluated one by one
_BLOCK_SETS = 1 << 14
_STEPS = 400


def build_coverage(reduced: ReducedProblem, worth: Worth) -> Coverage:
    """Promises of the poses of a reduced problem.

    Parameters
    ----------
    reduced : ReducedProblem
        Its runs are the rows, weights multiplied in. Forced units stand already: the supply is
        what may join them.
    worth : {"apr", "margins"}
        A run that is avoided is worth its weight, or weight times margin.

    Returns
    -------
    coverage : Coverage
        Limits of units, sites and money hold; wishes and rivals are left out, which only makes a
        bound higher.
    """
    values = np.zeros((reduced.n_poses, len(reduced.weight)))
    detected = reduced.detected()
    for chain in range(reduced.n_chains):
        runs = np.flatnonzero(reduced.run_chain == chain)
        seen = detected[:, reduced.window_frames[reduced.chain(chain), 0]]
        first = np.where(seen.any(axis=1), seen.argmax(axis=1), seen.shape[1])
        margin = reduced.margin_s[runs][:, first].T
        is_avoided = margin > -np.inf
        amount = np.ones(margin.shape) if worth == "apr" else np.maximum(margin, 0.0)
        values[:, runs] = np.where(is_avoided, amount, 0.0) * reduced.weight[runs]
    limits = reduced.limits
    forced = np.flatnonzero(limits.is_forced)
    at_site = np.bincount(limits.site_index[forced], minlength=limits.n_sites)
    budget = np.inf if limits.budget_eur is None else limits.budget_eur
    site_cost = np.where(at_site > 0, 0.0, limits.site_cost_eur)
    spent = limits.unit_cost_eur[forced].sum() + limits.site_cost_eur[at_site > 0].sum()
    reached = values[forced].max(axis=0, initial=0.0)
    values[forced] = 0.0  # they cannot join once more
    return Coverage(
        values=values,
        supply=Supply(
            max_units=max(limits.max_units - len(forced), 0),
            site_index=limits.site_index,
            site_capacity=np.maximum(limits.site_capacity - at_site, 0),
            unit_cost_eur=limits.unit_cost_eur,
            site_cost_eur=site_cost,
            budget_eur=max(budget - float(spent), 0.0),
        ),
        reached=reached,
    )


def relaxed_limit(reduced: ReducedProblem, worth: Worth, *, n_steps: int = _STEPS) -> float:
    """No set within the limits is worth more: from Lagrangian multipliers."""
    coverage = build_coverage(reduced, worth)
    if coverage.supply.max_units == 0 or not coverage.n_rows:
        return float(coverage.floor.sum(dtype=np.float64))
    start = lazy_greedy(coverage)
    chosen = swap(coverage, start)
    target = coverage.value(chosen)
    bound = tighten(
        coverage, first_multipliers(coverage, chosen), target=target, n_steps=n_steps
    ).bound
    # All poses together are a limit, too.
    everything = float(np.maximum(coverage.values.max(axis=0), coverage.floor).sum())
    return min(bound.limit, everything)


def can_enumerate(reduced: ReducedProblem, n_units: int) -> bool:
    """Whether sets of so many units beside the forced ones can be looked through."""
    limits = reduced.limits
    is_monotone = limits.budget_eur is None and not (
        len(limits.rivals) or limits.is_forced_site.any()
    )
    return is_monotone and 1 <= n_units <= MAX_UNITS and reduced.n_poses <= MAX_POSES


def best_beyond(
    reduced: ReducedProblem, worth: Worth, need: float, *, n_units: int
) -> tuple[IntArray | None, bool]:
    """Best set of so many units, beside the forced ones, among all that may be worth more.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from, see :func:`can_enumerate`.
    worth : str
        See :func:`build_coverage`.
    need : float
        Sets that promise no more are not looked at.
    n_units : int
        Units beside the forced ones.

    Returns
    -------
    units : (n,) int or None
        The best, forced ones included; None if no set promises more.
    is_complete : bool
        Whether all were looked at; if not, there were too many.
    """
    coverage = build_coverage(reduced, worth).with_units(n_units)
    found = best_sets(coverage, need, max_triples=_MAX_TRIPLES, workers=2)
    if found is None or len(found.sets) > _MAX_SETS:
        return None, False
    forced = np.flatnonzero(reduced.limits.is_forced)
    best: IntArray | None = None
    best_value: FloatArray = np.empty(0)
    for start in range(0, len(found.sets), _BLOCK_SETS):
        part = found.sets[start : start + _BLOCK_SETS]
        sets = np.column_stack([np.tile(forced, (len(part), 1)), part])
        sets = sets[_worth(reduced, worth, sets) > need]  # cheaper to see than the other values
        if not len(sets):
            continue
        values = set_values(reduced, sets)
        row = best_row(values)
        if best is None or exceeds(values[row], best_value):
            best, best_value = sets[row], values[row]
    return best, True


def _worth(reduced: ReducedProblem, worth: Worth, sets: IntArray) -> FloatArray:
    """What sets are really worth, (n_sets,)."""
    margin = union_margins_s(reduced, unions_of(reduced, sets))
    is_avoided = margin > -np.inf
    amount = is_avoided if worth == "apr" else np.where(is_avoided, margin, 0.0)
    total: FloatArray = amount @ reduced.weight
    return total
