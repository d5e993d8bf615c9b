"""The placement problem on a detection table, and what a set of poses is worth in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, NamedTuple, get_args

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.errors import InputError, Unquoted
from scenarios.aeb import AebRule, is_in_time
from scenarios.runs import confirmation_times_s

from ..detection_table import DetectionTable
from .limits import COST_TOLERANCE_EUR, Limits, cost_eur, is_allowed
from .measure import Measure, build_measure

Fusion = Literal["any", "single"]
Goal = Literal["best", "fewest", "cheapest"]

TOLERANCE = 1.0e-9
"""Values that differ by no more count as equal: shares and times carry rounding noise."""
MAX_FAILURES = 2
"""Failed units that can be asked to be survived."""


class PlacementValue(NamedTuple):
    """What a set of poses is worth: compared from left to right.

    Attributes
    ----------
    apr : float
        Accident prevention ratio, 0..1.
    apr_one_failed : float
        The same when the most painful one of the units fails.
    smallest_margin_s : float
        Of the avoided runs; 0 if there is none. [s]
    mean_margin_s : float
        Of the avoided runs, by their weights; 0 if there is none. [s]
    cost_eur : float
        Units, and sites once; the less the better. [EUR]
    """

    apr: float
    apr_one_failed: float
    smallest_margin_s: float
    mean_margin_s: float
    cost_eur: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Floor:
    """An accident prevention ratio that must be reached.

    Attributes
    ----------
    name : str
        Who asks for it, such as "--target", for messages.
    share : float
        The ratio, 0..1.
    is_counted : (n_runs,) bool, optional
        Runs that count, such as those of a case; by default all, by the problem's own measure.
    n_failures : int
        It must still be reached when any so many units fail.
    """

    name: str
    share: float
    is_counted: BoolArray | None = None
    n_failures: int = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise InputError(self.name, self.share, "a share of the runs, 0 to 1")
        if self.n_failures not in range(MAX_FAILURES + 1):
            raise InputError("--survive", self.n_failures, f"0 to {MAX_FAILURES} units")

    def __repr__(self) -> str:
        return f"Floor({self.name!r}, {self.share:g}, {self.n_failures} failures)"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacementProblem:
    """Which poses to mount, given what each detects.

    Attributes
    ----------
    table : DetectionTable
        V[c, f].
    limits : Limits
        What may be mounted together.
    fusion : {"any", "single"}
        "any": a frame counts if any unit detects; "single": one unit must confirm alone.
    rule : AebRule
        Confirmation and latency.
    floors : tuple of Floor
        What must be reached in any case.
    goal : {"best", "fewest", "cheapest"}
        "fewest", "cheapest": of the sets that reach the floors only those with the fewest units,
        or of the least cost, are looked at; then the best of them.
    survive : int
        If not 0, the APR when so many units fail is the first objective.
    stage_weights : (5,) float, optional
        One objective instead of five in order: the sum of the fields of
        :class:`PlacementValue` times these weights; that of the cost counts against. Margins in
        it leave presolve little to drop: more seen may mean less to spare.
    sample_index : (n_runs,) int, optional
        Sampled world of each run.
    tail : float
        See :class:`placement.optimiser.measure.Measure`: how the APR sums up the sampled worlds.
    """

    table: DetectionTable
    limits: Limits
    fusion: Fusion
    rule: AebRule
    floors: tuple[Floor, ...] = ()
    goal: Goal = "best"
    survive: int = 0
    stage_weights: tuple[float, ...] | None = None
    sample_index: IntArray | None = None
    tail: float = 1.0

    def __post_init__(self) -> None:
        n_poses = self.table.n_poses
        if self.limits.n_poses != n_poses:
            raise InputError(
                "site_index", Unquoted(f"{self.limits.n_poses} poses"), f"{n_poses} poses"
            )
        if (self.table.axis.last_brake_time_s == np.inf).any():
            raise InputError("last_brake_time_s", np.inf, "a time, or minus infinity")
        if self.fusion not in get_args(Fusion):
            raise InputError("--fusion", self.fusion, "one of " + ", ".join(get_args(Fusion)))
        if self.goal not in get_args(Goal):
            raise InputError("goal", self.goal, "one of " + ", ".join(get_args(Goal)))
        if self.survive not in range(MAX_FAILURES + 1):
            raise InputError("--survive", self.survive, f"0 to {MAX_FAILURES} units")
        weights = self.stage_weights
        if weights is not None and not (
            len(weights) == len(PlacementValue._fields)
            and all(0.0 <= weight < np.inf for weight in weights)
            and any(weights)
        ):
            raise InputError(
                "--stage-weights",
                list(weights),
                "weights of " + ", ".join(PlacementValue._fields) + ", at least 0 and not all 0",
            )
        for floor in self.floors:
            counted = floor.is_counted
            if counted is not None and counted.shape != (self.table.axis.n_runs,):
                raise InputError(
                    floor.name, Unquoted(f"shape {counted.shape}"), "a flag for each run"
                )
        self.measure()  # checks samples and tail

    def measure(self) -> Measure:
        """The accident prevention ratio, as a function of the runs that are avoided."""
        return build_measure(self.table.axis.weight, self.sample_index, tail=self.tail)

    def floor_measure(self, floor: Floor) -> Measure:
        """What a floor counts: all runs, or its own by their weights."""
        if floor.is_counted is None:
            return self.measure()
        weight = np.where(floor.is_counted, self.table.axis.weight, 0.0)
        total = float(weight.sum())
        if total == 0.0:
            raise InputError(floor.name, Unquoted("runs without weight"), "a run that counts")
        return build_measure(weight / total)

    def __repr__(self) -> str:
        return f"PlacementProblem({self.goal}, {self.limits!r}, fusion {self.fusion!r})"


def is_feasible(problem: PlacementProblem, pose_index: Sequence[int]) -> bool:
    """Whether poses are distinct, within all limits, and reach all floors."""
    if not is_allowed(problem.limits, list(pose_index)):
        return False
    return all(
        floor_value(problem, floor, pose_index) >= floor.share - TOLERANCE
        for floor in problem.floors
    )


def floor_value(problem: PlacementProblem, floor: Floor, pose_index: Sequence[int]) -> float:
    """What a set of poses reaches of a floor, 0..1."""
    return _left_after_failures(problem, problem.floor_measure(floor), pose_index, floor.n_failures)


def run_margins_s(problem: PlacementProblem, pose_index: Sequence[int]) -> FloatArray:
    """Time left, in every run, between the onset of braking and the last moment for it.

    Parameters
    ----------
    problem : PlacementProblem
        The table and the rule.
    pose_index : sequence of int
        What is mounted; the problem's budget and capacities do not matter here.

    Returns
    -------
    margin_s : (n_runs,) float
        last brake time - (confirmation + latency); minus infinity if that is too late. [s]
    """
    axis, rule = problem.table.axis, problem.rule
    if len(pose_index) == 0:
        return np.full(axis.n_runs, -np.inf)
    detected = problem.table.detected(list(pose_index))
    if problem.fusion == "any":
        detected = np.logical_or.reduce(detected, axis=0, keepdims=True)
    confirmed = confirmation_times_s(detected, axis, n_confirmations=rule.n_confirmations)
    confirmed = confirmed.min(axis=0)
    last_brake = axis.last_brake_time_s
    in_time = np.isfinite(confirmed) & is_in_time(confirmed, last_brake, latency_s=rule.latency_s)
    margin = np.full(axis.n_runs, -np.inf)
    margin[in_time] = last_brake[in_time] - (confirmed[in_time] + rule.latency_s)
    return margin


def apr(problem: PlacementProblem, pose_index: Sequence[int]) -> float:
    """Accident prevention ratio of a set of poses, 0..1."""
    return float(problem.measure().of(run_margins_s(problem, pose_index) > -np.inf))


def apr_one_failed(problem: PlacementProblem, pose_index: Sequence[int]) -> float:
    """Smallest accident prevention ratio that is left when one of the poses fails, 0..1."""
    return apr_failed(problem, pose_index, 1)


def apr_failed(problem: PlacementProblem, pose_index: Sequence[int], n_failures: int) -> float:
    """Smallest accident prevention ratio that is left when so many of the poses fail, 0..1."""
    return _left_after_failures(problem, problem.measure(), pose_index, n_failures)


def _left_after_failures(
    problem: PlacementProblem, measure: Measure, pose_index: Sequence[int], n_failures: int
) -> float:
    n_left = len(pose_index) - n_failures
    if n_left < 0:
        return 0.0
    return min(
        float(measure.of(run_margins_s(problem, left) > -np.inf))
        for left in combinations(pose_index, n_left)
    )


def placement_value(problem: PlacementProblem, pose_index: Sequence[int]) -> PlacementValue:
    """What a set of poses is worth; runs without weight do not count.

    Parameters
    ----------
    problem : PlacementProblem
        The table and the rule.
    pose_index : sequence of int
        What is mounted.
    """
    weight, margin = problem.table.axis.weight, run_margins_s(problem, pose_index)
    counts = (margin > -np.inf) & (weight > 0.0)
    cost = cost_eur(problem.limits, pose_index)
    if not counts.any():
        return PlacementValue(0.0, 0.0, 0.0, 0.0, cost)
    return PlacementValue(
        apr=float(problem.measure().of(counts)),
        apr_one_failed=apr_one_failed(problem, pose_index),
        smallest_margin_s=float(margin[counts].min()),
        mean_margin_s=float(np.average(margin[counts], weights=weight[counts])),
        cost_eur=cost,
    )


def is_better(value: PlacementValue, other: PlacementValue) -> bool:
    """Whether the first difference that exceeds rounding noise favours `value`.

    Examples
    --------
    >>> is_better(PlacementValue(1.0, 0.5, 0.2, 0.3, 9.0), PlacementValue(1.0, 0.5, 0.1, 0.9, 0.0))
    True
    """
    for mine, theirs in zip(value[:-1], other[:-1], strict=True):
        if abs(mine - theirs) > TOLERANCE:
            return mine > theirs
    return value.cost_eur < other.cost_eur - COST_TOLERANCE_EUR
