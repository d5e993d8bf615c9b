"""Columns and rows of a covering problem that do not matter drop out; and the way back.

The reductions are those of the set covering literature, which also make the instances of the
GECCO 2020 camera placement competition small: dominance of columns and of rows, essential
columns, independent parts [1]_ [2]_. Each is a function of its own and changes no optimum.

References
----------
.. [1] J. E. Beasley, "An algorithm for set covering problem", European Journal of Operational
   Research 31, 1987.
.. [2] "Weighting-based Variable Neighborhood Search for Optimal Camera Placement", HAL
   hal-04322244: four reduction rules based on dominance and independence.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from geometry.arrays import BoolArray, FloatArray, IntArray

from ..tolerances import ROUNDING
from .instance import CoveringInstance

# ---------- containment


WordArray = NDArray[np.uint64]

_MAX_WORDS = 64  # 4,096 bits to a signature: exact for so many members, a sieve for more
_BLOCK_BYTES = 1 << 25
_FIRST_WORDS = 4


def first_equal(sets: sp.csr_array) -> IntArray:
    """For every set, a row of `sets`, the first one with the same members, (n_sets,)."""
    first: dict[bytes, int] = {}
    members = (sets.indices[start:end].tobytes() for start, end in pairwise(sets.indptr))
    return np.array([first.setdefault(key, row) for row, key in enumerate(members)], dtype=np.int64)


def supersets(
    sets: sp.csr_array, price: FloatArray, *, max_work: float
) -> Iterator[tuple[int, IntArray]]:
    """For every set, the larger sets at no higher price of which it is a part: set, and those sets.

    Rows of `sets`, (n_sets, n_members), are neither equal nor empty. It gives up after `max_work`
    comparisons, beginning with sets that have the fewest candidates. A whole has the rarest member
    of its part: only sets with that one are compared, by signatures, and where there are more
    members than bits, member by member.
    """
    n_sets, n_members = sets.shape
    if n_sets == 0:
        return
    size = np.diff(sets.indptr)
    by_member = sets.T.tocsr()
    frequency = np.diff(by_member.indptr)
    rarest = _rarest_members(sets, frequency)
    words = _signatures(sets)
    is_exact = n_members <= 64 * words.shape[1]
    for part in np.argsort(frequency[rarest], kind="stable"):
        start, end = by_member.indptr[rarest[part]], by_member.indptr[rarest[part] + 1]
        max_work -= end - start
        if max_work < 0.0:
            return
        wholes: IntArray = by_member.indices[start:end].astype(np.int64)
        wholes = wholes[(size[wholes] > size[part]) & (price[wholes] <= price[part])]
        for some in (slice(0, _FIRST_WORDS), slice(_FIRST_WORDS, None)):  # few pass the first
            if len(wholes) and words[part, some].any():
                wholes = wholes[~(words[part, some] & ~words[wholes, some]).any(axis=1)]
        if len(wholes) and not is_exact:
            wholes = _containing(sets, _row(sets, part), wholes)
        if len(wholes):
            yield int(part), wholes


def _row(sets: sp.csr_array, row: int) -> IntArray:
    return sets.indices[sets.indptr[row] : sets.indptr[row + 1]].astype(np.int64)


def _rarest_members(sets: sp.csr_array, frequency: IntArray) -> IntArray:
    """The member of each set that is in fewest sets, (n_sets,)."""
    n_members = np.int64(sets.shape[1])
    keys = frequency[sets.indices].astype(np.int64) * n_members + sets.indices
    rarest: IntArray = np.minimum.reduceat(keys, sets.indptr[:-1]) % n_members
    return rarest


def _signatures(sets: sp.csr_array) -> WordArray:
    """One bit per member, or several members to a bit, (n_sets, n_words)."""
    n_sets, n_members = sets.shape
    n_words = min(-(-n_members // 64), _MAX_WORDS)
    words = np.empty((n_sets, n_words), dtype=np.uint64)
    block = max(1, _BLOCK_BYTES // (64 * n_words))
    for start in range(0, n_sets, block):
        end = min(start + block, n_sets)
        members = sets.indices[sets.indptr[start] : sets.indptr[end]]
        rows = np.repeat(np.arange(end - start), np.diff(sets.indptr[start : end + 1]))
        bits = np.zeros((end - start, 64 * n_words), dtype=np.bool_)
        bits[rows, members % (64 * n_words)] = True
        words[start:end] = np.packbits(bits, axis=1, bitorder="little").view(np.uint64)
    return words


def _containing(sets: sp.csr_array, members: IntArray, candidates: IntArray) -> IntArray:
    """Those candidates that have all the members."""
    is_member = np.zeros(sets.shape[1], dtype=np.bool_)
    is_member[members] = True
    return np.array(
        [
            candidate
            for candidate in candidates
            if np.count_nonzero(is_member[_row(sets, candidate)]) == len(members)
        ],
        dtype=np.int64,
    )


# ---------- reductions


_MAX_WORK = 5.0e8  # pairs of sets compared in one reduction: a minute at worst


@dataclass(frozen=True, slots=True, kw_only=True)
class CoveringPresolve:
    """What the presolve of a covering problem did."""

    # Before, after.
    n_columns: tuple[int, int]
    n_rows: tuple[int, int]
    n_idle_rows: int = 0  # rows without weight, or that no column covers
    # Columns that cover nothing that is left, or cost more than all the money.
    n_idle_columns: int = 0
    # Chosen already: free of charge, or the only ones that cover some row.
    n_essential_columns: int = 0
    n_equal_columns: int = 0  # columns that cover what another one covers, at no less cost
    n_dominated_columns: int = 0  # columns that cover less than another one, at no less cost
    # Columns that cost more than the cheapest columns of all their rows together.
    n_dear_columns: int = 0
    n_equal_rows: int = 0  # rows that are covered by the same columns as another one
    n_dominated_rows: int = 0  # rows that are covered whenever another one is
    n_components: int = 0  # independent parts that are left

    def __str__(self) -> str:
        sizes = (
            f"{before} -> {after} {noun}"
            for noun, (before, after) in (("columns", self.n_columns), ("rows", self.n_rows))
        )
        effects = (
            f"{getattr(self, field.name)} {field.name[2:].replace('_', ' ')}"
            for field in fields(self)[2:]
            if getattr(self, field.name) > (field.name == "n_components")  # one part is no news
        )
        return ", ".join((*sizes, *effects))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReducedCovering:
    """A covering problem without what does not matter."""

    instance: CoveringInstance  # what is left
    # (n_columns,): the columns that are left, in the full instance: the way back.
    column_index: IntArray
    essential: IntArray  # (n,): columns of the full instance that are chosen already
    statistics: CoveringPresolve  # what was done


class _Reduction:
    """The matrix while it shrinks: what is left of it, and what happened."""

    def __init__(self, instance: CoveringInstance) -> None:
        self.covers = instance.covers
        self.cost = instance.cost
        self.weight = instance.weight
        self.column_index = np.arange(instance.n_columns)
        self.essential = np.empty(0, dtype=np.int64)
        self.effects: dict[str, int] = {}

    def keep_columns(self, is_kept: BoolArray, effect: str) -> bool:
        """Drop the others, note how many they are; whether there are any."""
        n_dropped = len(is_kept) - int(np.count_nonzero(is_kept))
        if n_dropped:
            self.effects[effect] = self.effects.get(effect, 0) + n_dropped
            self.covers = self.covers[is_kept]
            self.cost = self.cost[is_kept]
            self.column_index = self.column_index[is_kept]
        return n_dropped > 0

    def keep_rows(self, is_kept: BoolArray, effect: str | None) -> bool:
        """Drop the others, note how many they are unless they are covered; whether any."""
        n_dropped = len(is_kept) - int(np.count_nonzero(is_kept))
        if n_dropped:
            if effect is not None:
                self.effects[effect] = self.effects.get(effect, 0) + n_dropped
            self.covers = self.covers[:, is_kept]
            self.weight = self.weight[is_kept]
        return n_dropped > 0

    def choose(self, columns: IntArray) -> bool:
        """Take columns, drop the rows that they cover; whether there are any."""
        if len(columns) == 0:
            return False
        self.essential = np.concatenate([self.essential, self.column_index[columns]])
        is_left = np.ones(self.covers.shape[1], dtype=np.bool_)
        is_left[self.covers[columns].indices] = False
        self.keep_columns(_all_but(columns, len(self.cost)), "n_essential_columns")
        self.keep_rows(is_left, None)
        return True

    def drop_idle_columns(self) -> None:
        self.keep_columns(np.diff(self.covers.indptr) > 0, "n_idle_columns")

    def drop_idle_rows(self) -> None:
        is_kept = (self.weight > 0.0) & (_row_sizes(self.covers) > 0)
        self.keep_rows(is_kept, "n_idle_rows")

    def drop_dominated_columns(self, price: FloatArray) -> bool:
        """Drop equal, then dominated columns; whether there were any."""
        is_kept = ~equal_columns(self.covers, price)
        has_dropped = self.keep_columns(is_kept, "n_equal_columns")
        is_dominated = dominated_columns(self.covers, price[is_kept])
        return self.keep_columns(~is_dominated, "n_dominated_columns") or has_dropped

    def finish(self, instance: CoveringInstance, n_components: int) -> ReducedCovering:
        return ReducedCovering(
            instance=CoveringInstance(covers=self.covers, cost=self.cost, weight=self.weight),
            column_index=self.column_index,
            essential=np.sort(self.essential),
            statistics=CoveringPresolve(
                n_columns=(instance.n_columns, self.covers.shape[0]),
                n_rows=(instance.n_rows, self.covers.shape[1]),
                n_components=n_components,
                **self.effects,
            ),
        )


def presolve_full_cover(instance: CoveringInstance) -> ReducedCovering:
    """Reduce the problem to cover, at least cost, every row with weight that can be covered.

    The optima of what is left, with the essential columns, are optima of the problem, at no other
    cost.
    """
    work = _Reduction(instance)
    work.drop_idle_rows()
    is_free = (work.cost == 0.0) & (np.diff(work.covers.indptr) > 0)
    work.choose(np.flatnonzero(is_free))
    goes_on = True
    while goes_on:
        work.drop_idle_columns()
        goes_on = work.choose(essential_columns(work.covers))
        goes_on |= work.keep_rows(~equal_rows(work.covers), "n_equal_rows")
        goes_on |= work.keep_rows(~dominated_rows(work.covers), "n_dominated_rows")
        goes_on |= work.keep_columns(~dear_columns(work.covers, work.cost), "n_dear_columns")
        work.drop_idle_columns()
        goes_on |= work.drop_dominated_columns(work.cost)
    n_components, _ = independent_components(work.covers)
    return work.finish(instance, n_components)


def presolve_weighted_cover(
    instance: CoveringInstance, *, minds_cost: bool, money: float = np.inf
) -> ReducedCovering:
    """Reduce a problem in which not every row has to be covered.

    `minds_cost` says whether cost matters, or only the number of columns. Any set of the columns
    that are left covers the same weight in the full problem; none is essential.
    """
    work = _Reduction(instance)
    work.drop_idle_rows()
    if work.keep_columns(work.cost <= money, "n_idle_columns"):
        work.drop_idle_rows()
    work.drop_idle_columns()
    work.drop_dominated_columns(work.cost if minds_cost else np.zeros(len(work.cost)))
    first = first_equal(sp.csr_array(work.covers.T))
    work.weight = np.bincount(first, weights=work.weight, minlength=len(first)).astype(np.float64)
    work.keep_rows(first == np.arange(len(first)), "n_equal_rows")
    n_components, _ = independent_components(work.covers)
    return work.finish(instance, n_components)


def essential_columns(covers: sp.csr_array) -> IntArray:
    """Columns that are the only ones to cover some row, (n,), ascending."""
    only = _row_sizes(covers) == 1
    has_one = only[covers.indices]
    columns = np.repeat(np.arange(covers.shape[0]), np.diff(covers.indptr))
    return np.unique(columns[has_one])


def equal_columns(covers: sp.csr_array, cost: FloatArray) -> BoolArray:
    """Columns that cover what another one covers, at no less cost, (n_columns,).

    Of equal columns at equal cost, the first one stays.
    """
    first = first_equal(covers)
    order = np.lexsort((np.arange(len(first)), cost, first))
    is_first = np.ones(len(first), dtype=np.bool_)
    is_first[1:] = first[order][1:] != first[order][:-1]
    is_equal = np.ones(len(first), dtype=np.bool_)
    is_equal[order[is_first]] = False
    return is_equal


def dominated_columns(
    covers: sp.csr_array, cost: FloatArray, *, max_work: float = _MAX_WORK
) -> BoolArray:
    """Columns that cover less than another one, at no less cost, (n_columns,).

    No two columns of `covers`, (n_columns, n_rows), are equal, and none covers nothing. Beyond
    `max_work` pairs of columns, dominated ones may stay.
    """
    is_dominated = np.zeros(covers.shape[0], dtype=np.bool_)
    for part, _ in supersets(covers, cost, max_work=max_work):
        is_dominated[part] = True
    return is_dominated


def dear_columns(covers: sp.csr_array, cost: FloatArray) -> BoolArray:
    """Columns that cost more than the cheapest columns of all their rows together, (n_columns,).

    Those cheapest columns are never dear themselves.
    """
    cheapest = np.full(covers.shape[1], np.inf)
    np.minimum.at(cheapest, covers.indices, np.repeat(cost, np.diff(covers.indptr)))
    together = np.asarray(covers @ cheapest, dtype=np.float64)
    return cost > together * (1.0 + ROUNDING)  # the same prices, summed up in another order


def equal_rows(covers: sp.csr_array) -> BoolArray:
    """Rows covered by the same columns as an earlier one, (n_rows,)."""
    first = first_equal(sp.csr_array(covers.T))
    return np.not_equal(first, np.arange(len(first)))


def dominated_rows(covers: sp.csr_array, *, max_work: float = _MAX_WORK) -> BoolArray:
    """Rows that are covered whenever another one is: by all its columns and more, (n_rows,).

    No two rows of `covers`, (n_columns, n_rows), are equal, and none is without columns. Beyond
    `max_work` pairs of rows, dominated ones may stay.
    """
    rows = sp.csr_array(covers.T)
    is_dominated = np.zeros(rows.shape[0], dtype=np.bool_)
    for _, wholes in supersets(rows, np.zeros(rows.shape[0]), max_work=max_work):
        is_dominated[wholes] = True
    return is_dominated


def independent_components(covers: sp.csr_array) -> tuple[int, IntArray]:
    """Parts of the problem that share no row: how many, and the part of each column.

    A column that covers nothing is a part by itself, a row that nothing covers is in none.
    """
    n_columns = covers.shape[0]
    graph = sp.block_array([[None, covers], [sp.csr_array(covers.T), None]], format="csr")
    if n_columns == 0:
        return 0, np.empty(0, dtype=np.int64)
    _, labels = connected_components(graph, directed=False)
    parts, part = np.unique(labels[:n_columns], return_inverse=True)
    return len(parts), part.astype(np.int64)


def _row_sizes(covers: sp.csr_array) -> IntArray:
    return np.bincount(covers.indices, minlength=covers.shape[1])


def _all_but(indices: IntArray, n: int) -> BoolArray:
    is_kept = np.ones(n, dtype=np.bool_)
    is_kept[indices] = False
    return is_kept
