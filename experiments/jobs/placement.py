"""Placements, evaluations and comparisons: from a question to a folder of results."""

import logging
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import chain, count
from pathlib import Path

from msgspec import UNSET, UnsetType
from msgspec.structs import replace as replace_fields

from geometry.catalogue import load_cameras
from geometry.errors import InputError
from geometry.scene import Scene
from geometry.scene_files import load_scene
from placement.cache import cached_value
from placement.compute import Compute, silent
from placement.evaluation import Evaluation, apr
from placement.evaluator import evaluate_layouts
from placement.explain import find_pool
from placement.explain.other_sensors import STAGE as OTHER_SENSORS
from placement.explain.other_sensors import find_other_sensors
from placement.explain.sensitivity import STAGE as WHAT_IF
from placement.explain.sensitivity import find_sensitivity, prepare_sensitivity
from placement.ground import load_private_ground
from placement.layout import Layout, check_layout, find_baseline
from placement.optimiser.front import Front, front_below
from placement.pipeline import Assembly, Placement, assemble, place
from placement.prices import assumed_prices
from placement.question import Question
from placement.refinement.refine import refine
from placement.sampling.out_of_sample import STAGE as OUT_OF_SAMPLE
from placement.sampling.out_of_sample import (
    FreshWorlds,
    judge_layouts,
    look_at_fresh_worlds,
    out_of_sample_layouts,
)
from placement.sampling.uncertainty import Uncertainty, load_drawn
from placement.setting import Setting, build_setting

from ..parts.coverage import coverage_section
from ..parts.front import describe_front
from ..parts.sampled_worlds import plot_sampled_apr
from ..progress import StageProgress
from ..report.beside import Beside, Part, drawing_beside
from ..report.bill_of_materials import build_bill
from ..report.comparison import EXPERT, GREEDY
from ..report.units import build_plans
from ..results.baselines import (
    StudyCasesRecord,
    build_exchange_records,
    build_next_unit_record,
)
from ..results.explanations import (
    PrivateGroundRecord,
    build_explained_record,
    build_private_ground_record,
)
from ..results.folders import check_result_folder, left_as_it_was
from ..results.fronts import build_refinement_record
from ..results.result import (
    Result,
    build_comparison_result,
    build_layout_result,
    build_placement_result,
)
from ..results.sampled_worlds import build_sampled_record
from .alternatives import (
    begin_standing,
    build_recommendation,
    leading_layouts,
    other_priorities,
)
from .baselines import build_baselines_record, compare_layout, compare_placement
from .study_cases import on_study_cases
from .writing import write_results

_log = logging.getLogger(__name__)

MIN_FRESH_WORLDS = 60
"""Sampled worlds that a layout is judged in, at least: with fewer, intervals say little."""


def run_placement(
    question: Question,
    *,
    out: Path,
    compute: Compute,
    command: str,
    progress: StageProgress,
    beside: Beside | None = None,
) -> Result:
    """Find, prove, evaluate and compare a layout, and write everything to `out`.

    `beside` may have a second process, which was begun while this one was loading.

    Raises
    ------
    InputError
        A wish cannot be met, or `out` cannot be written.
    """
    check_result_folder(out)
    scene = load_scene(question.scene)
    progress.kept = left_as_it_was(out)
    plan = assemble(question, scene=scene, compute=compute)
    setting, uncertainty = plan.setting, plan.uncertainty
    assert uncertainty is not None
    with (
        nullcontext(beside)
        if beside is not None and beside.has_process
        else drawing_beside(_is_large(setting, compute))
    ) as beside:
        study = find_baseline(scene)

        def report(stage: str, done: int, total: int) -> None:
            cache = compute.cache_folder
            if stage == "optimise" and cache is not None:
                if any(cache.glob("table-*")):
                    progress.kept += "; the detection table is kept for the next call"
                # While this stage leaves a core idle.
                beside.begin("other brakes", prepare_sensitivity, setting, compute=compute)
            progress(stage, done, total)

        placement = place(replace(plan, compute=replace(compute, progress=report)))
        refinement, on_grid = None, placement
        if question.refine:
            refinement = refine(
                setting,
                placement,
                plan.candidates,
                solver=plan.effort,
                compute=replace(compute, progress=report),
            )
            placement = refinement.placement
        what_if = beside.begin(
            WHAT_IF,
            find_sensitivity,
            setting,
            placement.layout,
            fusion=question.fusion,
            compute=compute,
        )
        standing = begin_standing(beside, setting, placement.layout, question, compute)
        asked = {unit.sensor.name: unit.sensor for unit in plan.candidates}
        other_sensors = beside.begin(
            OTHER_SENSORS,
            find_other_sensors,
            setting,
            placement.layout.units,
            models=[*{**load_cameras(), **asked}.values()],
            kept=plan.wishes.existing,
            fusion=question.fusion,
            may_look=plan.may_look,
            compute=compute,
        )
        poses = plan.candidates if refinement is None else refinement.candidates
        compared = compare_placement(placement, poses, setting, seed=compute.seed)
        named = {
            placement.layout.name: placement.layout,
            GREEDY: placement.greedy,
            EXPERT: compared.expert,
            **({} if study is None else {study.name: study}),
        }
        layouts = {name: layout for name, layout in named.items() if layout is not None}
        fresh = _begin_fresh_worlds(
            beside, question, setting, [*layouts.values()], uncertainty, compute
        )
        progress("explain", 0, 0)
        pool = None
        if question.pool:
            pool = find_pool(placement.problem, placement.pose_index, n_sets=question.pool)
        explained = build_explained_record(placement, setting, poses, pool=pool, compute=compute)
        subject = placement.layout
        others = [] if study is None else [study]
        beside.begin("plans", build_plans, setting, {subject.name: subject}, others)
        beside.begin("coverage", coverage_section, scene, subject)
        front = _front_below(placement, plan, compute, progress)
        priorities = other_priorities(on_grid, question, plan, compute=compute, progress=progress)
        leading = leading_layouts(on_grid, placement, poses, pool)
        pooled = [layout for layout in leading if layout is not placement.greedy]
        judged_all = evaluate_layouts([*layouts.values(), *pooled], setting, compute=compute)
        verdicts = judged_all[: len(layouts)]
        evaluations = dict(zip(layouts, verdicts, strict=True))
        found, greedy = evaluations[placement.layout.name], evaluations[GREEDY]
        baseline = None if study is None else evaluations[study.name]
        next_unit = build_next_unit_record(placement, poses)
        study_cases = _on_study_cases(question, scene, setting, evaluations, compute)
        by_name = {item.layout.name: item for item in judged_all}
        recommendation = build_recommendation(
            [found, *(by_name[layout.name] for layout in leading)],
            standing,
            setting,
            question,
            compute=compute,
            progress=progress,
        )
        exchanged = other_sensors.result(partial(progress, OTHER_SENSORS, 0, 0))
        sensitivity = what_if.result(partial(progress, WHAT_IF, 0, 0))
        bill = build_bill(
            placement.layout,
            scene,
            site_cost_eur=question.site_cost_eur,
            kept_ids=plan.wishes.existing,
        )
        result = build_placement_result(
            placement, setting, found=found, greedy=greedy, baseline=baseline, compute=compute
        )
        result = replace_fields(
            result,
            **priorities,
            **recommendation.fields,
            explained=explained,
            sites_eur=UNSET if bill.sites_eur is None else bill.sites_eur,
            assumed_prices=(
                bill.assumed
                if plan.wishes.prices is None
                else assumed_prices(plan.wishes.prices, scene.sites)
            ),
            baselines=build_baselines_record(compared, evaluations.get(EXPERT), setting),
            next_unit=UNSET if next_unit is None else next_unit,
            other_sensors=(
                UNSET if exchanged is None else build_exchange_records(placement.layout, exchanged)
            ),
            study_cases=study_cases,
            front=(
                UNSET
                if front is None
                else describe_front(
                    front, placement.problem, poses, n_kept=len(plan.wishes.existing)
                )
            ),
            sensitivity=sensitivity,
            private_ground=(
                UNSET
                if plan.private_ground is None
                else build_private_ground_record(placement.layout.units, scene, plan.private_ground)
            ),
            refinement=UNSET if refinement is None else build_refinement_record(refinement),
        )
        sampled_figure = None
        if fresh:
            judged = judge_layouts(
                setting, [*layouts.values()], uncertainty, _look_at_fresh_worlds(fresh, progress)
            )
            sampled = build_sampled_record(
                judged,
                uncertainty,
                tail=plan.wishes.tail,
                seed=compute.seed,
                planned_apr={item.layout.name: apr(item.rsu_all, item.axis) for item in verdicts},
                chosen_apr={placement.layout.name: placement.certificate.stages[0].objective},
                chosen_in=question.samples,
            )
            result = replace_fields(result, sampled=sampled)
            sampled_figure = plot_sampled_apr(judged)
        return write_results(
            out,
            result,
            setting,
            evaluations,
            command=command,
            progress=progress,
            placement=placement,
            candidates=poses,
            recommended=recommendation.layout,
            bill=bill,
            sampled_figure=sampled_figure,
            beside=beside,
        )


_WORLDS_TOGETHER = 10


def _begin_fresh_worlds(
    beside: Beside,
    question: Question,
    setting: Setting,
    layouts: Sequence[Layout],
    uncertainty: Uncertainty,
    compute: Compute,
) -> list[Part[FreshWorlds]]:
    """Layouts in fresh sampled worlds, some of these at a time; nothing if none are asked for."""
    n_worlds = max(question.samples, MIN_FRESH_WORLDS) if question.samples else 0
    return [
        beside.begin(
            f"fresh worlds from {first}",
            look_at_fresh_worlds,
            setting,
            layouts,
            uncertainty,
            n_worlds=min(_WORLDS_TOGETHER, n_worlds - first),
            first=first,
            fusion=question.fusion,
            compute=replace(compute, progress=silent),
        )
        for first in range(0, n_worlds, _WORLDS_TOGETHER)
    ]


def _look_at_fresh_worlds(
    parts: Sequence[Part[FreshWorlds]], progress: StageProgress
) -> list[FreshWorlds]:
    """What came of them: the second process begins with the first, this one with the last."""
    found: list[FreshWorlds] = []
    for done, part in enumerate(reversed(parts)):
        progress(OUT_OF_SAMPLE, done, len(parts))
        found.insert(0, part.result())
    return found


_LARGE_RUNS = 100


def _is_large(setting: Setting, compute: Compute) -> bool:
    """Whether it takes longer to answer and draw than to start a process that helps to draw."""
    return compute.workers > 1 and len(setting.runs) >= _LARGE_RUNS


def _front_below(
    placement: Placement, plan: Assembly, compute: Compute, progress: StageProgress
) -> Front | None:
    """The best layout of each smaller size, too; None where the best was not what was asked."""
    problem, chosen = placement.problem, placement.pose_index
    if problem.goal != "best" or problem.survive:
        return None
    n_kept = len(plan.wishes.existing)
    if len(chosen) > max(n_kept, 1):
        progress("fewer units", 0, 0)
    return cached_value(
        compute.cache_folder,
        "front",
        lambda: front_below(
            problem,
            chosen,
            placement.certificate,
            min_units=n_kept,
            effort=plan.effort,
            on_point=lambda point: progress(f"fewer units: {point.units}", 0, 0),
            reduced=None if placement.presolved is None else placement.presolved(),
        ),
        kind=Front,
        made_from=(problem, chosen, placement.certificate, n_kept, plan.effort),
        is_worth_it=lambda front: front.is_proven,
    )


def _on_study_cases(
    question: Question,
    scene: Scene,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    compute: Compute,
) -> StudyCasesRecord | UnsetType:
    """The layouts on the study's cases; UNSET where these are asked about, or no arm has them."""
    try:
        record = on_study_cases(
            question,
            setting,
            evaluations,
            build=lambda other: build_setting(other, scene, compute=compute),
            compute=compute,
        )
    except InputError as error:  # the words of the question are known to be right
        _log.info("the study's cases: %s", error)
        return UNSET
    return record or UNSET


def run_evaluation(
    question: Question,
    *,
    layout: Layout,
    no_look: str = "",
    out: Path | None,
    compute: Compute,
    command: str,
    progress: StageProgress,
) -> Result:
    """Evaluate a layout, and write a report if asked to.

    Raises
    ------
    InputError
        A unit hangs underground or inside something, or `out` cannot be written.
    """
    return run_comparison(
        question,
        layouts=[layout],
        no_look=no_look,
        out=out,
        compute=compute,
        command=command,
        progress=progress,
    )


def run_comparison(
    question: Question,
    *,
    layouts: Sequence[Layout],
    samples: int = 0,
    uncertainty: str = "default",
    no_look: str = "",
    out: Path | None,
    compute: Compute,
    command: str,
    progress: StageProgress,
) -> Result:
    """Compare layouts on the same runs, or evaluate a single one; write a report if asked to.

    With samples, they are compared in so many sampled worlds, too: the same ones for all, so that
    differences have an interval.

    Raises
    ------
    InputError
        A unit hangs underground or inside something, or `out` cannot be written.
    """
    scene = load_scene(question.scene)
    drawn = load_drawn(replace(question, uncertainty=uncertainty), scene, n_samples=samples)
    if out is not None:
        check_result_folder(out)
        progress.kept = left_as_it_was(out)
    progress("setting", 0, 0)
    setting = build_setting(question, scene, compute=compute)
    layouts = _with_distinct_names(layouts)
    for layout in layouts:
        check_layout(layout, setting.scene)
    with drawing_beside(out is not None and _is_large(setting, compute)) as beside:
        what_if = beside.begin(WHAT_IF, find_sensitivity, setting, layouts[0], compute=compute)
        private = load_private_ground(Path(no_look), setting.scene) if no_look else None
        is_comparison = len(layouts) > 1
        compared = compare_layout(layouts[0], setting, compute=compute) if is_comparison else None
        if compared is not None and compared.expert is not None:
            everyone = _with_distinct_names([*layouts, compared.expert])
        else:
            everyone = layouts
        judged_all = evaluate_layouts(everyone, setting, compute=compute)
        verdicts, of_expert = judged_all[: len(layouts)], judged_all[len(layouts) :]
        seen: list[PrivateGroundRecord | UnsetType] = [
            UNSET
            if private is None
            else build_private_ground_record(layout.units, setting.scene, private)
            for layout in layouts
        ]
        bill = build_bill(layouts[0], scene, site_cost_eur=question.site_cost_eur)
        if len(verdicts) == 1:
            result = build_layout_result(setting, verdicts[0])
        else:
            result = build_comparison_result(
                setting, verdicts[0], verdicts[1:], private_ground=seen[1:]
            )
        evaluations = {verdict.layout.name: verdict for verdict in verdicts}
        evaluations |= dict(zip((EXPERT,), of_expert, strict=False))
        result = replace_fields(
            result,
            sites_eur=UNSET if bill.sites_eur is None else bill.sites_eur,
            assumed_prices=bill.assumed,
            private_ground=seen[0],
            baselines=UNSET
            if compared is None
            else build_baselines_record(compared, evaluations.get(EXPERT), setting),
            study_cases=_on_study_cases(question, scene, setting, evaluations, compute)
            if is_comparison or out is not None
            else UNSET,
        )
        sampled_figure = None
        if samples:
            judged = out_of_sample_layouts(
                setting,
                everyone,
                drawn,
                n_samples=samples,
                compute=compute,
            )
            planned = {item.layout.name: apr(item.rsu_all, item.axis) for item in judged_all}
            sampled = build_sampled_record(
                judged, drawn, tail=1.0, seed=compute.seed, planned_apr=planned
            )
            result = replace_fields(result, sampled=sampled)
            sampled_figure = plot_sampled_apr(judged)
        if out is None:
            return replace_fields(result, seconds=progress.finish())
        sensitivity = what_if.result(partial(progress, WHAT_IF, 0, 0))
        result = replace_fields(result, sensitivity=sensitivity)
        return write_results(
            out,
            result,
            setting,
            evaluations,
            command=command,
            progress=progress,
            bill=bill,
            sampled_figure=sampled_figure,
            beside=beside,
        )


def _with_distinct_names(layouts: Sequence[Layout]) -> list[Layout]:
    """Layouts under names of their own: one whose name is taken gets a number."""
    taken = {GREEDY, EXPERT}
    named = []
    for layout in layouts:
        names = chain([layout.name], (f"{layout.name} ({number})" for number in count(2)))
        name = next(name for name in names if name not in taken)
        taken.add(name)
        named.append(replace(layout, name=name))
    return named
