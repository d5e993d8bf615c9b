"""What more money buys: from the cheapest useful layout upwards, each step with its proof."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.errors import InputError, Unquoted

from .effort import Effort
from .feasibility import check_floors, check_limits, check_reach
from .front import (
    Front,
    FrontPoint,
    OnPoint,
    StageChoice,
    check_front,
    largest_values,
    look_around,
    prove_point,
    reaches,
    tightened,
)
from .limits import COST_TOLERANCE_EUR
from .presolve import ReducedProblem, presolve
from .problem import TOLERANCE, Floor, PlacementProblem
from .requirements import Requirement

DEFAULT_MAX_POINTS = 40
_SHARES = 3  # a point may take this part of the time that is left: most leave some of it


def cost_front(
    problem: PlacementProblem,
    *,
    step_apr: float | None = None,
    max_points: int = DEFAULT_MAX_POINTS,
    stages: StageChoice = "first",
    effort: Effort | None = None,
    on_point: OnPoint | None = None,
) -> Front:
    """Cheapest layouts for a growing APR, and for a growing APR when one unit fails.

    Parameters
    ----------
    problem : PlacementProblem
        What to solve. All its limits and floors hold at every point.
    step_apr : float, optional
        A point must be better than the one before it by so much; by default by the smallest weight
        of a run. Where runs weigh differently, points that are closer are left out.
    max_points : int
        Stop after so many.
    stages : {"first", "all"}
        "first": APR, then APR when one unit fails; "all": then margins.
    effort : Effort, optional
        Of all points together; by default :class:`placement.optimiser.Effort`'s.
    on_point : callable, optional
        Called with every point.

    Returns
    -------
    front : Front
        The first point is the cheapest that avoids anything. Its certificate's first stage is the
        cost: nothing that is better than the point before costs less.

    Raises
    ------
    InputError
        No layout meets the wishes or avoids anything, or more is asked for than the best.

    Notes
    -----
    The epsilon-constraint method of Haimes, Lasdon and Wismer (1971), in lexicographic order: the
    next point is the cheapest layout whose APR is higher, or that has the same APR and keeps more
    of it when one unit fails.
    """
    check_front(problem, stages)
    if max_points < 1:
        raise InputError("max_points", max_points, "at least 1")
    effort = Effort() if effort is None else effort
    check_limits(problem.limits, problem.table.pose_ids)
    reduced = presolve(problem)
    check_reach(problem, reduced)
    weight = reduced.weight[reduced.weight > 0.0]
    if not len(weight):
        raise InputError("candidates", Unquoted("poses that avoid nothing"), "one that does")
    climb = _Climb(
        problem=problem,
        reduced=reduced,
        stages=stages,
        effort=effort,
        end_s=time.monotonic() + effort.time_limit_s,
        step=float(weight.min()) if step_apr is None else step_apr,
        largest=largest_values(reduced, "first") or {},
    )
    points = [climb.first()]
    higher = _UNKNOWN
    settled = None
    while len(points) < max_points:
        last = points[-1]
        if on_point is not None:
            on_point(last)
        if higher is _UNKNOWN:
            higher = climb.higher(last)
        safer = climb.safer(last)
        if higher.point is None and safer.point is None:
            if higher.is_impossible and safer.is_impossible and last.is_proven:
                settled = last.value.cost_eur
            break
        point = _cheaper(higher, safer, last)
        if point.value.apr > last.value.apr + TOLERANCE:
            higher = _UNKNOWN
        points = [*_not_beaten(points, point), point]
    largest = largest_values(reduced, stages)
    is_final = stages == "first" or reaches(points[-1].value, largest)
    return Front(
        by="cost",
        points=tuple(points),
        stages=stages,
        settled=settled if is_final else None,
        refused=(),
        presolve=reduced.statistics,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    """The cheapest layout that is better in one respect.

    `least_eur` is proven: no such layout costs less; infinite if there is none.
    """

    point: FrontPoint | None
    least_eur: float

    @property
    def is_impossible(self) -> bool:
        return self.least_eur == np.inf


_UNKNOWN = _Step(point=None, least_eur=-np.inf)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Climb:
    """What the steps of one front share."""

    problem: PlacementProblem
    reduced: ReducedProblem
    stages: StageChoice
    effort: Effort
    end_s: float
    step: float
    largest: dict[str, float]

    def first(self) -> FrontPoint:
        """The cheapest layout that avoids anything."""
        problem, reduced, effort = self._asking([(self.step, 0)])
        search = look_around(problem, reduced, effort=effort, stages=self.stages)
        check_floors(problem, search)
        return prove_point(problem, reduced, search, effort=effort, stages=self.stages)

    def higher(self, last: FrontPoint) -> _Step:
        """The cheapest layout with a higher APR."""
        return self._step(last, "apr", [(last.value.apr + self.step, 0)])

    def safer(self, last: FrontPoint) -> _Step:
        """The cheapest layout with the same APR that keeps more of it when one unit fails."""
        least = last.value.apr_one_failed + self.step
        return self._step(last, "apr_one_failed", [(last.value.apr, 0), (least, 1)])

    def _step(self, last: FrontPoint, name: str, asked: Sequence[tuple[float, int]]) -> _Step:
        if asked[-1][0] > self.largest[name] + TOLERANCE:
            return _Step(point=None, least_eur=np.inf)
        problem, reduced, effort = self._asking(asked)
        search = look_around(
            problem, reduced, effort=effort, stages=self.stages, start=last.pose_index
        )
        # What is better than the point before costs more, if that point is the best at its cost.
        least_eur = last.value.cost_eur if last.is_proven else 0.0
        if search.units is None or search.shortfall > 0.0:
            return _Step(point=None, least_eur=np.inf if search.nothing_meets_all else least_eur)
        point = prove_point(problem, reduced, search, effort=effort, stages=self.stages)
        return _Step(point=point, least_eur=max(point.certificate.stages[0].bound, least_eur))

    def _asking(
        self, asked: Sequence[tuple[float, int]]
    ) -> tuple[PlacementProblem, ReducedProblem, Effort]:
        """The problem with floors of the APR: pairs of a share and how many units may fail."""
        floors = [
            Floor(name="APR", share=min(share, 1.0), n_failures=failed) for share, failed in asked
        ]
        requirements = [
            Requirement(
                measure=self.reduced.measure, least=floor.share, n_failures=floor.n_failures
            )
            for floor in floors
        ]
        left_s = max(self.end_s - time.monotonic(), 1.0e-3)
        return (
            replace(self.problem, goal="cheapest", floors=(*self.problem.floors, *floors)),
            replace(self.reduced, goal="cheapest", floors=(*self.reduced.floors, *requirements)),
            replace(self.effort, time_limit_s=left_s / _SHARES),
        )


def _cheaper(higher: _Step, safer: _Step, last: FrontPoint) -> FrontPoint:
    """The next point: the cheaper of two steps, at equal cost the one with the higher APR."""
    steps = [step for step in (higher, safer) if step.point is not None]
    costs = [step.point.value.cost_eur for step in steps if step.point is not None]
    is_first = len(steps) == 1 or costs[0] <= costs[1] + COST_TOLERANCE_EUR
    point = steps[0 if is_first else 1].point
    assert point is not None
    # Whatever is better than the last point is one of the two: it costs no less than either bound.
    bound = min(higher.least_eur, safer.least_eur)
    (cost, *others) = point.certificate.stages
    loosened = tightened(replace(cost, bound=-np.inf), bound)
    return replace(point, certificate=replace(point.certificate, stages=(loosened, *others)))


def _not_beaten(points: Sequence[FrontPoint], new: FrontPoint) -> list[FrontPoint]:
    """Points that cost less than a new one, which is better than all of them."""
    return [
        point for point in points if point.value.cost_eur < new.value.cost_eur - COST_TOLERANCE_EUR
    ]
