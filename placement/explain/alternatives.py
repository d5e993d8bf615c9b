"""Layouts that other priorities choose, and a choice among leaders.

Leaders on the detection table are compared by the evaluator.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from geometry.arrays import BoolArray
from geometry.phrases import Phrase
from geometry.tables import says
from scenarios.aeb import AebRule
from scenarios.weights import weight_share

from ..cache import cached_value
from ..detection_table import is_mixed
from ..evaluation import Evaluation, apr_one_failed, headline_apr, mix
from ..layout import Layout
from ..optimiser import (
    Effort,
    PlacementProblem,
    Solution,
    presolve,
    run_margins_s,
    solve_placement,
)
from ..optimiser.constants import TOLERANCE
from ..optimiser.problem import Fusion
from ..optimiser.solve import is_large

STAGE = Phrase("other priorities")
# Most time for each alternative: it is mentioned in passing.
TIME_LIMIT_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ByRuns:
    """The best layout if every run counted the same, on the detection table."""

    units: Annotated[
        tuple[str, ...],
        says(
            "Ids of the candidate poses that avoid the most runs, as far as was found."
        ),
    ]
    runs_avoided: Annotated[int, says("Runs that it avoids.")]
    runs_avoided_here: Annotated[
        int, says("Runs that the layout found avoids, before it was refined.")
    ]
    is_proven: Annotated[bool, says("No layout is proven to avoid more.")]


def find_by_runs(
    problem: PlacementProblem,
    pose_index: Sequence[int],
    *,
    effort: Effort,
    cache_folder: Path | None = None,
) -> ByRuns | None:
    """The layout that avoids the most runs, within the same limits.

    None where the highest APR is not asked for, all runs count the same anyway, worlds
    are sampled, or the problem is too large for a proof.
    """
    axis = problem.table.axis
    is_best = problem.goal == "best" and problem.survive == 0
    is_whole = (
        problem.sample_index is None and not is_mixed(axis) and not is_large(problem)
    )
    if not (is_best and is_whole) or np.ptp(axis.weight) <= TOLERANCE / axis.n_runs:
        return None
    # The same problem, in which every run counts the same.
    alike = replace(axis, weight=np.full(axis.n_runs, 1.0 / axis.n_runs))
    by_runs = replace(problem, table=replace(problem.table, axis=alike))
    effort = replace(effort, time_limit_s=min(effort.time_limit_s, TIME_LIMIT_S))
    # Start from the layout at hand, so that the answer is never worse.
    start = np.array(sorted(pose_index), dtype=np.int64)
    found = cached_value(
        cache_folder,
        "by-runs",
        lambda: solve_placement(
            by_runs, presolve(by_runs), effort=effort, starts=[start], n_stages=1
        ),
        kind=Solution,
        made_from=(by_runs, effort, start, 1),
        is_worth_it=lambda solution: solution.certificate.is_proven,
    )
    here, there = (
        int(np.isfinite(run_margins_s(problem, rows)).sum())
        for rows in (pose_index, found.pose_index)
    )
    rows = found.pose_index if there > here else pose_index
    return ByRuns(
        units=tuple(problem.table.pose_ids[row] for row in rows),
        runs_avoided=max(here, there),
        runs_avoided_here=here,
        is_proven=found.certificate.is_proven,
    )


# ---------- front-runners, by the evaluator
# Front-runners no farther apart are equal: results print a tenth of a point.
EQUAL_APR = 0.001

Deciding = Literal["apr", "apr_one_failed", "mounting", "order"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrontRunner:
    """A layout that leads on the detection table, by the evaluator.

    Attributes
    ----------
    layout : Layout
        Its units.
    apr, apr_one_failed : float
        All units together, and when the most needed one fails; 0 for a single
        unit. 0..1.
    """

    layout: Layout
    apr: float
    apr_one_failed: float


def build_front_runner(
    evaluation: Evaluation, rule: AebRule, *, fusion: Fusion
) -> FrontRunner:
    """A layout as the evaluator sees it, under the fusion that it was chosen with."""
    axis = evaluation.axis
    if fusion == "any":
        return FrontRunner(
            layout=evaluation.layout,
            apr=headline_apr(evaluation),
            apr_one_failed=apr_one_failed(evaluation, rule),
        )
    # Each unit confirms alone: a run is avoided if any of them avoids it.
    alone = np.array([unit.is_avoided for unit in evaluation.units.values()])
    own = evaluation.vut.is_avoided
    cars = evaluation.cars

    def share(units: BoolArray) -> float:
        is_avoided = units.any(axis=0)
        blind = weight_share(is_avoided, axis.weight)
        return mix(blind, weight_share(is_avoided | own, axis.weight), cars)

    return FrontRunner(
        layout=evaluation.layout,
        apr=share(alone),
        apr_one_failed=min(
            share(np.delete(alone, unit, axis=0)) for unit in range(len(alone))
        ),
    )


def recommend(
    runners: Sequence[FrontRunner], mounted_wrongly: Callable[[int], float]
) -> tuple[int, Deciding]:
    """Number of the front-runner to recommend, and what decided.

    The second value says what the first one was passed over for. In this order:
    APR; APR when the most needed unit fails; APR that a usual error of mounting
    leaves, `mounted_wrongly` by number, asked only for those equal so far.
    Differences up to ``EQUAL_APR`` are none. Of equals the first is recommended:
    "order".
    """
    left = list(range(len(runners)))
    keys: tuple[tuple[Deciding, Callable[[int], float]], ...] = (
        ("apr", lambda number: runners[number].apr),
        ("apr_one_failed", lambda number: runners[number].apr_one_failed),
        ("mounting", mounted_wrongly),
    )
    deciding: Deciding = "order"
    # Each key keeps the leaders up to a tolerance.
    for name, key in keys:
        if len(left) == 1:
            break
        values = {number: key(number) for number in left}
        most = max(values.values())
        had_first = 0 in left
        left = [number for number in left if values[number] >= most - EQUAL_APR]
        if had_first and 0 not in left:
            deciding = name
    return left[0], deciding
