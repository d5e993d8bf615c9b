"""Growth of the detection table's cost: ``python -m experiments.bench.growth --out FOLDER``.

Processor time of whole tables, with more mounts, runs, weathers or sampled worlds.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import click

from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.pipeline import assemble
from placement.question import Question
from placement.sampling.tables import obtain_table, sampled_table
from placement.sampling.uncertainty import load_uncertainty
from placement.setting import Setting, build_setting
from scenarios.runs import WEATHERS, build_frame_axis
from scenarios.weights import weight_per_run

Growth = dict[str, dict[str, float]]
"""Processor time in seconds by quantity and amount."""

_MOUNTS = (4, 8, 16)
_PARTS = (4, 2, 1)  # every so manieth run
_WEATHERS = (1, 2, 4)
_WORLDS = (1, 2, 4)
_MARKERS = "osv^"  # lines can be distinguished without colour, too


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder for figure and numbers."
)
def main(out: Path) -> None:
    """Measure the default question at the study's junction; write growth.json and growth.png."""
    growth = measure_growth(Question())
    out.mkdir(parents=True, exist_ok=True)
    (out / "growth.json").write_text(json.dumps(growth, indent=2) + "\n", encoding="utf-8")
    plot_growth(growth, out / "growth.png")
    for name, seconds in growth.items():
        times, cost = proportions(seconds)[-1]
        click.echo(f"{name:<10} {times:.3g} times as many cost {cost:.3g} times as much")


def measure_growth(question: Question, *, n_mounts: Sequence[int] = _MOUNTS) -> Growth:
    """Processor time of the table of a question, and of more or less of it."""
    setting = build_setting(question)
    planned = assemble(question, setting=setting).candidates
    mounts: dict[tuple[float, ...], list[CandidatePose]] = {}
    for candidate in planned:
        mounts.setdefault(tuple(candidate.pose.position_m.tolist()), []).append(candidate)

    def poses(n: int) -> list[CandidatePose]:
        step = max(1, len(mounts) // n)
        return [pose for group in list(mounts.values())[::step][:n] for pose in group]

    few = poses(n_mounts[0])
    compute = Compute(workers=1)
    uncertain, uncertainty = (
        build_setting(replace(question, detector="response")),
        load_uncertainty(),
    )

    def table(of: Setting, candidates: Sequence[CandidatePose] = few) -> float:
        return _timed(lambda: obtain_table(of, candidates, compute=compute))

    def worlds(n: int) -> float:
        return _timed(
            lambda: sampled_table(uncertain, few, uncertainty, n_samples=n, compute=compute)
        )

    table(setting)  # these compile, and fill caches from one table to the next
    worlds(1)
    parts = [setting.runs[::part] for part in _PARTS]
    return {
        "mounts": {str(n): table(setting, poses(n)) for n in n_mounts},
        "runs": {
            str(len(runs)): table(
                replace(setting, runs=runs, axis=build_frame_axis(runs, weight_per_run(runs)))
            )
            for runs in parts
        },
        "weathers": {
            str(n): table(build_setting(replace(question, weather=",".join(WEATHERS[:n]))))
            for n in _WEATHERS
        },
        "worlds": {str(n): worlds(n) for n in _WORLDS},
    }


def proportions(seconds: dict[str, float]) -> list[tuple[float, float]]:
    """Each amount over the least one, and its cost over that of the least."""
    amounts = [(float(amount), cost) for amount, cost in seconds.items()]
    least, cheapest = min(amounts)
    return [(amount / least, cost / cheapest) for amount, cost in sorted(amounts)]


def plot_growth(growth: Growth, path: Path) -> None:
    """Draw cost over amount, both relative to the least, with a line in proportion."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 4.0), layout="constrained")
    axes = figure.subplots()
    most = 1.0
    for (name, seconds), marker in zip(growth.items(), _MARKERS, strict=True):
        points = proportions(seconds)
        most = max(most, points[-1][0])
        axes.plot(*zip(*points, strict=True), marker=marker, label=name)
    axes.plot([1.0, most], [1.0, most], color="0.6", linestyle="--", label="in proportion")
    axes.set_xlabel("times as many")
    axes.set_ylabel("times the processor time of the table")
    axes.legend()
    figure.savefig(path, dpi=150)


def _timed(work: Callable[[], object]) -> float:
    began_s = time.process_time()
    work()
    return time.process_time() - began_s


if __name__ == "__main__":
    main()
