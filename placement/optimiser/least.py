"""The fewest units, or the least money, that reach the floors: walks size by size.

The cheapest set is looked for in the order of what sites and units cost at least: what
comes next bounds all that has not been looked at.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from geometry.arrays import IntArray
from geometry.phrases import Phrase

from . import constants
from .allowed_sets import are_allowed, costs_eur
from .bitsets import set_values
from .bounds import Rows, find_root, run_rows
from .constants import COST_TOLERANCE_EUR, TOLERANCE, Deadline
from .greedy import forced_units
from .presolve import ReducedProblem
from .problem import Requirement
from .site_walk import SiteSets, SiteWalk, find_site_sets, may_walk
from .walk import SetWalk

if TYPE_CHECKING:
    from .proof import Search


def fewest_units(search: "Search", fewest: int) -> int:
    """Lower bound of the units of a layout that reaches the floors.

    `fewest` is such a bound. All sets of ever more units are walked through, until some
    reach the floors, which is the best set then, or the time is up.
    """
    reduced = search.reduced
    if not (search.is_exact and reduced.floors and len(reduced.weight)):
        return fewest
    deadline = search.deadline.of("walk")
    fewest = max(fewest, int(reduced.limits.is_forced.sum()))
    most = min(len(search.found) - 1, constants.MAX_WALK_UNITS)
    while fewest <= most and not deadline.is_over:
        search.proofs[Phrase("branch and bound")] = None
        units, is_finished = find_of_size(reduced, fewest, deadline=deadline)
        if units is not None:
            search.keep(units)
            break
        if not is_finished:
            break
        fewest += 1
    return fewest


def find_of_size(
    reduced: ReducedProblem, n_units: int, *, deadline: Deadline
) -> tuple[IntArray | None, bool]:
    """A set of exactly so many units within the limits that reaches the floors.

    There is at least one floor, and no set has fewer units than there are forced
    poses.

    Returns
    -------
    units : (n_units,) int or None
        Poses of the reduced problem; None if none was found.
    is_complete : bool
        True if all sets were gone through: then None proves that there is none.

    Notes
    -----
    The walk is one for the hardest floor; what it asks for is necessary: the APR as
    a mean over all worlds, and what is left when units fail, though sites may. What
    it meets is looked at exactly.
    """
    forced = forced_units(reduced)
    if n_units <= len(forced):
        return _first_that_will_do(reduced, forced[None, :]), True

    floor, counted, rows = of_hardest_floor(reduced)
    root = find_root(counted, rows, n_units=n_units, deadline=deadline)
    if root.limit < floor.least - TOLERANCE:
        return None, True
    need = floor.least - TOLERANCE
    n_failures = 0
    left = 0.0
    if floor.n_failures < n_units and not len(forced):
        n_failures = floor.n_failures
        left = need
    walk = SetWalk(counted, root, need=need, n_failures=n_failures, left=left)
    for block in walk.blocks(deadline):
        units = _first_that_will_do(reduced, block)
        if units is not None:
            return units, False
    return None, walk.is_finished


def of_hardest_floor(
    reduced: ReducedProblem,
) -> tuple[Requirement, ReducedProblem, Rows]:
    """The hardest floor, and the problem and rows of what it counts.

    That is the mean over all worlds.
    """

    def hardness(floor: Requirement) -> float:
        return floor.least / max(floor.measure.limit, constants.TINY)

    floor = max(reduced.floors, key=hardness)
    counted = replace(reduced, measure=replace(floor.measure, tail=1.0))
    rows = run_rows(counted)
    return floor, counted, rows.of(rows.weight > 0.0)


def _first_that_will_do(reduced: ReducedProblem, sets: IntArray) -> IntArray | None:
    """First of some sets, (n_sets, n_units), that is allowed and reaches the floors."""
    if not sets.size:
        return None
    for begin in range(0, len(sets), constants.BLOCK_SETS):
        part = sets[begin : begin + constants.BLOCK_SETS]
        part = part[are_allowed(reduced.limits, part)]
        if not len(part):
            continue
        lacking = set_values(reduced, part).lacking
        will_do = np.flatnonzero(lacking == 0.0)
        if len(will_do):
            return np.sort(part[will_do[0]])
    return None


def least_cost_eur(search: "Search") -> float:
    """Lower bound of the cost of a set that reaches the floors, in euros.

    The cheapest set that is found on the way is kept.
    """
    reduced = search.reduced
    cost_eur = search.value.cost_eur
    if not (search.is_exact and reduced.floors and len(reduced.weight)):
        return 0.0
    deadline = search.deadline.of("least cost")
    floor, counted, rows = of_hardest_floor(reduced)
    need = floor.least - TOLERANCE
    cheaper = _cheaper_than(cost_eur, reduced)
    counted = replace(counted, limits=cheaper.limits)
    sites = find_site_sets(counted, least=need, deadline=deadline)
    if sites is None or not may_walk(sites):
        return 0.0
    search.proofs[Phrase("branch and bound")] = None
    n_forced = int(reduced.limits.is_forced.sum())
    walks: dict[int, SiteWalk | None] = {}
    for least_eur, n_units, some in _in_order_of_cost(sites, n_forced):
        if least_eur >= cost_eur - COST_TOLERANCE_EUR:
            break
        if deadline.is_over:
            return least_eur
        if n_units not in walks:
            walks[n_units] = None
            root = find_root(counted, rows, n_units=n_units, deadline=deadline)
            if root.limit >= need:
                n_failures = 0
                if floor.n_failures < n_units and not n_forced:
                    n_failures = floor.n_failures
                walks[n_units] = SiteWalk(
                    counted, root, sites, need=need, n_failures=n_failures, left=need
                )
        walk = walks[n_units]
        if walk is None:
            continue
        walk.sites = sites.of(some)
        walk.limits = cheaper.limits
        for block in walk.blocks(deadline):
            if not len(block):
                continue
            block = block[set_values(reduced, block).lacking == 0.0]
            if not len(block):
                continue
            search.keep(block[costs_eur(reduced.limits, block).argmin()])
            cost_eur = search.value.cost_eur
            cheaper = _cheaper_than(cost_eur, reduced)
            walk.limits = cheaper.limits
            if cost_eur <= least_eur + COST_TOLERANCE_EUR:
                return cost_eur
        if not walk.is_finished:
            return least_eur
    return cost_eur


def _in_order_of_cost(
    sites: SiteSets, n_forced: int
) -> Iterator[tuple[float, int, IntArray]]:
    """Sets of sites and numbers of units by what they cost at least.

    Yields
    ------
    least_eur : float
        Price of the sites and of so many cheapest units there. [EUR]
    n_units : int
        How many units.
    some : (n,) int
        Sets of sites of which it is true.
    """
    n_least = np.maximum(sites.is_used.sum(axis=1), max(n_forced, 1))
    n_each = sites.most - n_least + 1
    index = np.repeat(np.arange(len(n_each)), n_each)
    first = np.repeat(np.cumsum(n_each) - n_each, n_each)
    n_units = n_least[index] + np.arange(len(index)) - first
    cost_eur = sites.cost_eur[index] + (n_units - n_forced) * sites.unit_eur[index]
    ties = np.rint(cost_eur / COST_TOLERANCE_EUR)
    # What reaches most alone is most likely to do with few units.
    order = np.lexsort((-sites.apr[index], n_units, ties))
    ends = np.flatnonzero((np.diff(ties[order]) != 0) | (np.diff(n_units[order]) != 0))
    for some in np.split(order, ends + 1):
        if len(some):
            yield float(cost_eur[some].min()), int(n_units[some[0]]), index[some]


def _cheaper_than(cost_eur: float, reduced: ReducedProblem) -> ReducedProblem:
    """The problem for sets that cost less, by more than a tie."""
    most_eur = max(cost_eur - 2.0 * COST_TOLERANCE_EUR, 0.0)
    if reduced.limits.budget_eur is not None:
        most_eur = min(most_eur, reduced.limits.budget_eur)
    return replace(reduced, limits=replace(reduced.limits, budget_eur=most_eur))
