"""One way to call a mixed-integer solver through cvxpy, and to read what it has proven."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from geometry.errors import InputError

if TYPE_CHECKING:
    import cvxpy as cp


# ---------- one way to call a mixed-integer solver through cvxpy, and to read what it has proven


DEFAULT_SOLVER = "HIGHS"
# What each solver that may be named calls a limit on its time.
_TIME_LIMITS: dict[str, Any] = {
    "HIGHS": lambda seconds, gap: {
        "time_limit": seconds,
        "mip_rel_gap": gap,
        "mip_abs_gap": 0.0,
    },
    "SCIP": lambda seconds, gap: {
        "scip_params": {"limits/time": max(seconds, 0.0), "limits/gap": gap}
    },
    "CBC": lambda seconds, gap: {"maximumSeconds": seconds, "allowableFractionGap": gap},
    "GLPK_MI": lambda seconds, gap: {"tm_lim": int(1000.0 * seconds) + 1, "mip_gap": gap},
    "GUROBI": lambda seconds, gap: {"TimeLimit": seconds, "MIPGap": gap},
    "CPLEX": lambda seconds, gap: {
        "cplex_params": {"timelimit": seconds, "mip.tolerances.mipgap": gap}
    },
    "SCIPY": lambda seconds, gap: {"scipy_options": {"time_limit": seconds, "mip_rel_gap": gap}},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a solver says of a problem that is maximised.

    Attributes
    ----------
    is_found : bool
        Whether the variables hold a feasible point.
    is_finished : bool
        Whether that is best, or there is none, rather than the best within the time.
    bound : float
        No feasible point has a higher objective; minus infinity if there is none, plus infinity if
        nothing is known.
    """

    is_found: bool
    is_finished: bool
    bound: float


def check_solver(name: str) -> str:
    """The name of a mixed-integer solver that cvxpy finds here.

    Raises
    ------
    InputError
        It is not installed, or cannot be stopped by time.
    """
    solvers = installed_solvers()
    if name.upper() not in solvers:
        raise InputError("--milp-solver", name, "one that is installed: " + ", ".join(solvers))
    return name.upper()


def installed_solvers() -> list[str]:
    """Mixed-integer solvers that cvxpy finds here and that can be stopped by time."""
    import cvxpy as cp

    installed = cp.installed_solvers()
    return [solver for solver in _TIME_LIMITS if solver in installed]


def solver_text(name: str) -> str:
    """Solver and versions, for a certificate."""
    if name == DEFAULT_SOLVER:
        return f"HiGHS {version('highspy')} through cvxpy {version('cvxpy')}"
    return f"{name} through cvxpy {version('cvxpy')}"


def run_solver(
    problem: cp.Problem, *, solver: str, time_limit_s: float, gap: float = 0.0
) -> Answer:
    """Maximise, as far as the time goes.

    Parameters
    ----------
    problem : cvxpy.Problem
        To be maximised; its variables are bounded.
    solver : str
        See :func:`check_solver`.
    time_limit_s : float
        For the solver. [s]
    gap : float
        Relative gap at which it may stop.
    """
    import cvxpy as cp

    options = _TIME_LIMITS[solver](max(time_limit_s, 0.0), gap)
    with warnings.catch_warnings():
        # cvxpy calls a solution inaccurate when the time was up.
        warnings.filterwarnings("ignore", "Solution may be inaccurate")
        try:
            problem.solve(solver=solver, **options)
        except cp.SolverError:  # nothing is known then, and nothing is lost
            return Answer(is_found=False, is_finished=False, bound=np.inf)
    if problem.status in (cp.INFEASIBLE, cp.settings.INFEASIBLE_OR_UNBOUNDED):  # all is bounded
        return Answer(is_found=False, is_finished=True, bound=-np.inf)
    is_finished = problem.status == cp.OPTIMAL
    if solver == DEFAULT_SOLVER:
        info = problem.solver_stats.extra_stats
        is_found = info.primal_solution_status == 2  # kSolutionStatusFeasible
        # cvxpy minimises the negative.
        return Answer(is_found=is_found, is_finished=is_finished, bound=-info.mip_dual_bound)
    is_found = problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE, cp.USER_LIMIT)
    is_found = is_found and all(variable.value is not None for variable in problem.variables())
    bound = float(problem.value) if is_finished else np.inf
    return Answer(is_found=is_found, is_finished=is_finished, bound=bound)


# ---------- how hard the optimiser tries


SolverName = Literal["auto", "exact", "relax", "greedy"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How hard to try.

    Attributes
    ----------
    solver : {"auto", "exact", "relax", "greedy"}
        "greedy": search only, bounded by what all poses together reach; "relax": the bounds of
        relaxations, too; "exact": mixed-integer models and enumeration, too, until the time is up;
        "auto": the same, but relaxations alone where the instance is too large for models.
    time_limit_s : float
        For all stages together; presolve and the first layout are finished in any case. When it is
        up, the best layout found is kept and the gaps say what is not proven. [s]
    gap : float
        Relative gap at which a stage counts as settled.
    milp_solver : str
        Name of the mixed-integer solver in cvxpy.
    """

    solver: SolverName = "auto"
    time_limit_s: float = 60.0
    gap: float = 0.0
    milp_solver: str = DEFAULT_SOLVER

    def __post_init__(self) -> None:
        if self.solver not in ("auto", "exact", "relax", "greedy"):
            raise InputError("--solver", self.solver, "one of auto, exact, relax, greedy")
        if not self.time_limit_s > 0.0:
            raise InputError("--time-limit", self.time_limit_s, "seconds, more than 0")
        if not 0.0 <= self.gap < 1.0:
            raise InputError("--gap", self.gap, "a share, 0 <= gap < 1")
