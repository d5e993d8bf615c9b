"""The stages in order, each holding those before it, each with a proven bound."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version

import numpy as np

from geometry.arrays import FloatArray, IntArray

from ..layout import Certificate, Stage, relative_gap
from .bitsets import set_values, union_margins_s
from .cuts import Demand, first_cuts, violated_cuts
from .enumeration import best_of_all
from .greedy import extend_greedily, improve, solve_heuristically, to_full
from .model import Cut, avoided_weights, last_links, margin_weights, solve_milp
from .presolve import PresolveStatistics, ReducedProblem, presolve
from .problem import TOLERANCE, PlacementProblem, PlacementValue, is_better, placement_value

_SOLVER = f"HiGHS {version('highspy')} through cvxpy {version('cvxpy')}"
_SETS_PER_SECOND = 100_000  # enumeration; measured: two to three times as many
_MAX_SETS = 400_000  # beyond, MILPs are quicker
_HIGHS_TOLERANCE = 1.0e-6  # rows, whole numbers and gaps are met up to this


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Chosen poses, and how good they are proven to be.

    Attributes
    ----------
    pose_index : tuple of int
        Rows of the detection table, ascending.
    certificate : Certificate
        Stages "apr", "apr_one_failed", "smallest_margin_s", "mean_margin_s".
    presolve : PresolveStatistics
        What dropped out before.
    """

    pose_index: tuple[int, ...]
    certificate: Certificate
    presolve: PresolveStatistics


def solve_placement(
    problem: PlacementProblem,
    reduced: ReducedProblem | None = None,
    *,
    time_limit_s: float = 60.0,
    on_stage: Callable[[str], None] | None = None,
) -> Solution:
    """Best poses: by APR, then APR when one unit fails, smallest margin, mean margin.

    Parameters
    ----------
    problem : PlacementProblem
        What to solve.
    reduced : ReducedProblem, optional
        Its presolved form, where that is at hand.
    time_limit_s : float
        For all stages together; presolve and the first layout are finished in any case. When it is
        up, the best layout found is kept and the gaps say what is not proven. [s]
    on_stage : callable, optional
        Called with the name of every stage when it begins.

    Returns
    -------
    solution : Solution
        The bound of a stage is what no layout can exceed that is as good in all stages before.

    Raises
    ------
    ValueError
        The time limit is not positive.
    """
    if not time_limit_s > 0.0:
        raise ValueError(f"time_limit_s: got {time_limit_s!r}; expected seconds, more than 0")
    end_s = time.monotonic() + time_limit_s
    reduced = presolve(problem) if reduced is None else reduced
    search = _Search(reduced, end_s)
    bounders = (
        search.bound_apr,
        search.bound_apr_one_failed,
        search.bound_smallest_margin_s,
        search.bound_mean_margin_s,
    )
    bounds, seconds = [], []
    for name, find_bound in zip(PlacementValue._fields, bounders, strict=True):
        if on_stage is not None:
            on_stage(name)
        began_s = time.monotonic()
        bounds.append(find_bound())
        seconds.append(time.monotonic() - began_s)
    pose_index = to_full(problem, reduced, search.units)
    value = placement_value(problem, pose_index)
    stages = []
    for name, objective, bound, spent_s in zip(
        PlacementValue._fields, value, bounds, seconds, strict=True
    ):
        gap = relative_gap(objective, max(bound, objective))
        stages.append(
            Stage(
                name=name,
                objective=objective,
                bound=objective if gap == 0.0 else max(bound, objective),
                gap=gap,
                seconds=spent_s,
            )
        )
    return Solution(
        pose_index=pose_index,
        certificate=Certificate(
            stages=tuple(stages),
            solver=search.solver,
        ),
        presolve=reduced.statistics,
    )


class _Search:
    """The best set so far, and a method per stage that proves how much better one could be."""

    def __init__(self, reduced: ReducedProblem, end_s: float) -> None:
        self.reduced = reduced
        self.end_s = end_s
        everything = np.bitwise_or.reduce(reduced.words, axis=0, keepdims=True)
        self.margin_limit_s = union_margins_s(reduced, everything)[0]
        self.limit = self._limit()
        self.units = solve_heuristically(reduced, self.limit)
        self.value = self._value_of(self.units)
        self.has_used_solver = False
        self.has_enumerated: bool | None = None  # not tried yet
        self.cuts: dict[float, list[Cut]] = {}  # by the APR that is asked for when one unit fails

    @property
    def solver(self) -> str:
        """What the proofs rest on."""
        parts = [_SOLVER] if self.has_used_solver else []
        parts += ["exhaustive enumeration"] if self.has_enumerated else []
        return " and ".join(parts) or "simple bounds, no solver"

    def bound_apr(self) -> float:
        """No layout has a higher APR."""
        self.apr_limit = min(1.0, float(self.reduced.weight.sum()))
        if self.value.apr < self.apr_limit - TOLERANCE:
            bound = self._look_for(Demand(), avoided_weights(self.reduced))
            self.apr_limit = _settle(self.value.apr, bound, self.apr_limit)
        return self.apr_limit

    def bound_apr_one_failed(self) -> float:
        """No layout that holds the APR keeps a higher one when one unit fails."""
        n_units = self.reduced.budget_units
        if n_units == 1:
            return 0.0
        limit = self.value.apr
        if self.value.apr_one_failed >= limit - TOLERANCE:
            return limit
        if self._enumerate():
            return self.value.apr_one_failed
        # What is left when a unit fails is a layout with one unit less.
        fewer = replace(self.reduced, budget_units=n_units - 1)
        self.has_used_solver = True
        result = solve_milp(fewer, avoided_weights(fewer), time_limit_s=self._left_s())
        limit = _settle(self.value.apr_one_failed, result.bound, limit)
        all_runs = float(self.reduced.weight.sum())
        if limit >= all_runs - TOLERANCE > self.value.apr_one_failed:
            bound = self._look_for(Demand(apr=self.value.apr, apr_one_failed=all_runs))
            if bound == -np.inf:
                limit = all_runs - float(self.reduced.weight.min())
        while self.value.apr_one_failed < limit - TOLERANCE:
            before = self.value
            bound = self._look_for(
                Demand(apr=before.apr, apr_one_failed=before.apr_one_failed + 2.0 * TOLERANCE)
            )
            if bound == -np.inf:
                return before.apr_one_failed
            if not is_better(self.value, before):
                return limit  # time is up
        return limit

    def bound_smallest_margin_s(self) -> float:
        """No layout that holds the stages before has a larger smallest margin."""
        if self.value.apr == 0.0:
            return self._undefined_margin_s()
        order = np.argsort(-self.margin_limit_s)
        share = np.cumsum(self.reduced.weight[order])
        limit = self.margin_limit_s[order[np.argmax(share >= self.value.apr - TOLERANCE)]]
        if self.value.smallest_margin_s >= limit - TOLERANCE or self._enumerate():
            return self.value.smallest_margin_s
        margins = self.reduced.margin_s
        candidates = np.unique(margins[margins <= limit + TOLERANCE])
        low = int(np.searchsorted(candidates, self.value.smallest_margin_s + TOLERANCE))
        high, probe = len(candidates), low
        while low < high:
            demand = Demand(
                apr=self.value.apr,
                min_margin_s=float(candidates[probe]),
                apr_one_failed=self.value.apr_one_failed,
            )
            if self._look_for(demand) == -np.inf:
                high = probe
            elif self.value.smallest_margin_s >= candidates[probe] - TOLERANCE:
                low = int(np.searchsorted(candidates, self.value.smallest_margin_s + TOLERANCE))
            else:
                break  # time is up
            probe = (low + high) // 2
        return float(candidates[high - 1]) if low < high else self.value.smallest_margin_s

    def bound_mean_margin_s(self) -> float:
        """No layout that holds the stages before has a larger mean margin."""
        if self.value.apr == 0.0:
            return self._undefined_margin_s()
        total_s = self.reduced.weight @ self.margin_limit_s
        limit = min(float(self.margin_limit_s.max()), float(total_s) / self.value.apr)
        if self.value.mean_margin_s >= limit - TOLERANCE or self._enumerate():
            return self.value.mean_margin_s
        demand = Demand(
            apr=self.value.apr,
            min_margin_s=self.value.smallest_margin_s,
            apr_one_failed=self.value.apr_one_failed,
        )
        bound = self._look_for(demand, margin_weights(self.reduced))
        return _settle(self.value.mean_margin_s, bound / demand.apr, limit)

    def _enumerate(self) -> bool:
        """Go through all sets that could be better, if they are few; whether that was done."""
        if self.has_enumerated is None:
            is_apr_proven = self.value.apr >= self.apr_limit - TOLERANCE
            best = best_of_all(
                self.reduced,
                self.units,
                apr_one_failed=self.value.apr_one_failed,
                max_sets=min(_MAX_SETS, int(self._left_s() * _SETS_PER_SECOND))
                if is_apr_proven
                else 0,
            )
            self.has_enumerated = best is not None
            if best is not None:
                self.units, self.value = best, self._value_of(best)
        return self.has_enumerated

    def _limit(self) -> PlacementValue:
        """What all poses together reach where everything is avoided: no set is better."""
        all_runs = min(1.0, float(self.reduced.weight.sum()))
        if all_runs == 0.0:
            return PlacementValue(0.0, 0.0, 0.0, 0.0)
        return PlacementValue(
            apr=all_runs,
            apr_one_failed=all_runs if self.reduced.budget_units > 1 else 0.0,
            smallest_margin_s=float(self.margin_limit_s.min()),
            mean_margin_s=float(np.average(self.margin_limit_s, weights=self.reduced.weight)),
        )

    def _undefined_margin_s(self) -> float:
        """Bound of a margin while nothing is avoided: 0 if that is proven."""
        return 0.0 if self.apr_limit == 0.0 else float(self.margin_limit_s.max())

    def _look_for(self, demand: Demand, objective: FloatArray | None = None) -> float:
        """Look for the best set that meets a demand; keep it if it is better than the best so far.

        Parameters
        ----------
        demand : Demand
            What it must reach.
        objective : (n_links,) float, optional
            Weights of a; without them any set that meets the demand will do.

        Returns
        -------
        bound : float
            No set that meets the demand has a higher objective; minus infinity if there is none,
            plus infinity if nothing is known, or if there is no objective.
        """
        cuts = self.cuts.setdefault(demand.apr_one_failed, first_cuts(self.reduced, demand))
        bound = np.inf
        while self._left_s() > 0.0:
            self.has_used_solver = True
            result = solve_milp(
                self.reduced,
                objective,
                hold_link=last_links(self.reduced, min_margin_s=demand.min_margin_s),
                hold_share=demand.apr,
                cuts=cuts,
                time_limit_s=self._left_s(),
            )
            if result.units is None and result.is_finished:
                return -np.inf
            if objective is not None:
                bound = min(bound, result.bound)
            if result.units is None:
                break
            violated = violated_cuts(self.reduced, result.units, demand)
            if not violated:
                self._offer(result.units)
                break
            cuts.extend(violated)
        return bound

    def _offer(self, units: IntArray) -> None:
        units = improve(self.reduced, extend_greedily(self.reduced, units), self.limit)
        value = self._value_of(units)
        if is_better(value, self.value):
            self.units, self.value = units, value

    def _left_s(self) -> float:
        return self.end_s - time.monotonic()

    def _value_of(self, units: IntArray) -> PlacementValue:
        return PlacementValue(*map(float, set_values(self.reduced, units[None, :])[0]))


def _settle(objective: float, bound: float, limit: float) -> float:
    """Bound of a stage from what HiGHS says; `limit` holds without it."""
    tolerance = _HIGHS_TOLERANCE * max(1.0, abs(objective))
    if bound < objective - tolerance:
        return limit  # HiGHS errs: a set with this objective is at hand
    return objective if bound <= objective + tolerance else min(limit, bound)
