"""Speed as ratios to named references, measured in one run: ``python -m experiments.bench``.

Absolute times depend on the machine and its load; the ratios depend on them little, because both
sides are measured in turn, in the same process or as the same kind of process.
"""

import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp

from geometry.arrays import BoolArray
from geometry.raycast import caster_name
from geometry.scene_files import load_study_scene
from placement.candidates import CandidatePose, build_candidates, load_candidate_grid
from placement.detection_table import DetectionTable
from placement.evaluator import evaluate_layout
from placement.layout import Layout
from placement.optimiser import PlacementProblem, run_margins_s, solve_placement
from placement.setting import Setting
from placement.visibility.build import build_detection_table
from placement.wishes import Wishes, build_problem

from .bench_perception import measure_perception
from .bench_rays import N_MOUNTS, measure_casting
from .driving import build_setting
from .question import Question
from .study import load_carlancap_layout
from .timing import REPEATS, in_turn, ratio

_WORKERS = os.cpu_count() or 1
_OWN_CASES = "CPNC-50,CBNA,CBLA"  # the study's: rays and optimiser are measured on their 104 runs


@click.command()
@click.option("--budget", default=3, show_default=True, help="Units of the main job.")
@click.option("--out", type=click.Path(path_type=Path), help="JSON file for the figures.")
def main(budget: int, out: Path | None) -> None:
    """Measure rays, optimiser, growth with the runs, perception, and the whole command."""
    setting = build_setting(Question(cases=_OWN_CASES), load_study_scene())
    candidates = build_candidates(
        setting.scene, load_candidate_grid(), extra=load_carlancap_layout().units
    )
    figures = {
        "processors": os.cpu_count(),
        "rays by": caster_name(),
        **measure_casting(setting, candidates),
        **_measure_optimiser(setting, candidates, budget),
        **_measure_growth(candidates),
        **measure_perception(setting),
        **_measure_command(budget),
    }
    for name, value in figures.items():
        shown = f"{value:.3g}" if isinstance(value, float) else value
        click.echo(f"{name:<64} {shown}")
    if out is not None:
        out.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


# ---------------------------------------------------------------- optimiser


def _measure_optimiser(
    setting: Setting, candidates: tuple[CandidatePose, ...], budget: int
) -> dict[str, Any]:
    """All stages of the optimiser; and the maximal covering problem against HiGHS alone."""
    table = build_detection_table(
        setting.scene,
        candidates,
        setting.runs,
        setting.axis,
        detector=setting.planner,
        workers=_WORKERS,
    )
    problem = build_problem(
        setting, candidates, table, wishes=Wishes(budget_units=budget), fusion="any"
    )
    began_s = time.perf_counter()
    solution = solve_placement(problem)
    all_stages_s = time.perf_counter() - began_s
    single = build_problem(
        setting, candidates, table, wishes=Wishes(budget_units=budget), fusion="single"
    )
    covers = _covers(single, table)
    best: dict[str, float] = {}

    def ours() -> None:
        best["ours"] = solve_placement(single).certificate.stages[0].objective

    def direct() -> None:
        best["HiGHS"] = _solve_mclp(covers, single)

    ours_s, direct_s = in_turn(ours, direct)
    if not np.isclose(best["ours"], best["HiGHS"], atol=1e-6):
        raise RuntimeError(f"optima differ: {best}")
    return {
        "optimiser: poses": table.n_poses,
        "optimiser: presolve": str(solution.presolve),
        "optimiser: seconds, all stages, any": all_stages_s,
        "optimiser: proven": solution.certificate.is_proven,
        "optimiser: all stages, single / bare HiGHS, APR only": ratio(ours_s, direct_s),
    }


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


# ---------------------------------------------------------------- more cases


def _measure_growth(candidates: tuple[CandidatePose, ...]) -> dict[str, Any]:
    """Seconds per run of everything but the optimiser, as cases are added."""
    scene = load_study_scene()
    mounts = {tuple(c.pose.position_m) for c in candidates}
    some = set(sorted(mounts)[:: max(1, len(mounts) // N_MOUNTS)])
    few = [c for c in candidates if tuple(c.pose.position_m) in some]
    layout = Layout(name="three", units=load_carlancap_layout().units[:3])
    figures: dict[str, Any] = {}
    per_run_s = []
    for cases in ("CBLA", _OWN_CASES, "study", "protocol-4.5.1"):
        began_s = time.perf_counter()
        setting = build_setting(Question(cases=cases), scene)
        laid_s = time.perf_counter()
        build_detection_table(
            scene, few, setting.runs, setting.axis, detector=setting.planner, workers=_WORKERS
        )
        evaluate_layout(layout, setting, workers=_WORKERS)
        n_runs = len(setting.runs)
        per_run_s.append((time.perf_counter() - began_s) / n_runs)
        name = f"growth: {cases}, {n_runs} runs"
        figures[f"{name}: seconds to lay them"] = laid_s - began_s
        figures[f"{name}: time per run / that of CBLA alone"] = per_run_s[-1] / per_run_s[0]
    return figures


# ---------------------------------------------------------------- whole command


def _measure_command(budget: int) -> dict[str, Any]:
    """The main job cold and warm, its memory, and the start-up."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"PLACE_RSUS_CACHE": str(Path(folder) / "cache")}
        job = ["--budget", str(budget), "--quiet", "--out", str(Path(folder) / "out")]
        cold_s = _run_command(job, environment)
        warm_s = _run_command(job, environment)
        evaluate_s = _run_command(["evaluate", "--layout", "carlancap-12", "--quiet"], environment)
        peak_kib = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        help_s = statistics.median(_run_command(["--help"], environment) for _ in range(REPEATS))
    return {
        "command: seconds, cold (under 120)": cold_s,
        "command: seconds, warm": warm_s,
        "command: seconds, evaluate carlancap-12 and VUT (under 60)": evaluate_s,
        "command: peak memory, GiB (under 2)": peak_kib / 2**20,
        "command: seconds, --help (under 0.5)": help_s,
    }


def _run_command(arguments: list[str], environment: dict[str, str]) -> float:
    began_s = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "experiments.cli", *arguments],
        env=environment,
        stdout=subprocess.DEVNULL,
        check=True,
    )
    return time.perf_counter() - began_s


if __name__ == "__main__":
    main()
