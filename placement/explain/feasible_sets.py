"""Search for sets of poses that meet a wish, and for the least by which a number must give way."""

from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import IntArray
from geometry.clock import now_s
from geometry.errors import InputError

from ..optimiser import (
    Effort,
    Limits,
    PlacementProblem,
    ReducedProblem,
    is_allowed,
    presolve,
)
from ..optimiser.bitsets import set_values
from ..optimiser.constants import SOLVER_TOLERANCE, Deadline
from ..optimiser.greedy import extend_greedily, forced_units, improve, to_full
from ..optimiser.presolve import presolve_freely
from ..optimiser.problem import Goal, Measure, Objective, Requirement
from ..optimiser.proof import Search, Stages
from ..optimiser.solve import check_limits, check_reach

# ---------- greedy choice
_MAX_ADDED = 12  # values with failed units take too long to compute for more


def choose_greedily(reduced: ReducedProblem) -> IntArray:
    """Few poses, one by one that first which leaves the floors lacking least, until none does.

    No more than there is room for; see :func:`meets`.
    """
    limits = reduced.limits
    units = forced_units(reduced)
    most = max(min(limits.max_units, len(units) + _MAX_ADDED), 1)
    if not reduced.objectives[0].is_minimised:
        reduced = reduced.with_goal("fewest")
    return extend_greedily(
        replace(reduced, limits=replace(limits, budget_units=most)), units
    )


def meets(reduced: ReducedProblem, units: IntArray) -> bool:
    """True if a set of poses is within the limits and reaches the floors."""
    if not len(units) or not is_allowed(reduced.limits, units):
        return False
    return not bool(set_values(reduced, units[None, :]).lacking[0] > 0.0)


# ---------- the oracle
_FEW_UNITS = 6
_SHARE_OF_TIME = 0.4  # of the remaining time, that one question may take


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """The answer to whether a wish can be met."""

    pose_index: (
        tuple[int, ...] | None
    )  # a set of poses that meets it; None: none was found
    is_proven: bool  # that there is none; or that none has a better `value`
    value: float = (
        np.nan
    )  # where a number was asked for: the least, or the most, found; else NaN


_NONE = Answer(pose_index=None, is_proven=True)


class Oracle:
    """Answers by greedy choice, and by the optimiser's stages, until time is up.

    All questions are about one problem with other limits and floors.
    """

    def __init__(self, problem: PlacementProblem, *, end_s: float) -> None:
        self.end_s, self._shared = end_s, presolve_freely(problem)
        self._presolved: dict[int, tuple[Limits, ReducedProblem]] = {}

    def left_s(self) -> float:
        """Time left, in seconds."""
        return self.end_s - now_s()

    def find(self, problem: PlacementProblem) -> Answer:
        """A set that meets limits and floors."""
        if self._is_refused_at_once(problem):
            return _NONE
        problem = replace(problem, goal="fewest", survive=0)
        shared = self._shared.for_problem(problem)
        quick = choose_greedily(shared)
        if meets(shared, quick):
            return Answer(pose_index=to_full(shared, quick), is_proven=True)
        # What comes after limits and floors is worth no exchange.
        reduced = replace(self._presolve(problem), objectives=(Objective.UNITS,))
        found = self._search(reduced)
        if isinstance(found, Answer):
            return found
        return _answer(found, is_proven=True)

    def least(self, problem: PlacementProblem, goal: Goal) -> Answer:
        """The fewest units, or the least cost, that meet limits and floors."""
        problem = replace(problem, goal=goal, survive=0)
        if self._is_refused_at_once(problem):
            return _NONE
        found = self._search(self._presolve(problem))
        if isinstance(found, Answer):
            return found
        (objective, find_bound), *_ = Stages(problem, found, Effort()).plan()
        bound = find_bound()
        assert found.units is not None
        is_of_units = objective is Objective.UNITS
        if is_of_units:
            value = float(len(found.units))
        else:
            value = found.value.cost_eur
        is_proven = objective.excess(bound, value) <= objective.tolerance
        return _answer(found, is_proven=is_proven, value=value)

    def most(
        self, problem: PlacementProblem, measure: Measure, n_failures: int
    ) -> Answer:
        """The highest ratio left when the most painful units fail, within limits and floors.

        `measure` is that of all runs; the problem's floors hold, too.
        """
        problem = replace(problem, goal="best", survive=n_failures)
        if self._is_refused_at_once(problem):
            return _NONE
        reduced = self._presolve(problem)
        measure = measure.of_runs(reduced.run_index)
        if (
            not measure.weight.any()
        ):  # nothing that counts can be avoided: any set is as good
            return replace(self.find(problem), value=0.0)
        everything = Requirement(
            measure=measure, least=measure.limit, n_failures=n_failures
        )
        found = self._search(replace(reduced, measure=measure), everything)
        if isinstance(found, Answer):
            return found
        stages = Stages(problem, found, Effort())
        if n_failures:
            bound = stages.bound_apr_survived()
        else:
            bound = stages.bound_apr()
        value = float(
            found.row.of(Objective.APR_SURVIVED if n_failures else Objective.APR)
        )
        return _answer(found, is_proven=bound <= value + SOLVER_TOLERANCE, value=value)

    def _is_refused_at_once(self, problem: PlacementProblem) -> bool:
        """True if limits contradict each other, or all poses together reach too little."""
        limits = problem.limits
        shared = self._shared.for_problem(problem)
        usable = (limits.site_capacity[limits.site_index] > 0) & ~limits.is_forbidden
        try:
            check_limits(limits, problem.table.pose_ids)
            check_reach(
                problem, replace(shared, words=shared.words[usable[shared.pose_index]])
            )
        except InputError:
            return True
        return False

    def _presolve(self, problem: PlacementProblem) -> ReducedProblem:
        """Presolved for these limits: once for the same ones."""
        key = id(problem.limits)
        if key not in self._presolved:
            bare = replace(problem, floors=(), goal="best", survive=0)
            self._presolved[key] = problem.limits, presolve(bare)
        return self._presolved[key][1].for_problem(problem)

    def _search(
        self, reduced: ReducedProblem, aim: Requirement | None = None
    ) -> Search | Answer:
        """A search that has a set within limits and floors; else the answer that there is none.

        It begins with a set found quickly, and takes a part of the time left.
        """
        deadline = Deadline(now_s() + _SHARE_OF_TIME * max(self.left_s(), 0.0))
        search = Search(reduced, deadline=deadline)
        if aim is None:
            floors = reduced.floors
        else:
            floors = (*reduced.floors, aim)
        units = choose_greedily(replace(reduced, floors=floors))
        if len(units) and is_allowed(reduced.limits, units):
            search.keep(units)
            if len(units) <= _FEW_UNITS:  # exchanges take long for more
                search.keep(improve(reduced, units, search.limit, deadline=deadline))

        def has_set() -> bool:
            return search.units is not None and search.shortfall == 0.0

        if has_set():
            bound = np.nan
        else:
            bound = search.look_for(None, ())
        if has_set():
            return search
        return Answer(pose_index=None, is_proven=bound == -np.inf)


def _answer(search: Search, *, is_proven: bool, value: float = np.nan) -> Answer:
    """The best set of a search as an answer."""
    assert search.units is not None
    poses = to_full(search.reduced, search.units)
    return Answer(pose_index=poses, is_proven=is_proven, value=value)
