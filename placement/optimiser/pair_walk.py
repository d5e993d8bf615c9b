"""All sets of two or three units that reach a need: a class of poses, and pairs beside it.

Where detections flicker, that a pose sees the frame which a window is asked for says little: hardly
any run is out of reach of a pose (:mod:`placement.optimiser.cover_tree`). It says much more when
another unit is known, since what that one sees is not asked for any more. So

* poses of a site that avoid much the same runs are a *class*, as good as all of them together;
* classes are gone through, each with those behind it. Beside each, the other classes are laid out
  by the runs that they avoid with it, and by those where they may be of use
  (:mod:`placement.optimiser.pair_kernels`): first by the hardest runs alone, which tell of most
  pairs that they lose too much, and which bound all sets that begin with the class;
* the class that promises most comes first, so that what was not looked at promises less and less.
  Of its pairs that are left, the poses are laid out, and then beside each of the class's own.

A walk that ends has met every set that reaches the need.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from copy import copy
from typing import TypeVar

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s

from .limits import Limits
from .presolve import WordArray, pack_words, unpack_words
from .set_tree import Links, avoided_runs, first_seen
from .threads import WORKERS

MAX_UNITS = 3
_SLACK = 1.0e-9  # relative: rounding of sums
_CLASS_POSES = 8  # of a class, on average
_MAX_TOGETHER = 2000  # poses whose likeness is looked at in one go
_OUT_PAIRS = 1 << 14
_MANY_PAIRS = 2000  # to be valued beside a class
_HARD_ROWS = (192, 576)  # that are looked at first, and then

_T = TypeVar("_T")


class PairWalk:
    """A walk through all sets of two or three units whose weighted runs reach `need`.

    Sites' capacities hold; other limits do not count.
    """

    def __init__(
        self, links: Links, limits: Limits, weight: FloatArray, *, n_units: int, need: float
    ) -> None:
        if not 2 <= n_units <= MAX_UNITS:
            raise ValueError(f"n_units: got {n_units}; expected 2 .. {MAX_UNITS}")
        usable = np.flatnonzero(
            ~limits.is_forbidden & (limits.site_capacity > 0)[limits.site_index]
        )
        # What is looked at first lies side by side, and what does not count nowhere.
        chains = _hardest_first(links, weight, usable)
        weight, links = weight[np.isin(links.run_chain, chains)], links.of_chains(chains)
        self.links, self.limits, self.n_units = links, limits, n_units
        self.total = float(weight.sum())
        self.need = need
        self.is_finished = False  # whether all sets were gone through
        self.rows = _Rows(links, weight, usable)
        self.classes = _Classes(links, limits, weight, usable if n_units > 2 else usable[:0])
        self.seen_by = _seen_by(links)
        # Of classes by their place: what no set reaches that begins there; infinite: not known yet.
        self.promise = np.full(len(self.classes.order), np.inf)
        self.left_limit = self.total  # no set that was not met is worth more

    @property
    def root_limit(self) -> float:
        """No set is worth more, as far as this is known without a walk."""
        return self.total

    def again(self, need: float) -> "PairWalk":
        """The same walk from its beginning for another need."""
        walk = copy(self)
        walk.need, walk.is_finished = need, False
        return walk

    def raise_needs(self, need: float, left: float = 0.0) -> None:
        """Ask for more from here on; nothing is asked of what is `left` when units fail."""
        self.need = max(self.need, need)

    @property
    def may_lose(self) -> float:
        """Weight of runs that a set may lose."""
        return self.total - self.need + _SLACK * max(self.total, 1.0)

    def blocks(self, end_s: float) -> Iterator[IntArray]:
        """Sets that reach the need, many at a time, until `end_s` of `geometry.clock`.

        An empty block says that nothing was found for a while. The order is left to chance.
        """
        if self.n_units == 2:
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
        is_left = np.isin(np.arange(len(limits)), places)
        self._look_at_left(limits[is_left])
        for place, sets in _in_threads(self._beside_class, places.tolist(), end_s):
            is_left[place] = False
            self._look_at_left(limits[is_left])
            yield sets

    def _look_at_left(self, limits: FloatArray) -> None:
        """Take down what those that were not looked at promise, (n,)."""
        self.is_finished = len(limits) == 0
        self.left_limit = min(max(self.need, float(limits.max(initial=0.0))), self.total)

    def _all_pairs(self) -> IntArray:
        """All pairs that reach the need."""
        beside = _Beside(self, None, np.zeros(0, dtype=np.int64))
        poses = np.flatnonzero(~self.limits.is_forbidden)
        pairs = poses[beside.pairs(self.links, poses, self.limits.site_index[poses])]
        return self.rows.keep(self.links, pairs, self.may_lose)

    def _promise_of(self, place: int) -> float:
        """No set of a class and those behind it reaches more."""
        classes = self.classes
        behind = classes.order[place:]
        if self.total - classes.together[place] > self.may_lose:
            return float(classes.together[place])
        beside = _Beside(self, classes.links, behind[:1])
        return self.total - beside.least_lost(
            classes.links, behind, classes.site[behind], copies=classes.size
        )

    def _beside_class(self, place: int) -> IntArray:
        """Sets of a class and those behind it that reach the need."""
        classes, limits = self.classes, self.limits
        one, behind = classes.order[place], classes.order[place:]
        beside = _Beside(self, classes.links, np.array([one]))
        pairs = beside.pairs(classes.links, behind, classes.site[behind], copies=classes.size)
        found = beside.thin(self.links, classes.pairs_of_poses(behind[pairs]))
        members = np.flatnonzero(classes.class_of == one)
        if len(found) > _MANY_PAIRS:  # the class promises too much: its poses one by one
            parts = []
            for member in members.tolist():
                pairs = _Beside(self, self.links, np.array([member])).thin(self.links, found)
                parts.append(np.column_stack([np.full(len(pairs), member), pairs]))
            sets = np.concatenate(parts)
        else:
            found = self.rows.keep(self.links, found, self.may_lose, beside.union)
            sets = np.column_stack(
                [np.repeat(members, len(found)), np.tile(found, (len(members), 1))]
            )
        # Two or three of the class itself: once, in ascending order.
        is_later = (classes.class_of[sets[:, 1:]] != one) | (sets[:, 1:] > sets[:, :1])
        sets = sets[is_later.all(axis=1)]
        sites = limits.site_index[sets]
        n_beside = (sites[:, :, None] == sites[:, None, :]).sum(axis=2)
        sets = sets[(n_beside <= limits.site_capacity[sites]).all(axis=1)]
        return self.rows.keep(self.links, sets, self.may_lose)


class _Beside:
    """What stands before the last two units, and the runs that it leaves open."""

    def __init__(self, owner: PairWalk, links: Links | None, before: IntArray) -> None:
        from .pair_kernels import ask_for_pieces

        self.owner = owner
        layout = owner.links.layout
        self.room = owner.limits.site_capacity.copy()
        if links is None:
            self.union = np.zeros(layout.bits.shape[1:], dtype=np.uint64)
            if layout.bits.shape[2] > layout.n_phases:
                self.union[:, layout.n_phases] = _padding(owner.links)
            first = np.full(len(owner.links.n_links), owner.links.longest)
        else:
            self.union = links.union(before)
            first = first_seen(links, before[None, :])[0]
            site = owner.limits.site_index if links is owner.links else owner.classes.site
            self.room[site[before]] -= 1
        self.asked = np.empty((layout.bits.shape[1], layout.n_phases + 1), dtype=np.uint64)
        self.missing = np.empty_like(self.asked)
        n_chains = len(owner.links.n_links)
        self.asked_tail, self.dead_links = (np.empty(n_chains, dtype=np.int64) for _ in range(2))
        ask_for_pieces(
            layout,
            self.union,
            owner.links.n_links,
            owner.seen_by,
            self.asked,
            self.missing,
            self.asked_tail,
            self.dead_links,
        )
        self.open_rows = owner.rows.open_after(first)
        self.parts = owner.rows.hardest_first(self.open_rows)

    def pairs(
        self, links: Links, poses: IntArray, site: IntArray, *, copies: IntArray | None = None
    ) -> IntArray:
        """Pairs of some poses, or classes, that may lose little beside: places, (n, 2).

        `copies`, by class, is how many poses it has: two of them are a pair, too.
        """
        from .pair_kernels import find_pairs

        owner = self.owner
        table, may_lose = owner.rows.table, owner.may_lose
        hard_rows, hard_chains = self.parts[0]
        alone, may, part = self._cover(links, poses, hard_chains)
        gain = _weigh(may & hard_rows, table)
        need = float(_weigh(hard_rows[None, :], table)[0]) - may_lose
        has_room = self.room[site] > 0
        most = float(gain[has_room].max(initial=0.0))
        kept = np.flatnonzero(has_room & (gain + most >= need))
        kept = kept[np.argsort(-gain[kept], kind="stable")]
        n_copies = np.ones(len(kept), dtype=np.int64) if copies is None else copies[poses[kept]]
        found, lost = [np.empty((0, 2), dtype=np.int64)], [np.empty(0)]
        next_pair = np.zeros(2, dtype=np.int64)
        while next_pair[0] < len(kept):
            out, of_out = np.empty((_OUT_PAIRS, 2), dtype=np.int64), np.empty(_OUT_PAIRS)
            n_found = find_pairs(
                alone[kept],
                may[kept],
                part[kept],
                hard_rows,
                np.flatnonzero(hard_rows),
                table,
                gain[kept],
                need,
                may_lose,
                site[kept],
                self.room,
                n_copies,
                next_pair,
                out,
                of_out,
            )
            found.append(kept[out[:n_found]])
            lost.append(of_out[:n_found])
        pairs = np.concatenate(found)
        return pairs[self._may_lose_little(links, poses[pairs], np.concatenate(lost))]

    def least_lost(
        self, links: Links, poses: IntArray, site: IntArray, *, copies: IntArray
    ) -> float:
        """No pair of some classes loses less of the hardest runs beside."""
        from .pair_kernels import find_least_lost

        table = self.owner.rows.table
        hard_rows, hard_chains = self.parts[0]
        alone, may, part = self._cover(links, poses, hard_chains)
        gain = np.where(self.room[site] > 0, _weigh(may & hard_rows, table), -np.inf)
        order = np.argsort(-gain, kind="stable")[: np.count_nonzero(gain > -np.inf)]
        return find_least_lost(
            alone[order],
            may[order],
            part[order],
            hard_rows,
            np.flatnonzero(hard_rows),
            table,
            gain[order],
            float(_weigh(hard_rows[None, :], table)[0]),
            site[order],
            self.room,
            copies[poses[order]],
        )

    def thin(self, links: Links, pairs: IntArray) -> IntArray:
        """Pairs of poses, (n, 2), that may lose little beside."""
        return pairs[self._may_lose_little(links, pairs)]

    def _may_lose_little(
        self, links: Links, pairs: IntArray, lost: FloatArray | None = None
    ) -> BoolArray:
        """Which pairs, (n, 2), may lose little beside; `lost`, (n,), of the hardest runs if known.

        The more runs are looked at, the fewer pairs are left to be laid out for the others.
        """
        from .pair_kernels import add_lost

        parts = self.parts if lost is None else self.parts[1:]
        lost = np.zeros(len(pairs)) if lost is None else lost.copy()
        for rows, chains in parts:
            left = np.flatnonzero(lost <= self.owner.may_lose)
            if not len(left):
                break
            is_used = np.zeros(links.n_poses, dtype=bool)
            is_used[pairs[left]] = True
            place, of_left = np.cumsum(is_used) - 1, lost[left]
            add_lost(
                *self._cover(links, np.flatnonzero(is_used), chains),
                rows,
                np.flatnonzero(rows),
                self.owner.rows.table,
                self.owner.may_lose,
                place[pairs[left]],
                of_left,
            )
            lost[left] = of_left
        may: BoolArray = lost <= self.owner.may_lose
        return may

    def _cover(
        self, links: Links, poses: IntArray, chains: IntArray
    ) -> tuple[WordArray, WordArray, WordArray]:
        """Runs of chains as ``pair_kernels.cover_beside`` finds them: alone, may, part."""
        from .pair_kernels import cover_beside

        rows = self.owner.rows
        shape = (len(poses), len(self.open_rows))
        alone, may, part = (np.empty(shape, dtype=np.uint64) for _ in range(3))
        layout = links.layout
        cover_beside(
            layout.bits,
            tuple(range(layout.n_phases)),
            layout.start,
            layout.tail_links,
            layout.tail_start,
            self.union,
            self.asked,
            self.missing,
            self.asked_tail,
            self.dead_links,
            chains,
            rows.start,
            rows.last,
            rows.place,
            links.longest,
            poses,
            alone,
            may,
            part,
        )
        return alone, may, part


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


def _hardest_first(links: Links, weight: FloatArray, poses: IntArray) -> IntArray:
    """Chains that weigh anything, those first with a run that the fewest poses avoid."""
    some = poses[:: max(1, len(poses) // 256)]
    count = avoided_runs(links, first_seen(links, some[:, None])).sum(axis=0)
    hardest = np.full(len(links.n_links), np.inf)
    counts = weight > 0.0
    np.minimum.at(hardest, links.run_chain[counts], count[counts])
    order: IntArray = np.argsort(hardest, kind="stable")
    return order[: np.count_nonzero(hardest < np.inf)]


class _Rows:
    """Runs that weigh anything, as bits: those that the fewest poses avoid come first."""

    def __init__(self, links: Links, weight: FloatArray, poses: IntArray) -> None:
        order = np.lexsort((-links.last, links.run_chain))
        order = order[weight[order] > 0.0]
        self.chain, self.last = links.run_chain[order], links.last[order]
        self.start = np.searchsorted(self.chain, np.arange(len(links.n_links) + 1))
        some = poses[:: max(1, len(poses) // 256)]
        is_avoided = first_seen(links, some[:, None])[:, self.chain] < self.last
        hardest_first = np.argsort(is_avoided.sum(axis=0), kind="stable")
        self.place = np.empty(len(order), dtype=np.int64)
        self.place[hardest_first] = np.arange(len(order))
        self.n_words = max(1, -(-len(order) // 64))
        self.chain_at = np.zeros(64 * self.n_words, dtype=np.int64)  # of each place
        self.chain_at[self.place] = self.chain
        self.table = _byte_table(weight[order][hardest_first], self.n_words)
        self.worth = links.chain_worth(weight)
        self.chains: IntArray = np.unique(self.chain[hardest_first], return_index=True)[1]
        self.chains = self.chain[hardest_first][np.sort(self.chains)]

    def open_after(self, first: IntArray) -> WordArray:
        """Runs that are not avoided, as bits, given the first live windows."""
        bits = np.zeros(64 * self.n_words, dtype=bool)
        bits[self.place[first[self.chain] >= self.last]] = True
        return pack_words(bits)

    def hardest_first(self, open_rows: WordArray) -> list[tuple[WordArray, IntArray]]:
        """Some rows in parts, as bits, the hardest ones in the first, and their chains."""
        count = np.bitwise_count(open_rows).cumsum()
        ends = [*(1 + np.searchsorted(count, _HARD_ROWS)), self.n_words]
        is_open = unpack_words(open_rows, 64 * self.n_words)
        parts, begin = [], 0
        for end in np.clip(ends, 1, self.n_words).tolist():
            rows = np.zeros_like(open_rows)
            rows[begin:end] = open_rows[begin:end]
            chains = self.chain_at[64 * begin : 64 * end][is_open[64 * begin : 64 * end]]
            parts.append((rows, np.unique(chains)))
            begin = max(begin, end)
        return parts

    def keep(
        self, links: Links, sets: IntArray, may_lose: float, union: WordArray | None = None
    ) -> IntArray:
        """Sets that lose no more than so much, beside a union if there is one."""
        from .pair_kernels import keep_sets

        kept = np.zeros(len(sets), dtype=bool)
        if union is None:
            union = np.zeros(links.layout.bits.shape[1:], dtype=np.uint64)
        layout = links.layout
        keep_sets(
            layout.bits,
            layout.n_phases,
            layout.start,
            layout.tail_links,
            layout.tail_start,
            self.worth,
            self.chains,
            union,
            sets,
            may_lose,
            kept,
        )
        return sets[kept]


class _Classes:
    """Poses that are looked at together first; see :class:`PairWalk`."""

    def __init__(self, links: Links, limits: Limits, weight: FloatArray, poses: IntArray) -> None:
        self.class_of = np.full(links.n_poses, -1)
        value, n_classes = np.zeros(links.n_poses), 0
        for site in np.unique(limits.site_index[poses]):
            here = poses[limits.site_index[poses] == site]
            for alike in np.array_split(here, -(-len(here) // _MAX_TOGETHER)):
                avoided = avoided_runs(links, first_seen(links, alike[:, None]))
                value[alike] = avoided @ weight
                number = _alike(avoided.astype(np.float64) * np.sqrt(weight))
                self.class_of[alike] = n_classes + number
                n_classes += int(number.max()) + 1
        self.size = np.bincount(self.class_of[poses], minlength=n_classes)
        self.start = np.cumsum(self.size) - self.size
        self.member = poses[np.argsort(self.class_of[poses], kind="stable")]
        self.site = np.zeros(n_classes, dtype=np.int64)
        self.site[self.class_of[poses]] = limits.site_index[poses]
        bits = np.zeros((n_classes, *links.layout.bits.shape[1:]), dtype=np.uint64)
        most = np.zeros(n_classes)
        for which in range(n_classes):
            members = np.flatnonzero(self.class_of == which)
            bits[which] = links.union(members)
            most[which] = value[members].max()
        self.links = Links(
            links.layout._replace(bits=bits), links.last, links.run_chain, links.n_links
        )
        self.order: IntArray = np.argsort(-most, kind="stable")
        self.total = float(weight.sum())
        # What all from each place of the order on avoid together.
        self.together = np.zeros(n_classes)
        union = np.zeros_like(bits[:1])
        for place in range(n_classes - 1, -1, -1):
            union |= bits[self.order[place]]
            alone = Links(
                links.layout._replace(bits=union), links.last, links.run_chain, links.n_links
            )
            first = first_seen(alone, np.zeros((1, 1), dtype=np.int64))
            self.together[place] = float(avoided_runs(alone, first)[0] @ weight)

    def pairs_of_poses(self, pairs: IntArray) -> IntArray:
        """All pairs of poses, one of each class of some pairs of them, (n, 2)."""
        size = self.size[pairs]
        count = size.prod(axis=1)
        pair = np.repeat(np.arange(len(pairs)), count)
        number = np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count)
        one, other = np.divmod(number, size[pair, 1])
        poses: IntArray = self.member[self.start[pairs][pair] + np.column_stack([one, other])]
        is_once = (pairs[pair, 0] != pairs[pair, 1]) | (one < other)
        once: IntArray = poses[is_once]
        return once


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


def _padding(links: Links) -> WordArray:
    """Bits behind the tails of each chain, which are set in every pose, (n_words,)."""
    layout = links.layout
    is_padding = np.zeros(64 * layout.bits.shape[1], dtype=bool)
    for chain, n_tails in enumerate(np.diff(layout.tail_start).tolist()):
        begin, end = 64 * layout.start[chain : chain + 2]
        is_padding[begin + n_tails : end] = True
    return pack_words(is_padding)


def _seen_by(links: Links) -> FloatArray:
    """How many poses see each bit of each phase, and of the tails, (n_phases + 1, 64 n_words)."""
    from .root_kernels import add_up

    layout = links.layout
    seen = np.full((layout.n_phases + 1, 64 * layout.bits.shape[1]), np.inf)
    some = np.arange(0, links.n_poses, max(1, links.n_poses // 1024))
    share = np.full(len(some), 1.0 / len(some))
    for row in range(layout.bits.shape[2]):
        add_up(layout.bits, row, some, share, seen[row])
    return seen


def _byte_table(weight: FloatArray, n_words: int) -> FloatArray:
    """What each byte of bits along rows is worth, (8 n_words, 256)."""
    from .root_kernels import weigh_bytes

    table, used = np.zeros((8 * n_words, 256)), np.empty(8 * n_words, dtype=np.int64)
    padded = np.zeros(64 * n_words)
    padded[: len(weight)] = weight
    weigh_bytes(padded, np.full(n_words, ~np.uint64(0)), table, used)
    return table


def _weigh(bits: WordArray, table: FloatArray) -> FloatArray:
    """What the bits of each row weigh, (n,)."""
    from .pair_kernels import weights_of

    total = np.empty(len(bits))
    weights_of(np.ascontiguousarray(bits), table, total)
    return total
