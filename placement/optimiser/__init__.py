"""From a detection table to the best poses, proven: four rungs, each where the one before ends.

``problem`` and ``allowed_sets`` say what is asked and what a set of poses is worth, ``timing`` how
hard to try, ``bitsets`` what many sets are worth. 1. ``presolve`` drops what does not matter,
``greedy`` finds good sets. 2. ``bounds``: the Lagrangian bound, polished by OSQP. 3. ``walk``: all
sets that may be as good; ``pairs``, where worlds are sampled. 4. ``model``: HiGHS. ``proof`` takes
the objectives in order, ``solve`` calls it all, ``front`` says what more units or more money buy.
Modules called ``.._kernels`` are compiled by Numba.
"""

from .allowed_sets import Failing, Limits, cost_eur, is_allowed
from .greedy import solve_greedy
from .presolve import PresolveStatistics, ReducedProblem, presolve
from .problem import (
    Floor,
    Fusion,
    Goal,
    Objective,
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
from .solve import Solution, UnmetError, solve_placement, solve_sturdily, sturdy_problem
from .timing import Effort

__all__ = [
    "Effort",
    "Failing",
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
    "solve_sturdily",
    "sturdy_problem",
]
