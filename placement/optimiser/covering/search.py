"""All sets of a few columns that could still cover more, gone through exactly: for small budgets.

Coverage is submodular: what a set adds is never more than its members add one by one. Columns are
sorted by what they add; a branch ends where even the sum of the next ones is not enough. The last
three columns need no branches. With the weight g_i that a column covers, o_ij that two share and
o_ijk that three share, three columns cover

    g_i + g_j + g_k - o_ij - o_ik - o_jk + o_ijk,   o_ijk <= min(o_ij, o_ik, o_jk),

all o_ij of which come from one matrix product. Few triples pass this bound; those are counted.
"""

import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.arrays import FloatArray, IntArray

MAX_UNITS = 8
"""Budgets for which it is worth a try."""

SURE_UNITS = 3
"""Budgets for which it comes to an end: the last three columns need no branches."""

_MAX_CELLS = 1.0e8  # of the dense matrix, and of the overlaps of all pairs
_BLOCK = 1 << 22  # cells worked on at once
_GATHER_PENALTY = 20  # a pair picked out costs as much as so many of a matrix product
_EXACT_FLOAT32 = 1 << 24  # whole numbers up to it have no rounding error in float32

NumberArray = NDArray[Any]  # float32 where that is exact, else float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchResult:
    """What the search found."""

    chosen: IntArray  # (n,): the best columns known
    covered_weight: float  # of them
    bound: float  # no set of so many columns covers more


def search_best_columns(
    covers: sp.csr_array,
    weight: FloatArray,
    *,
    n_units: int,
    start: IntArray,
    time_limit_s: float,
    gap: float = 0.0,
) -> SearchResult | None:
    """The columns that together cover most, among all sets of so many.

    `covers` is (n_columns, n_rows). The search only looks for sets that cover more than `start`,
    and more than the best one by more than the share `gap`. None if the problem is too large for
    this search; nothing was done then.
    """
    search = _Search(covers, weight, start, time.perf_counter() + time_limit_s, gap)
    gain = search.gain(covers)
    columns = search.worth_a_look(gain, n_units)
    if len(columns) * max(covers.shape[1], len(columns)) > _MAX_CELLS:
        return None
    if len(columns) >= n_units:
        dense = covers[columns].toarray().astype(search.weight.dtype)
        is_used = dense.any(axis=0)
        search.run(dense[:, is_used], search.weight[is_used], columns, n_units)
    return SearchResult(
        chosen=np.sort(np.array(search.best, dtype=np.int64)),
        covered_weight=search.best_weight,
        bound=search.bound,
    )


class _Search:
    """The best set so far, and how long to go on."""

    def __init__(
        self,
        covers: sp.csr_array,
        weight: FloatArray,
        start: IntArray,
        deadline_s: float,
        gap: float,
    ) -> None:
        is_whole = bool((weight == np.round(weight)).all()) and weight.sum() < _EXACT_FLOAT32
        self.weight: NumberArray = weight.astype(np.float32) if is_whole else weight
        # Whole numbers differ by 1 or not at all; sums of others differ by rounding.
        self.tolerance = 0.5 if is_whole else 1.0e-12 * float(weight.sum())
        self.best: tuple[int, ...] = tuple(int(column) for column in start)
        self.best_weight = float(weight[np.unique(covers[start].indices)].sum())
        self.deadline_s = deadline_s
        self.gap = gap
        self.open_limit = -np.inf

    @property
    def bound(self) -> float:
        """No set covers more."""
        return max(self.best_weight * (1.0 + self.gap), self.open_limit)

    @property
    def threshold(self) -> float:
        """What a set must exceed to be looked for."""
        return self.best_weight * (1.0 + self.gap) + self.tolerance

    def is_over(self) -> bool:
        return time.perf_counter() > self.deadline_s

    def gain(self, covers: sp.csr_array) -> NumberArray:
        """Weight that each column covers."""
        sums = np.zeros(covers.indices.size + 1)
        np.cumsum(self.weight[covers.indices], out=sums[1:], dtype=np.float64)
        gain: NumberArray = (sums[covers.indptr[1:]] - sums[covers.indptr[:-1]]).astype(
            self.weight.dtype
        )
        return gain

    def worth_a_look(self, gain: NumberArray, n_units: int, base: float = 0.0) -> IntArray:
        """Columns that can be part of a better set, those that add most first."""
        order = np.argsort(-gain, kind="stable")
        most = float(gain[order[: n_units - 1]].sum(dtype=np.float64))
        is_enough = gain[order] > self.threshold - base - most
        columns: IntArray = order[: np.count_nonzero(is_enough)]
        return columns

    def note(self, weight: float, columns: tuple[int, ...]) -> None:
        if weight > self.best_weight + self.tolerance:
            self.best_weight, self.best = weight, columns

    def run(
        self,
        covers: NumberArray,
        weight: NumberArray,
        columns: IntArray,
        n_units: int,
        base: float = 0.0,
        prefix: tuple[int, ...] = (),
    ) -> None:
        """Look for `n_units` more columns beside those of `prefix`, which cover `base`.

        `covers` and `weight` are of the rows that `prefix` leaves.
        """
        gain = covers @ weight
        kept = self.worth_a_look(gain, n_units, base)
        if len(kept) < n_units:
            return
        covers, gain, columns = covers[kept], gain[kept], columns[kept]
        if n_units == 1:
            self.note(base + float(gain[0]), (*prefix, int(columns[0])))
            return
        overlap = (covers * weight) @ covers.T if n_units <= 3 else gain
        branch = _Branch(covers, weight, columns, gain, overlap)
        for i in range(len(columns) - n_units + 1):
            limit = base + float(gain[i : i + n_units].sum(dtype=np.float64))
            if limit <= self.threshold:
                return
            if self.is_over():
                self.open_limit = limit
                return
            added, chosen = base + float(gain[i]), (*prefix, int(columns[i]))
            if n_units == 2:
                value = gain[i + 1 :] - overlap[i, i + 1 :]
                j = int(value.argmax())
                self.note(added + float(value[j]), (*chosen, int(columns[i + 1 + j])))
            elif n_units == 3:
                self._pairs(branch, i, added, chosen)
            else:
                is_left = covers[i] == 0.0
                self.run(
                    np.ascontiguousarray(covers[i + 1 :, is_left]),
                    weight[is_left],
                    columns[i + 1 :],
                    n_units - 1,
                    added,
                    chosen,
                )
                if self.open_limit > -np.inf:  # what is open in the branch is open here
                    self.open_limit = limit
                    return

    def _pairs(self, branch: "_Branch", i: int, base: float, prefix: tuple[int, ...]) -> None:
        """Look for two more columns after the i-th, with which `prefix` ends."""
        added = branch.gain[i + 1 :] - branch.overlap[i, i + 1 :]
        kept = i + 1 + self.worth_a_look(added, 2, base)
        if len(kept) < 2:
            return
        added, shared = added[kept - i - 1], branch.overlap[i, kept]
        # Of two columns, the one that adds more stands first.
        n_first = int(np.count_nonzero(added[:-1] + added[1:] > self.threshold - base))
        size = max(1, _BLOCK // len(kept))
        for start in range(0, n_first, size):
            first = np.arange(start, min(n_first, start + size))
            twice = branch.overlap[np.ix_(kept[first], kept)]
            not_thrice = np.maximum(twice - np.minimum(shared[first, None], shared), 0.0)
            at_most = added[first, None] + added - not_thrice
            a, b = np.nonzero(at_most > self.threshold - base)
            is_pair = b > first[a]
            a, b = a[is_pair], b[is_pair]
            if len(a) == 0:
                continue
            rows = np.flatnonzero(branch.covers[i])
            seconds = np.unique(b)
            thrice = _shared_by_three(
                branch.covers[np.ix_(kept[first], rows)],
                branch.covers[np.ix_(kept[seconds], rows)],
                branch.weight[rows],
                a,
                np.searchsorted(seconds, b),
            )
            value = added[first[a]] + added[b] - twice[a, b] + thrice
            best = int(value.argmax())
            pair = (int(branch.columns[kept[c]]) for c in (first[a[best]], b[best]))
            self.note(base + float(value[best]), (*prefix, *pair))


class _Branch(NamedTuple):
    """Columns that are worth a look, those that add most first."""

    covers: NumberArray
    weight: NumberArray
    columns: IntArray
    gain: NumberArray
    overlap: NumberArray


def _shared_by_three(
    first: NumberArray, second: NumberArray, weight: NumberArray, a: IntArray, b: IntArray
) -> NumberArray:
    """Weight of the rows that first[a] and second[b] share; all rows are those of a third."""
    weighted = first * weight
    if len(a) * _GATHER_PENALTY > len(first) * len(second):
        all_pairs: NumberArray = (weighted @ second.T)[a, b]
        return all_pairs
    chunk = max(1, _BLOCK // max(1, len(weight)))
    parts = [
        np.einsum("pr,pr->p", weighted[a[start : start + chunk]], second[b[start : start + chunk]])
        for start in range(0, len(a), chunk)
    ]
    return np.concatenate(parts)
