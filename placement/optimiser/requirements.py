"""What a set of poses must reach: floors, and the stages that are settled already."""

from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray, FloatArray

from .measure import Measure

_TIME_TOLERANCE_S = 1.0e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Requirement:
    """A value that must be reached; more poses never reach less of it.

    Attributes
    ----------
    measure : Measure
        What is counted, over the runs of the reduced problem.
    least : float
        What must be reached, in the measure's unit; times seconds where margins are summed.
    min_margin_s : float
        Runs avoided with less than this do not count; minus infinity: just avoided. [s]
    n_failures : int
        It must still be reached when any so many units fail.
    sums_margins : bool
        Count the weights times the margins instead of the weights.
    """

    measure: Measure
    least: float
    min_margin_s: float = -np.inf
    n_failures: int = 0
    sums_margins: bool = False

    @property
    def needs_all(self) -> bool:
        """Whether only avoiding every run that weighs anything reaches it."""
        weight = self.measure.weight[self.measure.weight > 0.0]
        if self.sums_margins or not self.measure.is_mean or not len(weight):
            return False
        return bool(self.least > weight.sum() - weight.min() / 2.0)

    def reached(self, margin_s: FloatArray) -> FloatArray:
        """What sets with these margins reach: (n_sets, n_runs) -> (n_sets,), failures aside."""
        in_time: BoolArray = margin_s > -np.inf
        in_time &= margin_s >= self.min_margin_s - _TIME_TOLERANCE_S
        if self.sums_margins:
            total: FloatArray = np.where(in_time, margin_s, 0.0) @ self.measure.weight
            return total
        return self.measure.of(in_time)

    def __repr__(self) -> str:
        return (
            f"Requirement({self.least:g}, margin {self.min_margin_s:g} s, {self.n_failures} fail)"
        )
