"""Best sets where units confirm runs together (fusion "any"), with a proof: OSQP, then branching.

A run is confirmed in the first window whose frames the chosen poses see between them. That is
no best-of coverage, but lies below one for every choice of one frame per window: the first window
of which some chosen pose sees *that* frame is no later. The choice is free, run by run and window
by window, and the bound is as good as the choice. It starts with the first frame of each window,
where a VRU that comes into sight stays in sight; then each window is asked for the frame that the
relaxed solution sees least, which is what the set pays for missed detections and gaps.

Branch and bound finds the best set of more than three poses, or how much better one could be.
Near copies of a pose (a few degrees of yaw) make "with this pose, or without" a poor question: the
answer "without" changes nothing. So a node asks whether a site carries a unit that is not yet
accounted for, and then which half of its poses that unit is among.
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from geometry.arrays import FloatArray, IntArray
from geometry.clock import now_s

from .bounds import (
    Bound,
    Coverage,
    Supply,
    TimelyWindows,
    ValueArray,
    can_matter,
    first_seen_values,
    gains,
    hardest_frames,
    prove,
)
from .greedy import fill, lazy_greedy, round_shares, search_around, swap
from .relaxation import Columns, Tightened, generate_columns, polish, tighten, worthiest
from .tolerances import ROUNDING, TINY

_POOL_POSES = 5000
_EXCHANGE_POSES = 1000
_N_ROUNDS = 6
_N_PASSES = 3
_N_STEPS = 200
_N_LONGER = 12
_N_RESTARTS = 15
_SETTLED = 2.0e-4  # relative
_SMALL_SHARE = 1.0e-3
_MAX_BRANCH_VALUES = 1 << 26
_LOCAL_POSES = 2000  # that exchanges choose from


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WindowCover:
    """A set of poses and how good it is proven to be."""

    poses: IntArray  # (n_units,): ascending
    value: float  # what the windows are worth that they see together
    limit: float  # no feasible set is worth more
    frames: IntArray  # (n_rows, largest n_windows): frame that each window was asked for
    # (n_rows,): with the values of `frames`, :func:`placement.optimiser.bounds.prove` gives
    # `root_limit`.
    multipliers: ValueArray
    root_limit: float  # what the multipliers prove; `limit` is lower if branching has proven more
    pool: IntArray  # (n,): poses that the bound rests on: a good place to look for more
    n_nodes: int  # of branch and bound
    seconds: float  # spent [s]

    @property
    def gap(self) -> float:
        """How much better a set could be, as a share of the value."""
        if self.limit <= self.value:
            return 0.0
        return (self.limit - self.value) / self.value if self.value > 0.0 else np.inf


@dataclass(slots=True, kw_only=True, eq=False)
class _State:
    """What is known while the search goes on."""

    packed: NDArray[np.uint8]
    windows: TimelyWindows
    worth: FloatArray
    supply: Supply
    values: NDArray[np.float32]
    frames: IntArray
    best: IntArray
    seen: FloatArray  # how much relaxed solutions saw of each frame, added up
    value: float = -np.inf
    tried: set[bytes] = field(default_factory=set)

    def values_of_unions(self, packed: NDArray[np.uint8]) -> FloatArray:
        """What sets are worth that see certain frames, (n_sets,)."""
        values = first_seen_values(packed, self.windows, self.worth, frames=slice(None))
        total: FloatArray = values.sum(axis=1, dtype=np.float64)
        return total

    def evaluate(self, poses: IntArray) -> float:
        """What a set is worth."""
        union = np.bitwise_or.reduce(self.packed[poses], axis=0)
        return float(self.values_of_unions(union[None, :])[0])

    def offer(self, poses: IntArray, pool: IntArray) -> None:
        """Exchange poses of a set for others of a pool, or add some, while that helps; keep it."""
        key = np.sort(poses).tobytes()
        if key in self.tried:
            return
        self.tried.add(key)
        value, is_better = self.evaluate(poses), True
        bits = self.packed[pool]
        while is_better:
            is_better = False
            for unit in range(len(poses) + 1):  # the last one: nothing goes
                rest = np.delete(poses, unit) if unit < len(poses) else poses
                can = self.supply.has_room(rest)[pool]
                if not can.any():
                    continue
                others = np.bitwise_or.reduce(self.packed[rest], axis=0)
                trial = np.where(can, self.values_of_unions(bits | others), -np.inf)
                place = int(trial.argmax())
                if trial[place] > value * (1.0 + ROUNDING):
                    poses = np.append(rest, pool[place])
                    value, is_better = float(trial[place]), True
                    break
        self.tried.add(np.sort(poses).tobytes())
        if value > self.value:
            self.best, self.value = poses, value


def find_window_cover(
    packed: NDArray[np.uint8],
    windows: TimelyWindows,
    worth: FloatArray,
    supply: Supply,
    *,
    gap: float = 0.0,
    time_limit_s: float = 300.0,
    branches: bool = True,
    seed: int = 0,
    workers: int = 1,
    on_step: Callable[[str], None] | None = None,
) -> WindowCover:
    """Find a set that is proven to be within a relative gap of the best, if time suffices.

    `packed` and `worth` are as in :func:`first_seen_values`. When the time is up, the step under
    way is finished; then the best set and what is proven are returned. Without `branches`, only
    relaxations bound the set. `seed` is that of the restarts.
    """
    began_s = now_s()
    end_s, report = began_s + time_limit_s, on_step or _ignore
    with threadpool_limits(1):  # products are too small for BLAS's threads
        report("values")
        frames = np.zeros((len(worth), worth.shape[1] - 1), dtype=np.int64)
        values = first_seen_values(packed, windows, worth, frames=slice(0, 1), workers=workers)
        coverage = Coverage(values=values, supply=supply)
        report("bound")
        best = choose_greedily(coverage, workers=workers)
        state = _State(
            packed=packed,
            windows=windows,
            worth=worth,
            supply=supply,
            values=values,
            frames=frames,
            best=best,
            seen=np.zeros(8 * packed.shape[1]),
        )
        state.value = state.evaluate(best)
        columns = _columns(coverage, best, None, end_s, workers)
        root, root_frames = columns, frames
        for _ in range(_N_PASSES):
            report("sharpen")
            multipliers = _sharpen(state, columns, gap, seed, end_s, workers)
            is_enough = root.limit <= state.value * (1.0 + gap)
            if is_enough or now_s() > end_s or multipliers is None:
                break
            report("bound")
            first_seen_values(
                packed, windows, worth, frames=state.frames, out=values, workers=workers
            )
            columns = _columns(coverage, state.best, multipliers, end_s, workers)
            gained = root.limit - columns.limit
            if gained > 0.0:
                root, root_frames = columns, state.frames
            is_enough = root.limit <= state.value * (1.0 + gap)
            if is_enough or gained < _SETTLED * state.value:
                break
        limit, n_nodes = root.limit, 0
        if limit > state.value * (1.0 + gap) and now_s() < end_s:
            if root is not columns:
                first_seen_values(
                    packed, windows, worth, frames=root_frames, out=values, workers=workers
                )
            report("exchange")
            _look_longer(state, coverage, root, gap, seed, end_s)
        if branches and limit > state.value * (1.0 + gap) and now_s() < end_s:
            report("branch")
            limit, n_nodes = _branch(state, coverage, root, gap, end_s, workers)
    return WindowCover(
        poses=np.sort(state.best),
        value=state.value,
        limit=max(limit, state.value),
        frames=root_frames,
        multipliers=root.bound.multipliers,
        root_limit=root.limit,
        pool=root.pool,
        n_nodes=n_nodes,
        seconds=now_s() - began_s,
    )


def _columns(
    coverage: Coverage, best: IntArray, multipliers: ValueArray | None, end_s: float, workers: int
) -> Columns:
    return generate_columns(
        coverage, best, multipliers=multipliers, improve=polish, end_s=end_s, workers=workers
    )


def _sharpen(
    state: _State, columns: Columns, gap: float, seed: int, end_s: float, workers: int
) -> ValueArray | None:
    """Ask for harder frames among the worthiest poses while that lowers their bound.

    Returns the multipliers for the frames that it leaves in the state; None if they are the old
    ones.
    """
    pool = np.union1d(columns.pool, worthiest(columns.bound.worth, _POOL_POSES))
    pool = np.union1d(pool, state.best)
    bits, supply = state.packed[pool], state.supply.of_poses(pool)
    shares = np.zeros(len(pool))
    shares[np.searchsorted(pool, columns.pool)] = columns.shares
    multipliers = columns.bound.multipliers
    lowest, kept = columns.limit, None
    for number in range(_N_ROUNDS):
        used = np.flatnonzero(shares > _SMALL_SHARE)
        seen = np.zeros(len(state.seen))
        for pose in used:
            seen += shares[pose] * np.unpackbits(bits[pose], bitorder="little")
        state.seen += np.minimum(seen, 1.0)
        frames = hardest_frames(state.seen / state.seen.max(initial=TINY), state.windows)
        part = Coverage(
            values=first_seen_values(
                bits, state.windows, state.worth, frames=frames, workers=workers
            ),
            supply=supply,
        )
        tightened = tighten(
            part, multipliers, target=state.value, n_steps=_N_STEPS, workers=workers
        )
        tightened = polish(part, tightened)
        _look_near(state, part, pool, tightened, seed + number)
        shares, multipliers = tightened.shares, tightened.bound.multipliers
        gained = lowest - tightened.bound.limit
        if gained > 0.0:
            lowest, kept, state.frames = tightened.bound.limit, multipliers, frames
        if gained < _SETTLED * state.value or now_s() > end_s:
            break
    return kept


def _look_near(
    state: _State, part: Coverage, pool: IntArray, tightened: Tightened, seed: int
) -> None:
    """Offer sets that promise much."""
    near = worthiest(tightened.bound.worth, _EXCHANGE_POSES)
    used = np.flatnonzero(tightened.shares > _SMALL_SHARE)
    near = np.union1d(near, used)
    rounded = round_shares(part, used, tightened.shares[used], pool=near)
    state.offer(pool[rounded], pool[near])
    own = Columns(
        limit=tightened.bound.limit,
        bound=tightened.bound,
        pool=np.arange(len(pool)),
        shares=tightened.shares,
    )
    start = np.searchsorted(pool, state.best) if np.isin(state.best, pool).all() else rounded
    found = search_near(part, own, start, n_restarts=_N_RESTARTS, seed=seed)
    state.offer(pool[found], pool[near])


def _look_longer(
    state: _State, coverage: Coverage, root: Columns, gap: float, seed: int, end_s: float
) -> None:
    """Offer sets again and again while half of the time is left and the gap is too large."""
    pool = np.union1d(root.pool, worthiest(root.bound.worth, _POOL_POSES))
    pool = np.union1d(pool, state.best)
    shares = np.zeros(len(pool))
    shares[np.searchsorted(pool, root.pool)] = root.shares
    part = coverage.of_poses(pool)
    near = Tightened(bound=prove(part, root.bound.multipliers), shares=shares)
    half_s = now_s() + 0.5 * (end_s - now_s())
    for number in range(_N_LONGER):
        _look_near(state, part, pool, near, seed + _N_ROUNDS * _N_PASSES + number)
        is_enough = root.limit <= state.value * (1.0 + gap)
        if is_enough or now_s() > half_s:
            break


def _branch(
    state: _State, coverage: Coverage, root: Columns, gap: float, end_s: float, workers: int
) -> tuple[float, int]:
    """Limit by branch and bound on what reduced costs leave over, if that is little enough."""
    enough = state.value * (1.0 + gap)
    left = np.flatnonzero(can_matter(coverage, root.bound, enough))
    if len(left) * coverage.n_rows > _MAX_BRANCH_VALUES:
        return root.limit, 0
    left = np.union1d(left, state.best)
    search = branch_and_bound(
        coverage.of_poses(left),
        np.searchsorted(left, state.best),
        root.bound.multipliers,
        evaluate=lambda poses: state.evaluate(left[poses]),
        gap=gap,
        time_limit_s=end_s - now_s(),
        workers=workers,
    )
    state.best, state.value = left[search.poses], search.value
    return min(root.limit, max(search.limit, enough)), search.n_nodes


def choose_greedily(coverage: Coverage, *, workers: int = 1) -> IntArray:
    """Greedy by gain; where money is short, the better of that and of greedy by gain per euro."""
    worth = gains(coverage.values, coverage.floor, workers=workers)
    chosen = lazy_greedy(coverage, worth=worth)
    if np.isfinite(coverage.supply.budget_eur):
        per_euro = lazy_greedy(coverage, worth=worth, per_euro=True)
        chosen = max((chosen, per_euro), key=coverage.value)
    return chosen


def search_near(
    coverage: Coverage, columns: Columns, best: IntArray, *, n_restarts: int, seed: int = 0
) -> IntArray:
    """Round the relaxed solution, exchange, and leave local bests again and again."""
    pool = np.union1d(best, worthiest(columns.bound.worth, _LOCAL_POSES))
    pool = np.union1d(pool, columns.pool[columns.shares > 0.0])
    shares = np.zeros(len(pool))
    known = np.isin(columns.pool, pool)
    shares[np.searchsorted(pool, columns.pool[known])] = columns.shares[known]
    part = coverage.of_poses(pool)
    every = np.arange(len(pool))
    rounded = round_shares(part, every, shares)
    start = max((np.searchsorted(pool, best), rounded), key=part.value)
    found = search_around(part, start, every, n_restarts=n_restarts, seed=seed)
    return pool[found]


def _ignore(step: str) -> None:
    """Take no notice."""


# ---------- branch and bound


_ROOT_STEPS = 300
_NODE_STEPS = 60
_LITTLE_USED = 0.2  # units at a site: less, and another question says more


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BranchResult:
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
) -> BranchResult:
    """Find the best set among thousands of poses, or stop with what is proven.

    `evaluate` tells what a set is truly worth where f is only a limit of that. Sets that are better
    than the incumbent by no more than the relative `gap` need not be found: a finished search has
    ``limit <= (1 + gap) value``. Nodes with the highest limit come first: good sets come from
    exchanges rather than from the depth, and so the proven limit falls from node to node.
    """
    end_s = now_s() + time_limit_s
    with threadpool_limits(1):  # products are too small for BLAS's threads
        tree = _Tree(coverage, incumbent, multipliers, evaluate or coverage.value, gap, workers)
        while tree.is_open and tree.n_nodes != max_nodes and now_s() <= end_s:
            tree.look_at_next()
    return BranchResult(
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
        return self.value * (1.0 + max(self.gap, rounding, ROUNDING))

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
        self, limit: float, pool: IntArray, groups: tuple[IntArray, ...], multipliers: ValueArray
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
        if promise <= self.value * (1.0 + ROUNDING) or not self.coverage.supply.allows(poses):
            return
        value = self.evaluate(poses)
        if value > self.value * (1.0 + ROUNDING):
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
