"""HiGHS called through cvxpy, what it has proven, and how hard the optimiser tries."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Literal

import numpy as np

from geometry.errors import InputError

if TYPE_CHECKING:
    import cvxpy as cp


_LONGEST_S = 1.0e6  # eleven days


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a solver says of a problem that is maximised."""

    is_found: bool  # whether the variables hold a feasible point
    # Whether that is best, or there is none, rather than the best within the time.
    is_finished: bool
    # No feasible point has a higher objective; minus infinity if there is none, plus infinity if
    # nothing is known.
    bound: float


def solver_text() -> str:
    """Solver and versions, for a certificate."""
    return f"HiGHS {version('highspy')} through cvxpy {version('cvxpy')}"


def run_solver(problem: cp.Problem, *, time_limit_s: float, gap: float = 0.0) -> Answer:
    """Maximise by HiGHS, as far as the time goes or down to a relative gap.

    All variables of the problem are bounded.
    """
    import cvxpy as cp

    with warnings.catch_warnings():
        # cvxpy calls a solution inaccurate when the time was up.
        warnings.filterwarnings("ignore", "Solution may be inaccurate")
        try:
            problem.solve(
                solver="HIGHS",
                time_limit=min(max(time_limit_s, 0.0), _LONGEST_S),
                mip_rel_gap=gap,
                mip_abs_gap=0.0,
            )
        except cp.SolverError:  # nothing is known then, and nothing is lost
            return Answer(is_found=False, is_finished=False, bound=np.inf)
    if problem.status in (cp.INFEASIBLE, cp.settings.INFEASIBLE_OR_UNBOUNDED):  # all is bounded
        return Answer(is_found=False, is_finished=True, bound=-np.inf)
    info = problem.solver_stats.extra_stats
    return Answer(
        is_found=info.primal_solution_status == 2,  # kSolutionStatusFeasible
        is_finished=problem.status == cp.OPTIMAL,
        bound=-info.mip_dual_bound,  # cvxpy minimises the negative
    )


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
    """

    solver: SolverName = "auto"
    time_limit_s: float = 60.0
    gap: float = 0.0

    def __post_init__(self) -> None:
        if self.solver not in ("auto", "exact", "relax", "greedy"):
            raise InputError("--solver", self.solver, "one of auto, exact, relax, greedy")
        if not self.time_limit_s > 0.0:
            raise InputError("--time-limit", self.time_limit_s, "seconds, more than 0")
        if not 0.0 <= self.gap < 1.0:
            raise InputError("--gap", self.gap, "a share, 0 <= gap < 1")
