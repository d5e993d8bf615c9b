"""Fronts: the best layouts for more and more units, each with its proof.

A point is solved from the one before it: what was found for less is feasible for more.
So values never fall from point to point, and what no layout with more can exceed, none
with less can either.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, get_args

import numpy as np

from geometry.errors import InputError, check_one_of, refuse

from ..layout import Certificate, Stage
from .bitsets import union_apr
from .constants import COST_TOLERANCE_EUR, TOLERANCE, Effort, deadline_in
from .presolve import PresolveStatistics, ReducedProblem, presolve
from .problem import (
    VALUE_OBJECTIVES,
    Objective,
    PlacementProblem,
    PlacementValue,
    is_better,
    placement_value,
)
from .proof import Search
from .solve import (
    UnmetError,
    build_stage,
    check_limits,
    is_large,
    solve_placement,
)

StageChoice = Literal["first", "all"]
FIRST_STAGES = (Objective.APR, Objective.APR_ONE_FAILED)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrontPoint:
    """The best layout for so many units or so much money.

    Attributes
    ----------
    units : int
        On a front by units, those that were allowed: the layout may have fewer.
    pose_index : tuple of int
        Rows of the detection table, ascending.
    value : PlacementValue
        What the layout is worth.
    certificate : Certificate
        A stage for every objective that was optimised, in order.
    """

    units: int
    pose_index: tuple[int, ...]
    value: PlacementValue
    certificate: Certificate

    @property
    def seconds(self) -> float:
        """Time that the proofs took, in seconds."""
        return sum(stage.seconds for stage in self.certificate.stages)

    @property
    def is_proven(self) -> bool:
        """True if the gaps of all stages are closed."""
        return self.certificate.is_proven

    def stage(self, name: str) -> Stage | None:
        """The stage of a name; None if it was not optimised."""
        return next(
            (stage for stage in self.certificate.stages if stage.name == name), None
        )

    @property
    def apr_bound(self) -> float:
        """The APR that no layout exceeds there; it is a stage of every front."""
        stage = self.stage(Objective.APR)
        assert stage is not None
        return stage.bound

    def with_stages(self, stages: Iterable[Stage]) -> "FrontPoint":
        """The same layout with other stages."""
        return replace(
            self, certificate=replace(self.certificate, stages=tuple(stages))
        )

    def bounded(self, bounds: Mapping[str, float]) -> "FrontPoint":
        """The same layout with other bounds that hold as well, where closer."""
        return self.with_stages(
            tightened(stage, bounds.get(stage.name, stage.bound))
            for stage in self.certificate.stages
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Front:
    """Layouts for growing budgets.

    Attributes
    ----------
    by : {"units", "cost"}
        What the points are allowed more and more of.
    points : tuple of FrontPoint
        In ascending order, at least one; on a front by cost those at which something
        grows.
    stages : {"first", "all"}
        What was optimised: APR and the APR when one unit fails, or margins and cost,
        too.
    settled : float, optional
        Proven that from so many units, or euros, on nothing grows that was optimised,
        not even beyond the last point; None if that is not known.
    refused : tuple of (int, str)
        Numbers of units with which the wishes cannot be met, and why.
    presolve : PresolveStatistics, optional
        What dropped out before, once for all points; None if each was solved by itself.
    """

    by: Literal["units", "cost"]
    points: tuple[FrontPoint, ...]
    stages: StageChoice
    settled: float | None
    refused: tuple[tuple[int, str], ...]
    presolve: PresolveStatistics | None

    @property
    def is_proven(self) -> bool:
        """True if every point is."""
        return all(point.is_proven for point in self.points)


OnPoint = Callable[[FrontPoint], None]


def check_front(problem: PlacementProblem, stages: StageChoice) -> None:
    """Raise InputError if a front cannot be asked for in this way.

    A target or failures to survive are asked for, or `stages` are unknown.
    """
    check_one_of("stages", stages, get_args(StageChoice))
    if problem.goal != "best" or problem.survive:
        option = "target"
        if problem.goal == "best":
            option = "survive"
        refuse(option, "it with a front", "neither: a front has every APR")


def solve_point(
    problem: PlacementProblem,
    reduced: ReducedProblem | None,
    *,
    effort: Effort,
    n_stages: int,
    starts: Sequence[Sequence[int]] = (),
) -> FrontPoint:
    """The best layout for one point; only its first stages are proven.

    Parameters
    ----------
    problem : PlacementProblem
        The problem of the point.
    reduced : ReducedProblem, optional
        What was presolved for all points; None: it is presolved by itself.
    effort : Effort
        How hard to try.
    n_stages : int
        So many objectives are bounded.
    starts : sequence of sequence of int
        Layouts that are tried first, rows of the table.
    """
    if reduced is not None:
        reduced = reduced.for_problem(problem)
    solution = solve_placement(
        problem,
        reduced,
        effort=effort,
        starts=[np.array(start, dtype=np.int64) for start in starts],
        n_stages=n_stages,
    )
    return FrontPoint(
        units=len(solution.pose_index),
        pose_index=solution.pose_index,
        value=placement_value(problem, solution.pose_index),
        certificate=solution.certificate,
    )


def no_worse(point: FrontPoint, fewer: FrontPoint) -> FrontPoint:
    """A point; where the layout of the one before is better, that one.

    The bounds are those of the point in either case.
    """
    if not is_better(fewer.value, point.value):
        return point
    point = replace(point, pose_index=fewer.pose_index, value=fewer.value)
    return point.with_stages(
        tightened(
            replace(stage, objective=fewer.value.of(Objective(stage.name))), stage.bound
        )
        for stage in point.certificate.stages
    )


def largest_values(
    reduced: ReducedProblem, stages: StageChoice
) -> dict[Objective, float] | None:
    """Values that no layout of any size exceeds: those of all poses together.

    None if no limits of margins are known: they hold where all runs are avoided that
    some pose avoids, which only a mean over all runs ensures.
    """
    everything = np.bitwise_or.reduce(reduced.words, axis=0, keepdims=True)
    limits = {
        Objective.APR: float(union_apr(reduced, everything)[0]),
        Objective.APR_ONE_FAILED: one_failed_limit(reduced),
    }
    if stages == "all":
        if not reduced.measure.tells_runs_apart:
            return None
        most = Search(reduced).limit
        for objective in (Objective.SMALLEST_MARGIN, Objective.MEAN_MARGIN):
            limits[objective] = float(most.of(objective))
    return limits


def reaches(value: PlacementValue, limits: dict[Objective, float] | None) -> bool:
    """True if a value is as large as limits that none exceeds."""
    return limits is not None and all(
        value.of(objective) >= limit - TOLERANCE for objective, limit in limits.items()
    )


def one_failed_limit(reduced: ReducedProblem) -> float:
    """No set of any size keeps a higher APR when one unit fails.

    Of a set with pose c, the others are left when c fails; of one without it, more is
    left than when it had c, too. So no set keeps more than all poses but c reach,
    whichever c is.
    """
    words = reduced.words
    # What each pose and those before it see.
    before = np.bitwise_or.accumulate(words)
    everything = before[-1]
    twice = np.bitwise_or.reduce(before[:-1] & words[1:])
    once = everything & ~twice
    needed = np.flatnonzero((words & once).any(axis=1))
    if not len(needed):
        return float(union_apr(reduced, everything[None, :])[0])
    # What all poses but one see: without what that one alone sees.
    others = everything & ~(words[needed] & once) | reduced.base
    return float(union_apr(reduced, others).min())


def tightened(stage: Stage, bound: float) -> Stage:
    """A stage with another bound that holds as well, where that is closer."""
    objective = Objective(stage.name)
    bound = objective.worse(bound, stage.bound)
    return build_stage(objective, stage.objective, bound, stage.seconds)


# ---------- a front by units
DEFAULT_MAX_UNITS = 8


def pareto_front(
    problem: PlacementProblem,
    *,
    max_units: int = DEFAULT_MAX_UNITS,
    min_units: int = 1,
    stages: StageChoice = "first",
    effort: Effort | None = None,
    on_point: OnPoint | None = None,
    reduced: ReducedProblem | None = None,
) -> Front:
    """Best layouts of so many units and all smaller numbers.

    Parameters
    ----------
    problem : PlacementProblem
        All limits and floors hold at every point but the number of units, in which
        existing units count.
    max_units, min_units : int
        Largest and smallest number of units.
    stages : {"first", "all"}
        "first" optimises the APR, then the APR when one unit fails; "all" margins
        and cost, too.
    effort : Effort, optional
        That of all points together: time that a point leaves is there for those
        after it.
    on_point : callable, optional
        Called with every point as soon as it is solved.
    reduced : ReducedProblem, optional
        The problem presolved for no fewer units than `max_units`.

    Returns
    -------
    front : Front
        A point for every number of units with which the wishes can be met; once
        nothing can grow, and no more money is saved, copies.

    Raises
    ------
    InputError
        The wishes cannot be met with any number, or ask for more than the best.

    Notes
    -----
    Bounds are exchanged between points. A layout of K units is one of K + 1, too:
    what none of K + 1 exceeds, none of K does, if both points hold the same in the
    stages before. And what is left of K units when one fails is a layout of K - 1,
    which no wish binds if none is there.
    """
    check_front(problem, stages)
    if effort is None:
        effort = Effort()
    deadline = deadline_in(effort.time_limit_s)
    limits = problem.limits
    first = max(min_units, int(limits.is_forced.sum()), 1)
    reduced = _presolved(problem, first, max_units, reduced, effort)
    largest = None
    statistics = None
    if reduced is not None:
        largest = largest_values(reduced, stages)
        statistics = reduced.statistics
    optimised: tuple[Objective, ...] = VALUE_OBJECTIVES
    if stages == "first":
        optimised = FIRST_STAGES
    full = replace(limits, budget_units=None).max_units
    points: list[FrontPoint] = []
    refused: list[tuple[int, UnmetError]] = []
    settled = None
    for units in range(first, max_units + 1):
        # More units cannot be better: the last point is as good, and as well proven.
        if points and (settled is not None or units > full):
            points.append(replace(points[-1], units=units))
            continue
        of_point = deadline
        if units < max_units:
            of_point = deadline.of("point of a front")
        fewer = None
        starts = []
        if points:
            fewer = points[-1]
            starts = [fewer.pose_index]
        at_point = replace(problem, limits=replace(limits, budget_units=units))
        try:
            point = solve_point(
                at_point,
                reduced,
                effort=effort.until(of_point),
                n_stages=len(optimised),
                starts=starts,
            )
        except UnmetError as error:
            refused.append((units, error))
            continue
        if fewer is not None:
            point = no_worse(point, fewer)
        points.append(replace(point, units=units))
        if reaches(point.value, largest) and (
            stages == "first" or _is_cheap(problem, points[-1])
        ):
            settled = units
        if on_point is not None:
            on_point(points[-1])
    # No number of units will do: the reason is that of the last one.
    if not points:
        why = refused[-1][1]
        option = why.where
        if option == "budget":
            option = "max_units"
        raise UnmetError(option, why.got, why.expected)
    if settled is None and full <= max_units and points[-1].is_proven:
        settled = max(points[0].units, full)
    points = _exchange_bounds(points, is_free=_is_free(problem))
    return Front(
        by="units",
        points=tuple(points),
        stages=stages,
        settled=_first_like_last(points, settled),
        refused=tuple((units, str(error)) for units, error in refused),
        presolve=statistics,
    )


def front_below(
    problem: PlacementProblem,
    pose_index: tuple[int, ...],
    certificate: Certificate,
    *,
    min_units: int = 1,
    effort: Effort | None = None,
    on_point: OnPoint | None = None,
    reduced: ReducedProblem | None = None,
) -> Front:
    """A front that ends with a known layout and its certificate.

    It has points of fewer units, if any meet the wishes, then the one given, which
    was solved for the best. The other arguments and errors are those of
    :func:`pareto_front`; all stages are optimised.
    """
    check_front(problem, "all")
    most = problem.limits.budget_units or len(pose_index)
    value = placement_value(problem, pose_index)
    last = FrontPoint(
        units=most, pose_index=pose_index, value=value, certificate=certificate
    )
    alone = Front(
        by="units",
        points=(last,),
        stages="all",
        settled=None,
        refused=(),
        presolve=None,
    )
    if max(min_units, int(problem.limits.is_forced.sum()), 1) >= most:
        return alone
    numbers = {"min_units": min_units, "max_units": most - 1}
    try:
        fewer = pareto_front(
            problem,
            **numbers,
            stages="all",
            effort=effort,
            on_point=on_point,
            reduced=reduced,
        )
    except UnmetError:
        return alone
    last = no_worse(last, fewer.points[-1])
    points = _exchange_bounds([*fewer.points, last], is_free=_is_free(problem))
    return replace(fewer, points=tuple(points))


def _presolved(
    problem: PlacementProblem,
    min_units: int,
    max_units: int,
    reduced: ReducedProblem | None,
    effort: Effort,
) -> ReducedProblem | None:
    """The problem presolved once for all points; None where it is too large.

    Where it is so large, each point is presolved by itself. Poses that are
    dominated while many units are chosen are dominated while fewer are.
    """
    if not 1 <= min_units <= max_units:
        raise InputError(
            "max_units", max_units, f"a number of units, at least {min_units}"
        )
    check_limits(replace(problem.limits, budget_units=None), problem.table.pose_ids)
    if reduced is None and effort.solver != "exact" and is_large(problem):
        return None
    if reduced is None:
        widest = replace(problem.limits, budget_units=max_units)
        reduced = presolve(replace(problem, limits=widest), workers=effort.workers)
    return reduced.with_workers(effort.workers)


def _is_cheap(problem: PlacementProblem, point: FrontPoint) -> bool:
    """True if it is proven that no layout with more units costs less than a point's."""
    stage = point.stage(Objective.COST)
    prices = np.sort(problem.limits.unit_cost_eur[~problem.limits.is_forbidden])
    more_eur = float(prices[: point.units + 1].sum()) + COST_TOLERANCE_EUR
    return stage is not None and stage.gap == 0.0 and stage.objective <= more_eur


def _is_free(problem: PlacementProblem) -> bool:
    """True if every part of a layout is one, too: no wish asks for any unit."""
    limits = problem.limits
    return not (problem.floors or limits.is_forced.any() or limits.is_forced_site.any())


def _exchange_bounds(
    points: Sequence[FrontPoint], *, is_free: bool
) -> list[FrontPoint]:
    """Points whose bounds are no worse than what those of other points imply."""
    tight = list(points)
    for index in reversed(range(len(points) - 1)):
        bounds: dict[str, float] = {}
        stages = [point.certificate.stages for point in tight[index : index + 2]]
        for mine, theirs in zip(*stages, strict=True):
            bounds[mine.name] = theirs.bound
            if abs(mine.objective - theirs.objective) > TOLERANCE:
                # The stages after this one hold different things.
                break
        tight[index] = tight[index].bounded(bounds)
    if is_free:
        for index, (fewer, point) in enumerate(pairwise(tight), start=1):
            bound = fewer.certificate.stages[0].bound
            if point.units == fewer.units + 1:
                tight[index] = point.bounded({Objective.APR_ONE_FAILED: bound})
    return tight


def _first_like_last(points: Sequence[FrontPoint], settled: int | None) -> int | None:
    """The first number of units whose proven point is no worse than the settled one."""
    if settled is None:
        return None
    last = next(point for point in points if point.units == settled)
    reached = np.array([stage.objective for stage in last.certificate.stages])
    for point in points:
        values = [stage.objective for stage in point.certificate.stages]
        if point.is_proven and (np.abs(values - reached) <= TOLERANCE).all():
            return point.units
    return settled
