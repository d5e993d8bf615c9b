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
from .milp import DEFAULT_SOLVER, Effort, check_solver
from .presolve import PresolveStatistics, ReducedProblem, presolve
from .problem import (
    PlacementProblem,
    PlacementValue,
    apr_failed,
    placement_value,
)
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
    if effort.milp_solver != DEFAULT_SOLVER:
        check_solver(effort.milp_solver)
    check_limits(problem.limits, problem.table.pose_ids)
    if reduced is None and effort.solver != "exact" and is_large(problem):
        return _solve_large(problem, effort, on_stage)
    reduced = presolve(problem) if reduced is None else reduced
    check_reach(problem, reduced)
    search = Search(
        reduced,
        end_s=end_s,
        milp_solver=effort.milp_solver,
        uses_models=effort.solver in ("auto", "exact"),
    )
    search.start([_units_of(reduced, poses) for poses in starts])
    check_floors(problem, search)
    stages = Stages(problem, search, effort)
    records = []
    for name, find_bound in stages.plan():
        if on_stage is not None:
            on_stage(name)
        began_s = time.monotonic()
        bound = find_bound()
        records.append((name, bound, time.monotonic() - began_s))
        _log.info("%s: bound %.6g after %.2f s", name, bound, records[-1][-1])
    assert search.units is not None
    pose_index = to_full(reduced, search.units)
    value = placement_value(problem, pose_index)
    return Solution(
        pose_index=pose_index,
        certificate=Certificate(
            stages=tuple(
                _stage(name, _objective(problem, pose_index, value, name), bound, seconds)
                for name, bound, seconds in records
            ),
            solver=" and ".join(search.proofs) or "simple bounds, no solver",
        ),
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
    bounds_margins = problem.stage_weights is None and problem.tail == 1.0
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
    limits = {"apr": outlook.apr} if problem.tail == 1.0 else {}
    value = {stage.name: stage.objective for stage in found.certificate.stages}
    if bounds_margins and value.get("apr", 0.0) > 0.0:
        limits["mean_margin_s"] = outlook.margins_s / value["apr"]
    all_margins = margin_limits_s(problem)
    limit = problem.measure().of(all_margins > -np.inf)
    limits["apr"] = min(limits.get("apr", 1.0), float(limit))
    stages = []
    for stage in found.certificate.stages:
        if stage.name in ("units", "cost_eur"):
            bound = 1.0 if stage.name == "units" else 0.0
        elif stage.name in ("apr", "apr_one_failed", "apr_survived"):
            bound = limits["apr"]
        else:
            bound = min(limits.get(stage.name, np.inf), float(all_margins.max()))
        stages.append(_stage(stage.name, stage.objective, bound, stage.seconds))
    n_poses = problem.table.n_poses
    return Solution(
        pose_index=tuple(int(pool[pose]) for pose in found.pose_index),
        certificate=Certificate(
            stages=tuple(stages),
            solver=f"Lagrangian relaxation of all {n_poses} poses, search among {len(pool)}",
        ),
        presolve=replace(found.presolve, n_poses=(n_poses, found.presolve.n_poses[1])),
    )


def _objective(
    problem: PlacementProblem, pose_index: tuple[int, ...], value: PlacementValue, name: str
) -> float:
    if name == "units":
        return float(len(pose_index))
    if name == "weighted":
        assert problem.stage_weights is not None
        *weights, cost_weight = problem.stage_weights
        gains = sum(w * v for w, v in zip(weights, value[:-1], strict=True))
        return float(gains - cost_weight * value.cost_eur)
    if name == "apr_survived":
        return apr_failed(problem, pose_index, problem.survive)
    return float(getattr(value, name))


def _stage(name: str, objective: float, bound: float, seconds: float) -> Stage:
    is_minimised = name in ("units", "cost_eur")
    bound = min(bound, objective) if is_minimised else max(bound, objective)
    gap = relative_gap(objective, bound)
    return Stage(
        name=name,
        objective=objective,
        bound=objective if gap == 0.0 else bound,
        gap=gap,
        seconds=seconds,
    )
