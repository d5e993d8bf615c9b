"""Speed of the optimiser: all stages by budget, and against bare HiGHS."""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp

from geometry.arrays import BoolArray
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.optimiser import Effort, PlacementProblem, presolve, run_margins_s, solve_placement
from placement.optimiser.problem import Fusion
from placement.setting import Setting
from placement.visibility.build import build_detection_table
from placement.wishes import Wishes, build_problem

from .rays import WORKERS, Figures, in_turn, ratio

_TRACK_MEMORIES_S = (np.inf, 1.0)
_BUDGETS = (2, 3, 4, 5)
_BUDGET_TIME_S = 20.0


def build_bench_problem(
    setting: Setting, candidates: Sequence[CandidatePose], budget: int, *, fusion: Fusion = "any"
) -> PlacementProblem:
    """The question of so many units, on a table that is built for it."""
    table = build_detection_table(
        setting.scene,
        candidates,
        setting.runs,
        setting.axis,
        detector=setting.table_detector,
        compute=Compute(workers=WORKERS),
    )
    wishes = Wishes(budget_units=budget)
    return build_problem(setting, candidates, table, wishes=wishes, fusion=fusion)


def measure_optimiser(problem: PlacementProblem) -> Figures:
    """Presolve, and all stages for growing budgets."""
    table = problem.table
    began_s = time.perf_counter()
    presolve(problem)
    return {
        "optimiser: poses x runs x frames": f"{table.n_poses} x {table.axis.n_runs} x "
        f"{table.axis.n_frames}",
        "optimiser: seconds, presolve": time.perf_counter() - began_s,
        **measure_budgets(problem),
    }


def measure_budgets(problem: PlacementProblem, *, units: Sequence[int] = _BUDGETS) -> Figures:
    """Presolve and all stages for growing budgets, with tracks that live on and that end."""
    figures: Figures = {}
    for memory_s in _TRACK_MEMORIES_S:
        for budget in units:
            asked = replace(
                problem,
                rule=replace(problem.rule, track_memory_s=memory_s),
                limits=replace(problem.limits, budget_units=budget),
            )
            began_s = time.perf_counter()
            solution = solve_placement(asked, effort=Effort(time_limit_s=_BUDGET_TIME_S))
            name = f"optimiser: track memory {memory_s:g} s, K = {budget}"
            figures[f"{name}: seconds, presolve and all stages"] = time.perf_counter() - began_s
            figures[f"{name}: proven"] = solution.certificate.is_proven
    return figures


def measure_single(single: PlacementProblem) -> Figures:
    """All stages where each unit confirms alone, against maximal covering by HiGHS alone."""
    covers = _covers(single)
    best: dict[str, float] = {}

    def ours() -> None:
        best["ours"] = solve_placement(single).certificate.stages[0].objective

    def direct() -> None:
        best["HiGHS"] = _solve_mclp(covers, single)

    ours_s, direct_s = in_turn(ours, direct, repeats=1)  # HiGHS takes minutes
    if not np.isclose(best["ours"], best["HiGHS"], atol=1e-6):
        raise RuntimeError(f"optima differ: {best}")
    return {"optimiser: all stages, single / bare HiGHS, APR only": ratio(ours_s, direct_s)}


def _covers(problem: PlacementProblem) -> BoolArray:
    """A[c, r]: pose c avoids run r by itself."""
    return np.stack(
        [np.isfinite(run_margins_s(problem, [pose])) for pose in range(problem.table.n_poses)]
    )


def _solve_mclp(covers: BoolArray, problem: PlacementProblem) -> float:
    """Maximal covering by SciPy's HiGHS without any presolve of ours; returns the APR."""
    n_poses, n_runs = covers.shape
    weight = problem.table.axis.weight
    chosen = np.concatenate([np.ones(n_poses), np.zeros(n_runs)])
    cover = np.hstack([-covers.T.astype(float), np.eye(n_runs)])
    result = milp(
        -np.concatenate([np.zeros(n_poses), weight]),
        integrality=chosen,
        bounds=Bounds(0.0, 1.0),
        constraints=[
            LinearConstraint(chosen, ub=float(problem.limits.max_units)),
            LinearConstraint(cover, ub=0.0),
        ],
    )
    solution: Any = result.x
    return float(solution[n_poses:] @ weight)
