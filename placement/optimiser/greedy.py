"""Layouts found quickly, without proof: greedy choice, then exchanges one for one."""

import time
from collections.abc import Sequence

import numpy as np

from geometry.arrays import FloatArray, IntArray

from .bitsets import N_COLUMNS, best_row, exceeds, set_values, values_with_each
from .limits import are_allowed, fitting, is_allowed
from .presolve import ReducedProblem, presolve
from .problem import PlacementProblem

_N_RESTARTS = 4
_SEED = 1


def solve_greedy(
    problem: PlacementProblem, reduced: ReducedProblem | None = None
) -> tuple[int, ...]:
    """Add, one by one, the pose with the highest APR; ties go to the later objectives.

    Parameters
    ----------
    problem : PlacementProblem
        What to solve.
    reduced : ReducedProblem, optional
        Its presolved form, where that is at hand.

    Returns
    -------
    pose_index : tuple of int
        Rows of the detection table, ascending; within the limits if those leave greedy choice a
        way. No guarantee of quality holds with fusion "any": three units may be needed to
        complete one window.
    """
    reduced = presolve(problem) if reduced is None else reduced
    return to_full(reduced, extend_greedily(reduced, forced_units(reduced)))


def to_full(reduced: ReducedProblem, units: IntArray) -> tuple[int, ...]:
    """Rows of the detection table of poses of the reduced problem, ascending."""
    return tuple(sorted(int(pose) for pose in reduced.pose_index[units]))


def forced_units(reduced: ReducedProblem) -> IntArray:
    """Poses that every set must have."""
    return np.flatnonzero(reduced.limits.is_forced)


def extend_greedily(reduced: ReducedProblem, units: IntArray) -> IntArray:
    """Add poses one by one, the best first, as long as there is room.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from.
    units : (n,) int
        Poses of the reduced problem that are chosen already.

    Returns
    -------
    units : (n,) int
        With few or cheap units as the goal, just enough for the floors; else needless ones, too:
        exchanges and removals take those away again.
    """
    max_units = reduced.limits.max_units
    while len(units) < max_units:
        if reduced.goal != "best" and set_values(reduced, units[None, :])[0, 0] == 0.0:
            break
        free = np.flatnonzero(fitting(reduced.limits, units))
        if len(free) == 0:
            break
        values = values_with_each(reduced, units)[free]
        units = np.append(units, free[best_row(values)])
    return units


def improve(
    reduced: ReducedProblem, units: IntArray, limit: FloatArray, *, end_s: float = np.inf
) -> IntArray:
    """Exchange one unit for another, or leave one out, as long as that makes the set better.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from.
    units : (n,) int
        Poses of the reduced problem.
    limit : (N_COLUMNS,) float
        No set is better than this, see :func:`placement.optimiser.bitsets.set_values`: one that is
        as good needs no exchange.
    end_s : float
        When to stop, on the monotonic clock. [s]

    Returns
    -------
    units : (n,) int
        At least as good; no single exchange or removal improves it.
    """
    value = set_values(reduced, units[None, :])[0]
    while exceeds(limit, value) and time.monotonic() < end_s:
        best = units, value
        positions = np.flatnonzero(~reduced.limits.is_forced[units])
        for change in (_exchanged, _without):  # to leave one out is only cheaper: tried last
            for position in positions:
                sets, values = change(reduced, np.delete(units, position), units[position])
                if len(sets):
                    row = best_row(values)
                    if exceeds(values[row], best[1]):
                        best = sets[row], values[row]
            if exceeds(best[1], value):
                break
        if not exceeds(best[1], value):
            break
        units, value = best
    return units


def solve_heuristically(
    reduced: ReducedProblem,
    limit: FloatArray,
    *,
    starts: Sequence[IntArray] = (),
    end_s: float = np.inf,
) -> IntArray | None:
    """Best of several local optima: the greedy set's, and those of random first units.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from.
    limit : (N_COLUMNS,) float
        No set is better than this: the search ends when one is as good.
    starts : sequence of (n,) int
        Sets to begin with, before any other.
    end_s : float
        When to stop, on the monotonic clock; the first start is completed. [s]

    Returns
    -------
    units : (n,) int or None
        Within the limits; what is lacking to the floors is as little as was found. None: no set
        within the limits was found.
    """
    rng = np.random.default_rng(_SEED)
    forced = forced_units(reduced)
    begin = [*starts, forced]
    first = np.flatnonzero(fitting(reduced.limits, forced))
    if len(first):
        begin += [np.append(forced, pose) for pose in rng.choice(first, size=_N_RESTARTS)]
    best: IntArray | None = None
    best_value = np.full(N_COLUMNS, -np.inf)
    for start in begin:
        if best is not None and time.monotonic() >= end_s:
            break
        units = extend_greedily(reduced, start)
        if not len(units) or not is_allowed(reduced.limits, units):
            continue
        units = improve(reduced, units, limit, end_s=end_s)
        value = set_values(reduced, units[None, :])[0]
        if best is None or exceeds(value, best_value):
            best, best_value = units, value
        if not exceeds(limit, best_value):
            break
    return best


def _without(reduced: ReducedProblem, left: IntArray, removed: int) -> tuple[IntArray, FloatArray]:
    """The set itself, if it is allowed, and its value."""
    sets = left[None, :]
    if not len(left) or not are_allowed(reduced.limits, sets)[0]:
        sets = sets[:0]
    return sets, set_values(reduced, sets)


def _exchanged(
    reduced: ReducedProblem, left: IntArray, removed: int
) -> tuple[IntArray, FloatArray]:
    """Allowed sets with another pose in place of the one removed, and their values."""
    free = np.flatnonzero(fitting(reduced.limits, left))
    free = free[free != removed]
    sets = np.column_stack([np.tile(left, (len(free), 1)), free])
    free, sets = free[are_allowed(reduced.limits, sets)], sets[are_allowed(reduced.limits, sets)]
    values = values_with_each(reduced, left)[free] if len(free) else np.empty((0, N_COLUMNS))
    return sets, values
