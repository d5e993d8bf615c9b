"""Conflicts: demands that contradict each other, and the least by which one must give way.

A problem is taken apart into demands, of which any part makes a problem again. Demands without
which the others still cannot be met are left out, one after the other: what remains is a conflict
of which none can be spared (Chinneck, Dravnieks 1991, "deletion filter").
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.clock import now_s
from geometry.errors import InputError, Unquoted
from geometry.scene import Scene

from ..candidates import CandidatePose
from ..optimiser import Floor, Goal, Limits, PlacementProblem, is_allowed, presolve
from ..optimiser.bitsets import left_after_failures, set_values
from ..optimiser.greedy import extend_greedily, forced_units, to_full
from ..optimiser.presolve import ReducedProblem
from ..optimiser.problem import Measure, Objective, Requirement, objectives_in_order
from ..optimiser.solve import UnmetError, check_limits, check_reach
from ..optimiser.stages import Search, Stages
from ..optimiser.steering import Deadline, Effort
from ..wishes import Wishes, build_limits

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
class Demand:
    """One of the pieces: it can be dropped, or relaxed, without the others."""

    # "budget_units", "budget_eur"; "floor": one of them, without failures; "survive": that
    # all floors hold when units fail; "capacity": of all sites; "separation": rivals among
    # the sites; "forced_sites", "forbidden": all of them together
    kind: Kind
    floor: int | None = None  # index of the floor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Separation:
    """The effect of a least distance between units on the limits."""

    distance_m: float  # pairs of sites that are nearer are rivals. [m]
    pair_distance_m: FloatArray  # (n_pairs,): distances of the limits' rivals. [m]
    site_capacity: IntArray  # (n_sites,): units that each site could carry without it


def list_demands(problem: PlacementProblem, separation: Separation | None) -> tuple[Demand, ...]:
    """All demands that bind something; existing units, which are forced, are none but a fact."""
    limits = problem.limits
    capacity = limits.site_capacity if separation is None else separation.site_capacity
    per_site = np.bincount(limits.site_index, minlength=limits.n_sites)
    is_there: dict[Kind, bool] = {
        "budget_units": limits.budget_units is not None,
        "budget_eur": limits.budget_eur is not None,
        "capacity": bool((per_site > capacity).any()),
        "separation": separation is not None,
        "forced_sites": bool(limits.is_forced_site.any()),
        "forbidden": bool(limits.is_forbidden.any()),
    }
    demands = [Demand(kind="floor", floor=index) for index in range(len(problem.floors))]
    if any(floor.n_failures for floor in problem.floors):
        demands.append(Demand(kind="survive"))
    return (*demands, *(Demand(kind=kind) for kind, is_asked in is_there.items() if is_asked))


def part_of(
    problem: PlacementProblem, separation: Separation | None, demands: Set[Demand]
) -> PlacementProblem:
    """The problem with some of its demands only."""
    kinds = {demand.kind for demand in demands}
    limits = problem.limits
    capacity = limits.site_capacity
    if separation is not None and "separation" not in kinds:
        capacity = separation.site_capacity
    # One unit per site is what a separation asks for, whatever the sites could carry.
    is_kept_apart = separation is not None and "separation" in kinds
    if "capacity" not in kinds and not is_kept_apart:
        capacity = np.full(limits.n_sites, limits.n_poses)
    limits = replace(
        limits,
        site_capacity=capacity,
        budget_units=limits.budget_units if "budget_units" in kinds else None,
        budget_eur=limits.budget_eur if "budget_eur" in kinds else None,
        is_forbidden=limits.is_forbidden & ("forbidden" in kinds),
        is_forced_site=limits.is_forced_site & ("forced_sites" in kinds),
        rivals=limits.rivals if "separation" in kinds else limits.rivals[:0],
    )
    floors = [problem.floors[demand.floor] for demand in demands if demand.floor is not None]
    if "survive" not in kinds:
        floors = [replace(floor, n_failures=0) for floor in floors]
    return replace(problem, limits=limits, floors=tuple(floors), goal="best", survive=0)


# ---------- whether a problem can be met, and how much of it


_SHARE_OF_TIME = 0.4  # of the remaining time, that one question may take


@dataclass(frozen=True, slots=True, kw_only=True)
class _Answer:
    """A set of poses, None where none was found; whether it, or that there is none, is proven."""

    pose_index: tuple[int, ...] | None
    is_proven: bool
    value: float = np.nan  # the least or the most, where a number was asked for


class _Questions:
    """Questions about one problem with other limits and floors, until time is up."""

    def __init__(self, problem: PlacementProblem, end_s: float) -> None:
        self.end_s, limits = end_s, problem.limits
        # Whatever the limits, every pose that detects anything has its place in it.
        free = Limits(
            site_index=limits.site_index,
            site_capacity=np.full(limits.n_sites, limits.n_poses),
            unit_cost_eur=limits.unit_cost_eur,
            site_cost_eur=limits.site_cost_eur,
            is_forced=limits.is_forced,
            is_forced_site=limits.is_forced_site,
        )
        bare = replace(problem, limits=free, floors=(), goal="best", survive=0)
        self.presolved = presolve(bare, drops_dominated=False)

    def left_s(self) -> float:
        """Time left, in seconds."""
        return self.end_s - now_s()

    def find(self, problem: PlacementProblem) -> _Answer:
        """A set that meets limits and floors."""
        search = self._search(problem, self._ask(problem, "fewest"))
        if search is None or search.shortfall > 0.0:
            is_proven = search is None or search.nothing_meets_all
            return _Answer(pose_index=None, is_proven=is_proven)
        assert search.units is not None
        return _Answer(pose_index=to_full(search.reduced, search.units), is_proven=True)

    def best(
        self,
        problem: PlacementProblem,
        objective: Objective,
        measure: Measure | None = None,
        n_failures: int = 0,
    ) -> _Answer:
        """The best value of an objective within limits and floors, by some measure of runs."""
        goals: dict[Objective, Goal] = {Objective.UNITS: "fewest", Objective.COST: "cheapest"}
        reduced = self._ask(problem, goals.get(objective, "best"), n_failures)
        if measure is not None:
            reduced = replace(reduced, measure=measure.of_runs(reduced.run_index))
            if not reduced.weight.any():  # nothing that counts can be avoided: any set is as good
                return replace(self.find(problem), value=0.0)
        search = self._search(problem, reduced)
        if search is None or search.units is None or search.shortfall > 0.0:
            return _Answer(pose_index=None, is_proven=False)
        effort = Effort(time_limit_s=max(search.deadline.left_s(), 1.0e-3))
        stages = Stages(replace(problem, survive=n_failures), search, effort)
        bound = {
            Objective.UNITS: stages.bound_units,
            Objective.COST: stages.bound_first_cost_eur,
            Objective.APR: stages.bound_apr,
            Objective.APR_SURVIVED: stages.bound_apr_survived,
        }[objective]()
        units = search.units[None, :]
        if objective is Objective.UNITS:
            value = float(units.size)
        elif objective is Objective.COST:
            value = search.value.cost_eur
        else:
            value = float(left_after_failures(reduced, reduced.measure, n_failures, units)[0])
        return _Answer(
            pose_index=to_full(reduced, search.units),
            is_proven=abs(bound - value) <= objective.tolerance,
            value=value,
        )

    def _ask(self, problem: PlacementProblem, goal: Goal, survive: int = 0) -> ReducedProblem:
        """The reduced problem with a problem's limits and floors."""
        reduced = self.presolved
        return replace(
            reduced,
            limits=problem.limits.of_poses(reduced.pose_index),
            floors=tuple(
                Requirement(
                    measure=problem.floor_measure(floor).of_runs(reduced.run_index),
                    least=floor.share,
                    n_failures=floor.n_failures,
                )
                for floor in problem.floors
            ),
            objectives=objectives_in_order(goal, survive=survive),
            survive=survive,
        )

    def _search(self, problem: PlacementProblem, reduced: ReducedProblem) -> Search | None:
        """A search that has begun; None where limits or floors are out of reach at once."""
        try:
            check_limits(problem.limits, problem.table.pose_ids)
            limits = reduced.limits
            usable = (limits.site_capacity[limits.site_index] > 0) & ~limits.is_forbidden
            check_reach(problem, replace(reduced, words=reduced.words[usable]))
        except UnmetError:
            return None
        deadline = Deadline(now_s() + _SHARE_OF_TIME * max(self.left_s(), 0.0))
        search = Search(reduced, deadline=deadline)
        units = extend_greedily(reduced, forced_units(reduced))
        meets = len(units) > 0 and is_allowed(reduced.limits, units)
        if meets and set_values(reduced, units[None, :]).lacking[0] == 0.0:
            search.keep(units)
        if search.units is None or reduced.objectives[0] is not Objective.UNITS:
            search.start(() if search.units is None else [search.units])
        return search


# ---------- relaxations


@dataclass(frozen=True, slots=True, kw_only=True)
class Relaxation:
    """The least by which a demand gives way."""

    demand: Demand  # which
    # what can be had in place of its number: units, euros, share, failed units, units per
    # site, metres. NaN where it has none.
    value: float = np.nan
    # of a demand that lists poses or sites: those that have to go; sites for "forced_sites"
    given_up: tuple[int, ...] = ()
    suffices: bool = False  # the whole wish can be met then; else only this conflict is settled
    is_least: bool = True  # proven: less does not do
    pose_index: tuple[int, ...] = ()  # a set of poses that does


def relax(
    problem: PlacementProblem, relaxation: Relaxation, separation: Separation | None = None
) -> PlacementProblem:
    """The problem with one demand relaxed, all others as they were."""
    kind, value, limits = relaxation.demand.kind, relaxation.value, problem.limits
    floors = problem.floors
    if kind == "floor":
        index = relaxation.demand.floor
        floors = tuple(
            replace(floor, share=min(max(value, 0.0), 1.0)) if number == index else floor
            for number, floor in enumerate(floors)
        )
    elif kind == "survive":
        most = int(value)
        floors = tuple(replace(f, n_failures=min(f.n_failures, most)) for f in floors)
    elif kind == "budget_units":
        limits = replace(limits, budget_units=int(value))
    elif kind == "budget_eur":
        limits = replace(limits, budget_eur=value)
    elif kind == "capacity":
        limits = replace(limits, site_capacity=np.maximum(limits.site_capacity, int(value)))
    elif kind == "separation":
        assert separation is not None
        limits = replace(
            limits,
            rivals=limits.rivals[separation.pair_distance_m < value],
            site_capacity=limits.site_capacity if value > 0.0 else separation.site_capacity,
        )
    else:
        field = "is_forbidden" if kind == "forbidden" else "is_forced_site"
        flags = getattr(limits, field).copy()
        flags[list(relaxation.given_up)] = False
        limits = replace(limits, **{field: flags})
    return replace(problem, limits=limits, floors=floors)


class _Relaxing:
    """Looks for the least by which one demand gives way so that some others can be met, too."""

    def __init__(
        self,
        problem: PlacementProblem,
        separation: Separation | None,
        questions: _Questions,
        demand: Demand,
        others: Set[Demand],
    ) -> None:
        self.problem, self.separation, self.questions = problem, separation, questions
        self.demand, self.others = demand, others
        self.with_it = part_of(problem, separation, {*others, demand})
        self.without = part_of(problem, separation, others)
        if separation is not None and Demand(kind="capacity") not in others:
            limits = problem.limits  # without it, sites may carry any number of units
            capacity = np.full(limits.n_sites, limits.n_poses)
            self.separation = replace(separation, site_capacity=capacity)

    def least(self) -> Relaxation | None:
        """The relaxation; None if nothing was found in time."""
        kind, limits = self.demand.kind, self.with_it.limits
        if kind == "budget_units":
            return self._best(Objective.UNITS)
        if kind == "budget_eur":
            return self._best(Objective.COST)
        if kind == "floor":
            return self._floor()
        if kind == "survive":
            most = max(floor.n_failures for floor in self.with_it.floors)
            return self._first([float(n) for n in range(most - 1, -1, -1)])
        if kind == "capacity":
            per_site = np.bincount(limits.site_index, minlength=limits.n_sites)
            least = int(limits.site_capacity.min()) + 1
            return self._first([float(n) for n in range(least, int(per_site.max()) + 1)])
        if kind == "separation":
            assert self.separation is not None
            distances = np.unique(self.separation.pair_distance_m)
            return self._first([*distances[::-1].tolist(), 0.0])
        return self._fewest()

    def _best(
        self, objective: Objective, measure: Measure | None = None, n_failures: int = 0
    ) -> Relaxation | None:
        answer = self.questions.best(self.without, objective, measure, n_failures)
        if answer.pose_index is None:
            return None
        return Relaxation(
            demand=self.demand,
            value=answer.value,
            is_least=answer.is_proven,
            pose_index=answer.pose_index,
        )

    def _floor(self) -> Relaxation | None:
        assert self.demand.floor is not None
        floor: Floor = self.problem.floors[self.demand.floor]
        n_failures = floor.n_failures if Demand(kind="survive") in self.others else 0
        objective = Objective.APR_SURVIVED if n_failures else Objective.APR
        return self._best(objective, self.problem.floor_measure(floor), n_failures)

    def _first(self, values: Sequence[float]) -> Relaxation | None:
        """The first of some values, each looser than the one before, that can be met."""
        low, high, best = 0, len(values), None
        is_proven = True
        while low < high:
            middle = (low + high) // 2
            tried = self._try(values[middle], ())
            if tried.pose_index:
                high, best = middle, tried
            else:
                low = middle + 1
                is_proven &= tried.is_least
        return None if best is None else replace(best, is_least=is_proven)

    def _fewest(self) -> Relaxation | None:
        """Few sites that have to go: one that does, or else those of which none could stay."""
        limits = self.with_it.limits
        is_site = self.demand.kind == "forced_sites"
        chosen = np.flatnonzero(limits.is_forced_site if is_site else limits.is_forbidden)
        site_of = chosen if is_site else limits.site_index[chosen]
        items = {int(site): chosen[site_of == site].tolist() for site in np.unique(site_of)}
        is_proven = True
        for item in items.values():
            if self.questions.left_s() <= 0.0:
                is_proven = False
                break
            tried = self._try(np.nan, item)
            if tried.pose_index:
                return tried
            is_proven &= tried.is_least
        free = self.questions.find(self.without).pose_index
        if free is None:
            return None
        used = set(limits.site_index[list(free)].tolist())
        left = [site for site in items if (site in used) != is_site]
        best = self._relaxation(np.nan, [one for site in left for one in items[site]], free)
        for site in left.copy() if self.questions.left_s() > 0.0 else ():
            fewer = [one for other in left if other != site for one in items[other]]
            tried = self._try(np.nan, fewer)
            if tried.pose_index:
                left.remove(site)
                best = tried
        return replace(best, is_least=is_proven and len(left) <= 2)

    def _relaxation(
        self, value: float, given_up: Sequence[int], poses: tuple[int, ...] = ()
    ) -> Relaxation:
        return Relaxation(
            demand=self.demand, value=value, given_up=tuple(given_up), pose_index=poses
        )

    def _try(self, value: float, given_up: Sequence[int]) -> Relaxation:
        """A relaxation; no poses if it cannot be met, and then whether that is proven."""
        relaxation = self._relaxation(value, given_up)
        part = self.with_it
        if self.demand.floor is None:
            part = relax(part, relaxation, self.separation)
        answer = self.questions.find(part)
        return replace(relaxation, is_least=answer.is_proven, pose_index=answer.pose_index or ())


# ---------- conflicts


@dataclass(frozen=True, slots=True, kw_only=True)
class Conflict:
    """Demands that cannot all be met; any part of them can."""

    demands: tuple[Demand, ...]  # in the order of :func:`list_demands`
    # for each demand the least by which it has to give way, where that was found
    relaxations: tuple[Relaxation, ...]


def find_conflict(
    problem: PlacementProblem,
    *,
    separation: Separation | None = None,
    time_limit_s: float = 30.0,
) -> Conflict | None:
    """Demands because of which no set of poses meets limits and floors, none of them needless.

    `time_limit_s` is for all questions together, presolve is finished in any case. None if the wish
    can be met, if it was not found out that it cannot, or if nothing would help.
    """
    if problem.table.n_poses == 0:
        return None
    every = list_demands(problem, separation)
    questions = _Questions(problem, now_s() + time_limit_s)

    def ask(demands: Sequence[Demand]) -> _Answer:
        return questions.find(part_of(problem, separation, set(demands)))

    def is_refused(demands: Sequence[Demand]) -> bool:
        answer = ask(demands)
        return answer.pose_index is None and answer.is_proven

    if ask(()).pose_index is None or not is_refused(every):
        return None
    needed = list(every)
    for demand in every:
        fewer = [other for other in needed if other != demand]
        if is_refused(fewer):
            needed = fewer
    found = []
    for demand in needed:
        all_others = [other for other in every if other != demand]
        suffices = ask(all_others).pose_index is not None
        others = set(all_others if suffices else needed) - {demand}
        relaxation = _Relaxing(problem, separation, questions, demand, others).least()
        if relaxation is not None:
            found.append(replace(relaxation, suffices=suffices))
    return Conflict(demands=tuple(needed), relaxations=tuple(found))


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
    conflict = find_conflict(problem, separation=separation, time_limit_s=time_limit_s)
    if conflict is None:
        return None
    words = _Words(problem, wishes, candidates)
    got = "demands that no layout meets together"
    if len(conflict.demands) == 1:
        got = "more than any layout gives"
    return InputError(words.demands(conflict), Unquoted(got), words.ways_out(conflict))


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
