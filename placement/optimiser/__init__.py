"""From a detection table to the best poses, proven.

``problem`` says what is asked and what a set of poses is worth, ``objectives`` in which order sets
are compared, ``limits`` what may be mounted together.
``presolve`` drops what does not matter; ``bitsets`` values many sets at once. ``greedy`` finds good
sets quickly, and ``enumeration`` goes through all sets that may be better. ``set_tree`` lays
detections out and prices runs, ``cover_tree`` walks through all sets that reach an APR, also when
units fail; ``tied_sets`` chooses among those that tie. Modules called ``.._kernels`` are machine
code. Bounds come from ``bounds`` (Lagrangian), ``relaxation`` (subgradient steps and OSQP),
``window_cover`` (branch and bound) and ``model`` (HiGHS), and ``promises`` says what they mean for
sets. ``stages`` takes the objectives in order with ``search``. ``solve`` calls it all, says which
wish cannot be met, and solves tables that are too large for models. ``threads`` shares work out.
``front`` and ``cost_front`` say what more units or more money buy. ``tolerances`` says which values
are equal, and how far a solver's bound can be believed.
"""

from .greedy import solve_greedy
from .limits import Failing, Limits, cost_eur, is_allowed
from .model import Effort
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
from .solve import Solution, UnmetError, solve_placement

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
]
