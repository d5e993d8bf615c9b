"""Search for sets of poses that meet a wish, and for the least by which a number must give way."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.arrays import BoolArray, IntArray
from geometry.clock import now_s
from geometry.errors import InputError

from ..optimiser import Limits, PlacementProblem, ReducedProblem, cost_eur, is_allowed, presolve
from ..optimiser.allowed_sets import fitting, price_step_eur
from ..optimiser.bitsets import left_after_failures, set_values, union_margins_s, values_with_each
from ..optimiser.greedy import forced_units, improve, to_full
from ..optimiser.problem import Measure, Objective, Requirement
from ..optimiser.proof import Search
from ..optimiser.solve import check_limits
from ..optimiser.timing import COST_TOLERANCE_EUR, TOLERANCE, Deadline
from ..optimiser.walk import best_of_few

# ---------- greedy choice
_MAX_ADDED = 12  # values with failed units take too long to compute for more


def choose_greedily(reduced: ReducedProblem) -> IntArray:
    """Add poses one by one, that first which leaves the floors lacking least.

    No more than are needed, or all that there is room for; see :func:`meets`.
    """
    units = forced_units(reduced)
    most = min(reduced.limits.max_units, len(units) + _MAX_ADDED)
    while len(units) < most and not meets(reduced, units):
        fits = fitting(reduced.limits, units)
        if not _lacks_floors(reduced, units):  # a forced site, or any unit at all
            fits &= _at_missing_site(reduced, units)
        free = np.flatnonzero(fits)
        if not len(free):
            break
        units = np.append(units, free[values_with_each(reduced, units)[free].descending()[0]])
    return units


def meets(reduced: ReducedProblem, units: IntArray) -> bool:
    """True if a set of poses is within the limits and reaches the floors."""
    if not len(units) or not is_allowed(reduced.limits, units):
        return False
    return not _lacks_floors(reduced, units)


def _lacks_floors(reduced: ReducedProblem, units: IntArray) -> bool:
    return bool(set_values(reduced, units[None, :]).lacking[0] > 0.0)


def _at_missing_site(reduced: ReducedProblem, units: IntArray) -> BoolArray:
    """Poses at sites that are still to carry a unit; all where there is no such site."""
    limits = reduced.limits
    missing = limits.is_forced_site.copy()
    missing[limits.site_index[units]] = False
    at_missing: BoolArray = missing[limits.site_index]
    return at_missing if missing.any() else ~at_missing


# ---------- the oracle
_NO_OBJECTIVE: dict[str, Any] = {"floors": (), "goal": "best", "survive": 0}
_FEW_UNITS = 6
_SHARE_OF_TIME = 0.4  # of the remaining time, that one question may take


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """The answer to whether a wish can be met."""

    pose_index: tuple[int, ...] | None  # a set of poses that meets it; None: none was found
    is_proven: bool  # that there is none; or that none has a better `value`
    # where a number was asked for: the least, or the most, that was found; else NaN
    value: float = np.nan


class Oracle:
    """Answers by greedy choice, enumeration or mixed-integer models, until time is up.

    All questions are about one problem with other limits and floors. Up to `max_sets` sets are gone
    through one by one.
    """

    def __init__(self, problem: PlacementProblem, *, end_s: float, max_sets: int) -> None:
        self.end_s, self.max_sets = end_s, max_sets
        limits = problem.limits
        # One presolve for whatever limits come up: where every site carries any number of units, no
        # pose stands in another one's way, and only those that detect nothing that counts drop out.
        free = Limits(
            site_index=limits.site_index,
            site_capacity=np.full(limits.n_sites, limits.n_poses),
            unit_cost_eur=limits.unit_cost_eur,
            site_cost_eur=limits.site_cost_eur,
            is_forced=limits.is_forced,
            is_forced_site=limits.is_forced_site,
        )
        self._shared = presolve(replace(problem, limits=free, **_NO_OBJECTIVE))
        self._presolved: dict[int, tuple[Limits, ReducedProblem]] = {}

    def left_s(self) -> float:
        """Time left, in seconds."""
        return self.end_s - now_s()

    def find(self, problem: PlacementProblem) -> Answer:
        """A set that meets limits and floors."""
        if self._is_refused_at_once(problem):
            return _NONE
        shared = self._ask_of(self._shared, problem)
        quick = choose_greedily(shared)
        if meets(shared, quick):
            return Answer(pose_index=to_full(shared, quick), is_proven=True)
        reduced = self._ask_of(self._presolve(problem), problem)
        units, is_complete = best_of_few(reduced, max_sets=self.max_sets)
        if not is_complete:
            # What comes after limits and floors is worth no exchange.
            found = self._search(replace(reduced, objectives=(Objective.UNITS,)))
            if isinstance(found, Answer):
                return found
            units = found.units
        if units is None or not meets(reduced, units):
            return _NONE
        return Answer(pose_index=to_full(reduced, units), is_proven=True)

    def least_units(self, problem: PlacementProblem, *, more_than: int) -> Answer:
        """The fewest units that meet limits and floors; it is known how many do not suffice."""
        is_proven = True
        for n_units in range(more_than + 1, problem.limits.max_units + 1):
            if self.left_s() <= 0.0:
                break
            answer = self.find(
                replace(problem, limits=replace(problem.limits, budget_units=n_units))
            )
            if answer.pose_index is not None:
                return replace(answer, value=float(n_units), is_proven=is_proven)
            is_proven &= answer.is_proven
        any_number = self.find(problem)
        if any_number.pose_index is None:
            return any_number
        return replace(any_number, value=float(len(any_number.pose_index)), is_proven=False)

    def least_cost_eur(self, problem: PlacementProblem, *, more_than_eur: float) -> Answer:
        """The least cost at which limits and floors are met, where so much is known not to do."""
        limits = problem.limits
        step_eur = max(price_step_eur(limits), 0.01)
        best = self.find(problem)
        if best.pose_index is None:
            return best
        value, low, is_proven = cost_eur(limits, best.pose_index), more_than_eur, True
        while value - low > step_eur + COST_TOLERANCE_EUR and self.left_s() > 0.0:
            # No set costs anything between two multiples of the step.
            middle = step_eur * np.floor((0.5 * (low + value)) / step_eur + 1.0e-9)
            if middle <= low + COST_TOLERANCE_EUR:
                middle = step_eur * np.floor(value / step_eur - 1.0 + 1.0e-9)
            answer = self.find(replace(problem, limits=replace(limits, budget_eur=float(middle))))
            if answer.pose_index is not None:
                best, value = answer, cost_eur(limits, answer.pose_index)
            else:
                low, is_proven = float(middle), is_proven and answer.is_proven
        is_proven &= value - low <= step_eur + COST_TOLERANCE_EUR
        return replace(best, value=value, is_proven=is_proven)

    def most(self, problem: PlacementProblem, measure: Measure, n_failures: int) -> Answer:
        """The highest ratio left when the most painful units fail, within limits and floors.

        `measure` is that of all runs; the problem's floors hold, too.
        """
        if self._is_refused_at_once(problem):
            return _NONE
        reduced = self._ask_of(self._presolve(problem), problem)
        measure = measure.of_runs(reduced.run_index)
        if not measure.weight.any():  # nothing that counts can be avoided: any set is as good
            return replace(self.find(problem), value=0.0)
        objectives = (Objective.APR_SURVIVED, Objective.APR) if n_failures else (Objective.APR,)
        reduced = replace(reduced, objectives=objectives, measure=measure, survive=n_failures)
        units, is_complete = best_of_few(reduced, max_sets=self.max_sets)
        is_proven = True
        if not is_complete:
            everything = Requirement(measure=measure, least=measure.limit, n_failures=n_failures)
            found = self._search(reduced, everything)
            if isinstance(found, Answer):
                return found
            is_proven, units = _raise_ratio(found, n_failures), found.units
        if units is None or not meets(reduced, units):
            return _NONE
        left = left_after_failures(reduced, measure, n_failures, units[None, :])
        poses = to_full(reduced, units)
        return Answer(pose_index=poses, is_proven=is_proven, value=float(left[0]))

    def _is_refused_at_once(self, problem: PlacementProblem) -> bool:
        """True if limits contradict each other, or all poses together reach too little."""
        limits = problem.limits
        try:
            check_limits(limits, problem.table.pose_ids)
        except InputError:
            return True
        shared = self._ask_of(self._shared, problem)
        usable = (limits.site_capacity[limits.site_index] > 0) & ~limits.is_forbidden
        words = shared.words[usable[shared.pose_index]]
        everything = np.bitwise_or.reduce(words, axis=0, keepdims=True)
        is_avoided = union_margins_s(shared, everything) > -np.inf
        return any(
            float(floor.measure.of(is_avoided)[0]) < floor.least - TOLERANCE
            for floor in shared.floors
        )

    def _presolve(self, problem: PlacementProblem) -> ReducedProblem:
        """Presolved for these limits: once for the same ones."""
        key = id(problem.limits)
        if key not in self._presolved:
            bare = replace(problem, **_NO_OBJECTIVE)
            self._presolved[key] = problem.limits, presolve(bare)
        return self._presolved[key][1]

    def _ask_of(self, reduced: ReducedProblem, problem: PlacementProblem) -> ReducedProblem:
        """A reduced problem with a problem's limits and floors; few units come next."""
        floors = tuple(
            Requirement(
                measure=problem.floor_measure(floor).of_runs(reduced.run_index),
                least=floor.share,
                n_failures=floor.n_failures,
            )
            for floor in problem.floors
        )
        return replace(
            reduced, limits=problem.limits.of_poses(reduced.pose_index), floors=floors
        ).with_goal("fewest")

    def _search(self, reduced: ReducedProblem, aim: Requirement | None = None) -> Search | Answer:
        """A search that has a set within limits and floors; else the answer that there is none.

        It begins with a set found quickly, and takes a part of the time left.
        """
        deadline = Deadline(now_s() + _SHARE_OF_TIME * max(self.left_s(), 0.0))
        search = Search(reduced, deadline=deadline)
        floors = reduced.floors if aim is None else (*reduced.floors, aim)
        units = choose_greedily(replace(reduced, floors=floors))
        if len(units) and is_allowed(reduced.limits, units):
            search.keep(units)
            if len(units) <= _FEW_UNITS:  # exchanges take long for more
                search.keep(improve(reduced, units, search.limit, deadline=deadline))

        def has_set() -> bool:
            return search.units is not None and search.shortfall == 0.0

        bound = np.nan if has_set() else search.look_for(None, ())
        return search if has_set() else Answer(pose_index=None, is_proven=bound == -np.inf)


_NONE = Answer(pose_index=None, is_proven=True)


def _raise_ratio(search: Search, n_failures: int) -> bool:
    """Raise the ratio of the best set when units fail; True if it is proven to be the highest."""
    measure = search.reduced.measure

    def left() -> float:
        assert search.units is not None
        sets = search.units[None, :]
        return float(left_after_failures(search.reduced, measure, n_failures, sets)[0])

    while True:
        before = left()
        if before >= measure.limit - TOLERANCE:
            return True
        if n_failures == 0:
            bound = search.look_for(Objective.APR, ())
            return bound <= left() + 1.0e-6
        least = before + 2.0 * TOLERANCE
        more = Requirement(measure=measure, least=least, n_failures=n_failures)
        if search.look_for(None, [more]) == -np.inf:
            return True
        if left() <= before + TOLERANCE:
            return False  # time is up
