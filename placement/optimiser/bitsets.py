"""Values of many sets of poses at once, on the bits of the reduced problem."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from itertools import combinations, takewhile

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray

from .limits import Limits, cost_eur, costs_eur
from .presolve import ReducedProblem, unpack_words
from .problem import Measure, Objective, WordArray
from .steering import DECIMALS, FEW_PARTNERS, TOLERANCE, share_out

# ---------- values that are compared stage by stage


@dataclass(frozen=True, slots=True, eq=False)
class SetValues:
    """Values of sets of poses: minus what they lack to the floors, then each objective."""

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
        """Sum of what is lacking to the floors; 0 where all are reached."""
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
        """True if the first difference that exceeds rounding noise favours this single set."""
        difference = self.gains - other.gains
        differs = np.flatnonzero(np.abs(difference) > _tolerances(self.objectives))
        return bool(len(differs)) and bool(difference[differs[0]] > 0.0)

    def descending(self) -> IntArray:
        """Order of the sets, the best first."""
        order: IntArray = np.lexsort(-self.gains.round(DECIMALS).T[::-1])
        return order


@lru_cache(maxsize=32)
def _tolerances(objectives: tuple[Objective, ...]) -> FloatArray:
    return np.array([TOLERANCE, *(objective.tolerance for objective in objectives)])


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


# ---------- values of sets


def union_margins_s(reduced: ReducedProblem, unions: WordArray) -> FloatArray:
    """Margins of all runs given which frames are seen: (n_sets, n_words) -> (n_sets, n_runs).

    Minus infinity where a run is not avoided.
    """
    from .bit_kernels import first_live_windows

    first = np.empty((len(unions), reduced.n_chains), dtype=np.int64)

    def look(begin: int, end: int) -> None:
        first_live_windows(
            np.ascontiguousarray(unions[begin:end]), reduced.chains, first[begin:end]
        )

    share_out(look, len(unions), workers=reduced.workers)
    margin: FloatArray = reduced.margin_s[
        np.arange(len(reduced.weight)), first[:, reduced.run_chain]
    ]
    return margin


def union_apr(reduced: ReducedProblem, unions: WordArray) -> FloatArray:
    """Accident prevention ratio given which frames are seen, (n_sets,)."""
    return reduced.measure.of(union_margins_s(reduced, unions) > -np.inf)


def unions_of(reduced: ReducedProblem, sets: IntArray) -> WordArray:
    """Frames that sets of poses see: (n_sets, n_units) -> (n_sets, n_words) bits."""
    unions = np.tile(reduced.base, (len(sets), 1))
    for units in sets.T:
        unions |= reduced.words[units]
    return unions


def left_after_failures(
    reduced: ReducedProblem, measure: Measure, n_failures: int, sets: IntArray
) -> FloatArray:
    """APR that sets of poses keep when the worst of their units fail, (n_sets,)."""

    def value(left: IntArray) -> FloatArray:
        return measure.of(union_margins_s(reduced, unions_of(reduced, left)) > -np.inf)

    return least_left(reduced.limits, sets, n_failures, value)


# ---------- failures: by sites, several units may fail at once, those of one pole


def least_left(
    limits: Limits, sets: IntArray, n_failures: int, value: Callable[[IntArray], FloatArray]
) -> FloatArray:
    """Smallest value that sets keep when so many units, or sites, of each fail, (n_sets,).

    `value` is that of sets, (n_sets, any) -> (n_sets,), also of no units. Failing more never
    leaves more, so that it is enough to let the sites of any n of the units fail: that is at most n
    sites, and any n sites that carry units are among them.
    """
    n_units = sets.shape[1]
    n_failures = min(n_failures, n_units)
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
    left = value(np.where(works, sets, first))
    return np.where(works.any(axis=1), left, value(sets[:1, :0]))


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
        return np.full(len(poses), alone(units[:0]))
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


# ---------- all objectives


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
        left=partial(_left_by, reduced, units),
    )


def costs_with_each_eur(reduced: ReducedProblem, units: IntArray) -> FloatArray:
    """Cost of a set together with each pose in turn, (n_poses,), in euros."""
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
    lacking = _lacking(reduced, left)
    objectives = tuple(objective for objective in reduced.objectives if objective in values)
    columns = [
        -values[objective]() if objective.is_minimised else values[objective]()
        for objective in objectives
    ]
    gains = np.empty((len(columns[0]), 1 + len(columns)))
    gains[:, 0] = -lacking
    gains[:, 1:] = np.column_stack(columns)
    return SetValues(objectives, gains)


def _lacking(
    reduced: ReducedProblem, left: Callable[[Measure, int], FloatArray]
) -> FloatArray | float:
    """Sum of what sets lack to the floors."""
    lacking: FloatArray | float = 0.0
    for floor in reduced.floors:
        short = floor.least - TOLERANCE - left(floor.measure, floor.n_failures)
        lacking = lacking + np.maximum(short, 0.0)
    return lacking


# ---------- a set together with each pose: bits along the poses, 64 sets to a word


def avoided_with_each(reduced: ReducedProblem, units: IntArray) -> BoolArray:
    """Runs that a set of poses together with each pose in turn avoids, (n_poses, n_runs)."""
    in_time = reduced.last
    first = _first_with_each(reduced, units)
    avoided = np.empty((len(in_time), reduced.n_poses), dtype=bool)

    def compare(begin: int, end: int) -> None:
        for run in range(begin, end):
            np.less(first[reduced.run_chain[run]], in_time[run], out=avoided[run])

    share_out(compare, len(in_time), workers=reduced.workers)
    return avoided.T


def shares_with_each(
    reduced: ReducedProblem, units: IntArray, measure: Measure | None = None
) -> FloatArray:
    """APR of a set together with each pose in turn, (n_poses,); by default by the own measure."""
    from .bit_kernels import add_weights_with_each

    measure = reduced.measure if measure is None else measure
    union = unions_of(reduced, units[None, :])
    alone = union_margins_s(reduced, union)[0] > -np.inf
    is_seen, last = unpack_words(union[0], reduced.n_frames), reduced.last
    world = np.zeros_like(measure.sample_index) if measure.is_mean else measure.sample_index
    n_worlds = 1 if measure.is_mean else len(measure.sample_weight)
    total = np.zeros((reduced.n_poses, n_worlds))
    for number in range(n_worlds):
        is_mine = world == number
        runs = np.flatnonzero(is_mine & ~alone & (measure.weight > 0.0))
        parts: dict[int, FloatArray] = {}

        def add(begin: int, end: int, runs: IntArray, parts: dict[int, FloatArray]) -> None:
            parts[begin] = np.zeros(reduced.n_poses)
            add_weights_with_each(
                reduced.columns,
                is_seen,
                reduced.chains,
                reduced.run_chain,
                last,
                measure.weight,
                runs[begin:end],
                parts[begin],
            )

        share_out(partial(add, runs=runs, parts=parts), len(runs), workers=reduced.workers)
        total[:, number] = measure.weight[is_mine & alone].sum()
        for begin in sorted(parts):
            total[:, number] += parts[begin]
    return measure.of_worlds(total)


def left_with_each(
    reduced: ReducedProblem, units: IntArray, n_failures: int, measure: Measure | None = None
) -> FloatArray:
    """APR that a set with each pose keeps when its worst units fail, (n_poses,)."""
    measure = reduced.measure if measure is None else measure

    def alone(left: IntArray) -> float:
        margin_s = union_margins_s(reduced, unions_of(reduced, left[None, :]))
        return float(measure.of(margin_s > -np.inf)[0])

    return least_left_with_each(
        reduced.limits,
        units,
        n_failures,
        poses=np.arange(reduced.n_poses),
        with_each=lambda left: shares_with_each(reduced, left, measure),
        alone=alone,
    )


def best_with_each(reduced: ReducedProblem, units: IntArray, poses: IntArray) -> IntArray:
    """The best set of `units` and one of some poses, at least one; of equal ones the first.

    Objective by objective only the best poses are looked at further, so that what takes long is
    computed for few.
    """
    for find, tolerance in _quick_stages(reduced, units):
        if len(poses) <= FEW_PARTNERS:
            break
        value = find()[poses]
        poses = poses[value >= value.max() - tolerance]
    if len(poses) > FEW_PARTNERS:
        row = values_with_each(reduced, units)[poses].best_row()
        return np.append(units, poses[row])
    sets = np.column_stack([np.tile(units, (len(poses), 1)), poses])
    best: IntArray = sets[set_values(reduced, sets).best_row()]
    return best


def _quick_stages(
    reduced: ReducedProblem, units: IntArray
) -> list[tuple[Callable[[], FloatArray], float]]:
    """Functions that find the gains of the first objectives with each pose, before margins."""
    quick: dict[Objective, Callable[[], FloatArray]] = {
        Objective.UNITS: lambda: np.zeros(reduced.n_poses),  # all sets have as many
        Objective.COST: lambda: -costs_with_each_eur(reduced, units),
        Objective.APR_SURVIVED: lambda: left_with_each(reduced, units, reduced.survive),
        Objective.APR: lambda: shares_with_each(reduced, units),
        Objective.APR_ONE_FAILED: lambda: left_with_each(reduced, units, 1),
    }
    objectives = takewhile(quick.__contains__, reduced.objectives)
    stages = [(quick[objective], objective.tolerance) for objective in objectives]
    if reduced.floors:
        left = partial(_left_by, reduced, units)
        stages.insert(0, (lambda: -np.asarray(_lacking(reduced, left)), TOLERANCE))
    return stages


def _left_by(
    reduced: ReducedProblem, units: IntArray, measure: Measure, n_failures: int
) -> FloatArray:
    return left_with_each(reduced, units, n_failures, measure)


def _margins_with_each(reduced: ReducedProblem, units: IntArray) -> FloatArray:
    """Margins of all runs for a set together with each pose, (n_poses, n_runs)."""
    first = _first_with_each(reduced, units)
    margin = np.empty((reduced.n_poses, len(reduced.weight)))

    def look_up(begin: int, end: int) -> None:
        for run in range(begin, end):
            margin[:, run] = reduced.margin_s[run][first[reduced.run_chain[run]]]

    share_out(look_up, len(reduced.weight), workers=reduced.workers)
    return margin


def _first_with_each(reduced: ReducedProblem, units: IntArray) -> NDArray[np.int32]:
    """First live window of each chain for a set together with each pose, (n_chains, n_poses)."""
    from .bit_kernels import first_live_with_each

    is_seen = unpack_words(unions_of(reduced, units[None, :])[0], reduced.n_frames)
    first = np.empty((reduced.n_chains, reduced.n_poses), dtype=np.int32)  # it may be large

    def look(begin: int, end: int) -> None:
        first_live_with_each(reduced.columns, is_seen, reduced.chains, begin, end, first)

    share_out(look, reduced.n_chains, workers=reduced.workers)
    return first
