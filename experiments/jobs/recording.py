"""What the commands do with a recording: judge its units, or choose the best of them."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from geometry.errors import InputError, Unquoted
from placement.evaluation import (
    Verdict,
    apr,
    apr_by_case,
    detected_share,
)
from placement.optimiser import (
    Fusion,
    Limits,
    PlacementProblem,
    apr_one_failed,
    presolve,
    solve_greedy,
    solve_placement,
)
from placement.planning import build_effort
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
from placement.verification.certificates import build_certificate, save_certificate
from scenarios.aeb import AebRule

from ..export.json import to_json_text
from ..progress import WRITING, StageProgress
from ..results.drives import versions
from ..results.reading import MARKER
from .writing import check_result_folder, new_result_folder

ALL_UNITS = "RSU_all"
"""All units of a recording together, in the study's words."""


def run_recording(
    question: Question,
    *,
    folder: Path,
    min_confidence: float,
    out: Path | None,
    progress: StageProgress,
) -> dict[str, Any]:
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

    Returns
    -------
    summary : dict
        The keys of :func:`.summarise_layout`, and what was read and skipped.

    Raises
    ------
    InputError
        The recording is not what it should be, or `out` cannot be written.
    """
    rule = build_rule(question)
    recording, evaluation = _evaluate(folder, rule, min_confidence, out, progress)
    summary = _summarise(recording, evaluation, rule)
    return _finish(summary, out, progress)


def run_recorded_placement(
    question: Question,
    *,
    folder: Path,
    min_confidence: float,
    out: Path | None,
    progress: StageProgress,
) -> dict[str, Any]:
    """Choose the best roadside units among those of a recording, and prove the choice.

    Parameters
    ----------
    question, folder, min_confidence, out, progress
        As for :func:`run_recording`.
    question : Question
        Budget, fusion, how hard to try; a recording has no sites and no prices.

    Returns
    -------
    summary : dict
        The keys of :func:`.summarise_placement`; the baseline is all recorded
        units, and there is no surrogate that could disagree.

    Raises
    ------
    InputError
        As :func:`run_recording`, or the budget is more than the units recorded.
    """
    rule = build_rule(question)
    recording, everything = _evaluate(folder, rule, min_confidence, out, progress)
    n_units = len(recording.units)
    budget_units, fusion = question.budget, question.fusion
    if budget_units is None:
        raise InputError("--budget", Unquoted("nothing"), "units, beside a recording")
    if budget_units > n_units:
        raise InputError("--budget", budget_units, f"at most {n_units}, the units recorded")
    progress("optimise", 0, 0)
    problem = _problem(everything, range(n_units), budget_units, fusion, rule)
    reduced = presolve(problem)
    solution = solve_placement(
        problem,
        reduced,
        effort=build_effort(question),
        on_stage=lambda stage: progress(f"optimise: {stage}", 0, 0),
    )
    greedy = _pick(recording, solve_greedy(problem, reduced))
    chosen = _pick(recording, solution.pose_index)
    summary = _summarise(recording, take_units(everything, chosen, rule), rule)
    first = solution.certificate.stages[0]
    summary |= {
        "name": f"best-{budget_units}",
        "budget": budget_units,
        "fusion": fusion,
        "candidates": n_units,
        "apr": first.objective,
        "bound": first.bound,
        "gap": first.gap,
        "apr_without_worst_unit": apr_one_failed(problem, solution.pose_index),
        "stages": [asdict(stage) for stage in solution.certificate.stages],
        "solver": solution.certificate.solver,
        "baseline_name": ALL_UNITS,
        "baseline": _summarise_evaluation(everything, rule),
        "greedy": {
            "layout": _units(greedy),
            **_summarise_evaluation(take_units(everything, greedy, rule), rule),
        },
    }
    document = build_certificate(
        problem,
        solution.certificate,
        pose_index=solution.pose_index,
        units=summary["layout"],
        presolve=solution.presolve,
        seconds=progress.seconds,
        versions=summary["versions"],
    )
    return _finish(summary, out, progress, lambda new: save_certificate(new, document, problem))


def rsu_name(folder_name: str) -> str:
    """What a roadside unit is called, by the name of its folder."""
    return f"RSU{folder_name}"


def _evaluate(
    folder: Path, rule: AebRule, min_confidence: float, out: Path | None, progress: StageProgress
) -> tuple[Recording, RecordedEvaluation]:
    if out is not None:
        check_result_folder(out)
    progress("read recording", 0, 0)
    recording = read_recording(folder)
    progress("evaluate", 0, 0)
    return recording, evaluate_recording(recording, rule, min_confidence=min_confidence)


def _problem(
    evaluation: RecordedEvaluation,
    unit_index: Sequence[int],
    budget_units: int,
    fusion: Fusion,
    rule: AebRule,
) -> PlacementProblem:
    """Each unit alone on a site of its own."""
    return PlacementProblem(
        table=recorded_table(evaluation),
        limits=Limits(
            site_index=np.array(unit_index),
            site_capacity=np.ones(len(unit_index), dtype=np.int64),
            budget_units=budget_units,
        ),
        fusion=fusion,
        rule=rule,
    )


def _pick(recording: Recording, unit_index: Sequence[int]) -> list[str]:
    return [recording.units[index] for index in unit_index]


def _units(folder_names: Sequence[str]) -> list[dict[str, str]]:
    """Units as records; a recording does not tell where they hang."""
    return [{"id": rsu_name(name), "folder": name} for name in folder_names]


def _summarise(
    recording: Recording, evaluation: RecordedEvaluation, rule: AebRule
) -> dict[str, Any]:
    axis = evaluation.axis
    evaluated = _summarise_evaluation(evaluation, rule)
    return {
        "name": recording.folder.name,
        "recording": str(recording.folder),
        "layout": _units(list(evaluation.units)),
        "budget": None,
        "fusion": "any",
        "runs": axis.n_runs,
        "cases": list(dict.fromkeys(axis.cases)),
        "weathers": list(dict.fromkeys(axis.weathers)),
        "not_driven": [],
        "apr": evaluated["rsu_all"]["all"],
        "bound": None,
        "gap": None,
        "apr_without_worst_unit": evaluated["apr_without_worst_unit"],
        "evaluation": evaluated,
        "detected_share": _of_parties(evaluation, lambda verdict: detected_share(verdict, axis)),
        "drives": _drives(recording, evaluation),
        "frames": {
            "recorded": recording.n_frames,
            "in_drives": axis.n_frames,
            "missing_in_drives": recording.n_missing,
            "several_vrus_in_view": evaluation.n_ambiguous,
        },
        "skipped": dict(recording.skipped),
        "baseline": None,
        "surrogate_disagreement": None,
        "seconds": {},
        "versions": versions(),
    }


def _summarise_evaluation(evaluation: RecordedEvaluation, rule: AebRule) -> dict[str, Any]:
    """The keys of :func:`.summarise_evaluation`; "vut" is None if unrecorded."""
    axis, n_units = evaluation.axis, len(evaluation.units)
    problem = _problem(evaluation, range(n_units), n_units, "any", rule)

    def ratios(verdict: Verdict) -> dict[str, Any]:
        return {"all": apr(verdict, axis), "by_case": apr_by_case(verdict, axis)}

    return {
        **_of_parties(evaluation, ratios),
        "apr_without_worst_unit": apr_one_failed(problem, range(n_units)),
    }


def _of_parties(
    evaluation: RecordedEvaluation, measure: Callable[[Verdict], Any]
) -> dict[str, Any]:
    """Something about every sensing party."""
    vut, together = evaluation.vut, evaluation.vut_and_rsus
    return {
        "vut": None if vut is None else measure(vut),
        "rsu_all": measure(evaluation.rsu_all),
        "vut_and_rsus": None if together is None else measure(together),
        "units": {rsu_name(name): measure(unit) for name, unit in evaluation.units.items()},
    }


def _drives(recording: Recording, evaluation: RecordedEvaluation) -> list[dict[str, Any]]:
    axis = evaluation.axis
    return [
        {
            "run": axis.run_ids[index],
            "case": axis.cases[index],
            "first_frame": drive.first_number,
            "frames": drive.n_frames,
            "missing_frames": drive.n_missing,
            "vut_speed_kmh": float(axis.vut_speed_kmh[index]),
            "vru_speed_kmh": 3.6 * drive.vru_speed_mps,
            "closing_speed_mps": drive.closing_speed_mps,
            "motion": "same direction" if is_longitudinal(drive) else "crossing",
            "last_brake_time_s": float(axis.last_brake_time_s[index]),
            "is_avoided": bool(evaluation.rsu_all.is_avoided[index]),
        }
        for index, drive in enumerate(recording.drives)
    ]


def _finish(
    summary: dict[str, Any],
    out: Path | None,
    progress: StageProgress,
    write_more: Callable[[Path], None] | None = None,
) -> dict[str, Any]:
    if out is None:
        summary["seconds"] = progress.finish()
        return summary
    progress(WRITING, 0, 0)
    with new_result_folder(out) as new:
        if write_more is not None:
            write_more(new)
        summary["seconds"] = progress.finish()
        (new / MARKER).write_text(to_json_text(summary), encoding="utf-8")
    progress.kept = f"the results are in {out}"
    return summary
