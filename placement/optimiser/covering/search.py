"""Answers to covering problems: good ones quickly, and best ones for small budgets.

Without proof: greedy choice, then local search, which exchanges one for one where the budget is
given, and ruins and recreates where the target is. All of it repeats itself exactly: chance has a
fixed seed. Bounds that cost nothing stand beside it.

With proof: all sets of a few columns that could still cover more are gone through. Coverage is
submodular: what a set adds is never more than its members add one by one. Columns are sorted by
what they add; a branch ends where even the sum of the next ones is not enough. The last three
columns need no branches. With the weight g_i that a column covers, o_ij that two share and o_ijk
that three share, three columns cover

    g_i + g_j + g_k - o_ij - o_ik - o_jk + o_ijk,   o_ijk <= min(o_ij, o_ik, o_jk),

all o_ij of which come from one matrix product. Few triples pass this bound; those are counted.
"""

import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray

from ...memory import available_bytes
from ..tolerances import ROUNDING
from .instance import CoveringBudget

_TRACE = 1.0e-3  # of the tolerance: what running sums may be off
_MIN_RUINED_SHARE, _MAX_RUINED_SHARE = 0.05, 0.35
_MAX_EXCHANGES = 1000
_SEED = 1


class _Cover:
    """Chosen columns and how often each row is covered, while they change."""

    def __init__(self, covers: sp.csr_array, weight: FloatArray) -> None:
        self.covers = covers
        self.by_row = sp.csr_array(covers.T)
        self.weight = weight
        self.times = np.zeros(covers.shape[1], dtype=np.int64)
        self.is_chosen = np.zeros(covers.shape[0], dtype=np.bool_)
        self.gain = np.asarray(covers @ weight, dtype=np.float64)

    def refresh(self) -> None:
        """Sum up what each column would add: running sums of numbers that are not whole drift."""
        self.gain = self.gains(np.flatnonzero(self.times == 0))

    def gains(self, rows: IntArray) -> FloatArray:
        """Weight of some rows, by the columns that cover them, (n_columns,)."""
        size = np.diff(self.by_row.indptr)[rows]
        columns = _slices(self.by_row, rows)
        return np.bincount(
            columns, weights=np.repeat(self.weight[rows], size), minlength=len(self.is_chosen)
        ).astype(np.float64)

    def rows_of(self, column: int) -> IntArray:
        start, end = self.covers.indptr[column], self.covers.indptr[column + 1]
        return self.covers.indices[start:end].astype(np.int64)

    def add(self, column: int) -> None:
        rows = self.rows_of(column)
        self.gain -= self.gains(rows[self.times[rows] == 0])
        self.times[rows] += 1
        self.is_chosen[column] = True

    def remove(self, column: int) -> None:
        rows = self.rows_of(column)
        self.times[rows] -= 1
        self.gain += self.gains(rows[self.times[rows] == 0])
        self.is_chosen[column] = False

    def loss(self, column: int) -> float:
        """Weight of the rows that only this chosen column covers."""
        rows = self.rows_of(column)
        return float(self.weight[rows[self.times[rows] == 1]].sum())

    @property
    def covered_weight(self) -> float:
        return float(self.weight[self.times > 0].sum())

    def chosen(self) -> IntArray:
        return np.flatnonzero(self.is_chosen)


def cover_cheaply(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    *,
    needed_weight: float,
    n_rounds: int,
    time_limit_s: float,
) -> IntArray:
    """Columns that cover a weight, at little cost.

    `covers` is (n_columns, n_rows), and all columns together cover the weight. The best answer is
    ruined in part and made whole again `n_rounds` times. None of the columns, which are ascending,
    can be left out.
    """
    cover = _Cover(covers, weight)
    slack = ROUNDING * float(weight.sum())
    _complete(cover, cost, needed_weight, slack)
    _drop_redundant(cover, cost, needed_weight, slack)
    best = cover.chosen()
    rng = np.random.default_rng(_SEED)
    deadline_s = time.perf_counter() + time_limit_s
    for _ in range(n_rounds):
        if len(best) == 0 or time.perf_counter() > deadline_s:
            break
        share = rng.uniform(_MIN_RUINED_SHARE, _MAX_RUINED_SHARE)
        chosen = cover.chosen()
        n_ruined = min(len(chosen), max(1, round(share * len(chosen))))
        for column in rng.choice(chosen, size=n_ruined, replace=False):
            cover.remove(int(column))
        # Another order of choice than the greedy one: prices as if they were a little different.
        _complete(cover, cost * rng.uniform(0.8, 1.25, len(cost)), needed_weight, slack)
        _drop_redundant(cover, cost, needed_weight, slack)
        if cost[cover.is_chosen].sum() <= cost[best].sum():
            best = cover.chosen()
        else:
            for column in np.setdiff1d(cover.chosen(), best):
                cover.remove(int(column))
            for column in np.setdiff1d(best, cover.chosen()):
                cover.add(int(column))
    return best


def cover_much(
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, budget: CoveringBudget
) -> IntArray:
    """Columns within a budget that cover much.

    They are ascending, and no exchange of one for another covers more. With a number of columns
    only, even the greedy choice covers at least 1 - 1/e = 63 % of the optimum (Nemhauser, Wolsey,
    Fisher 1978); with money there is no such guarantee.
    """
    best, best_weight = np.empty(0, dtype=np.int64), -1.0
    prices = [np.ones(len(cost))] if budget.cost is None else [np.ones(len(cost)), cost]
    for price in prices:  # what covers most, or most for its price
        cover = _Cover(covers, weight)
        _fill(cover, cost, price, budget)
        _exchange(cover, cost, price, budget)
        if cover.covered_weight > best_weight:
            best, best_weight = cover.chosen(), cover.covered_weight
    return best


def drop_redundant(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    chosen: IntArray,
    *,
    needed_weight: float,
) -> IntArray:
    """Those of some columns that are needed to cover a weight, the dearest being left out first."""
    cover = _Cover(covers[chosen], weight)
    for column in range(len(chosen)):
        cover.add(column)
    _drop_redundant(cover, cost[chosen], needed_weight, ROUNDING * float(weight.sum()))
    return chosen[cover.is_chosen]


def least_cost_bound(
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, *, needed_weight: float
) -> float:
    """A cost below which no columns cover a weight.

    No column covers weight for less than its own price per weight: each row is charged the least
    such price among its columns, the cheapest rows are taken first, and the last one in part.
    With all rows needed, a feasible solution of the linear program's dual.
    """
    sizes = np.diff(covers.indptr)
    covered = np.asarray(covers @ weight, dtype=np.float64)
    price = np.divide(cost, covered, out=np.full(len(cost), np.inf), where=covered > 0.0)
    least = np.full(covers.shape[1], np.inf)
    np.minimum.at(least, covers.indices, np.repeat(price, sizes))
    order = np.argsort(least, kind="stable")
    before = np.cumsum(weight[order]) - weight[order]
    taken = np.clip(needed_weight - before, 0.0, weight[order])
    is_taken = taken > 0.0
    return float(least[order][is_taken] @ taken[is_taken])


def most_weight_bound(
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, budget: CoveringBudget
) -> float:
    """A weight that no columns within a budget exceed: as if no two covered the same row."""
    gain = np.asarray(covers @ weight, dtype=np.float64)
    bound = float(weight.sum())
    if budget.units is not None:
        bound = min(bound, float(np.sort(gain)[::-1][: budget.units].sum()))
    if budget.cost is not None:
        order = np.argsort(
            -np.divide(gain, cost, out=np.full(len(cost), np.inf), where=cost > 0.0), kind="stable"
        )
        before = np.cumsum(cost[order]) - cost[order]
        share = np.clip(budget.cost - before, 0.0, cost[order])
        share = np.divide(share, cost[order], out=np.ones(len(cost)), where=cost[order] > 0.0)
        bound = min(bound, float((gain[order] * share).sum()))
    return bound


def _complete(cover: _Cover, cost: FloatArray, needed_weight: float, slack: float) -> None:
    """Add columns, those first that cover most of what is missing for their price."""
    least = slack * _TRACE
    while (missing := needed_weight - cover.covered_weight) > slack:
        is_open = ~cover.is_chosen & (cover.gain > least)
        if not is_open.any():
            cover.refresh()
            is_open, least = ~cover.is_chosen & (cover.gain > 0.0), 0.0
        cover.add(int(_ratio(np.minimum(cover.gain, missing), cost, is_open).argmax()))


def _drop_redundant(cover: _Cover, cost: FloatArray, needed_weight: float, slack: float) -> None:
    """Leave out columns without which enough is covered, the dearest first."""
    chosen = cover.chosen()
    spare = cover.covered_weight - needed_weight + slack
    for column in chosen[np.argsort(-cost[chosen], kind="stable")]:
        loss = cover.loss(int(column))
        if loss <= spare:
            cover.remove(int(column))
            spare -= loss


def _fill(cover: _Cover, cost: FloatArray, price: FloatArray, budget: CoveringBudget) -> None:
    """Add columns as long as the budget allows and they cover something more."""
    least = ROUNDING * _TRACE * float(cover.weight.sum())
    while budget.units is None or cover.is_chosen.sum() < budget.units:
        is_open = ~cover.is_chosen & (cost <= budget.money - cost[cover.is_chosen].sum())
        ratio = _ratio(cover.gain, price, is_open & (cover.gain > least))
        column = int(ratio.argmax()) if len(ratio) else -1
        if column < 0 or ratio[column] <= 0.0:
            return
        cover.add(column)


def _exchange(cover: _Cover, cost: FloatArray, price: FloatArray, budget: CoveringBudget) -> None:
    """Exchange one column for another as long as more is covered."""
    least = ROUNDING * float(cover.weight.sum())
    goes_on, n_exchanges = True, 0
    while goes_on and n_exchanges < _MAX_EXCHANGES:
        goes_on = False
        for column in cover.chosen():
            weight, before = cover.covered_weight, cover.chosen()
            cover.remove(int(column))
            is_open = ~cover.is_chosen & (cost <= budget.money - cost[cover.is_chosen].sum())
            cover.add(int(np.where(is_open, cover.gain, -1.0).argmax()))
            _fill(cover, cost, price, budget)
            n_exchanges += 1
            if cover.covered_weight > weight + least:
                goes_on = True
                continue
            for added in np.setdiff1d(cover.chosen(), before):
                cover.remove(int(added))
            for removed in np.setdiff1d(before, cover.chosen()):
                cover.add(int(removed))


def _ratio(gain: FloatArray, price: FloatArray, is_open: BoolArray) -> FloatArray:
    """Gain per price of what is open, 0 of what is not; infinite where it costs nothing."""
    useful = np.where(is_open, gain, 0.0)
    return np.divide(useful, price, out=np.where(useful > 0.0, np.inf, 0.0), where=price > 0.0)


def _slices(matrix: sp.csr_array, rows: IntArray) -> IntArray:
    """Entries of some rows, all in a line."""
    size = np.diff(matrix.indptr)[rows]
    start = np.repeat(matrix.indptr[rows] - np.cumsum(size) + size, size)
    members: IntArray = matrix.indices[start + np.arange(int(size.sum()))].astype(np.int64)
    return members


# ---------- exact search for small budgets


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
    # Dense: the matrix, the same with weights, and what all pairs share.
    n_cells = len(columns) * max(covers.shape[1], len(columns))
    n_bytes = 3 * n_cells * search.weight.dtype.itemsize
    if n_cells > _MAX_CELLS or n_bytes > available_bytes():
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
