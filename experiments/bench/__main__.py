"""Speed of the main job and of its parts, measured in one run: ``python -m experiments.bench``.

Each part runs in a process of its own, and is ended when its time is up.
"""

import json
import os
import resource
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np

from geometry.raycast import caster_name
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose, build_candidates, load_candidate_grid
from placement.compute import Compute
from placement.evaluator import evaluate_layout
from placement.layout import Layout, load_carlancap_layout
from placement.optimiser import Effort, PlacementProblem, presolve, solve_placement
from placement.question import Question
from placement.setting import Setting, build_setting
from placement.visibility.build import build_detection_table
from placement.wishes import Wishes, build_problem

Figures = dict[str, float | str | None]
"""Measured figures by their names."""

_REPEATS = 5
_WORKERS = os.cpu_count() or 1
_INSIDE = "PLACE_RSUS_BENCH_PART"  # set in the processes that measure
_EVERY_MOUNT = 4  # of which the table's verdicts are counted
_N_OTHERS = 6  # cameras, with the study's twelve
_TRACK_MEMORIES_S = (np.inf, 1.0)
_BUDGET_TIME_S = 20.0


def seconds_of(work: Callable[[], object]) -> float:
    """Median of the seconds of some repeats, after a first one that does not count."""
    seconds = []
    for _ in range(_REPEATS + 1):
        began_s = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began_s)
    return statistics.median(seconds[1:])


@cache
def _setting() -> Setting:
    return build_setting(Question(), load_study_scene())


@cache
def _candidates() -> tuple[CandidatePose, ...]:
    grid, study = load_candidate_grid(), load_carlancap_layout()
    return build_candidates(load_study_scene(), grid, extra=study.units)


def measure_table() -> Figures:
    """Verdicts of the table per second, over the whole build for some mounts."""
    setting, candidates = _setting(), _candidates()
    positions = list(dict.fromkeys(tuple(c.pose.position_m) for c in candidates))[::_EVERY_MOUNT]
    some = [c for c in candidates if tuple(c.pose.position_m) in set(positions)]
    seconds = seconds_of(lambda: _table(setting, some, Compute()))
    per_second = len(some) * setting.axis.n_frames / seconds
    return {"table: million verdicts per second (before 3.4; at least 30)": per_second / 1e6}


def _table(setting: Setting, candidates: Sequence[CandidatePose], compute: Compute) -> Any:
    world = (setting.scene, candidates, setting.runs, setting.axis)
    return build_detection_table(*world, detector=setting.table_detector, compute=compute)


def measure_evaluation() -> Figures:
    """The default runs from as many poses as found, greedy and the study's layout have, and VUT."""
    setting = _setting()
    others = build_candidates(setting.scene, load_candidate_grid(), extra=())
    units = (*load_carlancap_layout().units, *others[:: -(-len(others) // _N_OTHERS)])
    layout, compute = Layout(name="bench", units=units), Compute(workers=_WORKERS)
    seconds = seconds_of(lambda: evaluate_layout(layout, setting, compute=compute))
    name = f"evaluator: {len(setting.runs)} runs, {len(units)} cameras and VUT"
    return {f"{name}: seconds (at most 5)": seconds}


def _problem(budget: int) -> PlacementProblem:
    """The question of so many units, on a table that is built for it."""
    setting, candidates = _setting(), _candidates()
    table = _table(setting, candidates, Compute(workers=_WORKERS))
    wishes = Wishes(budget_units=budget)
    return build_problem(setting, candidates, table, wishes=wishes)


def measure_optimiser(budget: int) -> Figures:
    """Presolve, and all stages for growing budgets."""
    problem = _problem(budget)
    axis = problem.table.axis
    began_s = time.perf_counter()
    presolve(problem)
    size = f"{problem.table.n_poses} x {axis.n_runs} x {axis.n_frames}"
    return {
        "optimiser: poses x runs x frames": size,
        "optimiser: seconds, presolve": time.perf_counter() - began_s,
        **measure_budgets(problem),
    }


def measure_budgets(problem: PlacementProblem, *, units: Sequence[int] = (2, 3, 4, 5)) -> Figures:
    """Presolve and all stages for growing budgets, with tracks that live on and that end."""
    figures: Figures = {}
    for memory_s in _TRACK_MEMORIES_S:
        rule = replace(problem.rule, track_memory_s=memory_s)
        for budget in units:
            limits = replace(problem.limits, budget_units=budget)
            asked = replace(problem, rule=rule, limits=limits)
            began_s = time.perf_counter()
            solution = solve_placement(asked, effort=Effort(time_limit_s=_BUDGET_TIME_S))
            name = f"optimiser: track memory {memory_s:g} s, K = {budget}"
            figures[f"{name}: seconds, presolve and all stages"] = time.perf_counter() - began_s
            figures[f"{name}: proven"] = solution.certificate.is_proven
    return figures


def measure_command(budget: int) -> Figures:
    """The main job cold and warm, its memory, and the start-up."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"PLACE_RSUS_CACHE": str(Path(folder) / "cache")}

        def seconds(*arguments: str) -> float:
            began_s = time.perf_counter()
            words = [sys.executable, "-m", "experiments.main", *arguments]
            subprocess.run(words, env=environment, stdout=subprocess.DEVNULL, check=True)
            return time.perf_counter() - began_s

        job = ["--budget", str(budget), "--quiet", "--out", str(Path(folder) / "out")]
        cold_s, warm_s = seconds(*job), seconds(*job)
        evaluate_s = seconds("evaluate", "--layout", "carlancap-12", "--quiet")
        peak_kib = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        help_s = statistics.median(seconds("--help") for _ in range(_REPEATS))
    return {
        "command: seconds, cold (under 120)": cold_s,
        "command: seconds, warm": warm_s,
        "command: seconds, evaluate carlancap-12 and VUT (under 60)": evaluate_s,
        "command: peak memory, GiB (under 2)": peak_kib / 2**20,
        "command: seconds, --help (under 0.5)": help_s,
    }


PARTS: dict[str, Callable[[int], Figures]] = {
    "command": measure_command,
    "table": lambda _: measure_table(),
    "evaluator": lambda _: measure_evaluation(),
    "optimiser": measure_optimiser,
}
"""Functions of the budget of units that measure, by name."""


def run_part(name: str, *, budget: int, limit_s: float) -> Figures:
    """Figures of a part, measured in a process of its own, which ends when its time is up."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figures.json"
        words = ["--parts", name, "--budget", str(budget), "--out", str(path)]
        began_s = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "experiments.bench", *words],
            env=os.environ | {_INSIDE: name},
            start_new_session=True,
        )
        try:
            code = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            return {f"{name}: ended after so many seconds, not finished": limit_s}
        finally:
            if process.poll() is None:  # with all that it has started
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        if code:
            raise click.ClickException(f"{name}: ended with exit code {code}")
        figures: Figures = json.loads(path.read_text(encoding="utf-8"))
    return figures | {f"{name}: seconds to measure": time.perf_counter() - began_s}


@click.command()
@click.option("--budget", default=3, show_default=True, help="Units of the main job.")
@click.option(
    "--parts", default=",".join(PARTS), show_default=True, help="To measure, commas between."
)
@click.option(
    "--limit", default=240.0, show_default=True, help="Seconds after which a part is ended."
)
@click.option("--out", type=click.Path(path_type=Path), help="JSON file for the figures.")
def main(budget: int, parts: str, limit: float, out: Path | None) -> None:
    """Measure the whole command, table, evaluator and optimiser.

    Figures of parts that are not measured this time stay in the file as they are.
    """
    names = [name.strip() for name in parts.split(",") if name.strip()]
    for name in names:
        if name not in PARTS:
            raise click.BadParameter(f"{name}: expected some of {', '.join(PARTS)}")
    if os.environ.get(_INSIDE):
        (name,) = names
        assert out is not None
        out.write_text(json.dumps(PARTS[name](budget)), encoding="utf-8")
        return
    figures: dict[str, Figures] = {}
    if out is not None and out.exists():
        before = json.loads(out.read_text(encoding="utf-8"))
        figures = {name: before[name] for name in PARTS if isinstance(before.get(name), dict)}
    machine: Figures = {"processors": os.cpu_count(), "rays by": caster_name()}
    for name in names:
        click.echo(f"{name} ...", err=True)
        figures[name] = run_part(name, budget=budget, limit_s=limit)
        for figure, value in figures[name].items():
            shown = f"{value:.3g}" if isinstance(value, float) else value
            click.echo(f"{figure:<72} {shown}")
        if out is not None:  # after each part, in case a later one is interrupted
            ordered = {"machine": machine, **{n: figures[n] for n in PARTS if n in figures}}
            out.write_text(json.dumps(ordered, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
