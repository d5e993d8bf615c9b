"""What does not matter drops out: frames, windows, runs and poses; and the way back.

Both kinds of fusion become one problem here. With "any", a frame is seen if a chosen pose
detects in it, and a window needs all its frames. With "single", the frames of the reduced problem
are the statements "this pose alone has confirmed by then", and each window needs one of them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from scenarios.aeb import AebRule, is_in_time
from scenarios.runs import FrameAxis

from .limits import Limits
from .objectives import COST_TOLERANCE_EUR, Goal, Objective, objectives_in_order
from .problem import Measure, PlacementProblem, Requirement

WordArray = NDArray[np.uint64]


@dataclass(frozen=True, slots=True, kw_only=True)
class PresolveStatistics:
    """Sizes before and after."""

    # Before, after. Windows count once per run before, once if they need the same frames after;
    # runs are left out if nothing avoids them or they have no weight.
    n_poses: tuple[int, int]
    n_frames: tuple[int, int]
    n_windows: tuple[int, int]
    n_runs: tuple[int, int]

    def __str__(self) -> str:
        return ", ".join(
            f"{before} -> {after} {noun}"
            for noun, (before, after) in (
                ("poses", self.n_poses),
                ("frames", self.n_frames),
                ("windows", self.n_windows),
                ("runs", self.n_runs),
            )
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReducedProblem:
    """A placement problem without what does not matter.

    A chain is a sequence of windows in the order of time. Runs that go through the same windows,
    to different ends, share one.
    """

    pose_index: IntArray  # (n_poses,): rows of the detection table: the way back
    limits: Limits  # on these poses
    run_index: IntArray  # (n_runs,): runs of the full problem that some pose avoids
    measure: Measure  # of these runs, as in the full problem
    floors: tuple[Requirement, ...]  # what must be reached in any case
    objectives: tuple[Objective, ...]  # in the order in which sets of poses are compared
    survive: int  # failed units that ``Objective.APR_SURVIVED`` is about
    n_frames: int  # merged frames
    words: WordArray  # (n_poses, n_words): bits V[c, f] along the merged frames, lowest bit first
    # (n_windows, n_confirmations or 1): merged frames that each window needs; one may stand there
    # twice.
    window_frames: IntArray
    chain_window: IntArray  # (n_links,): the windows of all chains, chain after chain
    # (n_chains + 1,): links of chain g are chain_start[g] .. chain_start[g + 1] - 1.
    chain_start: IntArray
    run_chain: IntArray  # (n_runs,): chain of every run
    # (n_runs, longest chain + 1): margin if the first window seen is the k-th of the chain; minus
    # infinity from the first one that is too late for this run [s].
    margin_s: FloatArray
    statistics: PresolveStatistics  # sizes before and after

    @property
    def n_poses(self) -> int:
        """Number of poses that are left."""
        return len(self.pose_index)

    @property
    def weight(self) -> FloatArray:
        """Weights of the runs, (n_runs,)."""
        return self.measure.weight

    def with_goal(self, goal: Goal) -> "ReducedProblem":
        """The same problem for another goal."""
        return replace(self, objectives=objectives_in_order(goal, survive=self.survive))

    @property
    def n_chains(self) -> int:
        """Number of chains."""
        return len(self.chain_start) - 1

    def chain(self, chain_index: int) -> IntArray:
        """Windows of a chain."""
        return self.chain_window[self.chain_start[chain_index] : self.chain_start[chain_index + 1]]

    def detected(self) -> BoolArray:
        """V[c, f] on the merged frames, (n_poses, n_frames)."""
        return unpack_words(self.words, self.n_frames)

    def __repr__(self) -> str:
        return f"ReducedProblem({self.statistics})"


def pack_words(bits: BoolArray) -> WordArray:
    """Bits along the last axis as 64-bit words, lowest bit first."""
    n_words = -(-bits.shape[-1] // 64)
    packed = np.zeros((*bits.shape[:-1], n_words * 8), dtype=np.uint8)
    packed[..., : -(-bits.shape[-1] // 8)] = np.packbits(bits, axis=-1, bitorder="little")
    return packed.view("<u8")


def unpack_words(words: WordArray, n_bits: int) -> BoolArray:
    """Bits of 64-bit words, lowest bit first: (..., n_words) -> (..., n_bits)."""
    packed = np.ascontiguousarray(words).view(np.uint8)
    return np.unpackbits(packed, axis=-1, count=n_bits, bitorder="little").view(np.bool_)


def presolve(problem: PlacementProblem) -> ReducedProblem:
    """Reduce a placement problem without changing the best value of any stage.

    At least one best set of poses of the full problem is left. Repeated until no pose drops out:

    * Runs without weight, windows that end too late, windows with a frame that nobody sees and
      frames of no window cannot change any value.
    * Frames that the same poses see are one frame.
    * A window is dominated if an earlier window of its run needs no other frames.
    * Poses that the money does not suffice for, and dominated ones, see :func:`is_dominated`.
    """
    windows = _Windows(problem)
    limits = problem.limits
    usable = (limits.site_capacity[limits.site_index] > 0) & ~limits.is_forbidden
    if limits.budget_eur is not None:
        price = limits.unit_cost_eur + limits.site_cost_eur[limits.site_index]
        usable &= price <= limits.budget_eur + COST_TOLERANCE_EUR
    usable |= limits.is_forced
    # Where only the worst worlds count, the smallest margin may fall when more is seen: a run that
    # is avoided in another world, too, adds nothing to their APR, but its margin counts.
    is_monotone = windows.measure.is_mean
    while True:
        poses = np.flatnonzero(usable)
        reduced = windows.reduce(poses)
        is_wished = reduced.limits.is_forced
        is_wished = is_wished | limits.is_forced_site[reduced.limits.site_index]
        sees: BoolArray = np.logical_or.reduce(reduced.words != 0, axis=1)
        is_needless = ~sees & ~is_wished
        left = np.flatnonzero(~is_needless)
        is_needless[left] = is_dominated(
            reduced.words[left],
            reduced.limits.of_poses(left),
            max_units=limits.max_units,
            may_add=None if is_monotone else _settled_frames(reduced, left),
        )
        if len(poses):  # a layout has a unit, even where none avoids anything: the cheapest then
            price = limits.unit_cost_eur + limits.site_cost_eur[limits.site_index]
            is_needless[np.argmin(price[poses])] = False
        if not is_needless.any():
            return reduced
        usable[poses[is_needless]] = False


def is_dominated(
    words: WordArray,
    limits: Limits,
    *,
    max_units: int,
    may_add: Callable[[int], WordArray] | None = None,
) -> BoolArray:
    """Poses without which some best set remains, whatever the stage.

    `words`, (n_poses, n_words): what each pose sees. `max_units`: no set has more units. Returns
    (n_poses,): may be dropped, all together. `may_add` tells what a dominator may see beyond a
    pose, by default anything: where more runs avoided may be worse, frames of those alone that the
    pose avoids by itself. In its place the dominator then avoids the same runs, no later.

    Pose d dominates pose c if it sees all that c sees, costs no more and is bound by nothing that c
    is not: at the same site its price decides; elsewhere its site may have to be paid, too, and
    neither site may have rivals or be asked for. Among equal poses the earlier one dominates. Every
    stage is monotone in what each unit sees: where d can take the place of c, no value gets worse.
    So c may go if in every feasible set S with c one of its dominators is outside S and finds room.
    Who wants to prevent that has the other K - 1 units of S to

    * fill a site, or choose all the dominators that stand there: min(capacity, dominators)
      units at least;
    * at the site of c, which has room once c is gone: choose all dominators there, beside c;
      this fails if there are as many of them as the site's capacity.

    If that takes more than K - 1 units, c may go. Dominators that are dropped themselves count: the
    replacement is replaced in turn, each time by a pose earlier in one fixed order (more seen,
    cheaper, index), which ends.
    """
    count = np.bitwise_count(words).sum(axis=1, dtype=np.int64)
    order = np.lexsort((limits.unit_cost_eur, -count))
    columns = np.ascontiguousarray(~words[order].T)
    sites = limits.site_index[order]
    price = limits.unit_cost_eur[order]
    is_bound_site = limits.is_forced_site.copy()
    is_bound_site[limits.rivals.ravel()] = True
    elsewhere = price + limits.site_cost_eur[sites]
    elsewhere[is_bound_site[sites]] = np.inf
    result = np.zeros(len(words), dtype=bool)
    for rank, pose in enumerate(order):
        if limits.is_forced[pose]:
            continue
        own = limits.site_index[pose]
        affordable = limits.unit_cost_eur[pose] + COST_TOLERANCE_EUR
        if limits.is_plain:
            dominators = np.arange(rank)
        else:
            is_cheaper = (sites[:rank] == own) & (price[:rank] <= affordable)
            if not is_bound_site[own]:
                is_cheaper |= elsewhere[:rank] <= affordable
            dominators = np.flatnonzero(is_cheaper)
        row = words[pose]
        # The fullest words first: they leave the fewest.
        fullest = np.argsort(-np.bitwise_count(row).astype(np.int64), kind="stable")
        for word in fullest:
            if len(dominators) == 0 or row[word] == 0:
                break
            dominators = dominators[(columns[word, dominators] & row[word]) == 0]
        if may_add is not None and len(dominators):
            beyond = words[order[dominators]] & ~(row | may_add(int(pose)))
            dominators = dominators[~np.logical_or.reduce(beyond != 0, axis=1)]
        at_site = np.bincount(sites[dominators], minlength=limits.n_sites)
        result[pose] = (
            at_site[own] >= limits.site_capacity[own]
            or np.minimum(at_site, limits.site_capacity).sum() > max_units - 1
        )
    return result


def _settled_frames(reduced: ReducedProblem, poses: IntArray) -> Callable[[int], WordArray]:
    """What finds the frames that only runs need which a pose avoids alone, (n_words,)."""
    n_links = np.diff(reduced.chain_start)
    shortest = np.full(reduced.n_chains, np.iinfo(np.int64).max)
    in_time = (reduced.margin_s > -np.inf).sum(axis=1)
    np.minimum.at(shortest, reduced.run_chain, in_time)
    number = np.arange(len(reduced.chain_window)) - np.repeat(reduced.chain_start[:-1], n_links)
    is_for_all = number < np.repeat(shortest, n_links)
    frames = reduced.window_frames[reduced.chain_window]

    def find(pose: int) -> WordArray:
        detected = unpack_words(reduced.words[poses[pose]], reduced.n_frames)
        is_whole = np.logical_and.reduce(detected[frames], axis=1) & is_for_all
        is_open = ~np.logical_or.reduceat(is_whole, reduced.chain_start[:-1])
        is_settled = np.ones(reduced.n_frames, dtype=bool)
        is_settled[frames[np.repeat(is_open, n_links)]] = False
        return pack_words(is_settled)

    return find


def timely_windows_end(axis: FrameAxis, rule: AebRule) -> tuple[IntArray, IntArray, FloatArray]:
    """Windows of frames in a row that end in time, in runs with weight, each (n_windows,).

    Returns the last frame of each, its run, and the margin that it leaves [s].
    """
    run = np.repeat(np.arange(axis.n_runs), np.diff(axis.run_start))
    last_brake_s = axis.last_brake_time_s[run]
    counts = (
        (np.arange(axis.n_frames) - axis.run_start[run] >= rule.n_confirmations - 1)
        & is_in_time(axis.time_s, last_brake_s, latency_s=rule.latency_s)
        & (axis.weight[run] > 0.0)
    )
    end = np.flatnonzero(counts)
    return end, run[end], last_brake_s[end] - (axis.time_s[end] + rule.latency_s)


class _Windows:
    """Windows of a problem that end in time, as columns over the poses."""

    def __init__(self, problem: PlacementProblem) -> None:
        self.problem = problem
        self.measure = problem.measure()
        self.floor_measures = [problem.floor_measure(floor) for floor in problem.floors]
        end, self.run, self.margin_s = timely_windows_end(problem.table.axis, problem.rule)
        frames = end[:, None] + np.arange(1 - problem.rule.n_confirmations, 1)
        used, self.frames = np.unique(frames, return_inverse=True)
        detected = problem.table.detected(slice(None))
        self.columns = np.packbits(detected[:, used].T, axis=1, bitorder="little")
        if problem.fusion == "single":
            self.columns = np.bitwise_and.reduce(self.columns[self.frames], axis=1)
            for run in np.unique(self.run):
                of_run = slice(*np.searchsorted(self.run, [run, run + 1]))
                np.bitwise_or.accumulate(self.columns[of_run], axis=0, out=self.columns[of_run])
            self.frames = np.arange(len(end))[:, None]

    def reduce(self, poses: IntArray) -> ReducedProblem:
        """The problem on some poses, all of them kept."""
        problem = self.problem
        is_pose = np.zeros(problem.table.n_poses, dtype=bool)
        is_pose[poses] = True
        columns = self.columns & np.packbits(is_pose, bitorder="little")
        merged, frame = _unique_rows(columns)
        is_seen: BoolArray = np.logical_or.reduce(merged != 0, axis=1)

        frames = frame[self.frames]
        alive = np.flatnonzero(is_seen[frames].all(axis=1))
        alive = alive[~_is_late_window(_as_sets(frames[alive]), self.run[alive])]
        sets, window = np.unique(_as_sets(frames[alive]), axis=0, return_inverse=True)
        kept, window_frames = np.unique(sets, return_inverse=True)
        window_frames = window_frames.reshape(sets.shape)
        bits = np.unpackbits(merged[kept], axis=1, count=len(is_pose), bitorder="little")
        words = pack_words(np.ascontiguousarray(bits[:, poses].T).view(np.bool_))

        run_index, start = np.unique(self.run[alive], return_index=True)
        chain_window, chain_start, run_chain = _share_chains(np.split(window, start)[1:])
        margin_s = np.full((len(run_index), np.diff(chain_start).max(initial=0) + 1), -np.inf)
        for run, margin in enumerate(np.split(self.margin_s[alive], start)[1:]):
            margin_s[run, : len(margin)] = margin
        axis = problem.table.axis
        return ReducedProblem(
            pose_index=poses,
            limits=problem.limits.of_poses(poses),
            run_index=run_index,
            measure=self.measure.of_runs(run_index),
            floors=tuple(
                Requirement(
                    measure=measure.of_runs(run_index),
                    least=floor.share,
                    n_failures=floor.n_failures,
                )
                for floor, measure in zip(problem.floors, self.floor_measures, strict=True)
            ),
            objectives=problem.objectives,
            survive=problem.survive,
            n_frames=len(kept),
            words=words,
            window_frames=window_frames,
            chain_window=chain_window,
            chain_start=chain_start,
            run_chain=run_chain,
            margin_s=margin_s,
            statistics=PresolveStatistics(
                n_poses=(problem.table.n_poses, len(poses)),
                n_frames=(axis.n_frames, len(kept)),
                n_windows=(
                    int(
                        np.maximum(
                            np.diff(axis.run_start) + 1 - problem.rule.n_confirmations, 0
                        ).sum()
                    ),
                    len(sets),
                ),
                n_runs=(axis.n_runs, len(run_index)),
            ),
        )


def _unique_rows(rows: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], IntArray]:
    """Distinct rows, and which of them each row is."""
    whole = np.ascontiguousarray(rows).view(np.dtype((np.void, rows.shape[1])))[:, 0]
    _, first, inverse = np.unique(whole, return_index=True, return_inverse=True)
    return rows[first], inverse


def _as_sets(frames: IntArray) -> IntArray:
    """Rows sorted, the repeated entries last: equal as sets if and only if equal."""
    frames = np.sort(frames, axis=1)
    repeated = np.zeros(frames.shape, dtype=bool)
    repeated[:, 1:] = frames[:, 1:] == frames[:, :-1]
    return np.sort(np.where(repeated, frames[:, -1:], frames), axis=1)


def _is_late_window(frames: IntArray, run: IntArray) -> BoolArray:
    """Whether an earlier window of the same run needs no frame that this one does not need."""
    is_late = np.zeros(len(frames), dtype=bool)
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    for of_run in np.split(np.arange(len(frames)), starts)[1:]:
        mine = frames[of_run]
        is_subset = (mine[:, None, :, None] == mine[None, :, None, :]).any(axis=3).all(axis=2)
        is_late[of_run] = np.triu(is_subset, k=1).any(axis=0)
    return is_late


def _share_chains(sequences: list[IntArray]) -> tuple[IntArray, IntArray, IntArray]:
    """Chains such that every sequence is the beginning of one: windows, starts, chain of each."""
    chains: list[IntArray] = []
    beginnings: dict[bytes, int] = {}
    sequence_chain = np.zeros(len(sequences), dtype=np.int64)
    for index in sorted(range(len(sequences)), key=lambda index: -len(sequences[index])):
        sequence = sequences[index]
        key = sequence.tobytes()
        if key not in beginnings:
            for length in range(1, len(sequence) + 1):
                beginnings[sequence[:length].tobytes()] = len(chains)
            chains.append(sequence)
        sequence_chain[index] = beginnings[key]
    start = np.cumsum([0, *map(len, chains)])
    return np.concatenate([*chains, np.empty(0, dtype=np.int64)]), start, sequence_chain
