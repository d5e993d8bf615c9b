"""Which column covers which row, at what cost, for what weight: the value of covering problems."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray, float_array, freeze
from geometry.errors import InputError, Unquoted


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
        """Weight of the rows that a set of columns covers.

        Parameters
        ----------
        columns : (n,) int
            Indices of columns.
        """
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

    Parameters
    ----------
    covers : (n_columns, n_rows) array_like or sparse
        Whether a column covers a row.
    cost, weight, names, numbered_from
        As in :class:`CoveringInstance`.

    Raises
    ------
    InputError
        Shapes do not agree, or a number is negative or not finite.

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
