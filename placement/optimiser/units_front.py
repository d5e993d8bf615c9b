"""What each further unit buys: the best layout of 1, 2, 3 .. units, each with its proof."""

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from geometry.errors import InputError

from ..layout import Certificate
from .feasibility import (
    UnmetError,
    check_floors,
    check_limits,
    check_reach,
)
from .front import (
    Front,
    FrontPoint,
    OnPoint,
    StageChoice,
    check_front,
    from_solution,
    largest_values,
    look_around,
    no_worse,
    prove_point,
    reaches,
    tightened,
)
from .large import is_large
from .milp import Effort
from .objectives import COST_TOLERANCE_EUR, TOLERANCE, Objective
from .presolve import ReducedProblem, presolve
from .problem import PlacementProblem, placement_value
from .solve import solve_placement

DEFAULT_MAX_UNITS = 8
_SHARES = 2  # a point may take this part of the time that is left: most leave some of it


def pareto_front(
    problem: PlacementProblem,
    *,
    max_units: int = DEFAULT_MAX_UNITS,
    min_units: int = 1,
    stages: StageChoice = "first",
    effort: Effort | None = None,
    on_point: OnPoint | None = None,
) -> Front:
    """Best layouts of so many units and all smaller numbers.

    Parameters
    ----------
    problem : PlacementProblem
        What to solve. All its limits and floors hold at every point but the number of units; kept
        units count.
    max_units, min_units : int
        Of the last and the first point; no point has fewer units than are forced.
    stages : {"first", "all"}
        "first": APR, then APR when one unit fails; "all": then margins and cost.
    effort : Effort, optional
        Of all points together: time that a point leaves is there for those after it. By default
        :class:`placement.optimiser.Effort`'s.
    on_point : callable, optional
        Called with every point as soon as it is solved; the next ones may still tighten its bounds.

    Returns
    -------
    front : Front
        A point for every number of units with which the wishes can be met. Once nothing can grow,
        and no more money is saved, the points that are left are copies.

    Raises
    ------
    InputError
        The wishes cannot be met with any number of units, or ask for more than the best.

    Notes
    -----
    Bounds are exchanged between points. A layout of K units is one of K + 1, too: what none of
    K + 1 exceeds, none of K does. That holds for a stage if both points hold the same in the stages
    before it. And what is left of K units when one fails is a layout of K - 1, which no wish binds
    if none is there.
    """
    check_front(problem, stages)
    effort = Effort() if effort is None else effort
    end_s = time.monotonic() + effort.time_limit_s
    limits = problem.limits
    first = max(min_units, int(limits.is_forced.sum()), 1)
    if not 1 <= first <= max_units:
        raise InputError("--max", max_units, f"a number of units, at least {first}")
    check_limits(replace(limits, budget_units=None), problem.table.pose_ids)
    # Poses that are dominated while many units are chosen are dominated while fewer are.
    widest = replace(problem, limits=replace(limits, budget_units=max_units))
    reduced = None if _is_too_large(problem, effort) else presolve(widest)
    largest = None if reduced is None else largest_values(reduced, stages)
    full = replace(limits, budget_units=None).max_units
    points: list[FrontPoint] = []
    refused: list[tuple[int, str]] = []
    error: UnmetError | None = None
    settled = None
    for units in range(first, max_units + 1):
        if points and (settled is not None or units > full):
            points.append(replace(points[-1], units=units))  # as good, and as well proven
            continue
        left_s = max(end_s - time.monotonic(), 1.0e-3) / min(max_units + 1 - units, _SHARES)
        share = replace(effort, time_limit_s=left_s)
        fewer = points[-1] if points else None
        at_point = replace(problem, limits=replace(limits, budget_units=units))
        try:
            point = _solve_point(at_point, reduced, fewer, effort=share, stages=stages)
        except UnmetError as found:
            error = found
            refused.append((units, str(found)))
            continue
        points.append(replace(point, units=units))
        if reaches(point.value, largest) and (stages == "first" or _is_cheap(problem, points[-1])):
            settled = units
        if on_point is not None:
            on_point(points[-1])
    if error is not None and not points:
        option = "--max" if error.where == "--budget" else error.where
        raise UnmetError(option, error.got, error.expected)
    if settled is None and full <= max_units and points[-1].is_proven:
        settled = max(points[0].units, full)
    points = _exchange_bounds(points, is_free=_is_free(problem))
    return Front(
        by="units",
        points=tuple(points),
        stages=stages,
        settled=_first_like_last(points, settled),
        refused=tuple(refused),
        presolve=None if reduced is None else reduced.statistics,
    )


def front_below(
    problem: PlacementProblem,
    pose_index: tuple[int, ...],
    certificate: Certificate,
    *,
    min_units: int = 1,
    effort: Effort | None = None,
    on_point: OnPoint | None = None,
) -> Front:
    """A front that ends with a layout that is known: what each of its units has bought.

    Parameters
    ----------
    problem : PlacementProblem
        What was solved: for the best.
    pose_index : tuple of int
        Its solution, ascending.
    certificate : Certificate
        The proof.
    min_units, effort, on_point
        As for :func:`pareto_front`; all stages are optimised.

    Returns
    -------
    front : Front
        Points of fewer units, then the one given.

    Raises
    ------
    InputError
        As :func:`pareto_front`, but where the wishes cannot be met with fewer units: there the
        front has the last point alone.
    """
    check_front(problem, "all")
    most = problem.limits.budget_units or len(pose_index)
    last = FrontPoint(
        units=most,
        pose_index=pose_index,
        value=placement_value(problem, pose_index),
        certificate=certificate,
    )
    alone = Front(by="units", points=(last,), stages="all", settled=None, refused=(), presolve=None)
    first = max(min_units, int(problem.limits.is_forced.sum()), 1)
    if first >= most:
        return alone
    try:
        fewer = pareto_front(
            problem,
            max_units=most - 1,
            min_units=first,
            stages="all",
            effort=effort,
            on_point=on_point,
        )
    except UnmetError:
        return alone
    last = no_worse(last, fewer.points[-1])
    points = _exchange_bounds([*fewer.points, last], is_free=_is_free(problem))
    return replace(fewer, points=tuple(points))


def _is_too_large(problem: PlacementProblem, effort: Effort) -> bool:
    """Whether every point is better solved by itself, from a pool of promising poses."""
    return effort.solver != "exact" and is_large(problem)


def _solve_point(
    problem: PlacementProblem,
    reduced: ReducedProblem | None,
    fewer: FrontPoint | None,
    *,
    effort: Effort,
    stages: StageChoice,
) -> FrontPoint:
    start = fewer.pose_index if fewer else ()
    if reduced is None:
        starts = [np.array(start)] if start else []
        solution = solve_placement(problem, effort=effort, starts=starts)
        point = from_solution(problem, solution, stages=stages)
        return point if fewer is None else no_worse(point, fewer)
    reduced = replace(reduced, limits=problem.limits.of_poses(reduced.pose_index))
    check_reach(problem, reduced)
    search = look_around(problem, reduced, effort=effort, stages=stages, start=start)
    check_floors(problem, search)
    return prove_point(problem, reduced, search, effort=effort, stages=stages, fewer=fewer)


def _is_cheap(problem: PlacementProblem, point: FrontPoint) -> bool:
    """Whether it is proven that no layout with more units costs less than a point's."""
    stage = point.stage(Objective.COST)
    prices = np.sort(problem.limits.unit_cost_eur[~problem.limits.is_forbidden])
    more_eur = float(prices[: point.units + 1].sum())
    return (
        stage is not None and stage.gap == 0.0 and stage.objective <= more_eur + COST_TOLERANCE_EUR
    )


def _is_free(problem: PlacementProblem) -> bool:
    """Whether every part of a layout is one, too: no wish asks for anything to be there."""
    limits = problem.limits
    return not (problem.floors or limits.is_forced.any() or limits.is_forced_site.any())


def _exchange_bounds(points: Sequence[FrontPoint], *, is_free: bool) -> list[FrontPoint]:
    """Points whose bounds are no worse than what those of other points imply."""
    tight = list(points)
    for index in reversed(range(len(points) - 1)):
        tight[index] = _bounded_by_next(tight[index], tight[index + 1])
    if is_free:
        for index, (fewer, point) in enumerate(pairwise(tight), start=1):
            bound = fewer.certificate.stages[0].bound
            if point.units == fewer.units + 1:
                tight[index] = _with_bounds(point, {Objective.APR_ONE_FAILED: bound})
    return tight


def _bounded_by_next(point: FrontPoint, following: FrontPoint) -> FrontPoint:
    bounds: dict[str, float] = {}
    for mine, theirs in zip(point.certificate.stages, following.certificate.stages, strict=True):
        bounds[mine.name] = theirs.bound
        if abs(mine.objective - theirs.objective) > TOLERANCE:
            break  # the stages after this one hold different things
    return _with_bounds(point, bounds)


def _with_bounds(point: FrontPoint, bounds: dict[str, float]) -> FrontPoint:
    certificate = point.certificate
    return replace(
        point,
        certificate=Certificate(
            stages=tuple(
                tightened(stage, bounds[stage.name]) if stage.name in bounds else stage
                for stage in certificate.stages
            ),
            solver=certificate.solver,
        ),
    )


def _first_like_last(points: Sequence[FrontPoint], settled: int | None) -> int | None:
    """The first number of units whose proven point is no worse than the settled one."""
    if settled is None:
        return None
    last = next(point for point in points if point.units == settled)
    for point in points:
        pairs = zip(point.certificate.stages, last.certificate.stages, strict=True)
        if point.is_proven and all(abs(a.objective - b.objective) <= TOLERANCE for a, b in pairs):
            return point.units
    return settled
