"""The stages in order, each holding those before it, each with a proven bound."""

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import IntArray

from ..layout import Certificate, Stage, relative_gap
from .feasibility import check_floors, check_limits, check_reach
from .greedy import to_full
from .large import (
    is_large,
    look_out,
    margin_limits_s,
    of_pool,
)
from .milp import Effort
from .objectives import Objective
from .presolve import PresolveStatistics, ReducedProblem, presolve
from .problem import PlacementProblem, objective_values
from .relaxation import relaxation_text
from .search import Search
from .stages import Stages

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Chosen poses, and how good they are proven to be.

    Attributes
    ----------
    pose_index : tuple of int
        Rows of the detection table, ascending.
    certificate : Certificate
        A stage for every objective, in order.
    presolve : PresolveStatistics
        What dropped out before.
    """

    pose_index: tuple[int, ...]
    certificate: Certificate
    presolve: PresolveStatistics


def solve_placement(
    problem: PlacementProblem,
    reduced: ReducedProblem | None = None,
    *,
    effort: Effort | None = None,
    starts: Sequence[IntArray] = (),
    on_stage: Callable[[str], None] | None = None,
) -> Solution:
    """Best poses: by APR, then APR when one unit fails, smallest margin, mean margin, cost.

    Parameters
    ----------
    problem : PlacementProblem
        What to solve.
    reduced : ReducedProblem, optional
        Its presolved form, where that is at hand.
    effort : Effort, optional
        How hard to try; by default a minute.
    starts : sequence of (n,) int
        Rows of the table that are tried first, such as a good layout for a unit less.
    on_stage : callable, optional
        Called with the name of every stage when it begins.

    Returns
    -------
    solution : Solution
        The bound of a stage is what no layout can exceed that is as good in all stages before. A
        problem whose goal is "fewest" or "cheapest" begins with the stage "units" or "cost_eur",
        one that must survive failures with "apr_survived".

    Raises
    ------
    InputError
        Nothing meets the wishes: the message says which cannot be met, and the best that can. Or
        nothing was found that does in the time given.
    """
    effort = Effort() if effort is None else effort
    end_s = time.monotonic() + effort.time_limit_s
    check_limits(problem.limits, problem.table.pose_ids)
    if reduced is None and effort.solver != "exact" and is_large(problem):
        return _solve_large(problem, effort, on_stage)
    reduced = presolve(problem) if reduced is None else reduced
    check_reach(problem, reduced)
    search = Search(
        reduced,
        end_s=end_s,
        uses_models=effort.solver in ("auto", "exact"),
    )
    search.start([_units_of(reduced, poses) for poses in starts])
    check_floors(problem, search)
    stages = Stages(problem, search, effort)
    records = []
    for objective, find_bound in stages.plan():
        if on_stage is not None:
            on_stage(objective.value)
        began_s = time.monotonic()
        bound = find_bound()
        records.append((objective, bound, time.monotonic() - began_s))
        _log.info("%s: bound %.6g after %.2f s", objective, bound, records[-1][-1])
    assert search.units is not None
    pose_index = to_full(reduced, search.units)
    return Solution(
        pose_index=pose_index,
        certificate=build_certificate(problem, pose_index, records, search),
        presolve=reduced.statistics,
    )


def _units_of(reduced: ReducedProblem, poses: IntArray) -> IntArray:
    """Poses of the reduced problem; those that have dropped out are left out."""
    units: IntArray = np.flatnonzero(np.isin(reduced.pose_index, poses))
    return units


def _solve_large(
    problem: PlacementProblem, effort: Effort, on_stage: Callable[[str], None] | None
) -> Solution:
    """The best among promising poses, bounded by what all poses promise."""
    end_s = time.monotonic() + effort.time_limit_s
    bounds_margins = problem.tail == 1.0
    outlook = look_out(problem, has_margins=bounds_margins, on_step=on_stage)
    pool = outlook.pool
    places = [np.searchsorted(pool, poses) for poses in outlook.sets]
    part = of_pool(problem, pool)
    found = solve_placement(
        part,
        presolve(part),
        effort=replace(
            effort,
            solver="greedy",
            time_limit_s=max(end_s - time.monotonic(), 1.0e-3),
        ),
        starts=places,
        on_stage=on_stage,
    )
    all_margins = margin_limits_s(problem)
    apr = float(problem.measure().of(all_margins > -np.inf))
    largest_s = mean_s = float(all_margins.max())
    if bounds_margins:
        apr = min(apr, outlook.apr)
        value = {stage.name: stage.objective for stage in found.certificate.stages}
        if value[Objective.APR] > 0.0:
            mean_s = min(mean_s, outlook.margins_s / value[Objective.APR])
    bounds = {
        Objective.UNITS: 1.0,
        Objective.COST: 0.0,
        Objective.APR_SURVIVED: apr,
        Objective.APR: apr,
        Objective.APR_ONE_FAILED: apr,
        Objective.SMALLEST_MARGIN: largest_s,
        Objective.MEAN_MARGIN: mean_s,
    }
    stages = []
    for stage in found.certificate.stages:
        objective = Objective(stage.name)
        stages.append(build_stage(objective, stage.objective, bounds[objective], stage.seconds))
    n_poses = problem.table.n_poses
    return Solution(
        pose_index=tuple(int(pool[pose]) for pose in found.pose_index),
        certificate=Certificate(
            stages=tuple(stages),
            solver=f"{relaxation_text()}: relaxation of all {n_poses} poses, search among "
            f"{len(pool)}",
        ),
        presolve=replace(found.presolve, n_poses=(n_poses, found.presolve.n_poses[1])),
    )


def build_certificate(
    problem: PlacementProblem,
    pose_index: tuple[int, ...],
    records: Sequence[tuple[Objective, float, float]],
    search: Search,
) -> Certificate:
    """A certificate from the bound and the seconds of each stage."""
    values = objective_values(problem, pose_index)
    return Certificate(
        stages=tuple(
            build_stage(objective, values[objective], bound, seconds)
            for objective, bound, seconds in records
        ),
        solver=" and ".join(search.proofs) or "simple bounds, no solver",
    )


def build_stage(objective: Objective, value: float, bound: float, seconds: float) -> Stage:
    """A stage of a certificate; a bound that is worse than the value itself is not believed."""
    bound = objective.better(bound, value)
    gap = relative_gap(value, bound)
    return Stage(
        name=objective.value,
        objective=value,
        bound=value if gap == 0.0 else bound,
        gap=gap,
        seconds=seconds,
    )
