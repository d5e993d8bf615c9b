"""First rung: layouts found quickly, without proof.

Greedy choice, then exchanges from many starts. With fusion "any" no guarantee
of quality holds: three units may be needed to complete one window. Exchanges
replace one unit by another, or leave one out, until that does not help; then
others are thrown out and drawn again.
"""

from collections.abc import Callable, Iterable

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from . import constants
from .allowed_sets import are_allowed, fitting, is_allowed
from .bitsets import (
    BestSet,
    SetValues,
    best_with_each,
    left_with_each,
    set_values,
    shares_with_each,
)
from .constants import NEVER, TOLERANCE, Deadline
from .presolve import ReducedProblem, presolve
from .problem import PlacementProblem


def solve_greedy(
    problem: PlacementProblem, reduced: ReducedProblem | None = None
) -> tuple[int, ...]:
    """Add, one by one, the pose with the highest APR; ties go to the later objectives.

    Returns rows of the detection table, ascending, within the limits if those leave
    greedy choice a way. No guarantee of quality holds with fusion "any": three units
    may be needed to complete one window.
    """
    if reduced is None:
        reduced = presolve(problem)
    return to_full(reduced, extend_greedily(reduced, forced_units(reduced)))


def to_full(reduced: ReducedProblem, units: IntArray) -> tuple[int, ...]:
    """Rows of the detection table of poses of the reduced problem, ascending."""
    return tuple(sorted(int(pose) for pose in reduced.pose_index[units]))


def forced_units(reduced: ReducedProblem) -> IntArray:
    """Poses that every set must have."""
    return np.flatnonzero(reduced.limits.is_forced)


def extend_greedily(reduced: ReducedProblem, units: IntArray) -> IntArray:
    """Add poses to `units` one by one, the best first, as long as there is room.

    With few or cheap units as the goal, once the floors are reached, by one unit at
    least, only those are added that a site still has to carry.
    """
    limits = reduced.limits
    is_enough = reduced.objectives[0].is_minimised
    while len(units) < limits.max_units:
        fits = fitting(limits, units)
        is_done = False
        if is_enough and len(units):
            is_done = bool(set_values(reduced, units[None, :]).lacking[0] == 0.0)
        if is_done:
            forced_sites = np.flatnonzero(limits.is_forced_site)
            missing = np.setdiff1d(forced_sites, limits.site_index[units])
            fits &= np.isin(limits.site_index, missing)
        free = np.flatnonzero(fits)
        if not len(free):
            break
        units = best_with_each(reduced, units, free)
    return units


def improve(
    reduced: ReducedProblem,
    units: IntArray,
    limit: SetValues,
    *,
    deadline: Deadline = NEVER,
) -> IntArray:
    """Exchange one unit for another, or leave one out, while the set gets better.

    Parameters
    ----------
    reduced : ReducedProblem
        The problem.
    units : (n,) int
        An allowed set.
    limit : SetValues
        No set is better: the search ends at a set that is as good.
    deadline : Deadline
        It ends here, too.
    """
    value = set_values(reduced, units[None, :])[0]
    place = 0
    while limit.exceeds(value):
        # Another pose for each unit; then without each, which is only cheaper.
        for step in range(2 * len(units)):
            number = (place + step) % len(units)
            if deadline.is_over:
                return units
            if reduced.limits.is_forced[units[number]]:
                continue
            trial = _exchanged(reduced, units, number, is_out=step >= len(units))
            if trial is None:
                continue
            of_trial = set_values(reduced, trial[None, :])[0]
            if of_trial.exceeds(value):
                units = trial
                value = of_trial
                # The next one has moved up.
                place = number
                break
        else:
            break
    return units


def _exchanged(
    reduced: ReducedProblem, units: IntArray, number: int, *, is_out: bool
) -> IntArray | None:
    """Best allowed set with another pose for one unit, or without it.

    `number` is the unit's place in `units`; with `is_out` it is left out. None if
    there is no such set.
    """
    rest = np.delete(units, number)
    if is_out:
        if is_allowed(reduced.limits, rest):
            return rest
        return None
    free = np.flatnonzero(fitting(reduced.limits, rest))
    free = free[free != units[number]]
    before = np.tile(rest, (len(free), 1))
    free = free[are_allowed(reduced.limits, np.column_stack([before, free]))]
    if len(free):
        return best_with_each(reduced, rest, free)
    return None


def search_from_many_starts(
    reduced: ReducedProblem,
    limit: SetValues,
    *,
    starts: Iterable[IntArray] = (),
    chance: Callable[[], FloatArray] | None = None,
    deadline: Deadline = NEVER,
) -> IntArray | None:
    """Best of local optima: of `starts`, of the greedy set, and of sets drawn.

    It ends at a set as good as `limit`, after one more than units in a row that
    brought nothing, or at the deadline, but completes the first start.

    Parameters
    ----------
    reduced : ReducedProblem
        The problem.
    limit : SetValues
        Upper bound of all sets.
    starts : iterable of (n,) int
        Sets that are tried first.
    chance : callable, optional
        Gives the weights, (n_poses,), by which poses are drawn, such as their
        shares in a relaxed solution; by default the square of what each reaches
        alone. It is called only if something is drawn.
    deadline : Deadline
        When to end.

    Returns
    -------
    units : (n,) int, optional
        None if no set within the limits was found; it may lack something to the
        floors.
    """
    rng = np.random.default_rng(constants.SEED)
    forced = forced_units(reduced)
    best = BestSet()
    idle = 0
    begin = [*starts, forced]
    weight: FloatArray | None = None
    for number in range(len(begin) + constants.N_RESTARTS):
        n_units = reduced.limits.max_units
        if best.units is not None:
            n_units = len(best.units)
        is_first = number < len(begin)
        if (not is_first and idle > n_units) or (number and deadline.is_over):
            break
        if not is_first and weight is None:
            if chance is None:
                alone = shares_with_each(reduced, forced) ** 2
                total = max(float(alone.sum()), constants.TINY)
                weight = alone / total + constants.ROUNDING
            else:
                weight = chance() + constants.ROUNDING
        # A set to begin with, one that is drawn, or the best with some units redrawn.
        if is_first or weight is None:
            units = begin[number]
        elif number % 2 or best.units is None:
            units = _drawn(reduced, rng, forced, weight, n_units - len(forced))
        else:
            n_out = int(rng.integers(1, max(2, n_units // 2 + 1)))
            kept = rng.permutation(best.units)[n_out:]
            units = np.union1d(kept, forced)
            units = _drawn(reduced, rng, units, weight, n_out - 1)
        units = extend_greedily(reduced, units)
        idle += 1
        if not is_allowed(reduced.limits, units):
            continue
        # Where the first objective cannot get better, failures count.
        is_full = False
        if best.values is not None:
            is_full = bool(best.values.gains[1] >= limit.gains[1] - TOLERANCE)
        if is_full:
            units = _spread(reduced, units, deadline=deadline)
        units = improve(reduced, units, limit, deadline=deadline)
        before = best.units
        best.offer(units[None, :], set_values(reduced, units[None, :]))
        if best.units is not before:
            idle = 0
        if best.values is not None and not limit.exceeds(best.values):
            break
    return best.units


def _drawn(
    reduced: ReducedProblem,
    rng: np.random.Generator,
    units: IntArray,
    chance: FloatArray,
    n_more: int,
) -> IntArray:
    """A set with some more poses, as far as there is room."""
    for _ in range(n_more):
        fits: BoolArray = fitting(reduced.limits, units)
        if not fits.any():
            break
        weight = np.where(fits, chance, 0.0)
        units = np.append(units, rng.choice(len(weight), p=weight / weight.sum()))
    return units


def _spread(
    reduced: ReducedProblem, units: IntArray, *, deadline: Deadline
) -> IntArray:
    """Exchange units while the APR and what is left of it on failure grow together.

    Where many sets have the best APR, the way to those that lose little leads
    through others.
    """
    value = -np.inf
    idle = 0
    place = 0
    is_forced = reduced.limits.is_forced
    while idle < len(units) and not deadline.is_over:
        rest = np.delete(units, place)
        fits = np.flatnonzero(fitting(reduced.limits, rest))
        idle += 1
        if len(fits) and not is_forced[units[place]]:
            share = shares_with_each(reduced, rest)
            left = left_with_each(reduced, rest, reduced.measure, 1)
            total = (share + left)[fits]
            best = int(total.argmax())
            trial = np.append(rest, fits[best])
            if total[best] > value + TOLERANCE and is_allowed(reduced.limits, trial):
                units = trial
                value = total[best]
                idle = 0
                # Those behind have moved up.
                place -= 1
        place = (place + 1) % len(units)
    return units
