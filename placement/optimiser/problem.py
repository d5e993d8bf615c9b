"""The placement problem on a detection table, and what a set of poses is worth in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from geometry.arrays import FloatArray, IntArray, freeze
from geometry.errors import InputError, Unquoted
from scenarios.aeb import AebRule, is_in_time
from scenarios.exposure import weight_share
from scenarios.runs import confirmation_times_s

from ..detection_table import DetectionTable

Fusion = Literal["any", "single"]

TOLERANCE = 1.0e-9
"""Values that differ by no more count as equal: shares and times carry rounding noise."""


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
    """

    apr: float
    apr_one_failed: float
    smallest_margin_s: float
    mean_margin_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacementProblem:
    """Which poses to mount, given what each detects.

    Attributes
    ----------
    table : DetectionTable
        V[c, f].
    site_index : (n_poses,) int
        Site of every pose; a pose that belongs to no site has one of its own.
    site_capacity : (n_sites,) int
        Units that each site can carry.
    budget_units : int
        At most so many units; more never do harm, so that all are used.
    fusion : {"any", "single"}
        "any": a frame counts if any unit detects; "single": one unit must confirm alone.
    rule : AebRule
        Confirmation and latency.
    """

    table: DetectionTable
    site_index: IntArray
    site_capacity: IntArray
    budget_units: int
    fusion: Fusion
    rule: AebRule

    def __post_init__(self) -> None:
        for field in ("site_index", "site_capacity"):
            array = np.array(getattr(self, field))
            if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer):
                raise InputError(field, array.tolist(), "whole numbers in one row")
            object.__setattr__(self, field, freeze(array.astype(np.int64)))
        n_poses, n_sites = self.table.n_poses, len(self.site_capacity)
        if len(self.site_index) != n_poses:
            raise InputError(
                "site_index", Unquoted(f"{len(self.site_index)} poses"), f"{n_poses} poses"
            )
        if n_poses and not (self.site_index.min() >= 0 and self.site_index.max() < n_sites):
            raise InputError("site_index", self.site_index.tolist(), f"sites 0..{n_sites - 1}")
        if (self.site_capacity < 0).any():
            raise InputError("site_capacity", self.site_capacity.tolist(), "units, at least 0")
        if (self.table.axis.last_brake_time_s == np.inf).any():
            raise InputError("last_brake_time_s", np.inf, "a time, or minus infinity")
        if self.fusion not in get_args(Fusion):
            raise InputError("--fusion", self.fusion, "one of " + ", ".join(get_args(Fusion)))
        is_whole = isinstance(self.budget_units, int) and not isinstance(self.budget_units, bool)
        if not (is_whole and self.budget_units >= 1):
            raise InputError("--budget", self.budget_units, "a whole number of units, at least 1")
        if self.budget_units > self.max_units:
            raise InputError(
                "--budget",
                self.budget_units,
                f"at most {self.max_units}, the units that the sites can carry",
            )

    @property
    def max_units(self) -> int:
        """Units that the sites can carry at most, given their poses."""
        poses_per_site = np.bincount(self.site_index, minlength=len(self.site_capacity))
        return int(np.minimum(poses_per_site, self.site_capacity).sum())

    def __repr__(self) -> str:
        return (
            f"PlacementProblem({self.budget_units} of {self.table.n_poses} poses at "
            f"{len(self.site_capacity)} sites, fusion {self.fusion!r})"
        )


def is_feasible(problem: PlacementProblem, pose_index: Sequence[int]) -> bool:
    """Whether poses are distinct, within the budget and within every site's capacity."""
    at_site = np.bincount(
        problem.site_index[list(pose_index)], minlength=len(problem.site_capacity)
    )
    is_within_budget = len(set(pose_index)) == len(pose_index) <= problem.budget_units
    return is_within_budget and bool((at_site <= problem.site_capacity).all())


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
    is_avoided = run_margins_s(problem, pose_index) > -np.inf
    return weight_share(is_avoided, problem.table.axis.weight)


def apr_one_failed(problem: PlacementProblem, pose_index: Sequence[int]) -> float:
    """Smallest accident prevention ratio that is left when one of the poses fails, 0..1."""
    poses = list(pose_index)
    return min(
        (apr(problem, poses[:failed] + poses[failed + 1 :]) for failed in range(len(poses))),
        default=0.0,
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
    if not counts.any():
        return PlacementValue(0.0, 0.0, 0.0, 0.0)
    return PlacementValue(
        apr=weight_share(counts, weight),
        apr_one_failed=apr_one_failed(problem, pose_index),
        smallest_margin_s=float(margin[counts].min()),
        mean_margin_s=float(np.average(margin[counts], weights=weight[counts])),
    )


def is_better(value: PlacementValue, other: PlacementValue) -> bool:
    """Whether the first difference that exceeds rounding noise favours `value`.

    Examples
    --------
    >>> is_better(PlacementValue(1.0, 0.5, 0.2, 0.3), PlacementValue(1.0, 0.5, 0.1, 0.9))
    True
    """
    for mine, theirs in zip(value, other, strict=True):
        if abs(mine - theirs) > TOLERANCE:
            return mine > theirs
    return False
