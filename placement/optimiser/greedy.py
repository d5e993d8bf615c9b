"""Layouts found quickly, without proof: greedy choice, then exchanges one for one."""

import numpy as np

from geometry.arrays import FloatArray, IntArray

from .bitsets import best_row, best_set, set_values, values_with_each
from .presolve import ReducedProblem, presolve
from .problem import PlacementProblem, PlacementValue, is_better

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
        Rows of the detection table, ascending; feasible. No guarantee of quality holds with
        fusion "any": three units may be needed to complete one window.
    """
    reduced = presolve(problem) if reduced is None else reduced
    return to_full(problem, reduced, extend_greedily(reduced, np.empty(0, dtype=np.int64)))


def to_full(problem: PlacementProblem, reduced: ReducedProblem, units: IntArray) -> tuple[int, ...]:
    """Poses of the detection table, filled up to the budget with poses that had dropped out.

    Those add nothing to any objective that is proven; the ones that see most come first.
    """
    chosen = [int(pose) for pose in reduced.pose_index[units]]
    room = problem.site_capacity - np.bincount(
        problem.site_index[chosen], minlength=len(problem.site_capacity)
    )
    seen = np.bitwise_count(problem.table.packed).sum(axis=1, dtype=np.int64)
    for pose in np.argsort(-seen, kind="stable"):
        if len(chosen) == problem.budget_units:
            break
        if pose not in chosen and room[problem.site_index[pose]] > 0:
            chosen.append(int(pose))
            room[problem.site_index[pose]] -= 1
    return tuple(sorted(chosen))


def extend_greedily(reduced: ReducedProblem, units: IntArray) -> IntArray:
    """Add poses one by one, the best first, until budget or room is used up.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from.
    units : (n,) int
        Poses of the reduced problem that are chosen already.
    """
    while len(units) < reduced.budget_units:
        free = _poses_with_room(reduced, units)
        if len(free) == 0:
            break
        values = values_with_each(reduced, units)
        units = np.append(units, free[best_row(values[free])])
    return units


def improve(reduced: ReducedProblem, units: IntArray, limit: PlacementValue) -> IntArray:
    """Exchange one unit for another as long as that makes the set better.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from.
    units : (n,) int
        Poses of the reduced problem.
    limit : PlacementValue
        No set is better than this: one that is as good needs no exchange.

    Returns
    -------
    units : (n,) int
        At least as good; no single exchange improves it.
    """
    value = _value(reduced, units)
    while is_better(limit, value):
        sets, values = _exchanges(reduced, units)
        if len(sets) == 0:
            break
        row = best_row(values)
        best_value = PlacementValue(*map(float, values[row]))
        if not is_better(best_value, value):
            break
        units, value = sets[row], best_value
    return units


def solve_heuristically(reduced: ReducedProblem, limit: PlacementValue) -> IntArray:
    """Best of several local optima: the greedy set's, and those of random first units.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from.
    limit : PlacementValue
        No set is better than this: the search ends when one is as good.
    """
    rng = np.random.default_rng(_SEED)
    starts = [np.empty(0, dtype=np.int64)]
    if reduced.n_poses:
        starts += list(rng.integers(reduced.n_poses, size=(_N_RESTARTS, 1)))
    optima: list[IntArray] = []
    for start in starts:
        optima.append(improve(reduced, extend_greedily(reduced, start), limit))
        if not is_better(limit, _value(reduced, optima[-1])):
            return optima[-1]
    return best_set(reduced, np.array(optima))


def _poses_with_room(reduced: ReducedProblem, units: IntArray) -> IntArray:
    room = reduced.site_capacity - np.bincount(
        reduced.site_index[units], minlength=len(reduced.site_capacity)
    )
    is_free = room[reduced.site_index] > 0
    is_free[units] = False
    return np.flatnonzero(is_free)


def _exchanges(reduced: ReducedProblem, units: IntArray) -> tuple[IntArray, FloatArray]:
    """All feasible sets that differ from `units` in one pose, and their values."""
    sets, values = [np.empty((0, len(units)), dtype=np.int64)], [np.empty((0, 4))]
    for position in range(len(units)):
        left = np.delete(units, position)
        free = np.setdiff1d(_poses_with_room(reduced, left), units)
        sets.append(np.column_stack([np.tile(left, (len(free), 1)), free]))
        values.append(values_with_each(reduced, left)[free])
    return np.concatenate(sets), np.concatenate(values)


def _value(reduced: ReducedProblem, units: IntArray) -> PlacementValue:
    return PlacementValue(*(float(number) for number in set_values(reduced, units[None, :])[0]))
