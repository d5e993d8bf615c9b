"""Why, and why not: what a layout's units are there for, what they miss, what else would do.

``contributions`` takes one unit away at a time; ``unavoided`` takes the runs that are not avoided,
and asks ``hiding`` what is in the way; ``pool`` lists other sets as good, by going through
``every_set`` or by ``exchange``, on the ``rows`` of what sets are worth. ``conflicts`` finds the
smallest set of ``demands`` that no layout meets and asks ``relaxing`` how little has to give way,
both by the ``oracle``; ``wording`` says it in the words of the command line.
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
