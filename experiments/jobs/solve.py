"""``place-rsus solve``: read a problem, solve it, prove the answer, tell what was found."""

import time
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from geometry.errors import InputError
from geometry.phrases import Phrase
from placement.optimiser import Effort, Floor, PlacementProblem, apr, cost_eur, solve_placement
from placement.optimiser.timing import SolverName
from placement.verification.instances import load_problem

from ..language import mark
from ..progress import StageProgress
from ..results.record import Record, StageRecord, build_stage_records

HIGHS = "HIGHS"
_SEARCHES = ("auto", "exact", "relax", "greedy")


class PlacementSolution(Record, frozen=True, kw_only=True):
    """A placement problem solved, with its frames and windows."""

    file: str
    problem: str
    goal: str
    fusion: str
    objective: float
    bound: float
    gap: float
    chosen: tuple[int, ...]
    numbered_from: int
    chosen_names: tuple[str, ...]
    seconds: float
    is_proven: bool
    solver: str
    cost: float
    stages: tuple[StageRecord, ...]
    columns: int
    rows: int
    presolve_effect: str


def run_solve(
    path: Path,
    *,
    budget_units: int | None,
    budget_cost: float | None,
    target: float | None,
    track_memory_s: float | None,
    solver: str,
    time_limit_s: float,
    gap: float,
    progress: StageProgress,
) -> PlacementSolution:
    """Read a placement problem, ``instance.npz`` of a result folder, and solve it.

    Budgets, target (infinity: all that can be avoided) and memory of tracks are in place of the
    file's own. Raises InputError if the file is damaged, or the question has no answer.
    """
    progress(mark("read"), 0, 0)
    problem = load_problem(path)
    if track_memory_s is not None:
        try:
            rule = replace(problem.rule, track_memory_s=track_memory_s)
        except InputError as error:
            raise InputError("--track-memory", error.got, error.expected) from None
        problem = replace(problem, rule=rule)
    problem = _asked(problem, budget_units, budget_cost, target)
    if solver.upper() == HIGHS:
        solver = "exact"
    if solver not in _SEARCHES:
        raise InputError("--solver", solver, f"one of {', '.join(_SEARCHES)}, {HIGHS}")
    effort = Effort(solver=cast(SolverName, solver), time_limit_s=time_limit_s, gap=gap)
    began_s = time.perf_counter()
    solution = solve_placement(
        problem,
        effort=effort,
        on_stage=lambda stage: progress(Phrase("solve: {goal}", goal=stage), 0, 0),
    )
    first = solution.certificate.stages[0]
    return PlacementSolution(
        file=path.name,
        problem="placement",
        goal=problem.goal,
        fusion=problem.fusion,
        objective=first.objective,
        bound=first.bound,
        gap=first.gap,
        chosen=tuple(solution.pose_index),
        numbered_from=0,
        chosen_names=tuple(problem.table.pose_ids[pose] for pose in solution.pose_index),
        seconds=round(time.perf_counter() - began_s, 4),
        is_proven=solution.certificate.is_proven,
        solver=solution.certificate.solver,
        cost=cost_eur(problem.limits, solution.pose_index),
        stages=build_stage_records(solution.certificate),
        columns=problem.table.n_poses,
        rows=problem.table.axis.n_frames,
        presolve_effect=str(solution.presolve),
    )


def _asked(
    problem: PlacementProblem,
    budget_units: int | None,
    budget_cost: float | None,
    target: float | None,
) -> PlacementProblem:
    """The problem with the question of the command line in place of its own."""
    if budget_units is not None or budget_cost is not None:
        limits = replace(problem.limits, budget_units=budget_units, budget_eur=budget_cost)
        problem = replace(problem, limits=limits, goal="best", floors=())
    if target is None:
        return problem
    usable = np.flatnonzero(~problem.limits.is_forbidden).tolist()
    share = min(apr(problem, usable), 1.0) if target == np.inf else target
    if not 0.0 <= share <= 1.0:
        raise InputError("--target", target, "max, or a share of the runs, 0 to 1")
    limits = replace(problem.limits, budget_units=None, budget_eur=None)
    floor = Floor(name="--target", share=share)
    return replace(problem, limits=limits, goal="fewest", floors=(floor,))
