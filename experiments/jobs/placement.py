"""Placements, evaluations and comparisons: from a question to a folder of results."""

import logging
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from msgspec.structs import replace as replace_fields

from geometry.errors import InputError
from geometry.phrases import Phrase
from geometry.scene import Scene
from geometry.scene_files import load_scene
from geometry.writing import is_about, write_atomically
from placement.cache import cached_value
from placement.candidates import CandidatePose
from placement.certify import Grown, Growth, grow
from placement.compute import Compute, silent
from placement.evaluation import Evaluation, headline_apr
from placement.evaluator import evaluate_layouts, with_sight
from placement.layout import Layout, find_baseline, layout_records
from placement.optimiser import apr as apr_on_table
from placement.optimiser.front import Front, front_below
from placement.pipeline import Assembly, Placement, assemble, place
from placement.question import AUTO, Question, question_values
from placement.refinement import Refinement, refine
from placement.sampling.out_of_sample import STAGE as OUT_OF_SAMPLE
from placement.sampling.out_of_sample import (
    FreshWorlds,
    judge_layouts,
    look_at_fresh_worlds,
)
from placement.setting import Setting, build_setting
from placement.verification.certificates import build_certificate, save_certificate
from placement.verification.instances import build_mounts
from placement.wishes import assumed_prices

from ..export.geojson import to_geojson
from ..export.json import to_json, to_json_text
from ..export.table import to_csv
from ..language import language, mark
from ..parts import alternatives, bill_of_materials
from ..parts.baselines import build_baselines, compare_placement
from ..parts.bill_of_materials import BillOfMaterials, bill_of_materials_csv, build_bill
from ..parts.comparison import EXPERT, GREEDY, HIGHEST
from ..parts.explanation import build_explained_record, build_refinement_record
from ..parts.front import FrontRecord, describe_front
from ..parts.result import (
    AskedRecord,
    PlacementResult,
    Result,
    build_placement_result,
)
from ..parts.sampled_worlds import SampledRecord, build_sampled_record
from ..parts.study_cases import StudyCases, on_study_cases
from ..parts.units import build_plans, build_private_ground_record
from ..progress import WRITING, StageProgress
from ..report.page import begin_tasks, write_report
from ..results import folders
from ..results.tables import apr_table, csv_text, runs_table
from ..side_process import SideProcess, Task, side_process
from . import READY

_log = logging.getLogger(__name__)

MIN_FRESH_WORLDS = 60
"""Least number of worlds to judge a layout in: with fewer, intervals say little."""


_LARGE_RUNS = 100
"""With fewer, it takes longer to start a second process than to answer and draw."""
_WORLDS_TOGETHER = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """Values that all steps of a job need."""

    question: Question
    scene: Scene
    setting: Setting
    compute: Compute
    progress: StageProgress
    side: SideProcess


@contextmanager
def begin_job(
    question: Question,
    scene: Scene,
    *,
    setting: Setting | None = None,
    compute: Compute,
    progress: StageProgress,
    side: SideProcess | None = None,
    out: Path | None,
) -> Iterator[Job]:
    """Make the setting, if not known.

    Begin a second process unless `side` has one, if it pays.
    """
    if setting is None:
        folders.expect_results(out, progress)
        progress(mark("setting"), 0, 0)
        setting = build_setting(question, scene, compute=compute)
    setting = with_sight(setting, compute=compute)
    is_large = compute.workers > 1 and len(setting.runs) >= _LARGE_RUNS
    if side is not None and side.exists:
        begun = side
    else:
        begun = None
    with side_process(out is not None and is_large and begun is None, **READY) as new:
        chosen = begun or new
        chosen.share(setting)
        yield Job(
            question=question,
            scene=scene,
            setting=setting,
            compute=compute,
            progress=progress,
            side=chosen,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Found:
    """The layout that was asked for, and how it was found.

    `on_grid` is the placement before it was refined; `poses` are the rows of its table.
    """

    plan: Assembly
    placement: Placement
    on_grid: Placement
    refinement: Refinement | None
    poses: Sequence[CandidatePose]
    growth: Growth | None  # Where the number of worlds was to be found out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answered:
    """A result, and all that its files are written from."""

    job: Job
    result: Result  # without seconds, and without what was asked
    evaluations: Mapping[
        str, Evaluation
    ]  # by display name; the first one is the subject
    bill: BillOfMaterials
    placement: Placement | None = None  # of a layout that was searched for
    candidates: Sequence[CandidatePose] = ()  # rows of the placement's table
    recommended: Layout | None = None  # what the evaluator prefers


def run_placement(
    question: Question,
    *,
    out: Path,
    compute: Compute,
    command: str,
    progress: StageProgress,
    side: SideProcess | None = None,
    asked: Question | None = None,
    sign: Path | None = None,
) -> PlacementResult:
    """Find, prove, evaluate and compare a layout, and write everything to `out`.

    Parameters
    ----------
    question : Question
        With its map imported.
    out : Path
        Folder of the results.
    compute : Compute
        How to compute.
    command : str
        Command line that makes the result again, for the report.
    progress : StageProgress
        Is told the stages.
    side : SideProcess, optional
        A second process that was begun while this one was loading.
    asked : Question, optional
        As it was asked, before its map was imported; by default `question`.
    sign : Path, optional
        Key that signs the folder.

    Returns
    -------
    result : PlacementResult
        What ``summary.json`` holds.

    Raises
    ------
    InputError
        A wish cannot be met, or `out` cannot be written or signed.
    """
    folders.expect_results(out, progress, sign=sign)
    with answer_placement(
        question, out=out, compute=compute, progress=progress, side=side
    ) as answered:
        result = write_results(
            answered,
            out,
            asked=build_asked_record(asked or question, compute, command),
            sign=sign,
        )
    assert isinstance(result, PlacementResult)  # as answer_placement makes it
    return result


@contextmanager
def answer_placement(
    question: Question,
    *,
    out: Path,
    compute: Compute,
    progress: StageProgress,
    side: SideProcess | None = None,
) -> Iterator[Answered]:
    """Find, prove, evaluate and compare a layout.

    `out` is where its files will be written.

    Raises InputError if a wish cannot be met.
    """
    scene = load_scene(question.scene)
    if question.samples == AUTO:
        grown = grow(question, scene=scene, compute=compute)
    else:
        grown = None
    if grown:
        question = replace(question, samples=grown.growth.taken)
    if grown:
        plan = grown.assembly
    else:
        plan = assemble(question, scene=scene, compute=compute)
    job_of = partial(
        begin_job, setting=plan.setting, compute=compute, progress=progress
    )
    with job_of(question, scene, side=side, out=out) as job:
        found = _find(job, plan, grown)
        placement, layout, setting = (
            found.placement,
            found.placement.layout,
            job.setting,
        )
        study = find_baseline(scene)
        proposed = compare_placement(placement, found.poses, setting, seed=compute.seed)
        layouts = _named_layouts(placement, proposed.expert, study)
        # What depends on the layouts alone is begun, the longest first.
        standing = alternatives.begin_standing(
            job.side, setting, layout, question, compute
        )
        fresh = _begin_fresh_worlds(job, plan, [*layouts.values()])
        progress(mark("explain"), 0, 0)
        explained = build_explained_record(
            placement, setting, found.poses, compute=compute
        )
        if study is None:
            others = []
        else:
            others = [study]
        job.side.begin("plans", build_plans, setting, {layout.name: layout}, others)
        front = _front_below(job, found)
        by_runs = alternatives.find_other_weights(
            found.on_grid, question, plan, compute=compute, progress=progress
        )
        evaluations, leading = _evaluate(job, found, layouts)
        study_cases = judge_study_cases(
            job, evaluations
        )  # while the other process goes on
        front_runners, mounting, recommended = alternatives.find_front_runners(
            leading, standing, setting, question, compute=compute, progress=progress
        )
        existing = plan.wishes.existing
        prices = plan.wishes.prices
        private = plan.private_ground
        site_eur = question.site_cost_eur
        bill = build_bill(layout, scene, site_cost_eur=site_eur, kept_ids=existing)
        result = build_placement_result(
            placement,
            setting,
            found=evaluations[layout.name],
            greedy=evaluations[GREEDY],
            highest=evaluations.get(HIGHEST),
            baseline=None if study is None else evaluations[study.name],
            compute=compute,
            next_unit=placement.next_unit,
            private_ground=private
            and build_private_ground_record(layout.units, scene, private),
            refinement=found.refinement and build_refinement_record(found.refinement),
            sites_eur=bill.sites_eur,
            assumed_prices=(
                bill.assumed if prices is None else assumed_prices(prices, scene.sites)
            ),
            explained=explained,
            front=front,
            by_runs=by_runs,
            front_runners=front_runners,
            mounting=mounting,
            study_cases=study_cases,
            baselines=build_baselines(proposed, evaluations.get(EXPERT), setting),
            sampled=_in_fresh_worlds(job, found, evaluations, fresh) if fresh else None,
        )
        yield Answered(
            job=job,
            result=result,
            evaluations=evaluations,
            bill=bill,
            placement=placement,
            candidates=found.poses,
            recommended=recommended,
        )


def _named_layouts(
    placement: Placement, expert: Layout | None, study: Layout | None
) -> dict[str, Layout]:
    """Layouts to evaluate by display name, the one found first."""
    layouts = {placement.layout.name: placement.layout, GREEDY: placement.greedy}
    if (
        placement.highest is not None
        and placement.highest.pose_index != placement.pose_index
    ):
        layouts[HIGHEST] = placement.highest.layout
    if expert is None:
        layouts |= {}
    else:
        layouts |= {EXPERT: expert}
    return layouts | ({} if study is None else {study.name: study})


def _find(job: Job, plan: Assembly, grown: Grown | None) -> _Found:
    """Solve, and refine if asked to; the optimiser leaves the second process idle."""
    question = job.question
    compute = job.compute
    progress = job.progress

    def report(stage: str, done: int, total: int) -> None:
        cache = compute.cache_folder
        if stage == "optimise" and cache is not None and any(cache.glob("table-*")):
            progress.kept += "; the detection table is cached for the next call"
        progress(stage, done, total)

    reporting = replace(compute, progress=report)
    if grown:
        placement = grown.placement
    else:  # poses that are turned yet are compared with nothing
        placement = place(
            replace(plan, compute=reporting), asks_worlds=not question.refine
        )
    refinement = None
    if question.refine:
        refinement = refine(
            job.setting,
            placement,
            plan.candidates,
            solver=plan.effort,
            compute=reporting,
        )
    return _Found(
        plan=plan,
        placement=placement if refinement is None else refinement.placement,
        on_grid=placement,
        refinement=refinement,
        poses=plan.candidates if refinement is None else refinement.candidates,
        growth=grown.growth if grown else None,
    )


def _begin_fresh_worlds(
    job: Job, plan: Assembly, layouts: Sequence[Layout]
) -> list[Task[FreshWorlds]]:
    """Look at layouts in fresh sampled worlds, if asked for, in either process."""
    n_samples = job.question.n_samples
    uncertainty = plan.uncertainty
    if n_samples:
        n_worlds = max(n_samples, MIN_FRESH_WORLDS)
    else:
        n_worlds = 0
    assert uncertainty is not None  # assemble reads it with every question
    return [
        job.side.begin(
            f"fresh worlds from {first}",
            look_at_fresh_worlds,
            job.setting,
            layouts,
            uncertainty,
            n_worlds=min(_WORLDS_TOGETHER, n_worlds - first),
            first=first,
            fusion=job.question.fusion,
            compute=replace(job.compute, progress=silent),
        )
        for first in range(0, n_worlds, _WORLDS_TOGETHER)
    ]


def _evaluate(
    job: Job, found: _Found, layouts: Mapping[str, Layout]
) -> tuple[dict[str, Evaluation], list[Evaluation]]:
    """Layouts by display name, and those that lead, by the evaluator.

    The one found comes first.
    """
    leading = alternatives.leading_layouts(found.on_grid, found.placement)
    further = [layout for layout in leading if layout is not found.placement.greedy]
    judged = evaluate_layouts(
        [*layouts.values(), *further], job.setting, compute=job.compute
    )
    by_name = {item.layout.name: item for item in judged}
    evaluations = dict(zip(layouts, judged[: len(layouts)], strict=True))
    return evaluations, [judged[0], *(by_name[layout.name] for layout in leading)]


def _in_fresh_worlds(
    job: Job,
    found: _Found,
    evaluations: Mapping[str, Evaluation],
    fresh: Sequence[Task[FreshWorlds]],
) -> SampledRecord:
    """Layouts in fresh worlds.

    The other process begins with the first ones, this one last.
    """
    looked: list[FreshWorlds] = []
    for done, task in enumerate(reversed(fresh)):
        job.progress(OUT_OF_SAMPLE, done, len(fresh))
        looked.insert(0, task.result())
    placement = found.placement
    uncertainty = found.plan.uncertainty
    assert uncertainty is not None  # what the fresh worlds are drawn from
    layouts = [item.layout for item in evaluations.values()]
    # Over all worlds, whatever was asked for: the least cost, the worst share, what is
    # left.
    chosen_apr = apr_on_table(
        replace(placement.problem, tail=1.0), placement.pose_index
    )
    return build_sampled_record(
        judge_layouts(job.setting, layouts, uncertainty, looked),
        uncertainty,
        tail=found.plan.wishes.tail,
        seed=job.compute.seed,
        planned_apr={
            item.layout.name: headline_apr(item) for item in evaluations.values()
        },
        chosen_apr={placement.layout.name: chosen_apr},
        chosen_in=job.question.n_samples,
        growth=found.growth,
    )


def _front_below(job: Job, found: _Found) -> FrontRecord | None:
    """The best layout of each smaller size, too.

    None where the best was not what was asked.
    """
    placement = found.placement
    plan = found.plan
    progress = job.progress
    best = placement if placement.highest is None else placement.highest
    problem = best.problem
    chosen = best.pose_index
    if problem.goal != "best" or problem.survive:
        return None
    n_kept = len(plan.wishes.existing)
    if len(chosen) > max(n_kept, 1):
        progress(mark("fewer units"), 0, 0)
    front = cached_value(
        job.compute.cache_folder,
        "front",
        lambda: front_below(
            problem,
            chosen,
            best.certificate,
            min_units=n_kept,
            effort=plan.effort,
            on_point=lambda point: progress(
                Phrase("fewer units: {n}", n=point.units), 0, 0
            ),
            reduced=None if placement.presolved is None else placement.presolved(),
        ),
        kind=Front,
        made_from=(problem, chosen, best.certificate, n_kept, plan.effort),
        is_worth_it=lambda front: front.is_proven,
    )
    return describe_front(front, problem, found.poses, n_kept=n_kept)


def judge_study_cases(
    job: Job, evaluations: Mapping[str, Evaluation]
) -> StudyCases | None:
    """The layouts on the study's cases.

    None where these are asked about, or no arm has them.
    """
    try:
        return on_study_cases(
            job.question,
            job.setting,
            evaluations,
            build=lambda other: build_setting(other, job.scene, compute=job.compute),
            compute=job.compute,
        )
    except InputError as error:  # the words of the question are known to be right
        _log.info("the study's cases: %s", error)
        return None


def build_asked_record(
    question: Question, compute: Compute, command: str
) -> AskedRecord:
    """What was asked, as ``summary.json`` keeps it.

    The language is the one that is spoken.
    """
    return AskedRecord(
        command=command,
        question=question_values(question),
        seed=compute.seed,
        rays=compute.rays,
        language=language(),
    )


def write_results(
    answered: Answered,
    folder: Path | None,
    *,
    asked: AskedRecord,
    sign: Path | None = None,
) -> Result:
    """The result with its "seconds", all stages but the writing.

    In a folder, if asked for.

    `folder` is replaced as a whole, or left as it was; the key `sign` signs it. Raises
    InputError if something cannot be written: it names the folder where the answer is
    all the same.
    """
    progress = answered.job.progress
    result = answered.result
    if folder is None:
        return replace_fields(result, seconds=progress.finish())
    progress(WRITING, 0, 0)
    # Rounded as in the end, so that the report can be made again from what the summary
    # says.
    seconds = {stage: round(value, 3) for stage, value in progress.seconds.items()}
    result = replace_fields(result, seconds=seconds, asked=asked)
    answer = answer_files(answered, result)
    with (
        _saved_elsewhere(folder, answer),
        folders.new_result_folder(folder, sign=sign) as new,
    ):
        write_files(new, answered, result)
        result = replace_fields(result, seconds=progress.finish())
        write_atomically(new / folders.MARKER, to_json_text(result))
    progress.kept = f"the results are in {folder}"
    return result


def answer_files(answered: Answered, result: Result) -> dict[str, str]:
    """The answer as files, by name: what is kept if all else cannot be written."""
    scene = answered.job.setting.scene
    layout = _subject(answered)
    files = {
        folders.LAYOUT_FILE: to_json(layout, scene),
        "layout.csv": to_csv(layout, scene),
        folders.MARKER: to_json_text(result),
    }
    if answered.recommended is not None:
        recommended = replace(answered.recommended, scene_name=scene.name)
        files[folders.RECOMMENDED_FILE] = to_json(recommended)
    return files


def _subject(answered: Answered) -> Layout:
    """The layout that the result is about, with the scene's name."""
    subject = next(iter(answered.evaluations.values()))
    return replace(subject.layout, scene_name=answered.job.setting.scene.name)


def write_files(new: Path, answered: Answered, result: Result) -> None:
    """Write all files of a result into a folder: the answer first, the report last.

    `result` is that of `answered` with its seconds so far, and with what was asked,
    whose command makes it again. Raises OSError if one cannot be written.
    """
    job = answered.job
    setting = job.setting
    evaluations = answered.evaluations
    placement = answered.placement
    asked = result.asked
    assert asked is not None  # who writes a folder says what was asked
    # Drawn while other files are written.
    begin_tasks(job.side, result, setting, evaluations)
    for name, text in answer_files(answered, result).items():
        write_atomically(new / name, text)
    layout = _subject(answered)
    if setting.scene.crs:  # else nobody knows where on earth it lies
        geojson = to_geojson(layout, setting.scene.crs, setting.scene)
        write_atomically(new / "layout.geojson", geojson)
    if placement is not None:
        mounts = build_mounts(setting.scene, answered.candidates)
        document = build_certificate(
            placement.problem,
            placement.certificate,
            pose_index=placement.pose_index,
            units=layout_records(layout),
            presolve=placement.presolve,
            seconds=placement.seconds,
            versions=result.versions,
            mounts=mounts,
        )
        save_certificate(new, document, placement.problem, mounts)
    bill_text = bill_of_materials_csv(answered.bill)
    write_atomically(new / bill_of_materials.FILE_NAME, bill_text)
    write_atomically(new / folders.APR_FILE, csv_text(apr_table(evaluations)))
    write_atomically(new / folders.RUNS_FILE, runs_table(evaluations).to_parquet())
    write_report(
        new,
        result,
        setting,
        evaluations,
        command=asked.command,
        bill=answered.bill,
        side=job.side,
    )


@contextmanager
def _saved_elsewhere(folder: Path, answer: Mapping[str, str]) -> Iterator[None]:
    """Keep the answer in a temporary file if its folder cannot take it."""
    try:
        yield
    except OSError as error:
        kept = Path(tempfile.mkdtemp(prefix="place-rsus-kept-"))
        for name, text in answer.items():
            write_atomically(kept / name, text)
        more = f"layout and numbers are kept in {kept}"
        if not is_about(error, folder):
            error.add_note(more)
            raise
        raise folders.unwritable(folder, error, f"; {more}") from error
