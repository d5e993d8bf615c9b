"""What more units or more money buy: a front of layouts, each with its proof.

A point is solved from the one before it: what was found for less is feasible for more. The best
values therefore never fall from point to point, and what no layout with more can exceed, none with
less can either.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from geometry.errors import InputError, Unquoted

from ..layout import Certificate, Stage, relative_gap
from .bitsets import union_apr
from .presolve import PresolveStatistics, ReducedProblem
from .problem import (
    TOLERANCE,
    PlacementProblem,
    PlacementValue,
    is_better,
    placement_value,
)
from .search import Search
from .solve import Solution

StageChoice = Literal["first", "all"]
FIRST_STAGES = ("apr", "apr_one_failed")


@dataclass(frozen=True, slots=True, kw_only=True)
class FrontPoint:
    """The best layout for so many units or so much money.

    Attributes
    ----------
    units : int
        On a front by units those that were allowed, though the layout may have fewer; on one by
        cost those that it has.
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
        """Whether the gaps of all stages are closed."""
        return self.certificate.is_proven

    def stage(self, name: str) -> Stage | None:
        """The stage of a name; None if it was not optimised."""
        return next((stage for stage in self.certificate.stages if stage.name == name), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Front:
    """Layouts for growing budgets.

    Attributes
    ----------
    by : {"units", "cost"}
        What the points are allowed more and more of.
    points : tuple of FrontPoint
        In ascending order, at least one; on a front by cost those at which something grows.
    stages : {"first", "all"}
        What was optimised: APR and the APR when one unit fails, or margins and cost, too.
    settled : float, optional
        Proven that from so many units, or euros, on nothing grows that was optimised, not even
        beyond the last point; None if that is not known.
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
        """Whether every point is."""
        return all(point.is_proven for point in self.points)


OnPoint = Callable[[FrontPoint], None]


def check_front(problem: PlacementProblem, stages: StageChoice) -> None:
    """Check that a problem asks for nothing but the best.

    Raises
    ------
    InputError
        It has a target, failures to survive, or weights; or the stages are unknown.
    """
    if stages not in ("first", "all"):
        raise InputError("stages", stages, "first or all")
    for option, is_asked in (
        ("--target", problem.goal != "best"),
        ("--survive", problem.survive != 0),
        ("--stage-weights", problem.stage_weights is not None),
    ):
        if is_asked:
            raise InputError(option, Unquoted("it with a front"), "neither: a front has every APR")


def from_solution(
    problem: PlacementProblem, solution: Solution, *, stages: StageChoice
) -> FrontPoint:
    """A point of a front from a problem that was solved by itself."""
    certificate = solution.certificate
    if stages == "first":
        kept = tuple(stage for stage in certificate.stages if stage.name in FIRST_STAGES)
        certificate = replace(certificate, stages=kept)
    return FrontPoint(
        units=len(solution.pose_index),
        pose_index=solution.pose_index,
        value=placement_value(problem, solution.pose_index),
        certificate=certificate,
    )


def no_worse(point: FrontPoint, fewer: FrontPoint) -> FrontPoint:
    """A point, or with its bounds the layout of the one before, where that is better."""
    if not is_better(fewer.value, point.value):
        return point
    stages = [
        tightened(replace(stage, objective=float(getattr(fewer.value, stage.name))), stage.bound)
        for stage in point.certificate.stages
    ]
    return replace(
        point,
        pose_index=fewer.pose_index,
        value=fewer.value,
        certificate=replace(point.certificate, stages=tuple(stages)),
    )


def largest_values(reduced: ReducedProblem, stages: StageChoice) -> dict[str, float] | None:
    """What no layout of any size exceeds, by the names of the stages but for the cost.

    Parameters
    ----------
    reduced : ReducedProblem
        Presolved for all points of a front.
    stages : {"first", "all"}
        Which values.

    Returns
    -------
    limits : dict of str to float
        From what all poses together reach. None if no limits of margins are known: they hold where
        all runs are avoided that some pose avoids, which a mean over all runs alone ensures.
    """
    everything = np.bitwise_or.reduce(reduced.words, axis=0, keepdims=True)
    limits = {
        "apr": float(union_apr(reduced, everything)[0]),
        "apr_one_failed": one_failed_limit(reduced),
    }
    if stages == "all":
        if not reduced.measure.is_mean:
            return None
        most = Search(reduced, end_s=0.0).limit
        limits |= {"smallest_margin_s": float(most[5]), "mean_margin_s": float(most[6])}
    return limits


def reaches(value: PlacementValue, limits: dict[str, float] | None) -> bool:
    """Whether a value is as large as limits that none exceeds."""
    return limits is not None and all(
        getattr(value, name) >= limit - TOLERANCE for name, limit in limits.items()
    )


def one_failed_limit(reduced: ReducedProblem) -> float:
    """No set of any size keeps a higher APR when one unit fails.

    Of a set with pose c, the others are left when c fails; of one without it, more is left than
    when it had c, too. So no set keeps more than all poses but c reach, whichever c is.
    """
    words = reduced.words
    before = np.zeros_like(words)
    after = np.zeros_like(words)
    before[1:] = np.bitwise_or.accumulate(words, axis=0)[:-1]
    after[:-1] = np.bitwise_or.accumulate(words[::-1], axis=0)[::-1][1:]
    everything = before | after | words
    others = before | after
    needed = np.flatnonzero((others != everything).any(axis=1))
    if not len(needed):
        return float(union_apr(reduced, everything[:1])[0])
    return float(union_apr(reduced, others[needed]).min())


def tightened(stage: Stage, bound: float) -> Stage:
    """A stage with another bound that holds as well, where that is closer."""
    is_minimised = stage.name in ("units", "cost_eur")
    bound = max(bound, stage.bound) if is_minimised else min(bound, stage.bound)
    bound = min(bound, stage.objective) if is_minimised else max(bound, stage.objective)
    gap = relative_gap(stage.objective, bound)
    return replace(stage, bound=stage.objective if gap == 0.0 else bound, gap=gap)
