"""Front of a junction: its points, and steps that no layout exceeds."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations, pairwise
from math import comb

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError, Unquoted

from ..detection_table import DetectionTable
from ..optimiser import Effort, Limits, PlacementProblem, presolve
from ..optimiser.bitsets import BestSet, best_with_each, set_values
from ..optimiser.constants import COST_TOLERANCE_EUR, TOLERANCE, deadline_in
from ..optimiser.front import pareto_front
from ..optimiser.greedy import extend_greedily, forced_units, improve, to_full
from ..optimiser.presolve import ReducedProblem
from ..optimiser.problem import Objective, PlacementValue, improves
from ..optimiser.proof import Search

# ---------- one junction
_WORTH = ("apr", "apr_one_failed", "smallest_margin_s", "mean_margin_s")
Steps = tuple[tuple[float, float], ...]
"""From which units or euros on, up to the next step, which APR is not exceeded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A layout that a junction may get, by what it takes and what it is worth."""

    units: int  # New ones: the existing ones are not counted
    cost_eur: float  # Of the new units and their sites. [EUR]
    # As :class:`placement.optimiser.PlacementValue` has them, with the existing units
    apr: float
    apr_one_failed: float
    smallest_margin_s: float
    mean_margin_s: float

    @property
    def _worth(self) -> dict[Objective, float]:
        return {Objective(name): getattr(self, name) for name in _WORTH}

    def is_beaten_by(self, other: "Point") -> bool:
        """True if another point takes no more and is no worse, objective by objective."""
        return (
            other.units <= self.units
            and other.cost_eur <= self.cost_eur + COST_TOLERANCE_EUR
            and not improves(self._worth, other._worth)
        )


NOTHING = Point(units=0, cost_eur=0.0, **dict.fromkeys(_WORTH, 0.0))
"""A junction where nothing is mounted."""


def point_of(value: PlacementValue, *, units: int, cost_eur: float) -> Point:
    """A point that takes so much, by what its layout is worth."""
    worth = {name: getattr(value, name) for name in _WORTH}
    return Point(units=units, cost_eur=cost_eur, **worth)


@dataclass(frozen=True, slots=True, kw_only=True)
class JunctionFront:
    """Layouts that a junction may get, and bounds that no layout there exceeds."""

    points: tuple[Point, ...]  # the first takes nothing
    # from so many new units on, up to the next step, no layout has a higher APR
    by_units: Steps
    by_cost: (
        Steps  # from so many euros on, up to the next step, no layout has a higher APR
    )

    def __post_init__(self) -> None:
        if not self.points or self.points[0].units or self.points[0].cost_eur:
            raise InputError(
                "front", Unquoted("no point without units"), "it as the first"
            )
        for name in ("by_units", "by_cost"):
            steps = getattr(self, name)
            if not steps or steps[0][0] != 0:
                raise InputError(f"front.{name}", steps[:1], "steps from 0 on")
            if any(a[0] >= b[0] or a[1] > b[1] + TOLERANCE for a, b in pairwise(steps)):
                raise InputError(f"front.{name}", steps, "steps that rise")


def build_junction_front(
    points: Iterable[Point],
    *,
    by_units: Sequence[tuple[float, float]],
    by_cost: Sequence[tuple[float, float]],
) -> JunctionFront:
    """A front of the points that no other one beats, with steps that rise.

    A point without new units is among them; `by_units` and `by_cost` are steps (from,
    APR) from 0 on, ascending, in any order of APR.
    """
    found = sorted(points, key=lambda point: (point.units, point.cost_eur, -point.apr))
    kept = [
        point
        for index, point in enumerate(found)
        if not any(
            point.is_beaten_by(other)
            and (not other.is_beaten_by(point) or before < index)
            for before, other in enumerate(found)
            if before != index
        )
    ]
    return JunctionFront(
        points=tuple(kept), by_units=lowered(by_units), by_cost=lowered(by_cost)
    )


def value_at(steps: Sequence[tuple[float, float]], place: float) -> float:
    """The bound of the step in which a number of units, or an amount, lies."""
    return next(bound for start, bound in reversed(steps) if start <= place)


def lowest(steps: Sequence[Steps]) -> Steps:
    """Bounds of which each is the least of several that hold."""
    starts = sorted({start for each in steps for start, _ in each})
    return tuple(
        (start, min(value_at(each, start) for each in steps)) for start in starts
    )


def lowered(steps: Sequence[tuple[float, float]]) -> Steps:
    """Steps that rise: what holds for more holds for less; steps that say the same are one."""
    least = np.minimum.accumulate([bound for _, bound in reversed(steps)])[::-1]
    rising: list[tuple[float, float]] = []
    for (start, _), bound in zip(steps, least.tolist(), strict=True):
        if not rising or bound > rising[-1][1] + TOLERANCE:
            rising.append((start, bound))
    return tuple(rising)


# ---------- many junctions, as arrays
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Options:
    """Options of many junctions, one per row."""

    junction: (
        IntArray  # (n,): ascending, 0, 1, 2 ..; each junction has an option at least
    )
    units: IntArray  # (n,): new units
    cost_eur: FloatArray  # (n,): of these. [EUR]
    # apr, apr_one_failed, smallest_margin_s, mean_margin_s: (n,): what the option is
    # worth, see :class:`Point`
    apr: FloatArray
    apr_one_failed: FloatArray
    smallest_margin_s: FloatArray
    mean_margin_s: FloatArray

    def __len__(self) -> int:
        return len(self.junction)

    @property
    def n_junctions(self) -> int:
        """Number of junctions."""
        if len(self.junction):
            return int(self.junction[-1]) + 1
        return 0

    def taken(self, rows: IntArray) -> "Options":
        """Some of the options, by rows in ascending order; each junction keeps one at least."""
        return Options(**{name: getattr(self, name)[rows] for name in self.__slots__})


_VALUES = ("cost_eur", *_WORTH)


def stack_fronts(fronts: Sequence[JunctionFront]) -> Options:
    """The points of many fronts as options."""
    points = [point for front in fronts for point in front.points]
    return Options(
        junction=np.repeat(
            np.arange(len(fronts)), [len(front.points) for front in fronts]
        ),
        units=np.array([point.units for point in points]),
        **{
            name: np.array([getattr(point, name) for point in points])
            for name in _VALUES
        },
    )


def stack_bounds(
    fronts: Sequence[JunctionFront], *, counts_units: bool, counts_cost: bool
) -> Options:
    """Upper bounds of layouts other than the points, as options whose other values are 0.

    Each layout of a junction takes at least as much as one of them and has no higher
    APR. With units and cost counted, an option stands for a step of both.
    """
    rows = []
    for index, front in enumerate(fronts):
        if counts_units:
            by_units = front.by_units
        else:
            by_units = ((0, front.by_units[-1][1]),)
        if counts_cost:
            by_cost = front.by_cost
        else:
            by_cost = ((0.0, front.by_cost[-1][1]),)
        for row, (n_units, most) in enumerate(by_units):
            for column, (eur, bound) in enumerate(by_cost):
                value = min(most, bound)
                # Fewer units, or less money, may bound it as well.
                is_bound = row and min(by_units[row - 1][1], bound) == value
                if not is_bound and not (
                    column and min(most, by_cost[column - 1][1]) == value
                ):
                    rows.append((index, n_units, eur, value))
    junction, units, cost_eur, apr = np.array(rows).T
    unknown = np.zeros(len(rows))
    return Options(
        junction=junction.astype(np.int64),
        units=units.astype(np.int64),
        cost_eur=cost_eur,
        apr=apr,
        apr_one_failed=unknown,
        smallest_margin_s=unknown,
        mean_margin_s=unknown,
    )


# ---------- what few sites can do
_MAX_SETS = 12_000
_MAX_TIERS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SiteFront:
    """Layouts and bounds of so many sites with more units than one."""

    # APR that no layout exceeds whose new units are at 0, 1, 2 .. sites; more sites are
    # not bounded
    limits: tuple[float, ...]
    # good ones with fewer sites than new units: rows of the detection table, with the
    # existing ones
    layouts: tuple[tuple[int, ...], ...]

    def limit(self, n_sites: int) -> float:
        """Upper bound of the APR of layouts at so many sites."""
        if n_sites < len(self.limits):
            return self.limits[n_sites]
        return 1.0


def rooms_of(limits: Limits) -> IntArray:
    """New units that each site can carry, (n_sites,)."""
    sites = limits.site_index
    n_existing = np.bincount(sites[limits.is_forced], minlength=limits.n_sites)
    is_free = ~limits.is_forced & ~limits.is_forbidden
    room: IntArray = np.minimum(
        limits.site_capacity - n_existing,
        np.bincount(sites[is_free], minlength=limits.n_sites),
    )
    return room


def front_by_sites(
    problem: PlacementProblem,
    *,
    base_apr: float,
    max_units: int,
    effort: Callable[[], Effort],
) -> SiteFront:
    """Layouts of more new units than sites, and what bounds them, for up to `max_units` new units.

    The problem has no floors, and its prices do not count. `base_apr` is that of the
    existing units; `effort` says what the next step may take. No bounds where each unit
    confirms alone.
    """
    limits = problem.limits
    room = rooms_of(limits)
    if room.max(initial=0) < 2:
        return SiteFront(limits=(base_apr,), layouts=())
    # A site counts 1, in place of money.
    has_existing = (
        np.bincount(limits.site_index[limits.is_forced], minlength=limits.n_sites) > 0
    )
    counted = replace(
        problem,
        limits=replace(
            limits,
            budget_eur=None,
            unit_cost_eur=np.zeros(limits.n_poses),
            site_cost_eur=np.where(has_existing, 0.0, 1.0),
        ),
    )
    reduced = presolve(counted)
    is_free = ~reduced.limits.is_forced & (room[reduced.limits.site_index] > 0)
    if (
        not is_free.any()
    ):  # what remains is mounted already, or where there is no more room
        return SiteFront(limits=(base_apr,), layouts=())
    most = int(room.max())
    bounds, full, are_best = _front_of_full_sites(
        counted, reduced, room, max_sites=-(-max_units // most), effort=effort
    )
    layouts: dict[tuple[int, int], tuple[int, ...]] = {}
    n_existing = int(limits.is_forced.sum())
    widest = np.sort(room)[::-1]
    for n_sites in range(1, min(max_units, int((room > 0).sum()) + 1)):
        for n_units in range(
            n_sites + 1, min(max_units, int(widest[:n_sites].sum())) + 1
        ):
            within = replace(
                counted.limits,
                budget_units=n_units + n_existing,
                budget_eur=float(n_sites),
            )
            at = replace(reduced, limits=within.of_poses(reduced.pose_index))
            parts = _parts_of(full.get(n_sites, ()), limits, n_units + n_existing)
            if are_best and n_units == widest[:n_sites].sum() and parts:
                layouts[n_sites, n_units] = parts[0]  # the best one there is
                continue
            fewer = ((n_sites, n_units - 1), (n_sites - 1, n_units))
            starts = [*parts, *(layouts[key] for key in fewer if key in layouts)]
            layouts[n_sites, n_units] = _improved(at, starts, effort())
    return SiteFront(
        limits=tuple(np.maximum.accumulate([base_apr, *bounds]).tolist()),
        layouts=tuple(layouts.values()),
    )


def price_tiers_eur(limits: Limits) -> list[tuple[float, float]]:
    """Lowest and highest price of the sites in each tier, cheap ones first; three tiers at most."""
    prices = np.unique(limits.site_cost_eur[rooms_of(limits) > 0]).tolist()
    own = [(price, price) for price in prices[:_MAX_TIERS]]
    if len(prices) <= _MAX_TIERS:
        return own
    return [*own[:-1], (prices[_MAX_TIERS - 1], prices[-1])]


def bounds_by_money(
    limits: Limits, tiers: Sequence[tuple[float, Steps, SiteFront]]
) -> Steps:
    """Upper bound of the APR by money: by the units and sites that it buys at most.

    So many new units at so many sites, the dearest of some tier, cost at least what the
    cheapest ones and one site of that tier do, and do no more than sites up to that
    tier can. Of each tier, all sites first: the lowest price of its sites, and bounds
    by new units and by their sites.
    """
    free = ~limits.is_forbidden & ~limits.is_forced
    room = rooms_of(limits)
    units = np.cumsum(np.sort(limits.unit_cost_eur[free]))
    cheapest = np.cumsum([0.0, *np.sort(limits.site_cost_eur[room > 0])])
    carried = np.cumsum(np.sort(room[room > 0])[::-1])
    max_units = limits.budget_new_units
    assert max_units is not None
    least = {0.0: tiers[0][1][0][1]}
    for own_eur, by_units, by_sites in tiers:
        for n_sites, most in enumerate(carried, start=1):
            for n_units in range(n_sites, min(max_units, int(most)) + 1):
                eur = round(
                    float(own_eur + cheapest[n_sites - 1] + units[n_units - 1]), 6
                )
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

    They are where poses are columns one by one; of a class the pose that adds most is
    taken.
    """
    limits = problem.limits
    table = problem.table
    free = reduced.pose_index[~limits.is_forced[reduced.pose_index]]
    at_site = [
        free[limits.site_index[free] == site].tolist() for site in range(limits.n_sites)
    ]
    sizes = [min(len(here), int(room[site])) for site, here in enumerate(at_site)]
    if problem.fusion != "any" or not len(free):
        return [], {}, False
    classes = _classes_of(table, at_site, sizes)
    existing = np.flatnonzero(limits.is_forced).tolist()
    sets = [
        (site, chosen)
        for site, (here, size) in enumerate(zip(classes, sizes, strict=True))
        for chosen in combinations(here, min(size, len(here)))
        if size
    ]
    n_sets = len(sets)
    packed = np.empty((n_sets, table.packed.shape[1]), dtype=np.uint8)
    for row, (_, chosen) in enumerate(sets):
        together = [*chain.from_iterable(chosen), *existing]
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
    bounds = []
    layouts = {}
    for point in pareto_front(of_sets, max_units=max_sites, effort=effort()).points:
        bounds.append(point.apr_bound)
        chosen_classes = chain.from_iterable(sets[row][1] for row in point.pose_index)
        layouts[point.units] = _one_of_each(reduced, list(chosen_classes))
    return bounds, layouts, all(len(each) == 1 for here in classes for each in here)


def _one_of_each(
    reduced: ReducedProblem, classes: list[tuple[int, ...]]
) -> tuple[int, ...]:
    """Existing units, and of each class the pose that adds most to those before it."""
    units = forced_units(reduced)
    for poses in classes:
        members = np.searchsorted(reduced.pose_index, poses)
        units = best_with_each(reduced, units, members)
    return to_full(reduced, units)


def _classes_of(
    table: DetectionTable, at_site: list[list[int]], sizes: list[int]
) -> list[list[tuple[int, ...]]]:
    """Poses of each site one by one; where that makes too many sets, those together that see alike.

    A class sees what any of its poses does: bounds hold, but are higher.
    """
    n_sets = sum(
        comb(len(here), size) for here, size in zip(at_site, sizes, strict=True) if size
    )
    if n_sets <= _MAX_SETS:
        return [[(pose,) for pose in here] for here in at_site]
    from scipy.cluster.hierarchy import fcluster, linkage

    most = max(sizes)
    n_sites = sum(size > 0 for size in sizes)
    while (
        most < max(map(len, at_site))
        and n_sites * comb(most + 1, max(sizes)) <= _MAX_SETS
    ):
        most += 1
    classes: list[list[tuple[int, ...]]] = []
    for here in at_site:
        if len(here) <= most:
            classes.append([(pose,) for pose in here])
            continue
        seen = table.detected(here).astype(np.float32)
        number = fcluster(linkage(seen, "ward"), most, "maxclust")
        poses = np.array(here)
        classes.append(
            [tuple(poses[number == each].tolist()) for each in np.unique(number)]
        )
    return classes


def _parts_of(
    layout: tuple[int, ...], limits: Limits, n_units: int
) -> list[tuple[int, ...]]:
    """Layouts of so many units, among them all existing ones, out of a larger one."""
    existing = [pose for pose in layout if limits.is_forced[pose]]
    new = [pose for pose in layout if not limits.is_forced[pose]]
    n_new = n_units - len(existing)
    if not 0 < n_new <= len(new):
        return []
    return [tuple(sorted([*existing, *part])) for part in combinations(new, n_new)]


def _improved(
    reduced: ReducedProblem, starts: list[tuple[int, ...]], effort: Effort
) -> tuple[int, ...]:
    """A good layout within the limits, from the best of some smaller ones."""
    begin = [np.searchsorted(reduced.pose_index, layout) for layout in starts]
    best = BestSet()
    for units in begin or [forced_units(reduced)]:
        sets = extend_greedily(reduced, units)[None, :]
        best.offer(sets, set_values(reduced, sets))
    assert best.units is not None
    limit = Search(reduced).limit
    deadline = deadline_in(effort.time_limit_s)
    return to_full(reduced, improve(reduced, best.units, limit, deadline=deadline))
