"""From a detection table to the best poses, proven, in four rungs.

``problem`` and ``allowed_sets`` say what is asked and what a set of poses is
worth, ``constants`` how hard to try, ``bitsets`` what many sets are worth.

1. ``presolve`` drops what does not matter, ``greedy`` finds good sets.
2. ``bounds``: the Lagrangian bound, polished by OSQP.
3. ``walk``: all sets that may be as good; ``pairs``, where worlds are sampled.
4. ``model``: HiGHS.

Each rung goes on where the one before ends. ``proof`` takes the objectives in
order, ``solve`` calls it all, ``front`` and ``cost_front`` say what more units
or more money buy. Modules called ``.._kernels`` are compiled by Numba.
"""

from .allowed_sets import Failing as Failing
from .allowed_sets import Limits as Limits
from .allowed_sets import cost_eur as cost_eur
from .allowed_sets import is_allowed as is_allowed
from .constants import Effort as Effort
from .greedy import solve_greedy as solve_greedy
from .presolve import PresolveStatistics as PresolveStatistics
from .presolve import ReducedProblem as ReducedProblem
from .presolve import presolve as presolve
from .problem import Floor as Floor
from .problem import Fusion as Fusion
from .problem import Goal as Goal
from .problem import Objective as Objective
from .problem import PlacementProblem as PlacementProblem
from .problem import PlacementValue as PlacementValue
from .problem import apr as apr
from .problem import apr_failed as apr_failed
from .problem import apr_one_failed as apr_one_failed
from .problem import floor_value as floor_value
from .problem import is_better as is_better
from .problem import is_feasible as is_feasible
from .problem import placement_value as placement_value
from .problem import run_margins_s as run_margins_s
from .solve import Solution as Solution
from .solve import UnmetError as UnmetError
from .solve import solve_placement as solve_placement
from .solve import solve_sturdily as solve_sturdily
from .solve import sturdy_problem as sturdy_problem
