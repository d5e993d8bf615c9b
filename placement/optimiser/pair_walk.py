"""All sets of two or three units that reach a need: one unit after the other, then pairs.

Where detections flicker, that a pose sees the frame which a window is asked for says little: hardly
any run is out of reach of a pose (:mod:`placement.optimiser.cover_tree`). It says much more when the
other units are known, since all that they see already is not asked for any more. So

* units are gone through in the order of what they promise at the root, each with those behind it;
* beside each, the poses that may gain enough by the root's rows are laid out by the runs that they
  avoid with it, and those where they may be of use (:mod:`placement.optimiser.pair_kernels`);
* pairs of these that lose too little are valued on the windows.

A walk that ends has met every set that reaches the need.
"""

from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s

from .limits import Limits
from .presolve import WordArray
from .set_tree import Links, Root
from .threads import WORKERS

MAX_UNITS = 3
_SLACK = 1.0e-9  # relative: rounding of sums
_WORK = 2_000_000  # pairs that are looked at between two looks at the clock
_OUT_PAIRS = 1 << 14


class PairWalk:
    """A walk through all sets of two or three units whose weighted runs reach `need`.

    Sites' capacities hold; other limits do not count.
    """

    def __init__(
        self,
        links: Links,
        limits: Limits,
        weight: FloatArray,
        root: Root,
        *,
        n_units: int,
        need: float,
    ) -> None:
        if not 2 <= n_units <= MAX_UNITS:
            raise ValueError(f"n_units: got {n_units}; expected 2 .. {MAX_UNITS}")
        self.links, self.limits, self.n_units, self.root = links, limits, n_units, root
        self.total = float(weight.sum())
        self.need = need
        self.is_finished = False  # whether all sets were gone through
        self._rows = _Rows(links, weight)
        self._seen_by = _seen_by(links)
        self._root_table = _byte_table(root.weight, root.covers.shape[1])
        price = np.minimum(root.price, root.weight)
        # No set is worth more than this and the gains of its poses.
        self._base = float((root.weight - price).sum())
        gain = _weigh(root.covers, _byte_table(price, root.covers.shape[1]))
        usable = ~limits.is_forbidden & (limits.site_capacity > 0)[limits.site_index]
        order = np.argsort(-gain, kind="stable")
        self.order: IntArray = order[usable[order]]
        self._gain = gain[self.order]

    @property
    def root_limit(self) -> float:
        """No set that reaches what was needed at first is worth more."""
        return self.root.limit

    def raise_needs(self, need: float) -> None:
        """Ask for more from here on."""
        self.need = max(self.need, need)

    @property
    def may_lose(self) -> float:
        """Weight of runs that a set may lose."""
        return self.total - self.need + _SLACK * max(self.total, 1.0)

    def blocks(self, end_s: float) -> Iterator[IntArray]:
        """Sets that may reach the need, many at a time, until `end_s` on the monotonic clock.

        An empty block says that nothing was found for a while. The order is left to chance.
        """
        beginnings = self._beginnings()
        waiting: set[Future[tuple[_Beside | None, IntArray]]] = set()
        with ThreadPoolExecutor(WORKERS) as threads:
            while now_s() < end_s:
                while len(waiting) < 2 * WORKERS and (task := next(beginnings, None)) is not None:
                    waiting.add(threads.submit(task.go_on))
                if not waiting:
                    self.is_finished = True
                    return
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    left, found = future.result()
                    if left is not None:
                        waiting.add(threads.submit(left.go_on))
                    yield found

    def _beginnings(self) -> "Iterator[_Beside]":
        """What stands before the last two units, and who may come behind it."""
        if self.n_units == 2:
            yield _Beside(self, np.empty(0, dtype=np.int64), 0)
            return
        best_two = self._gain[1:-1] + self._gain[2:]
        for place, rest in enumerate(best_two.tolist()):
            if self._base + self._gain[place] + rest < self.total - self.may_lose:
                return
            yield _Beside(self, self.order[place : place + 1], place + 1)


class _Beside:
    """The pairs beside the first unit, or none, from some place of the order on."""

    def __init__(self, owner: PairWalk, before: IntArray, first: int) -> None:
        self.owner, self.before, self.first = owner, before, first
        self.poses: IntArray | None = None  # not looked at yet

    def go_on(self) -> "tuple[_Beside | None, IntArray]":
        """Look for a while; what is left to do, and sets that were found."""
        from .pair_kernels import find_pairs

        if self.poses is None:
            self._lay_out()
        assert self.poses is not None
        owner, n_units = self.owner, self.owner.n_units
        may_lose = owner.may_lose
        pairs = np.empty((_OUT_PAIRS, 2), dtype=np.int64)
        n_found = find_pairs(
            *(self.alone, self.may, self.part, self.open_rows, self.words, owner._rows.table),
            *(self.gain, self.open_weight - may_lose, may_lose),
            *(owner.limits.site_index[self.poses], self.room, self.next_pair, _WORK, pairs),
        )
        found = np.empty((n_found, n_units), dtype=np.int64)
        found[:, : n_units - 2] = self.before
        found[:, n_units - 2 :] = self.poses[pairs[:n_found]]
        found = owner._rows.keep(owner.links, found, owner.may_lose)
        is_done = int(self.next_pair[0]) >= len(self.poses)
        return (None if is_done else self), found

    def _lay_out(self) -> None:
        from .pair_kernels import ask_for_pieces, cover_beside

        owner, links = self.owner, self.owner.links
        layout, rows, limits = links.layout, owner._rows, owner.limits
        room = limits.site_capacity.copy()
        room[limits.site_index[self.before]] -= 1
        self.room = room
        poses = self._promising(owner.order[self.first :])
        union = np.zeros(layout.bits.shape[1:], dtype=np.uint64)
        if layout.bits.shape[2] > layout.n_phases and not len(self.before):
            union[:, layout.n_phases] = owner._rows.padding
        if len(self.before):
            union = links.union(self.before)
        n_words = layout.bits.shape[1]
        asked = np.empty((layout.n_phases + 1, n_words), dtype=np.uint64)
        missing = np.empty_like(asked)
        asked_tail, dead_links = (np.empty(len(links.n_links), dtype=np.int64) for _ in range(2))
        ask_for_pieces(
            layout, union, links.n_links, owner._seen_by, asked, missing, asked_tail, dead_links
        )
        self.open_rows, chains = rows.open_with(links, self.before)
        self.words = np.flatnonzero(self.open_rows)
        self.open_weight = float(_weigh(self.open_rows[None, :], rows.table)[0])
        shape = (len(poses), len(self.open_rows))
        alone, may, part = (np.empty(shape, dtype=np.uint64) for _ in range(3))
        cover_beside(
            *(layout, union, asked, missing, asked_tail, dead_links),
            *(chains, rows.start, rows.last, rows.place, links.longest),
            *(poses, 0, len(poses), alone, may, part),
        )
        gain = _weigh(may & self.open_rows, rows.table)
        # Hopeless: not even with the best other one.
        need = self.open_weight - owner.may_lose
        kept = np.flatnonzero(gain + gain.max(initial=0.0) >= need)
        kept = kept[np.argsort(-gain[kept], kind="stable")]
        self.poses, self.gain = poses[kept], gain[kept]
        self.alone, self.may, self.part = alone[kept], may[kept], part[kept]
        self.next_pair = np.array([0, 1])

    def _promising(self, poses: IntArray) -> IntArray:
        """Poses that may gain enough, with another one, by the rows of the root."""
        owner = self.owner
        root, limits = owner.root, owner.limits
        poses = poses[self.room[limits.site_index[poses]] > 0]
        if not len(self.before):
            return poses
        covered = np.bitwise_or.reduce(root.covers[self.before], axis=0)
        reached = float(_weigh(covered[None, :], owner._root_table)[0])
        gain = _weigh(root.covers[poses] & ~covered, owner._root_table)
        need = owner.total - owner.may_lose - reached
        promising: IntArray = poses[gain + gain.max(initial=0.0) >= need]
        return promising


class _Rows:
    """Runs as bits: those that the fewest poses avoid come first."""

    def __init__(self, links: Links, weight: FloatArray) -> None:
        order = np.lexsort((-links.last, links.run_chain))
        self.run = order
        self.start = np.searchsorted(links.run_chain[order], np.arange(len(links.n_links) + 1))
        self.last = links.last[order]
        self.chain = links.run_chain[order]
        # Chains whose windows few see stand together: words of them are looked at first.
        sample = np.arange(0, links.n_poses, max(1, links.n_poses // 256))
        from .set_tree import first_seen

        first = first_seen(links, sample[:, None])
        is_avoided = first[:, self.chain] < self.last
        self.place = np.empty(len(order), dtype=np.int64)
        self.place[np.argsort(is_avoided.mean(axis=0), kind="stable")] = np.arange(len(order))
        self.n_words = -(-len(order) // 64)
        by_place = np.zeros(64 * self.n_words)
        by_place[self.place] = weight[order]
        self.table = _byte_table(by_place, self.n_words)
        self.worth = links.chain_worth(weight)
        self.chains = np.argsort(
            -self.worth[:, 0] * (1.0 - _mean_share(self, first)), kind="stable"
        )
        n_tails = np.diff(links.layout.tail_start)
        padding = np.zeros(64 * links.layout.bits.shape[1], dtype=bool)
        for chain, count in enumerate(n_tails.tolist()):
            begin, end = 64 * links.layout.start[chain : chain + 2]
            padding[begin + count : end] = True
        from .presolve import pack_words

        self.padding: WordArray = pack_words(padding)

    def open_with(self, links: Links, units: IntArray) -> tuple[WordArray, IntArray]:
        """Runs that a set does not avoid, as bits, and the chains that they belong to."""
        from .presolve import pack_words
        from .set_tree import first_seen

        if len(units):
            first = first_seen(links, units[None, :])[0]
        else:
            first = np.full(len(links.n_links), links.longest)
        is_open = first[self.chain] >= self.last
        bits = np.zeros(64 * self.n_words, dtype=bool)
        bits[self.place[is_open]] = True
        return pack_words(bits), np.unique(self.chain[is_open])

    def keep(self, links: Links, sets: IntArray, may_lose: float) -> IntArray:
        """Sets that lose no more than so much."""
        from .pair_kernels import keep_sets

        kept = np.zeros(len(sets), dtype=bool)
        if len(sets):
            keep_sets(links.layout, self.worth, self.chains, sets, may_lose, kept)
        return sets[kept]


def _mean_share(rows: _Rows, first: IntArray) -> FloatArray:
    """Share of some poses that see a window of each chain in time for its longest run."""
    longest = np.zeros(first.shape[1], dtype=np.int64)
    np.maximum.at(longest, rows.chain, rows.last)
    share: FloatArray = (first < longest).mean(axis=0)
    return share


def _seen_by(links: Links) -> FloatArray:
    """How many poses see each bit of each phase, and of the tails, (n_phases + 1, 64 n_words)."""
    from .root_kernels import add_up

    layout = links.layout
    n_words = layout.bits.shape[1]
    seen = np.full((layout.n_phases + 1, 64 * n_words), np.inf)
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
