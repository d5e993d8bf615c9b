"""Best sets where units confirm runs together (fusion "any"), with a proof: OSQP, then branching.

A run is confirmed in the first window whose frames the chosen poses see between them. That is
no best-of coverage, but lies below one for every choice of one frame per window: the first window
of which some chosen pose sees *that* frame is no later. The choice is free, run by run and window
by window, and the bound is as good as the choice. It starts with the first frame of each window,
where a VRU that comes into sight stays in sight; then each window is asked for the frame that the
relaxed solution sees least, which is what the set pays for missed detections and gaps.

The values of the poses are read straight from the bits of a detection table, which may have
hundreds of thousands of poses.
"""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from geometry.arrays import FloatArray, IntArray
from scenarios.aeb import AebRule, is_in_time
from scenarios.runs import FrameAxis

from .bounds import Coverage, Supply, ValueArray, can_matter, gains, prove
from .branch_and_bound import branch_and_bound
from .greedy import lazy_greedy, round_shares, search_around
from .multipliers import Columns, Tightened, generate_columns, tighten, worthiest
from .presolve import WordArray
from .relaxation import polish

_BLOCK_WORDS = 1 << 18  # 2 MB: what is worked on stays in the cache
_SHARE_DIGITS = 3  # shares that differ by less are equal
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
_LOCAL_POSES = 2000  # that exchanges choose from


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimelyWindows:
    """Windows of consecutive frames that end in time, for runs where there are any."""

    run_index: IntArray  # (n_rows,): runs of the axis with weight and at least one such window
    first_frame: IntArray  # (n_rows,): frame of the axis at which the run's first window begins
    n_windows: IntArray  # (n_rows,): windows of each run; window k begins at first_frame + k
    # (n_rows, largest n_windows + 1): margin if window k is the first one seen; 0 from k =
    # n_windows on: none [s].
    margin_s: FloatArray
    n_confirmations: int  # frames of a window


def timely_windows(axis: FrameAxis, rule: AebRule) -> TimelyWindows:
    """Find the windows of a frame axis that end in time."""
    run = np.repeat(np.arange(axis.n_runs), np.diff(axis.run_start))
    last_brake_s = axis.last_brake_time_s[run]
    position = np.arange(axis.n_frames) - axis.run_start[run]
    counts = (
        (position >= rule.n_confirmations - 1)
        & is_in_time(axis.time_s, last_brake_s, latency_s=rule.latency_s)
        & (axis.weight[run] > 0.0)
    )
    ends = np.flatnonzero(counts)
    run_index, first, n_windows = np.unique(run[ends], return_index=True, return_counts=True)
    margin_s = np.zeros((len(run_index), n_windows.max(initial=0) + 1))
    row = np.repeat(np.arange(len(run_index)), n_windows)
    margin_s[row, np.arange(len(ends)) - first[row]] = last_brake_s[ends] - (
        axis.time_s[ends] + rule.latency_s
    )
    return TimelyWindows(
        run_index=run_index,
        first_frame=ends[first] - (rule.n_confirmations - 1),
        n_windows=n_windows,
        margin_s=margin_s,
        n_confirmations=rule.n_confirmations,
    )


def first_seen_index(
    packed: NDArray[np.uint8],
    windows: TimelyWindows,
    *,
    frames: slice | IntArray,
    workers: int = 1,
) -> NDArray[np.uint16]:
    """First window of each run of which each pose sees certain frames, (n_poses, n_rows).

    It is the window's number within the run, and n_windows of the run if there is none. `packed`
    has V[c, f], the lowest bit first. `frames` says which frames of a window count. A slice stands
    for the same frames of every window, all of which are needed: ``slice(0, 1)`` is the first one,
    ``slice(None)`` all of them. An array has one frame for each window, see :func:`hardest_frames`.

    Raises ValueError if no frame counts, or one that no window has.
    """
    index = np.empty((len(packed), len(windows.run_index)), dtype=np.uint16)

    def keep(rows: slice, found: IntArray) -> None:
        index[rows] = found.T

    _go_through(packed, windows, frames, keep, workers)
    return index


def first_seen_values(
    packed: NDArray[np.uint8],
    windows: TimelyWindows,
    worth: FloatArray,
    *,
    frames: slice | IntArray,
    out: NDArray[np.float32] | None = None,
    workers: int = 1,
) -> NDArray[np.float32]:
    """What each pose alone is worth in each run, v[c, r] rounded up, (n_poses, n_rows).

    `worth`, (n_rows, largest n_windows + 1), is that of a run if window k is the first one seen,
    such as weight times margin; it must not grow with k, and its entry at n_windows is for runs
    that are not seen. For the other arguments and errors see :func:`first_seen_index`.

    With all frames the values are exact where one unit must confirm alone. With one frame of each
    window the largest of the values of the chosen poses is a limit of what they reach together,
    whoever sees the frames: where a window is seen as a whole, one of them sees that frame of it.
    """
    if worth.shape != windows.margin_s.shape:
        raise ValueError(f"worth: got {worth.shape}; expected {windows.margin_s.shape}")
    values = np.empty((len(packed), len(worth)), dtype=np.float32) if out is None else out
    table = worth.astype(np.float32)
    is_less = table < worth  # rounded up instead: a limit stays one
    table[is_less] = np.nextafter(table[is_less], np.float32(np.inf))
    start = (np.arange(len(worth)) * worth.shape[1])[:, None]

    def keep(rows: slice, found: IntArray) -> None:
        values[rows] = table.ravel()[start + found].T

    _go_through(packed, windows, frames, keep, workers)
    return values


def hardest_frames(seen_share: FloatArray, windows: TimelyWindows) -> IntArray:
    """Of each window the frame that is seen least, for :func:`first_seen_values`.

    `seen_share`, (n_frames,), is how much of each frame a relaxed solution sees, 0..1. Whichever
    frame of a window is asked for, values are limits. To ask for the one that is seen least
    promises least: for a set it finds exactly the windows that it sees as a whole.
    """
    window = np.minimum(np.arange(windows.margin_s.shape[1] - 1), windows.n_windows[:, None] - 1)
    frame = windows.first_frame[:, None] + window
    shares = [seen_share[frame + offset] for offset in range(windows.n_confirmations)]
    frames: IntArray = np.argmin(np.round(np.stack(shares), _SHARE_DIGITS), axis=0)
    return frames


def _go_through(
    packed: NDArray[np.uint8],
    windows: TimelyWindows,
    frames: slice | IntArray,
    keep: Callable[[slice, IntArray], None],
    workers: int,
) -> None:
    """Call `keep` with the indices, (n_rows, n_poses), of a few poses at a time."""
    every = range(windows.n_confirmations)
    if isinstance(frames, slice):
        is_possible = len(every[frames]) > 0
    else:
        shape = (len(windows.run_index), windows.margin_s.shape[1] - 1)
        is_possible = frames.shape == shape and bool(np.isin(frames, every).all())
    if not is_possible:
        raise ValueError(f"frames: got {frames}; expected some of {windows.n_confirmations}")
    n_poses = max(64, _BLOCK_WORDS // max(1, len(windows.run_index)))

    def work(start: int) -> None:
        rows = slice(start, start + n_poses)
        keep(rows, _first_seen(_by_word(packed[rows]), windows, frames))

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, range(0, len(packed), n_poses)))


def _by_word(packed: NDArray[np.uint8]) -> WordArray:
    """Words of 64 frames, an empty one at the end: (n_words + 1, n_poses) uint64."""
    n_words = -(-packed.shape[1] // 8)
    padded = np.zeros((len(packed), 8 * (n_words + 1)), dtype=np.uint8)
    padded[:, : packed.shape[1]] = packed
    return np.ascontiguousarray(padded.view("<u8").T)


def _first_seen(words: WordArray, windows: TimelyWindows, frames: slice | IntArray) -> IntArray:
    """Index of the first window of each run, (n_rows, n_poses)."""
    index = np.repeat(windows.n_windows[:, None], words.shape[1], axis=1)
    n_rounds = -(-int(windows.n_windows.max(initial=0)) // 64)
    for first_window in range(64 * (n_rounds - 1), -1, -64):
        longer = np.flatnonzero(windows.n_windows > first_window)
        begin = windows.first_frame[longer] + first_window
        if isinstance(frames, slice):
            offsets = range(windows.n_confirmations)[frames]
            seen = _words_from(words, begin + offsets[0])
            for offset in offsets[1:]:
                seen &= _words_from(words, begin + offset)
        else:
            asked = frames[longer, first_window : first_window + 64]
            seen = np.zeros((len(longer), words.shape[1]), dtype=np.uint64)
            for offset in range(windows.n_confirmations):
                of_window = _by_word(np.packbits(asked == offset, axis=1, bitorder="little"))[0]
                seen |= _words_from(words, begin + offset) & of_window[:, None]
        n_left = np.minimum(windows.n_windows[longer] - first_window, 64).astype(np.uint64)
        seen &= (~np.uint64(0) >> (np.uint64(64) - n_left))[:, None]
        lowest = np.bitwise_count(~seen & (seen - np.uint64(1)))  # 64 if no bit is set
        index[longer] = np.where(lowest < 64, first_window + lowest.astype(np.int64), index[longer])
    return index


def _words_from(words: WordArray, first_frame: IntArray) -> WordArray:
    """The 64 frames from some frame on, a row for each: (n, n_poses) uint64."""
    word, bit = np.divmod(first_frame, 64)
    bit = bit.astype(np.uint64)[:, None]
    # numpy shifts everything out where the shift is 64.
    result: WordArray = (words[word] >> bit) | (words[word + 1] << (np.uint64(64) - bit))
    return result


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
    branches: bool = True,
    seed: int = 0,
    workers: int = 1,
    on_step: Callable[[str], None] | None = None,
) -> WindowCover:
    """Find a set that is proven to be within a relative gap of the best, if time suffices.

    `packed` has V[c, f], the lowest bit first. `worth`, (n_rows, largest n_windows + 1), is that of
    each run if window k is the first one seen, and must not grow with k. When the time is up, the
    step under way is finished; then the best set and what is proven are returned. Without
    `branches`, only relaxations bound the set. `seed` is that of the restarts.
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
        if branches and limit > state.value * (1.0 + gap) and time.monotonic() < end_s:
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


def choose_greedily(coverage: Coverage, *, workers: int = 1) -> IntArray:
    """Greedy by gain; where money is short, the better of that and of greedy by gain per euro."""
    worth = gains(coverage.values, coverage.floor, workers=workers)
    chosen = lazy_greedy(coverage, worth=worth)
    if np.isfinite(coverage.supply.budget_eur):
        per_euro = lazy_greedy(coverage, worth=worth, per_euro=True)
        chosen = max((chosen, per_euro), key=coverage.value)
    return chosen


def search_near(
    coverage: Coverage,
    columns: Columns,
    best: IntArray,
    *,
    n_restarts: int,
    seed: int = 0,
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
