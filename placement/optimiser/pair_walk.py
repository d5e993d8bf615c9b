"""All sets of two or three units that reach a need: a class of poses, and pairs beside it.

Where detections flicker, that a pose sees the frame which a window is asked for says little: hardly
any run is out of reach of a pose (:mod:`placement.optimiser.cover_tree`). It says much more when
another unit is known, since what that one sees is not asked for any more. So

* poses of a site that avoid much the same runs are a *class*, as good as all of them together;
* classes are gone through, each with those behind it. Beside each, the other classes are laid out
  by the runs that they avoid with it, and by those where they may be of use
  (:mod:`placement.optimiser.pair_kernels`): first by the runs alone where most is likely to be
  lost, which tell of most pairs that they lose too much, and which bound all sets that begin with
  the class;
* the class that promises most comes first, so that what was not looked at promises less and less.
  Of its pairs that are left, the poses are laid out, and then beside each of the class's own.

A walk that ends has met every set that reaches the need.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s

from .presolve import Detections, ReducedProblem, unpack_words
from .problem import Chains, WordArray
from .set_tree import Links, avoided_runs, build_rows, weigh
from .threads import WORKERS, share_out
from .tolerances import ROUNDING

MAX_UNITS = 3
_CLASS_POSES = 12  # of a class, on average
_MAX_TOGETHER = 2000  # poses whose likeness is looked at in one go
_OUT_PAIRS = 1 << 14
_FEW_PAIRS = 200  # to be valued beside a class
_TOGETHER = 16  # poses: what they all miss is likely to be lost beside a class, by two more, too
_MANY_WORDS = 16  # of which few are worth to be put side by side
_HARD_ROWS = (256, 512)  # that are looked at first, and then

_T = TypeVar("_T")


class PairWalk:
    """A walk through all sets of two or three units whose weighted runs reach `need`.

    Sites' capacities hold; other limits do not count.
    """

    def __init__(
        self,
        reduced: ReducedProblem,
        links: Links,
        weight: FloatArray,
        *,
        n_units: int,
        need: float,
    ) -> None:
        if not 2 <= n_units <= MAX_UNITS:
            raise ValueError(f"n_units: got {n_units}; expected 2 .. {MAX_UNITS}")
        limits = reduced.limits
        self.limits, self.n_units = limits, n_units
        self.total = float(weight.sum())
        self.need = need
        self.is_finished = False  # whether all sets were gone through
        usable = np.flatnonzero(
            ~limits.is_forbidden & (limits.site_capacity > 0)[limits.site_index]
        )
        self.runs = _Counted(links, weight, usable, in_order=n_units > 2)
        once = np.ones(reduced.n_poses, dtype=np.int64)
        detections = self.runs.rows.detections
        self.poses = self.runs.units(detections.words, detections.columns, limits.site_index, once)
        self.usable = usable
        self.classes = _Classes(self.runs, self.poses, usable, weight) if n_units > 2 else None
        # Of classes: what no set reaches that begins there; infinite: not known yet.
        n_classes = 0 if self.classes is None else len(self.classes.units.site)
        self.promise = np.full(n_classes, np.inf)
        # And the least need for which all sets were met that begin there; infinite: none yet.
        self.met = np.full(n_classes, np.inf)
        self.left_limit = self.total  # no set that was not met is worth more

    @property
    def root_limit(self) -> float:
        """No set is worth more, as far as this is known without a walk."""
        return self.total

    def again(self, need: float) -> "PairWalk":
        """The same walk from its beginning for another need."""
        walk = copy(self)
        walk.met = np.full_like(self.met, np.inf)
        walk.go_on(need)
        return walk

    def go_on(self, need: float) -> None:
        """Walk for another need, but leave out what was met for that or less."""
        self.need, self.is_finished = need, False

    def raise_needs(self, need: float, left: float = 0.0) -> None:
        """Ask for more from here on; nothing is asked of what is `left` when units fail."""
        self.need = max(self.need, need)

    @property
    def may_lose(self) -> float:
        """Weight of runs that a set may lose."""
        return self.total - self.need + ROUNDING * max(self.total, 1.0)

    def blocks(self, end_s: float) -> Iterator[IntArray]:
        """Sets that reach the need, many at a time, until `end_s` of `geometry.clock`.

        An empty block says that nothing was found for a while. The order is left to chance.
        """
        if self.n_units == 2:  # it takes less than to look for what can be left out
            found = self._all_pairs()
            self._look_at_left(np.empty(0))
            yield found
            return
        nothing = np.empty((0, self.n_units), dtype=np.int64)
        unknown = np.flatnonzero(np.isposinf(self.promise)).tolist()
        for place, limit in _in_threads(self._promise_of, unknown, end_s):
            self.promise[place] = limit
            yield nothing
        limits = np.minimum(self.promise, self.total)
        most_first = np.argsort(-limits, kind="stable")
        places = most_first[limits[most_first] >= self.total - self.may_lose]
        places = places[self.met[places] > self.need]
        is_left = np.isin(np.arange(len(limits)), places)
        self._look_at_left(limits[is_left])
        for place, (need, sets) in _in_threads(self._beside_class, places.tolist(), end_s):
            self.met[place], is_left[place] = need, False
            self._look_at_left(limits[is_left])
            yield sets

    def _look_at_left(self, limits: FloatArray) -> None:
        """Take down what those that were not looked at promise, (n,)."""
        self.is_finished = len(limits) == 0
        self.left_limit = min(max(self.need, float(limits.max(initial=0.0))), self.total)

    def _all_pairs(self) -> IntArray:
        """All pairs that reach the need."""
        pairs = _Beside(self, None).pairs(self.poses, self.usable)
        return self.runs.keep(pairs, self.may_lose)

    def _promise_of(self, place: int) -> float:
        """No set of a class and those behind it reaches more."""
        assert self.classes is not None
        units, together = self.classes.units, float(self.classes.together[place])
        if self.total - together > self.may_lose:
            return together
        behind = np.arange(place, len(units.site))
        return self.total - _Beside(self, units, place).least_lost(units, behind)

    def _beside_class(self, place: int) -> tuple[float, IntArray]:
        """The need, and sets of a class and those behind it that reach it."""
        classes, limits = self.classes, self.limits
        assert classes is not None
        behind = np.arange(place, len(classes.units.site))
        beside, members = _Beside(self, classes.units, place), classes.members(place)
        found = beside.pairs_within(classes, beside.pairs(classes.units, behind))
        if len(found) > _FEW_PAIRS:  # the class promises too much: its poses one by one
            parts = []
            for member in members.tolist():
                left = _Beside(self, self.poses, member).thin(self.poses, found)
                parts.append(np.column_stack([np.full(len(left), member), left]))
            sets = np.concatenate(parts)
        else:
            sets = np.column_stack(
                [np.repeat(members, len(found)), np.tile(found, (len(members), 1))]
            )
        # Two or three of the class itself: once, in ascending order.
        is_later = (classes.class_of[sets[:, 1:]] != place) | (sets[:, 1:] > sets[:, :1])
        sets = sets[is_later.all(axis=1)]
        sites = limits.site_index[sets]
        n_beside = (sites[:, :, None] == sites[:, None, :]).sum(axis=2)
        sets = sets[(n_beside <= limits.site_capacity[sites]).all(axis=1)]
        sets = self.runs.keep(sets, self.may_lose)
        return self.need, sets  # it may have been raised meanwhile


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Units:
    """Poses, or classes of poses."""

    words: WordArray  # (n, n_frame_words): what each sees, as bits along the frames
    columns: WordArray  # (n_frames, n_words): the same as bits along the units
    site: IntArray  # (n,)
    copies: IntArray  # (n,): how many poses each one stands for: two of them are a pair, too
    avoids: WordArray  # (n, n_row_words): rows that each avoids by itself


class _Beside:
    """What stands before the last two units, if anything, and the runs that it leaves open."""

    def __init__(self, owner: PairWalk, units: _Units | None, which: int = 0) -> None:
        self.owner, every = owner, owner.runs.rows.every
        self.room = owner.limits.site_capacity.copy()
        self.union, self.open_rows = np.zeros_like(owner.poses.words[0]), every
        if units is not None:
            self.union, self.open_rows = units.words[which], every & ~units.avoids[which]
            self.room[units.site[which]] -= 1
        self.parts = _hardest_first(self.open_rows)

    def pairs(self, units: _Units, some: IntArray) -> IntArray:
        """Pairs of some poses, or classes, that may lose little beside, (n, 2)."""
        from .pair_kernels import find_pairs

        owner = self.owner
        part, may_lose = self.parts[0], owner.may_lose
        open_rows, table = self.open_rows[part], owner.runs.table_of(part)
        self.hardest = self._cover(units, some, part)
        alone, may, some_of = (bits[some] for bits in self.hardest)
        site, copies = units.site[some], units.copies[some]
        gain = weigh(may, table)
        need = float(weigh(open_rows[None, :], table)[0]) - may_lose
        has_room = self.room[site] > 0
        most = float(gain[has_room].max(initial=0.0))
        kept = np.flatnonzero(has_room & (gain + most >= need))
        kept = kept[np.argsort(-gain[kept], kind="stable")]
        found, lost = [np.empty((0, 2), dtype=np.int64)], [np.empty(0)]
        next_pair = np.zeros(2, dtype=np.int64)
        while next_pair[0] < len(kept):
            out, of_out = np.empty((_OUT_PAIRS, 2), dtype=np.int64), np.empty(_OUT_PAIRS)
            n_found = find_pairs(
                alone[kept],
                may[kept],
                some_of[kept],
                open_rows,
                table,
                gain[kept],
                need,
                may_lose,
                site[kept],
                self.room,
                copies[kept],
                next_pair,
                out,
                of_out,
            )
            found.append(kept[out[:n_found]])
            lost.append(of_out[:n_found])
        pairs = some[np.concatenate(found)]
        return pairs[self._may_lose_little(units, pairs, np.concatenate(lost), self.parts[1:])]

    def pairs_within(self, classes: "_Classes", pairs: IntArray) -> IntArray:
        """Pairs of poses of classes, (n, 2), that may lose little beside.

        `pairs` of classes are those that were found last.
        """
        from .pair_kernels import find_pairs_within

        if not len(pairs):
            return pairs
        poses, part, may_lose = self.owner.poses, self.parts[0], self.owner.may_lose
        is_used = np.isin(classes.class_of, pairs)
        of_poses = self._cover(poses, np.flatnonzero(is_used), part)
        most = int(classes.size[pairs].prod(axis=1).max())
        found, lost, begin = [], [], 0
        while begin < len(pairs):
            out = np.empty((_OUT_PAIRS + most, 2), dtype=np.int64)
            of_out = np.empty(len(out))
            begin, n_found = find_pairs_within(
                *self.hardest,
                *of_poses,
                self.open_rows[part],
                self.owner.runs.table_of(part),
                may_lose,
                pairs,
                classes.start,
                classes.size,
                classes.member,
                begin,
                out,
                of_out,
            )
            found.append(out[:n_found])
            lost.append(of_out[:n_found])
        pairs = np.concatenate(found)
        return pairs[self._may_lose_little(poses, pairs, np.concatenate(lost), self.parts[1:])]

    def least_lost(self, units: _Units, some: IntArray) -> float:
        """No pair of some classes loses less of the hardest runs beside."""
        from .pair_kernels import find_least_lost

        part = self.parts[0]
        open_rows, table = self.open_rows[part], self.owner.runs.table_of(part)
        alone, may, some_of = (bits[some] for bits in self._cover(units, some, part))
        site = units.site[some]
        gain = np.where(self.room[site] > 0, weigh(may, table), -np.inf)
        order = np.argsort(-gain, kind="stable")[: np.count_nonzero(gain > -np.inf)]
        return find_least_lost(
            alone[order],
            may[order],
            some_of[order],
            open_rows,
            table,
            gain[order],
            float(weigh(open_rows[None, :], table)[0]),
            site[order],
            self.room,
            units.copies[some[order]],
        )

    def thin(self, units: _Units, pairs: IntArray) -> IntArray:
        """Pairs of poses, or classes, (n, 2), that may lose little beside."""
        return pairs[self._may_lose_little(units, pairs, np.zeros(len(pairs)), self.parts)]

    def _may_lose_little(
        self, units: _Units, pairs: IntArray, lost: FloatArray, parts: list[slice]
    ) -> BoolArray:
        """Which pairs, (n, 2), may lose little beside that have `lost`, (n,), in other parts.

        The more runs are looked at, the fewer pairs are left to be laid out for the others.
        """
        from .pair_kernels import add_lost

        may_lose, lost = self.owner.may_lose, lost.copy()
        left = np.flatnonzero(lost <= may_lose)
        for part in parts:
            if not len(left):
                break
            is_used, of_left = np.zeros(len(units.words), dtype=bool), lost[left]
            is_used[pairs[left]] = True
            add_lost(
                *self._cover(units, np.flatnonzero(is_used), part),
                self.open_rows[part],
                self.owner.runs.table_of(part),
                may_lose,
                pairs[left],
                of_left,
            )
            lost[left] = of_left
            left = left[of_left <= may_lose]
        may: BoolArray = lost <= may_lose
        return may

    def _cover(
        self, units: _Units, some: IntArray, part: slice
    ) -> tuple[WordArray, WordArray, WordArray]:
        """Open rows of a part as ``pair_kernels.cover_beside`` finds them: alone, may, part.

        Rows of all units are there, but are filled for some alone, (64 n_words, n_row_words).
        """
        from .pair_kernels import turn_some

        counted, words = self.owner.runs, units.columns.shape[1]
        n_row_words = part.stop - part.start

        def empty(n_words: int) -> tuple[WordArray, WordArray, WordArray]:
            shape = 64 * n_words, n_row_words
            return (
                np.empty(shape, np.uint64),
                np.empty(shape, np.uint64),
                np.empty(shape, np.uint64),
            )

        bits = empty(words)
        if 2 * len(some) > len(units.words) or words < _MANY_WORDS:
            counted.rows.cover(units.columns, self.union, self.open_rows, part, bits)
            return bits
        # Few poses are put side by side.
        begin, end = counted.frame_words(part)
        columns = np.empty((64 * (end - begin), -(-len(some) // 64)), dtype=np.uint64)
        turn_some(units.words, some, begin, columns)
        of_some = empty(columns.shape[1])
        counted.rows.cover(columns, self.union, self.open_rows, part, of_some, frame_0=64 * begin)
        for of_all, few in zip(bits, of_some, strict=True):
            of_all[some] = few[: len(some)]
        return bits


def _in_threads(
    work: Callable[[int], _T], tasks: Iterable[int], end_s: float
) -> Iterator[tuple[int, _T]]:
    """Tasks and what came of them, in the order in which they end, until `end_s`."""
    left, waiting = iter(tasks), dict[Future[_T], int]()
    with ThreadPoolExecutor(WORKERS) as threads:
        while now_s() < end_s:
            while len(waiting) < 2 * WORKERS and (task := next(left, None)) is not None:
                waiting[threads.submit(work, task)] = task
            if not waiting:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                yield waiting.pop(future), future.result()
        for future in waiting:
            future.cancel()


class _Counted:
    """Runs that weigh anything: those come first in which sets are likely to lose most."""

    def __init__(
        self, links: Links, weight: FloatArray, poses: IntArray, *, in_order: bool
    ) -> None:
        runs, columns = np.flatnonzero(weight > 0.0), links.detections.columns
        rows, nothing = build_rows(links, runs), np.zeros_like(links.detections.words[0])
        avoided = rows.avoided_with(columns, nothing, rows.every)[poses]
        share = unpack_words(avoided, len(runs)).sum(axis=0) / max(1, len(poses))
        lost = weight[runs] * (1.0 - share) ** _TOGETHER
        runs = runs[np.argsort(-lost, kind="stable")]
        self.links = _in_order(links, runs) if in_order else links
        self.rows, self.weight = build_rows(self.links, runs), weight[runs]
        self.first_frame, self.last_frame = _ends(self.links.detections.chains)
        self.table = self.rows.table(weight)
        worth = links.chain_worth(weight)
        self.lost = worth[:, :1] - worth
        chains, first = np.unique(links.run_chain[runs], return_index=True)
        self.chains: IntArray = chains[np.argsort(first)]

    def units(
        self, words: WordArray, columns: WordArray, site: IntArray, copies: IntArray
    ) -> _Units:
        """Poses, or classes, with the rows that each of them avoids by itself."""
        avoids = self.rows.avoided_with(columns, np.zeros_like(words[0]), self.rows.every)
        return _Units(
            words=words, columns=columns, site=site, copies=copies, avoids=avoids[: len(words)]
        )

    def frame_words(self, part: slice) -> tuple[int, int]:
        """First and last word, and one more, of the frames that rows of a part are about."""
        rows = slice(64 * part.start, 64 * part.stop)
        chains = self.rows.chain[rows][self.rows.run[rows] >= 0]
        first, last = self.first_frame[chains].min(), self.last_frame[chains].max()
        return int(first) >> 6, (int(last) >> 6) + 1

    def table_of(self, part: slice) -> FloatArray:
        """What bytes of the words of a part are worth, (8 n_words, 256)."""
        return self.table[8 * part.start : 8 * part.stop]

    def keep(self, sets: IntArray, may_lose: float) -> IntArray:
        """Sets that lose no more than so much."""
        from .pair_kernels import keep_sets

        kept = np.zeros(len(sets), dtype=bool)
        detections = self.rows.detections
        keep_sets(detections.words, detections.chains, self.chains, self.lost, sets, may_lose, kept)
        return sets[kept]


class _Classes:
    """Poses that are looked at together first, see :class:`PairWalk`: the best classes first."""

    def __init__(
        self, runs: _Counted, poses: _Units, usable: IntArray, run_weight: FloatArray
    ) -> None:
        from .frame_kernels import first_live_windows

        weight = runs.weight
        class_of, n_classes = np.full(len(poses.site), -1), 0
        value = np.zeros(len(poses.site))
        for site in np.unique(poses.site[usable]):
            here = usable[poses.site[usable] == site]
            for alike in np.array_split(here, -(-len(here) // _MAX_TOGETHER)):
                avoided = unpack_words(poses.avoids[alike], len(weight)).astype(np.float64)
                value[alike] = avoided @ weight
                number = _alike(avoided * np.sqrt(weight))
                class_of[alike] = n_classes + number
                n_classes += int(number.max()) + 1
        most = np.zeros(n_classes)
        np.maximum.at(most, class_of[usable], value[usable])
        place = np.empty(n_classes, dtype=np.int64)
        place[np.argsort(-most, kind="stable")] = np.arange(n_classes)
        self.class_of = np.where(class_of < 0, -1, place[class_of])
        self.size = np.bincount(self.class_of[usable], minlength=n_classes)
        self.start = np.cumsum(self.size) - self.size
        self.member = usable[np.argsort(self.class_of[usable], kind="stable")]
        words = np.array(
            [
                np.bitwise_or.reduce(poses.words[self.members(one)], axis=0)
                for one in range(n_classes)
            ]
        )
        chains = runs.rows.detections.chains
        detections = Detections(n_frames=runs.rows.detections.n_frames, words=words, chains=chains)
        site_of = poses.site[self.member[self.start]]
        self.units = runs.units(words, detections.columns, site_of, self.size)
        # What all from each place on avoid together.
        behind = np.bitwise_or.accumulate(words[::-1], axis=0)[::-1]
        self.together = np.zeros(n_classes)

        def look(begin: int, end: int) -> None:
            first = np.empty((end - begin, len(chains.start) - 1), dtype=np.int64)
            first_live_windows(behind[begin:end], chains, first)
            self.together[begin:end] = avoided_runs(runs.links, first) @ run_weight

        share_out(look, n_classes)

    def members(self, one: int) -> IntArray:
        """Poses of a class, ascending."""
        begin = self.start[one]
        return self.member[begin : begin + self.size[one]]


def _ends(chains: Chains) -> tuple[IntArray, IntArray]:
    """First and last frame of the windows and tails of each chain, (n_chains,)."""
    n_chains = len(chains.start) - 1
    of_window = np.repeat(np.arange(n_chains), np.diff(chains.start))
    of_tail = np.repeat(np.arange(n_chains), np.diff(chains.tail_start))
    frames = chains.window_frames[chains.window]
    first, last = np.full(n_chains, np.iinfo(np.int64).max), np.full(n_chains, -1)
    np.minimum.at(first, of_window, frames.min(axis=1))
    np.minimum.at(first, of_tail, chains.tail_frame)
    np.maximum.at(last, of_window, frames.max(axis=1))
    np.maximum.at(last, of_tail, chains.tail_frame)
    return first, last


def _in_order(links: Links, runs: IntArray) -> Links:
    """The same where frames come in the order of the runs that they are first of use for.

    Frames of no use for these runs are left out.
    """
    from .pair_kernels import turn_some

    chains = links.detections.chains
    rank = np.full(len(links.n_links), len(runs))
    np.minimum.at(rank, links.run_chain[runs], np.arange(len(runs)))
    first = np.full(links.detections.n_frames, len(runs))
    frames, tails = chains.window_frames[chains.window], np.diff(chains.tail_start)
    np.minimum.at(first, frames, np.repeat(rank, links.n_links)[:, None])
    np.minimum.at(first, chains.tail_frame, np.repeat(rank, tails))
    order = np.argsort(first, kind="stable")[: np.count_nonzero(first < len(runs))]
    number = np.zeros(len(first), dtype=np.int64)
    number[order] = np.arange(len(order))
    columns = links.detections.columns
    words = np.empty((64 * columns.shape[1], -(-len(order) // 64)), dtype=np.uint64)

    def turn(begin: int, end: int) -> None:
        of_part = np.empty((len(words), end - begin), dtype=np.uint64)
        turn_some(columns, order[64 * begin : 64 * end], 0, of_part)
        words[:, begin:end] = of_part

    share_out(turn, words.shape[1])
    detections = Detections(
        n_frames=len(order),
        words=words[: len(links.detections.words)],
        chains=chains._replace(
            window_frames=number[chains.window_frames], tail_frame=number[chains.tail_frame]
        ),
    )
    return replace(links, detections=detections)


def _hardest_first(open_rows: WordArray) -> list[slice]:
    """Words of open rows in parts, the hardest first; the rest says little more of pairs."""
    count = np.bitwise_count(open_rows).cumsum()
    ends = 1 + np.searchsorted(count, _HARD_ROWS)
    ends = np.unique(np.clip(ends, 1, len(open_rows))).tolist()
    return [slice(begin, end) for begin, end in pairwise([0, *ends])]


def _alike(avoided: FloatArray) -> IntArray:
    """Class of each of some poses, by the weighted runs that they avoid (Ward 1963)."""
    from scipy.cluster.hierarchy import fcluster, linkage

    n_classes = -(-len(avoided) // _CLASS_POSES)
    if n_classes == 1:
        return np.zeros(len(avoided), dtype=np.int64)
    size = (avoided**2).sum(axis=1)
    apart = np.sqrt(np.maximum(size[:, None] + size - 2.0 * avoided @ avoided.T, 0.0))
    tree = linkage(apart[np.triu_indices(len(avoided), 1)], "ward")
    _, number = np.unique(fcluster(tree, n_classes, "maxclust"), return_inverse=True)
    return number
