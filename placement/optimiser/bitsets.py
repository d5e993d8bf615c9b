"""Values of many sets of poses at once, on the bits of the reduced problem."""

from collections.abc import Callable
from functools import lru_cache
from itertools import combinations

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from .limits import cost_eur, costs_eur
from .presolve import (
    ReducedProblem,
    WordArray,
    pack_words,
    unpack_words,
)
from .problem import TOLERANCE, Measure

N_COLUMNS = 8
"""Columns of the values by which sets of poses are compared, from left to right."""
_BLOCK_BYTES = 1 << 25


def union_margins_s(reduced: ReducedProblem, unions: WordArray) -> FloatArray:
    """Margins of all runs, given which frames are seen.

    Parameters
    ----------
    reduced : ReducedProblem
        Windows and runs.
    unions : (n_sets, n_words) uint64
        Frames seen, as bits.

    Returns
    -------
    margin_s : (n_sets, n_runs) float
        Minus infinity where a run is not avoided. [s]
    """
    margin = np.empty((len(unions), len(reduced.weight)))
    size = max(reduced.n_frames, len(reduced.window_frames), 1)
    block = max(1, _BLOCK_BYTES // size)
    for start in range(0, len(unions), block):
        rows = slice(start, start + block)
        seen = unpack_words(unions[rows], reduced.n_frames)
        is_whole = seen[:, reduced.window_frames[:, 0]]
        for frames in reduced.window_frames.T[1:]:
            is_whole &= seen[:, frames]
        margin[rows] = _first_margins_s(reduced, is_whole)
    return margin


def _first_margins_s(reduced: ReducedProblem, is_whole: BoolArray) -> FloatArray:
    margin = np.empty((len(is_whole), len(reduced.weight)))
    for chain in range(reduced.n_chains):
        runs = np.flatnonzero(reduced.run_chain == chain)
        seen = is_whole[:, reduced.chain(chain)]
        first = np.where(seen.any(axis=1), seen.argmax(axis=1), seen.shape[1])
        margin[:, runs] = reduced.margin_s[runs][:, first].T
    return margin


def values_with_each(reduced: ReducedProblem, units: IntArray) -> FloatArray:
    """Values of a set of poses together with each pose in turn.

    Parameters
    ----------
    reduced : ReducedProblem
        Windows and runs.
    units : (n_units,) int
        Poses of the reduced problem.

    Returns
    -------
    values : (n_poses, N_COLUMNS) float
        As :func:`set_values`; row c is that of `units` and c.

    Notes
    -----
    Bits run along the poses here, 64 sets to a word: an order of magnitude faster than
    :func:`set_values` of the same sets, one by one.
    """
    limits = reduced.limits
    margin = _margins_with_each(reduced, units)
    is_new_site = ~np.isin(limits.site_index, limits.site_index[units])
    cost = cost_eur(limits, units) + limits.unit_cost_eur
    cost = cost + np.where(is_new_site, limits.site_cost_eur[limits.site_index], 0.0)

    return _values(
        reduced,
        margin,
        n_units=len(units) + 1,
        cost=cost,
        left=lambda measure, n_failures: _left_with_each(reduced, measure, n_failures, units),
    )


def _left_with_each(
    reduced: ReducedProblem, measure: Measure, n_failures: int, units: IntArray
) -> FloatArray:
    """What a set with each pose in turn still reaches when its worst units fail, (n_poses,)."""
    if n_failures > len(units):  # nothing is left then
        return np.zeros(reduced.n_poses)
    smallest = np.full(reduced.n_poses, np.inf)
    for failed in combinations(range(len(units)), n_failures):
        left = measure.of(avoided_with_each(reduced, np.delete(units, failed)))
        smallest = np.minimum(smallest, left)
    if n_failures:
        for failed in combinations(range(len(units)), n_failures - 1):
            union = unions_of(reduced, np.delete(units, failed)[None, :])
            is_avoided = union_margins_s(reduced, union)[0] > -np.inf
            smallest = np.minimum(smallest, measure.of(is_avoided))
    return smallest


def avoided_with_each(reduced: ReducedProblem, units: IntArray) -> BoolArray:
    """Runs that a set of poses together with each pose in turn avoids, (n_poses, n_runs)."""
    seen = _windows_with_each(reduced, units)
    avoided = np.zeros((len(reduced.weight), seen.shape[1]), dtype=np.uint64)
    in_time = (reduced.margin_s > -np.inf).sum(axis=1)
    for run, (chain, n_links) in enumerate(zip(reduced.run_chain, in_time, strict=True)):
        start = reduced.chain_start[chain]
        avoided[run] = np.bitwise_or.reduce(seen[start : start + n_links], axis=0)
    return unpack_words(avoided, reduced.n_poses).T


def _margins_with_each(reduced: ReducedProblem, units: IntArray) -> FloatArray:
    """Margins of all runs for a set together with each pose, (n_poses, n_runs)."""
    seen = _windows_with_each(reduced, units)
    first = np.empty((reduced.n_chains, reduced.n_poses), dtype=np.int64)
    for chain in range(reduced.n_chains):
        links = seen[reduced.chain_start[chain] : reduced.chain_start[chain + 1]]
        ever = unpack_words(np.bitwise_or.accumulate(links, axis=0), reduced.n_poses)
        first[chain] = len(links) - ever.sum(axis=0, dtype=np.int64)
    margin = np.empty((reduced.n_poses, len(reduced.weight)))
    for run, chain in enumerate(reduced.run_chain):
        margin[:, run] = reduced.margin_s[run][first[chain]]
    return margin


def _windows_with_each(reduced: ReducedProblem, units: IntArray) -> WordArray:
    """Windows of all chains that a set and each pose see as a whole, bits along the poses."""
    union = unpack_words(unions_of(reduced, units[None, :])[0], reduced.n_frames)
    frames = _columns(reduced).copy()
    frames[union] = ~np.uint64(0)
    windows = frames[reduced.window_frames[:, 0]]
    for column in reduced.window_frames.T[1:]:
        windows &= frames[column]
    links: WordArray = windows[reduced.chain_window]
    return links


@lru_cache(maxsize=2)
def _columns(reduced: ReducedProblem) -> WordArray:
    """V[c, f] with bits along the poses, (n_frames, n_words)."""
    return pack_words(np.ascontiguousarray(reduced.detected().T))


def union_apr(reduced: ReducedProblem, unions: WordArray) -> FloatArray:
    """Accident prevention ratio given which frames are seen, (n_sets,)."""
    return reduced.measure.of(union_margins_s(reduced, unions) > -np.inf)


def unions_of(reduced: ReducedProblem, sets: IntArray) -> WordArray:
    """Frames that sets of poses see.

    Parameters
    ----------
    reduced : ReducedProblem
        Its poses.
    sets : (n_sets, n_units) int
        Poses of the reduced problem.

    Returns
    -------
    unions : (n_sets, n_words) uint64
        Bits; none for a set without units.
    """
    unions = np.zeros((len(sets), reduced.words.shape[1]), dtype=np.uint64)
    for units in sets.T:
        unions |= reduced.words[units]
    return unions


def set_values(
    reduced: ReducedProblem, sets: IntArray, one_failed: FloatArray | None = None
) -> FloatArray:
    """Values of sets of poses, each column the larger the better.

    Parameters
    ----------
    reduced : ReducedProblem
        Windows and runs.
    sets : (n_sets, n_units) int
        Poses of the reduced problem.
    one_failed : (n_sets,) float, optional
        Their APR when one unit fails, where that is known.

    Returns
    -------
    values : (n_sets, N_COLUMNS) float
        What is lacking to the floors, negative; units or cost, negative, where the goal is few or
        cheap ones; the APR that survives failures where that is asked for; then the fields of
        :class:`placement.optimiser.problem.PlacementValue`, the cost negative, or their weighted
        sum.
    """
    margin = union_margins_s(reduced, unions_of(reduced, sets))

    def left(measure: Measure, n_failures: int) -> FloatArray:
        if n_failures == 1 and measure is reduced.measure and one_failed is not None:
            return one_failed
        return left_after_failures(reduced, measure, n_failures, sets)

    return _values(
        reduced,
        margin,
        n_units=sets.shape[1],
        cost=costs_eur(reduced.limits, sets),
        left=left,
    )


def _values(
    reduced: ReducedProblem,
    margin: FloatArray,
    *,
    n_units: int,
    cost: FloatArray,
    left: Callable[[Measure, int], FloatArray],
) -> FloatArray:
    """Values from the margins of all runs and what is left after failures."""
    is_avoided = margin > -np.inf
    share = is_avoided @ reduced.weight
    total = np.where(is_avoided, margin, 0.0) @ reduced.weight
    some = share > 0.0
    values = np.zeros((len(margin), N_COLUMNS))
    for floor in reduced.floors:
        lacking = floor.least - TOLERANCE - left(floor.measure, floor.n_failures)
        values[:, 0] -= np.maximum(lacking, 0.0)
    if reduced.goal == "fewest":
        values[:, 1] = -n_units
    elif reduced.goal == "cheapest":
        values[:, 1] = -cost
    if reduced.survive:
        values[:, 2] = left(reduced.measure, reduced.survive)
    values[:, 3] = reduced.measure.of(is_avoided)
    values[:, 4] = left(reduced.measure, 1)
    values[:, 5] = np.where(is_avoided, margin, np.inf).min(axis=1, initial=np.inf)
    values[~some, 5] = 0.0
    values[some, 6] = total[some] / share[some]
    values[:, 7] = -cost
    if reduced.stage_weights is not None:
        values[:, 3] = values[:, 3:] @ np.array(reduced.stage_weights)
        values[:, 4:] = 0.0
    return values


def left_after_failures(
    reduced: ReducedProblem, measure: Measure, n_failures: int, sets: IntArray
) -> FloatArray:
    """What sets of poses still reach when the worst of their units fail, (n_sets,)."""
    n_units = sets.shape[1]
    if n_failures > n_units:
        return np.zeros(len(sets))
    smallest = np.full(len(sets), np.inf)
    for failed in combinations(range(n_units), n_failures):
        unions = unions_of(reduced, np.delete(sets, failed, axis=1))
        left = measure.of(union_margins_s(reduced, unions) > -np.inf)
        smallest = np.minimum(smallest, left)
    return smallest


def best_set(reduced: ReducedProblem, sets: IntArray) -> IntArray:
    """First set of poses whose value no other one exceeds.

    Parameters
    ----------
    reduced : ReducedProblem
        Windows and runs.
    sets : (n_sets, n_units) int
        At least one. Poses of the reduced problem.

    Returns
    -------
    units : (n_units,) int
        A row of `sets`.
    """
    if not (reduced.floors or reduced.survive or reduced.goal != "best" or reduced.stage_weights):
        share = union_apr(reduced, unions_of(reduced, sets))
        # Failures are costly to go through: only sets with the best APR need it.
        sets = sets[share >= share.max() - TOLERANCE]
    best: IntArray = sets[best_row(set_values(reduced, sets))]
    return best


def best_row(values: FloatArray) -> int:
    """First row that no other one exceeds, compared from left to right."""
    rows = np.arange(len(values))
    for column in values.T:
        rows = rows[column[rows] >= column[rows].max() - TOLERANCE]
    return int(rows[0])


def exceeds(value: FloatArray, other: FloatArray) -> bool:
    """Whether the first difference that exceeds rounding noise favours `value`."""
    differs = np.flatnonzero(np.abs(value - other) > TOLERANCE)
    return bool(len(differs)) and bool(value[differs[0]] > other[differs[0]])
