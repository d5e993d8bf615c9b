"""A folder of results as an optimisation writes it: six runs, two units, no figures."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_files import as_json

from experiments.jobs import placement, search
from experiments.progress import StageProgress
from geometry.actors import load_actors
from geometry.scene import Scene
from geometry.study_scene import load_study_scene
from placement import candidates as poses
from placement import pipeline
from placement.candidates import CandidateGrid, load_candidate_grid
from placement.compute import Compute
from placement.detectors import load_detector, load_planning_detector
from placement.layout import Layout, load_carlancap_layout
from placement.question import Question, read_cars
from placement.setting import Setting
from scenarios.aeb import load_aeb_rule
from scenarios.cases import pick_cases
from scenarios.runs import build_frame_axis, build_runs
from scenarios.weights import weight_per_run

RUNS = (
    "CPNC-50/east/55",
    "CBNA/east/60",
    "CBLA/east/50",
    "CPNC-50/west/30",
    "CBNA/north/20",
    "CBLA/east/25",
)


def build_small_setting() -> Setting:
    """Six runs of the study's cases at its junction."""
    scene = load_study_scene()
    rule = load_aeb_rule()
    cases = pick_cases("CPNC-50,CBNA,CBLA", "cases")
    runs, _ = build_runs(scene, cases, vut=load_actors()["vut"], rule=rule)
    few = tuple(run for run in runs if run.id in RUNS)
    return Setting(
        scene=scene,
        runs=few,
        axis=build_frame_axis(few, weight_per_run(few)),
        rule=rule,
        detector=load_detector(),
        table_detector=load_planning_detector(),
    )


def build_small_grid(*, is_coarse: bool = False) -> CandidateGrid:
    """One height, four directions."""
    return replace(
        load_candidate_grid(),
        heights_m=np.array([6.0]),
        yaw_step_deg=90.0,
        pitches_deg=np.array([-20.0]),
    )


def build_small_baseline(scene: Scene) -> Layout:
    """The first two units of the study."""
    study = load_carlancap_layout()
    return replace(study, units=study.units[:2])


def assemble_without_runs(question: Question, scene: Scene) -> pipeline.Assembly:
    """An instance of which nobody asks what is detected."""
    nothing: Any = None
    setting = Setting(
        scene=scene,
        runs=(),
        axis=nothing,
        rule=nothing,
        detector=nothing,
        table_detector=nothing,
    )
    return pipeline.assemble(question, setting=setting)


def lay_runs_of(patch: pytest.MonkeyPatch, setting: Setting) -> None:
    """Let every placement, evaluation and comparison have the runs of a setting."""

    def build(question: Question, scene: object, **options: object) -> Setting:
        cars = read_cars(question.cars)
        if cars:
            return replace(setting, cars=cars)
        return setting

    for module in (placement, search, pipeline):
        patch.setattr(module, "build_setting", build)


@contextmanager
def small_world(setting: Setting) -> Iterator[pytest.MonkeyPatch]:
    """Let placements choose among a coarse grid, on the runs of a setting."""
    with pytest.MonkeyPatch.context() as patch:
        lay_runs_of(patch, setting)
        patch.setattr(poses, "load_candidate_grid", build_small_grid)
        patch.setattr(placement, "find_baseline", build_small_baseline)
        yield patch


def place_small(question, out, **compute):
    """Plain result of a placement by two workers."""
    progress = StageProgress()
    result = placement.run_placement(
        question,
        out=out,
        compute=Compute(workers=2, progress=progress, **compute),
        command="place-rsus",
        progress=progress,
    )
    return as_json(result)


def write_small_results(
    folder: Path,
    setting: Setting,
    question: Question | None = None,
    *,
    has_report: bool = False,
) -> None:
    """Choose two cameras of a coarse grid, and write everything, with or without the
    report.
    """

    def write_blank_report(folder: Path, *given: object, **options: object) -> None:
        (folder / "report.html").write_text("<p>no figures</p>")

    with small_world(setting) as patch:
        if not has_report:
            patch.setattr(placement, "write_report", write_blank_report)
        place_small(question or Question(budget=2, time_limit_s=60.0), folder)
