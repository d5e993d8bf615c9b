"""A small version of the study: the same steps in a second or two."""

from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from experiments.cli import main
from experiments.jobs import placement, writing
from experiments.report import section
from geometry.poses import Pose
from geometry.scene_files import load_study_scene
from placement import planning
from placement.candidates import CandidatePose, load_candidate_grid
from placement.detectors import load_detector, load_planning_detector
from placement.layout import Layout
from placement.setting import Setting
from scenarios.exposure import weight_per_run
from scenarios.runs import build_frame_axis

SMALL_RUNS = (
    "CPNC-50/east/55",
    "CBNA/east/60",
    "CBLA/east/50",
    "CPNC-50/west/30",
    "CBNA/north/20",
    "CBLA/east/25",
)


@pytest.fixture(scope="session")
def small_setting(runs, rule):
    few = tuple(run for run in runs if run.id in SMALL_RUNS)
    return Setting(
        scene=load_study_scene(),
        runs=few,
        axis=build_frame_axis(few, weight_per_run(few)),
        rule=rule,
        detector=load_detector(),
        planner=load_planning_detector(),
    )


@pytest.fixture
def small_study(small_setting, monkeypatch):
    """Makes every command work on a few runs and a few poses."""
    grid = replace(
        load_candidate_grid(),
        heights_m=np.array([6.0]),
        yaw_step_deg=90.0,
        pitches_deg=np.array([-20.0]),
    )
    monkeypatch.setattr(placement, "build_setting", lambda question, scene: small_setting)
    monkeypatch.setattr(planning, "load_candidate_grid", lambda: grid)
    return small_setting


@pytest.fixture
def without_figures(monkeypatch):
    """Leaves out what takes longest to write."""
    monkeypatch.setattr(writing, "write_report", lambda *given, **options: None)


@pytest.fixture
def with_blank_pictures(monkeypatch):
    """Pictures of a report are one pixel each: drawing takes long, and tests of words need none."""
    file = BytesIO()
    Image.new("RGB", (1, 1)).save(file, format="png")
    monkeypatch.setattr(section, "to_png", lambda drawn: file.getvalue())


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Runs a command in an empty folder: exit code, stdout, stderr."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv("PLACE_RSUS_CACHE", str(tmp_path / "cache"))

    def run_command(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main.main([str(argument) for argument in arguments])
        code = ended.value.code
        assert isinstance(code, int)
        return code, *capsys.readouterr()

    return run_command


@pytest.fixture
def layout(camera):
    """Two units with numbers that no short decimal equals, and one at the origin."""
    poses = (
        Pose(position_m=[-115.1 / 3.0, 8.7 / 7.0, 7.0], yaw_deg=100.0 / 3.0, pitch_deg=-20.0 / 3.0),
        Pose(position_m=[0.1 + 0.2, -1.0e-7, 5.5], yaw_deg=180.0, pitch_deg=-90.0),
        Pose(position_m=[0.0, 0.0, 6.0], yaw_deg=0.0, pitch_deg=0.0),
    )
    return Layout(
        name='two, "quoted"',
        units=tuple(
            CandidatePose(id=f"pole, {index}/ü", site_id=f"site-{index}", pose=pose, sensor=camera)
            for index, pose in enumerate(poses)
        ),
    )
