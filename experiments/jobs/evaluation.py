"""Evaluations and comparisons of layouts that are given.

From a question to a result.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path
from typing import Any

from geometry.scene import Scene
from geometry.scene_sources import load_scene
from placement.compute import Compute
from placement.evaluation import Evaluation, headline_apr
from placement.evaluator import evaluate_layouts
from placement.layout import Layout, check_layout
from placement.private_ground import load_private_ground
from placement.question import Question
from placement.sampling.out_of_sample import out_of_sample_layouts
from placement.sampling.uncertainty import load_drawn
from placement.setting import Setting

from ..parts.baselines import build_baselines, compare_layout
from ..parts.bill_of_materials import build_bill
from ..parts.comparison import EXPERT, GREEDY, HIGHEST, build_compared, find_differences
from ..parts.decision import judge_by_decision
from ..parts.result import ComparisonResult, EvaluationResult, build_answer
from ..parts.sampled_worlds import build_sampled_record
from ..parts.units import PrivateGroundRecord, build_private_ground_record
from ..progress import StageProgress
from ..results import folders
from .placement import (
    Answered,
    build_asked_record,
    judge_study_cases,
    write_results,
)
from .search import begin_job


def run_evaluation(
    question: Question,
    *,
    layout: Layout,
    out: Path | None,
    compute: Compute,
    command: str,
    progress: StageProgress,
    asked: Question | None = None,
    existing: Collection[str] = (),
    sign: Path | None = None,
) -> EvaluationResult:
    """Evaluate a layout, report if asked to.

    InputError if it cannot be mounted or written.

    `asked` is the question before its map was imported, `existing` are ids of units
    that are mounted already, `sign` is the key that signs the folder.
    """
    folders.expect_results(out, progress, sign=sign)
    scene = load_scene(question.scene)
    job = begin_job(question, scene, compute=compute, progress=progress)
    (layout,) = _with_distinct_names([layout])
    check_layout(layout, scene)
    (private,) = _private_ground(question, scene, [layout])
    (evaluation,) = evaluate_layouts([layout], job.setting, compute=compute)
    bill = build_bill(
        layout, scene, site_cost_eur=question.site_cost_eur, kept_ids=existing
    )
    evaluations = {layout.name: evaluation}
    result = build_evaluation_result(
        job.setting,
        evaluation,
        existing=tuple(unit.id for unit in layout.units if unit.id in existing),
        private_ground=private,
        sensors_eur=bill.sensors_eur,
        sites_eur=bill.sites_eur,
        assumed_prices=bill.assumed,
        study_cases=None if out is None else judge_study_cases(job, evaluations),
        **judge_by_decision(
            question.decision, job.setting, evaluations, compute=compute
        ),
    )
    answered = Answered(job=job, result=result, evaluations=evaluations, bill=bill)
    told = build_asked_record(asked or question, compute, command)
    written = write_results(answered, out, asked=told, sign=sign)
    assert isinstance(written, EvaluationResult)
    return written


def run_comparison(
    question: Question,
    *,
    layouts: Sequence[Layout],
    out: Path | None,
    compute: Compute,
    command: str,
    progress: StageProgress,
    asked: Question | None = None,
    sign: Path | None = None,
) -> ComparisonResult:
    """Compare two layouts or more on the same runs.

    Write a report if asked to.

    With samples also in so many sampled worlds. `asked`, `sign` and errors are as those
    of :func:`run_evaluation`.
    """
    folders.expect_results(out, progress, sign=sign)
    scene = load_scene(question.scene)
    samples = question.n_samples
    drawn = load_drawn(question, scene, n_samples=samples)
    job = begin_job(question, scene, compute=compute, progress=progress)
    setting = job.setting
    layouts = _with_distinct_names(layouts)
    for layout in layouts:
        check_layout(layout, scene)
    private, *of_others = _private_ground(question, scene, layouts)
    proposed = compare_layout(layouts[0], setting, compute=compute)
    everyone = layouts
    if proposed is not None and proposed.expert is not None:
        everyone = _with_distinct_names([*layouts, proposed.expert])
    judged = evaluate_layouts(everyone, setting, compute=compute)
    names = [layout.name for layout in layouts]
    evaluations = dict(zip([*names, EXPERT], judged, strict=False))
    sampled = None
    if samples:
        sampled = build_sampled_record(
            out_of_sample_layouts(
                setting, everyone, drawn, n_samples=samples, compute=compute
            ),
            drawn,
            tail=1.0,
            seed=compute.seed,
            planned_apr={item.layout.name: headline_apr(item) for item in judged},
        )
    bill = build_bill(layouts[0], scene, site_cost_eur=question.site_cost_eur)
    result = build_comparison_result(
        setting,
        judged[0],
        judged[1 : len(layouts)],
        of_others=of_others,
        private_ground=private,
        sensors_eur=bill.sensors_eur,
        sites_eur=bill.sites_eur,
        assumed_prices=bill.assumed,
        study_cases=judge_study_cases(job, evaluations),
        **judge_by_decision(question.decision, setting, evaluations, compute=compute),
        baselines=proposed
        and build_baselines(proposed, evaluations.get(EXPERT), setting),
        sampled=sampled,
    )
    answered = Answered(job=job, result=result, evaluations=evaluations, bill=bill)
    told = build_asked_record(asked or question, compute, command)
    written = write_results(answered, out, asked=told, sign=sign)
    assert isinstance(written, ComparisonResult)
    return written


def build_evaluation_result(
    setting: Setting, evaluation: Evaluation, **parts: Any
) -> EvaluationResult:
    """One layout by the evaluator, with further `parts` by name.

    "seconds" is empty.
    """
    return EvaluationResult(**build_answer(setting, evaluation, {}), **parts)


def build_comparison_result(
    setting: Setting,
    subject: Evaluation,
    others: Sequence[Evaluation],
    *,
    of_others: Sequence[PrivateGroundRecord | None] = (),
    **parts: Any,
) -> ComparisonResult:
    """A layout against others on the same runs.

    `of_others` is what these see of private ground.
    """
    compared = tuple(
        build_compared(subject, other, setting.rule, private)
        for other, private in zip(
            others, of_others or [None] * len(others), strict=True
        )
    )
    differences = find_differences(
        {item.layout.name: item for item in (subject, *others)}
    )
    return ComparisonResult(
        **build_answer(setting, subject, {item.layout.name: item for item in others}),
        compared=compared,
        differences=differences,
        **parts,
    )


def _private_ground(
    question: Question, scene: Scene, layouts: Sequence[Layout]
) -> list[PrivateGroundRecord | None]:
    """What each layout sees of the private ground of the question.

    None where it names none.
    """
    if not question.no_look:
        return [None] * len(layouts)
    private = load_private_ground(Path(question.no_look), scene)
    return [
        build_private_ground_record(layout.units, scene, private) for layout in layouts
    ]


def _with_distinct_names(layouts: Sequence[Layout]) -> list[Layout]:
    """Layouts under names of their own: one whose name is taken gets a number."""
    taken = {GREEDY, EXPERT, HIGHEST}
    named = []
    for layout in layouts:
        names = chain(
            [layout.name], (f"{layout.name} ({number})" for number in count(2))
        )
        name = next(name for name in names if name not in taken)
        taken.add(name)
        named.append(replace(layout, name=name))
    return named
