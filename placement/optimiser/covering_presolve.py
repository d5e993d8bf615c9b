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

from dataclasses import dataclass, fields

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from geometry.arrays import BoolArray, FloatArray, IntArray

from .covering_containment import first_equal, supersets
from .covering_instance import CoveringInstance
from .covering_questions import TOLERANCE

_MAX_WORK = 5.0e8  # pairs of sets compared in one reduction: a minute at worst


@dataclass(frozen=True, slots=True, kw_only=True)
class CoveringPresolve:
    """What the presolve of a covering problem did.

    Attributes
    ----------
    n_columns, n_rows : tuple of int
        Before, after.
    n_idle_rows : int
        Rows without weight, or that no column covers.
    n_idle_columns : int
        Columns that cover nothing that is left, or cost more than all the money.
    n_essential_columns : int
        Chosen already: free of charge, or the only ones that cover some row.
    n_equal_columns : int
        Columns that cover what another one covers, at no less cost.
    n_dominated_columns : int
        Columns that cover less than another one, at no less cost.
    n_dear_columns : int
        Columns that cost more than the cheapest columns of all their rows together.
    n_equal_rows : int
        Rows that are covered by the same columns as another one.
    n_dominated_rows : int
        Rows that are covered whenever another one is.
    n_components : int
        Independent parts that are left.
    """

    n_columns: tuple[int, int]
    n_rows: tuple[int, int]
    n_idle_rows: int = 0
    n_idle_columns: int = 0
    n_essential_columns: int = 0
    n_equal_columns: int = 0
    n_dominated_columns: int = 0
    n_dear_columns: int = 0
    n_equal_rows: int = 0
    n_dominated_rows: int = 0
    n_components: int = 0

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
    """A covering problem without what does not matter.

    Attributes
    ----------
    instance : CoveringInstance
        What is left.
    column_index : (n_columns,) int
        The columns that are left, in the full instance: the way back.
    essential : (n,) int
        Columns of the full instance that are chosen already.
    statistics : CoveringPresolve
        What was done.
    """

    instance: CoveringInstance
    column_index: IntArray
    essential: IntArray
    statistics: CoveringPresolve


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

    Parameters
    ----------
    instance : CoveringInstance
        The problem.

    Returns
    -------
    reduced : ReducedCovering
        Its optima, with the essential columns, are optima of the problem, at no other cost.
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

    Parameters
    ----------
    instance : CoveringInstance
        The problem.
    minds_cost : bool
        Whether cost matters, or only the number of columns.
    money : float
        What there is.

    Returns
    -------
    reduced : ReducedCovering
        Any set of its columns covers the same weight in the full problem; none is essential.
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

    Parameters
    ----------
    covers : (n_columns, n_rows) sparse
        No two columns are equal, none covers nothing.
    cost : (n_columns,) float
        Price of each.
    max_work : float
        Pairs of columns to compare; beyond, dominated ones may stay.
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
    return cost > together * (1.0 + TOLERANCE)  # the same prices, summed up in another order


def equal_rows(covers: sp.csr_array) -> BoolArray:
    """Rows covered by the same columns as an earlier one, (n_rows,)."""
    first = first_equal(sp.csr_array(covers.T))
    return np.not_equal(first, np.arange(len(first)))


def dominated_rows(covers: sp.csr_array, *, max_work: float = _MAX_WORK) -> BoolArray:
    """Rows that are covered whenever another one is: by all its columns and more, (n_rows,).

    Parameters
    ----------
    covers : (n_columns, n_rows) sparse
        No two rows are equal, none is without columns.
    max_work : float
        Pairs of rows to compare; beyond, dominated ones may stay.
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
