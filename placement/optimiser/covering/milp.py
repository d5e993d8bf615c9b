"""Covering problems as mixed-integer programs, for HiGHS through cvxpy.

x_c = 1: column c is chosen. y_r: row r is covered; only x has to be whole, for given x every y is
bounded by zeros and ones alone. Constraints are single matrix inequalities: what cvxpy needs to
state a model grows with their number, not with their rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError

from ..milp import run_solver
from .instance import CoveringBudget, is_whole

if TYPE_CHECKING:  # it takes two seconds to import: done where a model is stated
    import cvxpy as cp

AUTO, GREEDY, HIGHS = "auto", "greedy", "HIGHS"
"""What proves soonest; no proof; the mixed-integer solver."""

_LARGEST_SUM = 1.0e6  # of an objective's coefficients: solvers' tolerances are absolute, 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MilpAnswer:
    """What a solver knows when it stops.

    Attributes
    ----------
    chosen : (n,) int or None
        Best columns found; None if none were.
    bound : float
        Least cost, or most weight, that its search leaves possible.
    """

    chosen: IntArray | None
    bound: float


def check_solver(name: str) -> str:
    """The name of a solver as covering problems know it: "auto", "greedy" or "HIGHS".

    Raises
    ------
    InputError
        There is no such solver.
    """
    if name in (AUTO, GREEDY):
        return name
    if name.upper() != HIGHS:
        raise InputError("--solver", name, f"a solver that is installed: {HIGHS}")
    return HIGHS


def cover_at_least_cost(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    *,
    needed_weight: float | None,
    time_limit_s: float,
    gap: float,
) -> MilpAnswer:
    """Location set covering [1]_: least cost for which every row, or enough weight, is covered.

    Parameters
    ----------
    covers : (n_columns, n_rows) sparse
        Whether a column covers a row.
    cost : (n_columns,) float
        Price of each.
    weight : (n_rows,) float
        Of the rows.
    needed_weight : float or None
        What must be covered; None: every row.
    time_limit_s : float
        For the solver. [s]
    gap : float
        Relative gap at which it may stop.

    References
    ----------
    .. [1] C. Toregas, R. Swain, C. ReVelle, L. Bergman, "The location of emergency service
       facilities", Operations Research 19, 1971.
    """
    import cvxpy as cp

    x = cp.Variable(covers.shape[0], boolean=True)
    times_covered = _by_row(covers) @ x
    if needed_weight is None:
        constraints = [times_covered >= 1.0]
    else:
        y = cp.Variable(covers.shape[1], bounds=[0.0, 1.0])
        unit = float(weight.max())
        constraints = [times_covered - y >= 0.0, (weight / unit) @ y >= needed_weight / unit]
    unit = _unit(cost)
    answer = _solve(-(cost / unit) @ x, constraints, x, time_limit_s, gap)
    return MilpAnswer(chosen=answer.chosen, bound=-answer.bound * unit)


def cover_most_weight(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    budget: CoveringBudget,
    *,
    time_limit_s: float,
    gap: float,
) -> MilpAnswer:
    """Maximal covering [1]_: most weight that a number of columns, or some money, covers.

    Parameters
    ----------
    covers, cost, weight, time_limit_s, gap
        As for :func:`cover_at_least_cost`.
    budget : CoveringBudget
        What may be chosen.

    References
    ----------
    .. [1] R. L. Church, C. ReVelle, "The maximal covering location problem", Papers of the
       Regional Science Association 32, 1974.
    """
    import cvxpy as cp

    x = cp.Variable(covers.shape[0], boolean=True)
    y = cp.Variable(covers.shape[1], bounds=[0.0, 1.0])
    constraints = [_by_row(covers) @ x - y >= 0.0]
    if budget.units is not None:
        constraints.append(cp.sum(x) <= budget.units)
    if budget.cost is not None:
        unit = max(float(cost.max()), budget.cost) or 1.0
        constraints.append((cost / unit) @ x <= budget.cost / unit)
    unit = _unit(weight)
    answer = _solve((weight / unit) @ y, constraints, x, time_limit_s, gap)
    return MilpAnswer(chosen=answer.chosen, bound=answer.bound * unit)


def _by_row(covers: sp.csr_array) -> sp.csr_array:
    return sp.csr_array(covers.T).astype(np.float64)


def _unit(coefficients: FloatArray) -> float:
    """What to divide an objective by; whole numbers of an ordinary size stay whole."""
    total = float(coefficients.sum())
    return 1.0 if is_whole(coefficients) and total <= _LARGEST_SUM else total / _LARGEST_SUM


def _solve(
    objective: cp.Expression,
    constraints: list[Any],
    x: cp.Variable,
    time_limit_s: float,
    gap: float,
) -> MilpAnswer:
    """Maximise; every model here has a solution, so that one without has failed."""
    import cvxpy as cp

    problem = cp.Problem(cp.Maximize(objective), constraints)
    answer = run_solver(problem, time_limit_s=time_limit_s, gap=gap)
    if not answer.is_found:
        bound = np.inf if answer.is_finished else answer.bound
        return MilpAnswer(chosen=None, bound=bound)
    return MilpAnswer(chosen=np.flatnonzero(x.value > 0.5), bound=answer.bound)
