"""From a detection table to the best poses, proven.

``problem`` says what is asked and what a set of poses is worth, ``objectives`` in which order sets
are compared, ``limits`` what may be mounted together, ``feasibility`` which wish cannot be met.
``presolve`` drops what does not matter; ``bitsets`` values many sets at once. ``greedy`` finds good
sets quickly, and ``enumeration`` goes through all sets that may be better. Bounds come from
``bounds`` (Lagrangian), ``multipliers`` (subgradient steps), ``relaxation`` (OSQP),
``window_cover`` with ``branch_and_bound``, and ``model``, which ``milp`` hands to HiGHS. ``stages``
takes the objectives in order with ``search``, and ``solve`` calls it all; ``large`` is for tables
that no model takes. ``units_front`` and ``cost_front`` say what more units or more money buy.
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
