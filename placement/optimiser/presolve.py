"""Presolve: leave out what does not matter, and find the way back.

That is frames, windows, runs and poses. Both kinds of fusion become one problem
here. With "any", a frame is seen if a chosen pose detects in it, and a window
needs all its frames. With "single", the frames of the reduced problem are the
statements "this pose alone has confirmed by then", and each window needs one of
them.

Where tracks live for a limited time, "a chosen pose detects in one of the
frames in which the next detection must come" is a statement about one pose at a
time, too, so that it is one more frame of the reduced problem: a *tail*. A
window whose tails are all seen is *live*. As a later window has fewer tails,
one that is not seen ends all windows of the run up to some number.

Why each rule is allowed
------------------------
Let A(S) be the runs that layout S avoids, m(S) their margins, and B what the car sees
by itself. A rule may be applied if the best value of no stage changes. Five rules
change neither A(S) nor m(S):

* Unusable poses: a pose that is forbidden, has no room, or alone exceeds the budget is
  in no layout.
* Unseen windows: a window with a frame or tail that no remaining pose sees is never
  live.
* Equal frames: what the same poses see is seen by the same S.
* Needless tails: if all who see the run's next tail see this one, it is seen whenever
  the next one is.
* Dominated windows: an earlier window that needs no more is live whenever the later
  one is.

Needless poses: pose c sees nothing that counts beyond B. Then S without c sees the
same, also after failures, and costs no more. So c may go unless it, or its site, is
forced. The cheapest needless pose stays, since one layout must remain.

Dominated poses: pose d sees all that c in S sees, costs no more, has room, and is bound
by nothing that c is not (`is_dominated`). With d in place of c, the layout avoids A(S)
and perhaps more, also after failures, with no smaller margin on A(S). If it avoids
exactly A(S), no stage gets worse. If it avoids more, and each run weighs more than 4
times the tolerance of ties, no later stage asks about S, for its APR no longer ties.
For lighter runs, and for the mean over the worst worlds, the rule is not applied.
"""

from collections.abc import Set
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from itertools import pairwise
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.tables import says

from .allowed_sets import Limits
from .constants import COST_TOLERANCE_EUR, WORKERS, share_out
from .problem import (
    Chains,
    Goal,
    Measure,
    Objective,
    PlacementProblem,
    Requirement,
    WordArray,
    objectives_in_order,
    run_of_frames,
    tails_behind,
    timely_windows_end,
)

PackedArray = WordArray | NDArray[np.uint8]
# Words transposed at a time: a line of memory or two.
_WORDS_TOGETHER = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class PresolveStatistics:
    """Sizes of the problem before and after presolve."""

    n_poses: Annotated[tuple[int, int], says("Poses: before, after.")]
    n_frames: Annotated[
        tuple[int, int],
        says(
            "Frames; after, distinct columns: those of frames, and those that hold a"
            " track until it is needed, so that there may be more."
        ),
    ]
    n_windows: Annotated[
        tuple[int, int],
        says(
            "Windows of frames that confirm: once per run before, once if they need the"
            " same frames after."
        ),
    ]
    n_runs: Annotated[
        tuple[int, int],
        says("Runs: left out if nothing avoids them or they have no weight."),
    ]

    def __str__(self) -> str:
        sizes = ((field.name[2:], getattr(self, field.name)) for field in fields(self))
        return ", ".join(
            f"{before} -> {after} {noun}" for noun, (before, after) in sizes
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReducedProblem:
    """A placement problem without what does not matter.

    Attributes
    ----------
    pose_index : (n_poses,) int
        Rows of the detection table: the way back.
    limits : Limits
        What may be mounted together, on these poses.
    run_index : (n_runs,) int
        Runs of the full problem that some pose avoids.
    measure : Measure
        The APR, of these runs, as in the full problem.
    floors : tuple of Requirement
        What must be reached in any case.
    objectives : tuple of Objective
        In the order in which sets of poses are compared.
    survive : int
        Failed units that ``Objective.APR_SURVIVED`` is about.
    n_frames : int
        Merged frames, tails among them.
    words : (n_poses, n_words) uint64
        Bits V[c, f] along the merged frames, lowest bit first.
    columns : (n_frames, ceil(n_poses / 64)) uint64
        The same bits along the poses.
    base : (n_words,) uint64
        Frames that the VUT sees, as every pose does then.
    chains : Chains
        Windows, and what keeps them alive.
    workers : int
        Threads for all that is computed with them.
    run_chain : (n_runs,) int
        Chain of every run.
    margin_s : (n_runs, longest chain + 1) float
        Margin if the first live window is the k-th of the chain; minus infinity
        from the first one that is too late for this run. [s]
    statistics : PresolveStatistics
        Sizes before and after.
    """

    pose_index: IntArray
    limits: Limits
    run_index: IntArray
    measure: Measure
    floors: tuple[Requirement, ...]
    objectives: tuple[Objective, ...]
    survive: int
    n_frames: int
    words: WordArray
    columns: WordArray
    base: WordArray
    chains: Chains
    workers: int
    run_chain: IntArray
    margin_s: FloatArray
    statistics: PresolveStatistics

    @property
    def n_poses(self) -> int:
        """Number of poses that are left."""
        return len(self.pose_index)

    @property
    def weight(self) -> FloatArray:
        """Weights of the runs, (n_runs,)."""
        return self.measure.weight

    @property
    def last(self) -> IntArray:
        """Windows of its chain that end in time for each run, (n_runs,)."""
        return np.asarray((self.margin_s > -np.inf).sum(axis=1))

    def with_workers(self, workers: int) -> "ReducedProblem":
        """Problem on so many threads."""
        if workers == self.workers:
            return self
        return replace(self, workers=workers)

    def with_goal(self, goal: Goal) -> "ReducedProblem":
        """Problem for another goal."""
        return replace(self, objectives=objectives_in_order(goal, survive=self.survive))

    def for_problem(self, problem: PlacementProblem) -> "ReducedProblem":
        """The same poses and runs for another problem on the table.

        It may differ from the one that was presolved in floors, goal and failures to be
        survived: where a pose takes the place of another one, nothing that may be asked
        gets worse. And it may allow fewer units or less money: what is dominated stays
        so.
        """
        floors = [
            Requirement(
                measure=problem.floor_measure(floor).of_runs(self.run_index),
                least=floor.share,
                n_failures=floor.n_failures,
            )
            for floor in problem.floors
        ]
        return replace(
            self,
            limits=problem.limits.of_poses(self.pose_index),
            floors=tuple(floors),
            objectives=problem.objectives,
            survive=problem.survive,
        )

    @property
    def n_chains(self) -> int:
        """Number of chains."""
        return len(self.chains.start) - 1

    @property
    def window_frames(self) -> IntArray:
        """Merged frames that each window needs, (n_windows, n_confirmations or 1)."""
        return self.chains.window_frames

    def chain(self, chain_index: int) -> IntArray:
        """Windows of a chain."""
        start = self.chains.start
        return self.chains.window[start[chain_index] : start[chain_index + 1]]

    def tails(self, chain_index: int) -> tuple[IntArray, IntArray]:
        """Frames of a chain's tails, and how many first windows each keeps alive."""
        chains = self.chains
        begin = chains.tail_start[chain_index]
        mine = slice(begin, chains.tail_start[chain_index + 1])
        return chains.tail_frame[mine], chains.tail_links[mine]

    def detected(self) -> BoolArray:
        """V[c, f] on the merged frames, (n_poses, n_frames)."""
        return unpack_words(self.words, self.n_frames)

    def __repr__(self) -> str:
        return f"ReducedProblem({self.statistics})"


def pack_words(bits: BoolArray) -> WordArray:
    """Bits along the last axis as 64-bit words, lowest bit first."""
    n_words = -(-bits.shape[-1] // 64)
    packed = np.zeros((*bits.shape[:-1], n_words * 8), dtype=np.uint8)
    packed[..., : -(-bits.shape[-1] // 8)] = np.packbits(
        bits, axis=-1, bitorder="little"
    )
    return packed.view("<u8")


def unpack_words(words: WordArray, n_bits: int) -> BoolArray:
    """Bits of 64-bit words, lowest bit first: (..., n_words) -> (..., n_bits)."""
    packed = np.ascontiguousarray(words).view(np.uint8)
    return np.unpackbits(packed, axis=-1, count=n_bits, bitorder="little").view(
        np.bool_
    )


class Rule(StrEnum):
    """Something that presolve does; ``docs/method.md`` says why each loses nothing."""

    UNUSABLE_POSES = "unusable poses"
    NEEDLESS_POSES = "needless poses"
    DOMINATED_POSES = "dominated poses"
    UNSEEN_WINDOWS = "unseen windows"
    EQUAL_FRAMES = "equal frames"
    NEEDLESS_TAILS = "needless tails"
    DOMINATED_WINDOWS = "dominated windows"


ALL_RULES = frozenset(Rule)
OF_ANY_QUESTION = ALL_RULES - {Rule.NEEDLESS_POSES, Rule.DOMINATED_POSES}
"""Rules that also hold when limits and mounted poses change after presolve."""


def presolve(
    problem: PlacementProblem,
    *,
    workers: int = WORKERS,
    rules: Set[Rule] = ALL_RULES,
) -> ReducedProblem:
    """Reduce a placement problem without changing the best value of any stage.

    Runs without weight and windows that end too late count in no value and are
    always left out. The other rules are repeated until no pose drops out:

    * Unusable poses are forbidden, stand where a site has no room, or cost more
      than the budget.
    * Needless poses, see :func:`find_needless`; unusable ones are taken to be out.
    * Dominated poses, see :func:`find_dominated_poses`; the same.
    * Unseen windows have a frame or a tail that nobody sees: they are never live.
    * Frames that the same poses see are one frame, and so are tails.
    * A tail is needless where the next one of its run is seen by no other poses.
    * A window is dominated if an earlier window of its run needs no other frames
      and no tail that it does not need, too, or ensures.

    Parameters
    ----------
    problem : PlacementProblem
        The problem.
    workers : int
        Threads.
    rules : set of Rule
        The rules that are applied; by default all.
    """
    windows = _Windows(problem, workers, rules)
    usable = np.ones(problem.table.n_poses, dtype=bool)
    if Rule.UNUSABLE_POSES in rules:
        usable = _is_usable(problem.limits)
    if Rule.NEEDLESS_POSES in rules:
        # They would drop out below, but making the problem anew takes long.
        usable[usable] = ~_is_left_out(
            ~windows.sees_any()[usable], problem.limits.of_poses(np.flatnonzero(usable))
        )
    usable |= problem.limits.is_forced
    while True:
        poses = np.flatnonzero(usable)
        reduced = windows.reduce(poses)
        is_dropped = np.zeros(len(poses), dtype=bool)
        if Rule.NEEDLESS_POSES in rules:
            is_dropped = find_needless(reduced)
        if Rule.DOMINATED_POSES in rules:
            is_dropped |= find_dominated_poses(reduced, ~is_dropped)
        if not is_dropped.any():
            columns = transposed(reduced.words, reduced.n_frames, workers=workers)
            return replace(reduced, columns=columns).for_problem(problem)
        usable[poses[is_dropped]] = False


def _is_usable(limits: Limits) -> BoolArray:
    """Poses that some layout may have, each looked at alone, (n_poses,)."""
    usable: BoolArray = limits.site_capacity[limits.site_index] > 0
    usable = usable & ~limits.is_forbidden
    if limits.budget_eur is not None:
        usable &= _prices_alone(limits) <= limits.budget_eur + COST_TOLERANCE_EUR
    return usable


def _prices_alone(limits: Limits) -> FloatArray:
    """Price of each pose with its site, (n_poses,), in euros."""
    return limits.unit_cost_eur + limits.site_cost_eur[limits.site_index]


def find_needless(reduced: ReducedProblem) -> BoolArray:
    """Needless poses that may be left out together, (n_poses,).

    A pose is needless if it sees nothing that counts but what the VUT sees as well.
    Without it, a layout avoids the same runs with the same margins, whichever units
    fail, has fewer units and costs no more. Two demands keep some of them: forced poses
    and poses at forced sites stay; and as a layout has at least one unit, the cheapest
    of the others stays for the layout that is worth what the VUT is worth alone.
    """
    return _is_left_out(~_have_bits(reduced.words, ~reduced.base), reduced.limits)


def _is_left_out(is_needless: BoolArray, limits: Limits) -> BoolArray:
    """Poses that go of those that are needless, (n_poses,)."""
    is_asked_for = limits.is_forced | limits.is_forced_site[limits.site_index]
    is_left_out = is_needless & ~is_asked_for
    candidates = np.flatnonzero(is_left_out)
    if len(candidates):
        cheapest = np.argmin(_prices_alone(limits)[candidates])
        is_left_out[candidates[cheapest]] = False
    return is_left_out


def find_dominated_poses(reduced: ReducedProblem, is_left: BoolArray) -> BoolArray:
    """Poses of those that are left that others can take the place of, (n_poses,).

    None where more may be avoided at the same APR, see
    :attr:`~placement.optimiser.problem.Measure.tells_runs_apart`: the smallest margin
    may fall when more is seen, as a run that adds nothing to the APR has its margin
    counted.
    """
    dominated = np.zeros(reduced.n_poses, dtype=bool)
    limits = reduced.limits
    if not reduced.measure.tells_runs_apart or limits.max_units < 1:
        return dominated
    left = np.flatnonzero(is_left)
    words = reduced.words
    if not is_left.all():
        words = words[left]
    dominated[left] = is_dominated(
        words,
        limits.of_poses(left),
        max_units=limits.max_units,
        workers=reduced.workers,
    )
    return dominated


def presolve_freely(problem: PlacementProblem) -> ReducedProblem:
    """A problem reduced for whatever limits, floors, goals and mounted poses come up.

    All poses stay: where only the worst worlds count, or where a unit must be added,
    one that detects nothing may be the best.
    """
    limits = problem.limits
    free = Limits(
        site_index=limits.site_index,
        # Where every site carries any number of units, no pose stands in another one's
        # way.
        site_capacity=np.full(limits.n_sites, limits.n_poses),
        unit_cost_eur=limits.unit_cost_eur,
        site_cost_eur=limits.site_cost_eur,
        is_forced=limits.is_forced,
        is_forced_site=limits.is_forced_site,
    )
    asked = replace(problem, limits=free, floors=(), goal="best", survive=0)
    return presolve(asked, rules=OF_ANY_QUESTION)


def is_dominated(
    words: WordArray, limits: Limits, *, max_units: int, workers: int = WORKERS
) -> BoolArray:
    """Poses without which some best set remains, whatever the stage, (n_poses,).

    They may be dropped all together. All poses are usable, and each run more that
    is avoided is worth more than a tie.

    Parameters
    ----------
    words : (n_poses, n_words) uint64
        What each pose sees.
    limits : Limits
        What may be mounted together.
    max_units : int
        No set has more units: K below.
    workers : int
        Threads.

    Notes
    -----
    Pose d dominates pose c if it sees all that c sees, costs no more and is bound
    by nothing that c is not: at the same site its price decides; elsewhere its site
    may have to be paid, too, and neither site may have rivals, be asked for, or
    fail with more than one unit. Among equal poses the earlier one dominates. Every
    stage is monotone in what each unit sees: where d can take the place of c, no
    value gets worse. So c may go if in every feasible set S with c one of its
    dominators is outside S and finds room. Who wants to prevent that has the other
    K - 1 units of S to

    * fill a site, or choose all the dominators that stand there: min(capacity,
      dominators) units at least;
    * at the site of c, which has room once c is gone: choose all dominators there,
      next to c; this fails if there are as many of them as the site's capacity.

    If that takes more than K - 1 units, c may go. Dominators that are dropped
    themselves count: the replacement is replaced in turn, each time by a pose
    earlier in one fixed order (more seen, cheaper, index), which ends.
    """
    from .bit_kernels import find_dominated

    count = np.bitwise_count(words).sum(axis=1, dtype=np.int64)
    order = np.lexsort((limits.unit_cost_eur, -count))
    sites = limits.site_index[order]
    price = limits.unit_cost_eur[order]
    is_bound_site = limits.is_forced_site.copy()
    is_bound_site[limits.rivals.ravel()] = True
    # Elsewhere, a pose would fail together with what else stands there.
    if limits.failing == "site":
        is_bound_site |= limits.site_capacity > 1
    elsewhere = price + limits.site_cost_eur[sites]
    elsewhere[is_bound_site[sites]] = np.inf
    in_order = words[order]
    may_move = ~is_bound_site[sites]
    dominated = np.zeros(len(words), dtype=bool)
    result = np.zeros(len(words), dtype=bool)

    def look(begin: int) -> None:
        find_dominated(
            in_order,
            sites,
            price,
            elsewhere,
            may_move,
            limits.site_capacity,
            max_units,
            begin,
            workers,
            dominated,
        )

    with ThreadPoolExecutor(workers) as threads:
        list(threads.map(look, range(workers)))
    result[order] = dominated
    return result & ~limits.is_forced


class _Windows:
    """Windows of a problem that end in time, and their tails, over the poses.

    Attributes
    ----------
    end, run, margin_s : (n_windows,)
        Last frame, run and margin of each window. [s]
    frames : (n_windows, n_confirmations or 1) int
        Rows of `columns` that each window needs.
    tail_end, tail_run : (n_tails,) int
        Frame behind which each tail is needed, and its run.
    n_used : int
        Rows of `columns` that are frames; those behind them are tails.
    n_bits : int
        Poses, and the VUT behind them if it sees.
    columns : (n_used + n_tails, n_words) uint64
        Who sees each frame, and each tail.
    is_base : (n_used + n_tails,) bool
        What the VUT sees.
    """

    def __init__(
        self, problem: PlacementProblem, workers: int, rules: Set[Rule]
    ) -> None:
        from .bit_kernels import join_ranges

        self.problem = problem
        self.workers = workers
        self.rules = rules
        self.measure = problem.measure()
        axis = problem.table.axis
        rule = problem.rule
        self.end, self.run, self.margin_s = timely_windows_end(axis, rule)
        frames = self.end[:, None] + np.arange(1 - rule.n_confirmations, 1)
        used, self.frames = np.unique(frames, return_inverse=True)
        self.tail_end, last = tails_behind(axis, rule, self.end, self.run)
        self.tail_run = run_of_frames(axis)[self.tail_end]
        packed = problem.table.packed
        # (n_used + n_tails, n_words): who sees each frame, and each tail; the VUT
        # behind all poses
        seen_by_vut = problem.seen_by_vut
        n_bits = len(packed)
        if seen_by_vut is not None:
            vut = np.packbits(seen_by_vut, bitorder="little")
            packed = np.vstack([packed, vut])
            n_bits = n_bits + 1
        self.columns = np.empty(
            (len(used) + len(last), -(-n_bits // 64)), dtype=np.uint64
        )
        self.n_used = len(used)
        self.n_bits = n_bits
        transpose_chosen(packed, np.arange(n_bits), used, self.columns, workers)
        # Those between frames that are used are used.
        begin = np.searchsorted(used, self.tail_end, side="right")
        end = np.searchsorted(used, last, side="right")

        def join(one: int, other: int) -> None:
            part = slice(one, other)
            tails = self.columns[self.n_used :]
            join_ranges(self.columns, begin[part], end[part], tails[part])

        share_out(join, len(last), workers=workers)
        if problem.fusion == "single":
            self._let_each_confirm_alone()
        self.is_base = np.zeros(len(self.columns), dtype=bool)
        # What the VUT sees, it sees next to every pose.
        if seen_by_vut is not None:
            of_vut = self._mask(np.empty(0, dtype=np.int64))
            self.is_base = _have_bits(self.columns, of_vut)
            self.columns[self.is_base] = pack_words(np.ones(n_bits, dtype=bool))

    def _mask(self, poses: IntArray) -> WordArray:
        """Bits of some poses, and of the VUT if it sees, (n_words,)."""
        is_in = np.zeros(64 * self.columns.shape[1], dtype=bool)
        is_in[poses] = True
        is_in[self.problem.table.n_poses : self.n_bits] = True
        return pack_words(is_in)

    def _let_each_confirm_alone(self) -> None:
        """Let each window state that a pose alone has a live one up to its end."""
        tail_columns = self.columns[self.n_used :]
        self.columns = np.bitwise_and.reduce(self.columns[self.frames], axis=1)
        self.frames = np.arange(len(self.end))[:, None]
        self.n_used = len(self.end)
        for run in np.unique(self.run):
            begin, end = np.searchsorted(self.run, [run, run + 1])
            windows = self.columns[begin:end]
            begin, end = np.searchsorted(self.tail_run, [run, run + 1])
            tails = tail_columns[begin:end]
            # The first windows of a run have tails, one behind the last frame of each.
            from_here_on = np.bitwise_and.accumulate(tails[::-1], axis=0)[::-1]
            windows[: len(tails)] &= from_here_on
            np.bitwise_or.accumulate(windows, axis=0, out=windows)
        self.tail_end = self.tail_end[:0]
        self.tail_run = self.tail_run[:0]

    def sees_any(self) -> BoolArray:
        """Which poses see anything that matters, (n_poses,)."""
        columns = self.columns
        if self.is_base.any():
            columns = columns[~self.is_base]
        words = np.bitwise_or.reduce(columns, axis=0)
        return unpack_words(words, self.problem.table.n_poses)

    def reduce(self, poses: IntArray) -> ReducedProblem:
        """The problem on some poses, all of them kept."""
        from .bit_kernels import thin_out

        problem = self.problem
        axis = problem.table.axis
        # Frames and tails that the same poses see are one.
        mask = self._mask(poses)
        if Rule.EQUAL_FRAMES in self.rules:
            first, frame = distinct_rows(self.columns, mask)
        else:
            first = frame = np.arange(len(self.columns))
        frames = frame[: self.n_used][self.frames]
        tail_frame = frame[self.n_used :]
        is_seen = _have_bits(self.columns, mask)[first]

        # Windows that may be live, and tails that say something about them.
        last_lost = np.full(axis.n_runs, -1)
        alive = np.ones(len(self.end), dtype=bool)
        if Rule.UNSEEN_WINDOWS in self.rules:
            is_lost = ~is_seen[tail_frame]
            np.maximum.at(last_lost, self.tail_run[is_lost], self.tail_end[is_lost])
            alive = is_seen[frames].all(axis=1) & (self.end > last_lost[self.run])
        needed = self.tail_end > last_lost[self.tail_run]
        if Rule.NEEDLESS_TAILS in self.rules:
            needed &= ~self._is_needless(mask)
        needed &= np.isin(self.tail_run, self.run[alive])
        windows = np.flatnonzero(alive)
        tails = np.flatnonzero(needed)
        end = self.end[windows]
        tail_frame = tail_frame[tails]
        run_index, of_run = np.unique(self.run[windows], return_inverse=True)
        of_tail = np.searchsorted(run_index, self.tail_run[tails])
        begin = np.searchsorted(of_run, np.arange(len(run_index) + 1))
        sets = _as_sets(frames[windows])
        # Frames grow from run to run: so do the ends of windows.
        n_before = np.searchsorted(end, self.tail_end[tails], side="right")
        n_links = n_before - begin[of_tail]
        is_kept = np.ones(len(sets), dtype=bool)
        if Rule.DOMINATED_WINDOWS in self.rules:
            tail_begin = np.searchsorted(of_tail, np.arange(len(run_index) + 1))
            thin_out(sets, begin, tail_frame, tail_begin, n_links, is_kept)
        windows = windows[is_kept]
        sets = sets[is_kept]
        of_run = of_run[is_kept]
        order = _once_in_each_run(of_tail, tail_frame, n_links)
        tail_frame = tail_frame[order]
        n_links = n_links[order]
        of_tail = of_tail[order]

        # Windows of the same frames are one; frames that nothing needs are left out.
        first_set, window = distinct_rows(sets.astype(np.uint64))
        is_needed = np.zeros(len(first), dtype=bool)
        is_needed[sets] = True
        is_needed[tail_frame] = True
        kept = np.flatnonzero(is_needed)
        words = np.empty((len(poses), -(-len(kept) // 64)), dtype=np.uint64)
        transpose_chosen(self.columns, first[kept], poses, words, self.workers)
        # Windows and tails, run by run, as chains.
        begin = np.searchsorted(of_run, np.arange(len(run_index) + 1))
        tail_begin = np.searchsorted(of_tail, np.arange(len(run_index) + 1))
        tail_frame = np.searchsorted(kept, tail_frame)
        windows_of_runs = [window[one:end] for one, end in pairwise(begin)]
        tails_of_runs = [
            (tail_frame[one:end], n_links[one:end]) for one, end in pairwise(tail_begin)
        ]
        chains, run_chain = _share_chains(
            np.searchsorted(kept, sets[first_set]), windows_of_runs, tails_of_runs
        )
        longest = np.diff(begin).max(initial=0)
        margin_s = np.full((len(run_index), longest + 1), -np.inf)
        place = np.arange(len(windows)) - begin[of_run]
        margin_s[of_run, place] = self.margin_s[windows]
        # Windows before presolve, in time or not.
        n_whole = np.diff(axis.run_start) + 1 - problem.rule.n_confirmations
        return ReducedProblem(
            pose_index=poses,
            limits=problem.limits.of_poses(poses),
            run_index=run_index,
            measure=self.measure.of_runs(run_index),
            floors=(),
            objectives=problem.objectives,
            survive=problem.survive,
            n_frames=len(kept),
            words=words,
            columns=words[:0],
            base=pack_words(self.is_base[first[kept]]),
            chains=chains,
            workers=self.workers,
            run_chain=run_chain,
            margin_s=margin_s,
            statistics=PresolveStatistics(
                n_poses=(problem.table.n_poses, len(poses)),
                n_frames=(axis.n_frames, len(kept)),
                n_windows=(int(np.maximum(n_whole, 0).sum()), len(first_set)),
                n_runs=(axis.n_runs, len(run_index)),
            ),
        )

    def _is_needless(self, mask: WordArray) -> BoolArray:
        """Tails that are seen whenever the next one of their run is, (n_tails,).

        The next one ends more windows, so that these tails say nothing.
        """
        tails = self.columns[self.n_used :]
        is_needless = np.zeros(len(self.tail_run), dtype=bool)
        is_needless[:-1] = ~_have_bits(tails[1:] & ~tails[:-1], mask)
        is_needless[:-1] &= self.tail_run[1:] == self.tail_run[:-1]
        return is_needless


def distinct_rows(
    rows: WordArray, mask: WordArray | None = None
) -> tuple[IntArray, IntArray]:
    """First of the rows that are equal within a mask, and the number of each row.

    Parameters
    ----------
    rows : (n_rows, n_words) uint64
        Rows of bits.
    mask : (n_words,) uint64, optional
        Bits that count; by default all.

    Returns
    -------
    first : (n_distinct,) int
        Rows that are the first of their kind.
    number : (n_rows,) int
        Place in `first` of the row that each one is equal to.
    """
    if mask is None:
        every = np.full(rows.shape[1], ~np.uint64(0))
    else:
        every = mask
    known: dict[bytes, int] = {}
    numbers = [known.setdefault((row & every).tobytes(), len(known)) for row in rows]
    number = np.array(numbers, dtype=np.int64)
    return np.unique(number, return_index=True)[1], number


def _have_bits(rows: WordArray, mask: WordArray) -> BoolArray:
    """Which rows have any bit within a mask, (n_words,)."""
    return np.asarray((rows & mask).any(axis=1))


def transpose_chosen(
    rows: PackedArray,
    chosen: IntArray,
    bits: IntArray,
    columns: WordArray,
    workers: int,
) -> None:
    """Write some bits of chosen rows to the first rows of `columns`.

    Parameters
    ----------
    rows : (n_rows, n_words) uint64, or (n_rows, n_bytes) uint8
        Rows of bits, lowest bit first.
    chosen : (n,) int
        Rows that are transposed.
    bits : (n_bits,) int
        Bits that become rows of `columns`, in this order.
    columns : (at least n_bits, n_words) uint64
        Written: bits along the chosen rows.
    workers : int
        Threads.
    """
    row_bytes = np.ascontiguousarray(rows).view(np.uint8)
    n_bytes = row_bytes.shape[1]
    n_row_words = -(-n_bytes // 8)

    def transpose(begin: int, end: int) -> None:
        for first in range(begin, end, _WORDS_TOGETHER):
            last = min(first + _WORDS_TOGETHER, end)
            n_words = last - first
            some = chosen[64 * first : 64 * last]
            # Behind the last row: no bit of it is set.
            padded = np.zeros((64 * n_words, n_row_words), dtype=np.uint64)
            padded.view(np.uint8)[: len(some), :n_bytes] = row_bytes[some]
            in_blocks = padded.reshape(n_words, 64, n_row_words)
            blocks = np.ascontiguousarray(in_blocks.transpose(1, 2, 0))
            _transpose_blocks(blocks)
            turned = blocks.transpose(1, 0, 2).reshape(64 * n_row_words, n_words)
            columns[: len(bits), first:last] = turned[bits]

    share_out(transpose, columns.shape[1], workers=workers, few=workers)


def _transpose_blocks(blocks: WordArray) -> None:
    """Exchange rows and bits of each block of 64 words, (64, ...).

    A block is transposed by exchanging its quarters, then theirs, down to single bits
    (Warren, Hacker's Delight, 7-3).
    """
    width = 32
    mask = np.uint64(0x00000000FFFFFFFF)
    while width:
        shift = np.uint64(width)
        quarters = blocks.reshape(32 // width, 2, width, *blocks.shape[1:])
        upper = quarters[:, 0]
        lower = quarters[:, 1]
        swapped = ((upper >> shift) ^ lower) & mask
        upper ^= swapped << shift
        lower ^= swapped
        width >>= 1
        mask ^= mask << np.uint64(width)


def transposed(words: WordArray, n_bits: int, *, workers: int) -> WordArray:
    """First bits of all rows as rows of their own, (n_bits, ceil(n_rows / 64))."""
    columns = np.empty((n_bits, -(-len(words) // 64)), dtype=np.uint64)
    transpose_chosen(words, np.arange(len(words)), np.arange(n_bits), columns, workers)
    return columns


def _as_sets(frames: IntArray) -> IntArray:
    """Rows sorted, the repeated entries last: equal as sets if and only if equal."""
    frames = np.sort(frames, axis=1)
    repeated = np.zeros(frames.shape, dtype=bool)
    repeated[:, 1:] = frames[:, 1:] == frames[:, :-1]
    return np.sort(np.where(repeated, frames[:, -1:], frames), axis=1)


def _once_in_each_run(
    of_tail: IntArray, tail_frame: IntArray, n_links: IntArray
) -> IntArray:
    """Order of tails run by run, those that more windows need first.

    Each frame comes once in a run; tails that no window needs are left out.
    """
    order = np.lexsort((tail_frame, -n_links, of_tail))
    order = order[n_links[order] > 0]
    key = of_tail[order] * (tail_frame.max(initial=0) + 1) + tail_frame[order]
    _, first = np.unique(key, return_index=True)
    return order[np.sort(first)]


def _share_chains(
    window_frames: IntArray,
    sequences: list[IntArray],
    tails: list[tuple[IntArray, IntArray]],
) -> tuple[Chains, IntArray]:
    """Chains that every sequence with its tails is the beginning of; chain of each.

    Parameters
    ----------
    window_frames : (n_windows, n_frames) int
        Frames of each window.
    sequences : list of (n,) int
        Windows of each run in the order of time.
    tails : list of ((n,) int, (n,) int)
        Frames of each run's tails, and how many windows need each.

    Returns
    -------
    chains : Chains
        As few as possible.
    sequence_chain : (n_runs,) int
        Chain of each run.
    """
    keys = [
        (frames.tolist(), n_links.tolist(), row.tolist())
        for row, (frames, n_links) in zip(sequences, tails, strict=True)
    ]
    chains = list[int]()
    sequence_chain = np.zeros(len(sequences), dtype=np.int64)
    # In alphabetical order what begins like a sequence comes right behind it.
    for index in sorted(range(len(keys)), key=keys.__getitem__, reverse=True):
        frames, n_links, row = keys[index]
        if chains:
            above = keys[chains[-1]]
        else:
            above = ([], [], [])
        if not chains or (frames, n_links, row) != (*above[:2], above[2][: len(row)]):
            chains.append(index)
        sequence_chain[index] = len(chains) - 1
    none = np.empty(0, dtype=np.int64)
    return (
        Chains(
            window_frames=window_frames,
            window=np.concatenate([none, *(sequences[index] for index in chains)]),
            start=np.cumsum([0, *(len(sequences[index]) for index in chains)]),
            tail_frame=np.concatenate([none, *(tails[index][0] for index in chains)]),
            tail_links=np.concatenate([none, *(tails[index][1] for index in chains)]),
            tail_start=np.cumsum([0, *(len(tails[index][0]) for index in chains)]),
        ),
        sequence_chain,
    )
