"""Layouts on the study's cases, beside the question that was asked."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from geometry.arrays import BoolArray, IntArray
from geometry.catalogue import sensor_kind
from placement.compute import Compute
from placement.detectors.box_rule import GeometricDetector
from placement.evaluation import Evaluation, Verdict
from placement.evaluator import evaluate_layouts
from placement.evaluator.evaluate import Judge
from placement.question import Question
from placement.setting import Links, Setting
from scenarios.runs import Run

from ..results.baselines import StudyCasesRecord, build_study_cases_record

STAGE = "study's cases"


def study_question(question: Question) -> Question:
    """The same question about what the study drives, read as the study does.

    That is its cases by day, at the junction alone, all speeds and approaches, each run alike; a
    track that is confirmed once lives for ever. Scene, sensors, detector, links and all else stay
    as they were asked for.
    """
    return replace(
        question,
        cases="study",
        along_arms="",
        speeds="",
        approaches="",
        weather="day",
        weights="",
        force=False,
        strict=False,
        track_memory_s=math.inf,
    )


def on_study_cases(
    asked: Setting,
    study: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    compute: Compute,
) -> StudyCasesRecord | None:
    """What layouts prevent in the study's cases; None where these are what was asked about.

    Parameters
    ----------
    asked : Setting
        What the layouts were evaluated in.
    study : Setting
        The study's cases, see :func:`study_question`.
    evaluations : mapping of str to Evaluation
        By display name. Where the same frames were looked at there, nobody looks again.
    compute : Compute
        Of further evaluations.
    """
    if is_same_question(asked, study):
        return None
    rows = _same_runs(asked, study)
    if rows is not None and not _depends_on_chance(asked, evaluations):
        judge = Judge(study.runs, study.axis, study.rule)
        found = [judge_again(item, rows, study, judge) for item in evaluations.values()]
    else:
        layouts = [item.layout for item in evaluations.values()]
        found = evaluate_layouts(layouts, study, compute=compute.within(STAGE))
    return build_study_cases_record(dict(zip(evaluations, found, strict=True)))


def is_same_question(one: Setting, other: Setting) -> bool:
    """Whether the same runs count the same, and are avoided by the same rule."""
    return (
        one.axis.run_ids == other.axis.run_ids
        and np.allclose(one.axis.weight, other.axis.weight, rtol=1.0e-9, atol=0.0)
        and one.rule == other.rule
    )


def judge_again(evaluation: Evaluation, rows: IntArray, part: Setting, judge: Judge) -> Evaluation:
    """An evaluation on some of its runs, by another braking rule.

    `rows` are the runs of `part` among those evaluated. What was detected stays as it is.
    """
    frames = np.concatenate(
        [np.arange(evaluation.axis.n_frames)[evaluation.axis.frames_of(row)] for row in rows]
    )

    def detected(verdict: Verdict) -> BoolArray:
        return verdict.detected[frames]

    units = {
        unit.id: (detected(evaluation.units[unit.id]), unit.latency(part.rule))
        for unit in evaluation.layout.units
    }
    vut = (detected(evaluation.vut), part.rule.latency_s)
    return Evaluation(
        layout=evaluation.layout,
        axis=part.axis,
        vut=judge.verdict([vut]),
        units={name: judge.verdict([party]) for name, party in units.items()},
        rsu_all=judge.verdict([*units.values()]),
        vut_and_rsus=judge.verdict([*units.values(), vut]),
    )


def _same_runs(asked: Setting, study: Setting) -> IntArray | None:
    """Rows of the study's runs among those asked about, (n_runs,); None if one is not there."""
    index = {run.id: row for row, run in enumerate(asked.runs)}
    rows = [index.get(run.id, -1) for run in study.runs]
    if any(
        row < 0 or not _is_same_drive(asked.runs[row], run)
        for row, run in zip(rows, study.runs, strict=True)
    ):
        return None
    return np.array(rows, dtype=np.int64)


def _is_same_drive(one: Run, other: Run) -> bool:
    """Whether two runs look the same, frame by frame."""
    return (
        one.weather == other.weather
        and len(one.obstruction) == len(other.obstruction)
        and np.array_equal(one.time_s, other.time_s)
        and np.array_equal(one.vut_position_m, other.vut_position_m)
        and np.array_equal(one.vru_position_m, other.vru_position_m)
    )


def _depends_on_chance(setting: Setting, evaluations: Mapping[str, Evaluation]) -> bool:
    """Whether what is seen in a frame depends on which other frames there are: on random draws."""
    sensors = [unit.sensor for item in evaluations.values() for unit in item.layout.units]
    return not (
        isinstance(setting.detector, GeometricDetector)
        and setting.links == Links()
        and setting.vut_sensors == ("camera",)
        and all(sensor_kind(sensor) == "camera" for sensor in sensors)
    )
