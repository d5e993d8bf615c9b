"""All cases, laid and answered: ``python -m experiments.study.cases``.

How many runs of each case the study's junction and maps carry, and what the VUT, the study's
cameras and the best three for the set prevent.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np

from geometry.files import write_atomically
from geometry.scene import Scene
from geometry.scene_files import load_scene
from geometry.study_scene import load_study_scene
from placement.compute import Compute
from placement.evaluation import Evaluation, Verdict, apr, mean_impact_speed_kmh
from placement.evaluator import evaluate_layouts
from placement.explain.agreement import FUSED, Disagreement, find_disagreements
from placement.layout import Layout, load_carlancap_layout
from placement.pipeline import Assembly, Placement, assemble, place
from placement.question import Question
from placement.setting import Drives, Setting, drive

from ..figures.axes import WIDTH_IN, new_figure, to_png
from ..figures.plan import plot_plan
from ..progress import StageProgress
from ..results.numbers import percent
from ..results.tables import markdown_table

SETS = ("default", "junction", "all")
_POSES = """\
At the impact both bodies are where Euro NCAP's files have them. On the protocol's junction,
`tests/scenarios/test_vehicles.py` allows for the middles of both bodies in CCCscp and CMCscp
0.1 mm, for the rear axle of the turning VUT and the front of the target in CCFtap and CMFtap
0.2 mm, for headings 0.001 degrees, and for parked cars 0.001 mm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """The best layout for a set of cases, and what the evaluator says of it and of others."""

    setting: Setting
    placement: Placement
    evaluations: Mapping[str, Evaluation]  # of "best" and "twelve", and other layouts by name
    disagreements: tuple[Disagreement, ...]


def judge(
    assembly: Assembly, placement: Placement, others: Mapping[str, Layout], compute: Compute
) -> Answer:
    """Evaluate what was found, and others, at the study's junction."""
    setting = assembly.setting
    layouts = {"best": placement.layout, "twelve": load_carlancap_layout(), **others}
    found = evaluate_layouts(tuple(layouts.values()), setting, compute=compute)
    table, index = placement.nominal.table, placement.nominal_index
    return Answer(
        setting=setting,
        placement=placement,
        evaluations=dict(zip(layouts, found, strict=True)),
        disagreements=find_disagreements(setting, table, found[0], index, compute=compute),
    )


def count_runs(drives: Drives) -> tuple[Counter[str], Counter[str]]:
    """Runs that are driven, and those that the junction could carry, by family of case."""
    driven = Counter(run.case.family for run in drives.runs)
    possible = Counter(driven)
    for refusal in drives.refused:
        if refusal.is_possible and refusal.limit_kmh is None:
            possible[refusal.case.family] += len(refusal.speeds_kmh)
    return driven, possible


def table_of_cases(question: Question, scenes: Mapping[str, Scene], answer: Answer) -> list[str]:
    """A table in Markdown: a row for each family, and one for all."""
    counts = [count_runs(drive(question, scene)) for scene in scenes.values()]
    families = dict.fromkeys(run.case.family for run in answer.setting.runs)
    families |= dict.fromkeys(sorted({name for _, possible in counts for name in possible}))
    parties = {
        "VUT": answer.evaluations["best"].vut,
        "twelve": answer.evaluations["twelve"].rsu_all,
        "best three": answer.evaluations["best"].rsu_all,
        "best three and VUT": answer.evaluations["best"].vut_and_rsus,
    }
    rows = []
    of_run = np.array([run.case.family for run in answer.setting.runs])
    for family in families:
        cells = [f"{driven[family]} of {possible[family]}" for driven, possible in counts]
        mask = of_run == family
        cells += [
            _told(verdict, answer, mask) if mask.any() else "-" for verdict in parties.values()
        ]
        rows.append([family, *cells])
    cells = [f"{driven.total()} of {possible.total()}" for driven, possible in counts]
    everything = np.ones(len(of_run), dtype=bool)
    cells += [_told(verdict, answer, everything) for verdict in parties.values()]
    return markdown_table(["case", *scenes, *parties], [*rows, ["all", *cells]])


def _told(verdict: Verdict, answer: Answer, mask: np.ndarray) -> str:
    axis = answer.setting.axis
    left_kmh = mean_impact_speed_kmh(verdict, axis, mask)
    return f"{percent(apr(verdict, axis, mask))}, {left_kmh:.1f} km/h"


def _proof(name: str, answer: Answer) -> Iterator[str]:
    stages = answer.placement.certificate.stages
    told = ", ".join(
        f"{stage.name} {'proven' if stage.gap == 0.0 else f'gap {stage.gap:.2g}'}"
        for stage in stages
    )
    yield f"Best three for `{name}`, stage by stage: {told}."
    yield ""
    n_runs = answer.setting.axis.n_runs
    fused = [one for one in answer.disagreements if one.party == FUSED]
    share = percent(len(fused) / n_runs)
    yield f"Table and evaluator disagree on {len(fused)} of {n_runs} runs, units fused: {share}."
    yield ""
    for one in fused:
        said = "the table" if one.on_table else "the evaluator"
        yield f"* {one.run_id}: avoided only by {said}; {one.n_frames} frames, {one.cause}"
    if fused:
        yield ""


def _difference(junction: Answer, default: Answer) -> list[str]:
    what = "site, x, y, z in m, yaw, pitch in degrees"
    rows = []
    for name, answer in {"junction": junction, "default": default}.items():
        units = "; ".join(
            f"{unit.site_id} ({', '.join(f'{value:.1f}' for value in unit.pose.position_m)}), "
            f"{unit.pose.yaw_deg:.0f}, {unit.pose.pitch_deg:.0f}"
            for unit in answer.placement.layout.units
        )
        judged = [one.evaluations[name] for one in (junction, default)]
        shares = [percent(apr(one.rsu_all, one.axis)) for one in judged]
        rows.append([name, units, *shares])
    header = ("best three for", what, "APR of `junction`", "APR of `default`")
    return markdown_table(header, rows)


def save_plans(path: Path, answers: Mapping[str, Answer]) -> None:
    """Plans of the best layouts, side by side."""
    figure = new_figure(2.0 * WIDTH_IN, 1.35 * WIDTH_IN)
    for (name, answer), axes in zip(answers.items(), figure.subplots(1, len(answers)), strict=True):
        plot_plan(answer.setting, answer.placement.layout, axes=axes)
        axes.set_title(f"best three for --cases {name}")
    write_atomically(path, to_png(figure))


def describe(maps: Sequence[str], picture: Path, compute: Compute) -> str:
    """All of it, as Markdown; the picture is written beside."""
    question = Question(budget=3, protect="all")
    scenes = {"study's junction": load_study_scene()}
    scenes |= {Path(name).stem: load_scene(name) for name in maps}
    plans = {name: assemble(replace(question, cases=name), compute=compute) for name in SETS}
    found = {name: place(plan) for name, plan in plans.items()}
    layouts = {name: one.layout for name, one in found.items()}
    answers = {name: judge(plans[name], found[name], layouts, compute) for name in SETS}
    default = answers.pop("default")
    save_plans(picture, {"junction": answers["junction"], "default": default})
    lines = [
        "# All cases",
        "",
        "Runs driven of those possible: without speeds above a limit of the map, and cases whose",
        "roads it does not have. APR, and the mean speed of the VUT at contact over all runs, are",
        "of the study's junction.",
        "",
    ]
    for name, answer in answers.items():
        lines += [f"## `--cases {name} --protect all --budget 3`", ""]
        lines += [*table_of_cases(replace(question, cases=name), scenes, answer), ""]
        lines += _proof(name, answer)
    lines += ["## The best three for `junction` and for the default", ""]
    lines += [*_difference(answers["junction"], default), ""]
    lines += [f"![for junction, and for the default]({picture.name})", ""]
    return "\n".join([*lines, "## Poses at the impact", "", _POSES]) + "\n"


@click.command()
@click.option(
    "--map", "maps", multiple=True, help="A map, or a folder of a scene; may be repeated."
)
@click.option("--workers", type=int, default=2, show_default=True, help="Threads.")
@click.option(
    "--out", type=click.Path(path_type=Path), default="results/cases.md", show_default=True
)
def main(*, maps: tuple[str, ...], workers: int, out: Path) -> None:
    """Lay every case, answer for them, and write tables and a plan."""
    progress = StageProgress()
    progress.start(quiet=False)
    try:
        picture = out.with_name(f"{out.stem}_plan.png")
        text = describe(maps, picture, Compute(workers=workers, progress=progress))
    finally:
        progress.stop()
    write_atomically(out, text)


if __name__ == "__main__":
    main()
