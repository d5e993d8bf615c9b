"""Recordings in place of simulated runs: judge their units, or choose the best of them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace as replace_field
from pathlib import Path

from msgspec.structs import replace

from geometry.errors import InputError, Unquoted
from geometry.files import write_atomically
from placement.optimiser import (
    apr_one_failed,
    presolve,
    solve_greedy,
    solve_placement,
)
from placement.pipeline import build_effort
from placement.question import Question
from placement.recordings import (
    RecordedEvaluation,
    Recording,
    evaluate_recording,
    read_recording,
    take_units,
)
from placement.setting import build_rule
from placement.verification.certificates import build_certificate, save_certificate
from scenarios.aeb import AebRule

from ..export.json import to_json_text
from ..progress import WRITING, StageProgress
from ..results.folders import MARKER, check_result_folder, new_result_folder
from ..results.record import build_stage_records, to_plain
from ..results.recordings import (
    RecordedResult,
    build_recorded_apr_record,
    build_recorded_greedy_record,
    build_recorded_result,
    recorded_problem,
)

ALL_UNITS = "RSU_all"
"""All units of a recording together, in the study's words."""


def run_recording(
    question: Question,
    *,
    folder: Path,
    min_confidence: float,
    out: Path | None,
    progress: StageProgress,
) -> RecordedResult:
    """Judge the units of a recording, and write ``summary.json`` if asked to.

    Parameters
    ----------
    question : Question
        Only how the VUT confirms and brakes counts.
    folder : Path
        In the study's format, see :mod:`placement.recordings`.
    min_confidence : float
        Detections below do not count.
    out : Path, optional
        Result folder; else nothing is written.
    progress : StageProgress
        Is told the stages.

    Raises
    ------
    InputError
        The recording is not what it should be, or `out` cannot be written.
    """
    rule = _build_rule(question)
    recording, evaluation = _evaluate(folder, rule, min_confidence, out, progress)
    return _finish(build_recorded_result(recording, evaluation, rule), out, progress)


def run_recorded_placement(
    question: Question,
    *,
    folder: Path,
    min_confidence: float,
    out: Path | None,
    progress: StageProgress,
) -> RecordedResult:
    """Choose the best roadside units among those of a recording, and prove the choice.

    Parameters
    ----------
    question, folder, min_confidence, out, progress
        As for :func:`run_recording`.
    question : Question
        Budget, fusion, how hard to try; a recording has no sites and no prices.

    Raises
    ------
    InputError
        As :func:`run_recording`, or the budget is more than the units recorded.
    """
    rule = _build_rule(question)
    recording, everything = _evaluate(folder, rule, min_confidence, out, progress)
    n_units = len(recording.units)
    budget_units, fusion = question.budget, question.fusion
    if budget_units is None:
        raise InputError("--budget", Unquoted("nothing"), "units, beside a recording")
    if budget_units > n_units:
        raise InputError("--budget", budget_units, f"at most {n_units}, the units recorded")
    progress("optimise", 0, 0)
    problem = recorded_problem(everything, budget_units=budget_units, fusion=fusion, rule=rule)
    reduced = presolve(problem)
    solution = solve_placement(
        problem,
        reduced,
        effort=build_effort(question),
        on_stage=lambda stage: progress(f"optimise: {stage}", 0, 0),
    )
    greedy = _pick(recording, solve_greedy(problem, reduced))
    chosen = _pick(recording, solution.pose_index)
    first = solution.certificate.stages[0]
    result = replace(
        build_recorded_result(recording, take_units(everything, chosen, rule), rule),
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
        baseline=build_recorded_apr_record(everything, rule),
        greedy=build_recorded_greedy_record(greedy, take_units(everything, greedy, rule), rule),
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
    return _finish(result, out, progress, lambda new: save_certificate(new, document, problem))


def _build_rule(question: Question) -> AebRule:
    """The rule of a question; a recording of the study is read as the study does: no track dies."""
    endless = math.inf if question.track_memory_s is None else question.track_memory_s
    return build_rule(replace_field(question, track_memory_s=endless))


def _evaluate(
    folder: Path, rule: AebRule, min_confidence: float, out: Path | None, progress: StageProgress
) -> tuple[Recording, RecordedEvaluation]:
    if out is not None:
        check_result_folder(out)
    progress("read recording", 0, 0)
    recording = read_recording(folder)
    progress("evaluate", 0, 0)
    return recording, evaluate_recording(recording, rule, min_confidence=min_confidence)


def _pick(recording: Recording, unit_index: Sequence[int]) -> list[str]:
    return [recording.units[index] for index in unit_index]


def _finish(
    result: RecordedResult,
    out: Path | None,
    progress: StageProgress,
    write_more: Callable[[Path], None] | None = None,
) -> RecordedResult:
    if out is None:
        return replace(result, seconds=progress.finish())
    progress(WRITING, 0, 0)
    with new_result_folder(out) as new:
        if write_more is not None:
            write_more(new)
        result = replace(result, seconds=progress.finish())
        text = to_json_text(result).encode()
        write_atomically(new / MARKER, text)
    progress.kept = f"the results are in {out}"
    return result
