"""Which demands contradict each other, and how little has to give way.

The smallest conflict is found by implicit hitting sets: demands that cannot all be met have to hit
the complement of every set that can. The smallest set that hits all complements known so far is
asked for; either nothing meets it, and no smaller conflict exists, or what meets it shows another
complement.
"""

import time
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from itertools import combinations

from ..optimiser import PlacementProblem
from ..optimiser.milp import DEFAULT_SOLVER
from .demands import Demand, Separation, Wish
from .oracle import Answer, Oracle
from .relaxing import Relaxation, find_relaxation

_MAX_SETS = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Conflict:
    """Demands that cannot all be met; any part of them can.

    Attributes
    ----------
    demands : tuple of Demand
        In the order of ``Wish.demands``.
    is_smallest : bool
        Proven: no conflict has fewer demands. Else time was short, and some may be needless.
    relaxations : tuple of Relaxation
        For each demand the least by which it has to give way, where that was found.
    """

    demands: tuple[Demand, ...]
    is_smallest: bool
    relaxations: tuple[Relaxation, ...]


def find_conflicts(
    problem: PlacementProblem,
    *,
    separation: Separation | None = None,
    keeps_forced: bool = False,
    time_limit_s: float = 30.0,
    milp_solver: str = DEFAULT_SOLVER,
    max_sets: int = _MAX_SETS,
) -> tuple[Conflict, ...]:
    """Why no set of poses meets limits and floors.

    Parameters
    ----------
    problem : PlacementProblem
        The wish.
    separation : Separation, optional
        Where its rivals come from, if from a least distance.
    keeps_forced : bool
        Forced poses are no demand but a fact, such as units that hang there already.
    time_limit_s : float
        For all questions together; presolve is finished in any case. [s]
    milp_solver : str
        Name in cvxpy.
    max_sets : int
        Sets are gone through one by one if there are no more, else by models.

    Returns
    -------
    conflicts : tuple of Conflict
        A smallest one first, then a smallest one among the demands that are left, and so on: no
        two share a demand. None if the wish can be met, or it was not found out that it cannot, or
        nothing would help.
    """
    if problem.table.n_poses == 0:
        return ()
    wish = Wish(problem, separation, keeps_forced=keeps_forced)
    oracle = Oracle(
        problem, end_s=time.monotonic() + time_limit_s, milp_solver=milp_solver, max_sets=max_sets
    )
    asked: dict[frozenset[int], Answer] = {}

    def ask(active: frozenset[int]) -> Answer:
        if active not in asked:
            asked[active] = oracle.find(wish.part(active))
        return asked[active]

    if ask(frozenset()).pose_index is None:  # forced and forbidden, say
        return ()
    left, found = wish.everything, []
    while left and _is_refused(ask(left)):
        numbers, is_smallest = _smallest_conflict(wish, left, ask)
        found.append((numbers, is_smallest))
        left -= numbers
    return tuple(
        Conflict(
            demands=tuple(wish.demands[number] for number in sorted(numbers)),
            is_smallest=is_smallest,
            relaxations=_relaxations(wish, oracle, numbers, ask),
        )
        for numbers, is_smallest in found
    )


def _is_refused(answer: Answer) -> bool:
    return answer.pose_index is None and answer.is_proven


def _smallest_conflict(
    wish: Wish, demands: frozenset[int], ask: Callable[[frozenset[int]], Answer]
) -> tuple[frozenset[int], bool]:
    """A conflict among demands that cannot all be met, and whether no other one is smaller."""
    complements: list[frozenset[int]] = []
    while True:
        tried = _smallest_hitting_set(complements, demands)
        answer = ask(tried)
        if _is_refused(answer):
            return tried, True
        if answer.pose_index is None:  # time is up
            return _thinned(demands, ask), False
        complements.append(demands - wish.met_by(answer.pose_index, tried))


def _thinned(demands: frozenset[int], ask: Callable[[frozenset[int]], Answer]) -> frozenset[int]:
    """A conflict without the demands that are known to be needless."""
    for demand in sorted(demands):
        if _is_refused(ask(demands - {demand})):
            demands -= {demand}
    return demands


def _smallest_hitting_set(sets: Sequence[Set[int]], universe: Set[int]) -> frozenset[int]:
    """Fewest members that every set has one of, the earliest ones first.

    Examples
    --------
    >>> sorted(_smallest_hitting_set([{0, 1}, {1, 2}, {3}], {0, 1, 2, 3}))
    [1, 3]
    """
    members = sorted(set().union(*sets) & universe)
    for size in range(len(members) + 1):
        for chosen in combinations(members, size):
            if all(not of_set.isdisjoint(chosen) for of_set in sets):
                return frozenset(chosen)
    raise ValueError("a set has no member in the universe")


def _relaxations(
    wish: Wish,
    oracle: Oracle,
    conflict: frozenset[int],
    ask: Callable[[frozenset[int]], Answer],
) -> tuple[Relaxation, ...]:
    found = []
    for number in sorted(conflict):
        suffices = ask(wish.everything - {number}).pose_index is not None
        others = (wish.everything if suffices else conflict) - {number}
        relaxation = find_relaxation(wish, oracle, number, others)
        if relaxation is not None:
            found.append(replace(relaxation, suffices=suffices))
    return tuple(found)
