"""The best set found so far, and the loop of models and cuts that looks for better ones."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s

from .bitsets import SetValues, no_values, set_values, union_margins_s, unions_of
from .greedy import extend_greedily, improve, solve_heuristically
from .limits import Limits, is_allowed
from .model import Cut, entering_poses, last_links, solve_window_model, solver_text
from .objectives import VALUE_OBJECTIVES, Objective
from .presolve import ReducedProblem
from .problem import PlacementValue, Requirement, WordArray
from .tied_sets import SetSearch, can_walk
from .tolerances import TOLERANCE

# ---------- cuts


Fails = Callable[[WordArray], BoolArray]


def first_cuts(reduced: ReducedProblem, requirement: Requirement) -> list[Cut]:
    """Cuts that hold from the start: enough must see stabbing frames and tails of every run.

    Only where no run may be lost with any unit. Tails count that all windows of a run need.
    """
    if not (requirement.needs_all and requirement.n_failures):
        return []
    counted = np.flatnonzero(requirement.measure.weight > 0.0)
    links = last_links(reduced, min_margin_s=requirement.min_margin_s)[counted]
    cuts = []
    last = np.unique(links[links >= 0])
    chains = np.searchsorted(reduced.chains.start, last, "right") - 1
    for chain, link in zip(chains, last - reduced.chains.start[chains], strict=True):
        frames, n_links = reduced.tails(int(chain))
        for frame in frames[n_links > link]:
            sees = (reduced.words[:, frame >> 6] >> np.uint64(frame & 63)) & np.uint64(1)
            cuts.append(Cut(is_counted=sees != 0, n_units=requirement.n_failures + 1))
    for phase in range(reduced.window_frames.shape[1]):
        enters = entering_poses(reduced, phase).toarray() > 0.0
        for start, link in zip(reduced.chains.start[chains], last, strict=True):
            cuts.append(
                Cut(
                    is_counted=np.logical_or.reduce(enters[start : link + 1], axis=0),
                    n_units=requirement.n_failures + 1,
                )
            )
    return cuts


def violated_cuts(
    reduced: ReducedProblem, units: IntArray, requirements: Sequence[Requirement]
) -> list[Cut]:
    """Cuts that a set of poses violates; none if and only if it meets all requirements."""
    cuts = []
    for requirement in requirements:
        fails = _fails_requirement(reduced, requirement)
        n_units = requirement.n_failures + 1
        is_unit = reduced.limits.failing == "unit"
        at = np.arange(len(units)) if is_unit else reduced.limits.site_index[units]
        groups = np.unique(at)
        n_left = max(len(groups) - requirement.n_failures, 0)
        for left in combinations(groups.tolist(), n_left):
            union = unions_of(reduced, units[np.isin(at, left)][None, :])[0]
            if not fails(union[None, :])[0]:
                continue
            if requirement.needs_all:
                cuts += [
                    _cut(reduced, union, _fails_run(reduced, run, requirement), n_units=n_units)
                    for run in _lost_runs(reduced, union, requirement)
                ]
            else:
                cuts.append(_cut(reduced, union, fails, n_units=n_units))
    return cuts


def _lost_runs(reduced: ReducedProblem, union: WordArray, requirement: Requirement) -> list[int]:
    """Of every chain, the lost run with the fewest windows: the hardest to avoid."""
    margin = union_margins_s(reduced, union[None, :])[0]
    is_lost = ~requirement.counts_run(margin) & (requirement.measure.weight > 0.0)
    last = last_links(reduced, min_margin_s=requirement.min_margin_s)
    hardest = []
    for chain in np.unique(reduced.run_chain[is_lost]):
        runs = np.flatnonzero(is_lost & (reduced.run_chain == chain))
        hardest.append(int(runs[np.argmin(last[runs])]))
    return hardest


def _fails_requirement(reduced: ReducedProblem, requirement: Requirement) -> Fails:
    def fails(unions: WordArray) -> BoolArray:
        reached = requirement.reached(union_margins_s(reduced, unions))
        result: BoolArray = reached < requirement.least - TOLERANCE
        return result

    return fails


def _fails_run(reduced: ReducedProblem, run: int, requirement: Requirement) -> Fails:
    def fails(unions: WordArray) -> BoolArray:
        return ~requirement.counts_run(union_margins_s(reduced, unions)[:, run])

    return fails


def _cut(reduced: ReducedProblem, union: WordArray, fails: Fails, *, n_units: int) -> Cut:
    """Cut from a set that fails, enlarged until every further pose would end that."""
    words = reduced.words
    waiting = np.flatnonzero((words & ~union).any(axis=1))
    while len(waiting) > 0:
        waiting = waiting[fails(union | words[waiting])]
        # Those that add least come first: more of them fit in.
        n_new = np.bitwise_count(words[waiting] & ~union).sum(axis=1, dtype=np.int64)
        waiting = waiting[np.argsort(n_new, kind="stable")]
        grown = np.bitwise_or.accumulate(words[waiting], axis=0) | union
        n_fit = int(fails(grown).sum())
        if n_fit > 0:
            union = grown[n_fit - 1]
        waiting = waiting[n_fit:]
    outside: BoolArray = np.logical_or.reduce((words & ~union) != 0, axis=1)
    return Cut(is_counted=outside, n_units=n_units)


# ---------- the search


_START_SHARE = 0.1  # of the time left


class Search:
    """Best set of poses so far, and what the proofs rest on; it stops at `end_s`."""

    def __init__(self, reduced: ReducedProblem, *, end_s: float, uses_models: bool = True) -> None:
        self.reduced = reduced
        self.end_s = end_s
        self.uses_models = uses_models
        self.proofs: dict[str, None] = {}
        everything = np.bitwise_or.reduce(reduced.words, axis=0, keepdims=True)
        self.margin_limit_s: FloatArray = union_margins_s(reduced, everything)[0]
        self.units: IntArray | None = None
        self.nothing_meets_all = False  # proven that no set meets limits and floors
        self.row = no_values(reduced)
        self._cuts: dict[tuple[float, ...], list[Cut]] = {}
        self._sets: SetSearch | None = None

    @property
    def sets(self) -> SetSearch | None:
        """Exchanges and walks through all sets; None where wishes or money stand in their way."""
        if not can_walk(self.reduced):
            return None
        if self._sets is None or self._sets.reduced is not self.reduced:
            self._sets = SetSearch(self.reduced, end_s=self.end_s)
        return self._sets

    @property
    def value(self) -> PlacementValue:
        """Value of the best set."""
        return PlacementValue(*(float(self.row.of(objective)) for objective in VALUE_OBJECTIVES))

    @property
    def shortfall(self) -> float:
        """What the best set lacks to the floors, summed."""
        return float(self.row.lacking)  # infinite where there is no set

    @property
    def limit(self) -> SetValues:
        """What all poses together reach where everything is avoided: no set is better."""
        reduced = self.reduced
        largest: dict[Objective, float] = {}
        if len(reduced.weight):
            all_runs, most = reduced.measure.limit, reduced.limits.max_units
            largest = {
                Objective.APR_SURVIVED: all_runs if most > reduced.survive else 0.0,
                Objective.APR: all_runs,
                Objective.APR_ONE_FAILED: all_runs if most > 1 else 0.0,
                Objective.SMALLEST_MARGIN: float(self.margin_limit_s.min()),
                Objective.MEAN_MARGIN: float(
                    np.average(self.margin_limit_s, weights=reduced.weight)
                ),
            }
        gains = [largest.get(objective, 0.0) for objective in reduced.objectives]
        return SetValues(reduced.objectives, np.array([0.0, *gains]))

    def left_s(self) -> float:
        """Time left, in seconds."""
        return self.end_s - now_s()

    def start(self, starts: Sequence[IntArray] = ()) -> None:
        """Find a first set, from some to begin with; there may be none that reaches the floors."""
        if self.sets is None:
            units = solve_heuristically(self.reduced, self.limit, starts=starts, end_s=self.end_s)
        else:
            end_s = now_s() + _START_SHARE * self.left_s()
            units = self.sets.look(starts, limit=self.limit, end_s=end_s)
        if units is not None:
            self.keep(units)
        if self.shortfall > 0.0:
            self.nothing_meets_all = self.look_for(None, ()) == -np.inf

    def restrict(self, limits: Limits) -> None:
        """Look for the best set within tighter limits, which the best so far meets."""
        self.reduced = replace(self.reduced, limits=limits).with_goal("best")
        units = self.units
        self.units = None
        again = solve_heuristically(self.reduced, self.limit, end_s=self.end_s)
        for found in (units, again):
            if found is not None:
                self.keep(found)

    def avoided(self) -> BoolArray:
        """Runs that the best set avoids, (n_runs,)."""
        assert self.units is not None
        union = unions_of(self.reduced, self.units[None, :])
        is_avoided: BoolArray = union_margins_s(self.reduced, union)[0] > -np.inf
        return is_avoided

    def keep(self, units: IntArray) -> bool:
        """Take a set if it is better than the best so far; whether it was."""
        row = set_values(self.reduced, units[None, :])[0]
        if self.units is not None and not row.exceeds(self.row):
            return False
        self.units, self.row = units, row
        return True

    def offer(self, units: IntArray) -> None:
        """Take a set after completing and improving it, if it is better then."""
        if not is_allowed(self.reduced.limits, units):
            return
        self.keep(units)
        self.keep(improve(self.reduced, units, self.limit, end_s=self.end_s))
        extended = extend_greedily(self.reduced, units)
        if len(extended) > len(units) and is_allowed(self.reduced.limits, extended):
            self.keep(improve(self.reduced, extended, self.limit, end_s=self.end_s))

    def look_for(
        self,
        objective: Objective | None,
        requirements: Sequence[Requirement],
        reduced: ReducedProblem | None = None,
    ) -> float:
        """Look for the best set that meets requirements beside the floors; keep it if it is better.

        Without an objective, any set that meets them. Sets of another problem on the same poses,
        `reduced`, are not kept. Returns a bound: no set that meets the requirements has a better
        objective; the worst infinity if there is none, the best one if nothing is known.
        """
        problem = self.reduced if reduced is None else reduced
        demands = (*problem.floors, *requirements)
        is_minimised = objective is not None and objective.is_minimised
        bound = -np.inf if is_minimised else np.inf
        cuts = [cut for demand in demands for cut in self._cuts_of(problem, demand)]
        while self.uses_models and problem.can_unpack and self.left_s() > 0.0:
            self.proofs[solver_text()] = None
            result = solve_window_model(
                problem, objective, requirements=demands, cuts=cuts, time_limit_s=self.left_s()
            )
            if result.units is None and result.is_finished:
                return np.inf if is_minimised else -np.inf
            better = max if is_minimised else min
            bound = better(bound, result.bound)
            if result.units is None:
                break
            found: list[Cut] = []
            for demand in demands:
                new = violated_cuts(problem, result.units, [demand])
                self._cuts_of(problem, demand).extend(new)
                found += new
            if not found:
                if reduced is None:
                    self.offer(result.units)
                break
            cuts += found
        return bound

    def _cuts_of(self, problem: ReducedProblem, requirement: Requirement) -> list[Cut]:
        """Cuts that hold for all sets that meet a requirement, to be added to."""
        key = (
            float(id(requirement.measure)),
            requirement.least,
            requirement.min_margin_s,
            float(requirement.n_failures),
            float(requirement.sums_margins),
        )
        if key not in self._cuts:
            self._cuts[key] = first_cuts(problem, requirement)
        return self._cuts[key]
