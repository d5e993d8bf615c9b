"""All sets of so many units that lose little, and little when units fail: a tree of covers.

As in :mod:`placement.optimiser.set_tree`, a set avoids a run only if one of its poses *covers* it,
and runs that the same poses cover are one row. Of the poses at a site, most cover no row that
another one there does not cover: a *class* is a pose that is widest in this sense with those below
it. Every set of poses is one of each of so many classes, some of them perhaps several times. So the
walk is one through sets of classes, each as good as its widest pose:

* It asks which class covers the row that fewest cover. Where hardly anything may be lost, that
  leaves few classes at every node. When they have been tried, the row is lost.
* With m units to come, the m best classes at most cover what is not covered yet, and m - N of them
  if N units to come fail, or m - N + 1 if one of the chosen fails, which loses what it covers
  alone. The gains are weighed by the rows' weights, and by Lagrangian prices.

What is left is spelled out: sets of poses, one of each class, valued on the windows, where poses of
a class that is not settled yet see together. A walk that ends has met every set.
"""

from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s

from .limits import Limits
from .presolve import pack_words, unpack_words
from .set_tree import Links, Root, chains_hardest_first, failure_limit
from .threads import WORKERS
from .tolerances import ROUNDING

if TYPE_CHECKING:
    from .cover_kernels import Walk

_OUT_SETS = 1 << 8
_WORK = 30_000_000  # bytes looked at between two looks at the clock
_TURN_S = 0.1  # of spelling out
_STOP_DEPTH = 2  # nodes of this depth are handed out to processors


class SetWalk:
    """A walk through all sets of so many units that reach `need`, also when units fail.

    With failures, `left` is what must remain of any `n_failures` of them; sets are checked exactly
    for one failure, and for more only by bounds. Sites' capacities hold; other limits do not count.
    Prices that bound sets at the root are looked for until `end_s` of `geometry.clock`.
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
        n_failures: int = 0,
        left: float = 0.0,
        end_s: float = np.inf,
    ) -> None:
        from .cover_kernels import Covers

        self.links, self.n_units, self.n_failures = links, n_units, n_failures
        self.total = float(weight.sum())
        self._find_limit = partial(
            failure_limit, root, limits, n_units, n_failures, need, end_s=end_s
        )
        self.worth = links.chain_worth(weight)
        self.chains = chains_hardest_first(links, self.worth, root)
        usable = ~limits.is_forbidden & (limits.site_capacity > 0)[limits.site_index]
        rows = unpack_words(root.covers, len(root.weight))
        widest, class_of = widest_poses(rows, limits.site_index, usable)
        self.member = np.argsort(class_of, kind="stable")[np.count_nonzero(class_of < 0) :]
        size = np.bincount(class_of[class_of >= 0], minlength=len(widest))
        self.start = np.cumsum([0, *size])
        self.bits = np.stack(
            [
                links.union(self.member[begin:end])
                for begin, end in zip(self.start[:-1], self.start[1:], strict=True)
            ]
        )
        site = limits.site_index[widest]
        covers = root.covers[widest]
        self.covers = Covers(
            covers=covers,
            coverers=pack_words(np.ascontiguousarray(rows[widest].T)),
            rows=covers.view(np.uint8),
            weight=root.weight,
            price=np.minimum(root.price, root.weight),
            site=site,
            copies=np.minimum(size, limits.site_capacity[site]),
        )
        self.capacity = limits.site_capacity
        self.may_lose = np.zeros(2)
        self.is_finished = False  # whether all sets were gone through
        self.raise_needs(need, left)

    @property
    def root_limit(self) -> float:
        """No set that reaches what was needed at first is worth more, or keeps more."""
        return self._find_limit()

    def raise_needs(self, need: float, left: float = 0.0) -> None:
        """Ask for more from here on."""
        scale = max(self.total, 1.0)
        self.may_lose[:] = [self.total - need, self.total - left]
        self.may_lose += ROUNDING * scale

    def blocks(self, end_s: float) -> Iterator[IntArray]:
        """Sets that meet the needs, many at a time, until `end_s` of `geometry.clock`.

        An empty block says that nothing was found for a while. All processors walk, each behind
        some node near the root at a time: the order of the sets is left to chance.
        """
        spare: list[_Task] = []
        tasks = self._tasks(spare)
        waiting: set[Future[tuple[_Task, list[IntArray]]]] = set()
        with ThreadPoolExecutor(WORKERS) as threads:
            while now_s() < end_s:
                while len(waiting) < 2 * WORKERS and (task := next(tasks, None)) is not None:
                    waiting.add(threads.submit(task.go_on))
                if not waiting:
                    self.is_finished = True
                    return
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    task, found = future.result()
                    if task.is_done:
                        spare.append(task)
                    else:
                        waiting.add(threads.submit(task.go_on))
                    yield np.concatenate([np.empty((0, self.n_units), dtype=np.int64), *found])

    def _tasks(self, spare: "list[_Task]") -> "Iterator[_Task]":
        """The nodes near the root, one after the other; tasks that are done are taken again."""
        from .cover_kernels import AT_STOP, DONE, grow

        stop = max(min(_STOP_DEPTH, self.n_units - 2), 1)
        scout = _Task(self)
        while True:
            state = grow(self.covers, scout.walk, self.n_failures, stop, _WORK, scout.out)
            if state == DONE:
                return
            if state == AT_STOP:
                task = spare.pop() if spare else _Task(self)
                task.begin_at(scout.walk)
                yield task
                scout.walk.where[0] -= 1
                scout.walk.where[1] = 0


class _Task:
    """A walk behind a node, and the sets of classes it is about to spell out."""

    def __init__(self, owner: SetWalk) -> None:
        from .cover_kernels import Walk

        self.owner, self.is_done, self.is_walked = owner, False, False
        self.waiting: list[IntArray] = []  # to be spelled out
        n_units, (n_poses, n_words) = owner.n_units, owner.covers.covers.shape
        of_rows = (n_units + 1, n_words)
        self.out = np.empty((_OUT_SETS, n_units), dtype=np.int64)
        self.walk = Walk(
            where=np.array([0, 1, 0, 0, 0]),
            may_lose=owner.may_lose,
            chosen=np.zeros(n_units, dtype=np.int64),
            once=np.zeros(of_rows, dtype=np.uint64),
            twice=np.zeros(of_rows, dtype=np.uint64),
            gone=np.zeros(of_rows, dtype=np.uint64),
            lost=np.zeros(n_units + 1),
            is_open=np.ones((n_units + 1, n_poses), dtype=bool),
            room=np.tile(owner.capacity, (n_units + 1, 1)),
            queue=np.zeros((n_units, n_poses), dtype=np.int64),
            n_queued=np.zeros(n_units, dtype=np.int64),
            position=np.zeros(n_units, dtype=np.int64),
            gain=np.zeros(n_poses),
            beside=np.zeros(n_poses),
            table=np.zeros((8 * n_words, 256)),
            used=np.zeros(8 * n_words, dtype=np.int64),
            best=np.zeros(n_units, dtype=np.int64),
        )

    def begin_at(self, walk: "Walk") -> None:
        """Begin behind the node that another walk stands at."""
        depth = int(walk.where[0])
        self.is_done = self.is_walked = False
        self.walk.where[:] = depth, 1, 0, 0, depth
        self.walk.chosen[:depth] = walk.chosen[:depth]
        for name in ("once", "twice", "gone", "lost", "is_open", "room"):
            getattr(self.walk, name)[depth] = getattr(walk, name)[depth]

    def go_on(self) -> "tuple[_Task, list[IntArray]]":
        """Spell out for a while what was found, then walk on."""
        from .cover_kernels import DONE, grow

        owner = self.owner
        found: list[IntArray] = []
        stop_s = now_s() + _TURN_S
        while self.waiting and now_s() < stop_s:
            found += self._spell_out(self.waiting.pop())
        if not self.waiting and not self.is_walked:
            self.walk.where[2] = 0
            state = grow(owner.covers, self.walk, owner.n_failures, -1, _WORK, self.out)
            self.is_walked = state == DONE
            self.waiting = [np.sort(classes) for classes in self.out[: self.walk.where[2]]]
        self.is_done = self.is_walked and not self.waiting
        return self, found

    def _spell_out(self, classes: IntArray) -> list[IntArray]:
        from .cover_kernels import spell_out

        owner = self.owner
        place, found = np.append(np.full(len(classes), -1), 0), []
        while place[-1] >= 0:
            sets = np.empty((256, len(classes)), dtype=np.int64)
            n_found = spell_out(
                owner.links.layout,
                owner.bits,
                owner.start,
                owner.member,
                owner.worth,
                owner.chains,
                owner.may_lose,
                owner.n_failures > 0,
                classes,
                place,
                sets,
            )
            found.append(sets[:n_found])
        return found


def widest_poses(
    rows: BoolArray, site_index: IntArray, usable: BoolArray
) -> tuple[IntArray, IntArray]:
    """Poses that cover what no other one at their site covers, and the class of each pose.

    `rows`, (n_poses, n_rows), says what each covers. Classes are numbered as the widest poses are;
    -1: not usable.
    """
    widest, class_of, n_classes = [], np.full(len(rows), -1), 0
    for site in np.unique(site_index[usable]):
        poses = np.flatnonzero(usable & (site_index == site))
        poses = poses[np.argsort(-rows[poses].sum(axis=1), kind="stable")]
        covers = rows[poses].astype(np.float32)
        above = covers @ covers.T >= covers.sum(axis=1)[:, None] - 0.5
        first = above.argmax(axis=1)  # a wider one, or the first of those as wide
        is_widest = first == np.arange(len(poses))
        place = np.cumsum(is_widest) - 1
        # The first above is widest itself: what is above it would come before.
        class_of[poses] = n_classes + place[first]
        widest.append(poses[is_widest])
        n_classes += int(is_widest.sum())
    return np.concatenate([np.empty(0, dtype=np.int64), *widest]), class_of
