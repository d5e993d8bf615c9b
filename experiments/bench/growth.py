"""How the detection table's cost grows: ``python -m experiments.bench.growth --out FOLDER``.

Processor time of whole tables, as more mounts, runs, weathers or sampled worlds are asked for. By
processor time, for other work on the machine then matters little.
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
from scenarios.exposure import weight_per_run
from scenarios.runs import WEATHERS, build_frame_axis

Growth = dict[str, dict[str, float]]
"""By what grows: the processor time in seconds of each amount of it."""

_MOUNTS = (4, 8, 16)
_PARTS = (4, 2, 1)  # every so manieth run
_WEATHERS = (1, 2, 4)
_WORLDS = (1, 2, 4)
_MARKERS = "osv^"  # so that lines are told apart without colour, too


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
    parts = {len(setting.runs[::part]): setting.runs[::part] for part in _PARTS}
    drawn = replace(question, detector="response")
    uncertain, uncertainty = build_setting(drawn), load_uncertainty()
    # These compile, and fill what is kept from one table to the next.
    _seconds(setting, few, compute)
    sampled_table(uncertain, few, uncertainty, n_samples=1, compute=compute)
    return {
        "mounts": {str(n): _seconds(setting, poses(n), compute) for n in n_mounts},
        "runs": {
            str(n): _seconds(
                replace(setting, runs=runs, axis=build_frame_axis(runs, weight_per_run(runs))),
                few,
                compute,
            )
            for n, runs in parts.items()
        },
        "weathers": {
            str(n): _seconds(
                build_setting(replace(question, weather=",".join(WEATHERS[:n]))), few, compute
            )
            for n in _WEATHERS
        },
        "worlds": {
            str(n): _timed(
                lambda n=n: sampled_table(  # type: ignore[misc]
                    uncertain, few, uncertainty, n_samples=n, compute=compute
                )
            )
            for n in _WORLDS
        },
    }


def proportions(seconds: dict[str, float]) -> list[tuple[float, float]]:
    """How many times the least amount each amount is, and how many times its cost it costs."""
    amounts = [(float(amount), cost) for amount, cost in seconds.items()]
    least, cheapest = min(amounts)
    return [(amount / least, cost / cheapest) for amount, cost in sorted(amounts)]


def plot_growth(growth: Growth, path: Path) -> None:
    """Draw cost over amount, both relative to the least, beside a line in proportion."""
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


def _seconds(setting: Setting, candidates: Sequence[CandidatePose], compute: Compute) -> float:
    """Processor time of a table."""
    return _timed(lambda: obtain_table(setting, candidates, compute=compute))


def _timed(work: Callable[[], object]) -> float:
    began_s = time.process_time()
    work()
    return time.process_time() - began_s


if __name__ == "__main__":
    main()
