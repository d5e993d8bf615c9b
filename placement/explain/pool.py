"""Other sets of poses that are as good as the best one, or nearly: the planner's room to choose."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import comb
from typing import Literal

import numpy as np

from geometry.arrays import FloatArray, IntArray, freeze
from geometry.errors import InputError

from ..optimiser import (
    PlacementProblem,
    PlacementValue,
    ReducedProblem,
    is_feasible,
    placement_value,
)
from ..optimiser.bitsets import SetValues, concatenate_values, set_values, values_with_each
from ..optimiser.greedy import extend_greedily, forced_units
from ..optimiser.limits import are_allowed, is_allowed
from ..optimiser.objectives import Objective
from ..optimiser.steering import COST_TOLERANCE_EUR
from .feasible_sets import QuickRows, exceeds_clearly, is_within, presolve_undominated, site_counts

# ---------- every set


_MAX_CONTENDERS = 20_000  # sets whose margins are computed
_PART_SETS = 1 << 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Listed:
    """Sets of poses of a reduced problem, the best first."""

    sets: tuple[IntArray, ...]  # (n_units,): poses of the reduced problem
    values: SetValues  # what they are worth
    n_within: int  # sets that were counted
    pose_count: IntArray  # (n_poses,): how many of these have each pose
    site_count: IntArray  # (n_sites,): how many of them have a unit at each site
    best: float  # the best value of the first stage among them


def list_every_set(
    reduced: ReducedProblem, threshold: float, *, n_sets: int, max_prefixes: int
) -> Listed | None:
    """The best sets of poses, and how often each pose appears in all that reach a threshold.

    The threshold is one of the first stage. None if more than `max_prefixes` sets would have to be
    looked at together with every pose, or if too many sets differ by their margins alone.
    """
    most = reduced.limits.max_units
    if sum(comb(reduced.n_poses, size) for size in range(most)) > max_prefixes:
        return None
    walk = _Walk(reduced, threshold, n_sets=n_sets)
    for size in range(most):
        for prefix in combinations(range(reduced.n_poses - 1), size):
            walk.look_at(np.array(prefix, dtype=np.int64))
            if walk.n_contenders > _MAX_CONTENDERS:
                return None
    return walk.listed()


class _Walk:
    """Counts of all sets so far, and those that may be among the best."""

    def __init__(self, reduced: ReducedProblem, threshold: float, *, n_sets: int) -> None:
        limits = reduced.limits
        self.reduced, self.threshold, self.n_sets = reduced, threshold, n_sets
        self.quick = QuickRows(reduced)
        # What a set may lack and still grow.
        self.growing = replace(
            limits,
            is_forced=np.zeros_like(limits.is_forced),
            is_forced_site=np.zeros_like(limits.is_forced_site),
        )
        self.pose_count = np.zeros(reduced.n_poses, dtype=np.int64)
        self.site_count = np.zeros(limits.n_sites, dtype=np.int64)
        self.n_within = 0
        self.best = -np.inf
        self.contenders: list[tuple[IntArray, SetValues]] = []  # by size: sets, quick values
        self.worst: SetValues | None = None  # of the last set that could be listed

    @property
    def n_contenders(self) -> int:
        """Sets that may be among the best."""
        return sum(len(sets) for sets, _ in self.contenders)

    def look_at(self, prefix: IntArray) -> None:
        """All sets of these units and one more, with a higher index."""
        reduced = self.reduced
        if len(prefix) and not are_allowed(self.growing, prefix[None, :])[0]:
            return
        last = int(prefix[-1]) + 1 if len(prefix) else 0
        rows = self.quick.with_each(prefix)[last:]
        reaches = (rows.lacking == 0.0) & is_within(rows.first, self.threshold)
        joined = np.flatnonzero(reaches) + last
        sets = np.column_stack([np.tile(prefix, (len(joined), 1)), joined])
        is_allowed = are_allowed(reduced.limits, sets)
        sets, rows = sets[is_allowed], rows[joined - last][is_allowed]
        if not len(sets):
            return
        self.n_within += len(sets)
        self.best = max(self.best, float(rows.first.max()))
        np.add.at(self.pose_count, sets.ravel(), 1)
        self.site_count += site_counts(reduced, sets)
        if self.worst is not None:
            may_be_listed = rows.ties_or_beats(self.worst)
            sets, rows = sets[may_be_listed], rows[may_be_listed]
        if len(sets):
            self.contenders.append((sets, rows))
            if self.n_contenders > 2 * self.n_sets:
                self._drop_the_worst()

    def _drop_the_worst(self) -> None:
        """Keep what may be among the best: ties with the last one that would be listed stay."""
        if self.n_contenders <= self.n_sets:
            return
        rows = concatenate_values([rows for _, rows in self.contenders])
        self.worst = rows[int(rows.descending()[self.n_sets - 1])]
        kept: dict[int, tuple[IntArray, SetValues]] = {}
        for sets, own in self.contenders:
            stays = own.ties_or_beats(self.worst)
            sets, own = sets[stays], own[stays]
            size = sets.shape[1]
            if size in kept:
                sets = np.concatenate([kept[size][0], sets])
                own = concatenate_values([kept[size][1], own])
            kept[size] = sets, own
        self.contenders = list(kept.values())

    def listed(self) -> Listed:
        """The best of all sets."""
        self._drop_the_worst()
        sets: list[IntArray] = []
        rows = []
        for of_size, _ in self.contenders:
            for part in np.array_split(of_size, -(-len(of_size) // _PART_SETS) or 1):
                rows.append(set_values(self.reduced, part))
            sets += list(of_size)
        values = concatenate_values(rows)
        order = values.descending()[: self.n_sets]
        return Listed(
            sets=tuple(sets[index] for index in order),
            values=values[order],
            n_within=self.n_within,
            pose_count=self.pose_count,
            site_count=self.site_count,
            best=self.best,
        )


# ---------- exchanges


_FEW_SETS = 100  # up to so many are quicker one by one than by a look at all poses


def list_by_exchange(
    reduced: ReducedProblem, start: IntArray, *, n_sets: int, max_looks: int
) -> Listed:
    """The best `n_sets` sets that exchanges lead to from `start`, which meets limits and floors.

    Every set listed has been exchanged itself, unless `max_looks` were used up: looks at a set with
    one unit taken away, together with every pose. Beside `start`, the best pose of each site, with
    what greedy choice adds to it, is a beginning.
    """
    search = _Exchange(reduced, n_sets=n_sets, max_looks=max_looks)
    search.offer(start[None, :])
    search.exchange_all()
    for pose in _best_of_each_site(reduced):
        if search.n_looks >= max_looks:
            break
        seed = np.unique(np.append(forced_units(reduced), pose))
        units = extend_greedily(reduced, seed)
        search.n_looks += len(units) - len(seed)
        if is_allowed(reduced.limits, units):
            search.offer(np.sort(units)[None, :])
            search.exchange_all()
    return search.listed()


def _best_of_each_site(reduced: ReducedProblem) -> IntArray:
    """The best single pose of every site, the best site first."""
    usable = np.flatnonzero(~reduced.limits.is_forbidden)
    rows = QuickRows(reduced).with_each(np.empty(0, dtype=np.int64))[usable]
    ordered = usable[rows.descending()]
    _, first = np.unique(reduced.limits.site_index[ordered], return_index=True)
    return ordered[np.sort(first)]


class _Exchange:
    """The best sets so far."""

    def __init__(self, reduced: ReducedProblem, *, n_sets: int, max_looks: int) -> None:
        self.reduced = reduced
        self.n_sets, self.max_looks = n_sets, max_looks
        self.quick = QuickRows(reduced)
        self.values: dict[tuple[int, ...], SetValues] = {}  # one row each
        self.exchanged: set[tuple[int, ...]] = set()
        self.best = -np.inf
        self.n_looks = 0

    def offer(self, sets: IntArray) -> None:
        """Take sets, (n, n_units), if they are among the best."""
        if len(sets):
            self._take(sets, set_values(self.reduced, sets))

    def exchange_all(self) -> None:
        """Exchange units of the sets listed until nothing new is listed, or looks are used up."""
        while self.n_looks < self.max_looks:
            key = next((key for key in self.values if key not in self.exchanged), None)
            if key is None:
                return
            self.exchanged.add(key)
            units = np.array(key, dtype=np.int64)
            if len(units) < self.reduced.limits.max_units:
                self._look_at(units)
            for position in range(len(units)):
                left = np.delete(units, position)
                if len(left) and are_allowed(self.reduced.limits, left[None, :])[0]:
                    self.offer(left[None, :])
                self._look_at(left)

    def _look_at(self, left: IntArray) -> None:
        """All sets of these units and one more."""
        reduced = self.reduced
        self.n_looks += 1
        rows = self.quick.with_each(left)
        is_as_good = (rows.lacking == 0.0) & is_within(rows.first, self.best)
        is_as_good[left] = False
        joined = np.flatnonzero(is_as_good)
        sets = np.sort(np.column_stack([np.tile(left, (len(joined), 1)), joined]), axis=1)
        allowed = are_allowed(reduced.limits, sets)
        joined, sets = joined[allowed], sets[allowed]
        if len(sets) > _FEW_SETS:
            self._take(sets, values_with_each(reduced, left)[joined])
        else:
            self.offer(sets)

    def _take(self, sets: IntArray, values: SetValues) -> None:
        meets = values.lacking == 0.0
        sets, values = sets[meets], values[meets]
        if not len(sets):
            return
        self.best = max(self.best, float(values.first.max()))
        for index in values.descending()[: self.n_sets]:
            self.values[tuple(sets[index].tolist())] = values[index : index + 1]
        within = {
            key: row for key, row in self.values.items() if is_within(row.first, self.best)[0]
        }
        keys = list(within)
        order = concatenate_values(list(within.values())).descending()[: self.n_sets]
        self.values = {keys[index]: within[keys[index]] for index in order}

    def listed(self) -> Listed:
        """The best sets."""
        sets = tuple(np.array(key, dtype=np.int64) for key in self.values)
        pose_count = np.zeros(self.reduced.n_poses, dtype=np.int64)
        site_count = np.zeros(self.reduced.limits.n_sites, dtype=np.int64)
        for units in sets:
            pose_count[units] += 1
            site_count += site_counts(self.reduced, units[None, :])
        return Listed(
            sets=sets,
            values=concatenate_values(list(self.values.values())),
            n_within=len(sets),
            pose_count=pose_count,
            site_count=site_count,
            best=self.best,
        )


# ---------- the pool


Scope = Literal["all", "found"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PooledSet:
    """A set of poses."""

    pose_index: tuple[int, ...]  # rows of the table, ascending
    value: PlacementValue  # what it is worth
    objective: float  # its value in the first stage


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pool:
    """Sets of poses that are the best one's equals in the first stage."""

    stage: str  # name of the first stage, as in the certificate
    # "all": every set was gone through, and no set of the table that is better than the last
    # one listed is missing. "found": what exchanging units one for one has led to; there may
    # be more.
    scope: Scope
    sets: tuple[PooledSet, ...]  # the best first, by all stages in order
    n_within: int  # sets that are as good: all that there are, or those listed if scope is "found"
    pose_share: FloatArray  # (n_poses,): share of the `n_within` sets that have each pose
    # (n_sites,): share of them that have a unit at each site of the problem's limits
    site_share: FloatArray

    def __post_init__(self) -> None:
        for name in ("pose_share", "site_share"):
            object.__setattr__(self, name, freeze(getattr(self, name)))

    def __repr__(self) -> str:
        return f"Pool({len(self.sets)} of {self.n_within} sets, {self.scope})"


def find_pool(
    problem: PlacementProblem,
    pose_index: Sequence[int],
    *,
    n_sets: int = 20,
    max_prefixes: int = 5000,
    max_looks: int = 120,
) -> Pool:
    """The best sets of poses, of those that are as good as the solution in the first stage.

    `pose_index` is a solution of the problem. All sets of K units are gone through if there are at
    most `max_prefixes` sets of K - 1 units: each of them is looked at together with every pose at
    once. Else exchanges look at up to `max_looks` sets with one unit taken away, together with
    every pose.

    Poses that are dominated, or detect the same as others, are poses like all others here: to a
    planner another pole is another answer. Only poses that detect nothing that could save a run any
    sooner are left out, unless they are asked for. Raises InputError if the poses are no solution,
    or a number cannot be.
    """
    if n_sets < 1:
        raise InputError("pool", n_sets, "a number of layouts, at least 1")
    if not is_feasible(problem, pose_index):
        raise InputError("pose_index", list(pose_index), "a set that meets limits and floors")
    reduced = presolve_undominated(problem)
    start = np.flatnonzero(np.isin(reduced.pose_index, list(pose_index)))
    best = float(set_values(reduced, start[None, :]).first[0])
    reduced = _bounded(reduced, -best)
    listed = list_every_set(reduced, best, n_sets=n_sets, max_prefixes=max_prefixes)
    if listed is not None and exceeds_clearly(listed.best, best):  # not quite a solution: again
        listed = list_every_set(reduced, listed.best, n_sets=n_sets, max_prefixes=max_prefixes)
    scope: Scope = "found" if listed is None else "all"
    if listed is None:
        listed = list_by_exchange(reduced, start, n_sets=n_sets, max_looks=max_looks)
    return _build_pool(problem, reduced, listed, scope=scope)


def _bounded(reduced: ReducedProblem, most: float) -> ReducedProblem:
    """The problem with no more units or money than the solution, where these come first."""
    limits = reduced.limits
    if reduced.objectives[0] is Objective.UNITS:
        n_units = int(np.floor(most + 1.0e-6))
        n_units = min(n_units, limits.max_units)
        limits = replace(limits, budget_units=max(n_units, 1))
    elif reduced.objectives[0] is Objective.COST:
        allowed = most if limits.budget_eur is None else min(most, limits.budget_eur)
        limits = replace(limits, budget_eur=allowed + COST_TOLERANCE_EUR)
    return replace(reduced, limits=limits)


def _build_pool(
    problem: PlacementProblem, reduced: ReducedProblem, listed: Listed, *, scope: Scope
) -> Pool:
    limits, first = problem.limits, problem.objectives[0]
    sets = []
    for units, objective in zip(listed.sets, listed.values.of(first), strict=True):
        poses = tuple(sorted(reduced.pose_index[units].tolist()))
        sets.append(
            PooledSet(
                pose_index=poses, value=placement_value(problem, poses), objective=float(objective)
            )
        )
    pose_share = np.zeros(limits.n_poses)
    pose_share[reduced.pose_index] = listed.pose_count / listed.n_within
    return Pool(
        stage=first.value,
        scope=scope,
        sets=tuple(sets),
        n_within=listed.n_within,
        pose_share=pose_share,
        site_share=listed.site_count / listed.n_within,
    )
