"""Covering problems as mixed-integer models, and their solution by HiGHS.

x_c = 1 says that column c is chosen, y_r that row r is covered. Only x has to be whole: for given x
every y is bounded by zeros and ones alone. HiGHS is called directly: it is told the best answer
known, and asked to stop when the user wants to.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
import scipy.sparse as sp

from geometry.arrays import BoolArray, FloatArray, IntArray

from .instance import CoveringBudget, is_whole

_LARGEST_SUM = 1.0e6  # of an objective's coefficients: solvers' tolerances are absolute, 1e-6
_LONGEST_S = 1.0e6  # eleven days
_LOOK_S = 0.05
_GRACE_S = 1.0  # beyond its limit of time, after which it is told to stop
_STOP_S = 0.3  # to stop in when the user wants to; it is left alone then


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MilpAnswer:
    """What a solver knows when it stops."""

    chosen: IntArray | None  # (n,): best columns found; None if none were
    bound: float  # no answer has a better objective


def solver_text() -> str:
    """Solver and version."""
    return f"HiGHS {version('highspy')}"


def cover_at_least_cost(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    *,
    needed_weight: float | None,
    time_limit_s: float,
    gap: float,
    start: IntArray | None = None,
    meanwhile: Callable[[], bool] | None = None,
) -> MilpAnswer:
    """Location set covering [1]_: least cost for which every row, or enough weight, is covered.

    `covers` is (n_columns, n_rows). Every row must be covered if `needed_weight` is None. The
    solver may stop at the relative `gap`. `start`: columns that cover enough, if some are known.
    `meanwhile` is called again and again while the solver works: it does a little work of its own
    and says whether the solver should go on.

    References
    ----------
    .. [1] C. Toregas, R. Swain, C. ReVelle, L. Bergman, "The location of emergency service
       facilities", Operations Research 19, 1971.
    """
    n_columns, n_rows = covers.shape
    unit = _unit(cost)
    chosen = _indicator(start, n_columns)
    if needed_weight is None:
        model = _Model(
            objective=cost / unit,
            is_whole=np.ones(n_columns, dtype=np.bool_),
            matrix=_by_row(covers),
            at_least=np.ones(n_rows),
            at_most=np.full(n_rows, np.inf),
        )
        values = chosen
    else:
        most = float(weight.max())
        matrix = _stack(_by_row(covers), np.concatenate([np.zeros(n_columns), weight / most]))
        model = _Model(
            objective=np.concatenate([cost / unit, np.zeros(n_rows)]),
            is_whole=np.arange(n_columns + n_rows) < n_columns,
            matrix=matrix,
            at_least=np.append(np.zeros(n_rows), needed_weight / most),
            at_most=np.full(n_rows + 1, np.inf),
        )
        values = _with_rows(covers, chosen)
    found, bound = _minimise(model, values, time_limit_s, gap, meanwhile)
    return MilpAnswer(chosen=_columns(found, n_columns), bound=bound * unit)


def cover_most_weight(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    budget: CoveringBudget,
    *,
    time_limit_s: float,
    gap: float,
    start: IntArray | None = None,
) -> MilpAnswer:
    """Maximal covering [1]_: most weight that a number of columns, or some money, covers.

    `budget`: what may be chosen; `start`: columns within it, if some are known.

    References
    ----------
    .. [1] R. L. Church, C. ReVelle, "The maximal covering location problem", Papers of the
       Regional Science Association 32, 1974.
    """
    n_columns, n_rows = covers.shape
    limits: list[tuple[FloatArray, float]] = []
    if budget.units is not None:
        limits.append((np.ones(n_columns), float(budget.units)))
    if budget.cost is not None:
        most = max(float(cost.max()), budget.cost) or 1.0
        limits.append((cost / most, budget.cost / most))
    limited = [np.concatenate([coefficients, np.zeros(n_rows)]) for coefficients, _ in limits]
    unit = _unit(weight)
    model = _Model(
        objective=np.concatenate([np.zeros(n_columns), -weight / unit]),
        is_whole=np.arange(n_columns + n_rows) < n_columns,
        matrix=_stack(_by_row(covers), *limited),
        at_least=np.concatenate([np.zeros(n_rows), np.full(len(limits), -np.inf)]),
        at_most=np.append(np.full(n_rows, np.inf), [limit for _, limit in limits]),
    )
    values = _with_rows(covers, _indicator(start, n_columns))
    found, bound = _minimise(model, values, time_limit_s, gap, None)
    return MilpAnswer(chosen=_columns(found, n_columns), bound=-bound * unit)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Model:
    """Minimise objective @ x, 0 <= x <= 1, at_least <= matrix @ x <= at_most."""

    objective: FloatArray  # (n,)
    is_whole: BoolArray  # (n,)
    matrix: sp.csr_array  # (n_constraints, n)
    at_least: FloatArray  # (n_constraints,)
    at_most: FloatArray  # (n_constraints,)


def _minimise(
    model: _Model,
    start: FloatArray | None,
    time_limit_s: float,
    gap: float,
    meanwhile: Callable[[], bool] | None,
) -> tuple[FloatArray | None, float]:
    """The best point found and a bound; minus infinity if nothing is known.

    HiGHS works in a thread of its own, so that this one does something else meanwhile, and so that
    Ctrl-C is heard at once.
    """
    import highspy

    deadline_s = time.perf_counter() + time_limit_s
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    solver.setOptionValue("time_limit", min(max(time_limit_s, 0.0), _LONGEST_S))
    solver.setOptionValue("mip_rel_gap", gap)
    solver.setOptionValue("mip_abs_gap", 0.0)
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
    kinds = {True: highspy.HighsVarType.kInteger, False: highspy.HighsVarType.kContinuous}
    problem.integrality_ = [kinds[whole] for whole in model.is_whole.tolist()]
    solver.passModel(problem)
    if start is not None:
        known = highspy.HighsSolution()
        known.col_value = start.tolist()
        solver.setSolution(known)
    solver.HandleUserInterrupt = True
    solver.startSolve()
    try:
        is_over = False
        while not is_over:
            goes_on = time.perf_counter() < deadline_s + _GRACE_S
            if goes_on and meanwhile is not None:
                goes_on = meanwhile()
            if not goes_on:
                solver.cancelSolve()
            is_over, _ = solver.wait(_LOOK_S if meanwhile is None or not goes_on else 0.0)
    except BaseException:
        solver.cancelSolve()
        solver.wait(_STOP_S)
        raise
    info = solver.getInfo()
    is_found = info.primal_solution_status == highspy.kSolutionStatusFeasible
    found = np.array(solver.getSolution().col_value) if is_found else None
    return found, float(info.mip_dual_bound)


def _stack(times_covered: sp.csr_array, *rows: FloatArray) -> sp.csr_array:
    """How often each row is covered less y, and more constraints below it."""
    is_covered = -sp.eye_array(times_covered.shape[0], format="csr")
    above = sp.csr_array(sp.hstack([times_covered, is_covered]))
    if not rows:
        return above
    return sp.csr_array(sp.vstack([above, sp.csr_array(np.array(rows))]))


def _by_row(covers: sp.csr_array) -> sp.csr_array:
    return sp.csr_array(covers.T).astype(np.float64)


def _unit(coefficients: FloatArray) -> float:
    """What to divide an objective by; whole numbers of an ordinary size stay whole."""
    total = float(coefficients.sum())
    return 1.0 if is_whole(coefficients) and total <= _LARGEST_SUM else total / _LARGEST_SUM


def _indicator(columns: IntArray | None, n_columns: int) -> FloatArray | None:
    """1 where a column is one of some, 0 elsewhere."""
    if columns is None:
        return None
    chosen = np.zeros(n_columns)
    chosen[columns] = 1.0
    return chosen


def _with_rows(covers: sp.csr_array, chosen: FloatArray | None) -> FloatArray | None:
    """Values of x and, after them, of y."""
    if chosen is None:
        return None
    return np.concatenate([chosen, np.minimum(covers.T @ chosen, 1.0)])


def _columns(values: FloatArray | None, n_columns: int) -> IntArray | None:
    return None if values is None else np.flatnonzero(values[:n_columns] > 0.5)
