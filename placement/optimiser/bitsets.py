"""Values of many sets of poses at once, on the bits of the reduced problem."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from itertools import combinations, takewhile

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from .allowed_sets import cost_eur, costs_eur
from .constants import FAR_APART, FEW_PARTNERS, TIES_OF_TIES, TOLERANCE, share_out
from .presolve import ReducedProblem, unpack_words
from .problem import Measure, Objective, WordArray


@dataclass(frozen=True, slots=True, eq=False)
class SetValues:
    """Values of sets of poses: minus what they lack to the floors, then objectives.

    Attributes
    ----------
    objectives : tuple of Objective
        In the order in which sets are compared.
    gains : (n_sets, 1 + n_objectives) float
        The larger the better: minus what is lacking, then each objective, the
        minimised ones negative. One row, (1 + n_objectives,), for a single set.
    """

    objectives: tuple[Objective, ...]
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

    def of(self, objective: Objective) -> FloatArray:
        """Values of one objective, in its own unit."""
        gains: FloatArray = self.gains[..., 1 + self.objectives.index(objective)]
        if objective.is_minimised:
            return -gains
        return gains

    def best_row(self) -> int:
        """First set that no other one exceeds."""
        rows = np.arange(len(self.gains))
        tolerances = _tolerances(self.objectives)
        for column, tolerance in zip(self.gains.T, tolerances, strict=True):
            gain = column[rows]
            rows = rows[gain >= gain.max() - tolerance]
        return int(rows[0])

    def exceeds(self, other: "SetValues") -> bool:
        """True if the first real difference favours this single set.

        Differences within an objective's tolerance are rounding noise.
        """
        difference = self.gains - other.gains
        differs = np.flatnonzero(np.abs(difference) > _tolerances(self.objectives))
        return bool(len(differs)) and bool(difference[differs[0]] > 0.0)


@lru_cache(maxsize=32)
def _tolerances(objectives: tuple[Objective, ...]) -> FloatArray:
    """Tolerance of what is lacking, then of each objective, (1 + n_objectives,)."""
    return np.array([TOLERANCE, *(objective.tolerance for objective in objectives)])


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
            self.units = sets[row]
            self.values = values[row]


class Contenders:
    """Sets that may be best, or tie with the best, and what each is worth.

    Ties are not transitive: of three sets the second may tie with the first and be
    better in a later stage, and the third with the second, but not with the first. So
    no set is given up for another one before all are known.
    """

    def __init__(self, objectives: tuple[Objective, ...]) -> None:
        self.objectives = objectives
        self._sets: list[IntArray] = []
        self._gains: list[FloatArray] = []
        # Of what is lacking, and in the first stage.
        self._most = np.full(2, -np.inf)
        self._slack = TIES_OF_TIES * _tolerances(objectives)

    def add(self, sets: IntArray, values: SetValues) -> None:
        """Compare further sets, (n_sets, n_units)."""
        gains = values.gains
        # By what is lacking, then in the first stage: only sets near the best stay.
        for column in range(2):
            if not len(gains):
                return
            most = float(gains[:, column].max())
            if column == 0 and most > self._most[0] + self._slack[0]:
                # Of sets that lack more.
                self._most[1] = -np.inf
            self._most[column] = max(self._most[column], most)
            near = gains[:, column] >= self._most[column] - self._slack[column]
            sets = sets[near]
            gains = gains[near]
        self._sets.append(sets)
        self._gains.append(gains)

    def best(self) -> IntArray | None:
        """The first set that no other one exceeds; None if there is none."""
        gains = self._all_gains()
        if not len(gains):
            return None
        row = SetValues(self.objectives, gains).best_row()
        for sets in self._sets:
            if row < len(sets):
                return np.asarray(sets[row])
            row -= len(sets)
        raise AssertionError("a row of none of the sets")

    def limits(self, values: SetValues) -> dict[Objective, float]:
        """What no set exceeds that ties with one of some `values` so far, by objective.

        An objective's limit, in its own unit, is the best among the sets that tie with
        `values`, a single set's, in all stages before.
        """
        gains = self._all_gains()
        limits = {}
        for column, tolerance in enumerate(_tolerances(self.objectives)):
            of_values = float(values.gains[column])
            of_sets = float(gains[:, column].max(initial=-np.inf))
            most = max(of_sets, of_values)
            if column > 0:
                objective = self.objectives[column - 1]
                limits[objective] = most
                if objective.is_minimised:
                    limits[objective] = -most
            # Sets that tie in this stage, too, go on to the next one.
            gains = gains[gains[:, column] >= of_values - tolerance]
        return limits

    def _all_gains(self) -> FloatArray:
        """Gains of all sets that are kept, (n_sets, 1 + n_objectives)."""
        none = np.empty((0, 1 + len(self.objectives)))
        return np.concatenate([none, *self._gains])


def union_margins_s(reduced: ReducedProblem, unions: WordArray) -> FloatArray:
    """Margins of all runs given which frames are seen.

    Parameters
    ----------
    reduced : ReducedProblem
        Runs and windows.
    unions : (n_sets, n_words) uint64
        Frames that are seen, as bits.

    Returns
    -------
    margin_s : (n_sets, n_runs) float
        Minus infinity where a run is not avoided. [s]
    """
    from .bit_kernels import first_live_windows

    first = np.empty((len(unions), reduced.n_chains), dtype=np.int64)

    def look(begin: int, end: int) -> None:
        some = np.ascontiguousarray(unions[begin:end])
        first_live_windows(some, reduced.chains, first[begin:end])

    share_out(look, len(unions), workers=reduced.workers)
    run = np.arange(len(reduced.weight))
    margin_s: FloatArray = reduced.margin_s[run, first[:, reduced.run_chain]]
    return margin_s


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
    """APR that sets of poses keep when their worst units, or sites, fail.

    Parameters
    ----------
    reduced : ReducedProblem
        The problem; its limits say whether units or sites fail.
    measure : Measure
        The APR that is asked for.
    n_failures : int
        So many fail, or all that there are.
    sets : (n_sets, n_units) int
        Poses of the reduced problem.

    Returns
    -------
    left : (n_sets,) float
        What is left in the worst case.

    Notes
    -----
    Failing more never leaves more, so that it is enough to let the sites of any n
    of the units fail: that is at most n sites, and any n sites that carry units are
    among them.
    """
    limits = reduced.limits
    n_units = sets.shape[1]
    at = None
    if limits.failing == "site":
        at = limits.site_index[sets]
    smallest = np.full(len(sets), np.inf)
    for failed in combinations(range(n_units), min(n_failures, n_units)):
        if at is None:
            unions = unions_of(reduced, np.delete(sets, failed, axis=1))
        else:
            # Units work unless they stand at the site of one that fails.
            of_failed = at[:, None, list(failed)]
            works = ~(at[:, :, None] == of_failed).any(axis=2)
            unions = np.tile(reduced.base, (len(sets), 1))
            for number, units in enumerate(sets.T):
                unions |= np.where(works[:, number, None], reduced.words[units], 0)
        left = measure.of(union_margins_s(reduced, unions) > -np.inf)
        smallest = np.minimum(smallest, left)
    return smallest


Left = Callable[[Measure, int], FloatArray]
"""What sets keep by a measure when so many units fail, (n_sets,)."""


def set_values(reduced: ReducedProblem, sets: IntArray) -> SetValues:
    """Values of sets of poses, (n_sets, n_units) rows of the reduced problem."""
    margin = union_margins_s(reduced, unions_of(reduced, sets))

    def left(measure: Measure, n_failures: int) -> FloatArray:
        return left_after_failures(reduced, measure, n_failures, sets)

    cost = costs_eur(reduced.limits, sets)
    return _values(reduced, margin, n_units=sets.shape[1], cost=cost, left=left)


def values_with_each(reduced: ReducedProblem, units: IntArray) -> SetValues:
    """Values of a set of poses together with each pose in turn.

    Row c is that of `units` and pose c. Bits run along the poses, 64 sets to a
    word: far faster than :func:`set_values` of these sets.
    """
    return _values(
        reduced,
        _margins_with_each(reduced, units),
        n_units=len(units) + 1,
        cost=costs_with_each_eur(reduced, units),
        left=partial(left_with_each, reduced, units),
    )


def costs_with_each_eur(reduced: ReducedProblem, units: IntArray) -> FloatArray:
    """Cost of a set together with each pose in turn, (n_poses,), in euros."""
    limits = reduced.limits
    is_new = ~np.isin(limits.site_index, limits.site_index[units])
    cost = cost_eur(limits, units) + limits.unit_cost_eur
    of_site = limits.site_cost_eur[limits.site_index]
    return cost + np.where(is_new, of_site, 0.0)


def _values(
    reduced: ReducedProblem,
    margin: FloatArray,
    *,
    n_units: int,
    cost: FloatArray,
    left: Left,
) -> SetValues:
    """Values from the margins of all runs, (n_sets, n_runs), costs and what is left.

    A value is computed only if an objective asks for it.
    """
    is_avoided = margin > -np.inf

    @cache
    def share() -> FloatArray:
        return is_avoided @ reduced.weight

    def mean_margin() -> FloatArray:
        total = np.where(is_avoided, margin, 0.0) @ reduced.weight
        return np.divide(total, share(), out=np.zeros(len(margin)), where=share() > 0.0)

    def smallest_margin() -> FloatArray:
        smallest = np.where(is_avoided, margin, np.inf).min(axis=1, initial=np.inf)
        return np.where(share() > 0.0, smallest, 0.0)

    values = {
        Objective.UNITS: lambda: np.full(len(margin), float(n_units)),
        Objective.COST: lambda: cost,
        Objective.APR_SURVIVED: lambda: left(reduced.measure, reduced.survive),
        Objective.APR: lambda: reduced.measure.of(is_avoided),
        Objective.APR_ONE_FAILED: lambda: left(reduced.measure, 1),
        Objective.SMALLEST_MARGIN: smallest_margin,
        Objective.MEAN_MARGIN: mean_margin,
    }
    gains = np.empty((len(margin), 1 + len(reduced.objectives)))
    gains[:, 0] = -_lacking(reduced, left)
    for place, objective in enumerate(reduced.objectives, start=1):
        gains[:, place] = values[objective]()
        if objective.is_minimised:
            gains[:, place] *= -1.0
    return SetValues(reduced.objectives, gains)


def _lacking(reduced: ReducedProblem, left: Left) -> FloatArray | float:
    """Sum of what sets lack to the floors, (n_sets,).

    A set that lacks anything ties with no other: it lacks :data:`FAR_APART` more.
    """
    lacking: FloatArray | float = 0.0
    for floor in reduced.floors:
        short = floor.least - TOLERANCE - left(floor.measure, floor.n_failures)
        lacking = lacking + np.where(short > 0.0, short + FAR_APART, 0.0)
    return lacking


def avoided_with_each(reduced: ReducedProblem, units: IntArray) -> BoolArray:
    """Runs that a set avoids together with each pose in turn, (n_poses, n_runs)."""
    return _margins_with_each(reduced, units) > -np.inf


def shares_with_each(
    reduced: ReducedProblem, units: IntArray, measure: Measure | None = None
) -> FloatArray:
    """APR of a set together with each pose in turn, (n_poses,).

    Parameters
    ----------
    reduced : ReducedProblem
        The problem.
    units : (n,) int
        Poses of the set.
    measure : Measure, optional
        The APR that is asked for; by default the problem's own.
    """
    from .bit_kernels import add_weights_with_each

    if measure is None:
        measure = reduced.measure
    union = unions_of(reduced, units[None, :])
    alone = union_margins_s(reduced, union)[0] > -np.inf
    is_seen = unpack_words(union[0], reduced.n_frames)
    last = reduced.last
    # A mean over all worlds is a sum over runs: one world will do.
    world = measure.sample_index
    n_worlds = len(measure.sample_weight)
    if measure.is_mean:
        world = np.zeros_like(world)
        n_worlds = 1
    total = np.zeros((reduced.n_poses, n_worlds))
    fixed = (
        reduced.columns,
        is_seen,
        reduced.chains,
        reduced.run_chain,
        last,
        measure.weight,
    )
    for number in range(n_worlds):
        is_mine = world == number
        runs = np.flatnonzero(is_mine & ~alone & (measure.weight > 0.0))
        parts: dict[int, FloatArray] = {}

        def add(
            begin: int, end: int, runs: IntArray, parts: dict[int, FloatArray]
        ) -> None:
            parts[begin] = np.zeros(reduced.n_poses)
            add_weights_with_each(*fixed, runs[begin:end], parts[begin])

        add_part = partial(add, runs=runs, parts=parts)
        share_out(add_part, len(runs), workers=reduced.workers)
        # Parts in their order: sums are the same in each run of the program.
        total[:, number] = measure.weight[is_mine & alone].sum()
        for begin in sorted(parts):
            total[:, number] += parts[begin]
    return measure.of_worlds(total)


def left_with_each(
    reduced: ReducedProblem, units: IntArray, measure: Measure, n_failures: int
) -> FloatArray:
    """APR that a set with each pose keeps when its worst units, or sites, fail.

    The same as :func:`left_after_failures` of these sets, (n_poses,), but faster.
    """

    def alone(left: IntArray) -> float:
        return float(left_after_failures(reduced, measure, 0, left[None, :])[0])

    limits = reduced.limits
    if limits.failing == "unit":
        at = np.arange(len(units))
    else:
        at = limits.site_index[units]
    groups = np.unique(at).tolist()
    if n_failures > len(groups):
        return np.full(reduced.n_poses, alone(units[:0]))
    smallest = np.full(reduced.n_poses, np.inf)
    for failed in combinations(groups, n_failures):
        rest = units[~np.isin(at, failed)]
        left = shares_with_each(reduced, rest, measure)
        # A pose that joins a site that fails is lost with it.
        if limits.failing == "site":
            joins_failed = np.isin(limits.site_index, failed)
            left = np.where(joins_failed, alone(rest), left)
        smallest = np.minimum(smallest, left)
    # The pose that has joined may be among those that fail.
    if n_failures:
        for failed in combinations(groups, n_failures - 1):
            rest = units[~np.isin(at, failed)]
            smallest = np.minimum(smallest, alone(rest))
    return smallest


def best_with_each(
    reduced: ReducedProblem, units: IntArray, poses: IntArray
) -> IntArray:
    """Best set of `units` and one of some poses; of equal ones the first.

    There is at least one pose. Objective by objective only the best poses are
    looked at further. Returns the set, (n_units + 1,), the new pose last.
    """
    for find, tolerance in _quick_stages(reduced, units):
        if len(poses) <= FEW_PARTNERS:
            break
        value = find()[poses]
        poses = poses[value >= value.max() - tolerance]
    if len(poses) > FEW_PARTNERS:
        row = values_with_each(reduced, units)[poses].best_row()
        return np.append(units, poses[row])
    before = np.tile(units, (len(poses), 1))
    sets = np.column_stack([before, poses])
    row = set_values(reduced, sets).best_row()
    return np.asarray(sets[row])


def _quick_stages(
    reduced: ReducedProblem, units: IntArray
) -> list[tuple[Callable[[], FloatArray], float]]:
    """How to find the gains of the first objectives with each pose, and tolerances.

    These are the objectives before the first margin: their gains, (n_poses,), need
    no margins of runs.
    """
    left = partial(left_with_each, reduced, units)
    quick: dict[Objective, Callable[[], FloatArray]] = {
        # All sets have as many.
        Objective.UNITS: lambda: np.zeros(reduced.n_poses),
        Objective.COST: lambda: -costs_with_each_eur(reduced, units),
        Objective.APR_SURVIVED: lambda: left(reduced.measure, reduced.survive),
        Objective.APR: lambda: shares_with_each(reduced, units),
        Objective.APR_ONE_FAILED: lambda: left(reduced.measure, 1),
    }
    objectives = takewhile(quick.__contains__, reduced.objectives)
    stages = [(quick[objective], objective.tolerance) for objective in objectives]
    if reduced.floors:
        stages.insert(0, (lambda: -np.asarray(_lacking(reduced, left)), TOLERANCE))
    return stages


def _margins_with_each(reduced: ReducedProblem, units: IntArray) -> FloatArray:
    """Margins of all runs for a set together with each pose, (n_poses, n_runs)."""
    from .bit_kernels import first_live_with_each

    union = unions_of(reduced, units[None, :])[0]
    is_seen = unpack_words(union, reduced.n_frames)
    # Short integers: this array may be large.
    first = np.empty((reduced.n_chains, reduced.n_poses), dtype=np.int32)
    margin = np.empty((reduced.n_poses, len(reduced.weight)))

    def look(begin: int, end: int) -> None:
        first_live_with_each(
            reduced.columns, is_seen, reduced.chains, begin, end, first
        )

    def look_up(begin: int, end: int) -> None:
        for run in range(begin, end):
            link = first[reduced.run_chain[run]]
            margin[:, run] = reduced.margin_s[run][link]

    share_out(look, reduced.n_chains, workers=reduced.workers)
    share_out(look_up, len(reduced.weight), workers=reduced.workers)
    return margin
