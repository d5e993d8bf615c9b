"""From a detection table to the best poses, proven.

problem.py says what is asked and what a set of poses is worth; presolve.py drops what does not
matter; greedy.py finds good sets quickly; model.py and cuts.py state what HiGHS solves;
enumeration.py goes through all sets of few units; solve.py takes the stages in order: APR, APR
when one unit fails, smallest margin, mean margin.
"""

from .greedy import solve_greedy
from .presolve import PresolveStatistics, ReducedProblem, presolve
from .problem import (
    Fusion,
    PlacementProblem,
    PlacementValue,
    apr,
    apr_one_failed,
    is_better,
    is_feasible,
    placement_value,
    run_margins_s,
)
from .solve import Solution, solve_placement

__all__ = [
    "Fusion",
    "PlacementProblem",
    "PlacementValue",
    "PresolveStatistics",
    "ReducedProblem",
    "Solution",
    "apr",
    "apr_one_failed",
    "is_better",
    "is_feasible",
    "placement_value",
    "presolve",
    "run_margins_s",
    "solve_greedy",
    "solve_placement",
]
