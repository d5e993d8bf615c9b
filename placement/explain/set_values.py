"""What sets of poses are worth, as rows of numbers: those that are quick to tell, and all of them.

Rows are those of :func:`placement.optimiser.bitsets.set_values`, each column the larger the better.
Ratios of avoided runs take a hundredth of the time that margins take: columns up to the APR that
is left when a unit fails are told for all sets, the others only for those that come into question.
"""

from itertools import combinations

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from ..optimiser import ReducedProblem, cost_eur
from ..optimiser.bitsets import avoided_with_each, values_with_each
from ..optimiser.problem import TOLERANCE, Measure

LACKING, FEW, SURVIVED, APR, ONE_FAILED = range(5)
"""Columns that are quick to tell."""
_DECIMALS = 8  # differences below are rounding noise
_MAX_REMEMBERED = 4_000_000  # numbers: 32 MB
_BLOCK_RUNS = 32


class QuickRows:
    """Rows of a set of poses together with each pose in turn.

    Parameters
    ----------
    reduced : ReducedProblem
        Windows and runs.
    """

    def __init__(self, reduced: ReducedProblem) -> None:
        self.reduced = reduced
        self.measures: list[Measure] = [
            reduced.measure,
            *(floor.measure for floor in reduced.floors),
        ]
        self._ratios: dict[tuple[int, ...], FloatArray] = {}

    def with_each(self, units: IntArray) -> FloatArray:
        """Rows of a set together with each pose, (n_poses, 5); all columns of a weighted sum."""
        reduced = self.reduced
        if reduced.stage_weights is not None:  # it has the margins in it
            return values_with_each(reduced, units)
        rows = np.zeros((reduced.n_poses, ONE_FAILED + 1))
        for number, floor in enumerate(reduced.floors, start=1):
            lacking = floor.least - TOLERANCE - self._left(number, floor.n_failures, units)
            rows[:, LACKING] -= np.maximum(lacking, 0.0)
        if reduced.goal == "fewest":
            rows[:, FEW] = -(len(units) + 1)
        elif reduced.goal == "cheapest":
            rows[:, FEW] = -costs_with_each_eur(reduced, units)
        if reduced.survive:
            rows[:, SURVIVED] = self._left(0, reduced.survive, units)
        rows[:, APR] = self._ratio(0, units)
        rows[:, ONE_FAILED] = self._left(0, 1, units)
        return rows

    def _left(self, measure: int, n_failures: int, units: IntArray) -> FloatArray:
        """What is left of each set when its worst units fail, (n_poses,)."""
        if n_failures > len(units):
            return np.zeros(self.reduced.n_poses)
        smallest = np.full(self.reduced.n_poses, np.inf)
        for failed in combinations(range(len(units)), n_failures):
            left = self._ratio(measure, np.delete(units, failed))
            smallest = np.minimum(smallest, left)
        if n_failures:  # the pose that has joined may be among those that fail
            for failed in combinations(range(len(units)), n_failures - 1):
                *others, last = np.delete(units, failed).tolist()
                alone = self._ratio(measure, np.array(others, dtype=np.int64))[last]
                smallest = np.minimum(smallest, alone)
        return smallest

    def _ratio(self, measure: int, units: IntArray) -> FloatArray:
        """Ratio of avoided runs of a set together with each pose, (n_poses,)."""
        key = tuple(units.tolist())
        if key not in self._ratios:
            if len(self._ratios) * self.reduced.n_poses > _MAX_REMEMBERED:
                self._ratios.clear()
            is_avoided = avoided_with_each(self.reduced, units)
            self._ratios[key] = np.stack([_ratios(m, is_avoided) for m in self.measures])
        ratio: FloatArray = self._ratios[key][measure]
        return ratio


def _ratios(measure: Measure, is_avoided: BoolArray) -> FloatArray:
    """What a measure makes of avoided runs, (n_sets, n_runs) -> (n_sets,)."""
    if not measure.is_mean:
        return measure.of(is_avoided)
    total = np.zeros(len(is_avoided))
    # A few runs at a time stay in the cache: ten times as fast as the product as a whole.
    for start in range(0, len(measure.weight), _BLOCK_RUNS):
        block = slice(start, start + _BLOCK_RUNS)
        total += measure.weight[block] @ is_avoided.T[block].astype(np.float64)
    return total


def costs_with_each_eur(reduced: ReducedProblem, units: IntArray) -> FloatArray:
    """What a set costs together with each pose in turn, (n_poses,), in euros."""
    limits = reduced.limits
    is_new = ~np.isin(limits.site_index, limits.site_index[units])
    opened = np.where(is_new, limits.site_cost_eur[limits.site_index], 0.0)
    cost: FloatArray = cost_eur(limits, units) + limits.unit_cost_eur + opened
    return cost


def first_column(reduced: ReducedProblem) -> int:
    """Column of the first stage."""
    if reduced.goal != "best":
        return FEW
    return SURVIVED if reduced.survive else APR


def is_within(value: float | FloatArray, threshold: float) -> BoolArray:
    """Whether values reach a threshold, rounding noise aside."""
    within: BoolArray = np.asarray(value) >= threshold - TOLERANCE * max(1.0, abs(threshold))
    return within


def threshold_of(reduced: ReducedProblem, best: float, tolerance: float) -> float:
    """What a set must reach in the first stage: a share of units or cost, else of the runs."""
    return best - tolerance if reduced.goal == "best" else best * (1.0 + tolerance)


def exceeds_clearly(value: float, other: float) -> bool:
    """Whether a value is higher than another one by more than any rounding noise."""
    return value > other + 1.0e-6 * max(1.0, abs(other))


def descending(rows: FloatArray) -> IntArray:
    """Order of rows, the best first, compared from left to right."""
    rounded = -rows.round(_DECIMALS)
    order: IntArray = np.lexsort(rounded.T[::-1])
    return order


def ties_or_beats(rows: FloatArray, other: FloatArray) -> BoolArray:
    """Rows that are at least as good as another one, compared from left to right."""
    difference = rows.round(_DECIMALS) - other.round(_DECIMALS)
    is_different = difference != 0.0
    first = is_different.argmax(axis=1)
    decisive = difference[np.arange(len(rows)), first]
    reaches: BoolArray = decisive >= 0.0
    return reaches


def site_counts(reduced: ReducedProblem, sets: IntArray) -> IntArray:
    """How many of some sets have a unit at each site, (n_sets, n_units) -> (n_sites,)."""
    sites = np.sort(reduced.limits.site_index[sets], axis=1)
    is_first = np.ones(sites.shape, dtype=bool)
    is_first[:, 1:] = sites[:, 1:] != sites[:, :-1]
    return np.bincount(sites[is_first], minlength=reduced.limits.n_sites)
