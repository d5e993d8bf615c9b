"""Conflicts: demands that contradict each other, and the least by which one must give way.

The smallest conflict is found by implicit hitting sets: demands that cannot all be met have to hit
the complement of every set that can. The smallest set that hits all complements known so far is
asked for; either nothing meets it, and no smaller conflict exists, or what meets it shows another
complement.
"""

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from geometry.clock import now_s
from geometry.errors import InputError, Unquoted
from geometry.scene import Scene

from ..candidates import CandidatePose
from ..optimiser import PlacementProblem
from ..wishes import Wishes, build_limits
from .demands import Demand, Relaxation, Separation, Wish, find_relaxation
from .feasible_sets import Answer, Oracle

# ---------- conflicts


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
    max_sets: int = _MAX_SETS,
) -> tuple[Conflict, ...]:
    """Why no set of poses meets limits and floors.

    With `keeps_forced`, forced poses are no demand but a fact, such as units that are
    mounted already. `time_limit_s` is for all questions together; presolve always ends. Up to
    `max_sets` sets are gone through one by one, more of them by models.

    A smallest conflict comes first, then a smallest one among the remaining demands, and so on: no
    two share a demand. There is none if the wish can be met, if it was not found out that it
    cannot, or if nothing would help.
    """
    if problem.table.n_poses == 0:
        return ()
    wish = Wish(problem, separation, keeps_forced=keeps_forced)
    oracle = Oracle(problem, end_s=now_s() + time_limit_s, max_sets=max_sets)
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
    wish: Wish, oracle: Oracle, conflict: frozenset[int], ask: Callable[[frozenset[int]], Answer]
) -> tuple[Relaxation, ...]:
    found = []
    for number in sorted(conflict):
        suffices = ask(wish.everything - {number}).pose_index is not None
        others = (wish.everything if suffices else conflict) - {number}
        relaxation = find_relaxation(wish, oracle, number, others)
        if relaxation is not None:
            found.append(replace(relaxation, suffices=suffices))
    return tuple(found)


# ---------- messages


_MAX_NAMES = 4


def find_refusal(
    problem: PlacementProblem,
    wishes: Wishes,
    scene: Scene,
    candidates: Sequence[CandidatePose],
    *,
    time_limit_s: float = 30.0,
) -> InputError | None:
    """Why wishes cannot be met, in one line, to be raised.

    `problem` is what :func:`placement.wishes.build_problem` makes of them, `candidates` are the
    rows of its table. None if they can be met, or if it was not found out that they cannot.
    """
    separation = build_separation(problem, wishes, scene, candidates)
    conflicts = find_conflicts(
        problem, separation=separation, keeps_forced=True, time_limit_s=time_limit_s
    )
    if not conflicts:
        return None
    words = _Words(problem, wishes, candidates)
    first, *others = conflicts
    got = "demands that no layout meets together"
    if len(first.demands) == 1:
        got = "more than any layout gives"
    more = [f"; besides, {words.demands(other)}: {words.ways_out(other)}" for other in others]
    return InputError(words.demands(first), Unquoted(got), words.ways_out(first) + "".join(more))


def build_separation(
    problem: PlacementProblem, wishes: Wishes, scene: Scene, candidates: Sequence[CandidatePose]
) -> Separation | None:
    """The effect of a least distance between units on the limits; None where none is asked for."""
    if wishes.separation_m <= 0.0:
        return None
    limits = problem.limits
    free = build_limits(
        Wishes(existing=wishes.existing, site_capacity=wishes.site_capacity),
        scene,
        candidates,
    )
    position_m = np.array([candidate.pose.position_m[:2] for candidate in candidates])
    where_m = np.array(
        [position_m[limits.site_index == site].mean(axis=0) for site in range(limits.n_sites)]
    )
    one, other = limits.rivals.T
    return Separation(
        distance_m=wishes.separation_m,
        pair_distance_m=np.linalg.norm(where_m[one] - where_m[other], axis=1),
        site_capacity=free.site_capacity,
    )


class _Words:
    """Demands by the fields of a question, in backticks."""

    def __init__(
        self, problem: PlacementProblem, wishes: Wishes, candidates: Sequence[CandidatePose]
    ) -> None:
        self.problem, self.wishes = problem, wishes
        self.site_ids = {
            int(site): candidate.site_id or candidate.id
            for site, candidate in zip(problem.limits.site_index, candidates, strict=True)
        }

    def demands(self, conflict: Conflict) -> str:
        """All demands of a conflict."""
        *first, last = [self._demand(demand) for demand in conflict.demands]
        return f"{', '.join(first)} and {last}" if first else last

    def ways_out(self, conflict: Conflict) -> str:
        """All relaxations of a conflict."""
        if not conflict.relaxations:
            return "fewer demands"
        ways = " or ".join(self._way_out(relaxation) for relaxation in conflict.relaxations)
        return ways if len(conflict.relaxations) == 1 else f"one of them to give way: {ways}"

    def _demand(self, demand: Demand) -> str:
        limits, kind = self.problem.limits, demand.kind
        if kind == "floor":
            assert demand.floor is not None
            floor = self.problem.floors[demand.floor]
            is_max = _field(floor.name) == "target" and self.wishes.target == np.inf
            return _inserted(floor.name, "max" if is_max else f"{floor.share:g}")
        if kind == "forbidden":
            return f"`forbid_site` {self._sites_of(np.flatnonzero(limits.is_forbidden).tolist())}"
        if kind == "forced_sites":
            sites = np.flatnonzero(limits.is_forced_site).tolist()
            return f"`force_site` {_few([self.site_ids[site] for site in sites])}"
        if kind == "capacity" and self.wishes.site_capacity is None:
            return "what the sites can carry"
        number = {
            "survive": max((floor.n_failures for floor in self.problem.floors), default=0),
            "budget_units": (limits.budget_units or 0) - self._n_kept,
            "budget_eur": limits.budget_eur,
            "capacity": self.wishes.site_capacity,
            "separation": self.wishes.separation_m,
        }[kind]
        return f"{_FIELDS[kind]} {number:g}{self._failing if kind == 'survive' else ''}"

    def _way_out(self, relaxation: Relaxation) -> str:
        demand, value = relaxation.demand, relaxation.value
        gone = list(relaxation.given_up)
        if demand.kind == "floor":
            assert demand.floor is not None
            name = self.problem.floors[demand.floor].name
            text = _inserted(name, f"{np.floor(value * 1.0e4 + 1.0e-6) / 1.0e4:g}")
        elif demand.kind == "forbidden":
            text = f"`forbid_site` without {self._sites_of(gone)}"
        elif demand.kind == "forced_sites":
            text = f"`force_site` without {_few([self.site_ids[site] for site in gone])}"
        elif demand.kind == "separation" and not value > 0.0:
            text = "no `separation_m`"
        elif demand.kind == "budget_units":
            text = f"`budget` {value - self._n_kept:g}"
        elif demand.kind == "budget_eur":
            text = f"`budget_cost` {np.ceil(value * 100.0 - 1.0e-4) / 100.0:.2f}"
            text = text.removesuffix(".00")
        elif demand.kind == "separation":
            text = f"`separation_m` {np.floor(value * 100.0) / 100.0:g}"
        else:
            failing = self._failing if demand.kind == "survive" else ""
            text = f"{_FIELDS[demand.kind]} {value:g}{failing}"
        if not relaxation.suffices:
            text += " (not enough by itself)"
        return text if relaxation.is_least else f"{text} (perhaps less will do)"

    @property
    def _failing(self) -> str:
        """Suffix of the number of failures."""
        return " sites" if self.problem.limits.failing == "site" else ""

    @property
    def _n_kept(self) -> int:
        """Existing units, which the budget does not count."""
        return int(self.problem.limits.is_forced.sum())

    def _sites_of(self, poses: Sequence[int]) -> str:
        sites = self.problem.limits.site_index[list(poses)].tolist()
        return _few([self.site_ids[site] for site in sites])


_FIELDS = {
    "survive": "`survive`",
    "budget_units": "`budget`",
    "budget_eur": "`budget_cost`",
    "capacity": "`site_capacity`",
    "separation": "`separation_m`",
}


def _inserted(name: str, number: str) -> str:
    """A number after the field that a name begins with: "`min_case_apr` 0.8 in CPNA-25"."""
    return f"`{_field(name)}` {number} {name.partition(' ')[2]}".rstrip()


def _field(name: str) -> str:
    """Field of a question that the name of a floor begins with."""
    return name.partition(" ")[0].strip("-`").replace("-", "_")


def _few(names: Sequence[str]) -> str:
    """The first few names, each once."""
    each = list(dict.fromkeys(names))
    left = len(each) - _MAX_NAMES
    return ",".join(each[:_MAX_NAMES]) + (f" and {left} more" if left > 0 else "")
