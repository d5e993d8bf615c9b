"""The objectives one by one: better sets, and how much better one could be, rung by rung."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from geometry.arrays import FloatArray, IntArray

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
    Tied,
    TieSearch,
    best_of_few,
    best_of_tied,
    can_walk,
    find_of_size,
    least_apr,
)


class Search:
    """The incumbent, the best set of poses so far, and what the proofs rest on."""

    def __init__(
        self,
        reduced: ReducedProblem,
        *,
        deadline: Deadline = NEVER,
        is_exact: bool = True,
    ) -> None:
        self.reduced = reduced
        self.deadline = deadline
        self.is_exact = is_exact  # whether walks and models may be used
        self.proofs: dict[str, None] = {}
        everything = np.bitwise_or.reduce(reduced.words, axis=0, keepdims=True)
        self.margin_limit_s: FloatArray = union_margins_s(reduced, everything)[0]
        self.apr_of_vut = float(
            union_apr(reduced, reduced.base[None, :])[0]
        )  # all units failed
        self.units: IntArray | None = None
        self.nothing_meets_all = False  # proven that no set meets limits and floors
        nothing = np.full(1 + len(reduced.objectives), -np.inf)
        self.row = SetValues(reduced.objectives, nothing)
        self._held: dict[Objective, float] = {}  # values in stages that are settled
        self._cuts: dict[tuple[object, ...], list[Cut]] = {}
        self._root: Root | None = None

    @property
    def root(self) -> Root:
        """Prices on runs for sets of as many units as allowed."""
        if self._root is None:
            reduced, n_units = self.reduced, self.reduced.limits.max_units
            self._root = find_root(
                reduced, run_rows(reduced), n_units=n_units, deadline=self.deadline
            )
        return self._root

    @property
    def value(self) -> PlacementValue:
        """Value of the best set."""
        return PlacementValue(
            *(float(self.row.of(objective)) for objective in VALUE_OBJECTIVES)
        )

    @property
    def shortfall(self) -> float:
        """Sum of what the incumbent lacks to the floors."""
        return float(self.row.lacking)  # infinite where there is no set

    @property
    def limit(self) -> SetValues:
        """Upper bound of all sets: the values of all poses together."""
        reduced = self.reduced
        largest: dict[Objective, float] = {}
        if len(reduced.weight):
            all_runs = reduced.measure.limit
            most = reduced.limits.max_units
            margin_s = self.margin_limit_s
            largest = {
                Objective.APR_SURVIVED: (
                    all_runs if most > reduced.survive else self.apr_of_vut
                ),
                Objective.APR: all_runs,
                Objective.APR_ONE_FAILED: all_runs if most > 1 else self.apr_of_vut,
                Objective.SMALLEST_MARGIN: float(margin_s.min()),
                Objective.MEAN_MARGIN: float(
                    np.average(margin_s, weights=reduced.weight)
                ),
            }
        gains = [largest.get(objective, 0.0) for objective in reduced.objectives]
        return SetValues(reduced.objectives, np.array([0.0, *gains]))

    def mean_margin_limit_s(self, apr: float) -> float:
        """No set of an APR has a larger mean margin: no more seconds are there to share out."""
        largest_s = float(self.margin_limit_s.max(initial=0.0))
        total_s = float(self.reduced.weight @ np.maximum(self.margin_limit_s, 0.0))
        least = self.reduced.measure.least_tied(apr)
        if least > 0.0:
            return min(largest_s, total_s / least)
        return largest_s

    def start(
        self, starts: Sequence[IntArray] = (), *, chance: FloatArray | None = None
    ) -> None:
        """Find a good set, from some to begin with; there may be none that reaches the floors.

        Others are drawn by a `chance`, (n_poses,), such as their shares in a relaxed
        solution.
        """
        for start in starts:
            if is_allowed(self.reduced.limits, start):
                self.keep(start)
        uses_root = can_walk(self.reduced) and not goes_by_pairs(self.reduced)
        if uses_root:
            shares = lambda: self.root.share
        else:
            shares = None
        if chance is None:
            chances = shares
        else:
            chances = lambda: chance
        end = self.deadline.of("first set")
        units = search_from_many_starts(
            self.reduced, self.limit, starts=starts, chance=chances, deadline=end
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
        """Look for the best set that meets requirements and the floors; keep it if it is better.

        Without an objective, any set that meets them. Sets of another problem on the
        same poses, `reduced`, are not kept. Returns a bound: no set that meets the
        requirements has a better objective; the worst infinity if there is none, the
        best one if nothing is known.
        """
        if reduced is None:
            problem = self.reduced
        else:
            problem = reduced
        demands = (*problem.floors, *requirements)
        is_minimised = objective is not None and objective.is_minimised
        if is_minimised:
            bound = -np.inf
        else:
            bound = np.inf
        cuts: list[Cut] | None = None
        n_cells = problem.n_poses * problem.n_frames
        fits = n_cells <= constants.MAX_CELLS
        while self.is_exact and fits and not self.deadline.is_over:
            left_s = self.deadline.left_s()
            if (
                n_cells > left_s * constants.CELLS_PER_SECOND
            ):  # the model would take longer to be stated
                break
            self.proofs[solver_text()] = None
            if cuts is None:  # finding the first ones takes long, too
                cuts = [
                    cut for demand in demands for cut in self._cuts_of(problem, demand)
                ]
                left_s = self.deadline.left_s()
            result = solve_window_model(
                problem, objective, requirements=demands, cuts=cuts, time_limit_s=left_s
            )
            if result.units is None and result.is_finished:
                if is_minimised:
                    return np.inf
                return -np.inf
            if is_minimised:
                better = max
            else:
                better = min
            bound = better(bound, result.bound)
            if result.units is None:
                break
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


class Stages:
    """A method per stage that improves the best set, and says how much better one could be."""

    def __init__(
        self, problem: PlacementProblem, search: Search, effort: Effort
    ) -> None:
        self.problem = problem
        self.search = search
        self.effort = effort
        self.held: list[Requirement] = []
        self.apr_limit = search.reduced.measure.limit
        self.is_complete: bool | None = None  # not tried yet
        # Where it is complete: all sets that may be best or tie, valued on a problem.
        self.contenders: tuple[ReducedProblem, Contenders] | None = None
        # By the failures to be survived: no set exceeds it; infinite where nothing is
        # known.
        self.walk_limit: defaultdict[int, float] = defaultdict(lambda: np.inf)

    def plan(self) -> list[tuple[Objective, Callable[[], float]]]:
        """The stages in order, and what finds their bounds."""
        is_cheapest = self.problem.goal == "cheapest"
        find_bound = {
            Objective.UNITS: self.bound_units,
            Objective.COST: (
                self.bound_first_cost_eur if is_cheapest else self.bound_cost_eur
            ),
            Objective.APR_SURVIVED: self.bound_apr_survived,
            Objective.APR: self.bound_apr,
            Objective.APR_ONE_FAILED: self.bound_apr_one_failed,
            Objective.SMALLEST_MARGIN: self.bound_smallest_margin_s,
            Objective.MEAN_MARGIN: self.bound_mean_margin_s,
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

    def bound_units(self) -> float:
        """No layout that reaches the floors has fewer units; from here on none has more."""
        search = self.search
        bound = 1.0
        if not self._is_complete():
            n_units = len(self._units())
            if n_units > 1 and not self._one_unit_does():
                bound = 2.0
            bound = float(self._fewest_by_walks(int(bound)))
            if len(self._units()) > bound:
                found = (
                    search.look_for(Objective.UNITS, ()) - constants.SOLVER_TOLERANCE
                )
                bound = max(bound, np.ceil(found))
        n_units = len(self._units())
        return self._restricted(float(n_units), bound, budget_units=n_units)

    def _fewest_by_walks(self, fewest: int) -> int:
        """No layout that reaches the floors has fewer units; `fewest` is such a bound.

        All sets of ever more units are walked through, until some reach the floors,
        which is the best set then, or the time is up.
        """
        search = self.search
        reduced = search.reduced
        if not (search.is_exact and reduced.floors and len(reduced.weight)):
            return fewest
        deadline = search.deadline.of("walk")
        fewest = max(fewest, int(reduced.limits.is_forced.sum()))
        most = min(len(self._units()) - 1, constants.MAX_WALK_UNITS)
        while fewest <= most and not deadline.is_over:
            search.proofs["branch and bound"] = None
            units, is_finished = find_of_size(reduced, fewest, deadline=deadline)
            if units is not None:
                search.keep(units)
                break
            if not is_finished:
                break
            fewest += 1
        return fewest

    def bound_first_cost_eur(self) -> float:
        """No layout that reaches the floors costs less; from here on none costs more."""
        search = self.search
        bound = self._cheapest_unit_eur()
        if (
            not self._is_complete()
            and search.value.cost_eur > bound + COST_TOLERANCE_EUR
        ):
            bound = max(bound, search.look_for(Objective.COST, ()))
        cost = search.value.cost_eur
        return self._restricted(
            cost, self._settled_from_below(cost, bound), budget_eur=cost
        )

    def _restricted(self, value: float, bound: float, **limits: Any) -> float:
        """Bound of a stage whose value limits all sets from here on."""
        self.search.restrict(replace(self.search.reduced.limits, **limits))
        if self.is_complete:
            return value
        self.is_complete = None  # fewer sets are left now
        return min(bound, value)

    def bound_apr_survived(self) -> float:
        """No layout keeps a higher APR when its worst units fail."""
        limit = self.search.reduced.measure.limit
        return self._bound_failed(Objective.APR_SURVIVED, self.problem.survive, limit)

    def bound_apr(self) -> float:
        """No layout has a higher APR."""
        search = self.search
        rungs: list[Callable[[], float]] = [
            lambda: (
                self._complete_limit(Objective.APR) if self._is_complete() else np.inf
            ),
            lambda: search.value.apr if self._walk(0) else np.inf,
            lambda: self.walk_limit[0],
            lambda: self._relaxed(search.reduced, Objective.APR),
            lambda: search.look_for(Objective.APR, self.held),
        ]
        for bound in rungs:
            if self._is_settled(search.value.apr, self.apr_limit):
                break
            self.apr_limit = self._settle(search.value.apr, bound(), self.apr_limit)
        self.held.append(self._demand(self._least_apr()))
        return self.apr_limit

    def bound_apr_one_failed(self) -> float:
        """No layout that holds the APR keeps a higher one when one unit fails."""
        if self.search.reduced.limits.max_units == 1:
            return self.search.apr_of_vut
        return self._bound_failed(Objective.APR_ONE_FAILED, 1, self.search.value.apr)

    def bound_smallest_margin_s(self) -> float:
        """No layout that holds the stages before has a larger smallest margin."""
        search = self.search
        limit = self._smallest_margin_limit_s()
        if not self._is_settled(search.value.smallest_margin_s, limit):
            limit = self._largest_margin_s(limit)
        least_s = search.value.smallest_margin_s - TOLERANCE
        self.held.append(self._demand(self._least_apr(), min_margin_s=least_s))
        return limit

    def _largest_margin_s(self, limit: float) -> float:
        """By halving: the largest margin at which it is not proven that no layout has it."""
        search = self.search
        if self._is_complete():
            return self._complete_limit(Objective.SMALLEST_MARGIN)
        margins = search.reduced.margin_s
        candidates = np.unique(margins[margins <= limit + TOLERANCE])
        low = int(
            np.searchsorted(candidates, search.value.smallest_margin_s + TOLERANCE)
        )
        high = len(candidates)
        probe = low
        while low < high:
            demand = self._demand(
                self._least_apr(), min_margin_s=float(candidates[probe])
            )
            if search.look_for(None, [*self.held, demand]) == -np.inf:
                high = probe
            elif search.value.smallest_margin_s >= candidates[probe] - TOLERANCE:
                low = int(
                    np.searchsorted(
                        candidates, search.value.smallest_margin_s + TOLERANCE
                    )
                )
            else:
                break  # time is up
            probe = (low + high) // 2
        if low < high:
            return float(candidates[high - 1])
        return search.value.smallest_margin_s

    def bound_mean_margin_s(self) -> float:
        """No layout that holds the stages before has a larger mean margin."""
        search = self.search
        if self._avoids_nothing():
            return 0.0
        limit = search.mean_margin_limit_s(search.value.apr)
        if self._is_settled(search.value.mean_margin_s, limit):
            return limit
        if self._is_complete():
            return self._complete_limit(Objective.MEAN_MARGIN)
        least_apr = self._least_apr()
        if (
            least_apr <= 0.0
        ):  # what is avoided at least is not known: sums bound no mean
            return limit
        total_s = self._relaxed(search.reduced, Objective.MEAN_MARGIN)
        limit = min(limit, total_s / least_apr)
        if self._is_settled(search.value.mean_margin_s, limit):
            return limit
        bound = search.look_for(Objective.MEAN_MARGIN, self.held)
        return settle(search.value.mean_margin_s, bound / least_apr, limit)

    def bound_cost_eur(self) -> float:
        """No layout that holds the stages before costs less."""
        search = self.search
        cost = search.value.cost_eur
        least = self._cheapest_unit_eur()
        if cost <= least + COST_TOLERANCE_EUR:
            return cost
        if self._is_complete():
            return self._complete_limit(Objective.COST)
        total_s = self._least_total_s()
        mean = self._demand(total_s, sums_margins=True)
        bound = search.look_for(Objective.COST, [*self.held, mean])
        return max(least, self._settled_from_below(search.value.cost_eur, bound))

    def _relaxed(self, reduced: ReducedProblem, worth: Objective) -> float:
        """Upper bound of all sets by relaxation; infinite where that is not asked.

        The mean over the worst worlds is no higher than that over all.
        """
        if self.effort.solver == "greedy" or self.search.deadline.is_over:
            return np.inf
        search = self.search
        limit, share = relax(reduced, worth, deadline=search.deadline.of("relaxation"))
        search.proofs[relaxation_text()] = None
        if share is not None and reduced is search.reduced and worth is Objective.APR:
            search.start([self._units()], chance=share)
        return limit

    def _bound_failed(
        self, objective: Objective, n_failures: int, limit: float
    ) -> float:
        """No layout that holds the stages before keeps a higher APR when its worst units fail."""
        value = self._left(n_failures)
        if not self._is_settled(value, limit):
            if self._is_complete():
                limit = self._complete_limit(objective)
            elif self._walk(n_failures):
                limit = self._left(n_failures)
            elif self.walk_limit[n_failures] < limit:
                limit = self.walk_limit[n_failures]
            else:
                limit = self._bound_failed_by_models(n_failures, limit)
        least = self.search.reduced.measure.least_tied(self._left(n_failures))
        self.held.append(self._demand(least, n_failures=n_failures))
        return limit

    def _bound_failed_by_models(self, n_failures: int, limit: float) -> float:
        search = self.search
        reduced = search.reduced
        n_left = reduced.limits.max_units - n_failures
        if n_left < 1:
            return search.apr_of_vut
        # What is left when units fail is a layout with fewer, bound by no wish.
        names = "is_forced", "is_forced_site"
        none = {name: np.zeros_like(getattr(reduced.limits, name)) for name in names}
        limits = replace(reduced.limits, budget_units=n_left, **none)
        fewer = replace(reduced, floors=(), limits=limits)
        bound = self._relaxed(fewer, Objective.APR)
        limit = self._settle(self._left(n_failures), bound, limit)
        if not self._is_settled(self._left(n_failures), limit):
            bound = search.look_for(Objective.APR, (), fewer)
            limit = self._settle(self._left(n_failures), bound, limit)
        all_runs = reduced.measure.limit
        if (
            limit >= all_runs - TOLERANCE > self._left(n_failures)
            and reduced.measure.is_mean
        ):
            demand = self._demand(all_runs, n_failures=n_failures)
            if search.look_for(None, [*self.held, demand]) == -np.inf:
                limit = all_runs - float(reduced.weight.min())
        while self._left(n_failures) < limit - TOLERANCE:
            before = self._left(n_failures)
            demand = self._demand(before + constants.STEP_UP, n_failures=n_failures)
            if search.look_for(None, [*self.held, demand]) == -np.inf:
                return before
            if self._left(n_failures) <= before + TOLERANCE:
                return limit  # time is up
        return limit

    def _left(self, n_failures: int) -> float:
        reduced = self.search.reduced
        sets = self._units()[None, :]
        return float(left_after_failures(reduced, reduced.measure, n_failures, sets)[0])

    def _units(self) -> IntArray:
        units = self.search.units
        assert (
            units is not None
        )  # a first set is there, or solve_placement has given up
        return units

    def _demand(self, least: float, **how: Any) -> Requirement:
        return Requirement(measure=self.search.reduced.measure, least=least, **how)

    def _is_settled(self, value: float, limit: float) -> bool:
        return limit - value <= max(TOLERANCE, self.effort.gap * abs(value))

    def _settle(self, apr: float, bound: float, limit: float) -> float:
        return settle(apr, bound, limit, step=self.search.reduced.measure.step)

    def _settled_from_below(self, cost: float, bound: float) -> float:
        """Lower bound of a cost; the solver's own has an error."""
        error = constants.SOLVER_TOLERANCE * max(1.0, cost)
        step = price_step_eur(self.search.reduced.limits)
        if bound >= cost - max(COST_TOLERANCE_EUR, step - error):
            return cost
        return bound

    def _smallest_margin_limit_s(self) -> float:
        search = self.search
        if self._avoids_nothing():
            return 0.0
        order = np.argsort(-search.margin_limit_s)
        share = np.cumsum(search.reduced.weight[order])
        enough = np.argmax(share >= self._least_apr() - TOLERANCE)
        return float(search.margin_limit_s[order[enough]])

    def _least_apr(self) -> float:
        """No set that ties with the best one so far has a lower APR."""
        return self.search.reduced.measure.least_tied(self.search.value.apr)

    def _least_total_s(self) -> float:
        """No set that ties with the best one so far has a smaller sum of margins."""
        reduced = self.search.reduced
        union = unions_of(reduced, self._units()[None, :])
        is_avoided = union_margins_s(reduced, union)[0] > -np.inf
        share = float(reduced.weight @ is_avoided)
        least_s = self.search.value.mean_margin_s - constants.TIES_OF_TIES * TOLERANCE
        if not reduced.measure.is_mean:  # others may avoid less where it does not count
            share = self.search.value.apr
        return max(least_s, 0.0) * max(reduced.measure.least_tied(share), 0.0)

    def _complete_limit(self, objective: Objective) -> float:
        """What no set exceeds that ties in all stages before, where all were compared."""
        assert self.contenders is not None
        reduced, contenders = self.contenders
        values = set_values(reduced, self._units()[None, :])[0]
        return contenders.limits(values)[objective]

    def _compared(self, reduced: ReducedProblem, contenders: Contenders) -> bool:
        """Take the best of all sets that were compared; False if there is none."""
        best = contenders.best()
        if best is None:
            return False
        search = self.search
        search.keep(best)
        self.contenders = reduced, contenders
        values = search.row
        limits = contenders.limits(values)
        if any(
            one.excess(limit, float(values.of(one))) > one.tolerance
            for one, limit in limits.items()
        ):
            search.take(best)
        return True

    def _avoids_nothing(self) -> bool:
        """True if it is proven that no layout that holds the stages before avoids anything.

        Where only the worst worlds count, an APR of 0 does not say so: others may avoid
        something.
        """
        reduced = self.search.reduced
        is_none = reduced.measure.tells_runs_apart and self.apr_limit == 0.0
        return is_none or not len(reduced.weight)

    def _cheapest_unit_eur(self) -> float:
        limits = self.search.reduced.limits
        if not limits.n_poses:
            return 0.0
        return float(
            (limits.unit_cost_eur + limits.site_cost_eur[limits.site_index]).min()
        )

    def _one_unit_does(self) -> bool:
        """True if a single pose reaches the floors."""
        reduced = self.search.reduced
        sets = np.arange(reduced.n_poses)[:, None]
        sets = sets[are_allowed(reduced.limits, sets)]
        return bool(len(sets)) and bool(
            (set_values(reduced, sets).lacking == 0.0).any()
        )

    def _is_complete(self) -> bool:
        """Go through all sets, if they are few; whether that was done."""
        search = self.search
        if self.is_complete is None:
            self.is_complete = False
            if self.effort.is_exact:
                deadline = search.deadline.of("few sets")
                has_money = search.reduced.limits.budget_eur is not None
                if has_money:
                    most = constants.MAX_SETS_OF_MONEY
                else:
                    most = constants.MAX_FEW_SETS
                most = min(most, int(deadline.left_s() * constants.FEW_SETS_PER_SECOND))
                contenders, is_complete = best_of_few(
                    search.reduced, max_sets=most, deadline=deadline
                )
                has_any = contenders is not None and self._compared(
                    search.reduced, contenders
                )
                self.is_complete = is_complete and has_any
            if self.is_complete:
                search.proofs["exhaustive enumeration"] = None
        return self.is_complete

    def _walk(self, n_failures: int) -> bool:
        """Walk through all sets that may be better in a stage; whether that was done.

        The stage is the APR when so many units fail; the APR itself is held in a later
        one. Where few sets are best, the best of them all is best in every stage that
        comes.
        """
        search = self.search
        reduced = search.reduced
        n_forced = int(reduced.limits.is_forced.sum())
        if not can_walk(reduced) or not search.is_exact or search.deadline.is_over:
            return False
        by_pairs = goes_by_pairs(reduced)
        # By pairs, nothing but ties that were met tells of failures.
        if n_failures and (by_pairs or n_forced):
            return False
        if by_pairs:
            end = search.deadline.of("worlds")
            tied = walk_by_pairs(
                reduced, self._units(), deadline=end, on_better=self._improved
            )
        elif reduced.measure.is_mean:
            tied = self._find_tied(n_failures)
        else:
            return False
        search.proofs["branch and bound"] = None
        self.walk_limit[n_failures] = tied.limit
        if tied.sets is not None:
            contenders = best_of_tied(
                reduced, tied.sets, n_failures=n_failures, value=tied.value
            )
            self.is_complete = self._compared(reduced, contenders)
        return tied.is_finished

    def _find_tied(self, n_failures: int) -> Tied:
        """Ties by a walk through the covering problem; the APR itself may be held already."""
        search = self.search
        reduced = search.reduced
        root = search.root
        held = None
        if n_failures:
            if self.problem.survive:
                held = least_apr(reduced)
            else:
                held = self._least_apr()

        def walk_from(need: float, left: float) -> SetWalk:
            return SetWalk(reduced, root, need=need, n_failures=n_failures, left=left)

        return TieSearch(
            reduced,
            self._units(),
            walk_from=walk_from,
            limit=lambda least, deadline: failure_limit(
                root, n_failures, least, deadline=deadline
            ),
            ahead=constants.NEAR * self._left(n_failures) if n_failures else 0.0,
            n_failures=n_failures,
            least_apr=held,
            on_better=self._improved,
        ).find(search.deadline.of("walk"))

    def _improved(self, units: IntArray) -> IntArray:
        """The best set so far after a set that may be better was improved by exchanges."""
        search = self.search
        search.keep(
            improve(search.reduced, units, search.limit, deadline=search.deadline)
        )
        return self._units()
