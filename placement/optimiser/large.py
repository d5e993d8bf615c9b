"""Instances too large for models: few promising poses are solved, all poses are bounded.

The table is gone through once, to see what each pose alone promises in every run (first_seen.py).
On these promises, prices for poses (multipliers.py) bound every layout there is, and tell which
poses can matter. Among those the layout is sought on the real windows.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import FloatArray, IntArray
from scenarios.aeb import AebRule, is_in_time
from scenarios.runs import FrameAxis

from ..detection_table import DetectionTable
from .bounds import Coverage, Supply
from .greedy import lazy_greedy, swap
from .limits import Limits
from .multipliers import Columns, generate_columns
from .problem import PlacementProblem, run_margins_s

# ---------- when each pose alone first sees each run, straight from the bits of a detection table


WordArray = NDArray[np.uint64]

_BLOCK_WORDS = 1 << 18  # 2 MB: what is worked on stays in the cache
_SHARE_DIGITS = 3  # shares that differ by less are equal


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimelyWindows:
    """Windows of consecutive frames that end in time, for runs where there are any.

    Attributes
    ----------
    run_index : (n_rows,) int
        Runs of the axis with weight and at least one such window.
    first_frame : (n_rows,) int
        Frame of the axis at which the run's first window begins.
    n_windows : (n_rows,) int
        Windows of each run; window k begins at first_frame + k.
    margin_s : (n_rows, largest n_windows + 1) float
        Margin if window k is the first one seen; 0 from k = n_windows on: none. [s]
    n_confirmations : int
        Frames of a window.
    """

    run_index: IntArray
    first_frame: IntArray
    n_windows: IntArray
    margin_s: FloatArray
    n_confirmations: int


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
    """First window of each run of which each pose sees certain frames.

    Parameters
    ----------
    packed : (n_poses, n_bytes) uint8
        V[c, f], lowest bit first.
    windows : TimelyWindows
        Of the same frames.
    frames : slice or (n_rows, largest n_windows) int
        Frames of a window that count. A slice: the same of every window, all needed, such as
        ``slice(0, 1)``, the first one, or ``slice(None)``, all. An array: one of each window, see
        :func:`hardest_frames`.
    workers : int
        Threads.

    Returns
    -------
    index : (n_poses, n_rows) uint16
        Window within the run; n_windows of the run if there is none.

    Raises
    ------
    ValueError
        No frame counts, or one that no window has.
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
    """What each pose alone is worth in each run.

    Parameters
    ----------
    packed, windows, frames, workers
        As for :func:`first_seen_index`.
    worth : (n_rows, largest n_windows + 1) float
        If window k is the first one seen, such as weight times margin; what stands at n_windows
        is for runs that are not seen. Must not grow with k.
    out : (n_poses, n_rows) float32, optional
        Where to write.

    Returns
    -------
    values : (n_poses, n_rows) float32
        v[c, r], rounded up. With ``slice(None)`` exact where one unit must confirm alone. With one
        frame of each window the largest of the values of the chosen poses is a limit of what they
        reach together, whoever sees the frames: where a window is seen as a whole, one of them
        sees that frame of it.

    Raises
    ------
    ValueError
        As for :func:`first_seen_index`, or `worth` has another shape.
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
    """Of each window the frame that is seen least.

    Parameters
    ----------
    seen_share : (n_frames,) float
        How much of each frame a relaxed solution sees, 0..1.
    windows : TimelyWindows
        Of the same frames.

    Returns
    -------
    frames : (n_rows, largest n_windows) int
        For :func:`first_seen_values`; of equal ones the first.

    Notes
    -----
    Whichever frame of a window is asked for, values are limits. To ask for the one that is seen
    least promises least: for a set it finds exactly the windows that it sees as a whole.
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


# ---------- instances too large for models: few promising poses are solved, all poses are bounded


MAX_BITS = 1_000_000_000
"""Detections in a table that is still solved as a whole."""
_POOL = 400
_WORKERS = 2
_BLOCK_POSES = 1 << 14


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outlook:
    """What can be known of a large instance without solving it.

    Attributes
    ----------
    pool : (n,) int
        Promising poses, forced ones among them.
    sets : tuple of (n_units,) int
        Sets that promise most, of the whole problem.
    apr : float
        No layout within units, sites and money has a higher APR.
    margins_s : float
        Nor a larger sum of weights times margins; infinite where that was not asked. [s]
    """

    pool: IntArray
    sets: tuple[IntArray, ...]
    apr: float
    margins_s: float


def is_large(problem: PlacementProblem) -> bool:
    """Whether a problem is better not solved as a whole."""
    return problem.table.n_poses * problem.table.axis.n_frames > MAX_BITS


def look_out(
    problem: PlacementProblem,
    *,
    has_margins: bool = True,
    on_step: Callable[[str], None] | None = None,
) -> Outlook:
    """Bound all poses, and pick the promising ones.

    Parameters
    ----------
    problem : PlacementProblem
        Its measure is a mean; wishes are left out, which only makes bounds higher.
    has_margins : bool
        Whether margins are bounded, too: another pass through the table.
    on_step : callable, optional
        Called with what is being done.
    """
    windows = timely_windows(problem.table.axis, problem.rule)
    weight = problem.table.axis.weight[windows.run_index]
    last = np.arange(windows.margin_s.shape[1]) < windows.n_windows[:, None]
    worths: list[FloatArray] = [np.where(last, weight[:, None], 0.0)]
    if has_margins:
        worths.append(np.where(last, np.maximum(windows.margin_s, 0.0), 0.0) * weight[:, None])
    limits, sets = [], []
    pools = [np.flatnonzero(problem.limits.is_forced)]
    for number, worth in enumerate(worths):
        if on_step is not None:
            on_step("margins of all poses" if number else "all poses")
        chosen, columns = _promise(_coverage(problem, windows, worth))
        limits.append(columns.bound.limit)
        best_first = np.argsort(-columns.bound.worth[columns.pool], kind="stable")
        pools += [chosen, columns.pool[best_first[:_POOL]]]
        sets.append(chosen)
    pool = np.unique(np.concatenate(pools))
    return Outlook(
        pool=pool[~problem.limits.is_forbidden[pool]],
        sets=tuple(sets),
        apr=min(limits[0], 1.0),
        margins_s=limits[1] if has_margins else np.inf,
    )


def of_pool(problem: PlacementProblem, pool: IntArray) -> PlacementProblem:
    """The same problem on some of the poses."""
    table = problem.table
    return replace(
        problem,
        table=DetectionTable(
            pose_ids=tuple(table.pose_ids[pose] for pose in pool),
            axis=table.axis,
            packed=table.packed[pool],
        ),
        limits=problem.limits.of_poses(pool),
    )


def _coverage(problem: PlacementProblem, windows: TimelyWindows, worth: FloatArray) -> Coverage:
    limits = problem.limits
    frames = slice(0, 1) if problem.fusion == "any" else slice(None)
    values = first_seen_values(
        problem.table.packed, windows, worth, frames=frames, workers=_WORKERS
    )
    values[limits.is_forbidden] = 0.0
    return Coverage(
        values=values,
        supply=Supply(
            max_units=limits.max_units,
            site_index=limits.site_index,
            site_capacity=limits.site_capacity,
            unit_cost_eur=limits.unit_cost_eur,
            site_cost_eur=limits.site_cost_eur,
            budget_eur=np.inf if limits.budget_eur is None else limits.budget_eur,
        ),
    )


def _promise(coverage: Coverage) -> tuple[IntArray, Columns]:
    """A set that promises much, and the bound of all."""
    chosen = lazy_greedy(coverage, workers=_WORKERS)
    columns = generate_columns(coverage, chosen, workers=_WORKERS)
    better = swap(coverage, chosen, pool=columns.pool)
    if coverage.value(better) <= coverage.value(chosen) + 1.0e-9:
        return chosen, columns
    columns = generate_columns(
        coverage,
        better,
        multipliers=columns.bound.multipliers.astype(np.float64),
        workers=_WORKERS,
    )
    return better, columns


def margin_limits_s(problem: PlacementProblem) -> FloatArray:
    """Margins of all runs with every allowed pose mounted, (n_runs,); minus infinity: not avoided.

    With fusion "single", no less than what any one pose reaches.
    """
    table, limits = problem.table, problem.limits
    everything = np.zeros(table.packed.shape[1], dtype=np.uint8)
    for start in range(0, table.n_poses, _BLOCK_POSES):
        rows = slice(start, start + _BLOCK_POSES)
        allowed = table.packed[rows][~limits.is_forbidden[rows]]
        everything |= np.bitwise_or.reduce(allowed, axis=0)
    one = DetectionTable(pose_ids=("all",), axis=table.axis, packed=everything[None, :])
    alone = replace(
        problem,
        table=one,
        limits=Limits(site_index=np.array([0]), site_capacity=np.array([1])),
    )
    return run_margins_s(alone, [0])
