"""All layouts that could still be better, gone through one by one.

Where there are few poses, that is all there are. Otherwise it is quick for up to three units:
a layout of K units that keeps an APR when any one of them fails consists of sets of K - 1 units
that all have that APR. Few have: to put together what they allow takes seconds where the cuts of
the models take minutes.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain, combinations, pairwise
from math import comb

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s

from .bitsets import (
    BestSet,
    SetValues,
    best_set,
    keep_apr,
    may_keep_margins,
    set_values,
    union_apr,
    unions_of,
    values_with_each,
)
from .bounds import Coverage, ValueArray
from .limits import Limits, are_allowed, costs_eur
from .objectives import Objective
from .presolve import ReducedProblem
from .tolerances import COST_TOLERANCE_EUR, ROUNDING_SINGLE, TOLERANCE

# ---------- all sets, or all that keep an APR


MAX_UNITS = 3
_PART_SETS = 1 << 14
_FIRST_POSES = 64


def best_of_few(
    reduced: ReducedProblem, *, max_sets: int, end_s: float = np.inf
) -> tuple[IntArray | None, bool]:
    """Best of all allowed sets, of any size, where they are few.

    Gives up if there are more than `max_sets`, or at `end_s` of `geometry.clock`. The units are
    None if it gave up or no set is allowed; the flag tells whether all sets were gone through.
    """
    n_poses, most = reduced.n_poses, reduced.limits.max_units
    n_sets = 0
    for n_units in range(1, most + 1):
        n_sets += comb(n_poses, n_units)
        if n_sets > max_sets:
            return None, False
    best = BestSet()
    alone = np.flatnonzero(are_allowed(reduced.limits, np.arange(n_poses)[:, None]))
    if len(alone):
        nothing = np.empty(0, dtype=np.int64)
        best.offer(alone[:, None], values_with_each(reduced, nothing)[alone])
    for n_units in range(2, most + 1):
        count = comb(n_poses, n_units)
        numbers = chain.from_iterable(combinations(range(n_poses), n_units))
        sets = np.fromiter(numbers, dtype=np.int64, count=count * n_units).reshape(-1, n_units)
        for part in _parts(sets[are_allowed(reduced.limits, sets)]):
            if not len(part):
                continue
            if now_s() > end_s:
                return best.units, False
            best.offer(part, set_values(reduced, part))
    return best.units, True


def best_of_all(
    reduced: ReducedProblem, units: IntArray, *, known: SetValues, max_sets: int
) -> IntArray | None:
    """Best set of as many units as `units` has that is as good when one unit fails.

    `known` is what these units are worth. The limits are plain, the APR is a weighted mean that no
    set exceeds theirs in, and they are three poses at most. None if there are more than `max_sets`
    sets to go through, of either size.
    """
    n_units = len(units)
    if n_units == 1 and reduced.n_poses <= max_sets:
        return best_set(reduced, np.arange(reduced.n_poses)[:, None])
    if not 2 <= n_units <= MAX_UNITS or comb(reduced.n_poses, n_units - 1) > max_sets:
        return None
    least = float(known.of(Objective.APR_ONE_FAILED)) - TOLERANCE
    kept = []
    for part in _parts_of_fewer(reduced.n_poses, n_units - 1):
        part = part[keep_apr(reduced, part, least)]
        kept.append(np.column_stack([part, union_apr(reduced, unions_of(reduced, part))]))
    # APR of what is left, by the ascending poses that are left; -1 where it is too low.
    table = np.full((reduced.n_poses,) * (n_units - 1), -1.0)
    for part in kept:
        table[tuple(part[:, :-1].astype(np.int64).T)] = part[:, -1]
    sets = _pairs(table, max_sets) if n_units == 2 else _triples(table, max_sets)
    if sets is None:
        return None
    known_smallest_s = float(known.of(Objective.SMALLEST_MARGIN))
    known_total_s = float(known.of(Objective.MEAN_MARGIN) * known.of(Objective.APR))
    best = BestSet()
    best.offer(units[None, :], set_values(reduced, units[None, :]))
    for part in _parts(sets[are_allowed(reduced.limits, sets)]):
        one_failed = np.min(
            [table[tuple(np.delete(part, unit, axis=1).T)] for unit in range(n_units)], axis=0
        )
        # Of sets that are no better when one fails, only those with better margins matter.
        may = one_failed > least + 2.0 * TOLERANCE
        for beyond_s, total_s in ((TOLERANCE, 0.0), (-TOLERANCE, known_total_s - TOLERANCE)):
            may |= may_keep_margins(
                reduced, part, smallest_s=known_smallest_s + beyond_s, total_s=total_s
            )
        if may.any():
            best.offer(part[may], set_values(reduced, part[may], one_failed[may]))
    return best.units


def _parts_of_fewer(n_poses: int, n_units: int) -> Iterator[IntArray]:
    """All poses, or all pairs of them, ascending, many at a time."""
    if n_units == 1:
        yield np.arange(n_poses)[:, None]
        return
    for first in range(0, n_poses, _FIRST_POSES):
        firsts = np.arange(first, min(first + _FIRST_POSES, n_poses))
        one, other = np.nonzero(np.arange(n_poses) > firsts[:, None])
        yield np.column_stack([firsts[one], other])


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


# ---------- sets of up to three poses that promise more than a need


MAX_POSES = 6000  # the table of pairs takes 4 bytes each: 144 MB
_FIRST_ROWS = 8
_BLOCK_SETS = 1 << 15
_BATCH_TRIPLES = 1 << 25
_MAX_SETS = 10_000_000
_BLOCK_SECONDS = 64
_SAMPLE = 4096

PairArray = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmallSets:
    """Sets that are worth more than a need."""

    sets: IntArray  # (n_sets, n_units): feasible, poses ascending in each, all that there are
    values: FloatArray  # (n_sets,): f of each
    n_looked_at: int  # sets that were looked at one by one


def best_sets(
    coverage: Coverage, need: float, *, max_triples: float = 1e9, workers: int = 1
) -> SmallSets | None:
    """All sets of up to three poses that promise more than `need`; None if they are too many.

    More than `max_triples` triples after the first step are too many (some ten million are gone
    through a second), and so are ten million sets. A `need` closer to an incumbent's value than the
    rounding of float32 values, 6e-8 of them, asks for float64 values. Raises ValueError for more
    than three units or 6000 poses.
    """
    n_units = coverage.supply.max_units
    if not 1 <= n_units <= MAX_UNITS or coverage.n_poses > MAX_POSES:
        raise ValueError(
            f"got {n_units} units and {coverage.n_poses} poses; "
            f"expected 1 to {MAX_UNITS} units and up to {MAX_POSES} poses"
        )
    values = np.maximum(coverage.values, coverage.floor)
    single = values.sum(axis=1, dtype=np.float64)
    order = np.argsort(-single, kind="stable")
    best = float(values.max(axis=0, initial=0.0).sum(dtype=np.float64))
    rough, rough_need = values[order].astype(np.float32), need - ROUNDING_SINGLE * best
    if n_units == 1:
        candidates = np.flatnonzero(single[order] > rough_need)[:, None]
    else:
        pairs = _pair_values(rough, workers)
        if n_units == 2:
            candidates = np.argwhere(np.triu(pairs > rough_need, k=1))
        else:
            counts = _count_triples(pairs, rough_need)
            if counts.sum() > max_triples:
                return None
            found: list[IntArray] = [np.empty((0, 3), dtype=np.int64)]
            batch = np.cumsum(counts) // _BATCH_TRIPLES  # of each apex
            for number in np.unique(batch):
                triples = _triples_small_sets(
                    pairs, rough_need, np.flatnonzero(batch == number), workers
                )
                found.append(_thinned(values[order], triples, rough_need, workers))
                if sum(map(len, found)) > _MAX_SETS:
                    return None
            candidates = np.concatenate(found)
    sets = np.sort(order[candidates], axis=1)
    sets = sets[coverage.supply.allows_each(sets)]
    worth = np.concatenate(
        [np.zeros(0)]
        + [
            values[sets[first : first + _BLOCK_SETS]].max(axis=1).sum(axis=1, dtype=np.float64)
            for first in range(0, len(sets), _BLOCK_SETS)
        ]
    )
    is_enough = worth > need
    return SmallSets(sets=sets[is_enough], values=worth[is_enough], n_looked_at=len(candidates))


def _pair_values(values: ValueArray, workers: int) -> PairArray:
    """F of every pair, (n_poses, n_poses); f of one pose on the diagonal."""
    n_poses = len(values)
    pairs = np.empty((n_poses, n_poses), dtype=np.float32)

    def work(pose: int) -> None:
        later = slice(pose, n_poses)
        pairs[pose, later] = np.maximum(values[later], values[pose]).sum(axis=1, dtype=np.float64)
        pairs[later, pose] = pairs[pose, later]

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, range(n_poses)))
    return pairs


def _partners(pairs: PairArray, need: float, apex: int) -> tuple[IntArray, IntArray]:
    """Later poses, the one that adds most to the apex first; and up to where each finds a third.

    The a-th and the b-th of them, a < b, add enough together if b is less than the a-th limit.
    """
    gain = pairs[apex, apex + 1 :] - pairs[apex, apex]
    order = np.argsort(-gain)
    falling = -gain[order]
    limit = np.searchsorted(falling, -falling - np.float32(need - pairs[apex, apex]), side="left")
    return order + apex + 1, limit


def _count_triples(pairs: PairArray, need: float) -> IntArray:
    """Triples that the apex of their best pose leaves over, by that pose."""
    counts = np.zeros(max(len(pairs) - 2, 0), dtype=np.int64)
    for apex in range(len(counts)):
        _, limit = _partners(pairs, need, apex)
        counts[apex] = np.maximum(limit - np.arange(1, len(limit) + 1), 0).sum()
    return counts


def _triples_small_sets(pairs: PairArray, need: float, apexes: IntArray, workers: int) -> IntArray:
    """Triples whose best pose is one of some, that all three apexes leave over, (n, 3)."""
    single = np.diagonal(pairs)

    def work(apex: int) -> list[IntArray]:
        partners, limit = _partners(pairs, need, apex)
        # Seen from j, i and k must add enough to it: f({j, k}) > need + f({j}) - f({i, j}).
        least = (need + single - pairs[apex])[partners]
        found = []
        for first in range(0, len(partners), _BLOCK_SECONDS):
            last = int(limit[first])
            if last <= first + 1:
                break
            seconds, thirds = slice(first, first + _BLOCK_SECONDS), slice(first + 1, last)
            block = pairs.take(partners[seconds], axis=0).take(partners[thirds], axis=1)
            is_enough = block > least[seconds, None]
            is_enough &= block > least[thirds]
            second, third = np.nonzero(is_enough)
            second, third = second + first, third + first + 1
            counts = (third > second) & (third < limit[second])
            second, third = partners[second[counts]], partners[third[counts]]
            found.append(np.column_stack([np.full(len(second), apex), second, third]))
        return found

    with ThreadPoolExecutor(workers) as pool:
        parts = [part for found in pool.map(work, apexes.tolist()) for part in found]
    return np.concatenate([np.empty((0, 3), dtype=np.int64), *parts])


def _thinned(values: FloatArray, sets: IntArray, need: float, workers: int) -> IntArray:
    """Sets that are worth more than a need, looked at a few rows at a time.

    What a set falls short of the best of all poses adds up row by row; most have fallen short by
    too much after the rows in which sets differ most.
    """
    if len(sets) == 0:
        return sets
    best = values.max(axis=0)
    short = (best - values).astype(np.float32)
    allowed = np.float32(best.sum(dtype=np.float64) - need)
    sample = sets[:: max(1, len(sets) // _SAMPLE)]
    order = np.argsort(-short[sample].min(axis=1).mean(axis=0), kind="stable")
    bounds = [0]
    while bounds[-1] < len(order):
        bounds.append(min(len(order), max(_FIRST_ROWS, 2 * bounds[-1])))
    parts = [np.ascontiguousarray(short[:, order[first:last]]) for first, last in pairwise(bounds)]

    def work(first: int) -> IntArray:
        left = sets[first : first + _BLOCK_SETS]
        so_far = np.zeros(len(left), dtype=np.float32)
        for part in parts:
            least = part.take(left[:, 0], axis=0)
            for pose in left.T[1:]:
                np.minimum(least, part.take(pose, axis=0), out=least)
            so_far += least.sum(axis=1)
            is_left = so_far <= allowed
            left, so_far = left[is_left], so_far[is_left]
        return left

    with ThreadPoolExecutor(workers) as pool:
        return np.concatenate(list(pool.map(work, range(0, len(sets), _BLOCK_SETS))))


# ---------- sets within a budget of money


_MAX_GROWN = 20_000_000  # sets that are looked at for their price alone


def best_affordable(
    reduced: ReducedProblem, *, least_apr: float, max_sets: int
) -> tuple[IntArray | None, bool]:
    """Best of all sets within limits of money, where they are few; the APR comes first.

    Sets with less than `least_apr`, that of a set at hand, are not looked at further. The units are
    None if there are more than `max_sets` sets, or none has that APR; the flag tells whether all
    sets were gone through.
    """
    sizes = affordable_sets(reduced.limits, max_sets=max_sets)
    if sizes is None:
        return None, False
    best = BestSet()
    for sets in sizes:
        for part in _parts(sets):
            part = part[union_apr(reduced, unions_of(reduced, part)) >= least_apr - TOLERANCE]
            if len(part):
                best.offer(part, set_values(reduced, part))
    return best.units, True


def affordable_sets(limits: Limits, *, max_sets: int) -> list[IntArray] | None:
    """All sets within limits, by their size: of 1, 2, .. poses, ascending.

    None if there are more sets than `max_sets`, or too many to find out.
    """
    poses = np.flatnonzero(~limits.is_forbidden)
    grown: IntArray = poses[:, None]
    grown = grown[_may_grow(limits, grown)]
    sizes: list[IntArray] = []
    n_sets = 0
    for n_units in range(1, limits.max_units + 1):
        sets = grown[are_allowed(limits, grown)]
        n_sets += len(sets)
        if n_sets > max_sets:
            return None
        sizes.append(sets)
        if n_units == limits.max_units or not len(grown):
            break
        if len(grown) * len(poses) > _MAX_GROWN:
            return None
        # A later pose than the last one: every set comes up once.
        first, later = np.nonzero(poses[None, :] > grown[:, -1:])
        grown = np.column_stack([grown[first], poses[later]])
        grown = grown[_may_grow(limits, grown)]
    return sizes


def _may_grow(limits: Limits, sets: IntArray) -> BoolArray:
    """Which sets fit into sites and money; what is forced may still be missing."""
    sites = limits.site_index[sets]
    n_beside = (sites[:, :, None] == sites[:, None, :]).sum(axis=2)
    fits: BoolArray = (n_beside <= limits.site_capacity[sites]).all(axis=1)
    if limits.budget_eur is not None:
        fits &= costs_eur(limits, sets) <= limits.budget_eur + COST_TOLERANCE_EUR
    return fits
