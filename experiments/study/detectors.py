"""The study's cases by four detectors: ``python -m experiments.study.detectors``.

One layout and its runs are judged by the box rule, the response model, the network that is
shipped, and the response table fitted to it; and by the detection table, to show how well plans
predict the network's verdicts.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from geometry.arrays import BoolArray
from geometry.files import write_atomically
from geometry.scene_files import load_scene
from geometry.sensors import CameraModel
from placement.compute import Compute
from placement.detectors import load_planning_detector
from placement.evaluation import Evaluation, Verdict, apr, detected_share
from placement.evaluator import build_surroundings, evaluate_layout, load_vut_camera
from placement.evaluator.evaluate import Judge
from placement.evaluator.perceive import perceive_from_roadside, perceive_from_vut
from placement.layout import Layout, load_carlancap_layout
from placement.question import Question
from placement.setting import Setting, build_setting

from ..progress import StageProgress
from ..results.numbers import percent
from ..results.tables import markdown_table

CASES = ("CPNC-50", "CBNA", "CBLA")
DETECTORS = {
    "geometric": "box rule",
    "response": "response model",
    "cnn-table": "table fitted to the network",
    "cnn": "network",
}
_UNITS = ("VUT", "all units")


def compare_detectors(question: Question, layout: Layout, compute: Compute) -> str:
    """Frames detected and APR by case and detector, and how well plans predict the network's.

    The question gives cases and runs; its detector is not used. Returns Markdown.
    """
    scene = load_scene(question.scene)
    settings = {name: build_setting(replace(question, detector=name), scene) for name in DETECTORS}
    found = {
        name: evaluate_layout(layout, setting, compute=compute)
        for name, setting in settings.items()
    }
    setting = settings["cnn"]
    shown = (f"{unit}: {what}" for what in ("frames detected", "APR") for unit in _UNITS)
    lines = [
        f"{layout.name}, {len(setting.runs)} runs, {len(layout.units)} cameras.",
        "",
        *markdown_table(("case", "runs", "detector", *shown), _rows(setting, found)),
        "",
        *_agreement(setting, layout, found["cnn"]),
    ]
    return "\n".join(lines) + "\n"


def _rows(setting: Setting, found: Mapping[str, Evaluation]) -> Iterator[list[str]]:
    axis = setting.axis
    for case in dict.fromkeys(axis.cases):
        mask = np.array(axis.cases) == case
        for name, words in DETECTORS.items():
            verdicts = (found[name].vut, found[name].rsu_all)
            seen = [percent(detected_share(one, axis, mask)) for one in verdicts]
            avoided = [percent(apr(one, axis, mask)) for one in verdicts]
            yield [case, str(mask.sum()), words, *seen, *avoided]


def _agreement(setting: Setting, layout: Layout, by_network: Evaluation) -> list[str]:
    """Shares of runs in which a plan predicts the network's verdict, unit by unit."""
    surroundings = build_surroundings(setting.scene, setting.runs)
    judge = Judge(setting.runs, setting.axis, setting.rule)
    mount = load_vut_camera()
    evidence = {"VUT": perceive_from_vut(surroundings, mount)}
    for unit in layout.units:
        if isinstance(unit.sensor, CameraModel):
            evidence[unit.id] = perceive_from_roadside(surroundings, unit.pose, unit.sensor)
    verdicts: dict[str, Verdict] = {"VUT": by_network.vut, **by_network.units}
    rows = []
    for name in ("geometric", "response", "cnn-table"):
        planner = load_planning_detector(name)
        expected: dict[str, BoolArray] = {
            party: planner.is_expected(one) for party, one in evidence.items()
        }
        latency_s = setting.rule.latency_s
        shares = []
        for party, frames in expected.items():
            plan = judge.verdict([(frames, latency_s)])
            shares.append(float((plan.is_avoided == verdicts[party].is_avoided).mean()))
        units = [(frames, latency_s) for party, frames in expected.items() if party != "VUT"]
        fused = judge.verdict(units)
        shares.append(float((fused.is_avoided == by_network.rsu_all.is_avoided).mean()))
        rows.append([DETECTORS[name], *map(percent, shares)])
    return [
        "Runs in which what a plan counts on gives the verdict of the network:",
        "",
        *markdown_table(("planned with", *evidence, "all units"), rows),
    ]


@click.command()
@click.option("--cases", default=",".join(CASES), show_default=True)
@click.option("--speeds", default="", help="km/h with commas between; default: all of a case.")
@click.option("--workers", type=int, default=2, show_default=True, help="Threads.")
@click.option("--out", type=click.Path(path_type=Path), help="File; default: the terminal.")
def main(*, cases: str, speeds: str, workers: int, out: Path | None) -> None:
    """Judge the study's layout by the box rule, the response model, the network, its table."""
    question = Question(cases=cases, along_arms="0", speeds=speeds)
    progress = StageProgress()
    progress.start(quiet=False)
    try:
        compute = Compute(workers=workers, progress=progress)
        text = compare_detectors(question, load_carlancap_layout(), compute)
    finally:
        progress.stop()
    if out is None:
        click.echo(text)
    else:
        write_atomically(out, text)


if __name__ == "__main__":
    main()
