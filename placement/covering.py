"""Covering problems of the literature, LSCP and MCLP: read from files, solved, proven by HiGHS.

LSCP, the location set covering problem [1]_: at least cost, cover everything, or enough. MCLP, the
maximal covering location problem [2]_: within a budget, cover as much as possible. Greedy choice
and a bound without a solver come first; HiGHS starts from them. Objectives are counted on the
instance itself, never taken from the solver.

Four formats of files are nothing but numbers. A file is in the one that it fits from the first
number to the last; where it fits several, in the one whose records begin the lines of the file.

orlib
    OR-Library's sets 4 to 6, A to E, NRE to NRH, CYC and CLR [3]_: rows, columns; the cost of each
    column; for each row, how many columns cover it, and which, from 1.
rail
    OR-Library's railway instances [3]_: rows, columns; for each column, its cost, how many rows it
    covers, and which, from 1.
gecco
    Camera placement competition of GECCO 2020 [4]_: samples, candidates; for each sample, its id,
    how many candidates see it, and which, from 0.
sts
    Steiner triple systems [5]_: variables, triples; the three variables of each triple, from 1. The
    variables are columns, the triples rows.

References
----------
.. [1] C. Toregas, R. Swain, C. ReVelle, L. Bergman, "The location of emergency service facilities",
   Operations Research 19, 1971.
.. [2] R. L. Church, C. ReVelle, "The maximal covering location problem", Papers of the Regional
   Science Association 32, 1974.
.. [3] J. E. Beasley, "OR-Library: distributing test problems by electronic mail", Journal of the
   Operational Research Society 41, 1990; its page scpinfo.
.. [4] J. Kritter, M. Brévilliers, J. Lepagnot, L. Idoumghar, "On the optimal placement of cameras
   for surveillance and the underlying set cover problem", Applied Soft Computing 74, 2019.
.. [5] D. R. Fulkerson, G. L. Nemhauser, L. E. Trotter, "Two computationally difficult set covering
   problems that arise in computing the 1-width of incidence matrices of Steiner triple systems",
   Mathematical Programming Study 2, 1974; files and README by M. G. C. Resende.
"""

import contextlib
import math
import os
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray, FloatArray, IntArray, float_array, freeze
from geometry.errors import InputError, Unquoted
from geometry.files import open_file, write_atomically
from geometry.untrusted_files import is_text, unpacked_bytes

from .layout import relative_gap
from .memory import check_fits
from .optimiser.steering import ROUNDING, common_step, settle

# ---------- instances


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveringInstance:
    """A covering problem without its question; made by :func:`build_covering_instance`."""

    # (n_columns, n_rows): whether a column (a pose) covers a row (a demand); rows ascend in each.
    covers: sp.csr_array
    cost: FloatArray  # (n_columns,): price of each column, not negative
    weight: FloatArray  # (n_rows,): what covering each row is worth, not negative
    names: tuple[str, ...] = ()  # of the columns; empty if they have none
    # the number of the first column where the instance comes from: 1 in OR-Library's files
    numbered_from: int = 0

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
        return _covered(self.covers, self.weight, np.arange(self.n_columns))

    def covered_weight(self, columns: ArrayLike) -> float:
        """Weight of the rows that some columns cover."""
        return _covered(self.covers, self.weight, np.asarray(columns, dtype=np.int64))

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
    expected = "columns by rows, as 0 and 1"
    try:
        matrix = sp.csr_array(covers if sp.issparse(covers) else np.asarray(covers), copy=True)
    except (TypeError, ValueError):
        raise InputError("covers", Unquoted("no matrix"), expected) from None
    if matrix.ndim != 2:
        raise InputError("covers", Unquoted(f"{matrix.ndim} dimensions"), expected)
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    matrix.sort_indices()
    matrix.data = np.ones(matrix.nnz, dtype=np.bool_)
    for array in (matrix.data, matrix.indices, matrix.indptr):
        freeze(array)
    amounts = []
    for name, values, size in zip(("cost", "weight"), (cost, weight), matrix.shape, strict=True):
        array = float_array(np.ones(size) if values is None else values, (size,), name)
        if (array < 0.0).any():
            raise InputError(name, float(array.min()), "no negative number")
        amounts.append(array)
    if names and len(names) != matrix.shape[0]:
        expected = f"{matrix.shape[0]}, or none"
        raise InputError("names", Unquoted(f"{len(names)} names"), expected)
    return CoveringInstance(
        covers=matrix, cost=amounts[0], weight=amounts[1], names=names, numbered_from=numbered_from
    )


def _covered(covers: sp.csr_array, weight: FloatArray, columns: IntArray) -> float:
    return float(weight[np.unique(covers[columns].indices)].sum())


# ---------- solutions


HIGHS, GREEDY = "HIGHS", "greedy"
"""With proof; without."""

_AUTO = "auto"  # a second name of HIGHS, so that both kinds of `solve` have the same default
_LARGEST_SUM = 1.0e6  # of an objective's coefficients: HiGHS' tolerances are absolute, 1e-6
_LONGEST_S = 1.0e6  # eleven days: HiGHS takes no infinite limit
_GRACE_S = 1.0  # beyond its time limit, after which HiGHS is cancelled
_POLL_S = 0.05  # so that Ctrl-C is noticed
_MODEL_BYTES = 300  # of HiGHS' memory for each entry of the matrix; measured: 200 to 240


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveringSolution:
    """An answer to a covering problem, and how good it is."""

    chosen: IntArray  # (n,): indices of columns, ascending
    objective: float  # LSCP: their cost; MCLP: the weight that they cover
    bound: float  # LSCP: no answer costs less; MCLP: none covers more
    gap: float  # relative distance of the two, as HiGHS defines it
    cost: float  # of the columns chosen
    covered_weight: float  # of the rows that they cover
    solver: str  # what found and proved it
    seconds: float  # from instance to answer, model building included [s]

    @property
    def is_proven(self) -> bool:
        """True if the objective is proven to be the best there is."""
        return self.gap == 0.0


def solve_lscp(
    instance: CoveringInstance,
    *,
    target: float | None = None,
    solver: str = _AUTO,
    time_limit_s: float = math.inf,
    gap: float = 0.0,
) -> CoveringSolution:
    """Least cost that covers everything that can be covered, or a share of the weight.

    Parameters
    ----------
    instance : CoveringInstance
        What covers what.
    target : float, optional
        Share of the weight of all rows, 0 to 1; by default every row with weight that any column
        covers is covered.
    solver : str
        "auto" or "HIGHS"; "greedy": no proof.
    time_limit_s : float
        When it is up, the best answer found is given with its bound. [s]
    gap : float
        Relative distance of objective and bound that is good enough.

    Raises
    ------
    InputError
        The target is out of reach, there is no such solver, or no memory for it.
    """
    began_s = time.perf_counter()
    has_proof = _check_effort(instance, solver, time_limit_s, gap)
    needed = _needed_weight(instance, target)
    covers, weight, cost = *_coverable_rows(instance), instance.cost
    # Where all rows are needed, each counts alike: no sum of weights, no tolerance.
    needs_all = needed is None
    weight = np.ones(len(weight)) if needs_all else weight
    enough = float(len(weight)) if needed is None else needed
    chosen = _without_needless(covers, cost, weight, _grow(covers, cost, weight, enough), enough)
    bound = _least_cost_bound(covers, cost, weight, enough)
    if has_proof and bound < cost[chosen].sum():
        unit, most = _unit(cost), float(weight.max(initial=0.0)) or 1.0
        found, bound_found = _minimise(
            covers,
            cost / unit,
            np.zeros(len(weight)),
            is_covered=needs_all,
            rows=[] if needs_all else [(np.zeros(len(cost)), -weight / most, -enough / most)],
            start=chosen,
            time_limit_s=time_limit_s - (time.perf_counter() - began_s),
            gap=gap,
        )
        bound = max(bound, bound_found * unit)
        if found is not None and _covered(covers, weight, found) >= enough * (1.0 - ROUNDING):
            found = _without_needless(covers, cost, weight, found, enough)
            chosen = min((chosen, found), key=lambda columns: float(cost[columns].sum()))
    least = float(cost[chosen].sum())
    bound = -settle(-least, -bound, -bound, step=common_step(cost))
    return _solution(instance, chosen, least, bound, has_proof, began_s)


def solve_mclp(
    instance: CoveringInstance,
    *,
    budget_units: int | None = None,
    budget_cost: float | None = None,
    solver: str = _AUTO,
    time_limit_s: float = math.inf,
    gap: float = 0.0,
) -> CoveringSolution:
    """Most weight that at most so many columns, or so much money, covers.

    At least one of the two budgets is given. Fewer columns are chosen where more would add nothing.
    The other arguments are those of :func:`solve_lscp`. Raises InputError if there is no budget, it
    buys nothing, there is no such solver, or no memory for it.
    """
    began_s = time.perf_counter()
    has_proof = _check_effort(instance, solver, time_limit_s, gap)
    units, money = _check_budget(instance, budget_units, budget_cost)
    covers, weight, cost = *_coverable_rows(instance), instance.cost
    # Greedy choice by weight and, where money is short, by weight for cost: the better one.
    prices = [np.ones(len(cost)), *([cost] if money < math.inf else [])]
    chosen = max(
        (_grow(covers, price, weight, units=units, cost=cost, money=money) for price in prices),
        key=lambda columns: _covered(covers, weight, columns),
    )
    bound = _most_weight_bound(covers, cost, weight, units, money)
    if has_proof and bound > _covered(covers, weight, chosen):
        unit, nothing = _unit(weight), np.zeros(len(weight))
        rows = [(np.ones(len(cost)), nothing, float(units))] if units < len(cost) else []
        if money < math.inf:
            most = max(float(cost.max(initial=0.0)), money) or 1.0
            rows.append((cost / most, nothing, money / most))
        found, bound_found = _minimise(
            covers,
            np.zeros(len(cost)),
            -weight / unit,
            is_covered=False,
            rows=rows,
            start=chosen,
            time_limit_s=time_limit_s - (time.perf_counter() - began_s),
            gap=gap,
        )
        bound = min(bound, -bound_found * unit)
        if found is not None and len(found) <= units and _may_spend(cost[found].sum(), money):
            enough = _covered(covers, weight, found)
            found = _without_needless(covers, cost, weight, found, enough)
            chosen = max((chosen, found), key=lambda columns: _covered(covers, weight, columns))
    covered = instance.covered_weight(chosen)
    bound = settle(covered, bound, bound, step=common_step(weight))
    return _solution(instance, chosen, covered, bound, has_proof, began_s)


def _check_effort(instance: CoveringInstance, solver: str, time_limit_s: float, gap: float) -> bool:
    """Check how hard to try; whether the solver proves its answers."""
    if not time_limit_s > 0.0:
        raise InputError("time_limit_s", time_limit_s, "seconds, more than 0")
    if not 0.0 <= gap < 1.0:
        raise InputError("gap", gap, "a share, 0 <= gap < 1")
    if solver == GREEDY:
        return False
    if solver.upper() not in (HIGHS, _AUTO.upper()):
        raise InputError("solver", solver, f"a solver that is installed: {HIGHS}")
    check_fits(
        "solver",
        f"{solver} with {instance.covers.nnz:,} entries of a matrix",
        _MODEL_BYTES * instance.covers.nnz,
        f"`solver` {GREEDY}, or fewer rows or columns",
    )
    return True


def _check_budget(
    instance: CoveringInstance, units: int | None, money: float | None
) -> tuple[int, float]:
    """Most columns, and most money; infinite where it does not limit more than their number."""
    if units is None and money is None:
        raise InputError("budget_units", Unquoted("nothing"), "a number of columns, or money")
    if units is not None and units < 1:
        raise InputError("budget_units", units, "a whole number of columns, at least 1")
    if money is not None and not 0.0 <= money < math.inf:
        raise InputError("budget_cost", money, "an amount of money, at least 0")
    most = instance.n_columns if units is None else min(units, instance.n_columns)
    prices = np.unique(instance.cost[np.asarray(instance.covers @ instance.weight) > 0.0])
    if money is None or not len(prices):
        return most, math.inf if money is None else money
    if not _may_spend(prices[0], money):
        expected = f"at least {prices[0]:g}, the least cost of a column that covers anything"
        raise InputError("budget_cost", money, expected)
    if len(prices) > 1 or prices[0] == 0.0:
        return most, money
    return int(min(money * (1.0 + ROUNDING) / prices[0], most)), math.inf


def _may_spend(amount: ArrayLike, money: float) -> Any:
    """Which amounts are within a budget, but for what sums may be off by."""
    return np.asarray(amount) <= money * (1.0 + ROUNDING)


def _needed_weight(instance: CoveringInstance, target: float | None) -> float | None:
    """Weight that a target asks for; None where every row that can be covered is needed."""
    if target is None:
        return None
    if not 0.0 <= target <= 1.0:
        raise InputError("target", target, "max, or a share of the weight, 0 to 1")
    total, coverable = float(instance.weight.sum()), instance.coverable_weight
    needed = (target - ROUNDING) * total
    if needed > coverable:
        most = math.floor(1.0e6 * coverable / total) / 1.0e6
        raise InputError(
            "target", target, f"at most {most:g}, the share that all columns together cover"
        )
    least = float(instance.weight[instance.weight > 0.0].min(initial=math.inf))
    if needed > coverable - least:
        return None
    return float(np.ceil(needed)) if _is_whole(instance.weight) else max(needed, 0.0)


def _is_whole(amounts: FloatArray) -> bool:
    return bool((amounts == np.round(amounts)).all())


def _coverable_rows(instance: CoveringInstance) -> tuple[sp.csr_array, FloatArray]:
    """Columns and weights of the rows with weight that some column covers."""
    rows = np.unique(instance.covers.indices)
    rows = rows[instance.weight[rows] > 0.0]
    return sp.csr_array(instance.covers[:, rows]), instance.weight[rows]


def _solution(
    instance: CoveringInstance,
    chosen: IntArray,
    objective: float,
    bound: float,
    has_proof: bool,
    began_s: float,
) -> CoveringSolution:
    return CoveringSolution(
        chosen=np.sort(chosen),
        objective=objective,
        bound=bound,
        # Relative to the objective: what is small may just be in large units.
        gap=relative_gap(1.0, bound / objective) if objective > 0.0 else relative_gap(0.0, bound),
        cost=float(instance.cost[chosen].sum()),
        covered_weight=instance.covered_weight(chosen),
        solver=f"HiGHS {version('highspy')}" if has_proof else GREEDY,
        seconds=time.perf_counter() - began_s,
    )


# ---------- greedy choice, and bounds without a solver


def _grow(
    covers: sp.csr_array,
    price: FloatArray,
    weight: FloatArray,
    enough: float = math.inf,
    *,
    units: float = math.inf,
    cost: FloatArray | None = None,
    money: float = math.inf,
) -> IntArray:
    """Columns one by one, each with the most new weight for its price, until that is enough."""
    left, chosen = weight.copy(), list[int]()
    total, slack = float(weight.sum()), ROUNDING * float(weight.sum())
    while len(chosen) < units and total - left.sum() < enough - slack:
        # Beyond what is needed nothing counts: no large column for a small remainder.
        gain = np.minimum(covers @ left, enough - (total - left.sum()))
        if cost is not None:
            gain[cost > money * (1.0 + ROUNDING) - cost[chosen].sum()] = 0.0
        if not gain.max(initial=0.0) > 0.0:
            break
        best = int(np.argmax(_per_price(gain, price)))
        chosen.append(best)
        left[covers[[best]].indices] = 0.0
    return np.array(chosen, dtype=np.int64)


def _per_price(gain: FloatArray, price: FloatArray) -> FloatArray:
    """Weight for each unit of a price, (n_columns,); infinite where it is for nothing."""
    ratio = np.divide(gain, price, out=np.full(len(price), np.inf), where=price > 0.0)
    return np.where(gain > 0.0, ratio, -1.0)


def _without_needless(
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, chosen: IntArray, enough: float
) -> IntArray:
    """Those of some columns that are needed to cover a weight; the dearest are left out first."""
    times = np.bincount(covers[chosen].indices, minlength=covers.shape[1])
    spare = float(weight[times > 0].sum()) - enough + ROUNDING * float(weight.sum())
    is_needed = np.ones(len(chosen), dtype=np.bool_)
    for position in np.argsort(-cost[chosen], kind="stable"):
        rows = covers[[chosen[position]]].indices
        lost = float(weight[rows[times[rows] == 1]].sum())
        if lost <= spare:
            times[rows] -= 1
            spare -= lost
            is_needed[position] = False
    return chosen[is_needed]


def _least_cost_bound(
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, enough: float
) -> float:
    """A cost below which no columns cover a weight.

    No column covers weight for less than its own price per weight: each row is charged the least
    such price among its columns, the cheapest rows are taken first, and the last one in part. With
    all rows needed, a feasible solution of the linear program's dual.
    """
    covered = np.asarray(covers @ weight, dtype=np.float64)
    price = np.divide(cost, covered, out=np.full(len(cost), np.inf), where=covered > 0.0)
    least = np.full(covers.shape[1], np.inf)
    np.minimum.at(least, covers.indices, np.repeat(price, np.diff(covers.indptr)))
    order = np.argsort(least, kind="stable")
    before = np.cumsum(weight[order]) - weight[order]
    taken = np.clip(enough - before, 0.0, weight[order])
    return float(least[order] @ taken)


def _most_weight_bound(
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, units: int, money: float
) -> float:
    """A weight that no columns within a budget exceed: as if no two covered the same row."""
    gain = np.asarray(covers @ weight, dtype=np.float64)
    bound = min(float(weight.sum()), float(np.sort(gain)[::-1][:units].sum()))
    if money < math.inf:
        order = np.argsort(-_per_price(gain, cost), kind="stable")
        before = np.cumsum(cost[order]) - cost[order]
        share = np.clip(money - before, 0.0, cost[order])
        share = np.divide(share, cost[order], out=np.ones(len(cost)), where=cost[order] > 0.0)
        bound = min(bound, float(gain[order] @ share))
    return bound


# ---------- the mixed-integer model


def _unit(coefficients: FloatArray) -> float:
    """Divisor of an objective; whole numbers of an ordinary size stay whole."""
    total = float(coefficients.sum())
    if total == 0.0 or (_is_whole(coefficients) and total <= _LARGEST_SUM):
        return 1.0
    return total / _LARGEST_SUM


def _minimise(
    covers: sp.csr_array,
    of_columns: FloatArray,
    of_rows: FloatArray,
    *,
    is_covered: bool,
    rows: list[tuple[FloatArray, FloatArray, float]],
    start: IntArray,
    time_limit_s: float,
    gap: float,
) -> tuple[IntArray | None, float]:
    """The best columns found and a bound; minus infinity if nothing is known.

    Least ``of_columns @ x + of_rows @ y`` where x_c = 1 says that column c is chosen, y_r that row
    r is covered, y <= sum of the x that cover it, ``a @ x + b @ y <= limit`` for each of `rows`,
    and y = 1 if all `is_covered`. Only x has to be whole: for given x every y is bounded by zeros
    and ones alone. HiGHS is called directly, not by cvxpy: it starts from the greedy choice, and
    works in a thread of its own so that Ctrl-C is noticed at once.
    """
    import highspy

    deadline_s = time.perf_counter() + time_limit_s
    if time_limit_s <= 0.0:
        return None, -math.inf
    (n_columns, n_rows), n = covers.shape, sum(covers.shape)
    by_row = sp.csr_array(covers.T).astype(np.float64)
    blocks = [sp.hstack([-by_row, sp.eye_array(n_rows)])]
    blocks += [sp.csr_array(np.append(a, b)[None, :]) for a, b, _ in rows]
    matrix = sp.csr_array(sp.vstack(blocks))
    solver = highspy.Highs()
    for option, value in (
        ("output_flag", False),
        ("time_limit", min(time_limit_s, _LONGEST_S)),
        ("mip_rel_gap", gap),
        ("mip_abs_gap", 0.0),
    ):
        solver.setOptionValue(option, value)
    problem = highspy.HighsLp()
    problem.num_col_, problem.num_row_ = n, len(rows) + n_rows
    problem.col_cost_ = np.append(of_columns, of_rows)
    problem.col_lower_ = np.append(np.zeros(n_columns), np.full(n_rows, float(is_covered)))
    problem.col_upper_ = np.ones(n)
    problem.row_lower_ = np.full(len(rows) + n_rows, -np.inf)
    problem.row_upper_ = np.append(np.zeros(n_rows), [limit for _, _, limit in rows])
    problem.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    problem.a_matrix_.start_, problem.a_matrix_.index_ = matrix.indptr, matrix.indices
    problem.a_matrix_.value_ = matrix.data
    whole, continuous = highspy.HighsVarType.kInteger, highspy.HighsVarType.kContinuous
    problem.integrality_ = [whole] * n_columns + [continuous] * n_rows
    solver.passModel(problem)
    known, x = highspy.HighsSolution(), np.zeros(n_columns)
    x[start] = 1.0
    known.col_value = np.append(x, np.minimum(by_row @ x, 1.0)).tolist()
    solver.setSolution(known)
    solver.HandleUserInterrupt = True
    solver.startSolve()
    try:
        is_over = False
        while not is_over:
            if time.perf_counter() > deadline_s + _GRACE_S:
                solver.cancelSolve()
            is_over, _ = solver.wait(_POLL_S)
    except BaseException:
        solver.cancelSolve()
        solver.wait(_GRACE_S)
        raise
    info = solver.getInfo()
    if info.primal_solution_status != highspy.kSolutionStatusFeasible:
        return None, float(info.mip_dual_bound)
    values = np.array(solver.getSolution().col_value)
    return np.flatnonzero(values[:n_columns] > 0.5), float(info.mip_dual_bound)


# ---------- files of numbers


_MAX_SIZE = 10_000_000  # rows, columns: what a file of a few bytes may make us allocate
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_CHARACTERS = b"0123456789+-.eE \t\n\r\v\f"
_IS_BLANK = np.isin(np.arange(256), list(b" \t\n\r\v\f"))
_COST = "the cost of a column"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Format:
    """What the numbers of a file are: two sizes, perhaps costs, then lists of members."""

    sizes: tuple[str, str]  # what the first two numbers count
    lists: int  # which of the two is the number of lists; members are what the other one counts
    has_costs: bool = False  # of all columns, before the lists
    head: str = ""  # what stands before each list, in words
    count: str = ""  # how many members it has, in words; always three without these
    member: str  # a member, and the owner of a list, in words
    owner: str
    first: int = 1  # number of the first member


_FORMATS = {
    "orlib": _Format(
        sizes=("rows", "columns"),
        lists=0,
        has_costs=True,
        count="how many columns cover row {}",
        member="column",
        owner="row",
    ),
    "gecco": _Format(
        sizes=("samples", "candidates"),
        lists=0,
        head="the id of sample {}",
        count="how many candidates see sample {}",
        member="column",
        owner="sample",
        first=0,
    ),
    "rail": _Format(
        sizes=("rows", "columns"),
        lists=1,
        head="the cost of column {}",
        count="how many rows column {} covers",
        member="row",
        owner="column",
    ),
    "sts": _Format(sizes=("variables", "triples"), lists=1, member="variable", owner="triple"),
}
TEXT_FORMATS = tuple(_FORMATS)
"""Names of the formats that are nothing but numbers."""
_OF_NUMBERS = f"{', '.join(TEXT_FORMATS[:-1])} or {TEXT_FORMATS[-1]}"
_TRIPLE = 3


class _MisfitError(Exception):
    """A file is not in a format, from a number on."""

    def __init__(self, index: int, expected: str) -> None:
        self.index, self.expected = index, expected
        super().__init__(expected)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Numbers:
    """The numbers of a file and where they stand."""

    data: bytes  # the file
    start: IntArray  # (n,): where each number starts
    value: FloatArray  # (n,): what it is

    def size(self, index: int, what: str) -> int:
        """A number of rows or columns."""
        if index >= len(self.value):
            raise _MisfitError(index, what)
        value = self.value[index]
        if not 1 <= value <= _MAX_SIZE or value != np.floor(value):
            raise _MisfitError(index, f"{what}, 1 to {_MAX_SIZE}")
        return int(value)

    def begin_lines(self, indices: IntArray) -> bool:
        """True if all of some numbers are the first of their lines."""
        text = np.frombuffer(self.data, dtype=np.uint8)
        ends = np.flatnonzero((text == ord("\n")) | (text == ord("\r")))
        line = np.searchsorted(ends, self.start)
        return bool((line[indices] > line[indices - 1]).all())

    def place(self, index: int) -> str:
        """Where a number stands, in words."""
        if len(self.start) == 0:
            return "line 1"
        offset = int(self.start[min(index, len(self.start) - 1)])
        line_start = self.data.rfind(b"\n", 0, offset) + 1
        line = self.data.count(b"\n", 0, offset) + 1
        return f"line {line}, number {len(self.data[line_start:offset].split()) + 1}"

    def text(self, index: int, *, longest: int = 40) -> str:
        """Text from a number's place to the next blank."""
        offset = int(self.start[index])
        return self.data[offset : offset + longest].split(None, 1)[0].decode("latin-1")


def _parse(data: bytes, where: str, format_name: str | None) -> CoveringInstance:
    """Covering instance from the text of a file; its rows weigh 1.

    `where` is its name, for messages. Without `format_name`, the format is the one that it fits; a
    few numbers can fit several: it is the one then of which each record begins a line. Raises an
    InputError that names the line and the number from which on it fits no format.
    """
    numbers = _numbers(data, where)
    misfits: dict[str, _MisfitError] = {}
    fits: dict[str, tuple[CoveringInstance, IntArray]] = {}
    for name in TEXT_FORMATS if format_name is None else (format_name,):
        try:
            fits[name] = _read(numbers, _FORMATS[name])
        except _MisfitError as misfit:
            misfits[name] = misfit
    if len(fits) > 1:
        lined = [name for name, (_, records) in fits.items() if numbers.begin_lines(records)]
        if len(lined) != 1:
            raise InputError(
                where,
                Unquoted("numbers that fit more than one format"),
                "`format_name` " + " or ".join(lined or fits),
            )
        return fits[lined[0]][0]
    if fits:
        return next(iter(fits.values()))[0]
    # The format that was meant: one that has most of its lines, else the one it fits longest.
    meant = _formats_of_lines(data)
    name = max(misfits, key=lambda each: (each in meant, misfits[each].index))
    index, n_numbers = misfits[name].index, len(numbers.start)
    at_end = Unquoted("the end of the file after it")
    raise InputError(
        f"{where}: {numbers.place(index)}",
        numbers.text(index) if index < n_numbers else at_end,
        f"{misfits[name].expected} (format {name})",
    )


def _numbers(data: bytes, where: str) -> _Numbers:
    is_blank = _IS_BLANK[np.frombuffer(data, dtype=np.uint8)]
    start = np.flatnonzero(~is_blank & np.append(True, is_blank[:-1])[: len(is_blank)])
    value = np.empty(0)
    if not data.translate(None, _CHARACTERS):
        with contextlib.suppress(ValueError):  # such as a sign without digits, refused below
            value = np.fromstring(data.decode("ascii"), sep=" ")
    numbers = _Numbers(data=data, start=start, value=value)
    if len(value) != len(start) or not np.isfinite(value).all():
        for index in range(len(start)):
            token = numbers.text(index, longest=4096)
            if not _NUMBER.fullmatch(token.encode("latin-1")) or not np.isfinite(float(token)):
                raise InputError(
                    f"{where}: {numbers.place(index)}",
                    numbers.text(index),
                    f"a number (format {_OF_NUMBERS}), or an .npz file of this program",
                )
    return numbers


def _formats_of_lines(data: bytes) -> set[str]:
    """Formats with a record to a line, if most of the lines after the first are such records."""
    sizes, *lines = [line.split() for line in data.splitlines() if line.strip()]
    n_lists = sum(len(line) > 1 and line[1] == str(len(line) - 2).encode() for line in lines)
    n_triples = sum(len(line) == _TRIPLE for line in lines)
    if 2 * n_lists > len(lines):
        formats = ("gecco", "rail")  # as many records as the first, or the second number says
        exact = {name for name, size in zip(formats, sizes, strict=False) if float(size) == n_lists}
        return exact or set(formats)
    return {"sts"} if 2 * n_triples > len(lines) else set()


def _read(numbers: _Numbers, form: _Format) -> tuple[CoveringInstance, IntArray]:
    """The instance of a file, and the numbers that begin a line in files of a format.

    Raises the first misfit in the file.
    """
    value, n_given = numbers.value, len(numbers.value)
    counts = [numbers.size(index, f"the number of {what}") for index, what in enumerate(form.sizes)]
    n_lists, n_members = counts[form.lists], counts[1 - form.lists]
    begin, cost = 2, np.ones(n_lists if form.owner == "column" else n_members)
    if form.has_costs:
        begin, cost = 2 + n_members, value[2 : 2 + n_members]
        _raise_first(_wrong(value, np.arange(2, 2 + len(cost)), 0, None, _COST))
        if len(cost) < n_members:
            raise _MisfitError(n_given, f"the costs of {n_members} columns")
    record, start, count, misfit = _find_lists(value, form, begin, n_lists, n_members)
    end = int(start[-1] + count[-1]) if len(record) else begin
    if end > n_given:  # the last list is cut off
        count[-1] -= end - n_given
    before = np.cumsum(count) - count
    places = np.repeat(start - before, count)
    places += np.arange(len(places))
    owner, high = np.repeat(np.arange(len(count)), count), n_members - 1 + form.first
    misfits = [misfit]
    if form.owner == "sample":
        what = "the id of a sample"
        misfits.append(_wrong(value, record, 0, n_lists - 1, what))
        misfits.append(_again(value[record], record, f"{what} that has not been there yet"))
    elif form.owner == "column":
        misfits.append(_wrong(value, record, 0, None, _COST))
    wrong = _wrong(value, places, form.first, high, f"a {form.member}")
    misfits.append(wrong)
    if wrong is None:
        keys = owner * (high + 1) + value[places].astype(np.int64)
        what = f"a {form.member} that the {form.owner} has not named yet"
        misfits.append(_again(keys, places, what))
    if end > n_given:
        what = f"{end - n_given} more {form.member}s of the last {form.owner}"
        misfits.append(_MisfitError(n_given, what))
    if misfit is None and end < n_given:
        misfits.append(_MisfitError(end, "the end of the file"))
    _raise_first(*misfits)
    if form.owner == "sample":
        owner = value[record].astype(np.int64)[owner]
    column, row = value[places].astype(np.int64) - form.first, owner
    if form.owner == "column":
        cost, column, row = value[record], row, column
    n_rows = n_members if form.owner == "column" else n_lists
    entries = np.ones(len(row), dtype=np.bool_), (column, row)
    covers = sp.csr_array(entries, shape=(len(cost), n_rows))
    instance = build_covering_instance(covers, cost=cost, numbered_from=form.first)
    return instance, np.append(2, record) if form.has_costs else record


def _find_lists(
    value: FloatArray, form: _Format, index: int, n_lists: int, most: int
) -> tuple[IntArray, IntArray, IntArray, _MisfitError | None]:
    """Where lists begin, their first members and their sizes, up to the first that is none."""
    n_given, n_heads = len(value), int(form.head != "")
    if not form.count:
        n_whole = min(n_lists, (n_given - index) // _TRIPLE)
        record = index + _TRIPLE * np.arange(n_whole)
        what = f"the variables of triple {n_whole + 1} of {n_lists}"
        misfit = None if n_whole == n_lists else _MisfitError(n_given, what)
        return record, record, np.full(n_whole, _TRIPLE), misfit
    found, misfit = list[tuple[int, int]](), None
    while len(found) < n_lists and misfit is None:
        place, which = index + n_heads, f"{len(found) + 1} of {n_lists}"
        count = value[place] if place < n_given else -1.0
        if 0.0 <= count <= most and count == int(count):
            found.append((index, int(count)))
            index = place + 1 + int(count)
        elif place < n_given:
            misfit = _MisfitError(place, f"{form.count.format(which)}, 0 to {most}")
        else:
            words = form.head if form.head and index >= n_given else form.count
            misfit = _MisfitError(n_given, words.format(which))
    record, sizes = np.array(found, dtype=np.int64).reshape(-1, 2).T
    return record, record + n_heads + 1, sizes.copy(), misfit


def _wrong(
    value: FloatArray, places: IntArray, low: int, high: int | None, what: str
) -> _MisfitError | None:
    """The first of some numbers that is none from low to high, whole where there is a high."""
    is_wrong: BoolArray = value[places] < low
    if high is not None:
        is_wrong |= (value[places] > high) | (value[places] != np.floor(value[places]))
    if not is_wrong.any():
        return None
    expected = f"{what}, at least {low}" if high is None else f"{what}, {low} to {high}"
    return _MisfitError(int(places[is_wrong].min()), expected)


def _again(values: IntArray | FloatArray, places: IntArray, what: str) -> _MisfitError | None:
    """The first of some numbers that has been there before."""
    _, first = np.unique(values, return_index=True)
    again = np.delete(places, first)
    return _MisfitError(int(again.min()), what) if len(again) else None


def _raise_first(*misfits: _MisfitError | None) -> None:
    found = [misfit for misfit in misfits if misfit is not None]
    if found:
        raise min(found, key=lambda misfit: misfit.index)


# ---------- reading and writing


NPZ = "npz"
FORMATS = (NPZ, *TEXT_FORMATS)
"""Names of the formats that :func:`load_instance` reads; of its own, npz."""

KIND = "place-rsus/covering-instance/1"
"""Kind of our own files; raise the number whenever the fields change."""

_ZIP_MAGIC = b"PK"
_MAX_BYTES = 1 << 30
# of memory for each byte of a file of numbers while it is read; measured: 19 to 24
_TEXT_BYTES = 25
_UNPACKED_BYTES = 6  # of memory for each byte of our own files, unpacked, while they are read


def load_instance(path: Path, *, format_name: str | None = None) -> CoveringInstance:
    """Read an instance in one of :data:`FORMATS`; by default the one that the content is in.

    Raises InputError if the file cannot be read, or holds no instance: the message says where, and
    what is expected there.
    """
    if format_name is not None and format_name not in FORMATS:
        raise InputError("format_name", format_name, "one of " + ", ".join(FORMATS))
    where = str(path)
    try:
        with open_file(path, max_bytes=_MAX_BYTES) as file:
            n_bytes = os.fstat(file.fileno()).st_size
            magic = file.read(len(_ZIP_MAGIC))
            file.seek(0)
            if format_name == NPZ or (format_name is None and magic == _ZIP_MAGIC):
                return _load_npz(file, where)
            check_fits(
                where,
                f"{n_bytes:,} bytes of text",
                _TEXT_BYTES * n_bytes,
                "fewer rows or columns, or a file of this program (`out`, .npz), a fifth of it",
            )
            data = file.read()
    except OSError as error:
        raise InputError(where, Unquoted(error.strerror or error), "a readable file") from None
    if not data.strip():
        raise InputError(where, Unquoted("an empty file"), "an instance")
    return _parse(data, where, format_name)


def save_instance(path: Path, instance: CoveringInstance) -> None:
    """Write an instance in this program's own format, whole or not at all.

    Raises OSError: the file cannot be written.
    """
    covers = instance.covers
    write_atomically(
        path,
        lambda file: np.savez_compressed(
            file,
            kind=KIND,
            n_rows=instance.n_rows,
            covered_rows_start=covers.indptr,
            covered_rows=covers.indices,
            cost=instance.cost,
            weight=instance.weight,
            names=np.array(instance.names, dtype=np.str_),
            numbered_from=instance.numbered_from,
        ),
    )


def instance_kind(path: Path) -> str | None:
    """Kind of instance that one of this program's files holds, such as :data:`KIND`.

    None if the file cannot be read, or is none of this program's.
    """
    try:
        # Opened here: numpy does not close a file that turns out to be no archive.
        with open_file(path) as file, np.load(file, allow_pickle=False) as stored:
            return str(stored["kind"])
    except Exception:  # what is wrong with it is said by what reads it
        return None


def _load_npz(file: BinaryIO, where: str) -> CoveringInstance:
    try:
        with np.load(file, allow_pickle=False) as stored:
            n_bytes = unpacked_bytes(stored.zip, where)
            check_fits(
                where,
                f"{n_bytes:,} bytes when unpacked",
                _UNPACKED_BYTES * n_bytes,
                "fewer rows or columns",
            )
            fields = {name: stored[name] for name in stored.files}
    except (InputError, OSError):
        raise
    except Exception as error:  # what damaged archives raise has no end: zipfile's, zlib's
        words = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            where, Unquoted(f"a damaged file ({words})"), "an .npz file of this program"
        ) from None
    found = np.asarray(fields.get("kind", 0))
    kind = str(found) if is_text(found) else Unquoted("no text" if "kind" in fields else "nothing")
    if kind != KIND:
        raise InputError(f"{where}: kind", kind, repr(KIND))
    try:
        return _from_fields(fields)
    except InputError as error:
        raise InputError(f"{where}: {error.where}", error.got, error.expected) from None


def _from_fields(fields: Mapping[str, Any]) -> CoveringInstance:
    for name in ("n_rows", "covered_rows_start", "covered_rows", "cost", "weight"):
        if not isinstance(fields.get(name), np.ndarray):  # what is no array is read as bytes
            got = "something else" if name in fields else "nothing"
            raise InputError(name, Unquoted(got), "an array")
        kind, got = fields[name].dtype.kind, Unquoted(f"an array of {fields[name].dtype}")
        if kind not in "iuf":
            raise InputError(name, got, "numbers")
        if kind == "f" and name not in ("cost", "weight"):
            raise InputError(name, got, "whole numbers")
    start, rows = fields["covered_rows_start"], fields["covered_rows"]
    if fields["n_rows"].shape != () or not 0 <= fields["n_rows"] < 1 << 31:
        raise InputError("n_rows", fields["n_rows"].tolist(), "a number of rows")
    if start.ndim != 1 or len(start) == 0 or rows.ndim != 1:
        raise InputError(
            "covered_rows_start", Unquoted(f"shape {start.shape}"), "one number more than columns"
        )
    first = np.asarray(fields.get("numbered_from", 0))
    names = np.asarray(fields.get("names", np.empty(0, dtype=np.str_)))
    if first.shape != () or first.dtype.kind not in "iu":
        raise InputError("numbered_from", Unquoted(f"{first.dtype} of shape {first.shape}"), "0, 1")
    if names.ndim != 1 or not is_text(names):
        raise InputError("names", Unquoted(f"{names.dtype} of shape {names.shape}"), "texts")
    try:
        covers = sp.csr_array(
            (np.ones(len(rows), dtype=np.bool_), rows, start),
            shape=(len(start) - 1, int(fields["n_rows"])),
        )
        covers.check_format(full_check=True)
    except ValueError as error:
        raise InputError("covered_rows", Unquoted(error), "rows of every column") from None
    return build_covering_instance(
        covers,
        cost=fields["cost"],
        weight=fields["weight"],
        names=tuple(names.tolist()),
        numbered_from=int(first),
    )
