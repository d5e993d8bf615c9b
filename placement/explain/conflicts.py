"""Conflicts between demands, and the least by which one must give way.

A problem is taken apart into demands, of which any part makes a problem again. Parts
are asked for in order of size, but for those that a set of poses found before meets,
too: the first part that nothing meets is a smallest conflict.
"""

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.clock import now_s
from geometry.errors import InputError, Unquoted
from geometry.scene import Scene

from ..candidates import CandidatePose
from ..optimiser import Limits, PlacementProblem, is_feasible
from ..optimiser.problem import Goal
from ..wishes import Wishes, build_limits
from .feasible_sets import Feasibility, Oracle

# ---------- demands
Kind = Literal[
    "budget_units",
    "budget_eur",
    "floor",
    "survive",
    "capacity",
    "separation",
    "forced_sites",
    "forbidden",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class DroppableWish:
    """One of the pieces: it can be dropped, or relaxed, without the others.

    Attributes
    ----------
    kind : str
        "budget_units", "budget_eur"; "floor": one of them, without failures; "survive":
        that all floors hold when units fail; "capacity": of all sites; "separation":
        rivals among the sites; "forced_sites", "forbidden", "forced": all of them
        together.
    floor : int, optional
        Index of the floor.
    """

    kind: Kind
    floor: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Separation:
    """The effect of a least distance between units on the limits.

    Attributes
    ----------
    distance_m : float
        Pairs of sites that are nearer are rivals. [m]
    pair_distance_m : (n_pairs,) float
        Distances of the limits' rivals. [m]
    site_capacity : (n_sites,) int
        Units that each site could carry without it.
    """

    distance_m: float
    pair_distance_m: FloatArray
    site_capacity: IntArray


class Wish:
    """A placement problem that can be taken apart.

    `separation` says where the rivals of its limits come from; without it there are
    none. Forced poses are no demand but a fact: existing units.
    """

    def __init__(
        self, problem: PlacementProblem, separation: Separation | None = None
    ) -> None:
        self.problem = problem
        self.separation = separation
        self.demands = _list_demands(problem, separation)
        self.everything = frozenset(range(len(self.demands)))
        self._limits: dict[frozenset[int], Limits] = {}

    def part(self, active: Set[int]) -> PlacementProblem:
        """The problem with some of the demands only; equal limits are one object."""
        demands = [self.demands[number] for number in sorted(active)]
        floors = tuple(
            self.problem.floors[one.floor] for one in demands if one.floor is not None
        )
        if not any(demand.kind == "survive" for demand in demands):
            floors = tuple(replace(floor, n_failures=0) for floor in floors)
        return replace(
            self.problem,
            limits=self._limits_of(active),
            floors=floors,
            goal="best",
            survive=0,
        )

    def met_by(self, poses: Sequence[int], active: Set[int]) -> frozenset[int]:
        """Demands that a set of poses meets all at once.

        Those of `active` are among them if the set meets them. That floors hold
        when units fail counts as met where that is so for all floors that are met
        without failures, or where it is asked for: then floors must hold so.
        """
        # Floors with failures depend on which floors are met at all.
        survive = frozenset(
            n for n in self.everything if self.demands[n].kind == "survive"
        )
        met = frozenset(
            number
            for number in self.everything - survive
            if is_feasible(self.part({number} | (survive & active)), poses)
        )
        if is_feasible(self.part(met | survive), poses):
            return met | survive
        return met

    def _limits_of(self, active: Set[int]) -> Limits:
        """Limits of the active demands; equal ones are one object."""
        key = frozenset(
            number
            for number in active
            if self.demands[number].kind not in ("floor", "survive")
        )
        if key not in self._limits:
            kinds = {self.demands[number].kind for number in key}
            self._limits[key] = _loosen(self.problem.limits, kinds, self.separation)
        return self._limits[key]


def _list_demands(
    problem: PlacementProblem, separation: Separation | None
) -> tuple[DroppableWish, ...]:
    """All demands that bind something."""
    limits = problem.limits
    if separation is None:
        capacity = limits.site_capacity
    else:
        capacity = separation.site_capacity
    per_site = np.bincount(limits.site_index, minlength=limits.n_sites)
    # Limits are demands where they bind something.
    is_there: dict[Kind, bool] = {
        "budget_units": limits.budget_units is not None,
        "budget_eur": limits.budget_eur is not None,
        "capacity": bool((per_site > capacity).any()),
        "separation": separation is not None,
        "forced_sites": bool(limits.is_forced_site.any()),
        "forbidden": bool(limits.is_forbidden.any()),
    }
    demands = [
        DroppableWish(kind="floor", floor=index) for index in range(len(problem.floors))
    ]
    if any(floor.n_failures for floor in problem.floors):
        demands.append(DroppableWish(kind="survive"))
    return (
        *demands,
        *(DroppableWish(kind=kind) for kind, is_asked in is_there.items() if is_asked),
    )


def _loosen(limits: Limits, kinds: Set[Kind], separation: Separation | None) -> Limits:
    """Limits of some kinds only."""
    # Room at the sites, with and without a least distance.
    capacity = limits.site_capacity
    if separation is not None and "separation" not in kinds:
        capacity = separation.site_capacity
    # One unit per site is what a separation asks for, whatever the sites could carry.
    is_kept_apart = separation is not None and "separation" in kinds
    if "capacity" not in kinds and not is_kept_apart:
        capacity = np.full(limits.n_sites, limits.n_poses)
    return replace(
        limits,
        site_capacity=capacity,
        budget_units=limits.budget_units if "budget_units" in kinds else None,
        budget_eur=limits.budget_eur if "budget_eur" in kinds else None,
        is_forbidden=limits.is_forbidden & ("forbidden" in kinds),
        is_forced_site=limits.is_forced_site & ("forced_sites" in kinds),
        rivals=limits.rivals if "separation" in kinds else limits.rivals[:0],
    )


# ---------- relaxations
_MAX_TRIALS = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Relaxation:
    """The least by which a demand gives way.

    Attributes
    ----------
    demand : DroppableWish
        The demand that gives way.
    value : float
        What can be had in place of its number: units, euros, share, failed units, units
        per site, metres. NaN where it has none.
    given_up : tuple of int
        Of a demand that lists poses, sites or rivals: those that have to go. Poses, and
        rows of the limits' rivals; sites for "forced_sites".
    suffices : bool
        Whether the whole wish can be met then; else only this conflict is settled.
    is_least : bool
        Proven: less does not do.
    pose_index : tuple of int
        A set of poses that does.
    """

    demand: DroppableWish
    value: float = np.nan
    given_up: tuple[int, ...] = ()
    suffices: bool = False
    is_least: bool = True
    pose_index: tuple[int, ...] = ()


def relax(
    problem: PlacementProblem,
    relaxation: Relaxation,
    separation: Separation | None = None,
) -> PlacementProblem:
    """The problem with one demand relaxed.

    The demand has no number of its own that could be optimised.
    """
    kind = relaxation.demand.kind
    value = relaxation.value
    limits = problem.limits
    items = list(relaxation.given_up)
    # Each kind of demand is relaxed in its own way.
    if kind == "survive":
        floors = (
            replace(f, n_failures=min(f.n_failures, int(value))) for f in problem.floors
        )
        return replace(problem, floors=tuple(floors))
    if kind == "capacity":
        limits = replace(
            limits, site_capacity=np.maximum(limits.site_capacity, int(value))
        )
    elif separation is not None and kind == "separation":
        is_near = separation.pair_distance_m < value
        if value > 0.0:
            capacity = limits.site_capacity
        else:
            capacity = separation.site_capacity
        limits = replace(limits, rivals=limits.rivals[is_near], site_capacity=capacity)
    else:
        if kind == "forced_sites":
            field = "is_forced_site"
        else:
            field = "is_forbidden"
        flags = getattr(limits, field).copy()
        flags[items] = False
        limits = replace(limits, **{field: flags})
    return replace(problem, limits=limits)


def find_relaxation(
    wish: Wish, oracle: Oracle, number: int, others: frozenset[int]
) -> Relaxation | None:
    """The least by which a demand has to give way for others to be met.

    The others can be met together without it. None if nothing was found in time;
    `suffices` is to be filled in.
    """
    demand = wish.demands[number]
    separation = wish.separation
    with_it = wish.part(others | {number})
    without = wish.part(others)
    limits = with_it.limits
    kinds = {wish.demands[other].kind for other in others}
    # Demands with a number are optimised: the least or the most that can be had.
    answer = None
    if demand.kind in ("budget_units", "budget_eur"):
        goal: Goal = "cheapest"
        if demand.kind == "budget_units":
            goal = "fewest"
        answer = oracle.least(without, goal)
    elif demand.floor is not None:
        floor = wish.problem.floors[demand.floor]
        if "survive" in kinds:
            n_failures = floor.n_failures
        else:
            n_failures = 0
        answer = oracle.most(without, wish.problem.floor_measure(floor), n_failures)
    if answer is not None:
        if answer.pose_index is None:
            return None
        return Relaxation(
            demand=demand,
            value=answer.value,
            is_least=answer.is_proven,
            pose_index=answer.pose_index,
        )
    # Sites may carry any number of units.
    if separation is not None and "capacity" not in kinds:
        any_number = np.full(wish.problem.limits.n_sites, wish.problem.limits.n_poses)
        separation = replace(separation, site_capacity=any_number)
    # Others are tried, from the tightest to the loosest.
    trial = _Trial(demand, with_it, oracle, separation)
    if demand.kind == "survive":
        most = max(floor.n_failures for floor in with_it.floors)
        return trial.first([float(n) for n in range(most - 1, -1, -1)])
    if demand.kind == "capacity":
        per_site = np.bincount(limits.site_index, minlength=limits.n_sites)
        least = int(limits.site_capacity.min()) + 1
        return trial.first([float(n) for n in range(least, int(per_site.max()) + 1)])
    if demand.kind == "separation" and separation is not None:
        distances = np.unique(separation.pair_distance_m)
        return trial.first([*distances[::-1].tolist(), 0.0])
    return trial.fewest(_items(demand, limits), oracle.find(without))


def _items(demand: DroppableWish, limits: Limits) -> list[tuple[int, ...]]:
    """Entries of a demand, in groups that belong together.

    All forbidden poses of a site are one group.
    """
    if demand.kind == "forced_sites":
        return [(site,) for site in np.flatnonzero(limits.is_forced_site).tolist()]
    forbidden = np.flatnonzero(limits.is_forbidden)
    sites = limits.site_index[forbidden]
    return [tuple(forbidden[sites == site].tolist()) for site in np.unique(sites)]


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """Relaxations of one demand that are tried one after the other."""

    demand: DroppableWish
    problem: PlacementProblem
    oracle: Oracle
    separation: Separation | None

    def first(self, values: Sequence[float]) -> Relaxation | None:
        """The first of some values that can be met.

        Each value is looser than the one before.
        """
        low = 0
        high = len(values)
        best = None
        is_proven = True
        # Bisection: what can be met stays possible when it is looser.
        while low < high:
            middle = (low + high) // 2
            tried = self._try(values[middle], ())
            if tried.pose_index:
                high = middle
                best = tried
            else:
                low = middle + 1
                is_proven &= tried.is_least
        if best is None:
            return None
        return replace(best, is_least=is_proven)

    def fewest(
        self, items: Sequence[tuple[int, ...]], without: Feasibility
    ) -> Relaxation | None:
        """The fewest items that have to go.

        `without` is the answer without any of them.
        """
        if without.pose_index is None:
            return None
        # All items that the free answer violates are enough; look for fewer.
        enough = [item for item in items if self._is_violated(item, without.pose_index)]
        best = self._relaxation(np.nan, enough, without.pose_index)
        n_trials = 0
        is_proven = True
        for size in range(1, len(enough)):
            for given_up in combinations(items, size):
                if n_trials == _MAX_TRIALS or self.oracle.left_s() <= 0.0:
                    return self._thinned(best, enough)
                n_trials += 1
                tried = self._try(np.nan, given_up)
                if tried.pose_index:
                    return replace(tried, is_least=is_proven)
                is_proven &= tried.is_least
        return replace(best, is_least=is_proven)

    def _thinned(self, best: Relaxation, given_up: list[tuple[int, ...]]) -> Relaxation:
        """Drop given-up items that could stay, as far as time goes.

        Other items might be fewer.
        """
        for item in given_up.copy():
            if self.oracle.left_s() <= 0.0:
                break
            fewer = [other for other in given_up if other != item]
            tried = self._try(np.nan, fewer)
            if tried.pose_index:
                given_up = fewer
                best = tried
        return replace(best, is_least=False)

    def _is_violated(self, item: tuple[int, ...], poses: tuple[int, ...]) -> bool:
        """True if a set of poses is against an item of the demand."""
        if self.demand.kind == "forbidden":
            return not set(item).isdisjoint(poses)
        return not set(item) <= set(
            self.problem.limits.site_index[list(poses)].tolist()
        )

    def _relaxation(
        self,
        value: float,
        given_up: Sequence[tuple[int, ...]],
        poses: tuple[int, ...] = (),
    ) -> Relaxation:
        """A relaxation of the demand that gives up some items."""
        gone = tuple(part for item in given_up for part in item)
        return Relaxation(
            demand=self.demand, value=value, given_up=gone, pose_index=poses
        )

    def _try(self, value: float, given_up: Sequence[tuple[int, ...]]) -> Relaxation:
        """Try a relaxation.

        It has no poses if it cannot be met; `is_least` then says whether that is
        proven.
        """
        relaxation = self._relaxation(value, given_up)
        answer = self.oracle.find(relax(self.problem, relaxation, self.separation))
        return replace(
            relaxation, is_least=answer.is_proven, pose_index=answer.pose_index or ()
        )


# ---------- conflicts
@dataclass(frozen=True, slots=True, kw_only=True)
class Conflict:
    """Demands that cannot all be met; any part of them can.

    Attributes
    ----------
    demands : tuple of DroppableWish
        In the order of ``Wish.demands``.
    relaxations : tuple of Relaxation
        For each demand the least by which it has to give way, where that was
        found.
    """

    demands: tuple[DroppableWish, ...]
    relaxations: tuple[Relaxation, ...]


def find_conflicts(
    problem: PlacementProblem,
    *,
    separation: Separation | None = None,
    time_limit_s: float = 30.0,
) -> tuple[Conflict, ...]:
    """Smallest conflicts that explain why no set of poses does.

    No two of them have a demand in common. `time_limit_s` is for all questions
    together, but for presolve. None if the wish can be met, if it was not found out
    that it cannot, or if nothing would help.
    """
    if problem.table.n_poses == 0:
        return ()
    wish = Wish(problem, separation)
    oracle = Oracle(problem, end_s=now_s() + time_limit_s)
    asked: dict[frozenset[int], Feasibility] = {}

    def ask(active: frozenset[int]) -> Feasibility:
        if active not in asked:
            asked[active] = oracle.find(wish.part(active))
        return asked[active]

    # Forced and forbidden, say.
    if ask(frozenset()).pose_index is None:
        return ()
    # Take out one smallest conflict after the other.
    left = wish.everything
    found = []
    while left and _is_refused(ask(left)):
        numbers = _smallest_conflict(wish, left, ask)
        found.append(numbers)
        left -= numbers
    return tuple(
        Conflict(
            demands=tuple(wish.demands[number] for number in sorted(numbers)),
            relaxations=_relaxations(wish, oracle, numbers, ask),
        )
        for numbers in found
    )


def _is_refused(answer: Feasibility) -> bool:
    return answer.pose_index is None and answer.is_proven


def _smallest_conflict(
    wish: Wish, demands: frozenset[int], ask: Callable[[frozenset[int]], Feasibility]
) -> frozenset[int]:
    """A smallest conflict among demands that cannot all be met.

    Where time is short, it is any conflict.
    """
    # Demands that some set of poses meets together.
    met = list[frozenset[int]]()
    # Parts in order of size: the first refused one is a smallest conflict.
    for size in range(len(demands) + 1):
        for tried in map(frozenset, combinations(sorted(demands), size)):
            if any(tried <= known for known in met):
                continue
            answer = ask(tried)
            if _is_refused(answer):
                return tried
            # Time is up.
            if answer.pose_index is None:
                return _thinned(demands, ask)
            met.append(wish.met_by(answer.pose_index, tried))
    raise ValueError("the demands can be met")


def _thinned(
    demands: frozenset[int], ask: Callable[[frozenset[int]], Feasibility]
) -> frozenset[int]:
    """A conflict without the demands that are known to be needless."""
    for demand in sorted(demands):
        if _is_refused(ask(demands - {demand})):
            demands -= {demand}
    return demands


def _relaxations(
    wish: Wish,
    oracle: Oracle,
    conflict: frozenset[int],
    ask: Callable[[frozenset[int]], Feasibility],
) -> tuple[Relaxation, ...]:
    """Relaxations of the demands of a conflict, as far as found."""
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

    `candidates` are the rows of the problem's table. None if they can be met, or if it
    was not found out that they cannot.
    """
    separation = build_separation(problem, wishes, scene, candidates)
    conflicts = find_conflicts(
        problem, separation=separation, time_limit_s=time_limit_s
    )
    if not conflicts:
        return None
    words = _Words(problem, wishes, candidates)
    # The first conflict is the error; others follow in its text.
    first, *others = conflicts
    got = "demands that no layout meets together"
    if len(first.demands) == 1:
        got = "a demand that no layout meets"
    more = [
        f"; besides, {words.demands(other)}: {words.ways_out(other)}"
        for other in others
    ]
    return InputError(
        words.demands(first), Unquoted(got), words.ways_out(first) + "".join(more)
    )


def build_separation(
    problem: PlacementProblem,
    wishes: Wishes,
    scene: Scene,
    candidates: Sequence[CandidatePose],
) -> Separation | None:
    """Effect of a least distance between units on the limits.

    None where no distance is asked for.
    """
    if wishes.separation_m <= 0.0:
        return None
    limits = problem.limits
    # Room at the sites if there were no least distance.
    free = build_limits(
        Wishes(existing=wishes.existing, site_capacity=wishes.site_capacity),
        scene,
        candidates,
    )
    position_m = np.array([candidate.pose.position_m[:2] for candidate in candidates])
    where_m = np.array(
        [
            position_m[limits.site_index == site].mean(axis=0)
            for site in range(limits.n_sites)
        ]
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
        self,
        problem: PlacementProblem,
        wishes: Wishes,
        candidates: Sequence[CandidatePose],
    ) -> None:
        self.problem = problem
        self.wishes = wishes
        self.site_ids = {
            int(site): candidate.site_id or candidate.id
            for site, candidate in zip(
                problem.limits.site_index, candidates, strict=True
            )
        }

    def demands(self, conflict: Conflict) -> str:
        """All demands of a conflict."""
        *first, last = [self._demand(demand) for demand in conflict.demands]
        if first:
            return f"{', '.join(first)} and {last}"
        return last

    def ways_out(self, conflict: Conflict) -> str:
        """All relaxations of a conflict."""
        if not conflict.relaxations:
            return "fewer demands"
        ways = " or ".join(
            self._way_out(relaxation) for relaxation in conflict.relaxations
        )
        if len(conflict.relaxations) == 1:
            return ways
        return f"one of them to give way: {ways}"

    def _demand(self, demand: DroppableWish) -> str:
        """A demand as the question states it, in words."""
        limits = self.problem.limits
        kind = demand.kind
        if demand.floor is not None:
            floor = self.problem.floors[demand.floor]
            is_max = _field(floor.name) == "target" and self.wishes.target == np.inf
            if is_max:
                return _inserted(floor.name, "max")
            return _inserted(floor.name, f"{floor.share:g}")
        if kind == "capacity" and self.wishes.site_capacity is None:
            return "what the sites can carry"
        items = {
            "forbidden": limits.is_forbidden,
            "forced_sites": limits.is_forced_site,
        }
        if kind in items:
            return self._sites(kind, np.flatnonzero(items[kind]).tolist())
        # Demands that have a number.
        number = {
            "survive": max(
                (floor.n_failures for floor in self.problem.floors), default=0
            ),
            "budget_units": (limits.budget_units or 0) - self._n_kept,
            "budget_eur": limits.budget_eur,
            "capacity": self.wishes.site_capacity,
            "separation": self.wishes.separation_m,
        }[kind]
        text = f"`{_FIELDS[kind]}` {number:g}"
        if kind == "survive":
            text += self._failing
        return text

    def _way_out(self, relaxation: Relaxation) -> str:
        """A relaxation as a change of the question, in words."""
        demand = relaxation.demand
        kind = demand.kind
        value = relaxation.value
        if demand.floor is not None:
            name = self.problem.floors[demand.floor].name
            text = _inserted(name, f"{np.floor(value * 1.0e4 + 1.0e-6) / 1.0e4:g}")
        elif kind in ("forbidden", "forced_sites"):
            text = self._sites(kind, list(relaxation.given_up), "without ")
        elif kind == "separation" and not value > 0.0:
            text = "no `separation_m`"
        else:
            # Numbers are rounded to the side that is sure to be met.
            number = f"{value:g}"
            if kind == "budget_units":
                number = f"{value - self._n_kept:g}"
            elif kind == "budget_eur":
                number = f"{np.ceil(value * 100.0 - 1.0e-4) / 100.0:.2f}".removesuffix(
                    ".00"
                )
            elif kind == "separation":
                number = f"{np.floor(value * 100.0) / 100.0:g}"
            if kind == "survive":
                number += self._failing
            text = f"`{_FIELDS[kind]}` {number}"
        if not relaxation.suffices:
            text += " (not enough by itself)"
        if relaxation.is_least:
            return text
        return f"{text} (perhaps less will do)"

    @property
    def _failing(self) -> str:
        """Suffix of the number of failures."""
        if self.problem.limits.failing == "site":
            return " sites"
        return ""

    @property
    def _n_kept(self) -> int:
        """Existing units, which the budget does not count."""
        return int(self.problem.limits.is_forced.sum())

    def _sites(self, kind: Kind, items: list[int], without: str = "") -> str:
        """A demand that lists sites, or the poses at them: the first few, each once."""
        sites = items
        if kind == "forbidden":
            sites = self.problem.limits.site_index[items].tolist()
        names = list(dict.fromkeys(self.site_ids[site] for site in sites))
        left = len(names) - _MAX_NAMES
        if left > 0:
            more = f" and {left} more"
        else:
            more = ""
        return f"`{_FIELDS[kind]}` {without}{','.join(names[:_MAX_NAMES])}{more}"


_FIELDS = {
    "survive": "survive",
    "budget_units": "budget",
    "budget_eur": "budget_cost",
    "capacity": "site_capacity",
    "separation": "separation_m",
    "forbidden": "forbid_site",
    "forced_sites": "force_site",
}


def _inserted(name: str, number: str) -> str:
    """Insert a number after the field that a name begins with.

    An example is "`min_case_apr` 0.8 in CPNA-25".
    """
    return f"`{_field(name)}` {number} {name.partition(' ')[2]}".rstrip()


def _field(name: str) -> str:
    """Field of a question that the name of a floor begins with."""
    return name.partition(" ")[0].strip("-`").replace("-", "_")
