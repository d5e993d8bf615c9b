"""Upper bounds of the worth of sets by relaxation, and all sets whose bound is high enough."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from geometry.arrays import FloatArray, IntArray

from .bitsets import (
    BestSet,
    SetValues,
    keep_apr,
    may_keep_margins,
    set_values,
    union_margins_s,
    unions_of,
)
from .bounds import Coverage, build_supply, timely_windows
from .enumeration import MAX_POSES, MAX_UNITS, best_sets
from .greedy import lazy_greedy, swap
from .objectives import Objective
from .presolve import ReducedProblem
from .problem import PlacementProblem
from .relaxation import first_multipliers, polish, tighten
from .threads import WORKERS
from .tolerances import TOLERANCE, common_step
from .window_cover import WindowCover, find_window_cover

_MAX_TRIPLES = 3e8
_MAX_SETS_BEST_OF = 2_000_000  # that are evaluated one by one
_BLOCK_SETS = 1 << 14
_STEPS = 400
_WHOLE_GAP = 0.999  # a limit above a whole number by less proves that number


def build_coverage(reduced: ReducedProblem, worth: Objective) -> Coverage:
    """What each pose alone promises in every run, as a best-of coverage.

    A run that is avoided is worth its weight, for ``Objective.MEAN_MARGIN`` its weight times its
    margin. Forced units stand already: the supply is what may join them. Limits of units, sites and
    money hold; wishes and rivals are left out, which only makes a bound higher.
    """
    values = np.zeros((reduced.n_poses, len(reduced.weight)))
    detected = reduced.detected()
    for chain in range(reduced.n_chains):
        runs = np.flatnonzero(reduced.run_chain == chain)
        seen = detected[:, reduced.window_frames[reduced.chain(chain), 0]]
        first = np.where(seen.any(axis=1), seen.argmax(axis=1), seen.shape[1])
        margin = reduced.margin_s[runs][:, first].T
        is_avoided = margin > -np.inf
        amount = np.maximum(margin, 0.0)
        if worth is Objective.APR:
            amount = np.ones(margin.shape)
        values[:, runs] = np.where(is_avoided, amount, 0.0) * reduced.weight[runs]
    limits, supply = reduced.limits, build_supply(reduced.limits)
    forced = np.flatnonzero(limits.is_forced)
    at_site = np.bincount(limits.site_index[forced], minlength=limits.n_sites)
    spent = limits.unit_cost_eur[forced].sum() + limits.site_cost_eur[at_site > 0].sum()
    reached = values[forced].max(axis=0, initial=0.0)
    values[forced] = 0.0  # they cannot join once more
    return Coverage(
        values=values,
        supply=replace(
            supply,
            max_units=max(supply.max_units - len(forced), 0),
            site_capacity=np.maximum(supply.site_capacity - at_site, 0),
            site_cost_eur=np.where(at_site > 0, 0.0, limits.site_cost_eur),
            budget_eur=max(supply.budget_eur - float(spent), 0.0),
        ),
        reached=reached,
    )


def relaxed_limit(reduced: ReducedProblem, worth: Objective, *, n_steps: int = _STEPS) -> float:
    """No set within the limits is worth more: from Lagrangian multipliers, polished by OSQP."""
    coverage = build_coverage(reduced, worth)
    if coverage.supply.max_units == 0 or not coverage.n_rows:
        return float(coverage.floor.sum(dtype=np.float64))
    start = lazy_greedy(coverage)
    chosen = swap(coverage, start)
    target = coverage.value(chosen)
    tightened = tighten(
        coverage, first_multipliers(coverage, chosen), target=target, n_steps=n_steps
    )
    bound = polish(coverage, tightened).bound
    # All poses together are a limit, too.
    everything = float(np.maximum(coverage.values.max(axis=0), coverage.floor).sum())
    return min(bound.limit, everything)


def can_cover(problem: PlacementProblem, reduced: ReducedProblem) -> bool:
    """Whether the windows of a problem can be covered: see :func:`cover_windows`."""
    is_any = problem.fusion == "any" and reduced.measure.is_mean
    return is_any and len(reduced.weight) > 0 and not reduced.limits.is_forced.any()


def cover_windows(
    problem: PlacementProblem,
    reduced: ReducedProblem,
    worth: Objective,
    *,
    time_limit_s: float,
    branches: bool,
) -> tuple[WindowCover, float]:
    """A set of poses of the reduced problem that is worth much, and a limit that none exceeds.

    Limits of units, sites and money hold; wishes and rivals are left out, which only makes the
    limit higher. Without branches only relaxations bound it.
    """
    windows = timely_windows(problem.table.axis, problem.rule)
    weight = problem.table.axis.weight[windows.run_index, None]
    in_time = np.arange(windows.margin_s.shape[1]) < windows.n_windows[:, None]
    # Runs of equal weight count 1: no rounding, and limits may be rounded down to whole numbers.
    step = common_step(weight)
    unit = step or float(weight.max())
    amount, gap = weight / unit, 0.0
    is_whole = worth is Objective.APR and step > 0.0
    if is_whole:
        amount = amount.round()
        gap = _WHOLE_GAP / float(amount.sum())
    elif worth is Objective.MEAN_MARGIN:
        amount = amount * np.maximum(windows.margin_s, 0.0)
    cover = find_window_cover(
        problem.table.packed[reduced.pose_index],
        windows,
        np.where(in_time, amount, 0.0),
        build_supply(reduced.limits),
        gap=gap,
        time_limit_s=time_limit_s,
        branches=branches,
        workers=WORKERS,
    )
    return cover, unit * (np.floor(cover.limit + 1.0 - _WHOLE_GAP) if is_whole else cover.limit)


def can_enumerate(reduced: ReducedProblem, n_units: int) -> bool:
    """Whether sets of so many units beside the forced ones can be looked through."""
    limits = reduced.limits
    is_monotone = limits.budget_eur is None and not (
        len(limits.rivals) or limits.is_forced_site.any()
    )
    is_small = reduced.n_poses <= MAX_POSES and reduced.can_unpack
    return is_monotone and 1 <= n_units <= MAX_UNITS and is_small


def best_beyond(
    reduced: ReducedProblem,
    worth: Objective,
    need: float,
    *,
    n_units: int,
    known: SetValues,
    left_s: Callable[[], float],
) -> tuple[IntArray | None, bool]:
    """Best set of so many units beside the forced ones, among all that promise more than `need`.

    Only where :func:`can_enumerate` allows it, and only sets that are no worse than a `known` one.
    Returns the best set, forced units included, or None if there is none; and whether all were
    looked at: if not, there were too many, or no time is left.
    """
    coverage = build_coverage(reduced, worth).with_units(n_units)
    found = best_sets(coverage, need, max_triples=_MAX_TRIPLES, workers=WORKERS)
    if found is None or len(found.sets) > _MAX_SETS_BEST_OF:
        return None, False
    forced = np.flatnonzero(reduced.limits.is_forced)
    best = BestSet()
    for start in range(0, len(found.sets), _BLOCK_SETS):
        if left_s() <= 0.0:
            return best.units, False
        part = found.sets[start : start + _BLOCK_SETS]
        sets = np.column_stack([np.tile(forced, (len(part), 1)), part])
        if worth is Objective.MEAN_MARGIN:  # what is cheap to see comes first
            sets = _no_worse_before(reduced, sets, known, need)
        sets = sets[_worth(reduced, worth, sets) > need]
        if len(sets):
            best.offer(sets, set_values(reduced, sets))
    return best.units, True


def _no_worse_before(
    reduced: ReducedProblem, sets: IntArray, known: SetValues, need: float
) -> IntArray:
    """Sets that may reach a total margin without falling behind a known set in stages before."""
    if Objective.SMALLEST_MARGIN in reduced.objectives:
        smallest_s = float(known.of(Objective.SMALLEST_MARGIN)) - TOLERANCE
        sets = sets[may_keep_margins(reduced, sets, smallest_s=smallest_s, total_s=need)]
    if Objective.APR_ONE_FAILED in reduced.objectives and reduced.measure.is_mean:
        least = float(known.of(Objective.APR_ONE_FAILED)) - TOLERANCE
        sets = sets[keep_apr(reduced, sets, least, with_failures=True)]
    return sets


def _worth(reduced: ReducedProblem, worth: Objective, sets: IntArray) -> FloatArray:
    """What sets are really worth, (n_sets,)."""
    margin = union_margins_s(reduced, unions_of(reduced, sets))
    is_avoided = margin > -np.inf
    amount = is_avoided if worth is Objective.APR else np.where(is_avoided, margin, 0.0)
    total: FloatArray = amount @ reduced.weight
    return total
