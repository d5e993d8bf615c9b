"""The best set of more than three poses, or how much better one could be: branch and bound.

Near copies of a pose (a few degrees of yaw) make "with this pose, or without" a poor question: the
answer "without" changes nothing. So a node asks whether a site carries a unit that is not yet
accounted for, and then which half of its poses that unit is among.
"""

import heapq
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.arrays import FloatArray, IntArray

from .bounds import (
    Bound,
    Coverage,
    ValueArray,
    can_matter,
)
from .greedy import fill, swap
from .multipliers import tighten

_ROOT_STEPS = 300
_NODE_STEPS = 60
_LEAST_GAIN = 1.0e-9
_LITTLE_USED = 0.2  # units at a site: less, and another question says more


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Search:
    """What branch and bound found."""

    poses: IntArray  # (n_units,): the best set
    value: float  # f of it
    limit: float  # no feasible set is worth more
    n_nodes: int  # looked at
    is_finished: bool  # False: the time was up


@dataclass(order=True, slots=True)
class _Node:
    """Sets that have one pose of each group, others from the rest of the pool."""

    priority: float  # minus the limit: the highest comes first
    number: int
    pool: IntArray = field(compare=False)
    groups: tuple[IntArray, ...] = field(compare=False)  # poses of the whole coverage
    multipliers: ValueArray = field(compare=False)


def branch_and_bound(
    coverage: Coverage,
    incumbent: IntArray,
    multipliers: ValueArray,
    *,
    evaluate: Callable[[IntArray], float] | None = None,
    gap: float = 0.0,
    time_limit_s: float = 60.0,
    max_nodes: int | None = None,
    workers: int = 1,
) -> Search:
    """Find the best set among thousands of poses, or stop with what is proven.

    It begins with a feasible set and with multipliers, (n_rows,). `evaluate` tells what a set is
    truly worth where f is only a limit of that. Sets that are better than the incumbent by no more
    than the relative `gap` need not be found: a finished search has ``limit <= (1 + gap) value``.

    Nodes with the highest limit come first: good sets come from exchanges rather than from the
    depth, and so the proven limit falls from node to node.
    """
    end_s = time.monotonic() + time_limit_s
    with threadpool_limits(1):  # products are too small for BLAS's threads
        tree = _Tree(coverage, incumbent, multipliers, evaluate or coverage.value, gap, workers)
        while tree.is_open and tree.n_nodes != max_nodes and time.monotonic() <= end_s:
            tree.look_at_next()
    return Search(
        poses=tree.best,
        value=tree.value,
        limit=tree.limit,
        n_nodes=tree.n_nodes,
        is_finished=not tree.is_open,
    )


class _Tree:
    """Open nodes, the best set so far, and what has been given up."""

    def __init__(
        self,
        coverage: Coverage,
        incumbent: IntArray,
        multipliers: ValueArray,
        evaluate: Callable[[IntArray], float],
        gap: float,
        workers: int,
    ) -> None:
        self.coverage, self.evaluate = coverage, evaluate
        self.gap, self.workers = gap, workers
        self.best, self.value = incumbent, evaluate(incumbent)
        self.n_nodes = 0
        self.given_up = -np.inf  # no set that was left aside is worth more
        self.numbers = count()
        self.heap: list[_Node] = []
        self._open(np.inf, np.arange(coverage.n_poses), coverage.supply.groups, multipliers)

    @property
    def enough(self) -> float:
        """Sets worth no more are not looked for."""
        rounding = 4.0 * float(np.finfo(self.coverage.values.dtype).eps)
        return self.value * (1.0 + max(self.gap, rounding, _LEAST_GAIN))

    @property
    def is_open(self) -> bool:
        """Whether a node may hold a set that is looked for."""
        return bool(self.heap) and -self.heap[0].priority > self.enough

    @property
    def limit(self) -> float:
        """No set is worth more."""
        return max([self.value, self.given_up] + [-node.priority for node in self.heap])

    def look_at_next(self) -> None:
        """Bound the node with the highest limit; ask a question about it."""
        node = heapq.heappop(self.heap)
        self.n_nodes += 1
        part = _part(self.coverage, node.pool, node.groups)
        tightened = tighten(
            part,
            node.multipliers,
            target=self.value,
            n_steps=_NODE_STEPS if self.n_nodes > 1 else _ROOT_STEPS,
            stop_below=self.enough,
            workers=self.workers,
        )
        bound = tightened.bound
        limit = min(bound.limit, -node.priority)
        for trial in _sets_near(part, bound):
            self._offer(node.pool[trial], part.value(trial))
        if limit <= self.enough:
            self.given_up = max(self.given_up, limit)
            return
        left = np.flatnonzero(can_matter(part, bound, self.enough))
        if len(left) < part.n_poses:
            self.given_up = max(self.given_up, min(self.enough, limit))
        part, pool = part.of_poses(left), node.pool[left]
        if not all(map(len, part.supply.groups)):
            return
        for some, groups in _children(part, tightened.shares[left]):
            self._open(limit, pool[some], tuple(pool[group] for group in groups), bound.multipliers)

    def _open(
        self,
        limit: float,
        pool: IntArray,
        groups: tuple[IntArray, ...],
        multipliers: ValueArray,
    ) -> None:
        node = _Node(
            priority=-limit,
            number=next(self.numbers),
            pool=pool,
            groups=groups,
            multipliers=multipliers,
        )
        heapq.heappush(self.heap, node)

    def _offer(self, poses: IntArray, promise: float) -> None:
        """Keep a set if it is better; what it promises is a limit of its value."""
        if promise <= self.value * (1.0 + _LEAST_GAIN) or not self.coverage.supply.allows(poses):
            return
        value = self.evaluate(poses)
        if value > self.value * (1.0 + _LEAST_GAIN):
            self.best, self.value = poses, value


def _part(coverage: Coverage, pool: IntArray, groups: tuple[IntArray, ...]) -> Coverage:
    """The coverage of a node."""
    supply = coverage.supply.with_groups(groups)
    grouped = Coverage(values=coverage.values, supply=supply, reached=coverage.reached)
    return grouped.of_poses(pool)


def _sets_near(part: Coverage, bound: Bound) -> list[IntArray]:
    """Sets near what the bound picks: filled up, and exchanged until that does not help."""
    chosen = np.empty(0, dtype=np.int64)
    for pose in bound.pick.poses[np.argsort(-bound.pick.shares, kind="stable")]:
        if part.supply.has_room(chosen)[pose]:
            chosen = np.append(chosen, pose)
    every = np.arange(part.n_poses)
    filled = fill(part, chosen, every)
    return [filled, swap(part, filled, every)]


def _children(part: Coverage, shares: FloatArray) -> list[tuple[IntArray, tuple[IntArray, ...]]]:
    """Pools and groups of the nodes that a node falls apart into; none if it is one set.

    Every set of the node is in one of them.
    """
    supply = part.supply
    groups, every = supply.groups, np.arange(part.n_poses)
    is_free = np.ones(part.n_poses, dtype=bool)
    for group in groups:
        is_free[group] = False
    if len(groups) == supply.max_units:
        is_free[:] = False
        every = np.sort(np.concatenate(groups)) if groups else every[:0]
    at_site = np.bincount(supply.site_index, weights=shares * is_free)
    sizes = [len(group) for group in groups]
    if is_free.any() and (at_site.max() > _LITTLE_USED or max(sizes, default=1) == 1):
        site = supply.site_index[is_free][at_site[supply.site_index[is_free]].argmax()]
        asked = np.flatnonzero(is_free & (supply.site_index == site))
        return [(every, (*groups, asked)), (np.setdiff1d(every, asked), groups)]
    if max(sizes, default=1) == 1:
        return []
    undecided = [
        shares[group].sum() - shares[group].max() if len(group) > 1 else -1.0 for group in groups
    ]
    number = int(np.argmax(undecided))
    group = groups[number]
    pivot = part.values[group[shares[group].argmax()]]
    distance = np.abs(part.values[group] - pivot).sum(axis=1)
    order = group[np.argsort(distance, kind="stable")]
    near, far = np.sort(order[: (len(order) + 1) // 2]), np.sort(order[(len(order) + 1) // 2 :])
    others = (*groups[:number], *groups[number + 1 :])
    left = np.setdiff1d(every, far) if len(groups) == supply.max_units else every
    return [(left, (*others, near)), (np.setdiff1d(every, near), (*others, far))]
