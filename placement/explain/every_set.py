"""All sets of poses gone through, K - 1 units at a time together with every pose."""

from dataclasses import dataclass, replace
from itertools import combinations
from math import comb

import numpy as np

from geometry.arrays import FloatArray, IntArray

from ..optimiser import ReducedProblem
from ..optimiser.bitsets import set_values
from ..optimiser.limits import are_allowed
from .rows import (
    LACKING,
    QuickRows,
    descending,
    first_column,
    is_within,
    site_counts,
    ties_or_beats,
)

_MAX_CONTENDERS = 20_000  # sets whose margins are told
_PART_SETS = 1 << 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Listed:
    """Sets of poses of a reduced problem, the best first.

    Attributes
    ----------
    sets : tuple of (n_units,) int
        Poses of the reduced problem.
    rows : (n_sets, N_COLUMNS) float
        What they are worth, see :func:`placement.optimiser.bitsets.set_values`.
    n_within : int
        Sets that were counted.
    pose_count : (n_poses,) int
        How many of these have each pose.
    site_count : (n_sites,) int
        How many of them have a unit at each site.
    best : float
        The best value of the first stage among them.
    """

    sets: tuple[IntArray, ...]
    rows: FloatArray
    n_within: int
    pose_count: IntArray
    site_count: IntArray
    best: float


def list_every_set(
    reduced: ReducedProblem, threshold: float, *, n_sets: int, max_prefixes: int
) -> Listed | None:
    """The best sets of poses, and how often each pose appears in all within a threshold.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from.
    threshold : float
        Of the first stage.
    n_sets : int
        How many to list.
    max_prefixes : int
        Give up if more sets than this have to be looked at together with every pose.

    Returns
    -------
    listed : Listed or None
        None: given up, for too many sets, or too many that only their margins tell apart.
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
        self.contenders: list[tuple[IntArray, FloatArray]] = []  # by size: sets, quick rows
        self.worst: FloatArray | None = None  # quick row of the last set that could be listed

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
        reaches = (rows[:, LACKING] == 0.0) & is_within(
            rows[:, first_column(reduced)], self.threshold
        )
        joined = np.flatnonzero(reaches) + last
        sets = np.column_stack([np.tile(prefix, (len(joined), 1)), joined])
        is_allowed = are_allowed(reduced.limits, sets)
        sets, rows = sets[is_allowed], rows[joined - last][is_allowed]
        if not len(sets):
            return
        self.n_within += len(sets)
        self.best = max(self.best, float(rows[:, first_column(reduced)].max()))
        np.add.at(self.pose_count, sets.ravel(), 1)
        self.site_count += site_counts(reduced, sets)
        if self.worst is not None:
            may_be_listed = ties_or_beats(rows, self.worst)
            sets, rows = sets[may_be_listed], rows[may_be_listed]
        if len(sets):
            self.contenders.append((sets, rows))
            if self.n_contenders > 2 * self.n_sets:
                self._drop_the_worst()

    def _drop_the_worst(self) -> None:
        """Keep what may be among the best: ties with the last one that would be listed stay."""
        rows = np.concatenate([rows for _, rows in self.contenders])
        if len(rows) <= self.n_sets:
            return
        self.worst = rows[descending(rows)[self.n_sets - 1]]
        kept: dict[int, tuple[IntArray, FloatArray]] = {}
        for sets, own in self.contenders:
            stays = ties_or_beats(own, self.worst)
            sets, own = sets[stays], own[stays]
            size = sets.shape[1]
            if size in kept:
                sets = np.concatenate([kept[size][0], sets])
                own = np.concatenate([kept[size][1], own])
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
        values = np.concatenate(rows)
        order = descending(values)[: self.n_sets]
        return Listed(
            sets=tuple(sets[index] for index in order),
            rows=values[order],
            n_within=self.n_within,
            pose_count=self.pose_count,
            site_count=self.site_count,
            best=self.best,
        )
