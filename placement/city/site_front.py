"""What few sites can do: full sets of units at each, which bound what money buys at a junction.

A site is paid once, however many units it carries: money buys more sites, or more units at few of
them. So many units at so many sites avoid no more than the best layout of so many units, and no
more than the best layout of so many full sites. Both are maximal covering problems without prices,
which are proven in seconds where those with prices are not: for the second one, every full set of
poses at a site is one column, of which a site carries one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from math import comb

import numpy as np

from geometry.arrays import IntArray

from ..detection_table import DetectionTable
from ..optimiser import Effort, Limits, PlacementProblem, presolve
from ..optimiser.bitsets import set_values, values_with_each
from ..optimiser.front import pareto_front, without_margins
from ..optimiser.greedy import extend_greedily, forced_units, improve, to_full
from ..optimiser.objectives import Objective
from ..optimiser.presolve import ReducedProblem
from ..optimiser.stages import Search
from ..optimiser.steering import deadline_in
from .fronts import Steps, value_at

_MAX_SETS = 12_000
_MAX_TIERS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SiteFront:
    """What so many sites with more units than one can do.

    Attributes
    ----------
    limits : tuple of float
        APR that no layout exceeds whose new units hang at 0, 1, 2 .. sites; more sites are not
        bounded.
    layouts : tuple of tuple of int
        Good ones with fewer sites than new units: rows of the detection table, with those kept.
    """

    limits: tuple[float, ...]
    layouts: tuple[tuple[int, ...], ...]

    def limit(self, n_sites: int) -> float:
        """What no layout at so many sites exceeds."""
        return self.limits[n_sites] if n_sites < len(self.limits) else 1.0


def rooms_of(limits: Limits) -> IntArray:
    """New units that each site can carry, (n_sites,)."""
    sites = limits.site_index
    n_kept = np.bincount(sites[limits.is_forced], minlength=limits.n_sites)
    is_free = ~limits.is_forced & ~limits.is_forbidden
    room: IntArray = np.minimum(
        limits.site_capacity - n_kept, np.bincount(sites[is_free], minlength=limits.n_sites)
    )
    return room


def front_by_sites(
    problem: PlacementProblem, *, base_apr: float, max_units: int, effort: Callable[[], Effort]
) -> SiteFront:
    """Layouts of more new units than sites, and what bounds them.

    Parameters
    ----------
    problem : PlacementProblem
        Without floors; its prices do not count.
    base_apr : float
        Of what is kept.
    max_units : int
        New ones.
    effort : callable
        What the next step may take.

    Returns
    -------
    front : SiteFront
        With bounds up to as many sites as can carry `max_units`; without any where each unit has
        to confirm alone.
    """
    limits = problem.limits
    room = rooms_of(limits)
    if room.max(initial=0) < 2:
        return SiteFront(limits=(base_apr,), layouts=())
    # A site counts 1, in place of money.
    has_kept = np.bincount(limits.site_index[limits.is_forced], minlength=limits.n_sites) > 0
    counted = replace(
        problem,
        limits=replace(
            limits,
            budget_eur=None,
            unit_cost_eur=np.zeros(limits.n_poses),
            site_cost_eur=np.where(has_kept, 0.0, 1.0),
        ),
    )
    reduced = presolve(counted)
    is_free = ~reduced.limits.is_forced & (room[reduced.limits.site_index] > 0)
    if not is_free.any():  # what is left hangs already, or where there is no more room
        return SiteFront(limits=(base_apr,), layouts=())
    most = int(room.max())
    bounds, full, are_best = _front_of_full_sites(
        counted, reduced, room, max_sites=-(-max_units // most), effort=effort
    )
    layouts: dict[tuple[int, int], tuple[int, ...]] = {}
    n_kept = int(limits.is_forced.sum())
    widest = np.sort(room)[::-1]
    for n_sites in range(1, min(max_units, int((room > 0).sum()) + 1)):
        for n_units in range(n_sites + 1, min(max_units, int(widest[:n_sites].sum())) + 1):
            within = replace(
                counted.limits, budget_units=n_units + n_kept, budget_eur=float(n_sites)
            )
            at = replace(reduced, limits=within.of_poses(reduced.pose_index))
            parts = _parts_of(full.get(n_sites, ()), limits, n_units + n_kept)
            if are_best and n_units == widest[:n_sites].sum() and parts:
                layouts[n_sites, n_units] = parts[0]  # the best one there is
                continue
            fewer = [layouts.get(key) for key in _fewer(n_sites, n_units)]
            starts = [*parts, *(layout for layout in fewer if layout is not None)]
            layouts[n_sites, n_units] = _improved(at, starts, effort())
    return SiteFront(
        limits=tuple(np.maximum.accumulate([base_apr, *bounds]).tolist()),
        layouts=tuple(layouts.values()),
    )


def price_tiers_eur(limits: Limits) -> list[tuple[float, float]]:
    """Lowest and highest price of the sites in each tier, cheap ones first; three tiers at most."""
    prices = np.unique(limits.site_cost_eur[rooms_of(limits) > 0]).tolist()
    own = [(price, price) for price in prices[:_MAX_TIERS]]
    return own if len(prices) <= _MAX_TIERS else [*own[:-1], (prices[_MAX_TIERS - 1], prices[-1])]


def bounds_by_money(limits: Limits, tiers: Sequence[tuple[float, Steps, SiteFront]]) -> Steps:
    """What no layout for so much money exceeds: by the units and sites that so much buys at most.

    So many new units at so many sites, the dearest of which is of some tier, cost at least what the
    cheapest ones and one site of that tier do; they do no more than what sites up to that tier can.

    Parameters
    ----------
    limits : Limits
        With prices, and a number of units.
    tiers : sequence of (euros, Steps, SiteFront)
        Lowest price of a site of the tier; bounds by new units, and by their sites, where no site
        is dearer than those of the tier. The first one has all sites.

    Returns
    -------
    by_cost : sequence of (from, APR)
        Steps that rise. [EUR]
    """
    free = ~limits.is_forbidden & ~limits.is_forced
    room = rooms_of(limits)
    units = np.cumsum(np.sort(limits.unit_cost_eur[free]))
    cheapest = np.cumsum([0.0, *np.sort(limits.site_cost_eur[room > 0])])
    carried = np.cumsum(np.sort(room[room > 0])[::-1])
    assert limits.budget_units is not None
    max_units = limits.budget_units - int(limits.is_forced.sum())
    least = {0.0: tiers[0][1][0][1]}
    for own_eur, by_units, by_sites in tiers:
        for n_sites, most in enumerate(carried, start=1):
            for n_units in range(n_sites, min(max_units, int(most)) + 1):
                eur = round(float(own_eur + cheapest[n_sites - 1] + units[n_units - 1]), 6)
                bound = min(value_at(by_units, n_units), by_sites.limit(n_sites))
                least[eur] = max(least.get(eur, 0.0), bound)
    costs = sorted(least)
    bounds = np.maximum.accumulate([least[eur] for eur in costs])
    return tuple(zip(costs, bounds.tolist(), strict=True))


def _front_of_full_sites(
    problem: PlacementProblem,
    reduced: ReducedProblem,
    room: IntArray,
    *,
    max_sites: int,
    effort: Callable[[], Effort],
) -> tuple[list[float], dict[int, tuple[int, ...]], bool]:
    """Bounds for 1, 2 .. full sites, the layout of each number, and whether those are the best.

    They are where poses are columns one by one; of a class the pose that adds most is taken.
    """
    limits, table = problem.limits, problem.table
    free = reduced.pose_index[~limits.is_forced[reduced.pose_index]]
    at_site = [free[limits.site_index[free] == site].tolist() for site in range(limits.n_sites)]
    sizes = [min(len(here), int(room[site])) for site, here in enumerate(at_site)]
    if problem.fusion != "any" or not len(free):
        return [], {}, False
    classes = _classes_of(table, at_site, sizes)
    kept = np.flatnonzero(limits.is_forced).tolist()
    sets = [
        (site, chosen)
        for site, (here, size) in enumerate(zip(classes, sizes, strict=True))
        for chosen in combinations(here, min(size, len(here)))
        if size
    ]
    n_sets = len(sets)
    packed = np.empty((n_sets, table.packed.shape[1]), dtype=np.uint8)
    for row, (_, chosen) in enumerate(sets):
        together = [*chain.from_iterable(chosen), *kept]
        np.bitwise_or.reduce(table.packed[together], axis=0, out=packed[row])
    of_sets = replace(
        problem,
        table=DetectionTable(
            pose_ids=tuple(map(str, range(n_sets))), axis=table.axis, packed=packed
        ),
        limits=Limits(
            site_index=np.array([site for site, _ in sets]),
            site_capacity=np.ones(limits.n_sites, dtype=np.int64),
            rivals=limits.rivals,
        ),
    )
    max_sites = min(max_sites, len({site for site, _ in sets}))
    bounds, layouts = [], {}
    for point in pareto_front(of_sets, max_units=max_sites, effort=effort()).points:
        stage = point.stage(Objective.APR)
        assert stage is not None  # the first of all fronts
        bounds.append(stage.bound)
        chosen_classes = chain.from_iterable(sets[row][1] for row in point.pose_index)
        layouts[point.units] = _one_of_each(reduced, list(chosen_classes))
    return bounds, layouts, all(len(each) == 1 for here in classes for each in here)


def _one_of_each(reduced: ReducedProblem, classes: list[tuple[int, ...]]) -> tuple[int, ...]:
    """What is kept, and of each class the pose that adds most to those before it."""
    units = forced_units(reduced)
    for poses in classes:
        members = np.searchsorted(reduced.pose_index, poses)
        values = values_with_each(reduced, units)[members]
        units = np.append(units, members[values.best_row()])
    return to_full(reduced, units)


def _classes_of(
    table: DetectionTable, at_site: list[list[int]], sizes: list[int]
) -> list[list[tuple[int, ...]]]:
    """Poses of each site one by one; where that makes too many sets, those together that see alike.

    A class sees what any of its poses does: bounds hold, but are higher.
    """
    n_sets = sum(comb(len(here), size) for here, size in zip(at_site, sizes, strict=True) if size)
    if n_sets <= _MAX_SETS:
        return [[(pose,) for pose in here] for here in at_site]
    from scipy.cluster.hierarchy import fcluster, linkage

    most = max(sizes)
    n_sites = sum(size > 0 for size in sizes)
    while most < max(map(len, at_site)) and n_sites * comb(most + 1, max(sizes)) <= _MAX_SETS:
        most += 1
    classes: list[list[tuple[int, ...]]] = []
    for here in at_site:
        if len(here) <= most:
            classes.append([(pose,) for pose in here])
            continue
        seen = table.detected(here).astype(np.float32)
        number = fcluster(linkage(seen, "ward"), most, "maxclust")
        poses = np.array(here)
        classes.append([tuple(poses[number == each].tolist()) for each in np.unique(number)])
    return classes


def _parts_of(layout: tuple[int, ...], limits: Limits, n_units: int) -> list[tuple[int, ...]]:
    """Layouts of so many units, among them all that are kept, out of a larger one."""
    kept = [pose for pose in layout if limits.is_forced[pose]]
    new = [pose for pose in layout if not limits.is_forced[pose]]
    n_new = n_units - len(kept)
    if not 0 < n_new <= len(new):
        return []
    return [tuple(sorted([*kept, *part])) for part in combinations(new, n_new)]


def _fewer(n_sites: int, n_units: int) -> tuple[tuple[int, int], ...]:
    return (n_sites, n_units - 1), (n_sites - 1, n_units)


def _improved(
    reduced: ReducedProblem, starts: list[tuple[int, ...]], effort: Effort
) -> tuple[int, ...]:
    """A good layout within the limits, from the best of some smaller ones."""
    plain = without_margins(reduced)
    begin = [np.searchsorted(plain.pose_index, layout) for layout in starts]
    begin = begin or [forced_units(plain)]
    sets = [extend_greedily(plain, units) for units in begin]
    values = [set_values(plain, units[None, :]) for units in sets]
    best = 0
    for index, value in enumerate(values):
        if value[0].exceeds(values[best][0]):
            best = index
    limit = Search(plain).limit
    deadline = deadline_in(effort.time_limit_s)
    return to_full(plain, improve(plain, sets[best], limit, deadline=deadline))
