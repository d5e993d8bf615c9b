"""Third rung for sampled worlds: sets of a class of poses and a pair.

Sets have two or three units. Where detections are drawn, hardly any run is out
of reach of a pose; what a window is asked for says more when another unit is
known, since what that one sees is not asked for any more. So poses of a site
that avoid much the same runs are a *class*, as good as all of them together.
Classes are gone through, each with those behind it:

* Of the pieces, frames and tails, that are missing in a window, one unit of the
  pair sees the one that fewest see; and one sees all that are missing in some
  window, or both see some. Both are bits along the runs: most pairs of classes
  lose too much by them, then most pairs of poses, at the hardest runs.
* Sets of what remains are valued on the windows.

A walk that ends has met every set that reaches the need. The mean over the
worst worlds is no higher than that over all, which bounds it.
"""

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from . import constants
from .allowed_sets import may_grow
from .bitsets import shares_with_each, union_apr, unions_of
from .bounds import Rows, byte_table, coverers_of, is_covered_by, run_rows
from .constants import Deadline
from .presolve import ReducedProblem, transposed, unpack_words
from .problem import WordArray
from .walk import Tied, TieSearch, group_by_class, in_threads, lost_by_chain


def goes_by_pairs(reduced: ReducedProblem) -> bool:
    """True if worlds are sampled, and sets so small that pairs are gone through."""
    limits = reduced.limits
    is_small = 2 <= limits.max_units <= constants.MAX_PAIR_UNITS
    return (
        len(reduced.measure.sample_weight) > 1
        and is_small
        and not limits.is_forced.any()
    )


def walk_by_pairs(
    reduced: ReducedProblem,
    units: IntArray,
    *,
    deadline: Deadline,
    on_better: Callable[[IntArray], IntArray],
) -> Tied:
    """All sets as good as the best, by their mean over all worlds.

    Where the time is too short, an upper bound: ever nearer ones are proven first.
    Where only the worst worlds count, no more than an upper bound: that of the
    mean.

    Parameters
    ----------
    reduced : ReducedProblem
        A problem of which :func:`goes_by_pairs` is true.
    units : (n_units,) int
        The best set so far.
    deadline : Deadline
        When to end.
    on_better : callable
        Takes better sets and returns what they were improved to.
    """
    if reduced.measure.is_mean:
        walk = PairWalk(reduced, need=0.0)
        value = float(union_apr(reduced, unions_of(reduced, units[None, :]))[0])
        search = TieSearch(
            reduced,
            units,
            walk_from=lambda need, _: walk.again(need),
            near=constants.NEAR_IN_WORLDS * value,
            on_better=on_better,
        )
        return search.find(deadline)
    value = float(union_apr(reduced, unions_of(reduced, units[None, :]))[0])
    of_all = replace(reduced, measure=replace(reduced.measure, tail=1.0))
    walk = PairWalk(of_all, need=value * (1.0 + constants.NEAR))
    for block in walk.blocks(deadline):
        if len(block):
            walk.raise_needs(float(union_apr(of_all, unions_of(of_all, block)).max()))
    if walk.is_finished:
        limit = walk.need
    else:
        limit = reduced.measure.limit
    return Tied(sets=None, value=value, limit=max(limit, value), is_finished=False)


class _Units(NamedTuple):
    """Poses, or classes of poses.

    Attributes
    ----------
    words : (n, n_frame_words) uint64
        What each sees, as bits along the frames.
    columns : (n_frames, n_words) uint64
        The same as bits along the units.
    """

    words: WordArray
    columns: WordArray


class PairWalk:
    """A walk through all sets of two or three units that reach `need`.

    The need is a mean over all worlds. Sites' capacities hold; other limits do not
    count.

    Attributes
    ----------
    is_finished : bool
        True once all sets were gone through.
    rows : Rows
        Runs with weight, the hardest first.
    classes, poses : _Units
        What classes of poses, and poses, see.
    class_of : (n_poses,) int
        Class of each pose; -1: not usable.
    member, start, size : (n,), (n_classes,), (n_classes,) int
        Poses, class after class; the first and the number of each class.
    """

    def __init__(self, reduced: ReducedProblem, *, need: float) -> None:
        from .walk_kernels import Losses

        self.reduced = reduced
        self.need = need
        self.n_units = reduced.limits.max_units
        self.total = float(reduced.weight.sum())
        # Whether all sets were gone through.
        self.is_finished = False
        limits = reduced.limits
        self.usable = (
            ~limits.is_forbidden & (limits.site_capacity > 0)[limits.site_index]
        )
        self.rows, avoided = _hardest_first(reduced)
        self.seen = np.bitwise_count(reduced.columns).sum(axis=1).astype(np.float64)
        chains = self.rows.chain
        self.losses = Losses(
            chains=reduced.chains,
            lost=lost_by_chain(reduced),
            order=chains[np.sort(np.unique(chains, return_index=True)[1])],
            may_lose=np.zeros(2),
            base=np.zeros_like(reduced.base),
        )
        self.class_of = _classes(
            limits.site_index, self.usable, avoided, self.rows.weight
        )
        self.member, start, words = group_by_class(reduced, self.class_of)
        self.start = start[:-1]
        self.size = np.diff(start)
        columns = transposed(words, reduced.n_frames, workers=reduced.workers)
        self.classes = _Units(words=words, columns=columns)
        self.poses = _Units(words=reduced.words, columns=reduced.columns)
        self.class_site = limits.site_index[self.member[self.start]]

    def again(self, need: float) -> "PairWalk":
        """A walk from the beginning for another need."""
        walk = copy(self)
        walk.need = need
        walk.is_finished = False
        return walk

    def raise_needs(self, need: float, left: float = 0.0) -> None:
        """Ask for more from here on; `left`, what failures leave, does not count."""
        self.need = max(self.need, need)

    @property
    def may_lose(self) -> float:
        """Weight of runs that a set may lose."""
        return self.total - self.need + constants.ROUNDING * max(self.total, 1.0)

    def blocks(self, deadline: Deadline) -> Iterator[IntArray]:
        """Sets that reach the need, many at a time, until the deadline.

        An empty block says that nothing was found for a while. Threads take turns: the
        order of the sets is left to chance.
        """
        is_pair = self.n_units == 2
        look: Callable[[int], IntArray] = self._beside_class
        left = iter(range(len(self.size)))
        if is_pair:
            look = self._beside_pose
            left = iter(self.member.tolist())

        def next_task() -> Callable[[], IntArray] | None:
            one = next(left, None)
            if one is None:
                return None
            return partial(look, one)

        yield from in_threads(
            next_task, workers=self.reduced.workers, deadline=deadline
        )
        self.is_finished = not deadline.is_over

    def _beside_pose(self, pose: int) -> IntArray:
        """Pairs of a pose and later ones that reach the need."""
        share = shares_with_each(self.reduced, np.array([pose]))
        later = np.flatnonzero((self.total - share <= self.may_lose) & self.usable)
        later = later[later > pose]
        sets = np.column_stack([np.full(len(later), pose), later])
        return sets[may_grow(self.reduced.limits, sets)]

    def _beside_class(self, one: int) -> IntArray:
        """Sets of a class and two of those from it on that reach the need, (n, 3).

        Pairs of classes are thinned out first, then pairs of poses, then sets.
        """
        union = self.classes.words[one]
        is_open = ~is_covered_by(self.reduced, union, self.rows)
        rows = self.rows.of(is_open)
        # All pairs of classes from this one on for which the sites have room, and which
        # have enough poses.
        behind = np.arange(one, len(self.size))
        place = np.column_stack(np.triu_indices(len(behind)))
        pairs = behind[place]
        sites = self.class_site[pairs]
        capacity = self.reduced.limits.site_capacity
        is_same = sites == self.class_site[one]
        needed = 1 + is_same.sum(axis=1)
        fits = needed <= capacity[self.class_site[one]]
        fits &= (sites[:, 0] != sites[:, 1]) | (capacity[sites[:, 0]] >= 2)
        fits &= (pairs[:, 0] != pairs[:, 1]) | (self.size[pairs[:, 0]] >= 2)
        pairs = pairs[fits]
        # Pairs of classes, at the hardest runs, which say most, then at all.
        for n_rows in (constants.HARD_ROWS, len(rows.chain)):
            some = rows.of(slice(n_rows))
            pairs = self._losing_little(self.classes, union, some, pairs)
        # Pairs of their poses next to the class.
        hard = rows.of(slice(constants.HARD_ROWS))
        pairs = self._losing_little(self.poses, union, hard, self._members_of(pairs))
        # Sets: each pose of the class with what pairs are left next to it.
        first = self.start[one]
        members = self.member[first : first + self.size[one]]
        found = [np.empty((0, 3), dtype=np.int64)]
        for member in members:
            left = pairs
            # The class is too wide then: its poses see much less.
            if len(left) > constants.FEW_PAIRS:
                left = self._beside_member(int(member), left)
            sets = np.column_stack([np.full(len(left), member), left])
            # Two or three of the class itself: once, in ascending order.
            is_later = (self.class_of[sets[:, 1:]] != one) | (sets[:, 1:] > sets[:, :1])
            sets = sets[is_later.all(axis=1)]
            sets = sets[may_grow(self.reduced.limits, sets)]
            found.append(self._keep(sets))
        return np.concatenate(found)

    def _beside_member(self, member: int, pairs: IntArray) -> IntArray:
        """Pairs of poses that may lose little next to a pose.

        They are looked at at the hardest runs, then at all.
        """
        union = self.poses.words[member]
        is_open = ~is_covered_by(self.reduced, union, self.rows)
        rows = self.rows.of(is_open)
        for n_rows in (constants.HARD_ROWS, len(rows.chain)):
            some = rows.of(slice(n_rows))
            if len(pairs) > constants.FEW_PAIRS:
                pairs = self._losing_little(self.poses, union, some, pairs)
        return pairs

    def _members_of(self, pairs: IntArray) -> IntArray:
        """All pairs of poses, one of each class of some pairs, (n, 2).

        A pair of one class has its poses in ascending order, so that it comes once.
        """
        sizes = self.size[pairs]
        count = sizes.prod(axis=1)
        # Of each pair of classes, so many pairs of poses: `number` counts them.
        row = np.repeat(np.arange(len(pairs)), count)
        number = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        one, other = np.divmod(number, np.maximum(sizes[row, 1], 1))
        first = self.member[self.start[pairs[row, 0]] + one]
        second = self.member[self.start[pairs[row, 1]] + other]
        is_once = (pairs[row, 0] != pairs[row, 1]) | (first < second)
        return np.asarray(np.column_stack([first, second])[is_once])

    def _losing_little(
        self, units: _Units, union: WordArray, rows: Rows, pairs: IntArray
    ) -> IntArray:
        """Pairs of units, (n, 2), that may lose little of some rows next to a union."""
        from .walk_kernels import lost_by_pairs

        if not len(pairs) or not len(rows.chain):
            return pairs
        alone, part = _coverers(self.reduced, units, union, rows)
        may = coverers_of(self.reduced, rows, union, self.seen, columns=units.columns)
        # Bits along the rows, a row for each unit.
        n_units = len(units.words)
        alone = transposed(alone, n_units, workers=1)
        may = transposed(may, n_units, workers=1)
        part = transposed(part, n_units, workers=1)
        table = byte_table(rows.weight, alone)
        lost = np.empty(len(pairs))
        lost_by_pairs(alone, may, part, table, self.may_lose, pairs, lost)
        return pairs[lost <= self.may_lose]

    def _keep(self, sets: IntArray) -> IntArray:
        """Sets that reach the need."""
        from .walk_kernels import keep_sets

        kept = np.zeros(len(sets), dtype=bool)
        order = self.losses.order.copy()
        losses = self.losses._replace(order=order, may_lose=np.full(2, self.may_lose))
        keep_sets(self.reduced.words, sets, losses, kept)
        return sets[kept]


def _hardest_first(reduced: ReducedProblem) -> tuple[Rows, WordArray]:
    """Rows of all runs, the hardest first, and the poses that avoid each.

    Returns the rows and (n_rows, n_words) bits along the poses.
    """
    rows = run_rows(reduced)
    rows = rows.of(rows.weight > 0.0)
    union = reduced.base
    units = _Units(words=reduced.words, columns=reduced.columns)
    alone = _coverers(reduced, units, union, rows)[0]
    share = unpack_words(alone, reduced.n_poses).mean(axis=1)
    # Two more poses are likely to lose what many poses lose.
    loss = -rows.weight * (1.0 - share) ** constants.TOGETHER
    order = np.argsort(loss, kind="stable")
    return rows.of(order), alone[order]


def _coverers(
    reduced: ReducedProblem, units: _Units, union: WordArray, rows: Rows
) -> tuple[WordArray, WordArray]:
    """Units that avoid each row next to a union, and that see a missing piece.

    Both are (n_rows, n_words) bits along the units.
    """
    from .bit_kernels import avoid_beside

    is_seen = unpack_words(union, reduced.n_frames)
    shape = (len(rows.chain), units.columns.shape[1])
    alone = np.empty(shape, dtype=np.uint64)
    part = np.empty(shape, dtype=np.uint64)
    avoid_beside(
        units.columns, is_seen, reduced.chains, rows.chain, rows.last, alone, part
    )
    return alone, part


def _classes(
    site_index: IntArray, usable: BoolArray, avoided: WordArray, weight: FloatArray
) -> IntArray:
    """Class of each pose, the best classes first; -1: not usable.

    Poses of a site that avoid much the same runs are one class: they are clustered
    by Ward's method [1]_ on weighted bits.

    Parameters
    ----------
    site_index : (n_poses,) int
        Site of each pose.
    usable : (n_poses,) bool
        Poses that may be chosen.
    avoided : (n_rows, n_words) uint64
        Poses that avoid each row.
    weight : (n_rows,) float
        Weight of each row.

    References
    ----------
    .. [1] J. Ward, "Hierarchical grouping to optimize an objective function", 1963.
    """
    from scipy.cluster.hierarchy import fcluster, linkage

    class_of = np.full(len(site_index), -1)
    n_classes = 0
    bits = unpack_words(avoided, len(site_index)).T
    for site in np.unique(site_index[usable]):
        here = np.flatnonzero(usable & (site_index == site))
        n_parts = -(-len(here) // constants.MAX_LIKE_POSES)
        for alike in np.array_split(here, n_parts):
            of_poses = bits[alike] * np.sqrt(weight)
            number: IntArray = np.zeros(len(alike), dtype=np.int64)
            if len(alike) > constants.CLASS_POSES:
                # Distances between all two poses: |a - b|^2 = |a|^2 + |b|^2 - 2 a b.
                size = (of_poses**2).sum(axis=1)
                apart = size[:, None] + size - 2.0 * of_poses @ of_poses.T
                upper = np.triu_indices(len(alike), 1)
                apart = np.sqrt(np.maximum(apart, 0.0))[upper]
                tree = linkage(apart, "ward")
                n_most = -(-len(alike) // constants.CLASS_POSES)
                of_tree = fcluster(tree, n_most, "maxclust")
                number = np.unique(of_tree, return_inverse=True)[1]
            class_of[alike] = n_classes + number
            n_classes += int(number.max()) + 1
    # Number classes by their best pose.
    value = bits @ weight
    most = np.zeros(n_classes)
    np.maximum.at(most, class_of[usable], value[usable])
    place = np.empty(n_classes, dtype=np.int64)
    place[np.argsort(-most, kind="stable")] = np.arange(n_classes)
    return np.where(class_of < 0, -1, place[class_of])
