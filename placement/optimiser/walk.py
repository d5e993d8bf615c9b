"""Third rung: all sets that lose little, and the best of those that tie.

As in :mod:`placement.optimiser.bounds`, poses *cover* runs, and runs that the
same poses cover are one row. Of the poses at a site, most cover no row that
another one there does not cover: a *class* is a pose that is widest in this
sense with those below it. So the walk is one through sets of classes, each as
good as its widest pose:

* It asks which class covers the row that fewest cover. Where hardly anything
  may be lost, that leaves few classes at every node. When they have been tried,
  the row is lost.
* With m units to come, the m best classes at most cover what is not covered
  yet, and m - N of them if N units to come fail, or m - N + 1 if one of the
  chosen fails, which loses what it covers alone. The gains are weighed by the
  rows' weights, and by Lagrangian prices.

What remains is spelled out: sets of poses, one of each class, valued on the
windows, where poses of a class that is not settled yet see together. A walk
that ends has met every set. Where few tie, all are valued, and every later
stage is proven at once; where many do, the APR that is left when units fail is
asked for in the walk, too.

:class:`placement.optimiser.walk_kernels.Walk` draws what a node of the walk is.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s

from . import constants
from .allowed_sets import Limits, are_allowed, may_grow
from .bitsets import (
    Contenders,
    left_after_failures,
    set_values,
    shares_with_each,
    union_apr,
    unions_of,
)
from .bounds import Root, rounded_down
from .constants import NEVER, TIES_OF_TIES, TOLERANCE, Deadline, deadline_in
from .greedy import forced_units
from .presolve import ReducedProblem, transposed, unpack_words
from .problem import Objective

if TYPE_CHECKING:
    from .walk_kernels import Classes, Walk


_T = TypeVar("_T")


def can_walk(reduced: ReducedProblem) -> bool:
    """True if a walk through sets of the largest size can meet all best sets.

    A best set must have as many units as allowed, or be part of such a set: money
    must be no limit. There may be one floor, an APR of all runs without failures.
    """
    limits = reduced.limits
    if limits.budget_eur is not None or reduced.objectives[0].is_minimised:
        return False
    if limits.is_forced_site.any() or len(limits.rivals):
        return False
    if reduced.floors and least_apr(reduced) is None:
        return False
    if not len(reduced.weight):
        return False
    n_forced = int(limits.is_forced.sum())
    if n_forced and reduced.survive:
        return False
    fewest = max(2, n_forced + 1)
    most = min(constants.MAX_WALK_UNITS, reduced.n_poses)
    return fewest <= limits.max_units <= most


def least_apr(reduced: ReducedProblem) -> float | None:
    """APR that every set must reach, where that is the only floor; else None."""
    if len(reduced.floors) != 1:
        return None
    (floor,) = reduced.floors
    if floor.n_failures or not floor.measure.is_mean:
        return None
    if (floor.measure.weight == reduced.weight).all():
        return floor.least
    return None


def best_of_few(
    reduced: ReducedProblem, *, max_sets: int, deadline: Deadline = NEVER
) -> tuple[Contenders | None, bool]:
    """Best of all allowed sets of any size, and what ties, where they are few.

    Parameters
    ----------
    reduced : ReducedProblem
        The problem whose sets are valued.
    max_sets : int
        Give up if there are more allowed sets.
    deadline : Deadline
        Give up when it is over.

    Returns
    -------
    contenders : Contenders or None
        The best sets so far; None if there are too many to begin with.
    is_complete : bool
        True if all sets were gone through.
    """
    sizes = allowed_sets(reduced.limits, max_sets=max_sets)
    if sizes is None:
        return None, False
    contenders = Contenders(reduced.objectives)
    least = -np.inf
    is_by_apr = reduced.objectives[0] is Objective.APR and not reduced.floors
    for sets in sizes:
        for begin in range(0, len(sets), constants.BLOCK_SETS):
            if deadline.is_over:
                return contenders, False
            part = sets[begin : begin + constants.BLOCK_SETS]
            # The APR first: all else takes longer, and matters for few.
            if is_by_apr:
                share = union_apr(reduced, unions_of(reduced, part))
                near = float(share.max()) - TIES_OF_TIES * TOLERANCE
                least = max(least, near)
                part = part[share >= least]
            if len(part):
                contenders.add(part, set_values(reduced, part))
    return contenders, True


def allowed_sets(limits: Limits, *, max_sets: int) -> list[IntArray] | None:
    """All sets within limits, by their size.

    Parameters
    ----------
    limits : Limits
        What may be mounted together.
    max_sets : int
        Give up if there are more sets.

    Returns
    -------
    sizes : list of (n_sets, n_units) int, or None
        Sets of poses, one array for each number of units, poses ascending. None if
        there are more than `max_sets`, or too many to count.
    """
    forced = np.flatnonzero(limits.is_forced)
    poses = np.flatnonzero(~limits.is_forbidden & ~limits.is_forced)
    grown = forced[None, :]
    sizes = []
    if 0 < len(forced) <= limits.max_units:
        sizes.append(grown[are_allowed(limits, grown)])
    n_sets = sum(map(len, sizes))
    if n_sets > max_sets:
        return None
    most = max(constants.MANY_SETS, min(constants.MAX_GROWN_SETS, 100 * max_sets))
    for n_units in range(len(forced) + 1, limits.max_units + 1):
        if not len(grown):
            break
        if len(grown) * len(poses) > most:
            return None
        # Some at a time: those that do not fit are many more than those that do.
        step = max(1, constants.GROWN_TOGETHER // max(1, len(poses)))
        larger = []
        allowed = []
        for begin in range(0, len(grown), step):
            part = grown[begin : begin + step]
            sets = _with_one_more(
                limits, part, poses, is_first=n_units == len(forced) + 1
            )
            is_allowed_set = are_allowed(limits, sets)
            n_sets += int(is_allowed_set.sum())
            if n_sets > max_sets:
                return None
            larger.append(sets)
            allowed.append(np.sort(sets[is_allowed_set], axis=1))
        grown = np.concatenate(larger)
        sizes.append(np.concatenate(allowed))
    return sizes


def _with_one_more(
    limits: Limits, sets: IntArray, poses: IntArray, *, is_first: bool
) -> IntArray:
    """Sets (n_sets, n_units + 1) that fit into sites and money, from smaller ones.

    Each takes a pose later than its last one, so that every set comes up once; any
    pose where `is_first`: the sets have only what is forced.
    """
    last = np.full((1, 1), -1)
    if not is_first:
        last = sets[:, -1:]
    row, later = np.nonzero(np.broadcast_to(poses, (len(sets), len(poses))) > last)
    larger = np.column_stack([sets[row], poses[later]])
    return larger[may_grow(limits, larger)]


class SetWalk:
    """A walk through all sets of so many units that reach `need`, also on failure.

    Parameters
    ----------
    reduced : ReducedProblem
        The problem; sites' capacities hold, other limits do not count.
    root : Root
        Its covering problem, with prices.
    need : float
        Value that whole sets must reach.
    n_failures : int
        Units that fail; 0 if nothing is asked of what is left.
    left : float
        Value that must be left when they fail.
    """

    def __init__(
        self,
        reduced: ReducedProblem,
        root: Root,
        *,
        need: float,
        n_failures: int = 0,
        left: float = 0.0,
    ) -> None:
        from .walk_kernels import Covers, Losses

        self.reduced = reduced
        self.n_failures = n_failures
        self.forced = forced_units(reduced)
        choice = root.choice
        self.n_units = choice.n_units
        self.capacity = choice.room
        self.total = float(reduced.weight.sum())
        usable = (choice.is_open > 0) & (choice.room > 0)[choice.site]
        rows = unpack_words(root.covers, len(root.weight))
        widest, class_of = widest_poses(rows, choice.site, usable)
        self.classes = group_by_class(reduced, class_of)
        size = np.diff(self.classes.start)
        covers = root.covers[widest]
        self.covers = Covers(
            covers=covers,
            coverers=transposed(covers, len(root.weight), workers=reduced.workers),
            rows=covers.view(np.uint8),
            weight=root.weight,
            price=np.minimum(root.price, root.weight),
            site=choice.site[widest],
            copies=np.minimum(size, choice.room[choice.site[widest]]),
        )
        lost = lost_by_chain(reduced)
        self.losses = Losses(
            chains=reduced.chains,
            lost=lost,
            order=_hardest_first(reduced, lost, root),
            may_lose=np.zeros(2),
            base=unions_of(reduced, self.forced[None, :])[0],
        )
        # Sites behind which it walks, (n_sites,) each time; None: all together.
        self.starts: Iterator[BoolArray] | None = None
        # Whether all sets were gone through.
        self.is_finished = False
        self.raise_needs(need, left)

    def raise_needs(self, need: float, left: float = 0.0) -> None:
        """Ask for more from here on, of whole sets and of what is left of them.

        Tasks share the array that is changed: all threads see it at once.
        """
        self.losses.may_lose[:] = [self.total - need, self.total - left]
        self.losses.may_lose[:] += constants.ROUNDING * max(self.total, 1.0)

    def blocks(self, deadline: Deadline) -> Iterator[IntArray]:
        """Sets that meet the needs, many at a time, until the deadline.

        An empty block says that nothing was found for a while. All threads walk, each
        behind a node near the root: the order of the sets is left to chance.

        Yields
        ------
        sets : (n_sets, n_units) int
            Poses of the reduced problem, the forced ones first.
        """
        if self.n_units == 1:
            yield self._alone()
            return
        spare: list[_Task] = []
        paused: list[_Task] = []
        nodes = self._tasks(spare)

        def next_task() -> "Callable[[], tuple[_Task, list[IntArray]]] | None":
            if paused:
                return paused.pop().go_on
            task = next(nodes, None)
            if task is None:
                return None
            return task.go_on

        for task, found in in_threads(
            next_task, workers=self.reduced.workers, deadline=deadline
        ):
            if task.is_done:
                spare.append(task)
            else:
                paused.append(task)
            yield self._with_forced(found)
        self.is_finished = not deadline.is_over

    def _with_forced(self, found: list[IntArray]) -> IntArray:
        """Found sets in one array, behind the forced poses, (n_sets, n_units)."""
        none = np.empty((0, self.n_units), dtype=np.int64)
        sets = np.concatenate([none, *found])
        forced = np.tile(self.forced, (len(sets), 1))
        return np.column_stack([forced, sets])

    def _alone(self) -> IntArray:
        """Sets of the forced poses and one more that lose little."""
        from .walk_kernels import WHOLE

        share = shares_with_each(self.reduced, self.forced)
        share[~np.isin(np.arange(len(share)), self.classes.member)] = -np.inf
        self.is_finished = True
        is_kept = self.total - share <= self.losses.may_lose[WHOLE]
        return self._with_forced([np.flatnonzero(is_kept)[:, None]])

    def _tasks(self, spare: "list[_Task]") -> "Iterator[_Task]":
        """Walks behind the nodes near the root, one after the other.

        A scout walks from the root and pauses at every node of some depth: a task
        begins there. Tasks in `spare` are done; their arrays are used again.
        """
        from .walk_kernels import AT_STOP, DONE, grow

        stop = max(min(constants.STOP_DEPTH, self.n_units - 2), 1)
        scout = _Task(self)

        def begin() -> _Task:
            task = spare.pop() if spare else _Task(self)
            task.begin_at(scout.walk)
            return task

        if self.starts is not None:
            for is_used in self.starts:
                scout.walk.is_open[0] = is_used[self.covers.site]
                yield begin()
            return
        while True:
            state = grow(
                self.covers,
                scout.walk,
                self.n_failures,
                stop,
                constants.WALK_WORK,
                scout.out,
            )
            if state == DONE:
                return
            if state == AT_STOP:
                yield begin()
                # The scout goes back up, as if it had been behind the node itself.
                scout.walk.at[0].depth -= 1
                scout.walk.at[0].is_new = 0


class _Task:
    """A walk behind a node, and the sets of classes it is about to spell out.

    Attributes
    ----------
    is_done : bool
        True once all sets behind the node were walked through and spelled out.
    is_walked : bool
        True once the walk has ended; sets may still wait to be spelled out.
    waiting : list of (n_units,) int
        Sets of classes that wait.
    out : (n, n_units) int
        Where the kernel writes the sets of classes that it finds.
    """

    def __init__(self, owner: SetWalk) -> None:
        from .walk_kernels import Walk, build_position

        self.owner = owner
        self.is_done = False
        self.is_walked = False
        # To be spelled out.
        self.waiting: list[IntArray] = []
        self.losses = owner.losses._replace(order=owner.losses.order.copy())
        n_units = owner.n_units
        (n_poses, n_words) = owner.covers.covers.shape
        self.out = np.empty((constants.OUT_SETS, n_units), dtype=np.int64)
        self.walk = Walk(
            at=build_position(),
            may_lose=owner.losses.may_lose,
            chosen=np.zeros(n_units, dtype=np.int64),
            covered=np.zeros((n_units + 1, n_words), dtype=np.uint64),
            covered_twice=np.zeros((n_units + 1, n_words), dtype=np.uint64),
            given_up=np.zeros((n_units + 1, n_words), dtype=np.uint64),
            weight_given_up=np.zeros(n_units + 1),
            is_open=np.ones((n_units + 1, n_poses), dtype=bool),
            room=np.tile(owner.capacity, (n_units + 1, 1)),
            queue=np.zeros((n_units, n_poses), dtype=np.int64),
            n_queued=np.zeros(n_units, dtype=np.int64),
            position=np.zeros(n_units, dtype=np.int64),
            gain=np.zeros(n_poses),
            gain_beside=np.zeros(n_poses),
            table=np.zeros((8 * n_words, 256)),
            used=np.zeros(8 * n_words, dtype=np.int64),
            best=np.zeros(n_units, dtype=np.int64),
        )

    def begin_at(self, walk: "Walk") -> None:
        """Begin behind the node that another walk stands at."""
        from .walk_kernels import build_position

        mine = self.walk
        depth = int(walk.at[0].depth)
        self.is_done = False
        self.is_walked = False
        mine.at[:] = build_position(depth)
        mine.chosen[:depth] = walk.chosen[:depth]
        mine.covered[depth] = walk.covered[depth]
        mine.covered_twice[depth] = walk.covered_twice[depth]
        mine.given_up[depth] = walk.given_up[depth]
        mine.weight_given_up[depth] = walk.weight_given_up[depth]
        mine.is_open[depth] = walk.is_open[depth]
        mine.room[depth] = walk.room[depth]

    def go_on(self) -> "tuple[_Task, list[IntArray]]":
        """Spell out for a while what was found, then walk on."""
        from .walk_kernels import DONE, grow

        owner = self.owner
        found: list[IntArray] = []
        # Sets that were found before, for a while; none is left when it walks on.
        stop = deadline_in(constants.SPELL_S)
        while self.waiting and not stop.is_over:
            found += self._spell_out(self.waiting.pop())
        if not self.waiting and not self.is_walked:
            at = self.walk.at[0]
            at.n_found = 0
            state = grow(
                owner.covers,
                self.walk,
                owner.n_failures,
                -1,
                constants.WALK_WORK,
                self.out,
            )
            self.is_walked = state == DONE
            self.waiting = [np.sort(classes) for classes in self.out[: at.n_found]]
        self.is_done = self.is_walked and not self.waiting
        return self, found

    def _spell_out(self, classes: IntArray) -> list[IntArray]:
        """Sets of poses, one of each class, that lose little: blocks (n, n_units)."""
        from .walk_kernels import spell_out

        owner = self.owner
        words = owner.reduced.words
        has_failures = owner.n_failures > 0
        # Where the search stands: no member so far, and no unit is settled.
        place = np.append(np.full(len(classes), -1), 0)
        found = []
        while place[-1] >= 0:
            sets = np.empty((256, len(classes)), dtype=np.int64)
            n_found = spell_out(
                words, owner.classes, self.losses, has_failures, classes, place, sets
            )
            found.append(sets[:n_found])
        return found


def widest_poses(
    rows: BoolArray, site_index: IntArray, usable: BoolArray
) -> tuple[IntArray, IntArray]:
    """Poses that cover what no other one at their site covers, and all classes.

    Parameters
    ----------
    rows : (n_poses, n_rows) bool
        What each pose covers.
    site_index : (n_poses,) int
        Site of each pose.
    usable : (n_poses,) bool
        Poses that may be chosen.

    Returns
    -------
    widest : (n_classes,) int
        The widest pose of each class.
    class_of : (n_poses,) int
        Class of each pose, numbered as the widest poses are; -1: not usable.
    """
    widest = []
    class_of = np.full(len(rows), -1)
    n_classes = 0
    for site in np.unique(site_index[usable]):
        poses = np.flatnonzero(usable & (site_index == site))
        n_covered = rows[poses].sum(axis=1)
        poses = poses[np.argsort(-n_covered, kind="stable")]
        # Pose b is above a if all that a covers is covered by both.
        covers = rows[poses].astype(np.float32)
        above = covers @ covers.T >= covers.sum(axis=1)[:, None] - 0.5
        # A wider one, or the first of those as wide.
        first = above.argmax(axis=1)
        is_widest = first == np.arange(len(poses))
        place = np.cumsum(is_widest) - 1
        # The first above is widest itself: what is above it would come before.
        class_of[poses] = n_classes + place[first]
        widest.append(poses[is_widest])
        n_classes += int(is_widest.sum())
    return np.concatenate([np.empty(0, dtype=np.int64), *widest]), class_of


def group_by_class(reduced: ReducedProblem, class_of: IntArray) -> "Classes":
    """Poses of classes 0, 1, .., in their order; those of class -1 are left out."""
    from .walk_kernels import Classes

    n_unusable = np.count_nonzero(class_of < 0)
    member = np.argsort(class_of, kind="stable")[n_unusable:]
    size = np.bincount(class_of[member])
    words = np.zeros((len(size), reduced.words.shape[1]), dtype=np.uint64)
    np.bitwise_or.at(words, class_of[member], reduced.words[member])
    return Classes(member=member, start=np.cumsum([0, *size]), words=words)


def lost_by_chain(reduced: ReducedProblem) -> FloatArray:
    """Weight of runs that are lost by chain and first live window.

    Returns
    -------
    lost : (n_chains, longest + 1) float
        ``lost[g, k]`` is the weight of the runs of chain g that are lost if its
        k-th window is the first live one; ``longest`` is the length of the longest
        chain.
    """
    longest = int(np.diff(reduced.chains.start).max(initial=0))
    lost = np.zeros((reduced.n_chains, longest + 1))
    for chain, last, weight in zip(
        reduced.run_chain, reduced.last, reduced.weight, strict=True
    ):
        lost[chain, last:] += weight
    return lost


def _hardest_first(reduced: ReducedProblem, lost: FloatArray, root: Root) -> IntArray:
    """Chains in the order of what the worthiest poses lose in them, (n_chains,)."""
    from .bit_kernels import first_live_windows

    best = np.argsort(-root.gains(), kind="stable")[:256]
    first = np.empty((len(best), reduced.n_chains), dtype=np.int64)
    first_live_windows(reduced.words[best], reduced.chains, first)
    mean = lost[np.arange(reduced.n_chains), first].mean(axis=0)
    return np.argsort(-mean, kind="stable")


def in_threads(
    next_task: Callable[[], Callable[[], _T] | None],
    *,
    workers: int,
    deadline: Deadline,
) -> Iterator[_T]:
    """What tasks return, as they end, until none is left or the time is up.

    Parameters
    ----------
    next_task : callable
        Gives the next task, a function without arguments; None if there is none at
        present. More may come once a task that is under way has returned.
    workers : int
        Threads. Twice as many tasks wait, so that no thread does.
    deadline : Deadline
        No task is begun behind it.
    """
    waiting: set[Future[_T]] = set()
    with ThreadPoolExecutor(workers) as threads:
        while not deadline.is_over:
            # Two tasks for each thread, so that none is idle when one ends.
            while len(waiting) < 2 * workers and (task := next_task()) is not None:
                waiting.add(threads.submit(task))
            if not waiting:
                return
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
        for future in waiting:
            future.cancel()


# ---------- sets that tie
class SomeWalk(Protocol):
    """A walk through all sets that meet needs, which may be raised on the way.

    Attributes
    ----------
    is_finished : bool
        True once all sets were gone through.
    """

    # Whether all sets were gone through.
    is_finished: bool

    def blocks(self, deadline: Deadline) -> Iterator[IntArray]:
        """Sets, many at a time, until the deadline."""

    def raise_needs(self, need: float, left: float = 0.0) -> None:
        """Ask for more from here on."""


class Tied(NamedTuple):
    """Sets that tie at the best value of a stage.

    Attributes
    ----------
    sets : (n, n_units) int, optional
        All of them; None: too many, or not all were looked at.
    value : float
        The best that was found.
    limit : float
        No set exceeds it.
    is_finished : bool
        True if the value is proven.
    """

    sets: IntArray | None
    value: float
    limit: float
    is_finished: bool


class TieSearch:
    """A search for all sets as good as the best, by the APR when units fail.

    Parameters
    ----------
    reduced : ReducedProblem
        The problem.
    units : (n_units,) int
        The best set so far.
    walk_from : callable
        Begins a walk for what whole sets must reach, and what must be left of them.
    limit : callable, optional
        Upper bound of all sets that reach so much, until a deadline.
    ahead : float
        If not 0, it is first proven that no set is better by that.
    near : float
        If not 0, a walk may not end: it is proven before that no set is better by
        that, by half of it, and so on.
    n_failures : int
        Units that fail; 0 for none.
    least_apr : float, optional
        What the whole set must reach; by default what must be left.
    on_better : callable
        Takes better sets and returns what they were improved to.
    """

    def __init__(
        self,
        reduced: ReducedProblem,
        units: IntArray,
        *,
        walk_from: "Callable[[float, float], SomeWalk]",
        limit: Callable[[float, Deadline], float] | None = None,
        ahead: float = 0.0,
        near: float = 0.0,
        n_failures: int = 0,
        least_apr: float | None = None,
        on_better: Callable[[IntArray], IntArray] = lambda units: units,
    ) -> None:
        self.reduced = reduced
        self.walk_from = walk_from
        self.limit = limit
        self.n_failures = n_failures
        self.least_apr = least_apr
        self.on_better = on_better
        self.best = float(self._value_of(np.sort(units)[None, :])[0])
        self.ahead = ahead
        self.near = near
        self.tied: list[IntArray] = []
        self.has_all = True

    def find(self, deadline: Deadline) -> Tied:
        """Prove the best value, as far as the time goes, then meet all ties.

        It takes much less to prove that nothing is better by a step, where values are
        so far apart, or by a little, than to meet all ties.
        """
        measure = self.reduced.measure
        is_near = self.ahead > 0.0
        ahead = (1.0 - constants.SOLVER_TOLERANCE) * measure.step
        if is_near:
            ahead = self.ahead
        if deadline.is_over:
            return self._tied(measure.limit, False)
        limit = measure.limit
        if self.limit is not None:
            need = self.best
            if self.least_apr is not None:
                need = self.least_apr
            limit = min(limit, rounded_down(self.reduced, self.limit(need, deadline)))
        # No set is better by `ahead`.
        is_proven = False
        limit = self._come_near(deadline, limit)
        if ahead > 0.0 and (not is_near or limit >= self.best + ahead):
            if not self._walk(deadline, ahead):
                return self._tied(limit, False)
            is_proven = not is_near
            limit = min(limit, rounded_down(self.reduced, self.best + ahead))
            if deadline.is_over:
                return self._tied(limit, is_proven)
        # No set is better, and these are all that tie.
        is_finished = self._walk(deadline, 0.0, is_proven=is_proven)
        sets = None
        if is_finished and self.has_all:
            tied = np.sort(np.concatenate(self.tied), axis=1)
            sets = np.unique(tied, axis=0)
        return self._tied(limit, is_proven or is_finished, sets)

    def _come_near(self, deadline: Deadline, limit: float) -> float:
        """Upper bound ever nearer to the best, while a walk for all may not end."""
        near = self.near
        while near > 0.0 and self.best + near < limit and not deadline.is_over:
            began_s = now_s()
            if not self._walk(deadline, near):
                break
            limit = self.best + near
            if constants.ALL_TIMES_NEAR * (now_s() - began_s) < deadline.left_s():
                break
            near /= 2.0
        return limit

    def _tied(
        self, limit: float, is_proven: bool, sets: IntArray | None = None
    ) -> Tied:
        """What was found, with a limit that is no lower than the best value."""
        if is_proven:
            limit = self.best
        else:
            limit = max(limit, self.best)
        return Tied(sets=sets, value=self.best, limit=limit, is_finished=is_proven)

    @property
    def _least(self) -> float:
        """Least value that ties with a set that may be a tie worse than the best."""
        return self.best - TIES_OF_TIES * TOLERANCE

    def _value_of(self, sets: IntArray) -> FloatArray:
        """APR that sets keep when units fail, (n_sets,)."""
        return left_after_failures(
            self.reduced, self.reduced.measure, self.n_failures, sets
        )

    def _needs(self, need: float) -> tuple[float, float]:
        """Value that whole sets must reach, and value that must be left of them."""
        if self.least_apr is None:
            return need, need
        return self.least_apr, need

    def _asked(self, ahead: float) -> float:
        """Value that a walk asks for: better by `ahead`, or 0.0 for all that tie."""
        if ahead:
            return self.best + ahead
        return self._least

    def _walk(
        self, deadline: Deadline, ahead: float, *, is_proven: bool = False
    ) -> bool:
        """Walk through better sets, or with `ahead` 0 all that tie; True if it ended.

        With `is_proven` nothing but ties is left to be found: the walk is given up once
        they are too many.
        """
        need, left = self._needs(self._asked(ahead))
        walk = self.walk_from(need, left)
        if not ahead:
            n_units = self.reduced.limits.max_units
            self.tied = [np.empty((0, n_units), dtype=np.int64)]
            self.has_all = True
        for block in walk.blocks(deadline):
            value, block = self._within(block)
            if len(block) and value.max() > self.best + TOLERANCE:
                better = self.on_better(block[value.argmax()])
                of_better = float(self._value_of(np.sort(better)[None, :])[0])
                before = self.best
                self.best = max(float(value.max()), of_better)
                need, left = self._needs(self._asked(ahead))
                walk.raise_needs(need, left)
                # None of those before ties any more.
                if before < self._least:
                    self.tied = self.tied[:1]
                    self.has_all = True
            elif len(block):
                self.best = max(self.best, float(value.max()))
            if ahead or not self.has_all:
                continue
            self.tied.append(block[value >= self._least])
            self.has_all = sum(map(len, self.tied)) <= constants.MAX_TIED
            if not self.has_all:
                if is_proven:
                    return False
                # Ties are too many: only sets that are better are asked for.
                step = (1.0 - constants.SOLVER_TOLERANCE) * self.reduced.measure.step
                more = self.best + max(step, constants.STEP_UP)
                need, left = self._needs(more)
                walk.raise_needs(need, left)
        return walk.is_finished

    def _within(self, block: IntArray) -> tuple[FloatArray, IntArray]:
        """Values, (n,), and sets of a block that reach what whole sets must."""
        if self.least_apr is not None and len(block):
            share = union_apr(self.reduced, unions_of(self.reduced, block))
            block = block[share >= self.least_apr - TOLERANCE]
        return self._value_of(block), block


def best_of_tied(
    reduced: ReducedProblem,
    sets: IntArray,
    *,
    n_failures: int,
    value: float,
    among: Contenders | None = None,
) -> Contenders:
    """Tied sets and their parts that tie with them, within the limits.

    Parts are looked at with one unit less each time: a part is as good in the first
    stages only if a whole set is.

    Parameters
    ----------
    reduced : ReducedProblem
        The problem.
    sets : (n_sets, n_units) int
        All sets of the largest size that tie.
    n_failures : int
        Units that fail in the stage in which they tie.
    value : float
        The best value of that stage.
    among : Contenders, optional
        Others that they join.
    """
    contenders = among or Contenders(reduced.objectives)
    while len(sets) and sets.shape[1] > 0:
        for start in range(0, len(sets), constants.BLOCK_SETS):
            part = sets[start : start + constants.BLOCK_SETS]
            part = part[are_allowed(reduced.limits, part)]
            if len(part):
                contenders.add(part, set_values(reduced, part))
        # Parts of these sets, with a unit less, that are as good in the first stages.
        fewer = sets.shape[1] - 1
        if not fewer:
            break
        places = combinations(range(sets.shape[1]), fewer)
        smaller = np.concatenate([sets[:, list(place)] for place in places])
        smaller = np.unique(np.sort(smaller, axis=1), axis=0)
        left = left_after_failures(reduced, reduced.measure, n_failures, smaller)
        sets = smaller[left >= value - TIES_OF_TIES * TOLERANCE]
    return contenders
