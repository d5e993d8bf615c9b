"""Covers of all rows at little cost: local search with row weights, and a Lagrangian bound.

The search [1]_ leaves out a column more than the best cover can spare and tries to cover the rest
with what that saves: it takes a row that is not covered, by chance, adds the column of it that
gains most, and makes all rows that are still uncovered weigh more, so that rows that are hard to
cover decide more and more. A column that was left out comes back only after something around it
has changed. Gains count by cost, and columns are added as long as the cover costs less than the
best one: with equal costs, this is one exchange after another.

It repeats itself exactly: chance has a seed, and work is counted, not timed. Only a limit of time
makes an answer depend on the machine.

The bound pays each row a price and lets each column earn the prices of its rows; subgradient steps
[2]_ raise the prices of rows that stay uncovered and lower those of rows covered more than once. At
the best prices, what a column costs more than it earns says how much dearer every cover with it is.

References
----------
.. [1] C. Gao, X. Yao, T. Weise, J. Li, "An efficient local search heuristic with row weighting for
   the unicost set covering problem", European Journal of Operational Research 246, 2015.
.. [2] M. Held, P. Wolfe, H. P. Crowder, "Validation of subgradient optimization", Mathematical
   Programming 6, 1974.
"""

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from geometry.arrays import FloatArray, IntArray

from ..tolerances import ROUNDING
from .instance import is_whole

if TYPE_CHECKING:
    from .kernels import Matrix

SLICE = 10_000_000
"""Entries of the matrix looked at between two looks at the clock: 50 ms."""

_SEED = 1
_MAX_STEPS = 2000  # of subgradients
_PATIENCE = 20  # steps without a better bound, after which steps are halved
_SHORTEST = 1.0e-3  # of the first step: the end


class RowWeighting:
    """A search for cheaper and cheaper covers of all rows, which goes on whenever it is asked.

    `covers` is (n_columns, n_rows); each row has a column; columns cost more than nothing.

    Attributes
    ----------
    best : (n,) int
        The columns of the cheapest cover so far, ascending; empty until there is one.
    cost : float
        What they cost; infinite until there is a cover.
    work : int
        Entries of the matrix that were looked at, or a little less.
    """

    def __init__(self, covers: sp.csr_array, cost: FloatArray, *, seed: int = _SEED) -> None:
        from .kernels import State  # loads the compiler

        n_columns, n_rows = covers.shape
        self._matrix = _matrix(covers, cost)
        self._state = State(
            weight=np.ones(n_rows, dtype=np.int64),
            times=np.zeros(n_rows, dtype=np.int64),
            holder=np.zeros(n_rows, dtype=np.int64),
            score=np.diff(covers.indptr).astype(np.int64),
            changed=np.zeros(n_columns, dtype=np.int64),
            may_add=np.ones(n_columns, dtype=np.bool_),
            place=np.full(n_columns, -1, dtype=np.int64),
            chosen=np.zeros(n_columns, dtype=np.int64),
            uncovered_place=np.arange(n_rows, dtype=np.int64),
            uncovered=np.arange(n_rows, dtype=np.int64),
            counters=np.array([0, n_rows, -1, 0, seed], dtype=np.int64),
        )
        self._is_whole = is_whole(cost)
        self._limit = np.inf
        self.best: IntArray = np.empty(0, dtype=np.int64)
        self.cost = np.inf
        self.work = 0

    def go_on(self, work: int = SLICE) -> None:
        """Search for so much work; first of all, until there is a cover."""
        from .kernels import N_CHOSEN, N_UNCOVERED, complete_greedily, search_cheaper

        counters = self._state.counters
        self.work += work
        if np.isinf(self.cost) and counters[N_UNCOVERED] > 0:
            work = complete_greedily(self._matrix, self._state, work)
            if counters[N_UNCOVERED] > 0:
                return
        while work > 0:
            work = search_cheaper(self._matrix, self._state, self._limit, work)
            if work == 0:
                return
            self.best = np.sort(self._state.chosen[: counters[N_CHOSEN]])
            self.cost = float(self._matrix.cost[self.best].sum())
            # Whole costs differ by 1 or not at all; others by more than rounding.
            self._limit = self.cost - (0.5 if self._is_whole else ROUNDING * self.cost)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LagrangianBound:
    """A cost that every cover has, and what covers with a column cost in addition."""

    bound: float  # no cover costs less
    reduced_cost: FloatArray  # (n_columns,): no cover with the column costs less than both together


def lagrangian_bound(
    covers: sp.csr_array, cost: FloatArray, *, known_cost: float, time_limit_s: float
) -> LagrangianBound:
    """Bound of the cost of covering every row, near that of the linear program.

    `covers` is (n_columns, n_rows), each row has a column; `known_cost` is that of some cover.
    """
    from .kernels import lagrangian_value

    deadline_s = time.perf_counter() + time_limit_s
    matrix = _matrix(covers, cost)
    size = np.diff(covers.indptr)
    price = np.full(covers.shape[1], np.inf)
    np.minimum.at(price, covers.indices, np.repeat(cost / np.maximum(size, 1), size))
    reduced_cost, excess = np.empty(len(cost)), np.empty(len(price))
    best, best_reduced_cost = -np.inf, reduced_cost
    length, n_idle, n_steps = 1.0, 0, 0
    while n_steps < _MAX_STEPS and length > _SHORTEST:
        value = lagrangian_value(matrix, price, reduced_cost, excess)
        n_steps, n_idle = n_steps + 1, n_idle + 1
        if value > best:
            best, best_reduced_cost, n_idle = value, np.maximum(reduced_cost, 0.0), 0
        excess[(price <= 0.0) & (excess < 0.0)] = 0.0  # no price is negative
        norm = float(excess @ excess)
        if norm == 0.0 or best >= known_cost or time.perf_counter() > deadline_s:
            break
        if n_idle > _PATIENCE:
            length, n_idle = 0.5 * length, 0
        price = np.maximum(price + (length * (known_cost - value) / norm) * excess, 0.0)
    # The sums of prices are off by rounding.
    return LagrangianBound(bound=best - ROUNDING * abs(best), reduced_cost=best_reduced_cost)


def _matrix(covers: sp.csr_array, cost: FloatArray) -> "Matrix":
    from .kernels import Matrix

    by_row = sp.csr_array(covers.T)
    return Matrix(
        column_start=covers.indptr.astype(np.int64),
        rows=covers.indices.astype(np.int64),
        row_start=by_row.indptr.astype(np.int64),
        columns=by_row.indices.astype(np.int64),
        cost=np.array(cost, dtype=np.float64),
    )
