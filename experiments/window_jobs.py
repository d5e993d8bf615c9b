"""``place-rsus solve`` on a whole placement problem, with its frames and windows."""

import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from geometry.errors import InputError
from placement.instance import load_problem
from placement.optimiser import (
    Effort,
    Floor,
    PlacementProblem,
    apr,
    cost_eur,
    solve_placement,
)
from placement.optimiser.milp import DEFAULT_SOLVER, check_solver

from .progress import StageProgress
from .tables import percent

_SEARCHES = ("auto", "exact", "relax", "greedy")


def run_solve_windows(
    path: Path,
    *,
    budget_units: int | None,
    budget_cost: float | None,
    target: float | None,
    solver: str,
    time_limit_s: float,
    gap: float,
    progress: StageProgress,
) -> dict[str, Any]:
    """Read a placement problem and solve it.

    Parameters
    ----------
    path : Path
        As ``place-rsus`` writes it: ``instance.npz`` of a result folder.
    budget_units, budget_cost : int, float or None
        In place of the file's own question.
    target : float or None
        In place of the file's own question: share of the runs to avoid, with the fewest units;
        infinity: all that can be avoided.
    solver : str
        auto, exact, relax, greedy, or a mixed-integer solver by its name in cvxpy.
    time_limit_s, gap
        See :class:`placement.optimiser.Effort`.
    progress : StageProgress
        Shows what happens.

    Returns
    -------
    summary : dict
        The keys of every solved file - objective, bound, gap, chosen, seconds - and all stages.

    Raises
    ------
    InputError
        The file is damaged, or the question has no answer.
    """
    progress("read", 0, 0)
    problem = _asked(load_problem(path), budget_units, budget_cost, target)
    is_search = solver in _SEARCHES
    effort = Effort(
        solver="exact" if not is_search else solver,  # type: ignore[arg-type]
        milp_solver=DEFAULT_SOLVER if is_search else check_solver(solver),
        time_limit_s=time_limit_s,
        gap=gap,
    )
    began_s = time.perf_counter()
    solution = solve_placement(
        problem, effort=effort, on_stage=lambda stage: progress(f"solve: {stage}", 0, 0)
    )
    first = solution.certificate.stages[0]
    return {
        "file": path.name,
        "problem": "placement",
        "goal": problem.goal,
        "fusion": problem.fusion,
        "objective": first.objective,
        "bound": first.bound,
        "gap": first.gap,
        "chosen": list(solution.pose_index),
        "numbered_from": 0,
        "chosen_names": [problem.table.pose_ids[pose] for pose in solution.pose_index],
        "seconds": round(time.perf_counter() - began_s, 4),
        "is_proven": solution.certificate.is_proven,
        "solver": solution.certificate.solver,
        "cost": cost_eur(problem.limits, solution.pose_index),
        "stages": [asdict(stage) for stage in solution.certificate.stages],
        "columns": problem.table.n_poses,
        "rows": problem.table.axis.n_frames,
        "presolve_effect": str(solution.presolve),
    }


def window_text(summary: dict[str, Any]) -> str:
    """What :func:`run_solve_windows` found, for a terminal."""
    lines = [f"{summary['file']}: {summary['goal']} layout, fusion {summary['fusion']}"]
    for stage in summary["stages"]:
        is_share = stage["name"].startswith("apr")
        objective, bound = (
            percent(stage[key]) if is_share else f"{stage[key]:.6g}"
            for key in ("objective", "bound")
        )
        proof = "proven" if stage["gap"] == 0.0 else f"bound {bound}"
        lines.append(f"  {stage['name']:<18}{objective:>12}  {proof}")
    lines += [f"  chosen            {name}" for name in summary["chosen_names"]]
    lines += [
        f"  presolve          {summary['presolve_effect']}",
        f"  solver            {summary['solver']}; {summary['seconds']:.2f} s",
    ]
    return "\n".join(lines)


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
