"""The objectives one by one: better sets, and how much better one could be."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from geometry.arrays import IntArray
from geometry.clock import now_s

from .bitsets import left_after_failures, set_values
from .enumeration import best_of_all, best_of_few
from .limits import are_allowed, price_step_eur
from .model import Effort
from .objectives import Objective
from .presolve import ReducedProblem
from .problem import PlacementProblem, Requirement
from .promises import best_beyond, can_cover, can_enumerate, cover_windows, relaxed_limit
from .relaxation import relaxation_text
from .search import Search
from .tolerances import COST_TOLERANCE_EUR, SOLVER_TOLERANCE, TOLERANCE, settle

_COVER_SHARE = 0.5  # of the time left
_WALK_SHARE = 0.6  # of the time left
_PAIRS_SHARE = 0.9
_SETS_PER_SECOND = 30_000  # enumeration; measured: two to three times as many
_MAX_FEW_SETS = 60_000  # of all sizes, when every one is valued in full
_SETS_KEPT_PER_SECOND = 200_000  # that lose too much; measured: twice as many
_MAX_SETS = 400_000  # beyond, models are quicker


class Stages:
    """A method per stage that improves the best set, and says how much better one could be."""

    def __init__(self, problem: PlacementProblem, search: Search, effort: Effort) -> None:
        self.problem = problem
        self.search = search
        self.effort = effort
        self.held: list[Requirement] = []
        self.apr_limit = search.reduced.measure.limit
        self.is_complete: bool | None = None  # not tried yet
        self.has_enumerated: bool | None = None
        # By the failures to be survived: no set exceeds it; infinite where nothing is known.
        self.walk_limit: defaultdict[int, float] = defaultdict(lambda: np.inf)

    def plan(self) -> list[tuple[Objective, Callable[[], float]]]:
        """The stages in order, and what finds their bounds."""
        is_cheapest = self.problem.goal == "cheapest"
        find_bound = {
            Objective.UNITS: self.bound_units,
            Objective.COST: self.bound_first_cost_eur if is_cheapest else self.bound_cost_eur,
            Objective.APR_SURVIVED: self.bound_apr_survived,
            Objective.APR: self.bound_apr,
            Objective.APR_ONE_FAILED: self.bound_apr_one_failed,
            Objective.SMALLEST_MARGIN: self.bound_smallest_margin_s,
            Objective.MEAN_MARGIN: self.bound_mean_margin_s,
        }
        return [(objective, find_bound[objective]) for objective in self.problem.objectives]

    def bound_units(self) -> float:
        """No layout that reaches the floors has fewer units; from here on none has more."""
        search = self.search
        bound = 1.0
        if not self._is_complete():
            n_units = len(self._units())
            if n_units > 1 and not self._one_unit_does():
                bound = 2.0
            if n_units > bound:
                bound = max(bound, np.ceil(search.look_for(Objective.UNITS, ()) - SOLVER_TOLERANCE))
        n_units = len(self._units())
        search.restrict(replace(search.reduced.limits, budget_units=n_units))
        if self.is_complete:
            return float(n_units)
        self.is_complete = None  # fewer sets are left now
        return min(bound, float(n_units))

    def bound_first_cost_eur(self) -> float:
        """No layout that reaches the floors costs less; from here on none costs more."""
        search = self.search
        bound = self._cheapest_unit_eur()
        if not self._is_complete() and search.value.cost_eur > bound + COST_TOLERANCE_EUR:
            bound = max(bound, search.look_for(Objective.COST, ()))
        cost = search.value.cost_eur
        search.restrict(replace(search.reduced.limits, budget_eur=cost))
        if self.is_complete:
            return cost
        self.is_complete = None  # fewer sets are left now
        return min(self._settled_from_below(cost, bound), cost)

    def bound_apr_survived(self) -> float:
        """No layout keeps a higher APR when its worst units fail."""
        return self._bound_failed(self.problem.survive, self.search.reduced.measure.limit)

    def bound_apr(self) -> float:
        """No layout has a higher APR."""
        search = self.search
        if not self._is_settled(search.value.apr, self.apr_limit):
            if (
                self._is_complete()
                or self._walk(0)
                or self._beats_all_promises(Objective.APR, search.value.apr)
            ):
                self.apr_limit = search.value.apr
            else:
                limit = min(self.apr_limit, self.walk_limit[0])
                self.apr_limit = self._settle(search.value.apr, limit, self.apr_limit)
                promised = self._promised(Objective.APR)
                self.apr_limit = self._settle(search.value.apr, promised, self.apr_limit)
                if not self._is_settled(search.value.apr, self.apr_limit):
                    bound = search.look_for(Objective.APR, self.held)
                    self.apr_limit = self._settle(search.value.apr, bound, self.apr_limit)
        self._hold(Requirement(measure=search.reduced.measure, least=search.value.apr))
        return self.apr_limit

    def bound_apr_one_failed(self) -> float:
        """No layout that holds the APR keeps a higher one when one unit fails."""
        if self.search.reduced.limits.max_units == 1:
            return 0.0
        return self._bound_failed(1, self.search.value.apr)

    def bound_smallest_margin_s(self) -> float:
        """No layout that holds the stages before has a larger smallest margin."""
        search = self.search
        reduced = search.reduced
        limit = self._smallest_margin_limit_s()
        if self._is_settled(search.value.smallest_margin_s, limit):
            return self._hold_margin(limit)
        if self._is_complete() or self._enumerate():
            return self._hold_margin(search.value.smallest_margin_s)
        margins = reduced.margin_s
        candidates = np.unique(margins[margins <= limit + TOLERANCE])
        low = int(np.searchsorted(candidates, search.value.smallest_margin_s + TOLERANCE))
        high, probe = len(candidates), low
        while low < high:
            demand = Requirement(
                measure=reduced.measure,
                least=search.value.apr,
                min_margin_s=float(candidates[probe]),
            )
            if search.look_for(None, [*self.held, demand]) == -np.inf:
                high = probe
            elif search.value.smallest_margin_s >= candidates[probe] - TOLERANCE:
                low = int(np.searchsorted(candidates, search.value.smallest_margin_s + TOLERANCE))
            else:
                break  # time is up
            probe = (low + high) // 2
        bound = float(candidates[high - 1]) if low < high else search.value.smallest_margin_s
        return self._hold_margin(bound)

    def bound_mean_margin_s(self) -> float:
        """No layout that holds the stages before has a larger mean margin."""
        search = self.search
        if self._avoids_nothing():
            return 0.0
        limit = float(search.margin_limit_s.max())
        if search.value.apr > 0.0:  # what avoids as much has no larger sum of margins to share out
            total_s = float(search.reduced.weight @ np.maximum(search.margin_limit_s, 0.0))
            limit = min(limit, total_s / search.value.apr)
        if self._is_settled(search.value.mean_margin_s, limit):
            return limit
        if self._is_complete() or self._enumerate():
            return search.value.mean_margin_s
        if search.value.apr == 0.0:  # what is avoided at least is not known: sums bound no mean
            return limit
        value = search.value.mean_margin_s * self._avoided_weight()
        if self._beats_all_promises(Objective.MEAN_MARGIN, value):
            return search.value.mean_margin_s
        limit = min(limit, self._promised(Objective.MEAN_MARGIN) / search.value.apr)
        if self._is_settled(search.value.mean_margin_s, limit):
            return limit
        bound = search.look_for(Objective.MEAN_MARGIN, self.held)
        return settle(search.value.mean_margin_s, bound / search.value.apr, limit)

    def bound_cost_eur(self) -> float:
        """No layout that holds the stages before costs less."""
        search = self.search
        cost, least = search.value.cost_eur, self._cheapest_unit_eur()
        if cost <= least + COST_TOLERANCE_EUR or self._is_complete():
            return cost
        total_s = search.value.mean_margin_s * self._avoided_weight()
        if self._no_smaller_set_does(total_s):
            return search.value.cost_eur
        mean = Requirement(measure=search.reduced.measure, least=total_s, sums_margins=True)
        bound = search.look_for(Objective.COST, [*self.held, mean])
        return max(least, self._settled_from_below(search.value.cost_eur, bound))

    def _avoided_weight(self) -> float:
        return float(self.search.reduced.weight @ self.search.avoided())

    def _promised(self, worth: Objective) -> float:
        """What no set can be worth more than, by relaxation; infinite where that is not asked."""
        reduced = self.search.reduced
        if self.effort.solver == "greedy" or (
            worth is Objective.APR and not reduced.measure.is_mean
        ):
            return np.inf
        if can_cover(self.problem, reduced) and self.search.left_s() > 0.0:
            return self._covered(reduced, worth)
        if not reduced.can_unpack:
            return np.inf
        limit = relaxed_limit(reduced, worth)
        self.search.proofs[relaxation_text()] = None
        return limit

    def _covered(self, reduced: ReducedProblem, worth: Objective) -> float:
        """What no set can be worth more than, on the windows; a better set on the way is kept."""
        search = self.search
        branches = worth is Objective.APR and search.uses_models
        cover, limit = cover_windows(
            self.problem,
            reduced,
            worth,
            time_limit_s=_COVER_SHARE * search.left_s(),
            branches=branches,
        )
        search.proofs[relaxation_text()] = None
        if cover.n_nodes:
            search.proofs["branch and bound"] = None
        if worth is Objective.APR and reduced is search.reduced:
            search.offer(cover.poses)
        return limit

    def _beats_all_promises(self, worth: Objective, value: float) -> bool:
        """Look through all sets that may be worth more than the best; whether that was possible."""
        search = self.search
        reduced = search.reduced
        n_units = reduced.limits.max_units - int(reduced.limits.is_forced.sum())
        is_possible = search.uses_models and search.left_s() > 0.0 and reduced.measure.is_mean
        if not (is_possible and can_enumerate(reduced, n_units)):
            return False
        need = value + (1.0 if worth is Objective.APR else -1.0) * TOLERANCE
        units, is_complete = best_beyond(
            reduced, worth, need, n_units=n_units, known=search.row, left_s=search.left_s
        )
        if units is not None:
            search.keep(units)
        if is_complete:
            search.proofs["exhaustive enumeration"] = None
        return is_complete

    def _no_smaller_set_does(self, total_margin_s: float) -> bool:
        """Whether, at equal prices, no set with one unit less is as good in all stages before."""
        search = self.search
        reduced = search.reduced
        limits = reduced.limits
        n_units = len(self._units()) - 1 - int(limits.is_forced.sum())
        is_uniform = not (limits.site_cost_eur.any() or limits.is_forced.any())
        is_uniform = is_uniform and np.ptp(limits.unit_cost_eur) == 0.0
        if not (is_uniform and search.uses_models and can_enumerate(reduced, n_units)):
            return False
        if search.left_s() <= 0.0:
            return False
        units, is_complete = best_beyond(
            reduced,
            Objective.MEAN_MARGIN,
            total_margin_s - TOLERANCE,
            n_units=n_units,
            known=search.row,
            left_s=search.left_s,
        )
        if not is_complete:
            return False
        search.proofs["exhaustive enumeration"] = None
        # keep() takes it only if it is as good as the best set, and cheaper.
        return units is None or not search.keep(units)

    def _bound_failed(self, n_failures: int, limit: float) -> float:
        """No layout that holds the stages before keeps a higher APR when its worst units fail."""
        search = self.search
        value = self._left(n_failures)
        if not self._is_settled(value, limit):
            if self._is_complete() or self._walk(n_failures):
                limit = self._left(n_failures)
            elif self.walk_limit[n_failures] < limit:
                limit = self.walk_limit[n_failures]
            else:
                limit = self._bound_failed_by_models(n_failures, limit)
        self._hold(
            Requirement(
                measure=search.reduced.measure, least=self._left(n_failures), n_failures=n_failures
            )
        )
        return limit

    def _bound_failed_by_models(self, n_failures: int, limit: float) -> float:
        search = self.search
        reduced = search.reduced
        n_left = reduced.limits.max_units - n_failures
        if n_left < 1:
            return 0.0
        # What is left when units fail is a layout with fewer, bound by no wish.
        fewer = replace(
            reduced,
            floors=(),
            limits=replace(
                reduced.limits,
                budget_units=n_left,
                is_forced=np.zeros_like(reduced.limits.is_forced),
                is_forced_site=np.zeros_like(reduced.limits.is_forced_site),
            ),
        )
        if can_cover(self.problem, fewer) and search.left_s() > 0.0:
            limit = self._settle(self._left(n_failures), self._covered(fewer, Objective.APR), limit)
        elif search.sets is not None and search.sets.goes_by_pairs and n_left > 1:
            limit = self._settle(
                self._left(n_failures), self._best_of_fewer(fewer, n_failures), limit
            )
        if not self._is_settled(self._left(n_failures), limit):
            bound = search.look_for(Objective.APR, (), fewer)
            limit = self._settle(self._left(n_failures), bound, limit)
        step = 2.0 * TOLERANCE
        all_runs = reduced.measure.limit
        if limit >= all_runs - TOLERANCE > self._left(n_failures) and reduced.measure.is_mean:
            demand = Requirement(measure=reduced.measure, least=all_runs, n_failures=n_failures)
            if search.look_for(None, [*self.held, demand]) == -np.inf:
                limit = all_runs - float(reduced.weight.min())
        while self._left(n_failures) < limit - TOLERANCE:
            before = self._left(n_failures)
            demand = Requirement(
                measure=reduced.measure, least=before + step, n_failures=n_failures
            )
            if search.look_for(None, [*self.held, demand]) == -np.inf:
                return before
            if self._left(n_failures) <= before + TOLERANCE:
                return limit  # time is up
        return limit

    def _best_of_fewer(self, fewer: ReducedProblem, n_failures: int) -> float:
        """No set of as many units as are left when some fail has a higher APR."""
        search = self.search
        assert search.sets is not None
        if not search.uses_models or search.left_s() <= 0.0:
            return np.inf
        sets = search.sets.with_limits(fewer.limits)
        left = self._units()[:-n_failures]
        tied = sets.tied(
            sets.climb(sets.fill(left), end_s=search.end_s),
            n_failures=0,
            least_apr=None,
            end_s=now_s() + _WALK_SHARE * search.left_s(),
            on_better=lambda units: units,
        )
        search.proofs["branch and bound"] = None
        return tied.limit

    def _left(self, n_failures: int) -> float:
        search = self.search
        sets = self._units()[None, :]
        left = left_after_failures(search.reduced, search.reduced.measure, n_failures, sets)
        return float(left[0])

    def _units(self) -> IntArray:
        units = self.search.units
        assert units is not None  # a first set is there, or solve_placement has given up
        return units

    def _hold(self, requirement: Requirement) -> None:
        self.held.append(requirement)

    def _hold_margin(self, bound: float) -> float:
        search = self.search
        self._hold(
            Requirement(
                measure=search.reduced.measure,
                least=search.value.apr,
                min_margin_s=search.value.smallest_margin_s,
            )
        )
        return bound

    def _is_settled(self, value: float, limit: float) -> bool:
        return limit - value <= max(TOLERANCE, self.effort.gap * abs(value))

    def _settle(self, apr: float, bound: float, limit: float) -> float:
        return settle(apr, bound, limit, step=self.search.reduced.measure.step)

    def _settled_from_below(self, cost: float, bound: float) -> float:
        """Lower bound of a cost; the solver's own has an error."""
        error = SOLVER_TOLERANCE * max(1.0, cost)
        step = price_step_eur(self.search.reduced.limits)
        return cost if bound >= cost - max(COST_TOLERANCE_EUR, step - error) else bound

    def _smallest_margin_limit_s(self) -> float:
        search = self.search
        if self._avoids_nothing():
            return 0.0
        order = np.argsort(-search.margin_limit_s)
        share = np.cumsum(search.reduced.weight[order])
        enough = np.argmax(share >= search.value.apr - TOLERANCE)
        return float(search.margin_limit_s[order[enough]])

    def _avoids_nothing(self) -> bool:
        """Whether it is proven that no layout that holds the stages before avoids anything.

        Where only the worst worlds count, an APR of 0 does not say so: others may avoid something.
        """
        reduced = self.search.reduced
        is_none = reduced.measure.is_mean and self.apr_limit == 0.0
        return is_none or not len(reduced.weight)

    def _cheapest_unit_eur(self) -> float:
        limits = self.search.reduced.limits
        if not limits.n_poses:
            return 0.0
        return float((limits.unit_cost_eur + limits.site_cost_eur[limits.site_index]).min())

    def _one_unit_does(self) -> bool:
        """Whether a single pose reaches the floors."""
        reduced = self.search.reduced
        sets = np.arange(reduced.n_poses)[:, None]
        sets = sets[are_allowed(reduced.limits, sets)]
        return bool(len(sets)) and bool((set_values(reduced, sets).lacking == 0.0).any())

    def _is_complete(self) -> bool:
        """Go through all sets, if they are few; whether that was done."""
        search = self.search
        if self.is_complete is None:
            self.is_complete = False
            if self.effort.solver in ("auto", "exact"):
                units, self.is_complete = best_of_few(
                    search.reduced,
                    max_sets=min(self._max_sets(), _MAX_FEW_SETS),
                    end_s=search.end_s,
                )
                if units is not None:
                    search.keep(units)
            if self.is_complete:
                search.proofs["exhaustive enumeration"] = None
        return self.is_complete

    def _walk(self, n_failures: int) -> bool:
        """Walk through all sets that may be better in a stage; whether that was done.

        The stage is the APR when so many units fail; the APR itself is held in a later one. Where
        few sets are best, the best of them all is best in every stage that comes.
        """
        search = self.search
        sets = search.sets
        if sets is None or not search.uses_models or search.left_s() <= 0.0:
            return False
        holds_apr = n_failures > 0 and not self.problem.survive

        def better(units: IntArray) -> IntArray:
            search.keep(sets.climb(units, end_s=search.end_s))
            return self._units()

        # Nothing else bounds drawn detections; the APR that is left is bounded by fewer units.
        if sets.goes_by_pairs and n_failures and not search.reduced.can_unpack:
            return False
        share = _PAIRS_SHARE if sets.goes_by_pairs else _WALK_SHARE
        tied = sets.tied(
            self._units(),
            n_failures=n_failures,
            least_apr=search.value.apr if holds_apr else None,
            end_s=now_s() + share * search.left_s(),
            on_better=better,
        )
        search.proofs["branch and bound"] = None
        self.walk_limit[n_failures] = tied.limit
        if tied.sets is not None:
            best = sets.best_of(tied.sets, n_failures=n_failures, value=tied.value)
            if best is not None:
                search.keep(best)
            self.is_complete = True
        return tied.is_finished

    def _enumerate(self) -> bool:
        """Go through all sets that could be better, if they are few; whether that was done."""
        search, reduced, problem = self.search, self.search.reduced, self.problem
        if self.has_enumerated is None:
            self.has_enumerated = False
            is_apr_proven = search.value.apr >= self.apr_limit - TOLERANCE
            is_plain = reduced.limits.is_plain and reduced.measure.is_mean
            is_plain = is_plain and not (problem.floors or problem.survive)
            is_plain = is_plain and reduced.limits.failing == "unit"
            is_full = len(self._units()) == reduced.limits.max_units
            if is_apr_proven and is_plain and is_full and search.uses_models:
                best = best_of_all(
                    reduced,
                    self._units(),
                    known=search.row,
                    max_sets=int(max(search.left_s(), 0.0) * _SETS_KEPT_PER_SECOND),
                )
                self.has_enumerated = best is not None
                if best is not None:
                    search.keep(best)
                    search.proofs["exhaustive enumeration"] = None
        return self.has_enumerated

    def _max_sets(self) -> int:
        return max(0, min(_MAX_SETS, int(self.search.left_s() * _SETS_PER_SECOND)))
