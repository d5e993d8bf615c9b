"""Covering problems as mixed-integer programs, through cvxpy, for any solver it finds by name.

x_c = 1: column c is chosen. y_r: row r is covered; only x has to be whole, for given x every y is
bounded by zeros and ones alone. Constraints are single matrix inequalities: what cvxpy needs to
state a model grows with their number, not with their rows.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError

from .instance import CoveringBudget, is_whole

if TYPE_CHECKING:  # it takes two seconds to import: done where a model is stated
    import cvxpy as cp

DEFAULT_SOLVER = "HIGHS"

_LARGEST_SUM = 1.0e6  # of an objective's coefficients: solvers' tolerances are absolute, 1e-6
_LONGEST_S = 1.0e6  # eleven days, in milliseconds still a 32-bit number
_FEASIBLE = 2  # HiGHS: kSolutionStatusFeasible


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverInterface:
    """How to speak to a solver through cvxpy.

    Attributes
    ----------
    distribution : str
        Its Python package, for the version.
    options : callable
        Time limit [s] and relative gap to the options that cvxpy passes on.
    bound : callable, optional
        What cvxpy returns of the solver to the bound it proved, of the minimisation; None: it
        does not tell.
    """

    distribution: str
    options: Callable[[float, float], Mapping[str, Any]]
    bound: Callable[[Any], float] | None = None


SOLVERS: Mapping[str, SolverInterface] = {
    "HIGHS": SolverInterface(
        distribution="highspy",
        options=lambda time_limit_s, gap: {
            "time_limit": time_limit_s,
            "mip_rel_gap": gap,
            "mip_abs_gap": 0.0,
        },
        bound=lambda info: float(info.mip_dual_bound),
    ),
    "SCIPY": SolverInterface(
        distribution="scipy",
        options=lambda time_limit_s, gap: {
            "scipy_options": {"time_limit": time_limit_s, "mip_rel_gap": gap}
        },
        bound=lambda info: float(info["mip_dual_bound"]),
    ),
    "SCIP": SolverInterface(
        distribution="pyscipopt",
        options=lambda time_limit_s, gap: {
            "scip_params": {"limits/time": time_limit_s, "limits/gap": gap}
        },
        bound=lambda info: float(info["model"].getDualbound()),
    ),
    "CBC": SolverInterface(
        distribution="cylp",
        options=lambda time_limit_s, gap: {
            "maximumSeconds": time_limit_s,
            "allowableFractionGap": gap,
        },
    ),
    "GLPK_MI": SolverInterface(
        distribution="cvxopt",
        options=lambda time_limit_s, gap: {
            "tm_lim": max(1, round(1000.0 * time_limit_s)),
            "mip_gap": gap,
        },
    ),
    "GUROBI": SolverInterface(
        distribution="gurobipy",
        options=lambda time_limit_s, gap: {"TimeLimit": time_limit_s, "MIPGap": gap},
        bound=lambda model: float(model.ObjBound),
    ),
}
"""Solvers by cvxpy's name, those whose time limit and gap are known."""


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


_NOTHING_KNOWN = MilpAnswer(chosen=None, bound=-np.inf)


def check_solver(name: str) -> str:
    """The name of a solver that is there, as cvxpy writes it.

    Raises
    ------
    InputError
        It is not installed, or not known here; the message lists those that are.
    """
    wanted = name.upper()
    if wanted == DEFAULT_SOLVER:  # comes with this project
        return wanted
    import cvxpy as cp

    installed = [known for known in SOLVERS if known in cp.installed_solvers()]
    if wanted not in installed:
        raise InputError("--solver", name, "a solver that is installed: " + ", ".join(installed))
    return wanted


def describe_solver(name: str) -> str:
    """Name and version of a solver and of cvxpy."""
    distributions = {name: SOLVERS[name].distribution, "cvxpy": "cvxpy"}
    words = []
    for each, distribution in distributions.items():
        try:
            words.append(f"{each} {version(distribution)}")
        except PackageNotFoundError:  # a solver can come by other ways than pip
            words.append(each)
    return " through ".join(words)


def cover_at_least_cost(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    *,
    needed_weight: float | None,
    solver: str,
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
    solver : str
        One of :data:`SOLVERS`.
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
    answer = _solve(cp.Minimize((cost / unit) @ x), constraints, x, solver, time_limit_s, gap)
    return MilpAnswer(chosen=answer.chosen, bound=answer.bound * unit)


def cover_most_weight(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    budget: CoveringBudget,
    *,
    solver: str,
    time_limit_s: float,
    gap: float,
) -> MilpAnswer:
    """Maximal covering [1]_: most weight that a number of columns, or some money, covers.

    Parameters
    ----------
    covers, cost, weight, solver, time_limit_s, gap
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
    answer = _solve(cp.Minimize((-weight / unit) @ y), constraints, x, solver, time_limit_s, gap)
    return MilpAnswer(chosen=answer.chosen, bound=-answer.bound * unit)


def _by_row(covers: sp.csr_array) -> sp.csr_array:
    return sp.csr_array(covers.T).astype(np.float64)


def _unit(coefficients: FloatArray) -> float:
    """What to divide an objective by; whole numbers of an ordinary size stay whole."""
    total = float(coefficients.sum())
    return 1.0 if is_whole(coefficients) and total <= _LARGEST_SUM else total / _LARGEST_SUM


def _solve(
    objective: cp.Minimize,
    constraints: list[Any],
    x: cp.Variable,
    solver: str,
    time_limit_s: float,
    gap: float,
) -> MilpAnswer:
    import cvxpy as cp

    interface = SOLVERS[solver]
    problem = cp.Problem(objective, constraints)
    limit_s = min(max(time_limit_s, 0.0), _LONGEST_S)
    with warnings.catch_warnings():
        # cvxpy calls a solution inaccurate when the time was up.
        warnings.filterwarnings("ignore", "Solution may be inaccurate")
        try:
            problem.solve(solver=solver, **interface.options(limit_s, gap))
        except cp.SolverError:  # such as: nothing was found in time
            return _NOTHING_KNOWN
    if x.value is None:  # every model here has a solution: it was the solver that failed
        return _NOTHING_KNOWN
    info = problem.solver_stats.extra_stats
    if solver == DEFAULT_SOLVER and info.primal_solution_status != _FEASIBLE:
        return MilpAnswer(chosen=None, bound=float(info.mip_dual_bound))
    if interface.bound is not None and info is not None:
        bound = interface.bound(info)
    elif problem.status == cp.OPTIMAL:  # as far as the solver was asked to
        bound = float(objective.value) - gap * abs(float(objective.value))
    else:
        bound = -np.inf
    return MilpAnswer(chosen=np.flatnonzero(x.value > 0.5), bound=bound)
