"""Search for sets of poses that meet a wish.

Where none does, it finds the least by which a number must give way.
"""

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
# Values with failed units take too long to compute for more.
_MAX_ADDED = 12


def choose_greedily(reduced: ReducedProblem) -> IntArray:
    """Add poses one by one, that first which leaves the floors lacking least.

    These are no more poses than are needed, or all that greedy choice has found room
    for; what comes after the floors does not matter. They may lack something, see
    :func:`meets`.
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
# Of the remaining time, that one question may take.
_SHARE_OF_TIME = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class Feasibility:
    """The answer to whether a wish can be met.

    Attributes
    ----------
    pose_index : tuple of int, optional
        A set of poses that meets it; None: none was found.
    is_proven : bool
        That there is none; or that none has a better `value`.
    value : float
        Where a number was asked for: the least, or the most, found; else NaN.
    """

    pose_index: tuple[int, ...] | None
    is_proven: bool
    value: float = np.nan


_NONE = Feasibility(pose_index=None, is_proven=True)


class Oracle:
    """Answers by greedy choice, and by the optimiser's stages, until time is up.

    All questions are about one problem with other limits and floors.
    """

    def __init__(self, problem: PlacementProblem, *, end_s: float) -> None:
        self.end_s = end_s
        self._shared = presolve_freely(problem)
        self._presolved: dict[int, tuple[Limits, ReducedProblem]] = {}

    def left_s(self) -> float:
        """Time left, in seconds."""
        return self.end_s - now_s()

    def find(self, problem: PlacementProblem) -> Feasibility:
        """A set that meets limits and floors."""
        if self._is_refused_at_once(problem):
            return _NONE
        problem = replace(problem, goal="fewest", survive=0)
        shared = self._shared.for_problem(problem)
        # Greedy choice first; the search only where it fails.
        quick = choose_greedily(shared)
        if meets(shared, quick):
            return Feasibility(pose_index=to_full(shared, quick), is_proven=True)
        # What comes after limits and floors is worth no exchange.
        reduced = replace(self._presolve(problem), objectives=(Objective.UNITS,))
        found = self._search(reduced)
        if isinstance(found, Feasibility):
            return found
        return _answer(found, is_proven=True)

    def least(self, problem: PlacementProblem, goal: Goal) -> Feasibility:
        """The fewest units, or the least cost, that meet limits and floors."""
        problem = replace(problem, goal=goal, survive=0)
        if self._is_refused_at_once(problem):
            return _NONE
        found = self._search(self._presolve(problem))
        if isinstance(found, Feasibility):
            return found
        (objective, find_bound), *_ = Stages(problem, found, Effort()).plan()
        # Proven if the bound of the first stage is reached.
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
    ) -> Feasibility:
        """The highest ratio left when units fail, within limits and floors.

        Those units fail whose loss costs most. `measure` is that of all runs; the
        problem's floors hold, too.
        """
        problem = replace(problem, goal="best", survive=n_failures)
        if self._is_refused_at_once(problem):
            return _NONE
        reduced = self._presolve(problem)
        measure = measure.of_runs(reduced.run_index)
        # Nothing that counts can be avoided: any set is as good.
        if not measure.weight.any():
            return replace(self.find(problem), value=0.0)
        # Ask for all of the measure; what is reached is the most.
        everything = Requirement(
            measure=measure, least=measure.limit, n_failures=n_failures
        )
        found = self._search(replace(reduced, measure=measure), everything)
        if isinstance(found, Feasibility):
            return found
        stages = Stages(problem, found, Effort())
        if n_failures:
            bound = stages.bound_apr_survived()
            objective = Objective.APR_SURVIVED
        else:
            bound = stages.bound_apr()
            objective = Objective.APR
        value = float(found.row.of(objective))
        return _answer(found, is_proven=bound <= value + SOLVER_TOLERANCE, value=value)

    def _is_refused_at_once(self, problem: PlacementProblem) -> bool:
        """True if it is plain that the problem has no solution.

        Limits contradict each other, or all poses together reach too little.
        """
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
    ) -> Search | Feasibility:
        """Search for a set within limits and floors.

        Where there is none, the answer says so. It begins with a set found quickly,
        and takes a part of the time left.
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
            # Exchanges take long for more.
            if len(units) <= _FEW_UNITS:
                search.keep(improve(reduced, units, search.limit, deadline=deadline))

        def has_set() -> bool:
            return search.units is not None and search.shortfall == 0.0

        if has_set():
            bound = np.nan
        else:
            bound = search.look_for(None, ())
        if has_set():
            return search
        return Feasibility(pose_index=None, is_proven=bound == -np.inf)


def _answer(search: Search, *, is_proven: bool, value: float = np.nan) -> Feasibility:
    """The best set of a search as an answer."""
    assert search.units is not None
    poses = to_full(search.reduced, search.units)
    return Feasibility(pose_index=poses, is_proven=is_proven, value=value)
