"""Covering problems of the literature, solved and proven by HiGHS: LSCP and MCLP.

LSCP, the location set covering problem [1]_: at least cost, cover everything, or enough. MCLP, the
maximal covering location problem [2]_: within a budget, cover as much as possible. Greedy choice
and a bound without a solver come first; HiGHS starts from them. Objectives are counted on the
instance itself, never taken from the solver.

x_c = 1 says that column c is chosen, y_r that row r is covered. Only x has to be whole: for given x
every y is bounded by zeros and ones alone.

References
----------
.. [1] C. Toregas, R. Swain, C. ReVelle, L. Bergman, "The location of emergency service facilities",
   Operations Research 19, 1971.
.. [2] R. L. Church, C. ReVelle, "The maximal covering location problem", Papers of the Regional
   Science Association 32, 1974.
"""

import math
import time
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray, FloatArray, IntArray, float_array, freeze
from geometry.errors import InputError, Unquoted

from ..layout import relative_gap
from ..memory import check_fits
from ..optimiser.steering import ROUNDING, common_step, settle

# ---------- instances


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveringInstance:
    """A covering problem without its question: columns can be chosen, rows want to be covered."""

    # (n_columns, n_rows): whether a column (a pose) covers a row (a demand). Compressed by columns
    # of the problem: ``covers.indices[covers.indptr[c] : covers.indptr[c + 1]]`` are the rows that
    # column c covers, ascending. May be given as any array
    covers: sp.csr_array
    cost: FloatArray  # (n_columns,): price of each column, not negative
    weight: FloatArray  # (n_rows,): what covering each row is worth, not negative
    names: tuple[str, ...] = ()  # of the columns; empty if they have none
    # the number of the first column where the instance comes from: 1 in OR-Library's files
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
    """Limits on what may be chosen."""

    units: int | None = None  # at most so many columns; by default any number
    cost: float | None = None  # at most so much money; by default any

    def __post_init__(self) -> None:
        if self.units is None and self.cost is None:
            raise InputError("budget_units", Unquoted("nothing"), "a number of columns, or money")
        if self.units is not None and self.units < 1:
            raise InputError("budget_units", self.units, "a whole number of columns, at least 1")
        if self.cost is not None and not 0.0 <= self.cost < math.inf:
            raise InputError("budget_cost", self.cost, "an amount of money, at least 0")

    @property
    def money(self) -> float:
        """Most that may be spent, with what sums may be off by; infinite if there is no limit."""
        return math.inf if self.cost is None else self.cost * (1.0 + ROUNDING)

    def allows(self, cost: ArrayLike) -> bool:
        """True if columns at these costs may be chosen together."""
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
            "budget_cost",
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
    return float(np.ceil(needed)) if is_whole(instance.weight) else max(needed, 0.0)


def is_whole(amounts: FloatArray) -> bool:
    """True if all are whole numbers, so that their sums are, too."""
    return bool((amounts == np.round(amounts)).all())


def check_effort(*, time_limit_s: float, gap: float) -> None:
    """Check how long to look and how near is near enough.

    Raises InputError: the time is not positive, or the gap is no share.
    """
    if not time_limit_s > 0.0:
        raise InputError("time_limit_s", time_limit_s, "seconds, more than 0")
    if not 0.0 <= gap < 1.0:
        raise InputError("gap", gap, "a share, 0 <= gap < 1")


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
    """An answer to a covering problem, and how good it is.

    Attributes
    ----------
    chosen : (n,) int
        Indices of columns, ascending.
    objective : float
        LSCP: their cost. MCLP: the weight that they cover.
    bound : float
        LSCP: no answer costs less. MCLP: none covers more.
    gap : float
        Relative distance of the two, as HiGHS defines it.
    cost : float
        Of the columns chosen.
    covered_weight : float
        Of the rows that they cover.
    solver : str
        What found and proved it.
    seconds : float
        From instance to answer, model building included. [s]
    """

    chosen: IntArray
    objective: float
    bound: float
    gap: float
    cost: float
    covered_weight: float
    solver: str
    seconds: float

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
    check_effort(time_limit_s=time_limit_s, gap=gap)
    has_proof = _has_proof(solver, instance)
    needed = needed_weight(instance, target)
    rows = np.flatnonzero((instance.weight > 0.0) & _is_coverable(instance))
    covers, cost = sp.csr_array(instance.covers[:, rows]), instance.cost
    # Where all rows are needed, each counts alike: no sum of weights, no tolerance.
    weight = np.ones(len(rows)) if needed is None else instance.weight[rows]
    enough = float(len(rows)) if needed is None else needed
    chosen = _cheap_cover(covers, cost, weight, enough)
    bound = _least_cost_bound(covers, cost, weight, enough)
    if has_proof and bound < cost[chosen].sum():
        unit = _unit(cost)
        model = _cover_model(covers, cost / unit, weight, needed)
        found, bound_found = _minimise(
            model, chosen, time_limit_s - (time.perf_counter() - began_s), gap
        )
        bound = max(bound, bound_found * unit)
        if found is not None and _covered(covers, weight, found) >= enough * (1.0 - ROUNDING):
            found = _drop_redundant(covers, cost, weight, found, enough)
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
    check_effort(time_limit_s=time_limit_s, gap=gap)
    has_proof = _has_proof(solver, instance)
    budget = simplify_budget(instance, CoveringBudget(units=budget_units, cost=budget_cost))
    rows = np.flatnonzero((instance.weight > 0.0) & _is_coverable(instance))
    covers, cost, weight = (
        sp.csr_array(instance.covers[:, rows]),
        instance.cost,
        instance.weight[rows],
    )
    chosen = _wide_cover(covers, cost, weight, budget)
    bound = _most_weight_bound(covers, cost, weight, budget)
    if has_proof and bound > _covered(covers, weight, chosen):
        unit = _unit(weight)
        model = _weight_model(covers, cost, weight / unit, budget)
        found, bound_found = _minimise(
            model, chosen, time_limit_s - (time.perf_counter() - began_s), gap
        )
        bound = min(bound, -bound_found * unit)
        if found is not None and budget.allows(cost[found]):
            found = _drop_redundant(covers, cost, weight, found, _covered(covers, weight, found))
            chosen = max((chosen, found), key=lambda columns: _covered(covers, weight, columns))
    covered = instance.covered_weight(chosen)
    bound = settle(covered, bound, bound, step=common_step(weight))
    return _solution(instance, chosen, covered, bound, has_proof, began_s)


def solver_text() -> str:
    """Solver and version."""
    return f"HiGHS {version('highspy')}"


def _has_proof(solver: str, instance: CoveringInstance) -> bool:
    """True if a solver proves its answers, by its name.

    Raises InputError: there is no such solver, or no memory for it.
    """
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


def _is_coverable(instance: CoveringInstance) -> BoolArray:
    is_coverable = np.zeros(instance.n_rows, dtype=np.bool_)
    is_coverable[instance.covers.indices] = True
    return is_coverable


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
        solver=solver_text() if has_proof else GREEDY,
        seconds=time.perf_counter() - began_s,
    )


# ---------- greedy choice, and bounds without a solver


def _covered(covers: sp.csr_array, weight: FloatArray, columns: IntArray) -> float:
    return float(weight[np.unique(covers[columns].indices)].sum())


def _cheap_cover(
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, needed_weight: float
) -> IntArray:
    """Columns that cover a weight: each the one with the most new weight for its cost."""
    left = weight.copy()
    chosen: list[int] = []
    slack = ROUNDING * float(weight.sum())
    while weight.sum() - left.sum() < needed_weight - slack:
        # Beyond what is needed nothing counts: no large column for a small remainder.
        missing = needed_weight - (weight.sum() - left.sum())
        gain = np.minimum(covers @ left, missing)
        if not gain.max(initial=0.0) > 0.0:
            break
        best = int(np.argmax(_per_cost(gain, cost)))
        chosen.append(best)
        left[covers[[best]].indices] = 0.0
    return _drop_redundant(covers, cost, weight, np.array(chosen, dtype=np.int64), needed_weight)


def _wide_cover(
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, budget: CoveringBudget
) -> IntArray:
    """Columns within a budget: greedy choice by weight, and by weight for cost; the better one."""

    def fill(price: FloatArray) -> IntArray:
        left = weight.copy()
        chosen: list[int] = []
        while budget.units is None or len(chosen) < budget.units:
            gain = np.asarray(covers @ left, dtype=np.float64)
            gain[cost > budget.money - cost[chosen].sum()] = 0.0
            if not gain.max(initial=0.0) > 0.0:
                break
            best = int(np.argmax(_per_cost(gain, price)))
            chosen.append(best)
            left[covers[[best]].indices] = 0.0
        return np.array(chosen, dtype=np.int64)

    fills = [fill(np.ones(len(cost)))] + ([] if budget.cost is None else [fill(cost)])
    return max(fills, key=lambda columns: _covered(covers, weight, columns))


def _per_cost(gain: FloatArray, cost: FloatArray) -> FloatArray:
    """Weight for each unit of cost, (n_columns,); infinite where it is for nothing."""
    ratio = np.divide(gain, cost, out=np.full(len(cost), np.inf), where=cost > 0.0)
    return np.where(gain > 0.0, ratio, -1.0)


def _drop_redundant(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    chosen: IntArray,
    needed_weight: float,
) -> IntArray:
    """Those of some columns that are needed to cover a weight; the dearest are left out first."""
    times = np.bincount(covers[chosen].indices, minlength=covers.shape[1])
    spare = float(weight[times > 0].sum()) - needed_weight + ROUNDING * float(weight.sum())
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
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, needed_weight: float
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
    taken = np.clip(needed_weight - before, 0.0, weight[order])
    return float(least[order] @ taken)


def _most_weight_bound(
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, budget: CoveringBudget
) -> float:
    """A weight that no columns within a budget exceed: as if no two covered the same row."""
    gain = np.asarray(covers @ weight, dtype=np.float64)
    bound = float(weight.sum())
    if budget.units is not None:
        bound = min(bound, float(np.sort(gain)[::-1][: budget.units].sum()))
    if budget.cost is not None:
        order = np.argsort(-_per_cost(gain, cost), kind="stable")
        before = np.cumsum(cost[order]) - cost[order]
        share = np.clip(budget.cost - before, 0.0, cost[order])
        share = np.divide(share, cost[order], out=np.ones(len(cost)), where=cost[order] > 0.0)
        bound = min(bound, float(gain[order] @ share))
    return bound


# ---------- the mixed-integer models


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Model:
    """Minimise objective @ (x, y), 0 <= x, y <= 1, at_least <= matrix @ (x, y) <= at_most."""

    objective: FloatArray  # (n_columns + n_rows,), or (n_columns,) where every row is covered
    matrix: sp.csr_array  # (n_constraints, len(objective))
    at_least: FloatArray  # (n_constraints,)
    at_most: FloatArray  # (n_constraints,)
    covers: sp.csr_array  # (n_columns, n_rows)


def _cover_model(
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, needed_weight: float | None
) -> _Model:
    """Least cost for which every row, or enough weight, is covered."""
    n_columns, n_rows = covers.shape
    by_row = sp.csr_array(covers.T).astype(np.float64)
    if needed_weight is None:
        return _Model(
            objective=cost,
            matrix=by_row,
            at_least=np.ones(n_rows),
            at_most=np.full(n_rows, np.inf),
            covers=covers,
        )
    most = float(weight.max(initial=0.0)) or 1.0
    return _Model(
        objective=np.append(cost, np.zeros(n_rows)),
        matrix=_stack(by_row, np.append(np.zeros(n_columns), weight / most)),
        at_least=np.append(np.zeros(n_rows), needed_weight / most),
        at_most=np.full(n_rows + 1, np.inf),
        covers=covers,
    )


def _weight_model(
    covers: sp.csr_array, cost: FloatArray, weight: FloatArray, budget: CoveringBudget
) -> _Model:
    """Most weight that a number of columns, or some money, covers."""
    n_columns, n_rows = covers.shape
    limits: list[tuple[FloatArray, float]] = []
    if budget.units is not None:
        limits.append((np.ones(n_columns), float(budget.units)))
    if budget.cost is not None:
        most = max(float(cost.max(initial=0.0)), budget.cost) or 1.0
        limits.append((cost / most, budget.cost / most))
    return _Model(
        objective=np.append(np.zeros(n_columns), -weight),
        matrix=_stack(
            sp.csr_array(covers.T).astype(np.float64),
            *(np.append(coefficients, np.zeros(n_rows)) for coefficients, _ in limits),
        ),
        at_least=np.append(np.zeros(n_rows), np.full(len(limits), -np.inf)),
        at_most=np.append(np.full(n_rows, np.inf), [limit for _, limit in limits]),
        covers=covers,
    )


def _stack(times_covered: sp.csr_array, *rows: FloatArray) -> sp.csr_array:
    """How often each row is covered less y, and more constraints below it."""
    is_covered = -sp.eye_array(times_covered.shape[0], format="csr")
    above = sp.csr_array(sp.hstack([times_covered, is_covered]))
    return sp.csr_array(sp.vstack([above, sp.csr_array(np.array(rows))])) if rows else above


def _unit(coefficients: FloatArray) -> float:
    """Divisor of an objective; whole numbers of an ordinary size stay whole."""
    total = float(coefficients.sum())
    if total == 0.0 or (is_whole(coefficients) and total <= _LARGEST_SUM):
        return 1.0
    return total / _LARGEST_SUM


def _minimise(
    model: _Model, start: IntArray, time_limit_s: float, gap: float
) -> tuple[IntArray | None, float]:
    """The best columns found and a bound; minus infinity if nothing is known.

    HiGHS is called directly, not by cvxpy: it starts from the greedy choice, and works in a thread
    of its own so that Ctrl-C is noticed at once.
    """
    import highspy

    deadline_s = time.perf_counter() + time_limit_s
    if time_limit_s <= 0.0:
        return None, -math.inf
    solver = highspy.Highs()
    for option, value in (
        ("output_flag", False),
        ("time_limit", min(time_limit_s, _LONGEST_S)),
        ("mip_rel_gap", gap),
        ("mip_abs_gap", 0.0),
    ):
        solver.setOptionValue(option, value)
    n_columns = model.covers.shape[0]
    n_constraints, n = model.matrix.shape
    problem = highspy.HighsLp()
    problem.num_col_, problem.num_row_ = n, n_constraints
    problem.col_cost_ = model.objective
    problem.col_lower_, problem.col_upper_ = np.zeros(n), np.ones(n)
    problem.row_lower_, problem.row_upper_ = model.at_least, model.at_most
    problem.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    problem.a_matrix_.start_ = model.matrix.indptr
    problem.a_matrix_.index_ = model.matrix.indices
    problem.a_matrix_.value_ = model.matrix.data.astype(np.float64)
    whole, continuous = highspy.HighsVarType.kInteger, highspy.HighsVarType.kContinuous
    problem.integrality_ = [whole] * n_columns + [continuous] * (n - n_columns)
    solver.passModel(problem)
    known = highspy.HighsSolution()
    known.col_value = _values(model, start).tolist()
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


def _values(model: _Model, chosen: IntArray) -> FloatArray:
    """Values of x and, where the model has them, of y."""
    x = np.zeros(model.covers.shape[0])
    x[chosen] = 1.0
    y = np.minimum(model.covers.T @ x, 1.0)
    return np.append(x, y)[: len(model.objective)]
