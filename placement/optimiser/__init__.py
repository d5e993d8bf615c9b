"""From a detection table to the best poses, proven.

problem.py says what is asked and what a set of poses is worth, limits.py what may be mounted
together, measure.py how the APR sums up runs and sampled worlds; presolve.py drops what does not
matter; greedy.py finds good sets quickly; model.py and cuts.py state what a mixed-integer solver
solves, milp.py calls it; enumeration.py and best_of.py go through all sets that may matter;
stages.py takes the objectives in order: APR, APR when one unit fails, smallest margin, mean
margin, cost; solve.py calls it all, large.py for tables that no model takes. feasibility.py says
which wish cannot be met.
"""

from .feasibility import UnmetError
from .greedy import solve_greedy
from .limits import Limits, cost_eur, is_allowed
from .milp import Effort
from .objectives import Goal, Objective
from .presolve import PresolveStatistics, ReducedProblem, presolve
from .problem import (
    Floor,
    Fusion,
    PlacementProblem,
    PlacementValue,
    apr,
    apr_failed,
    apr_one_failed,
    floor_value,
    is_better,
    is_feasible,
    placement_value,
    run_margins_s,
)
from .solve import Solution, solve_placement

__all__ = [
    "Effort",
    "Floor",
    "Fusion",
    "Goal",
    "Limits",
    "Objective",
    "PlacementProblem",
    "PlacementValue",
    "PresolveStatistics",
    "ReducedProblem",
    "Solution",
    "UnmetError",
    "apr",
    "apr_failed",
    "apr_one_failed",
    "cost_eur",
    "floor_value",
    "is_allowed",
    "is_better",
    "is_feasible",
    "placement_value",
    "presolve",
    "run_margins_s",
    "solve_greedy",
    "solve_placement",
]
