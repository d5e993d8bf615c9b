"""Values of many sets of poses at once, on the bits of the reduced problem."""

from functools import lru_cache

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from .presolve import ReducedProblem, WordArray, pack_words, unpack_words
from .problem import TOLERANCE

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
    """Values of a set of poses together with each pose in turn: the four objectives.

    Parameters
    ----------
    reduced : ReducedProblem
        Windows and runs.
    units : (n_units,) int
        Poses of the reduced problem.

    Returns
    -------
    values : (n_poses, 4) float
        As :class:`placement.optimiser.problem.PlacementValue`; row c is that of `units` and c.

    Notes
    -----
    Bits run along the poses here, 64 sets to a word: an order of magnitude faster than
    :func:`set_values` of the same sets, one by one.
    """
    margin = _margins_with_each(reduced, units)
    one_failed = np.full(reduced.n_poses, 0.0 if len(units) == 0 else np.inf)
    if len(units):
        one_failed[:] = union_apr(reduced, unions_of(reduced, units[None, :]))[0]
        for failed in range(len(units)):
            left = aprs_with_each(reduced, np.delete(units, failed))
            one_failed = np.minimum(one_failed, left)
    return _values(reduced, margin, one_failed)


def aprs_with_each(reduced: ReducedProblem, units: IntArray) -> FloatArray:
    """Accident prevention ratio of a set of poses together with each pose in turn, (n_poses,)."""
    seen = _windows_with_each(reduced, units)
    avoided = np.zeros((len(reduced.weight), seen.shape[1]), dtype=np.uint64)
    in_time = (reduced.margin_s > -np.inf).sum(axis=1)
    for run, (chain, n_links) in enumerate(zip(reduced.run_chain, in_time, strict=True)):
        start = reduced.chain_start[chain]
        avoided[run] = np.bitwise_or.reduce(seen[start : start + n_links], axis=0)
    share: FloatArray = reduced.weight @ unpack_words(avoided, reduced.n_poses)
    return share


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
    share: FloatArray = (union_margins_s(reduced, unions) > -np.inf) @ reduced.weight
    return share


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
    """Values of sets of poses: the four objectives.

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
    values : (n_sets, 4) float
        As :class:`placement.optimiser.problem.PlacementValue`.
    """
    margin = union_margins_s(reduced, unions_of(reduced, sets))
    return _values(
        reduced, margin, one_failed_apr(reduced, sets) if one_failed is None else one_failed
    )


def _values(reduced: ReducedProblem, margin: FloatArray, one_failed: FloatArray) -> FloatArray:
    """Objectives from the margins of all runs, (n_sets, 4)."""
    is_avoided = margin > -np.inf
    share = is_avoided @ reduced.weight
    total = np.where(is_avoided, margin, 0.0) @ reduced.weight
    some = share > 0.0
    values = np.zeros((len(margin), 4))
    values[:, 0] = share
    values[:, 1] = one_failed
    values[:, 2] = np.where(is_avoided, margin, np.inf).min(axis=1, initial=np.inf)
    values[~some, 2] = 0.0
    values[some, 3] = total[some] / share[some]
    return values


def one_failed_apr(reduced: ReducedProblem, sets: IntArray) -> FloatArray:
    """Smallest accident prevention ratio when one unit fails, (n_sets,)."""
    n_units = sets.shape[1]
    smallest = np.full(len(sets), np.inf if n_units else 0.0)
    for failed in range(n_units):
        left = np.delete(sets, failed, axis=1)
        smallest = np.minimum(smallest, union_apr(reduced, unions_of(reduced, left)))
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
