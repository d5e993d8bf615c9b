"""Speed of the optimiser: against bare HiGHS, against spopt, and on instances of growing size."""

import os
import resource
import time
import warnings
from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp

from geometry.arrays import BoolArray, FloatArray
from placement.candidates import CandidatePose
from placement.detection_table import DetectionTable
from placement.optimiser import (
    Effort,
    Limits,
    PlacementProblem,
    presolve,
    run_margins_s,
    solve_placement,
)
from placement.optimiser.covering import solve_mclp
from placement.optimiser.covering_instance import build_covering_instance
from placement.optimiser.pareto import pareto_front
from placement.setting import Setting
from placement.visibility.build import build_detection_table
from placement.wishes import Wishes, build_problem
from scenarios.aeb import load_aeb_rule

from .synthetic import SyntheticSize, build_synthetic_instance
from .timing import in_turn, ratio

_WORKERS = os.cpu_count() or 1
_FRONT_UNITS = 8
_MCLP_POSES, _MCLP_ROWS, _MCLP_UNITS = 1500, 4000, 3
_MCLP_RADIUS = 0.1  # of the unit square
_LARGE_UNITS, _LARGE_GAP, _LARGE_TIME_S = 6, 0.01, 300.0


def measure_optimiser(
    setting: Setting, candidates: Sequence[CandidatePose], budget: int
) -> dict[str, Any]:
    """Presolve and all stages, fronts, and maximal covering against HiGHS alone.

    Parameters
    ----------
    setting : Setting
        What is driven.
    candidates : sequence of CandidatePose
        Poses to choose from.
    budget : int
        Units.
    """
    table = build_detection_table(
        setting.scene,
        candidates,
        setting.runs,
        setting.axis,
        detector=setting.planner,
        workers=_WORKERS,
    )
    wishes = Wishes(budget_units=budget)
    problem = build_problem(setting, candidates, table, wishes=wishes, fusion="any")
    began_s = time.perf_counter()
    reduced = presolve(problem)
    presolve_s = time.perf_counter() - began_s
    solution = solve_placement(problem, reduced)
    all_stages_s = time.perf_counter() - began_s
    figures = {
        "optimiser: poses x runs x frames": f"{table.n_poses} x {table.axis.n_runs} x "
        f"{table.axis.n_frames}",
        "optimiser: presolve": str(solution.presolve),
        "optimiser: seconds, presolve": presolve_s,
        "optimiser: seconds, presolve and all stages (under 10)": all_stages_s,
        "optimiser: all stages proven": solution.certificate.is_proven,
    }
    for stages in ("first", "all"):
        began_s = time.perf_counter()
        front = pareto_front(
            problem,
            max_units=_FRONT_UNITS,
            stages=stages,
            effort=Effort(time_limit_s=60.0),
        )
        what = "APR and one failed" if stages == "first" else "all stages"
        name = f"optimiser: front K = 1..{_FRONT_UNITS}, {what}"
        figures[f"{name}: seconds (under 60)"] = time.perf_counter() - began_s
        figures[f"{name}: proven"] = front.is_proven
    single = build_problem(setting, candidates, table, wishes=wishes, fusion="single")
    return figures | _measure_single(single, table)


def _measure_single(single: PlacementProblem, table: DetectionTable) -> dict[str, Any]:
    covers = _covers(single, table)
    best: dict[str, float] = {}

    def ours() -> None:
        best["ours"] = solve_placement(single).certificate.stages[0].objective

    def direct() -> None:
        best["HiGHS"] = _solve_mclp(covers, single)

    ours_s, direct_s = in_turn(ours, direct)
    if not np.isclose(best["ours"], best["HiGHS"], atol=1e-6):
        raise RuntimeError(f"optima differ: {best}")
    return {"optimiser: all stages, single / bare HiGHS, APR only": ratio(ours_s, direct_s)}


def _covers(problem: PlacementProblem, table: DetectionTable) -> BoolArray:
    """A[c, r]: whether pose c avoids run r by itself."""
    return np.stack([np.isfinite(run_margins_s(problem, [pose])) for pose in range(table.n_poses)])


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


# ---------------------------------------------------------------- maximal covering


def measure_covering() -> dict[str, Any]:
    """Maximal covering, model building included, against spopt with CBC on the same instance."""
    name = f"covering: {_MCLP_POSES} x {_MCLP_ROWS}, K = {_MCLP_UNITS}"
    random = np.random.default_rng(0)
    poses, rows = random.random((_MCLP_POSES, 2)), random.random((_MCLP_ROWS, 2))
    distance: FloatArray = np.linalg.norm(poses[:, None] - rows[None], axis=2)
    weight = random.integers(1, 10, _MCLP_ROWS).astype(np.float64)
    began_s = time.perf_counter()
    found = solve_mclp(
        build_covering_instance(distance < _MCLP_RADIUS, weight=weight), budget_units=_MCLP_UNITS
    )
    ours_s = time.perf_counter() - began_s
    figures: dict[str, Any] = {f"{name}: seconds": ours_s}
    if find_spec("spopt") is None:
        return figures | {f"{name}: spopt with CBC": "not installed: uv run --group bench"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its own
        import pulp
        from spopt.locate import MCLP

        began_s = time.perf_counter()
        model = MCLP.from_cost_matrix(
            np.where(distance.T < _MCLP_RADIUS, 0.0, 1.0), weight, 0.5, p_facilities=_MCLP_UNITS
        ).solve(pulp.PULP_CBC_CMD(msg=False))
        theirs_s = time.perf_counter() - began_s
    theirs = float(model.problem.objective.value())
    if not np.isclose(found.objective, theirs):
        raise RuntimeError(f"optima differ: ours {found.objective}, spopt {theirs}")
    return figures | {
        f"{name}: spopt with CBC, seconds": theirs_s,
        f"{name}: spopt / ours (at least 10)": theirs_s / ours_s,
    }


# ---------------------------------------------------------------- a hundred times larger


def measure_large() -> dict[str, Any]:
    """A made-up instance of 200,000 poses and 50,000 frames."""
    size = SyntheticSize()
    name = f"large: {size.n_poses} x {size.n_frames}, K = {_LARGE_UNITS}"
    began_s = time.perf_counter()
    instance = build_synthetic_instance(size, workers=_WORKERS)
    problem = PlacementProblem(
        table=instance.to_table(),
        limits=Limits(
            site_index=instance.site_index,
            site_capacity=instance.site_capacity,
            budget_units=_LARGE_UNITS,
        ),
        fusion="any",
        rule=load_aeb_rule(),
    )
    built_s = time.perf_counter() - began_s
    began_s = time.perf_counter()
    effort = Effort(time_limit_s=_LARGE_TIME_S, gap=_LARGE_GAP)
    solution = solve_placement(problem, effort=effort)
    first = solution.certificate.stages[0]
    return {
        f"{name}: seconds to make it up": built_s,
        f"{name}: seconds (under 300)": time.perf_counter() - began_s,
        f"{name}: APR": first.objective,
        f"{name}: proven gap, % (at most 1)": 100.0 * first.gap,
        f"{name}: peak memory, GiB (under 6)": (
            resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        ),
    }
