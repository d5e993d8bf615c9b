"""Front of one junction of a city, by units and by money.

Bounds hold for all sums.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import IntArray
from geometry.clock import now_s
from geometry.errors import InputError, Unquoted
from geometry.phrases import Phrase
from geometry.scene import Scene

from ..candidates import CandidateGrid, build_candidates, load_candidate_grid
from ..compute import Compute
from ..layout import Layout, at_sites, check_layout
from ..optimiser import Effort, PlacementProblem, UnmetError, presolve
from ..optimiser.cost_front import cost_front
from ..optimiser.front import Front, largest_values, pareto_front
from ..optimiser.problem import Objective, PlacementValue, placement_value
from ..optimiser.solve import of_pool
from ..pipeline import assemble, pick_layout
from ..question import Question
from .fronts import (
    JunctionFront,
    SiteFront,
    Steps,
    bounds_by_money,
    build_junction_front,
    front_by_sites,
    lowered,
    lowest,
    point_of,
    price_tiers_eur,
    rooms_of,
)

_SHARE = 0.5
"""Of the optimiser's time that is left: for each part; most leave some of it."""
_LEAST_OPTIMISER_S = 2.0


class TimeUpError(RuntimeError):
    """A junction takes more time than it was given."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JunctionWishes:
    """How a junction's front is looked for.

    Attributes
    ----------
    grid : CandidateGrid
        Poses at each site.
    max_units : int
        Most new units.
    time_limit_s : float
        For all of it; of what is left after the detection table, the optimiser
        takes what the question allows it. [s]
    existing : Layout, optional
        What is mounted there already.
    """

    grid: CandidateGrid
    max_units: int
    time_limit_s: float
    existing: Layout | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolvedJunction:
    """A junction's front with its layouts, and the sizes of its question.

    Attributes
    ----------
    front : JunctionFront
        Points and bounds.
    layouts : tuple of Layout, optional
        Of each point, existing units too; None: nothing mounted.
    sites : int
        Number of sites.
    poses : int
        Number of candidate poses.
    runs : int
        Number of runs that are driven.
    possible_runs : int
        These, and those for which the junction has no room.
    frames : int
        Number of frames of all runs.
    seconds : dict of str to float
        Processor time of the thread that solved it, by stage. [s]
    """

    front: JunctionFront
    layouts: tuple[Layout | None, ...]
    sites: int
    poses: int
    runs: int
    possible_runs: int
    frames: int
    seconds: dict[str, float]


def solve_junction(
    scene: Scene, question: Question, wishes: JunctionWishes, *, compute: Compute
) -> SolvedJunction:
    """Find the front of a junction.

    Parameters
    ----------
    scene : Scene
        The junction.
    question : Question
        What is driven, and what sites cost.
    wishes : JunctionWishes
        How it is looked for.
    compute : Compute
        Seed, threads, cache.

    Returns
    -------
    solved : SolvedJunction
        The first point takes nothing.

    Raises
    ------
    InputError
        Nothing can be driven there, or no site can carry a unit.
    TimeUpError
        The time was up before there was a front.
    """
    # The watch ends the work when the time is up.
    watch = _Watch(wishes.time_limit_s, compute)
    compute = replace(compute, progress=watch)
    existing = wishes.existing
    if existing is not None:
        check_layout(existing, scene)
        existing = at_sites(existing, scene)
        wishes = replace(wishes, existing=existing)
    watch.begin("lay runs")
    assembly = assemble(
        replace(question, budget=_most_units(scene, question, wishes)),
        scene=scene,
        grid=wishes.grid,
        existing=existing,
        counts_money=True,
        compute=compute,
    )
    watch.begin("detection table")
    candidates = assembly.candidates
    problem = assembly.problem
    end_s = now_s() + min(watch.left_s(), question.time_limit_s)

    def effort() -> Effort:
        """Effort of the next step, from the time that is left."""
        left_s = max(end_s - now_s(), _LEAST_OPTIMISER_S)
        return Effort(
            solver=question.solver,
            gap=question.gap,
            time_limit_s=_SHARE * left_s,
            workers=compute.workers,
        )

    # No point may be worse than what the coarse grid reaches.
    rule = replace(load_candidate_grid(is_coarse=True), sensors=wishes.grid.sensors)
    extra = () if existing is None else existing.units
    coarse = {candidate.id for candidate in build_candidates(scene, rule, extra=extra)}
    first = np.flatnonzero([candidate.id in coarse for candidate in candidates])
    try:
        front, chosen = find_front(
            problem, effort=effort, begin=watch.begin, first=first
        )
    except UnmetError as error:
        raise InputError(error.where, error.got, error.expected) from None
    setting = assembly.setting
    refused = sum(len(one.speeds_kmh) for one in setting.refusals if one.is_possible)
    return SolvedJunction(
        front=front,
        layouts=tuple(
            pick_layout(candidates, index, f"front-{len(index)}") if index else existing
            for index in chosen
        ),
        sites=len(scene.sites),
        poses=len(candidates),
        runs=len(setting.runs),
        possible_runs=len(setting.runs) + refused * len(set(setting.axis.weathers)),
        frames=setting.axis.n_frames,
        seconds=watch.finish(),
    )


def find_front(
    problem: PlacementProblem,
    *,
    effort: Callable[[], Effort],
    begin: Callable[[str], None],
    first: IntArray | None = None,
) -> tuple[JunctionFront, list[tuple[int, ...]]]:
    """Front of what units and money buy, and the layout of each point.

    The first point takes nothing. The problem has a number of units, the existing
    ones among them, and no floors. `effort` says what the next step may take,
    `begin` is called with each step. No point is worse than what the poses `first`,
    (n,), the existing ones among them, can do. Layouts are rows of the table.
    """
    limits = problem.limits
    forced = tuple(np.flatnonzero(limits.is_forced).tolist())
    n_existing = len(forced)
    # What the VUT avoids by itself, where there are none.
    base = placement_value(problem, forced)

    def fronts_of(
        part: PlacementProblem, tell: Callable[[str], None]
    ) -> tuple[Front, SiteFront]:
        """Fronts by units and by sites of a part of the problem."""
        assert limits.budget_units is not None
        tell(Phrase("front by units"))
        by_units = pareto_front(
            part,
            max_units=limits.budget_units,
            min_units=max(n_existing, 1),
            effort=effort(),
        )
        tell(Phrase("front by sites"))
        most = limits.budget_units - n_existing
        by_sites = front_by_sites(
            part, base_apr=base.apr, max_units=most, effort=effort
        )
        return by_units, by_sites

    # Layouts of a few poses first, as further points.
    few: list[tuple[int, ...]] = []
    if first is not None and 0 < len(first) < limits.n_poses:
        begin(Phrase("front of few poses"))
        part = of_pool(problem, first)
        if (rooms_of(part.limits) > 0).any():
            _, found = find_front(part, effort=effort, begin=lambda _: None)
            few = [tuple(first[list(layout)].tolist()) for layout in found]
    fronts = [fronts_of(problem, begin)]
    by_cost = None
    tiers = price_tiers_eur(limits)
    free = ~limits.is_forbidden & ~limits.is_forced
    site_eur = limits.site_cost_eur[limits.site_index]
    # Where one unit, or one site, costs more than another, money is more than numbers.
    if np.ptp(limits.unit_cost_eur[free]) or np.ptp(site_eur[free]):
        begin(Phrase("fronts of cheap sites"))
        for _, highest_eur in reversed(tiers[:-1]):
            is_dear = (site_eur > highest_eur) & ~limits.is_forced
            cheap = replace(limits, is_forbidden=limits.is_forbidden | is_dear)
            fronts.append(fronts_of(replace(problem, limits=cheap), lambda _: None))
        begin(Phrase("front by money"))
        try:
            by_cost = cost_front(problem, effort=effort())
        except InputError as error:
            # Else the poses avoid nothing.
            if error.where != "candidates":
                raise
    # Tiers from all sites to the cheapest ones.
    lowest_eur = [least_eur for least_eur, _ in reversed(tiers)] or [0.0]
    return _merge(
        problem,
        list(zip(lowest_eur, fronts, strict=True)),
        by_cost,
        few,
        base,
        n_existing,
    )


def _most_units(scene: Scene, question: Question, wishes: JunctionWishes) -> int:
    """As many new units as are asked for, or as the sites have room for."""
    # Room of the sites that may be used, less the existing units.
    room = {
        site.id: (
            site.capacity_units
            if question.site_capacity is None
            else question.site_capacity
        )
        for site in scene.sites
        if site.use != "forbidden"
    }
    for unit in () if wishes.existing is None else wishes.existing.units:
        if unit.site_id in room:
            room[unit.site_id] = max(room[unit.site_id] - 1, 0)
    most = min(wishes.max_units, sum(room.values()))
    if most < 1:
        raise InputError(
            f"{scene.name}: sites", Unquoted("none with room"), "one that is free"
        )
    return most


# ---------- one front of all
def _merge(
    problem: PlacementProblem,
    tiers: list[tuple[float, tuple[Front, SiteFront]]],
    by_cost: Front | None,
    others: list[tuple[int, ...]],
    base: PlacementValue,
    n_existing: int,
) -> tuple[JunctionFront, list[tuple[int, ...]]]:
    """The points of all fronts that no other one beats, and the poses of each.

    `tiers` are fronts with all sites, then with cheaper ones, and the least of their
    prices; `others` are more layouts.
    """
    forced = tuple(np.flatnonzero(problem.limits.is_forced).tolist())
    # Points by what they take and are worth; the first layout of each counts.
    poses = {point_of(base, units=0, cost_eur=0.0): forced}
    layouts = [(placement_value(problem, layout), layout) for layout in others]
    if by_cost:
        layouts += [(found.value, found.pose_index) for found in by_cost.points]
    for _, (by_units, by_sites) in tiers:
        layouts += [(found.value, found.pose_index) for found in by_units.points]
        layouts += [
            (placement_value(problem, layout), layout) for layout in by_sites.layouts
        ]
    for value, layout in layouts:
        if n_new := len(layout) - n_existing:
            poses.setdefault(
                point_of(value, units=n_new, cost_eur=value.cost_eur), layout
            )
    # Bounds by units and sites of every tier, and by money.
    bounds = [
        (
            eur,
            _bounds_by_units(by_units, base=base.apr, n_existing=n_existing),
            by_sites,
        )
        for eur, (by_units, by_sites) in tiers
    ]
    unit_steps = bounds[0][1]
    steps = [bounds_by_money(problem.limits, bounds)]
    if by_cost is not None:
        reduced = presolve(problem)
        most = (largest_values(reduced, "first") or {}).get(Objective.APR, 1.0)
        step = float(reduced.weight[reduced.weight > 0.0].min(initial=1.0))
        steps.append(_bounds_by_cost(by_cost, base=base.apr, most=most, step=step))
    front = build_junction_front(poses, by_units=unit_steps, by_cost=lowest(steps))
    return front, [poses[point] for point in front.points]


def _bounds_by_units(front: Front, *, base: float, n_existing: int) -> Steps:
    """Upper bounds of the APR by new units."""
    steps = [
        (float(point.units - n_existing), max(point.apr_bound, base))
        for point in front.points
        if point.units > n_existing
    ]
    return lowered([(0.0, base), *steps])


def _bounds_by_cost(front: Front, *, base: float, most: float, step: float) -> Steps:
    """Upper bound of the APR by money.

    The first stage of a point says what is better than the point before it costs at
    least: better by the step of the front, so that up to a step more is not ruled out
    for less money.
    """
    steps: list[tuple[float, float]] = [(0.0, base)]

    def add(eur: float, bound: float) -> None:
        """Add a step; it replaces the last one unless it costs more."""
        before_eur, before = steps[-1]
        if eur <= before_eur:
            steps.pop()
            eur = before_eur
        steps.append((eur, max(bound, before)))

    points = front.points
    # Bounds rise from point to point.
    for index, point in enumerate(points):
        if index + 1 == len(points):
            beyond = most
        else:
            beyond = points[index + 1].apr_bound
        here = max(point.apr_bound, min(point.value.apr + step, beyond))
        add(point.certificate.stages[0].bound, here)
    if front.settled is None:
        add(points[-1].value.cost_eur, most)
    return tuple(steps)


# ---------- time
class _Watch:
    """Takes the time of each stage, and ends what takes too long."""

    def __init__(self, limit_s: float, compute: Compute) -> None:
        self._end_s = now_s() + limit_s
        self._limit_s = limit_s
        self._progress = compute.progress
        self._stage = "begin"
        self._began_s = time.process_time()
        self._seconds: dict[str, float] = {}

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        self._progress(stage, done, total)
        if self.left_s() < 0.0 and not self._stage.startswith("front"):
            raise TimeUpError(
                f"{self._limit_s:g} s were up in the stage '{self._stage}'"
            )

    def begin(self, stage: str) -> None:
        self._note()
        self._stage = stage
        self(stage, 0, 0)

    def _note(self) -> None:
        """Add the time since the last note to the current stage."""
        at_s = time.process_time()
        self._seconds[self._stage] = (
            self._seconds.get(self._stage, 0.0) + at_s - self._began_s
        )
        self._began_s = at_s

    def finish(self) -> dict[str, float]:
        self._note()
        return {
            name: round(s, 2) for name, s in self._seconds.items() if name != "begin"
        }

    def left_s(self) -> float:
        return self._end_s - now_s()
