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

import click

from geometry.raycast import caster_name
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose, build_candidates, load_candidate_grid
from placement.compute import Compute
from placement.evaluator import evaluate_layout
from placement.layout import Layout
from placement.question import Question
from placement.setting import build_setting
from placement.visibility.build import build_detection_table

from ..study.layout import load_carlancap_layout
from .optimiser import measure_covering, measure_large, measure_optimiser
from .perception import measure_perception
from .rays import N_MOUNTS, REPEATS, Figures, measure_casting, measure_table

_WORKERS = os.cpu_count() or 1
_OWN_CASES = "CPNC-50,CBNA,CBLA"  # the study's: rays are measured on their 104 runs


@click.command()
@click.option("--budget", default=3, show_default=True, help="Units of the main job.")
@click.option("--out", type=click.Path(path_type=Path), help="JSON file for the figures.")
def main(budget: int, out: Path | None) -> None:
    """Measure rays, optimiser, growth with the runs, perception, and the whole command."""
    scene = load_study_scene()
    setting = build_setting(Question(cases=_OWN_CASES, along_arms="0"), scene)
    candidates = build_candidates(
        setting.scene, load_candidate_grid(), extra=load_carlancap_layout().units
    )
    asked = build_setting(Question(), scene)
    figures = {
        "processors": os.cpu_count(),
        "rays by": caster_name(),
        **_measure_command(budget),  # before anything large: children count the parent's memory
        **measure_casting(setting, candidates),
        **measure_table(asked, candidates),
        **measure_optimiser(asked, candidates, budget),
        **measure_covering(),
        **_measure_growth(candidates),
        **measure_perception(setting),
        **measure_large(),
    }
    for name, value in figures.items():
        shown = f"{value:.3g}" if isinstance(value, float) else value
        click.echo(f"{name:<64} {shown}")
    if out is not None:
        out.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


# ---------- more cases


def _measure_growth(candidates: tuple[CandidatePose, ...]) -> Figures:
    """Seconds per run of everything but the optimiser, as cases are added."""
    scene = load_study_scene()
    mounts = {tuple(c.pose.position_m) for c in candidates}
    some = set(sorted(mounts)[:: max(1, len(mounts) // N_MOUNTS)])
    few = [c for c in candidates if tuple(c.pose.position_m) in some]
    layout = Layout(name="three", units=load_carlancap_layout().units[:3])
    figures: Figures = {}
    per_run_s = []
    compute = Compute(workers=_WORKERS)
    for cases in ("CBLA", _OWN_CASES, "study", "protocol-4.5.1"):
        began_s = time.perf_counter()
        setting = build_setting(Question(cases=cases, along_arms="0"), scene)
        laid_s = time.perf_counter()
        build_detection_table(
            scene, few, setting.runs, setting.axis, detector=setting.planner, compute=compute
        )
        evaluate_layout(layout, setting, compute=compute)
        n_runs = len(setting.runs)
        per_run_s.append((time.perf_counter() - began_s) / n_runs)
        name = f"growth: {cases}, {n_runs} runs"
        figures[f"{name}: seconds to lay them"] = laid_s - began_s
        figures[f"{name}: time per run / that of CBLA alone"] = per_run_s[-1] / per_run_s[0]
    return figures


# ---------- whole command


def _measure_command(budget: int) -> Figures:
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
        [sys.executable, "-m", "experiments.cli.main", *arguments],
        env=environment,
        stdout=subprocess.DEVNULL,
        check=True,
    )
    return time.perf_counter() - began_s


if __name__ == "__main__":
    main()
