"""The objectives one by one: better sets, and how much better one could be.

The stages, in the order of ``docs/method.md``, and the rungs by which each is
bounded, up to the first that settles it:

========================  =================================================
few units, if asked for   few sets, one unit, walks, model
least cost, if asked for  few sets, cheapest unit, walks, model
APR when units fail, if   few sets, walk, relaxation and models
asked for
APR                       few sets, walk, relaxation, model
APR when one unit fails   few sets, walk, relaxation and models
smallest margin           all poses together, few sets, models
mean margin               all poses together, few sets, relaxation, model
cost                      cheapest unit, few sets, model
========================  =================================================

:class:`Search` has the best set so far, :class:`AllSets` compares sets where
they are few, :class:`Walks` proves by walks, :class:`Stages` has a method for
each stage. A walk that meets all sets that tie makes them few.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from enum import StrEnum
from typing import Any

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.phrases import Phrase
from geometry.registry import load_entry

from . import constants
from .allowed_sets import Limits, are_allowed, is_allowed, price_step_eur
from .bitsets import (
    Contenders,
    SetValues,
    left_after_failures,
    set_values,
    union_apr,
    union_margins_s,
    unions_of,
)
from .bounds import Root, failure_limit, find_root, relax, relaxation_text, run_rows
from .constants import COST_TOLERANCE_EUR, NEVER, TOLERANCE, Deadline, Effort, settle
from .greedy import extend_greedily, improve, search_from_many_starts
from .model import (
    Cut,
    first_cuts,
    solve_window_model,
    solver_text,
    violated_cuts,
)
from .pairs import goes_by_pairs, walk_by_pairs
from .presolve import ReducedProblem
from .problem import (
    VALUE_OBJECTIVES,
    Objective,
    PlacementProblem,
    PlacementValue,
    Requirement,
)
from .walk import (
    SetWalk,
    SomeWalk,
    Tied,
    TieSearch,
    best_of_few,
    best_of_tied,
    can_walk,
    least_apr,
)


class Search:
    """The incumbent, the best set of poses so far, and what the proofs rest on.

    Attributes
    ----------
    reduced : ReducedProblem
        The problem; its limits get tighter where a stage restricts them.
    deadline : Deadline
        When to end.
    is_exact : bool
        True if walks and models may be used.
    proofs : dict
        Names of what proved anything, in order, as keys.
    margin_limit_s : (n_runs,) float
        Margins of all poses together. [s]
    apr_of_vut : float
        APR when all units have failed.
    units : (n,) int, optional
        The incumbent; None before one was found.
    nothing_meets_all : bool
        Proven that no set meets limits and floors.
    row : SetValues
        Values of the incumbent.
    """

    def __init__(
        self,
        reduced: ReducedProblem,
        *,
        deadline: Deadline = NEVER,
        is_exact: bool = True,
    ) -> None:
        self.reduced = reduced
        self.deadline = deadline
        # Whether walks and models may be used.
        self.is_exact = is_exact
        self.proofs: dict[Phrase, None] = {}
        everything = np.bitwise_or.reduce(reduced.words, axis=0, keepdims=True)
        self.margin_limit_s: FloatArray = union_margins_s(reduced, everything)[0]
        # What is left when all units have failed.
        self.apr_of_vut = float(union_apr(reduced, reduced.base[None, :])[0])
        self.units: IntArray | None = None
        # Proven that no set meets limits and floors.
        self.nothing_meets_all = False
        nothing = np.full(1 + len(reduced.objectives), -np.inf)
        self.row = SetValues(reduced.objectives, nothing)
        # Values in stages that are settled.
        self._held: dict[Objective, float] = {}
        self._cuts: dict[tuple[object, ...], list[Cut]] = {}
        self._root: Root | None = None

    @property
    def root(self) -> Root:
        """Prices on runs for sets of as many units as allowed."""
        if self._root is None:
            reduced = self.reduced
            self._root = find_root(
                reduced,
                run_rows(reduced),
                n_units=reduced.limits.max_units,
                deadline=self.deadline,
            )
        return self._root

    @property
    def value(self) -> PlacementValue:
        """Value of the best set."""
        values = [float(self.row.of(objective)) for objective in VALUE_OBJECTIVES]
        return PlacementValue._make(values)

    @property
    def shortfall(self) -> float:
        """Sum of what the incumbent lacks to the floors."""
        # Infinite where there is no set.
        return float(self.row.lacking)

    @property
    def limit(self) -> SetValues:
        """Upper bound of all sets: the values of all poses together."""
        reduced = self.reduced
        largest: dict[Objective, float] = {}
        if len(reduced.weight):
            all_runs = reduced.measure.limit
            most = reduced.limits.max_units
            margin_s = self.margin_limit_s
            mean_margin_s = float(np.average(margin_s, weights=reduced.weight))

            def left(n_failures: int) -> float:
                if most > n_failures:
                    return all_runs
                return self.apr_of_vut

            largest = {
                Objective.APR_SURVIVED: left(reduced.survive),
                Objective.APR: all_runs,
                Objective.APR_ONE_FAILED: left(1),
                Objective.SMALLEST_MARGIN: float(margin_s.min()),
                Objective.MEAN_MARGIN: mean_margin_s,
            }
        gains = [largest.get(objective, 0.0) for objective in reduced.objectives]
        return SetValues(reduced.objectives, np.array([0.0, *gains]))

    def mean_margin_limit_s(self, apr: float) -> float:
        """Upper bound of the mean margin of sets of an APR, in seconds.

        No more seconds are there to share out than all poses together leave.
        """
        largest_s = float(self.margin_limit_s.max(initial=0.0))
        total_s = float(self.reduced.weight @ np.maximum(self.margin_limit_s, 0.0))
        least = self.reduced.measure.least_tied(apr)
        if least > 0.0:
            return min(largest_s, total_s / least)
        return largest_s

    def start(
        self, starts: Sequence[IntArray] = (), *, chance: FloatArray | None = None
    ) -> None:
        """Find a good set; there may be none that reaches the floors.

        Parameters
        ----------
        starts : sequence of (n,) int
            Sets that are tried first.
        chance : (n_poses,) float, optional
            Weights by which others are drawn, such as shares in a relaxed solution.
        """
        for start in starts:
            if is_allowed(self.reduced.limits, start):
                self.keep(start)
        uses_root = can_walk(self.reduced) and not goes_by_pairs(self.reduced)

        def chances() -> FloatArray:
            if chance is not None:
                return chance
            return self.root.share

        draw_by = None
        if uses_root or chance is not None:
            draw_by = chances
        end = self.deadline.of("first set")
        units = search_from_many_starts(
            self.reduced,
            self.limit,
            starts=starts,
            chance=draw_by,
            deadline=end,
        )
        if units is not None:
            self.keep(units)
        if self.shortfall > 0.0:
            self.nothing_meets_all = self.look_for(None, ()) == -np.inf

    def restrict(self, limits: Limits) -> None:
        """Look for the best set within tighter limits, which the best so far meets."""
        self.reduced = replace(self.reduced, limits=limits).with_goal("best")
        units = self.units
        self.units = None
        self._root = None
        end = self.deadline.of("first set")
        again = search_from_many_starts(self.reduced, self.limit, deadline=end)
        for found in (units, again):
            if found is not None:
                self.keep(found)

    def keep(self, units: IntArray) -> None:
        """Take a set if it is better than the best so far."""
        row = set_values(self.reduced, units[None, :])[0]
        if self.units is None or (row.exceeds(self.row) and self._ties_where_held(row)):
            self.take(units)

    def take(self, units: IntArray) -> None:
        """Take a set in place of the best so far."""
        self.units = units
        self.row = set_values(self.reduced, units[None, :])[0]

    def hold(self, objective: Objective) -> None:
        """From here on, take only sets that tie with the best one of now in a stage."""
        if objective in self.reduced.objectives:
            self._held[objective] = float(self.row.of(objective))

    @property
    def found(self) -> IntArray:
        """The best set so far, (n,); `solve_placement` has given up without one."""
        assert self.units is not None
        return self.units

    def left(self, n_failures: int) -> float:
        """APR that the best set keeps when its worst units fail."""
        sets = self.found[None, :]
        measure = self.reduced.measure
        return float(left_after_failures(self.reduced, measure, n_failures, sets)[0])

    @property
    def least_apr(self) -> float:
        """No set that ties with the best one so far has a lower APR."""
        return self.reduced.measure.least_tied(self.value.apr)

    @property
    def least_total_s(self) -> float:
        """No set that ties with the best so far has a smaller sum of margins."""
        reduced = self.reduced
        union = unions_of(reduced, self.found[None, :])
        is_avoided = union_margins_s(reduced, union)[0] > -np.inf
        share = float(reduced.weight @ is_avoided)
        least_s = self.value.mean_margin_s - constants.TIES_OF_TIES * TOLERANCE
        # Others may avoid less where it does not count.
        if not reduced.measure.is_mean:
            share = self.value.apr
        return max(least_s, 0.0) * max(reduced.measure.least_tied(share), 0.0)

    def demand(self, least: float, **how: Any) -> Requirement:
        """A requirement by the problem's own measure."""
        return Requirement(measure=self.reduced.measure, least=least, **how)

    def improved(self, units: IntArray) -> IntArray:
        """The best set so far after a set was improved by exchanges."""
        better = improve(self.reduced, units, self.limit, deadline=self.deadline)
        self.keep(better)
        return self.found

    def _ties_where_held(self, row: SetValues) -> bool:
        """True if a set is no more than a tie worse in the stages that are settled.

        Ties add up otherwise, from set to set.
        """
        return all(
            objective.excess(value, float(row.of(objective))) <= objective.tolerance
            for objective, value in self._held.items()
            if objective in self.reduced.objectives
        )

    def offer(self, units: IntArray) -> None:
        """Take a set after completing and improving it, if it is better then."""
        if not is_allowed(self.reduced.limits, units):
            return
        self.keep(units)
        self.keep(improve(self.reduced, units, self.limit, deadline=self.deadline))
        extended = extend_greedily(self.reduced, units)
        if len(extended) > len(units) and is_allowed(self.reduced.limits, extended):
            self.keep(
                improve(self.reduced, extended, self.limit, deadline=self.deadline)
            )

    def look_for(
        self,
        objective: Objective | None,
        requirements: Sequence[Requirement],
        reduced: ReducedProblem | None = None,
    ) -> float:
        """Look for the best set that meets requirements and floors, by models.

        A set that is better than the incumbent is kept.

        Parameters
        ----------
        objective : Objective, optional
            What is best; None: any set will do.
        requirements : sequence of Requirement
            What must be reached, besides the floors.
        reduced : ReducedProblem, optional
            Another problem on the same poses: its sets are not kept.

        Returns
        -------
        bound : float
            No set that meets the requirements has a better objective; the worst
            infinity if there is none, the best one if nothing is known.
        """
        problem = reduced
        if problem is None:
            problem = self.reduced
        demands = (*problem.floors, *requirements)
        is_minimised = objective is not None and objective.is_minimised
        worst = -np.inf
        if is_minimised:
            worst = np.inf
        bound = -worst
        cuts: list[Cut] | None = None
        n_cells = problem.n_poses * problem.n_frames
        fits = n_cells <= constants.MAX_CELLS
        while self.is_exact and fits and not self.deadline.is_over:
            # Would it take longer than there is to state the model?
            if n_cells > self.deadline.left_s() * constants.CELLS_PER_SECOND:
                break
            self.proofs[solver_text()] = None
            # Finding the first ones takes long, too.
            if cuts is None:
                cuts = []
                for demand in demands:
                    cuts += self._cuts_of(problem, demand)
            result = solve_window_model(
                problem,
                objective,
                requirements=demands,
                cuts=cuts,
                time_limit_s=self.deadline.left_s(),
            )
            if result.units is None and result.is_finished:
                return worst
            if is_minimised:
                bound = max(bound, result.bound)
            else:
                bound = min(bound, result.bound)
            if result.units is None:
                break
            # Cuts that the set violates; if there is none, it meets all demands.
            n_before = len(cuts)
            for demand in demands:
                new = violated_cuts(problem, result.units, demand)
                self._cuts_of(problem, demand).extend(new)
                cuts += new
            if len(cuts) == n_before:
                if reduced is None:
                    self.offer(result.units)
                break
        return bound

    def _cuts_of(self, problem: ReducedProblem, requirement: Requirement) -> list[Cut]:
        """Cuts that hold for all sets that meet a requirement, to be added to."""
        key = tuple(getattr(requirement, field.name) for field in fields(requirement))
        if key not in self._cuts:
            self._cuts[key] = first_cuts(problem, requirement)
        return self._cuts[key]


class Comparison(StrEnum):
    """How far the sets that may be best have been compared."""

    NOT_TRIED = "not tried"
    # Too many sets, too little time, or none that is allowed.
    IN_VAIN = "in vain"
    # All sets that may be best, or tie with it, are known.
    COMPLETE = "complete"


class AllSets:
    """All sets that may be best, where they are so few that each is valued.

    Attributes
    ----------
    state : Comparison
        How far they have been compared.
    """

    def __init__(self, search: Search, effort: Effort) -> None:
        self.search = search
        self.effort = effort
        self.state = Comparison.NOT_TRIED
        # Sets that may be best, and the problem on which they were valued.
        self._contenders: tuple[ReducedProblem, Contenders] | None = None

    @property
    def are_known(self) -> bool:
        """True if all sets that may be best have been compared."""
        return self.state is Comparison.COMPLETE

    def compare_few(self) -> None:
        """Value all sets one by one, if they are few; once, until limits change."""
        if self.state is not Comparison.NOT_TRIED:
            return
        self.state = Comparison.IN_VAIN
        if not self.effort.is_exact:
            return
        search = self.search
        deadline = search.deadline.of("few sets")
        most = constants.MAX_FEW_SETS
        if search.reduced.limits.budget_eur is not None:
            most = constants.MAX_SETS_OF_MONEY
        most = min(most, int(deadline.left_s() * constants.FEW_SETS_PER_SECOND))
        contenders, is_complete = best_of_few(
            search.reduced, max_sets=most, deadline=deadline
        )
        if contenders is None:
            return
        # The best of those that were valued is taken, whether or not these are all.
        has_any = self._take_best(search.reduced, contenders)
        if is_complete and has_any:
            self.state = Comparison.COMPLETE
            search.proofs[Phrase("exhaustive enumeration")] = None

    def add_all(self, reduced: ReducedProblem, contenders: Contenders) -> None:
        """Take over all sets that may be best, as a walk has met them."""
        self.state = Comparison.IN_VAIN
        if self._take_best(reduced, contenders):
            self.state = Comparison.COMPLETE

    def narrow(self) -> None:
        """Let sets be compared again: limits have become tighter, fewer are left."""
        if not self.are_known:
            self.state = Comparison.NOT_TRIED

    def limit(self, objective: Objective) -> float:
        """What no set exceeds that ties in all stages before; all must be known."""
        assert self._contenders is not None
        reduced, contenders = self._contenders
        values = set_values(reduced, self.search.found[None, :])[0]
        return contenders.limits(values)[objective]

    def _take_best(self, reduced: ReducedProblem, contenders: Contenders) -> bool:
        """Take the best of all sets that were compared; False if there is none."""
        best = contenders.best()
        if best is None:
            return False
        search = self.search
        search.keep(best)
        self._contenders = (reduced, contenders)
        values = search.row
        for objective, limit in contenders.limits(values).items():
            excess = objective.excess(limit, float(values.of(objective)))
            if excess > objective.tolerance:
                # A set that ties so far is better in this stage.
                search.take(best)
                break
        return True


class Walks:
    """Proofs by walks through all sets that may be better.

    Attributes
    ----------
    limit : dict of float by int
        By the failures to be survived: no set exceeds it; infinite where nothing
        is known.
    """

    def __init__(
        self, problem: PlacementProblem, search: Search, all_sets: AllSets
    ) -> None:
        self.problem = problem
        self.search = search
        self.all_sets = all_sets
        self.limit: defaultdict[int, float] = defaultdict(lambda: np.inf)

    def prove(self, n_failures: int) -> bool:
        """Walk through all sets that may be better in a stage; True if proven.

        The stage is the APR when so many units fail; the APR itself is held in a
        later one. Where few sets are best, the best of them all is best in every
        stage that comes.
        """
        search = self.search
        reduced = search.reduced
        if not search.is_exact or search.deadline.is_over:
            return False
        by_pairs = goes_by_pairs(reduced)
        n_forced = int(reduced.limits.is_forced.sum())
        # By pairs, nothing but ties that were met tells of failures.
        if n_failures and (by_pairs or n_forced):
            return False
        tied: Tied | None
        contenders = None
        if not can_walk(reduced):
            find = load_entry("placement.optimiser.site_walk:tied_by_sites")
            tied, contenders = find(search, n_failures, self._find_tied)
            if tied is None:
                return False
        elif by_pairs:
            end = search.deadline.of("worlds")
            tied = walk_by_pairs(
                reduced, search.found, deadline=end, on_better=search.improved
            )
        elif reduced.measure.is_mean:
            tied = self._find_tied(n_failures, reduced, search.root, SetWalk)
        else:
            return False
        search.proofs[Phrase("branch and bound")] = None
        self.limit[n_failures] = tied.limit
        if tied.sets is not None:
            contenders = best_of_tied(
                reduced, tied.sets, n_failures=n_failures, value=tied.value
            )
        if contenders is not None:
            self.all_sets.add_all(reduced, contenders)
        return tied.is_finished

    def _find_tied(
        self,
        n_failures: int,
        reduced: ReducedProblem,
        root: Root,
        walk_of: Callable[..., SomeWalk],
    ) -> Tied:
        """Ties by a walk through the covering problem; the APR may be held already."""
        search = self.search
        held = None
        ahead = 0.0
        if n_failures:
            ahead = constants.NEAR * search.left(n_failures)
            if self.problem.survive:
                held = least_apr(reduced)
            else:
                held = search.least_apr

        def walk_from(need: float, left: float) -> SomeWalk:
            return walk_of(reduced, root, need=need, n_failures=n_failures, left=left)

        def limit(least: float, deadline: Deadline) -> float:
            return failure_limit(root, n_failures, least, deadline=deadline)

        ties = TieSearch(
            reduced,
            search.found,
            walk_from=walk_from,
            limit=limit,
            ahead=ahead,
            n_failures=n_failures,
            least_apr=held,
            on_better=search.improved,
        )
        return ties.find(search.deadline.of("walk"))


class Stages:
    """The stages of a problem: each improves the best set and bounds all others.

    Attributes
    ----------
    held : list of Requirement
        What stages that are settled ask of all sets to come.
    apr_limit : float
        No layout has a higher APR.
    """

    def __init__(
        self, problem: PlacementProblem, search: Search, effort: Effort
    ) -> None:
        self.problem = problem
        self.search = search
        self.effort = effort
        self.all_sets = AllSets(search, effort)
        self.walks = Walks(problem, search, self.all_sets)
        self.held: list[Requirement] = []
        self.apr_limit = search.reduced.measure.limit

    def plan(self) -> list[tuple[Objective, Callable[[], float]]]:
        """The stages in order, and what finds their bounds.

        The order is that of :func:`placement.optimiser.problem.objectives_in_order`:
        what is asked for first, such as few units, then the five of
        ``docs/method.md``. A stage that is settled is held from then on.
        """
        bound_cost = self.bound_cost_eur
        if self.problem.goal == "cheapest":
            bound_cost = self.bound_first_cost_eur
        find_bound = {
            # Only where it is asked for:
            Objective.UNITS: self.bound_units,
            Objective.APR_SURVIVED: self.bound_apr_survived,
            # Always:
            Objective.APR: self.bound_apr,
            Objective.APR_ONE_FAILED: self.bound_apr_one_failed,
            Objective.SMALLEST_MARGIN: self.bound_smallest_margin_s,
            Objective.MEAN_MARGIN: self.bound_mean_margin_s,
            Objective.COST: bound_cost,
        }

        def settled(objective: Objective) -> Callable[[], float]:
            def find() -> float:
                bound = find_bound[objective]()
                self.search.hold(objective)
                return bound

            return find

        return [
            (objective, settled(objective)) for objective in self.problem.objectives
        ]

    # ---------- what may be asked for first: few units, or little money
    def bound_units(self) -> float:
        """Fewest units with which the floors are reached; from here on none has more.

        Few sets, one unit, the walk for ever more units, the model.
        """
        search = self.search
        bound = 1.0
        self.all_sets.compare_few()
        if not self.all_sets.are_known:
            if len(search.found) > 1 and not _one_unit_does(search.reduced):
                bound = 2.0
            find = load_entry("placement.optimiser.least:fewest_units")
            bound = float(find(search, int(bound)))
            if len(search.found) > bound:
                of_model = search.look_for(Objective.UNITS, ())
                bound = max(bound, np.ceil(of_model - constants.SOLVER_TOLERANCE))
        n_units = len(search.found)
        return self._restricted(float(n_units), bound, budget_units=n_units)

    def bound_first_cost_eur(self) -> float:
        """Least cost at which the floors are reached; from here on none costs more.

        Few sets, the cheapest unit, walks behind sets of sites, the model.
        """
        search = self.search
        bound = _cheapest_unit_eur(search.reduced.limits)
        self.all_sets.compare_few()
        if not self.all_sets.are_known:
            find = load_entry("placement.optimiser.least:least_cost_eur")
            bound = max(bound, find(search))
        cost = search.value.cost_eur
        if not self.all_sets.are_known and cost > bound + COST_TOLERANCE_EUR:
            bound = max(bound, search.look_for(Objective.COST, ()))
            cost = search.value.cost_eur
        bound = self._settled_from_below(cost, bound)
        return self._restricted(cost, bound, budget_eur=cost)

    def _restricted(self, value: float, bound: float, **limits: Any) -> float:
        """Bound of a stage whose value limits all sets from here on."""
        self.search.restrict(replace(self.search.reduced.limits, **limits))
        if self.all_sets.are_known:
            return value
        self.all_sets.narrow()
        return min(bound, value)

    # ---------- the APR, of all units and when some fail
    def bound_apr(self) -> float:
        """Upper bound of the APR.

        Few sets, the walk, what a walk that did not end has proven, the relaxation,
        the model: up to the first that settles it.
        """
        search = self.search
        rungs = (
            self._apr_of_few_sets,
            self._apr_of_walk,
            lambda: self.walks.limit[0],
            lambda: self._relaxed(search.reduced, Objective.APR),
            lambda: search.look_for(Objective.APR, self.held),
        )
        for find_bound in rungs:
            apr = search.value.apr
            if self._is_settled(apr, self.apr_limit):
                break
            self.apr_limit = self._settle(apr, find_bound(), self.apr_limit)
        self.held.append(search.demand(search.least_apr))
        return self.apr_limit

    def _apr_of_few_sets(self) -> float:
        """The highest APR of all sets, if they are few; else infinite."""
        self.all_sets.compare_few()
        if self.all_sets.are_known:
            return self.all_sets.limit(Objective.APR)
        return np.inf

    def _apr_of_walk(self) -> float:
        """The APR, if a walk proves that it is the highest; else infinite."""
        if self.walks.prove(0):
            return self.search.value.apr
        return np.inf

    def bound_apr_survived(self) -> float:
        """Upper bound of the APR that a layout keeps when its worst units fail."""
        limit = self.search.reduced.measure.limit
        return self._bound_failed(Objective.APR_SURVIVED, self.problem.survive, limit)

    def bound_apr_one_failed(self) -> float:
        """Upper bound of what layouts that hold the APR keep when one unit fails."""
        if self.search.reduced.limits.max_units == 1:
            return self.search.apr_of_vut
        return self._bound_failed(Objective.APR_ONE_FAILED, 1, self.search.value.apr)

    def _bound_failed(
        self, objective: Objective, n_failures: int, limit: float
    ) -> float:
        """Upper bound of what is left of layouts that hold the stages before.

        Few sets, the walk, what a walk that did not end has proven, else relaxation
        and models.
        """
        search = self.search
        if not self._is_settled(search.left(n_failures), limit):
            self.all_sets.compare_few()
            if self.all_sets.are_known:
                limit = self.all_sets.limit(objective)
            elif self.walks.prove(n_failures):
                limit = search.left(n_failures)
            elif self.walks.limit[n_failures] < limit:
                limit = self.walks.limit[n_failures]
            else:
                limit = self._bound_failed_by_models(n_failures, limit)
        least = search.reduced.measure.least_tied(search.left(n_failures))
        self.held.append(search.demand(least, n_failures=n_failures))
        return limit

    def _bound_failed_by_models(self, n_failures: int, limit: float) -> float:
        """Upper bound of what is left, by relaxation and models; `limit` holds too."""
        search = self.search
        reduced = search.reduced
        n_left = reduced.limits.max_units - n_failures
        if n_left < 1:
            return search.apr_of_vut
        # What is left when units fail is a layout with fewer, bound by no wish.
        fewer = _without_wishes(reduced, n_left)
        bound = self._relaxed(fewer, Objective.APR)
        limit = self._settle(search.left(n_failures), bound, limit)
        if not self._is_settled(search.left(n_failures), limit):
            bound = search.look_for(Objective.APR, (), fewer)
            limit = self._settle(search.left(n_failures), bound, limit)
        # Can all runs be kept? Then no sums of weights are compared.
        all_runs = reduced.measure.limit
        is_open = limit >= all_runs - TOLERANCE > search.left(n_failures)
        if is_open and reduced.measure.is_mean:
            demand = search.demand(all_runs, n_failures=n_failures)
            if search.look_for(None, [*self.held, demand]) == -np.inf:
                limit = all_runs - float(reduced.weight.min())
        # Ask for a little more than the best set keeps, until there is no such set.
        while search.left(n_failures) < limit - TOLERANCE:
            before = search.left(n_failures)
            demand = search.demand(before + constants.STEP_UP, n_failures=n_failures)
            if search.look_for(None, [*self.held, demand]) == -np.inf:
                return before
            if search.left(n_failures) <= before + TOLERANCE:
                # Time is up.
                return limit
        return limit

    # ---------- margins
    def bound_smallest_margin_s(self) -> float:
        """Upper bound of the smallest margin of layouts that hold the stages before.

        What all poses together reach, few sets, models for one margin after the
        other. [s]
        """
        search = self.search
        limit = self._smallest_margin_limit_s()
        if not self._is_settled(search.value.smallest_margin_s, limit):
            limit = self._largest_margin_s(limit)
        least_s = search.value.smallest_margin_s - TOLERANCE
        self.held.append(search.demand(search.least_apr, min_margin_s=least_s))
        return limit

    def _smallest_margin_limit_s(self) -> float:
        """Smallest margin of the fewest runs that an APR needs, as all poses leave."""
        search = self.search
        if self._avoids_nothing():
            return 0.0
        order = np.argsort(-search.margin_limit_s)
        share = np.cumsum(search.reduced.weight[order])
        enough = np.argmax(share >= search.least_apr - TOLERANCE)
        return float(search.margin_limit_s[order[enough]])

    def _largest_margin_s(self, limit: float) -> float:
        """The largest margin that is not proven to be out of reach, by halving."""
        search = self.search
        self.all_sets.compare_few()
        if self.all_sets.are_known:
            return self.all_sets.limit(Objective.SMALLEST_MARGIN)
        margins = search.reduced.margin_s
        candidates = np.unique(margins[margins <= limit + TOLERANCE])

        def n_reached() -> int:
            reached_s = search.value.smallest_margin_s + TOLERANCE
            return int(np.searchsorted(candidates, reached_s))

        # Candidates before `low` are reached, those from `high` on are not.
        low = n_reached()
        high = len(candidates)
        probe = low
        while low < high:
            asked_s = float(candidates[probe])
            demand = search.demand(search.least_apr, min_margin_s=asked_s)
            if search.look_for(None, [*self.held, demand]) == -np.inf:
                high = probe
            elif search.value.smallest_margin_s >= candidates[probe] - TOLERANCE:
                low = n_reached()
            else:
                # Time is up.
                break
            probe = (low + high) // 2
        if low < high:
            return float(candidates[high - 1])
        return search.value.smallest_margin_s

    def bound_mean_margin_s(self) -> float:
        """Upper bound of the mean margin of layouts that hold the stages before.

        What all poses together reach, few sets, the relaxation, the model. [s]
        """
        search = self.search
        if self._avoids_nothing():
            return 0.0
        limit = search.mean_margin_limit_s(search.value.apr)
        if self._is_settled(search.value.mean_margin_s, limit):
            return limit
        self.all_sets.compare_few()
        if self.all_sets.are_known:
            return self.all_sets.limit(Objective.MEAN_MARGIN)
        least_apr = search.least_apr
        # What is avoided at least is not known then: sums bound no mean.
        if least_apr <= 0.0:
            return limit
        total_s = self._relaxed(search.reduced, Objective.MEAN_MARGIN)
        limit = min(limit, total_s / least_apr)
        if self._is_settled(search.value.mean_margin_s, limit):
            return limit
        bound = search.look_for(Objective.MEAN_MARGIN, self.held)
        return settle(search.value.mean_margin_s, bound / least_apr, limit)

    def _avoids_nothing(self) -> bool:
        """True if no layout that holds the stages before avoids anything, proven.

        Where only the worst worlds count, an APR of 0 does not say so: others may
        avoid something.
        """
        reduced = self.search.reduced
        is_none = reduced.measure.tells_runs_apart and self.apr_limit == 0.0
        return is_none or not len(reduced.weight)

    # ---------- cost
    def bound_cost_eur(self) -> float:
        """Lower bound of the cost of layouts that hold the stages before.

        The cheapest unit, few sets, the model. [EUR]
        """
        search = self.search
        cost = search.value.cost_eur
        least = _cheapest_unit_eur(search.reduced.limits)
        if cost <= least + COST_TOLERANCE_EUR:
            return cost
        self.all_sets.compare_few()
        if self.all_sets.are_known:
            return self.all_sets.limit(Objective.COST)
        mean = search.demand(search.least_total_s, sums_margins=True)
        bound = search.look_for(Objective.COST, [*self.held, mean])
        return max(least, self._settled_from_below(search.value.cost_eur, bound))

    # ---------- what stages have in common
    def _relaxed(self, reduced: ReducedProblem, worth: Objective) -> float:
        """Upper bound of all sets by relaxation; infinite where that is not asked.

        The mean over the worst worlds is no higher than that over all.
        """
        search = self.search
        if self.effort.solver == "greedy" or search.deadline.is_over:
            return np.inf
        limit, share = relax(reduced, worth, deadline=search.deadline.of("relaxation"))
        search.proofs[relaxation_text()] = None
        # Shares of poses near the relaxed solution are chances to draw them by.
        if share is not None and reduced is search.reduced and worth is Objective.APR:
            search.start([search.found], chance=share)
        return limit

    def _is_settled(self, value: float, limit: float) -> bool:
        """True if a value is proven as well as the effort asks for."""
        return limit - value <= max(TOLERANCE, self.effort.gap * abs(value))

    def _settle(self, apr: float, bound: float, limit: float) -> float:
        """Upper bound of an APR from what a solver says; `limit` holds without it."""
        return settle(apr, bound, limit, step=self.search.reduced.measure.step)

    def _settled_from_below(self, cost: float, bound: float) -> float:
        """Lower bound of a cost; the solver's own has an error."""
        error = constants.SOLVER_TOLERANCE * max(1.0, cost)
        step = price_step_eur(self.search.reduced.limits)
        if bound >= cost - max(COST_TOLERANCE_EUR, step - error):
            return cost
        return bound


def _without_wishes(reduced: ReducedProblem, n_units: int) -> ReducedProblem:
    """The problem for so many units, with no floors and nothing forced."""
    limits = reduced.limits
    limits = replace(
        limits,
        budget_units=n_units,
        is_forced=np.zeros_like(limits.is_forced),
        is_forced_site=np.zeros_like(limits.is_forced_site),
    )
    return replace(reduced, floors=(), limits=limits)


def _cheapest_unit_eur(limits: Limits) -> float:
    """Price of the cheapest unit with its site; 0 if there is none; in euros."""
    if not limits.n_poses:
        return 0.0
    price = limits.unit_cost_eur + limits.site_cost_eur[limits.site_index]
    return float(price.min())


def _one_unit_does(reduced: ReducedProblem) -> bool:
    """True if a single pose reaches the floors."""
    sets = np.arange(reduced.n_poses)[:, None]
    sets = sets[are_allowed(reduced.limits, sets)]
    if not len(sets):
        return False
    lacking = set_values(reduced, sets).lacking
    return bool((lacking == 0.0).any())
