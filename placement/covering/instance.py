"""Covering instances: which column covers which row, at what cost, for what weight."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray, float_array, freeze
from geometry.errors import InputError, Unquoted

from ..optimiser.steering import ROUNDING

# ---------- instances


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveringInstance:
    """A covering problem without its question: columns can be chosen, rows want to be covered.

    Attributes
    ----------
    covers : (n_columns, n_rows) sparse bool
        Whether a column (a pose) covers a row (a demand). Compressed by columns of the problem:
        ``covers.indices[covers.indptr[c] : covers.indptr[c + 1]]`` are the rows that column c
        covers, ascending. May be given as any array.
    cost : (n_columns,) float
        Price of each column, not negative.
    weight : (n_rows,) float
        What covering each row is worth, not negative.
    names : tuple of str
        Of the columns; empty if they have none.
    numbered_from : int
        The number of the first column where the instance comes from: 1 in OR-Library's files.
    """

    covers: sp.csr_array
    cost: FloatArray
    weight: FloatArray
    names: tuple[str, ...] = ()
    numbered_from: int = 0

    def __post_init__(self) -> None:
        matrix = _canonical(self.covers)
        n_columns, n_rows = matrix.shape
        object.__setattr__(self, "covers", matrix)
        object.__setattr__(self, "cost", _amounts(self.cost, n_columns, "cost"))
        object.__setattr__(self, "weight", _amounts(self.weight, n_rows, "weight"))
        if self.names and len(self.names) != n_columns:
            raise InputError("names", Unquoted(f"{len(self.names)} names"), f"{n_columns}, or none")

    @property
    def n_columns(self) -> int:
        """Number of columns."""
        return int(self.covers.shape[0])

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return int(self.covers.shape[1])

    @property
    def coverable_weight(self) -> float:
        """Weight of the rows that some column covers."""
        return float(self.weight[np.unique(self.covers.indices)].sum())

    def covered_weight(self, columns: ArrayLike) -> float:
        """Weight of the rows that some columns cover."""
        chosen = np.asarray(columns, dtype=np.int64)
        return float(self.weight[np.unique(self.covers[chosen].indices)].sum())

    def __repr__(self) -> str:
        return f"CoveringInstance({self.n_columns} columns, {self.n_rows} rows)"


def build_covering_instance(
    covers: "sp.sparray | ArrayLike",
    *,
    cost: ArrayLike | None = None,
    weight: ArrayLike | None = None,
    names: tuple[str, ...] = (),
    numbered_from: int = 0,
) -> CoveringInstance:
    """Covering instance from any matrix; cost and weight are 1 where they are not given.

    `covers`, (n_columns, n_rows), says whether a column covers a row. Raises InputError if shapes
    do not agree, or a number is negative or not finite.

    Examples
    --------
    >>> build_covering_instance([[1, 1, 0], [0, 1, 1]])
    CoveringInstance(2 columns, 3 rows)
    """
    matrix = _canonical(covers)
    return CoveringInstance(
        covers=matrix,
        cost=np.ones(matrix.shape[0]) if cost is None else np.asarray(cost),
        weight=np.ones(matrix.shape[1]) if weight is None else np.asarray(weight),
        names=names,
        numbered_from=numbered_from,
    )


def _canonical(covers: Any) -> sp.csr_array:
    """Sparse copy of what was given: no zeros, no row twice, rows ascending, read-only."""
    try:
        if not sp.issparse(covers):
            covers = np.asarray(covers)
        matrix = sp.csr_array(covers, copy=True)
    except (TypeError, ValueError):
        raise InputError("covers", Unquoted("no matrix"), "columns by rows, as 0 and 1") from None
    if matrix.ndim != 2:
        raise InputError(
            "covers", Unquoted(f"{matrix.ndim} dimensions"), "columns by rows, as 0 and 1"
        )
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    matrix.sort_indices()
    matrix.data = freeze(np.ones(matrix.nnz, dtype=np.bool_))
    matrix.indices = freeze(matrix.indices)
    matrix.indptr = freeze(matrix.indptr)
    return matrix


def _amounts(values: FloatArray, n: int, name: str) -> FloatArray:
    amounts = float_array(values, (n,), name)
    if (amounts < 0.0).any():
        raise InputError(name, float(amounts.min()), "no negative number")
    return amounts


# ---------- targets and budgets


@dataclass(frozen=True, slots=True, kw_only=True)
class CoveringBudget:
    """What may be chosen."""

    units: int | None = None  # at most so many columns; by default any number
    cost: float | None = None  # at most so much money; by default any

    def __post_init__(self) -> None:
        if self.units is None and self.cost is None:
            raise InputError("--budget", Unquoted("nothing"), "a number of columns, or money")
        if self.units is not None and self.units < 1:
            raise InputError("--budget", self.units, "a whole number of columns, at least 1")
        if self.cost is not None and not 0.0 <= self.cost < math.inf:
            raise InputError("--budget-cost", self.cost, "an amount of money, at least 0")

    @property
    def money(self) -> float:
        """Most that may be spent, with what sums may be off by; infinite if there is no limit."""
        return math.inf if self.cost is None else self.cost * (1.0 + ROUNDING)

    def allows(self, cost: ArrayLike) -> bool:
        """Whether columns at these costs may be chosen together."""
        costs = np.asarray(cost, dtype=np.float64)
        return (self.units is None or len(costs) <= self.units) and bool(costs.sum() <= self.money)


def simplify_budget(instance: CoveringInstance, budget: CoveringBudget) -> CoveringBudget:
    """Check that money buys anything; where all columns cost the same, it is a number of them.

    Raises InputError: there is less money than the cheapest useful column costs.
    """
    is_useful = np.asarray(instance.covers @ instance.weight) > 0.0
    if budget.cost is None or not is_useful.any():
        return budget
    prices = np.unique(instance.cost[is_useful])
    if prices[0] > budget.money:
        raise InputError(
            "--budget-cost",
            budget.cost,
            f"at least {prices[0]:g}, the least cost of a column that covers anything",
        )
    if len(prices) > 1 or prices[0] == 0.0:
        return budget
    units = int(min(budget.money / prices[0], instance.n_columns))
    return CoveringBudget(units=units if budget.units is None else min(units, budget.units))


def needed_weight(instance: CoveringInstance, target: float | None) -> float | None:
    """Weight that a target, a share of the weight of all rows, asks for.

    None where every row that can be covered is needed, as without a target. Raises InputError: the
    target is no share, or all columns together do not reach it.
    """
    if target is None:
        return None
    if not 0.0 <= target <= 1.0:
        raise InputError("--target", target, "max, or a share of the weight, 0 to 1")
    total, coverable = float(instance.weight.sum()), instance.coverable_weight
    needed = (target - ROUNDING) * total
    if needed > coverable:
        most = math.floor(1.0e6 * coverable / total) / 1.0e6
        raise InputError(
            "--target", target, f"at most {most:g}, the share that all columns together cover"
        )
    least = float(instance.weight[instance.weight > 0.0].min(initial=math.inf))
    if needed > coverable - least:
        return None
    return float(np.ceil(needed)) if is_whole(instance.weight) else max(needed, 0.0)


def is_whole(amounts: FloatArray) -> bool:
    """Whether all are whole numbers, so that their sums are, too."""
    return bool((amounts == np.round(amounts)).all())


def check_effort(*, time_limit_s: float, gap: float) -> None:
    """Check how long to look and how near is near enough.

    Raises InputError: the time is not positive, or the gap is no share.
    """
    if not time_limit_s > 0.0:
        raise InputError("--time-limit", time_limit_s, "seconds, more than 0")
    if not 0.0 <= gap < 1.0:
        raise InputError("--gap", gap, "a share, 0 <= gap < 1")
