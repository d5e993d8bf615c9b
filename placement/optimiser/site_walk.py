"""Walks where money is short: behind one set of sites after the other.

A site is paid once, however many units it carries: few sets of sites can be paid, and
many of these do not reach enough even with all their poses. Behind each set of sites
that is left, :class:`placement.optimiser.walk.SetWalk` goes through all sets of as many
units as the rest of the money pays.

A set at these sites that has fewer units is part of one that has more, until the next
unit might be too dear. Where prices of units differ, all numbers between those that
only the dearest and only the cheapest units make are gone through, and what is too dear
drops out.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from . import constants
from .allowed_sets import Limits, are_allowed
from .bitsets import Contenders, union_apr
from .bounds import Root, find_root, reward_of, run_rows, tightened
from .constants import (
    COST_TOLERANCE_EUR,
    TIES_OF_TIES,
    TOLERANCE,
    Deadline,
    share_out,
)
from .presolve import ReducedProblem
from .walk import (
    SetWalk,
    SomeWalk,
    Tied,
    allowed_sets,
    best_of_tied,
    least_apr,
)

if TYPE_CHECKING:
    from .proof import Search

FindTied = Callable[[int, ReducedProblem, Root, Callable[..., SomeWalk]], Tied]


class SiteSets(NamedTuple):
    """Sets of sites that can be paid and reach enough with all their poses.

    Attributes
    ----------
    is_used : (n_sets, n_sites) bool
        Sites of each set; each carries at least one unit.
    apr : (n_sets,) float
        What all poses at these sites reach together.
    cost_eur : (n_sets,) float
        Price of the sites and of the forced units. [EUR]
    unit_eur : (n_sets,) float
        Price of the cheapest unit there. [EUR]
    fewest, most : (n_sets,) int
        Units that the sites carry, the forced ones among them: what has fewer than
        `fewest` is part of a set that can be paid, more than `most` cannot be.
    """

    is_used: BoolArray
    apr: FloatArray
    cost_eur: FloatArray
    unit_eur: FloatArray
    fewest: IntArray
    most: IntArray

    def of(self, some: IntArray | BoolArray) -> "SiteSets":
        """Some of the sets."""
        return SiteSets._make(array[some] for array in self)


def find_site_sets(
    reduced: ReducedProblem, *, least: float, deadline: Deadline
) -> SiteSets | None:
    """Sets of sites within the limits whose poses together reach an APR.

    None if they are too many, or the deadline is over.
    """
    limits = reduced.limits
    prices = limits.unit_cost_eur
    usable = np.flatnonzero(
        ~limits.is_forbidden & (limits.site_capacity > 0)[limits.site_index]
    )
    site = limits.site_index[usable]
    n_usable = np.bincount(site, minlength=limits.n_sites)
    room = np.minimum(n_usable, limits.site_capacity)
    cheapest = np.full(limits.n_sites, np.inf)
    np.minimum.at(cheapest, site, prices[usable])
    dearest = np.zeros(limits.n_sites)
    np.maximum.at(dearest, site, prices[usable])
    words = np.zeros((limits.n_sites, reduced.words.shape[1]), dtype=np.uint64)
    np.bitwise_or.at(words, site, reduced.words[usable])
    sizes = allowed_sets(
        _limits_of_sites(limits, room, cheapest), max_sets=constants.MAX_SITE_SETS
    )
    if sizes is None:
        return None
    used = []
    reached = []
    for sets in sizes:
        for begin in range(0, len(sets), constants.BLOCK_SETS):
            if deadline.is_over:
                return None
            part = sets[begin : begin + constants.BLOCK_SETS]
            union = np.bitwise_or.reduce(words[part], axis=1) | reduced.base
            apr = union_apr(reduced, union)
            is_enough = apr >= least - TIES_OF_TIES * TOLERANCE
            is_used = np.zeros((int(is_enough.sum()), limits.n_sites), dtype=bool)
            np.put_along_axis(is_used, part[is_enough], True, axis=1)
            used.append(is_used)
            reached.append(apr[is_enough])
    is_used = np.concatenate([np.zeros((0, limits.n_sites), dtype=bool), *used])
    n_forced = int(limits.is_forced.sum())
    of_forced = float(prices[limits.is_forced].sum())
    cost_eur = is_used @ limits.site_cost_eur + of_forced
    unit_eur = np.where(is_used, cheapest, np.inf).min(axis=1, initial=np.inf)
    left_eur = np.full(len(is_used), np.inf)
    if limits.budget_eur is not None:
        left_eur = limits.budget_eur + COST_TOLERANCE_EUR - cost_eur
    n_most = np.minimum(is_used @ room, limits.max_units)

    def count_units(price_eur: FloatArray) -> IntArray:
        """Units that the money pays, at most as many as there may be."""
        with np.errstate(divide="ignore", invalid="ignore"):
            n_paid = np.where(price_eur > 0.0, left_eur // price_eur, np.inf)
        n_paid = np.where(left_eur < 0.0, -np.inf, n_forced + n_paid)
        n_units: IntArray = np.clip(n_paid, 0, n_most).astype(np.int64)
        return n_units

    dearest_eur = np.where(is_used, dearest, 0.0).max(axis=1, initial=0.0)
    n_least = np.maximum(is_used.sum(axis=1), max(n_forced, 1))
    found = SiteSets(
        is_used=is_used,
        apr=np.concatenate([np.zeros(0), *reached]),
        cost_eur=cost_eur,
        unit_eur=unit_eur,
        fewest=np.maximum(count_units(dearest_eur), n_least),
        most=count_units(unit_eur),
    )
    return found.of(found.most >= found.fewest)


def _limits_of_sites(
    limits: Limits, room: IntArray, cheapest_eur: FloatArray
) -> Limits:
    """Limits on sites: each is a pose, with its price and that of its cheapest unit."""
    is_forced = limits.is_forced_site.copy()
    is_forced[limits.site_index[limits.is_forced]] = True
    return Limits(
        site_index=np.arange(limits.n_sites),
        site_capacity=np.ones(limits.n_sites, dtype=np.int64),
        budget_units=limits.budget_units,
        budget_eur=limits.budget_eur,
        unit_cost_eur=limits.site_cost_eur + np.where(room > 0, cheapest_eur, 0.0),
        is_forced=is_forced,
        is_forbidden=room == 0,
        rivals=limits.rivals,
    )


class SiteWalk:
    """A walk behind sets of sites: through their sets of poses within the limits.

    Parameters
    ----------
    reduced : ReducedProblem
        The problem.
    root : Root
        Its covering problem, for sets of so many units.
    sites : SiteSets
        The sets of sites.
    needs
        What :class:`placement.optimiser.walk.SetWalk` is asked for.
    """

    def __init__(
        self, reduced: ReducedProblem, root: Root, sites: SiteSets, **needs: Any
    ) -> None:
        self.limits = reduced.limits
        self.root = root
        self.sites = sites
        self.walk = SetWalk(reduced, root, **needs)
        self.is_finished = False

    @property
    def least(self) -> float:
        """Value that whole sets must reach by now."""
        from .walk_kernels import WHOLE

        return self.walk.total - float(self.walk.losses.may_lose[WHOLE])

    def raise_needs(self, need: float, left: float = 0.0) -> None:
        """Ask for more from here on."""
        self.walk.raise_needs(need, left)

    def blocks(self, deadline: Deadline) -> Iterator[IntArray]:
        """Sets that meet the needs, many at a time, until the deadline.

        Yields
        ------
        sets : (n_sets, n_units) int
            Poses of the reduced problem; one set may come up more than once.
        """
        for block in self._all_blocks(deadline):
            if len(block):
                block = block[are_allowed(self.limits, block)]
            yield block
        self.is_finished = not deadline.is_over

    def _all_blocks(self, deadline: Deadline) -> Iterator[IntArray]:
        """Blocks that may have sets that cannot be paid."""
        walk = self.walk
        if walk.n_units == 0:
            yield walk.forced[None, :]
            return
        if walk.n_units == 1:
            yield from walk.blocks(deadline)
            return
        n_sets = len(self.sites.apr)
        for begin in range(0, n_sets, constants.BLOCK_SITES):
            end = min(begin + constants.BLOCK_SITES, n_sets)
            walk.starts = iter(self._reaching(begin, end, deadline))
            yield from walk.blocks(deadline)

    def _reaching(self, first: int, last: int, deadline: Deadline) -> BoolArray:
        """Sites of sets first .. last - 1 whose relaxation reaches what is needed.

        (n, n_sites). Prices that bound one set of sites are good for the next one.
        """
        covers = self.walk.covers
        reward = reward_of(self.root.choice.n_units, 0)
        least = self.least
        may = self.sites.apr[first:last] >= least
        is_used = self.sites.is_used[first:last][may]
        kept = np.ones(len(is_used), dtype=bool)

        def bound(begin: int, end: int) -> None:
            price = self.root.price
            for number in range(begin, end):
                if deadline.is_over:
                    return
                here = is_used[number][covers.site]
                choice = self.root.choice._replace(
                    is_open=np.ones(int(here.sum()), dtype=np.int64),
                    cost=np.empty(0),
                    site=covers.site[here],
                )
                part = replace(
                    self.root, covers=covers.covers[here], price=price, choice=choice
                )
                # Few steps suffice for most.
                for n_steps in constants.SITE_STEPS:
                    part = tightened(part, reward, n_steps=n_steps)
                    kept[number] = part.limit >= least
                    if not kept[number]:
                        break
                price = part.price

        share_out(bound, len(is_used), workers=self.walk.reduced.workers, few=2)
        return is_used[kept]


def tied_by_sites(
    search: "Search", n_failures: int, find_tied: FindTied
) -> tuple[Tied | None, Contenders | None]:
    """Sets that tie at the best value of a stage, by walks behind sets of sites.

    Parameters
    ----------
    search : Search
        The best set so far, which is replaced by better ones.
    n_failures : int
        Units that fail in this stage; 0 if it is the APR.
    find_tied : callable
        Looks for all ties of so many failures by walks through sets of one size.

    Returns
    -------
    tied : Tied or None
        Best value and bound; None if nothing was walked. Its sets are contenders.
    contenders : Contenders or None
        The sets that tie; None if they are too many, or were not all looked at.
    """
    reduced = search.reduced
    limits = reduced.limits
    is_floor_known = not reduced.floors or least_apr(reduced) is not None
    is_open = limits.budget_eur is not None and not reduced.objectives[0].is_minimised
    is_by_mean = reduced.measure.is_mean and len(reduced.weight) > 0
    has_both = bool(limits.is_forced.any()) and reduced.survive > 0
    if not (is_open and is_floor_known and is_by_mean) or has_both:
        return None, None
    deadline = search.deadline.of("walk")
    least = search.value.apr
    if n_failures:
        least = search.least_apr
        if reduced.survive:
            least = least_apr(reduced) or 0.0
    sites = find_site_sets(reduced, least=least, deadline=deadline)
    if sites is None or not len(sites.apr) or not may_walk(sites):
        return None, None
    rows = run_rows(reduced)
    limit = search.left(n_failures)
    is_finished = True
    tied_sets: list[IntArray] | None = []
    for n_units in range(int(sites.most.max()), int(sites.fewest.min()) - 1, -1):
        mine = sites.of((sites.fewest <= n_units) & (n_units <= sites.most))
        part = replace(reduced, limits=replace(limits, budget_units=n_units))
        root = find_root(part, rows, n_units=n_units, deadline=deadline)
        if root.limit < least - TIES_OF_TIES * TOLERANCE:
            continue
        walk_of = partial(SiteWalk, sites=mine)
        tied = find_tied(n_failures, part, root, walk_of)
        limit = max(limit, tied.limit)
        is_finished &= tied.is_finished
        if tied.sets is None:
            tied_sets = None
        elif tied_sets is not None:
            tied_sets.append(tied.sets)
    value = search.left(n_failures)
    contenders = None
    if tied_sets is not None:
        contenders = Contenders(reduced.objectives)
        for sets in tied_sets:
            best_of_tied(
                reduced, sets, n_failures=n_failures, value=value, among=contenders
            )
    return Tied(None, value, max(limit, value), is_finished), contenders


def may_walk(sites: SiteSets) -> bool:
    """True if a walk through the largest sets may end."""
    return int(sites.most.max(initial=0)) <= constants.MAX_WALK_UNITS
