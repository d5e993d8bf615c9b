"""Layouts that other priorities choose: every run alike, or what is left when a unit fails."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..cache import cached_value
from ..optimiser import (
    Effort,
    PlacementProblem,
    PlacementValue,
    Solution,
    placement_value,
    presolve,
    run_margins_s,
    solve_placement,
)
from ..optimiser.solve import is_large
from ..optimiser.steering import TOLERANCE

STAGE = "other priorities"
TIME_LIMIT_S = 10.0
"""Most time for each alternative: it is told of in passing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ByRuns:
    """A layout, and the best one if every run counted the same.

    Attributes
    ----------
    pose_index : tuple of int
        Rows of the table that avoid the most runs, as far as was found.
    n_avoided, n_avoided_here : int
        Runs that these avoid, and the layout itself, on the table.
    is_proven : bool
        Whether no set avoids more than `n_avoided`.
    """

    pose_index: tuple[int, ...]
    n_avoided: int
    n_avoided_here: int
    is_proven: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Sturdier:
    """The layout of which the most is left when any one unit fails.

    Attributes
    ----------
    pose_index : tuple of int
        Rows of the table.
    value, value_here : PlacementValue
        What these are worth, and the layout itself.
    """

    pose_index: tuple[int, ...]
    value: PlacementValue
    value_here: PlacementValue


def find_by_runs(
    problem: PlacementProblem,
    pose_index: Sequence[int],
    *,
    effort: Effort,
    cache_folder: Path | None = None,
) -> ByRuns | None:
    """The layout that avoids the most runs, within the same limits.

    None where it is not asked for the highest APR, where all runs count the same anyway, and of
    problems in sampled worlds or too large for a proof.
    """
    axis = problem.table.axis
    if not _is_plain(problem) or np.ptp(axis.weight) <= TOLERANCE / axis.n_runs:
        return None
    alike = replace(axis, weight=np.full(axis.n_runs, 1.0 / axis.n_runs))
    by_runs = replace(problem, table=replace(problem.table, axis=alike))
    found = _solve("by-runs", by_runs, pose_index, effort, cache_folder, n_stages=1)
    here, there = (
        int(np.isfinite(run_margins_s(problem, rows)).sum())
        for rows in (pose_index, found.pose_index)
    )
    return ByRuns(
        pose_index=found.pose_index if there > here else tuple(pose_index),
        n_avoided=max(here, there),
        n_avoided_here=here,
        is_proven=found.certificate.is_proven,
    )


def find_sturdier(
    problem: PlacementProblem,
    pose_index: Sequence[int],
    *,
    effort: Effort,
    cache_folder: Path | None = None,
) -> Sturdier | None:
    """The layout that the APR that is left when a unit fails would choose, before all else.

    None as for :func:`find_by_runs`, and of a single unit.
    """
    if not _is_plain(problem) or len(pose_index) < 2:
        return None
    survives = replace(problem, survive=1)
    found = _solve("sturdier", survives, pose_index, effort, cache_folder, n_stages=2)
    return Sturdier(
        pose_index=found.pose_index,
        value=placement_value(problem, found.pose_index),
        value_here=placement_value(problem, pose_index),
    )


def _is_plain(problem: PlacementProblem) -> bool:
    """Whether the highest APR is asked for, in the world as planned, of a table of usual size."""
    is_best = problem.goal == "best" and problem.survive == 0
    return is_best and problem.sample_index is None and not is_large(problem)


def _solve(
    name: str,
    problem: PlacementProblem,
    start: Sequence[int],
    effort: Effort,
    cache_folder: Path | None,
    *,
    n_stages: int,
) -> Solution:
    limit_s = min(effort.time_limit_s, TIME_LIMIT_S)
    effort = replace(effort, time_limit_s=limit_s)
    rows = np.array(sorted(start), dtype=np.int64)
    return cached_value(
        cache_folder,
        name,
        lambda: solve_placement(
            problem, presolve(problem), effort=effort, starts=[rows], n_stages=n_stages
        ),
        kind=Solution,
        made_from=(problem, effort, rows, n_stages),
        is_worth_it=lambda solution: solution.certificate.is_proven,
    )
