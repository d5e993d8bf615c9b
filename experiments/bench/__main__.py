"""Speed as ratios to named references, measured in one run: ``python -m experiments.bench``.

Absolute times depend on the machine and its load; the ratios depend on them little, because both
sides are measured in turn. Each part runs in a process of its own, and is ended when its time is
up.
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
from collections.abc import Callable
from functools import cache
from pathlib import Path

import click

from geometry.raycast import caster_name
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose, build_candidates, load_candidate_grid
from placement.layout import load_carlancap_layout
from placement.question import Question
from placement.setting import Setting, build_setting

from . import speed

_OWN_CASES = "CPNC-50,CBNA,CBLA"  # the study's: rays are measured on their 104 runs
_LIMIT_S = 240.0
_INSIDE = "PLACE_RSUS_BENCH_PART"  # set in the processes that measure


@cache
def _setting(cases: str = "") -> Setting:
    question = Question(cases=cases, along_arms="0") if cases else Question()
    return build_setting(question, load_study_scene())


@cache
def _candidates() -> tuple[CandidatePose, ...]:
    grid, study = load_candidate_grid(), load_carlancap_layout()
    return build_candidates(load_study_scene(), grid, extra=study.units)


PARTS: dict[str, Callable[[int], speed.Figures]] = {
    "command": lambda budget: _measure_command(budget),
    "rays": lambda _: speed.measure_casting(_setting(_OWN_CASES), _candidates()),
    "table": lambda _: speed.measure_table(_setting(), _candidates()),
    "evaluator": lambda _: speed.measure_evaluation(_setting()),
    "optimiser": lambda budget: speed.measure_optimiser(
        speed.build_bench_problem(_setting(), _candidates(), budget)
    ),
    "single": lambda budget: speed.measure_single(
        speed.build_bench_problem(_setting(), _candidates(), budget, fusion="single")
    ),
}
"""Functions of the budget of units that measure, by name."""


@click.command()
@click.option("--budget", default=3, show_default=True, help="Units of the main job.")
@click.option(
    "--parts", default=",".join(PARTS), show_default=True, help="To measure, commas between."
)
@click.option(
    "--limit", default=_LIMIT_S, show_default=True, help="Seconds after which a part is ended."
)
@click.option("--out", type=click.Path(path_type=Path), help="JSON file for the figures.")
def main(budget: int, parts: str, limit: float, out: Path | None) -> None:
    """Measure the whole command, rays, evaluator and optimiser.

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
    figures: dict[str, speed.Figures] = {}
    if out is not None and out.exists():
        before = json.loads(out.read_text(encoding="utf-8"))
        figures = {name: before[name] for name in PARTS if isinstance(before.get(name), dict)}
    machine: speed.Figures = {"processors": os.cpu_count(), "rays by": caster_name()}
    for name in names:
        click.echo(f"{name} ...", err=True)
        figures[name] = run_part(name, budget=budget, limit_s=limit)
        for figure, value in figures[name].items():
            shown = f"{value:.3g}" if isinstance(value, float) else value
            click.echo(f"{figure:<72} {shown}")
        if out is not None:  # after each part, in case a later one is interrupted
            ordered = {"machine": machine, **{n: figures[n] for n in PARTS if n in figures}}
            out.write_text(json.dumps(ordered, indent=2) + "\n", encoding="utf-8")


def run_part(name: str, *, budget: int, limit_s: float) -> speed.Figures:
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
        figures: speed.Figures = json.loads(path.read_text(encoding="utf-8"))
    return figures | {f"{name}: seconds to measure": time.perf_counter() - began_s}


def _measure_command(budget: int) -> speed.Figures:
    """The main job cold and warm, its memory, and the start-up."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"PLACE_RSUS_CACHE": str(Path(folder) / "cache")}

        def seconds(*arguments: str) -> float:
            began_s = time.perf_counter()
            subprocess.run(
                [sys.executable, "-m", "experiments.main", *arguments],
                env=environment,
                stdout=subprocess.DEVNULL,
                check=True,
            )
            return time.perf_counter() - began_s

        job = ["--budget", str(budget), "--quiet", "--out", str(Path(folder) / "out")]
        cold_s, warm_s = seconds(*job), seconds(*job)
        evaluate_s = seconds("evaluate", "--layout", "carlancap-12", "--quiet")
        peak_kib = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        help_s = statistics.median(seconds("--help") for _ in range(speed.REPEATS))
    return {
        "command: seconds, cold (under 120)": cold_s,
        "command: seconds, warm": warm_s,
        "command: seconds, evaluate carlancap-12 and VUT (under 60)": evaluate_s,
        "command: peak memory, GiB (under 2)": peak_kib / 2**20,
        "command: seconds, --help (under 0.5)": help_s,
    }


if __name__ == "__main__":
    main()
