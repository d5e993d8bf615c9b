"""Recordings in place of simulated runs.

Judge their units, or choose the best of them.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace as replace_field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from msgspec.structs import asdict as fields_of
from msgspec.structs import replace

from geometry.errors import InputError, Unquoted
from geometry.phrases import Phrase
from geometry.writing import write_atomically
from placement.evaluation import Verdict, apr, apr_by_case, detected_share
from placement.optimiser import (
    Fusion,
    Limits,
    PlacementProblem,
    apr_one_failed,
    presolve,
    solve_greedy,
    solve_placement,
)
from placement.pipeline import build_effort
from placement.proof_files import build_certificate, save_certificate
from placement.question import Question
from placement.recordings import (
    RecordedEvaluation,
    Recording,
    evaluate_recording,
    is_longitudinal,
    read_recording,
    recorded_table,
    take_units,
)
from placement.setting import build_rule
from scenarios.aeb import AebRule

from ..export.json import to_json_text
from ..language import mark
from ..progress import WRITING, StageProgress
from ..results.drives import RefusalRecord, versions
from ..results.folders import MARKER, expect_results, new_result_folder
from ..results.numbers import finite_or_none
from ..results.record import (
    PartyAprRecord,
    Record,
    StageRecord,
    build_stage_records,
    to_plain,
)

_T = TypeVar("_T")
ALL_UNITS = "RSU_all"
"""All units of a recording together, in the study's words."""


class RecordedUnitRecord(Record, frozen=True, kw_only=True):
    """A recorded unit; a recording does not say where it is mounted."""

    id: str
    folder: str


class RecordedAprRecord(Record, frozen=True, kw_only=True):
    """APR of each party of a recording.

    None where the recording has no detections of the vehicle itself.
    """

    vut: PartyAprRecord | None
    rsu_all: PartyAprRecord
    vut_and_rsus: PartyAprRecord | None
    units: dict[str, PartyAprRecord]
    apr_without_worst_unit: float


class RecordedGreedyRecord(RecordedAprRecord, frozen=True, kw_only=True):
    """Units chosen one by one."""

    layout: tuple[RecordedUnitRecord, ...]


class DetectedShareRecord(Record, frozen=True, kw_only=True):
    """Share of the frames in which each party detects the road user."""

    vut: float | None
    rsu_all: float
    vut_and_rsus: float | None
    units: dict[str, float]


class RecordedDriveRecord(Record, frozen=True, kw_only=True):
    """A drive of the recording, and whether the units avoid its accident."""

    run: str
    case: str
    first_frame: int
    frames: int
    missing_frames: int
    vut_speed_kmh: float
    vru_speed_kmh: float
    closing_speed_mps: float
    motion: str
    last_brake_time_s: float
    is_avoided: bool


class RecordedFramesRecord(Record, frozen=True, kw_only=True):
    """Numbers of frames."""

    recorded: int
    in_drives: int
    missing_in_drives: int
    several_vrus_in_view: int


class RecordedResult(Record, frozen=True, kw_only=True):
    """Result of ``--recording``: ``summary.json``, and what ``--json`` prints.

    The fields of a result that a recording has; those after "versions" where units were
    chosen. There is no surrogate that could disagree.
    """

    name: str
    recording: str
    layout: tuple[RecordedUnitRecord, ...]
    budget: int | None
    fusion: str
    runs: int
    cases: tuple[str, ...]
    weathers: tuple[str, ...]
    track_memory_s: float | None = None
    not_driven: tuple[RefusalRecord, ...] = ()
    apr: float
    bound: float | None
    gap: float | None
    apr_without_worst_unit: float
    evaluation: RecordedAprRecord
    detected_share: DetectedShareRecord
    drives: tuple[RecordedDriveRecord, ...]
    frames: RecordedFramesRecord
    skipped: dict[str, int]
    baseline: RecordedAprRecord | None
    surrogate_disagreement: None = None
    seconds: dict[str, float]
    versions: dict[str, str]
    candidates: int | None = None
    stages: tuple[StageRecord, ...] | None = None
    solver: str | None = None
    baseline_name: str | None = None
    greedy: RecordedGreedyRecord | None = None


def _build_result(
    recording: Recording, evaluation: RecordedEvaluation, rule: AebRule
) -> RecordedResult:
    """The units of a recording, or some of them; "seconds" is empty."""
    axis = evaluation.axis
    evaluated = _build_apr(evaluation, rule)
    shares = _of_parties(lambda verdict: detected_share(verdict, axis), evaluation)
    return RecordedResult(
        name=recording.folder.name,
        recording=str(recording.folder),
        layout=_units(evaluation.units),
        budget=None,
        fusion="any",
        runs=axis.n_runs,
        cases=tuple(dict.fromkeys(axis.cases)),
        weathers=tuple(dict.fromkeys(axis.weathers)),
        track_memory_s=finite_or_none(rule.track_memory_s),
        apr=evaluated.rsu_all.all,  # type: ignore[arg-type]
        bound=None,
        gap=None,
        apr_without_worst_unit=evaluated.apr_without_worst_unit,
        evaluation=evaluated,
        detected_share=DetectedShareRecord(**shares),
        drives=tuple(
            RecordedDriveRecord(
                run=axis.run_ids[index],
                case=axis.cases[index],
                first_frame=drive.first_number,
                frames=drive.n_frames,
                missing_frames=drive.n_missing,
                vut_speed_kmh=float(axis.vut_speed_kmh[index]),
                vru_speed_kmh=3.6 * drive.vru_speed_mps,
                closing_speed_mps=drive.closing_speed_mps,
                motion="same direction" if is_longitudinal(drive) else "crossing",
                last_brake_time_s=float(axis.last_brake_time_s[index]),
                is_avoided=bool(evaluation.rsu_all.is_avoided[index]),
            )
            for index, drive in enumerate(recording.drives)
        ),
        frames=RecordedFramesRecord(
            recorded=recording.n_frames,
            in_drives=axis.n_frames,
            missing_in_drives=recording.n_missing,
            several_vrus_in_view=evaluation.n_ambiguous,
        ),
        skipped=dict(recording.skipped),
        baseline=None,
        seconds={},
        versions=versions(),
    )


def _units(folder_names: Iterable[str]) -> tuple[RecordedUnitRecord, ...]:
    """Units by the names of their folders."""
    return tuple(
        RecordedUnitRecord(id=f"RSU{name}", folder=name) for name in folder_names
    )


def _of_parties(
    measure: Callable[[Verdict], _T], found: RecordedEvaluation
) -> dict[str, Any]:
    """A measure of each party, by its name.

    None where the vehicle's detections are unknown.
    """
    return {
        "vut": None if found.vut is None else measure(found.vut),
        "rsu_all": measure(found.rsu_all),
        "vut_and_rsus": (
            None if found.vut_and_rsus is None else measure(found.vut_and_rsus)
        ),
        "units": {f"RSU{name}": measure(unit) for name, unit in found.units.items()},
    }


def _build_apr(evaluation: RecordedEvaluation, rule: AebRule) -> RecordedAprRecord:
    """APR of every party, over all drives and by case."""
    axis, n_units = evaluation.axis, len(evaluation.units)

    def ratios(verdict: Verdict) -> PartyAprRecord:
        return PartyAprRecord(
            all=apr(verdict, axis), by_case={**apr_by_case(verdict, axis)}
        )

    problem = recorded_problem(evaluation, fusion="any", rule=rule)
    return RecordedAprRecord(
        **_of_parties(ratios, evaluation),
        apr_without_worst_unit=apr_one_failed(problem, range(n_units)),
    )


def recorded_problem(
    evaluation: RecordedEvaluation,
    *,
    budget_units: int | None = None,
    fusion: Fusion,
    rule: AebRule,
) -> PlacementProblem:
    """The choice among recorded units: each alone on a site of its own.

    `budget_units` are the most that may be chosen; by default all.
    """
    n_units = len(evaluation.units)
    ones = np.ones(n_units, dtype=np.int64)
    limits = Limits(
        site_index=np.arange(n_units), site_capacity=ones, budget_units=budget_units
    )
    table = recorded_table(evaluation)
    return PlacementProblem(table=table, limits=limits, fusion=fusion, rule=rule)


def run_recording(
    question: Question,
    *,
    folder: Path,
    min_confidence: float,
    chooses: bool = False,
    out: Path | None,
    progress: StageProgress,
    sign: Path | None = None,
) -> RecordedResult:
    """Judge the units of a recording, or choose the best and prove it.

    Written if asked to.

    Of the question only how the VUT confirms and brakes counts, and with `chooses`
    budget, fusion and how hard to try; detections below `min_confidence` do not. Raises
    InputError if the recording is not what it should be, the budget is more than the
    units recorded, or `out` cannot be written.
    """
    # By default as the study reads a recording: no track dies.
    if question.track_memory_s is None:
        endless = math.inf
    else:
        endless = question.track_memory_s
    rule = build_rule(replace_field(question, track_memory_s=endless))
    expect_results(out, progress, sign=sign)
    progress(mark("read recording"), 0, 0)
    recording = read_recording(folder)
    progress(mark("evaluate"), 0, 0)
    everything = evaluate_recording(recording, rule, min_confidence=min_confidence)
    if not chooses:
        result = _build_result(recording, everything, rule)
        return _finish(result, out, progress, sign=sign)
    n_units = len(recording.units)
    budget_units = question.budget
    fusion = question.fusion
    if budget_units is None:
        raise InputError("--budget", Unquoted("nothing"), "units, beside a recording")
    if budget_units > n_units:
        raise InputError(
            "--budget", budget_units, f"at most {n_units}, the units recorded"
        )
    progress(mark("optimise"), 0, 0)
    problem = recorded_problem(
        everything, budget_units=budget_units, fusion=fusion, rule=rule
    )
    reduced = presolve(problem)
    solution = solve_placement(
        problem,
        reduced,
        effort=build_effort(question),
        on_stage=lambda stage: progress(Phrase("optimise: {goal}", goal=stage), 0, 0),
    )
    greedy = [recording.units[index] for index in solve_greedy(problem, reduced)]
    chosen = [recording.units[index] for index in solution.pose_index]
    first = solution.certificate.stages[0]
    result = replace(
        _build_result(recording, take_units(everything, chosen, rule), rule),
        name=f"best-{budget_units}",
        budget=budget_units,
        fusion=fusion,
        candidates=n_units,
        apr=first.objective,
        bound=first.bound,
        gap=first.gap,
        apr_without_worst_unit=apr_one_failed(problem, solution.pose_index),
        stages=build_stage_records(solution.certificate),
        solver=solution.certificate.solver,
        baseline_name=ALL_UNITS,
        baseline=_build_apr(everything, rule),
        greedy=RecordedGreedyRecord(
            layout=_units(greedy),
            **fields_of(_build_apr(take_units(everything, greedy, rule), rule)),
        ),
    )
    document = build_certificate(
        problem,
        solution.certificate,
        pose_index=solution.pose_index,
        units=[to_plain(unit) for unit in result.layout],
        presolve=solution.presolve,
        seconds=progress.seconds,
        versions=result.versions,
    )

    def write_certificate(new: Path) -> None:
        save_certificate(new, document, problem)

    return _finish(result, out, progress, write_certificate, sign=sign)


def _finish(
    result: RecordedResult,
    out: Path | None,
    progress: StageProgress,
    write_more: Callable[[Path], None] | None = None,
    *,
    sign: Path | None = None,
) -> RecordedResult:
    """The result with its "seconds", written and signed if asked to."""
    if out is None:
        return replace(result, seconds=progress.finish())
    progress(WRITING, 0, 0)
    with new_result_folder(out, sign=sign) as new:
        if write_more is not None:
            write_more(new)
        result = replace(result, seconds=progress.finish())
        write_atomically(new / MARKER, to_json_text(result))
    progress.kept = f"the results are in {out}"
    return result
