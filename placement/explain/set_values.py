"""Values of sets of poses that are quick to compute, for going through many sets.

Ratios of avoided runs take a hundredth of the time that margins take: values up to the APR that is
left when a unit fails are computed for all sets, the others only for those that may be listed.
"""

from collections.abc import Callable
from itertools import combinations

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from ..optimiser import ReducedProblem
from ..optimiser.bitsets import SetValues, avoided_with_each, build_values, costs_with_each_eur
from ..optimiser.objectives import TOLERANCE, Objective
from ..optimiser.problem import Measure

_MAX_REMEMBERED = 4_000_000  # numbers: 32 MB
_BLOCK_RUNS = 32


class QuickRows:
    """Quick values of a set of poses together with each pose in turn."""

    def __init__(self, reduced: ReducedProblem) -> None:
        self.reduced = reduced
        self.measures: list[Measure] = [
            reduced.measure,
            *(floor.measure for floor in reduced.floors),
        ]
        self._ratios: dict[tuple[int, ...], dict[int, FloatArray]] = {}

    def with_each(self, units: IntArray) -> SetValues:
        """Quick values of a set together with each pose, up to the APR if a unit fails."""
        reduced = self.reduced
        n_poses = reduced.n_poses
        values: dict[Objective, Callable[[], FloatArray]] = {
            Objective.UNITS: lambda: np.full(n_poses, len(units) + 1.0),
            Objective.APR_SURVIVED: lambda: self._left(reduced.measure, reduced.survive, units),
            Objective.APR: lambda: self._ratio(reduced.measure, units),
            Objective.APR_ONE_FAILED: lambda: self._left(reduced.measure, 1, units),
        }
        if reduced.objectives[0] is Objective.COST:  # else it comes after the margins
            values[Objective.COST] = lambda: costs_with_each_eur(reduced, units)
        return build_values(
            reduced, lambda measure, n_failures: self._left(measure, n_failures, units), values
        )

    def _left(self, measure: Measure, n_failures: int, units: IntArray) -> FloatArray:
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

    def _ratio(self, measure: Measure, units: IntArray) -> FloatArray:
        """Ratio of avoided runs of a set together with each pose, (n_poses,)."""
        key = tuple(units.tolist())
        if key not in self._ratios:
            if len(self._ratios) * self.reduced.n_poses > _MAX_REMEMBERED:
                self._ratios.clear()
            is_avoided = avoided_with_each(self.reduced, units)
            self._ratios[key] = {id(each): _ratios(each, is_avoided) for each in self.measures}
        return self._ratios[key][id(measure)]


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


def is_within(value: float | FloatArray, threshold: float) -> BoolArray:
    """Whether values reach a threshold, rounding noise aside."""
    within: BoolArray = np.asarray(value) >= threshold - TOLERANCE * max(1.0, abs(threshold))
    return within


def exceeds_clearly(value: float, other: float) -> bool:
    """Whether a value is higher than another one by more than any rounding noise."""
    return value > other + 1.0e-6 * max(1.0, abs(other))


def site_counts(reduced: ReducedProblem, sets: IntArray) -> IntArray:
    """How many of some sets have a unit at each site, (n_sets, n_units) -> (n_sites,)."""
    sites = np.sort(reduced.limits.site_index[sets], axis=1)
    is_first = np.ones(sites.shape, dtype=bool)
    is_first[:, 1:] = sites[:, 1:] != sites[:, :-1]
    return np.bincount(sites[is_first], minlength=reduced.limits.n_sites)
