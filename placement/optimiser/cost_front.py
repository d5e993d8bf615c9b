"""Fronts over money: the best layouts for more and more of it.

They begin with the cheapest layout that avoids anything.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.arrays import FloatArray
from geometry.clock import now_s
from geometry.errors import InputError, Unquoted, refuse

from .allowed_sets import CENTS, Limits, whole_cents
from .constants import COST_TOLERANCE_EUR, TOLERANCE, Deadline, Effort, deadline_in
from .front import (
    FIRST_STAGES,
    Front,
    FrontPoint,
    OnPoint,
    StageChoice,
    check_front,
    largest_values,
    reaches,
    solve_point,
)
from .greedy import to_full
from .presolve import ReducedProblem, presolve
from .problem import (
    VALUE_OBJECTIVES,
    Floor,
    Objective,
    PlacementProblem,
)
from .proof import Search, Stages
from .solve import (
    UnmetError,
    build_stage,
    check_floors,
    check_limits,
    check_reach,
    units_of,
)

_MAX_LEVELS = 20_000


def price_levels_eur(limits: Limits) -> FloatArray | None:
    """Amounts of which every layout within limits costs one, ascending, in euros.

    Not every amount need be the cost of a layout. None if prices are too many, or no
    whole cents.
    """
    usable = ~limits.is_forbidden | limits.is_forced
    most = limits.max_units
    sites = np.unique(limits.site_index[usable])
    by_units = _sums(limits.unit_cost_eur[usable], most)
    by_sites = _sums(limits.site_cost_eur[sites], min(most, limits.n_sites))
    if by_units is None or by_sites is None:
        return None
    # So many units need at least so many sites.
    largest = max(int(limits.site_capacity.max(initial=1)), 1)
    levels: set[int] = set()
    for n_units in range(1, most + 1):
        fewest = -(-n_units // largest)
        n_most = min(n_units, len(by_sites) - 1)
        for n_sites in range(fewest, n_most + 1):
            levels.update(a + b for a in by_units[n_units] for b in by_sites[n_sites])
            if len(levels) > _MAX_LEVELS:
                return None
    return np.array(sorted(levels)) / CENTS


def next_level_eur(
    levels_eur: FloatArray | None, amount_eur: float, *, is_more: bool
) -> float:
    """First level that is no less than an amount, or more; in euros.

    Parameters
    ----------
    levels_eur : (n,) float, optional
        Levels, ascending; None: not known, the amount itself is returned. [EUR]
    amount_eur : float
        The amount. [EUR]
    is_more : bool
        True if the level must be more than the amount.
    """
    if levels_eur is None or not np.isfinite(amount_eur):
        return amount_eur
    if is_more:
        from_eur = amount_eur + COST_TOLERANCE_EUR
        place = np.searchsorted(levels_eur, from_eur, side="right")
    else:
        from_eur = amount_eur - COST_TOLERANCE_EUR
        place = np.searchsorted(levels_eur, from_eur, side="left")
    if place < len(levels_eur):
        return float(levels_eur[place])
    return np.inf


def _sums(prices_eur: FloatArray, most: int) -> list[set[int]] | None:
    """Sums of 0, 1, .. prices in cents, each of which may be taken again and again."""
    cents = whole_cents(np.unique(prices_eur))
    if cents is None:
        return None
    sums: list[set[int]] = [{0}]
    for _ in range(most):
        sums.append({before + price for before in sums[-1] for price in cents.tolist()})
        if len(sums[-1]) > _MAX_LEVELS:
            return None
    return sums


DEFAULT_MAX_POINTS = 40
# What a point asks for, in place of a wish.
_ASKED = "APR"


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

    All limits and floors of the problem hold at every point. The first point is the
    cheapest that avoids anything. The first stage of a certificate is the cost:
    nothing that is better than the point before costs less.

    Parameters
    ----------
    problem : PlacementProblem
        The problem; its goal must be the best layout.
    step_apr : float, optional
        A point must be better than the one before it by so much; by default by the
        smallest weight of a run. Points that are closer are left out.
    max_points : int
        At most so many points.
    stages, effort, on_point
        Those of :func:`placement.optimiser.front.pareto_front`.

    Raises
    ------
    InputError
        No layout meets the wishes or avoids anything, or more is asked for than the
        best.

    Notes
    -----
    The epsilon-constraint method [1]_, in lexicographic order: the next point is
    the cheapest layout whose APR is higher, or that has the same APR and keeps more
    of it when one unit fails.

    References
    ----------
    .. [1] Y. Haimes, L. Lasdon, D. Wismer, "On a bicriterion formulation of the
       problems of integrated system identification and system optimization", 1971.
    """
    check_front(problem, stages)
    if max_points < 1:
        raise InputError("max_points", max_points, "at least 1")
    if effort is None:
        effort = Effort()
    check_limits(problem.limits, problem.table.pose_ids)
    reduced = presolve(problem, workers=effort.workers)
    check_reach(problem, reduced)
    weight = reduced.weight[reduced.weight > 0.0]
    if not len(weight):
        refuse("candidates", "poses that avoid nothing", "one that does")
    if step_apr is None:
        step_apr = float(weight.min())
    climb = _Climb(
        problem=problem,
        reduced=reduced,
        stages=stages,
        effort=effort,
        deadline=deadline_in(effort.time_limit_s),
        step=step_apr,
        largest=largest_values(reduced, "first") or {},
        levels_eur=price_levels_eur(problem.limits),
    )
    points = [climb.first()]
    higher = _UNKNOWN
    settled = None
    while len(points) < max_points:
        last = points[-1]
        if on_point is not None:
            on_point(last)
        # The cheapest layout with a higher APR stays the same until one is reached.
        if higher is _UNKNOWN:
            higher = climb.higher(last)
        safer = climb.safer(last)
        # Whatever is better than the last point is one of the two.
        least_eur = min(higher.least_eur, safer.least_eur)
        if higher.pose_index is None and safer.pose_index is None:
            if least_eur == np.inf and last.is_proven:
                settled = last.value.cost_eur
            break
        if higher.cost_eur <= safer.cost_eur + COST_TOLERANCE_EUR:
            point = climb.point(higher, least_eur)
        else:
            is_best = higher.least_eur > safer.cost_eur + COST_TOLERANCE_EUR
            point = climb.point(safer, least_eur, is_best=is_best)
        if point.value.apr > last.value.apr + TOLERANCE:
            higher = _UNKNOWN
        points = _with_point(points, point)
    largest = largest_values(reduced, stages)
    # Margins and cost may still grow, where they were optimised.
    if stages == "all" and not reaches(points[-1].value, largest):
        settled = None
    return Front(
        by="cost",
        points=tuple(points),
        stages=stages,
        settled=settled,
        refused=(),
        presolve=reduced.statistics,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    """The cheapest layout that is better in one respect, as found.

    Attributes
    ----------
    pose_index : tuple of int, optional
        Rows of the detection table; None: none was found.
    cost_eur : float
        Its cost; infinite without a layout. [EUR]
    least_eur : float
        Proven: no such layout costs less; infinite if there is none. [EUR]
    seconds : float
        Time that it took. [s]
    floors : tuple of (float, int)
        What was asked for: APRs, and how many units may fail.
    """

    pose_index: tuple[int, ...] | None
    cost_eur: float
    least_eur: float
    seconds: float
    floors: tuple[tuple[float, int], ...] = ()


_UNKNOWN = _Step(pose_index=None, cost_eur=np.inf, least_eur=-np.inf, seconds=0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Climb:
    """Problem, time and prices that the steps of one front share.

    Attributes
    ----------
    step : float
        A point's APR must be higher than the one before by so much.
    largest : dict
        Values that no layout exceeds, by objective.
    levels_eur : (n,) float, optional
        Amounts of which every layout costs one; None: not known. [EUR]
    """

    problem: PlacementProblem
    reduced: ReducedProblem
    stages: StageChoice
    effort: Effort
    deadline: Deadline
    step: float
    largest: dict[Objective, float]
    levels_eur: FloatArray | None

    def first(self) -> FrontPoint:
        """The cheapest layout that avoids anything."""
        try:
            step = self._cheapest([(self.step, 0)], None)
        except UnmetError as error:
            if error.where != _ASKED:
                raise
            got = Unquoted("no layout that avoids anything")
            raise InputError(
                "candidates", got, "one within the limits and the time"
            ) from None
        # check_floors has seen to it.
        assert step.pose_index is not None
        return self.point(step, step.least_eur)

    def higher(self, last: FrontPoint) -> _Step:
        """The cheapest layout with a higher APR."""
        if last.value.apr + self.step > self.largest[Objective.APR] + TOLERANCE:
            return replace(_UNKNOWN, least_eur=np.inf)
        return self._cheapest([(last.value.apr + self.step, 0)], last)

    def safer(self, last: FrontPoint) -> _Step:
        """The cheapest layout with the same APR that keeps more of it on failure."""
        least = last.value.apr_one_failed + self.step
        if least > self.largest[Objective.APR_ONE_FAILED] + TOLERANCE:
            return replace(_UNKNOWN, least_eur=np.inf)
        return self._cheapest([(last.value.apr, 0), (least, 1)], last)

    def _cheapest(
        self, asked: Sequence[tuple[float, int]], last: FrontPoint | None
    ) -> _Step:
        """The cheapest layout that reaches some APRs.

        `asked` are pairs of a share and how many units may fail; `last` is the point
        before, None for the first one.
        """
        began_s = now_s()
        problem = self._asking(asked, goal="cheapest")
        reduced = self.reduced.for_problem(problem)
        effort = self._effort()
        end = deadline_in(effort.time_limit_s)
        search = Search(reduced, deadline=end, is_exact=effort.is_exact)
        starts = []
        if last is not None:
            starts = [units_of(reduced, np.array(last.pose_index))]
        search.start(starts)
        known_eur = self._known_eur(last)
        if last is None:
            check_floors(problem, search)
        elif search.units is None or search.shortfall > 0.0:
            least_eur = known_eur
            if search.nothing_meets_all:
                least_eur = np.inf
            return replace(_UNKNOWN, least_eur=least_eur)
        if search.value.cost_eur > known_eur + COST_TOLERANCE_EUR:
            bound = Stages(problem, search, effort).bound_first_cost_eur()
            level_eur = next_level_eur(self.levels_eur, bound, is_more=False)
            known_eur = max(known_eur, level_eur)
        units = search.units
        assert units is not None
        return _Step(
            pose_index=to_full(reduced, units),
            cost_eur=search.value.cost_eur,
            least_eur=known_eur,
            seconds=now_s() - began_s,
            floors=tuple(asked),
        )

    def _known_eur(self, last: FrontPoint | None) -> float:
        """What is better than a point costs at least so much.

        It is better than all points before, too; and it costs more than this point, if
        that is the best at its cost.
        """
        if last is None:
            return next_level_eur(self.levels_eur, 0.0, is_more=False)
        # The best at its cost.
        if last.is_proven:
            return next_level_eur(self.levels_eur, last.value.cost_eur, is_more=True)
        return last.certificate.stages[0].bound

    def point(
        self, step: _Step, least_eur: float, *, is_best: bool = True
    ) -> FrontPoint:
        """The best layout for the cost of a step.

        No layout that is better than the point before costs less than `least_eur`. With
        `is_best`, nothing with a higher APR costs as little: what was asked for need
        not be asked again.
        """
        assert step.pose_index is not None
        limits = _within(self.problem.limits, step.cost_eur)
        asked = step.floors
        if is_best:
            asked = ()
        # No stage need ask for less money: that is the last one.
        n_stages = len(VALUE_OBJECTIVES) - 1
        if self.stages == "first":
            n_stages = len(FIRST_STAGES)
        point = solve_point(
            self._asking(asked, limits=limits),
            self.reduced,
            effort=self._effort(),
            n_stages=n_stages,
            starts=[step.pose_index],
        )
        cost = build_stage(
            Objective.COST, point.value.cost_eur, least_eur, step.seconds
        )
        return point.with_stages([cost, *point.certificate.stages])

    def _asking(
        self, asked: Sequence[tuple[float, int]], **changes: Any
    ) -> PlacementProblem:
        """The problem with some changes where APRs must be reached, too."""
        floors = [
            Floor(name=_ASKED, share=min(share, 1.0), n_failures=n_failures)
            for share, n_failures in asked
        ]
        return replace(self.problem, floors=(*self.problem.floors, *floors), **changes)

    def _effort(self) -> Effort:
        """Effort for one point, out of what is left for all."""
        return self.effort.until(self.deadline.of("point of a front"))


def _within(limits: Limits, cost_eur: float) -> Limits:
    """Limits with so much money; as a number of units, where that says the same."""
    price = float(limits.unit_cost_eur.max(initial=0.0))
    if price <= 0.0 or limits.site_cost_eur.any():
        return replace(limits, budget_eur=cost_eur)
    if np.ptp(limits.unit_cost_eur) != 0.0:
        return replace(limits, budget_eur=cost_eur)
    # Each unit costs the same.
    most = int((cost_eur + COST_TOLERANCE_EUR) / price)
    if limits.budget_units is not None:
        most = min(most, limits.budget_units)
    return replace(limits, budget_units=most, budget_eur=None)


def _with_point(points: Sequence[FrontPoint], new: FrontPoint) -> list[FrontPoint]:
    """Points that cost less than a new one, which is better than all, and that one.

    What is better than the last that stays may be worse than one that goes, and
    cost as little: the lowest bound of all holds.
    """
    least_eur = new.value.cost_eur - COST_TOLERANCE_EUR
    stay = [point for point in points if point.value.cost_eur < least_eur]
    cost, *others = new.certificate.stages
    gone = points[len(stay) :]
    least_eur = min(point.certificate.stages[0].bound for point in (new, *gone))
    if least_eur < cost.bound:
        cost = build_stage(Objective.COST, cost.objective, least_eur, cost.seconds)
    return [*stay, new.with_stages([cost, *others])]
