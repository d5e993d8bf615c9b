"""All layouts that could still be better, gone through one by one.

Where there are few poses, that is all there are. Otherwise it is quick for up to three units:
a layout of K units that keeps an APR when any one of them fails consists of sets of K - 1 units
that all have that APR. Few have: to put together what they allow takes seconds where the cuts of
cuts.py take minutes.
"""

import time
from itertools import chain, combinations
from math import comb

import numpy as np

from geometry.arrays import FloatArray, IntArray

from .bitsets import best_row, best_set, exceeds, set_values, union_apr, unions_of
from .limits import are_allowed
from .presolve import ReducedProblem
from .problem import TOLERANCE

MAX_UNITS = 3
_PART_SETS = 1 << 14


def best_of_few(
    reduced: ReducedProblem, *, max_sets: int, end_s: float = np.inf
) -> tuple[IntArray | None, bool]:
    """Best of all allowed sets, of any size, where they are few.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from.
    max_sets : int
        Give up if there are more sets to go through.
    end_s : float
        Give up then, on the monotonic clock. [s]

    Returns
    -------
    units : (n,) int or None
        The best set; None: given up, or no set is allowed.
    is_complete : bool
        Whether all sets were gone through.
    """
    n_poses, most = reduced.n_poses, reduced.limits.max_units
    n_sets = 0
    for n_units in range(1, most + 1):
        n_sets += comb(n_poses, n_units)
        if n_sets > max_sets:
            return None, False
    best: IntArray | None = None
    best_value = np.empty(0)
    for n_units in range(1, most + 1):
        count = comb(n_poses, n_units)
        numbers = chain.from_iterable(combinations(range(n_poses), n_units))
        sets = np.fromiter(numbers, dtype=np.int64, count=count * n_units).reshape(-1, n_units)
        for part in _parts(sets[are_allowed(reduced.limits, sets)]):
            if not len(part):
                continue
            if time.monotonic() > end_s:
                return best, False
            values = set_values(reduced, part)
            row = best_row(values)
            if best is None or exceeds(values[row], best_value):
                best, best_value = part[row], values[row]
    return best, True


def best_of_all(
    reduced: ReducedProblem, units: IntArray, *, apr_one_failed: float, max_sets: int
) -> IntArray | None:
    """Best set of as many units that keep an APR when one unit fails.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from; its limits are plain.
    units : (n_units,) int
        A set that does, up to three poses of the reduced problem.
    apr_one_failed : float
        What must be kept.
    max_sets : int
        Give up if there are more sets to go through, of either size.

    Returns
    -------
    units : (n_units,) int or None
        None: given up.
    """
    n_units = len(units)
    if n_units == 1 and reduced.n_poses <= max_sets:
        return best_set(reduced, np.arange(reduced.n_poses)[:, None])
    if not 2 <= n_units <= MAX_UNITS or comb(reduced.n_poses, n_units - 1) > max_sets:
        return None
    fewer = (
        np.arange(reduced.n_poses)[:, None]
        if n_units == 2
        else np.column_stack(np.triu_indices(reduced.n_poses, k=1))
    )
    left = np.concatenate([union_apr(reduced, unions_of(reduced, part)) for part in _parts(fewer)])
    keeps = left >= apr_one_failed - TOLERANCE
    # APR of what is left, by the ascending poses that are left; -1 where it is too low.
    table = np.full((reduced.n_poses,) * (n_units - 1), -1.0)
    table[tuple(fewer[keeps].T)] = left[keeps]
    sets = _pairs(table, max_sets) if n_units == 2 else _triples(table, max_sets)
    if sets is None:
        return None
    sets = np.concatenate([np.sort(units)[None, :], sets[are_allowed(reduced.limits, sets)]])
    winners, values = [], []
    for part in _parts(sets):
        one_failed = np.min(
            [table[tuple(np.delete(part, unit, axis=1).T)] for unit in range(n_units)], axis=0
        )
        part_values = set_values(reduced, part, one_failed)
        row = best_row(part_values)
        winners.append(part[row])
        values.append(part_values[row])
    best: IntArray = winners[best_row(np.array(values))]
    return best


def _parts(sets: IntArray) -> list[IntArray]:
    return np.array_split(sets, max(1, -(-len(sets) // _PART_SETS)))


def _pairs(table: FloatArray, max_sets: int) -> IntArray | None:
    """Pairs, ascending, of poses in the table."""
    poses = np.flatnonzero(table >= 0.0)
    if comb(len(poses), 2) > max_sets:
        return None
    return poses[np.column_stack(np.triu_indices(len(poses), k=1))]


def _triples(table: FloatArray, max_sets: int) -> IntArray | None:
    """Triples, ascending, all pairs of which are in the table."""
    is_in = table >= 0.0
    n_between = is_in.astype(np.float32) @ is_in.astype(np.float32)
    if n_between[is_in].sum(dtype=np.float64) > max_sets:
        return None
    triples = [np.empty((0, 3), dtype=np.int64)]
    for first in range(len(table)):
        seconds = np.flatnonzero(is_in[first])
        which, thirds = np.nonzero(is_in[seconds] & is_in[first])
        triples.append(np.column_stack([np.full(len(thirds), first), seconds[which], thirds]))
    return np.concatenate(triples)
