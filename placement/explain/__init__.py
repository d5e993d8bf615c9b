"""Why, and why not: what a layout's units are there for, what they miss, what else would do.

``contributions`` takes one unit away at a time; ``failures`` looks at every set of units that may
fail together; ``unavoided`` says why runs are not avoided, and what is in the way; ``pool`` lists
other sets that are as good; ``sensitivity`` changes one assumption at a time, ``tolerance`` the
mounting of one unit. ``conflicts`` finds the smallest set of ``demands`` that no layout meets, and
how little has to give way.
"""

from .conflicts import Conflict, build_separation, find_conflicts, find_refusal
from .contributions import Contribution, find_contributions
from .demands import Demand, Relaxation, Separation, relax
from .pool import Pool, PooledSet, find_pool
from .unavoided import Reason, Rescue, Unavoided, find_unavoided

__all__ = [
    "Conflict",
    "Contribution",
    "Demand",
    "Pool",
    "PooledSet",
    "Reason",
    "Relaxation",
    "Rescue",
    "Separation",
    "Unavoided",
    "build_separation",
    "find_conflicts",
    "find_contributions",
    "find_pool",
    "find_refusal",
    "find_unavoided",
    "relax",
]
