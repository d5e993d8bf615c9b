"""Values of many sets of poses at once, on the bits of the reduced problem."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray

from .failures import least_left, least_left_with_each
from .limits import cost_eur, costs_eur
from .objectives import Objective
from .presolve import ReducedProblem, unpack_words
from .problem import Measure, WordArray
from .threads import share_out
from .tolerances import TOLERANCE

_DECIMALS = 8  # differences below are rounding noise


@dataclass(frozen=True, slots=True, eq=False)
class SetValues:
    """What sets of poses are worth: what they lack to the floors, then objective by objective."""

    objectives: tuple[Objective, ...]  # in the order in which sets are compared
    # (n_sets, 1 + n_objectives): the larger the better: minus what is lacking, then each objective,
    # the minimised ones negative. One row for a single set.
    gains: FloatArray

    def __len__(self) -> int:
        return len(self.gains)

    def __getitem__(self, rows: int | slice | IntArray | BoolArray) -> "SetValues":
        """Values of some of the sets, or of a single one."""
        return SetValues(self.objectives, self.gains[rows])

    @property
    def lacking(self) -> FloatArray:
        """What is lacking to the floors, summed; 0 where all are reached."""
        return -self.gains[..., 0]

    @property
    def first(self) -> FloatArray:
        """The first objective, the larger the better."""
        gains: FloatArray = self.gains[..., 1]
        return gains

    def of(self, objective: Objective) -> FloatArray:
        """Values of one objective, in its own unit."""
        gains: FloatArray = self.gains[..., 1 + self.objectives.index(objective)]
        return -gains if objective.is_minimised else gains

    def best_row(self) -> int:
        """First set that no other one exceeds."""
        rows = np.arange(len(self.gains))
        for column, tolerance in zip(self.gains.T, _tolerances(self.objectives), strict=True):
            rows = rows[column[rows] >= column[rows].max() - tolerance]
        return int(rows[0])

    def exceeds(self, other: "SetValues") -> bool:
        """Whether the first difference that exceeds rounding noise favours this single set."""
        difference = self.gains - other.gains
        differs = np.flatnonzero(np.abs(difference) > _tolerances(self.objectives))
        return bool(len(differs)) and bool(difference[differs[0]] > 0.0)

    def descending(self) -> IntArray:
        """Order of the sets, the best first."""
        order: IntArray = np.lexsort(-self.gains.round(_DECIMALS).T[::-1])
        return order

    def ties_or_beats(self, other: "SetValues") -> BoolArray:
        """Which sets are at least as good as a single other one."""
        difference = self.gains.round(_DECIMALS) - other.gains.round(_DECIMALS)
        first = (difference != 0.0).argmax(axis=1)
        reaches: BoolArray = difference[np.arange(len(difference)), first] >= 0.0
        return reaches


@lru_cache(maxsize=32)
def _tolerances(objectives: tuple[Objective, ...]) -> FloatArray:
    return np.array([TOLERANCE, *(objective.tolerance for objective in objectives)])


def concatenate_values(parts: list[SetValues]) -> SetValues:
    """Values of all sets of some groups, at least one group."""
    return SetValues(parts[0].objectives, np.concatenate([part.gains for part in parts]))


def no_values(reduced: ReducedProblem, gain: float = -np.inf) -> SetValues:
    """Values of a single set that is worse, or with a gain of infinity better, than any."""
    return SetValues(reduced.objectives, np.full(1 + len(reduced.objectives), gain))


class BestSet:
    """The best of the sets of poses that were offered; of equal ones the first."""

    def __init__(self) -> None:
        self.units: IntArray | None = None
        self.values: SetValues | None = None

    def offer(self, sets: IntArray, values: SetValues) -> None:
        """Take the best of some sets, if it is better than the best so far."""
        if not len(sets):
            return
        row = values.best_row()
        if self.values is None or values[row].exceeds(self.values):
            self.units, self.values = sets[row], values[row]


def union_margins_s(reduced: ReducedProblem, unions: WordArray) -> FloatArray:
    """Margins of all runs given which frames are seen: (n_sets, n_words) -> (n_sets, n_runs).

    Minus infinity where a run is not avoided.
    """
    from .frame_kernels import first_live_windows

    first = np.empty((len(unions), reduced.n_chains), dtype=np.int64)

    def look(begin: int, end: int) -> None:
        first_live_windows(
            np.ascontiguousarray(unions[begin:end]), reduced.chains, first[begin:end]
        )

    share_out(look, len(unions))
    margin: FloatArray = reduced.margin_s[
        np.arange(len(reduced.weight)), first[:, reduced.run_chain]
    ]
    return margin


def union_apr(reduced: ReducedProblem, unions: WordArray) -> FloatArray:
    """Accident prevention ratio given which frames are seen, (n_sets,)."""
    return reduced.measure.of(union_margins_s(reduced, unions) > -np.inf)


def unions_of(reduced: ReducedProblem, sets: IntArray) -> WordArray:
    """Frames that sets of poses see: (n_sets, n_units) -> (n_sets, n_words) bits."""
    unions = np.zeros((len(sets), reduced.words.shape[1]), dtype=np.uint64)
    for units in sets.T:
        unions |= reduced.words[units]
    return unions


def left_after_failures(
    reduced: ReducedProblem, measure: Measure, n_failures: int, sets: IntArray
) -> FloatArray:
    """What sets of poses still reach when the worst of their units fail, (n_sets,)."""

    def value(left: IntArray) -> FloatArray:
        return measure.of(union_margins_s(reduced, unions_of(reduced, left)) > -np.inf)

    return least_left(reduced.limits, sets, n_failures, value)


def keep_apr(
    reduced: ReducedProblem, sets: IntArray, least: float, *, with_failures: bool = False
) -> BoolArray:
    """Which sets of poses have an APR of at least so much, (n_sets,).

    With failures: whichever unit fails. Only where the APR is a weighted mean over all runs. Most
    sets that lose too much are found out at a few runs.
    """
    lost = (reduced.margin_s == -np.inf) * reduced.weight[:, None]
    most = reduced.measure.limit - least
    return _lose_little(reduced, sets, lost, most, with_failures=with_failures)


def may_keep_margins(
    reduced: ReducedProblem, sets: IntArray, *, smallest_s: float, total_s: float
) -> BoolArray:
    """Which sets of poses may reach a smallest and a weighted total margin, (n_sets,).

    All that do reach them are among these, up to rounding; most that do not are found out at a few
    runs.
    """
    is_avoided = reduced.margin_s > -np.inf
    worth = np.where(is_avoided, reduced.margin_s, 0.0) * reduced.weight[:, None]
    best = worth.max(axis=1, keepdims=True)
    is_too_small = is_avoided & (reduced.margin_s < smallest_s) & (reduced.weight[:, None] > 0.0)
    lost = np.where(is_too_small, np.inf, best - worth)
    most = float(best.sum()) - total_s + TOLERANCE
    return _lose_little(reduced, sets, lost, most, with_failures=False)


def _lose_little(
    reduced: ReducedProblem,
    sets: IntArray,
    lost: FloatArray,
    most: float,
    *,
    with_failures: bool,
) -> BoolArray:
    """Which sets lose no more than so much; `lost` is by run and first live window."""
    from .frame_kernels import lose_little

    of_chain = np.zeros((reduced.n_chains, lost.shape[1]))
    np.add.at(of_chain, reduced.run_chain, lost)
    kept = np.empty(len(sets), dtype=bool)
    lose_little(
        reduced.words,
        np.ascontiguousarray(sets),
        with_failures,
        reduced.chains,
        of_chain,
        most,
        kept,
    )
    return kept


def set_values(
    reduced: ReducedProblem, sets: IntArray, one_failed: FloatArray | None = None
) -> SetValues:
    """Values of sets of poses, (n_sets, n_units) rows of the reduced problem.

    `one_failed` is their APR when one unit fails, (n_sets,), where that is known.
    """
    margin = union_margins_s(reduced, unions_of(reduced, sets))

    def left(measure: Measure, n_failures: int) -> FloatArray:
        if n_failures == 1 and measure is reduced.measure and one_failed is not None:
            return one_failed
        return left_after_failures(reduced, measure, n_failures, sets)

    cost = costs_eur(reduced.limits, sets)
    return _values(reduced, margin, n_units=sets.shape[1], cost=cost, left=left)


def values_with_each(reduced: ReducedProblem, units: IntArray) -> SetValues:
    """Values of a set of poses together with each pose in turn: row c is that of `units` and c.

    Bits run along the poses here, 64 sets to a word: an order of magnitude faster than
    :func:`set_values` of the same sets, one by one.
    """
    return _values(
        reduced,
        _margins_with_each(reduced, units),
        n_units=len(units) + 1,
        cost=costs_with_each_eur(reduced, units),
        left=lambda measure, n_failures: _left_with_each(reduced, measure, n_failures, units),
    )


def costs_with_each_eur(reduced: ReducedProblem, units: IntArray) -> FloatArray:
    """What a set costs together with each pose in turn, (n_poses,), in euros."""
    limits = reduced.limits
    is_new = ~np.isin(limits.site_index, limits.site_index[units])
    cost = cost_eur(limits, units) + limits.unit_cost_eur
    total: FloatArray = cost + np.where(is_new, limits.site_cost_eur[limits.site_index], 0.0)
    return total


def _values(
    reduced: ReducedProblem,
    margin: FloatArray,
    *,
    n_units: int,
    cost: FloatArray,
    left: Callable[[Measure, int], FloatArray],
) -> SetValues:
    """Values from the margins of all runs and what is left after failures."""
    is_avoided = margin > -np.inf

    @cache
    def share() -> FloatArray:
        weight: FloatArray = is_avoided @ reduced.weight
        return weight

    def mean_margin() -> FloatArray:
        total = np.where(is_avoided, margin, 0.0) @ reduced.weight
        mean: FloatArray = np.divide(total, share(), out=np.zeros(len(margin)), where=share() > 0.0)
        return mean

    def smallest_margin() -> FloatArray:
        smallest = np.where(is_avoided, margin, np.inf).min(axis=1, initial=np.inf)
        return np.where(share() > 0.0, smallest, 0.0)

    values: dict[Objective, Callable[[], FloatArray]] = {
        Objective.UNITS: lambda: np.full(len(margin), float(n_units)),
        Objective.COST: lambda: cost,
        Objective.APR_SURVIVED: lambda: left(reduced.measure, reduced.survive),
        Objective.APR: lambda: reduced.measure.of(is_avoided),
        Objective.APR_ONE_FAILED: lambda: left(reduced.measure, 1),
        Objective.SMALLEST_MARGIN: smallest_margin,
        Objective.MEAN_MARGIN: mean_margin,
    }
    return build_values(reduced, left, values)


def build_values(
    reduced: ReducedProblem,
    left: Callable[[Measure, int], FloatArray],
    values: dict[Objective, Callable[[], FloatArray]],
) -> SetValues:
    """Values in the order of a problem's objectives, as far as there is a function for them."""
    lacking: FloatArray | float = 0.0
    for floor in reduced.floors:
        short = floor.least - TOLERANCE - left(floor.measure, floor.n_failures)
        lacking = lacking + np.maximum(short, 0.0)
    objectives = tuple(objective for objective in reduced.objectives if objective in values)
    columns = [
        -values[objective]() if objective.is_minimised else values[objective]()
        for objective in objectives
    ]
    gains = np.empty((len(columns[0]), 1 + len(columns)))
    gains[:, 0] = -np.asarray(lacking)
    gains[:, 1:] = np.column_stack(columns)
    return SetValues(objectives, gains)


def best_set(reduced: ReducedProblem, sets: IntArray) -> IntArray:
    """First set of poses whose value no other one exceeds: (n_sets, n_units) -> (n_units,)."""
    if not reduced.floors and reduced.objectives[0] is Objective.APR:
        share = union_apr(reduced, unions_of(reduced, sets))
        # Failures are costly to go through: only sets with the best APR need it.
        sets = sets[share >= share.max() - TOLERANCE]
    best: IntArray = sets[set_values(reduced, sets).best_row()]
    return best


def avoided_with_each(reduced: ReducedProblem, units: IntArray) -> BoolArray:
    """Runs that a set of poses together with each pose in turn avoids, (n_poses, n_runs)."""
    in_time = (reduced.margin_s > -np.inf).sum(axis=1)
    first = _first_with_each(reduced, units)
    avoided = np.empty((len(in_time), reduced.n_poses), dtype=bool)

    def compare(begin: int, end: int) -> None:
        for run in range(begin, end):
            np.less(first[reduced.run_chain[run]], in_time[run], out=avoided[run])

    share_out(compare, len(in_time))
    return avoided.T


def _left_with_each(
    reduced: ReducedProblem, measure: Measure, n_failures: int, units: IntArray
) -> FloatArray:
    """What a set with each pose in turn still reaches when its worst units fail, (n_poses,)."""

    def alone(left: IntArray) -> float:
        margin_s = union_margins_s(reduced, unions_of(reduced, left[None, :]))
        return float(measure.of(margin_s > -np.inf)[0])

    return least_left_with_each(
        reduced.limits,
        units,
        n_failures,
        poses=np.arange(reduced.n_poses),
        with_each=lambda left: measure.of(avoided_with_each(reduced, left)),
        alone=alone,
    )


def _margins_with_each(reduced: ReducedProblem, units: IntArray) -> FloatArray:
    """Margins of all runs for a set together with each pose, (n_poses, n_runs)."""
    first = _first_with_each(reduced, units)
    margin = np.empty((reduced.n_poses, len(reduced.weight)))

    def look_up(begin: int, end: int) -> None:
        for run in range(begin, end):
            margin[:, run] = reduced.margin_s[run][first[reduced.run_chain[run]]]

    share_out(look_up, len(reduced.weight))
    return margin


def _first_with_each(reduced: ReducedProblem, units: IntArray) -> NDArray[np.int32]:
    """First live window of each chain for a set together with each pose, (n_chains, n_poses)."""
    from .frame_kernels import first_live_with_each

    is_seen = unpack_words(unions_of(reduced, units[None, :])[0], reduced.n_frames)
    first = np.empty((reduced.n_chains, reduced.n_poses), dtype=np.int32)  # it may be large

    def look(begin: int, end: int) -> None:
        first_live_with_each(reduced.detections.columns, is_seen, reduced.chains, begin, end, first)

    share_out(look, reduced.n_chains)
    return first
