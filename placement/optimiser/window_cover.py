"""From packed bits to a set with a proven gap, where units confirm together: fusion "any".

A run is confirmed in the first window whose frames the chosen poses see between them. That is
no best-of coverage, but lies below one for every choice of one frame per window: the first window
of which some chosen pose sees *that* frame is no later. The choice is free, run by run and window
by window, and the bound is as good as the choice. It starts with the first frame of each window,
where a VRU that comes into sight stays in sight; then each window is asked for the frame that the
relaxed solution sees least, which is what the set pays for missed detections and gaps.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from geometry.arrays import FloatArray, IntArray

from .best_cover import choose_greedily, search_near
from .bounds import (
    Coverage,
    Supply,
    ValueArray,
    can_matter,
    prove,
)
from .branch_and_bound import branch_and_bound
from .greedy import round_shares
from .large import TimelyWindows, first_seen_values, hardest_frames
from .multipliers import (
    Columns,
    Tightened,
    generate_columns,
    tighten,
    worthiest,
)
from .relaxation import polish

_POOL_POSES = 5000
_EXCHANGE_POSES = 1000
_N_ROUNDS = 6
_N_PASSES = 3
_N_STEPS = 200
_N_LONGER = 12
_N_RESTARTS = 15
_LEAST_GAIN = 1.0e-9
_SETTLED = 2.0e-4  # relative
_SMALL_SHARE = 1.0e-3
_MAX_BRANCH_VALUES = 1 << 26


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WindowCover:
    """A set of poses and how good it is proven to be.

    Attributes
    ----------
    poses : (n_units,) int
        Ascending.
    value : float
        What the windows are worth that they see together.
    limit : float
        No feasible set is worth more.
    frames : (n_rows, largest n_windows) int
        Frame that each window was asked for.
    multipliers : (n_rows,) float
        With the values of `frames`, :func:`placement.optimiser.bounds.prove` gives `root_limit`.
    root_limit : float
        What the multipliers prove; `limit` is lower if branching has proven more.
    pool : (n,) int
        Poses that the bound rests on: a good place to look for more.
    n_nodes : int
        Of branch and bound.
    seconds : float
        Spent. [s]
    """

    poses: IntArray
    value: float
    limit: float
    frames: IntArray
    multipliers: ValueArray
    root_limit: float
    pool: IntArray
    n_nodes: int
    seconds: float

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
                if trial[place] > value * (1.0 + _LEAST_GAIN):
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
    seed: int = 0,
    workers: int = 1,
    on_step: Callable[[str], None] | None = None,
) -> WindowCover:
    """Find a set that is proven to be within a gap of the best.

    Parameters
    ----------
    packed : (n_poses, n_bytes) uint8
        V[c, f], lowest bit first.
    windows : TimelyWindows
        Of the same frames.
    worth : (n_rows, largest n_windows + 1) float
        Of each run if window k is the first one seen; must not grow with k.
    supply : Supply
        Which sets are feasible.
    gap : float
        Good enough, as a share of the value.
    time_limit_s : float
        The step under way is finished, then what is proven is returned. [s]
    seed : int
        Of restarts.
    workers : int
        Threads.
    on_step : callable, optional
        Called with the name of every step when it begins.

    Returns
    -------
    cover : WindowCover
        The gap it reached may be larger than what was asked for.
    """
    began_s = time.monotonic()
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
            if is_enough or time.monotonic() > end_s or multipliers is None:
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
        if limit > state.value * (1.0 + gap) and time.monotonic() < end_s:
            if root is not columns:
                first_seen_values(
                    packed, windows, worth, frames=root_frames, out=values, workers=workers
                )
            report("exchange")
            _look_longer(state, coverage, root, gap, seed, end_s)
        if limit > state.value * (1.0 + gap) and time.monotonic() < end_s:
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
        seconds=time.monotonic() - began_s,
    )


def _columns(
    coverage: Coverage,
    best: IntArray,
    multipliers: ValueArray | None,
    end_s: float,
    workers: int,
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
        frames = hardest_frames(state.seen / state.seen.max(initial=1e-300), state.windows)
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
        if gained < _SETTLED * state.value or time.monotonic() > end_s:
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
    half_s = time.monotonic() + 0.5 * (end_s - time.monotonic())
    for number in range(_N_LONGER):
        _look_near(state, part, pool, near, seed + _N_ROUNDS * _N_PASSES + number)
        is_enough = root.limit <= state.value * (1.0 + gap)
        if is_enough or time.monotonic() > half_s:
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
        time_limit_s=end_s - time.monotonic(),
        workers=workers,
    )
    state.best, state.value = left[search.poses], search.value
    return min(root.limit, max(search.limit, enough)), search.n_nodes


def _ignore(step: str) -> None:
    """Take no notice."""
