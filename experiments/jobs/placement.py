"""Placements, evaluations and comparisons: from a question to a folder of results."""

import io
import logging
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from msgspec.structs import replace as replace_fields

from geometry.errors import InputError
from geometry.phrases import Phrase
from geometry.registry import load_entry
from geometry.writing import is_about, write_atomically
from placement.cache import cached_value
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.evaluation import Evaluation, headline_apr
from placement.evaluator import evaluate_layouts
from placement.layout import Layout, find_baseline, layout_records
from placement.optimiser import apr as apr_on_table
from placement.optimiser.front import Front, front_below
from placement.pipeline import Placement
from placement.proof_files import build_certificate, build_mounts, save_certificate
from placement.question import Question, question_values
from placement.sampling.out_of_sample import out_of_sample_layouts
from placement.setting import build_setting
from placement.wishes import assumed_prices

from ..export.csv import to_csv
from ..export.geojson import to_geojson
from ..export.json import to_json, to_json_text
from ..language import language, mark
from ..parts import alternatives, bill_of_materials
from ..parts.baselines import build_baselines, compare_placement
from ..parts.bill_of_materials import BillOfMaterials, bill_of_materials_csv, build_bill
from ..parts.comparison import EXPERT, GREEDY, HIGHEST
from ..parts.decision import judge_by_decision
from ..parts.explanation import build_explained_record, build_refinement_record
from ..parts.front import FrontRecord, describe_front
from ..parts.result import (
    AskedRecord,
    PlacementResult,
    Result,
    build_placement_result,
)
from ..parts.sampled_worlds import SampledRecord, build_sampled_record
from ..parts.study_cases import STAGE as STUDY_CASES
from ..parts.study_cases import StudyCases, on_study_cases
from ..parts.units import build_private_ground_record
from ..progress import WRITING, StageProgress
from ..report.page import write_report
from ..results import folders
from ..results.cached import cached_part
from ..results.tables import apr_records, records_csv, runs_table
from .search import FoundLayout, Job, search

_log = logging.getLogger(__name__)

MIN_FRESH_WORLDS = 60
"""Least number of worlds to judge a layout in: with fewer, intervals say little."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answered:
    """A result, and all that its files are written from."""

    job: Job
    # Without seconds, and without what was asked.
    result: Result
    evaluations: Mapping[
        str, Evaluation
    ]  # by display name; the first one is the subject
    bill: BillOfMaterials
    # Of a layout that was searched for.
    placement: Placement | None = None
    # Rows of the placement's table.
    candidates: Sequence[CandidatePose] = ()
    # What the evaluator prefers.
    recommended: Layout | None = None


def run_placement(
    question: Question,
    *,
    out: Path,
    compute: Compute,
    command: str,
    progress: StageProgress,
    found: FoundLayout | None = None,
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
    found : FoundLayout, optional
        The layout, where it has been searched for already.
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
    if found is None:
        folders.expect_results(out, progress, sign=sign)
        found = search(question, compute=compute, progress=progress)
    result = write_results(
        answer_placement(found),
        out,
        asked=build_asked_record(asked or question, compute, command),
        sign=sign,
    )
    # As answer_placement makes it.
    assert isinstance(result, PlacementResult)
    return result


def answer_placement(found: FoundLayout) -> Answered:
    """Explain, evaluate and compare a layout that was found."""
    job = found.job
    question = job.question
    compute = job.compute
    progress = job.progress
    setting = job.setting
    scene = job.scene
    plan = found.plan
    placement = found.placement
    layout = placement.layout
    study = find_baseline(scene)
    proposed = compare_placement(placement, found.poses, setting, compute=compute)
    layouts = _named_layouts(placement, proposed.expert, study)
    progress(mark("explain"), 0, 0)
    explained = build_explained_record(placement, setting, found.poses, compute=compute)
    front = _front_below(found)
    by_runs = alternatives.find_other_weights(
        found.on_grid, question, plan, compute=compute, progress=progress
    )
    evaluations, leading = _evaluate(found, layouts)
    study_cases = judge_study_cases(job, evaluations)
    front_runners, mounting, recommended = alternatives.find_front_runners(
        leading, setting, question, compute=compute, progress=progress
    )
    prices = plan.wishes.prices
    bill = build_bill(
        layout,
        scene,
        site_cost_eur=question.site_cost_eur,
        kept_ids=plan.wishes.existing,
    )
    assumed = bill.assumed if prices is None else assumed_prices(prices, scene.sites)
    baseline = None
    if study is not None:
        baseline = evaluations[study.name]
    private_ground = None
    if plan.private_ground:
        private_ground = build_private_ground_record(
            layout.units, scene, plan.private_ground
        )
    refinement = None
    if found.refinement:
        refinement = build_refinement_record(found.refinement)
    sampled = None
    if question.n_samples:
        sampled = _in_fresh_worlds(found, evaluations)
    result = build_placement_result(
        placement,
        setting,
        found=evaluations[layout.name],
        greedy=evaluations[GREEDY],
        highest=evaluations.get(HIGHEST),
        baseline=baseline,
        compute=compute,
        next_unit=placement.next_unit,
        private_ground=private_ground,
        refinement=refinement,
        existing=tuple(
            unit.id for unit in layout.units if unit.id in plan.wishes.existing
        ),
        sensors_eur=bill.sensors_eur,
        sites_eur=bill.sites_eur,
        assumed_prices=assumed,
        explained=explained,
        front=front,
        by_runs=by_runs,
        front_runners=front_runners,
        mounting=mounting,
        study_cases=study_cases,
        **judge_by_decision(question.decision, setting, evaluations, compute=compute),
        baselines=build_baselines(proposed, evaluations.get(EXPERT), setting),
        sampled=sampled,
        # By name: no part of what is asked for.
        cheaper=load_entry("experiments.jobs.cheaper_sites:cheaper_sentence")(found),
    )
    return Answered(
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
    if expert is not None:
        layouts[EXPERT] = expert
    if study is not None:
        layouts[study.name] = study
    return layouts


def _evaluate(
    found: FoundLayout, layouts: Mapping[str, Layout]
) -> tuple[dict[str, Evaluation], list[Evaluation]]:
    """Layouts by display name, and those that lead, by the evaluator.

    The one found comes first.
    """
    job = found.job
    leading = alternatives.leading_layouts(found.on_grid, found.placement)
    further = [layout for layout in leading if layout is not found.placement.greedy]
    judged = evaluate_layouts(
        [*layouts.values(), *further], job.setting, compute=job.compute
    )
    by_name = {item.layout.name: item for item in judged}
    evaluations = dict(zip(layouts, judged[: len(layouts)], strict=True))
    return evaluations, [judged[0], *(by_name[layout.name] for layout in leading)]


def _in_fresh_worlds(
    found: FoundLayout, evaluations: Mapping[str, Evaluation]
) -> SampledRecord:
    """Layouts by display name in sampled worlds in which none was chosen."""
    job = found.job
    n_worlds = max(job.question.n_samples, MIN_FRESH_WORLDS)
    uncertainty = found.plan.uncertainty
    # Assemble reads it with every question.
    assert uncertainty is not None
    layouts = [item.layout for item in evaluations.values()]
    judged = out_of_sample_layouts(
        job.setting,
        layouts,
        uncertainty,
        n_samples=n_worlds,
        fusion=job.question.fusion,
        compute=job.compute,
    )
    placement = found.placement
    # Over all worlds, whatever was asked for: the least cost, the worst share, what is
    # left.
    chosen_apr = apr_on_table(
        replace(placement.problem, tail=1.0), placement.pose_index
    )
    return build_sampled_record(
        judged,
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


def _front_below(found: FoundLayout) -> FrontRecord | None:
    """The best layout of each smaller size, too.

    None where the best was not what was asked.
    """
    job = found.job
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
    job.progress(STUDY_CASES, 0, 0)
    try:
        return on_study_cases(
            job.question,
            job.setting,
            evaluations,
            build=lambda other: build_setting(
                other, job.scene, known=job.setting, compute=job.compute
            ),
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
    # Who writes a folder says what was asked.
    assert asked is not None
    for name, text in answer_files(answered, result).items():
        write_atomically(new / name, text)
    layout = _subject(answered)
    # Else nobody knows where on earth it lies.
    if setting.scene.crs:
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
    apr_csv, runs_parquet = _tables(evaluations, job.compute.cache_folder)
    write_atomically(new / folders.APR_FILE, apr_csv)
    write_atomically(new / folders.RUNS_FILE, runs_parquet)
    write_report(
        new,
        result,
        setting,
        evaluations,
        command=asked.command,
        bill=answered.bill,
        cache_folder=job.compute.cache_folder,
    )


def _tables(
    evaluations: Mapping[str, Evaluation], cache_folder: Path | None
) -> tuple[str, bytes]:
    """Contents of ``apr.csv`` and ``runs.parquet``.

    Cached, for pyarrow takes longer to load than either to write.
    """

    def build() -> tuple[str, bytes]:
        from pyarrow.parquet import write_table

        runs = io.BytesIO()
        write_table(runs_table(evaluations), runs)
        return records_csv(apr_records(evaluations)), runs.getvalue()

    return cached_part(
        cache_folder,
        "tables",
        build,
        kind=tuple[str, bytes],
        made_from=[evaluations],
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
