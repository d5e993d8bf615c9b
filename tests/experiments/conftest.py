"""A small version of the study: the same steps in a second or two."""

import json
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from browser_pages import start_browser
from command_results import answer
from interactive_pages import build_evaluation, build_layout
from json_files import read_json, write_json
from once import make_once
from partial_pages import blank_pictures
from small_results import (
    build_small_baseline,
    build_small_grid,
    build_small_setting,
    lay_runs_of,
)

from experiments import main
from experiments.figures.views import GroundViews
from experiments.jobs import placement
from experiments.parts import baselines
from experiments.parts.player import interactive_part
from geometry.poses import Pose
from placement import candidates as poses
from placement import pipeline
from placement.candidates import CandidatePose
from placement.layout import Layout

FEW_WORLDS = 2
"""That choose between the layout found and greedy choice's, and judge layouts, in place
of 60.
"""


@pytest.fixture(scope="session")
def small_setting():
    """Six runs of the study's cases at its junction."""
    return build_small_setting()


@pytest.fixture(scope="session")
def tables(tmp_path_factory):
    """The cache of detection tables, which most tests share."""
    return tmp_path_factory.mktemp("tables")


@pytest.fixture
def few_runs(small_setting, tables, monkeypatch):
    """Makes every command work on a few runs and a few poses."""
    monkeypatch.setenv("PLACE_RSUS_CACHE", str(tables))
    lay_runs_of(monkeypatch, small_setting)
    monkeypatch.setattr(pipeline, "N_JUDGED", FEW_WORLDS)
    monkeypatch.setattr(placement, "MIN_FRESH_WORLDS", FEW_WORLDS)
    monkeypatch.setattr(poses, "load_candidate_grid", build_small_grid)
    monkeypatch.setattr(baselines, "load_candidate_grid", build_small_grid)
    return small_setting


@pytest.fixture
def small_study(few_runs, with_blank_pictures, monkeypatch):
    """As `few_runs`; compares with two units, no figures."""
    monkeypatch.setattr(placement, "find_baseline", build_small_baseline)
    return few_runs


@pytest.fixture(scope="session")
def whole_placement(small_setting, tmp_path_factory):
    """Where two units were placed, with report and figures: results, what was said and
    told.
    """

    def place(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch, chdir(folder):
            patch.setenv("PLACE_RSUS_CACHE", str(folder / "tables"))
            lay_runs_of(patch, small_setting)
            patch.setattr(poses, "load_candidate_grid", build_small_grid)
            with (
                Path("out").open("w") as out,
                Path("err").open("w") as err,
                redirect_stdout(out),
                redirect_stderr(err),
                pytest.raises(SystemExit) as ended,
            ):
                main.main(["--budget", "2", "--json", "--workers", "2"])
        assert ended.value.code == 0

    return make_once(tmp_path_factory, "whole-placement", place)


@pytest.fixture(scope="session")
def part_of_many(small_setting, tmp_path_factory):
    """The report's interactive part with 200 units.

    What one sees of the ground takes long: four each look from the same place.
    """

    def build(folder: Path) -> None:
        layout = build_layout(50)
        units = [replace(layout.units[i % 50], id=f"unit {i + 1}") for i in range(200)]
        evaluation = build_evaluation(
            small_setting, replace(layout, units=tuple(units)), with_vam=True
        )
        shapes = [GroundViews(small_setting).shape(unit) for unit in layout.units]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                GroundViews, "shape", lambda self, unit: shapes[units.index(unit) % 50]
            )
            part = interactive_part(small_setting, {"many": evaluation})
        write_json((folder / "part.json"), part)

    folder = make_once(tmp_path_factory, "part-of-many", build)
    return read_json(folder / "part.json")


@pytest.fixture(scope="module")
def browser():
    """Chromium, where there is one."""
    with start_browser() as opened:
        yield opened


@pytest.fixture
def own_cache(run, few_runs, tmp_path, monkeypatch):
    """An empty cache, for commands that are run."""
    monkeypatch.setenv("PLACE_RSUS_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def without_figures(monkeypatch):
    """Leaves out what takes longest to write."""
    monkeypatch.setattr(placement, "write_report", lambda *given, **options: None)


@pytest.fixture
def with_blank_pictures():
    """Pictures of a report are blank: drawing takes long, and tests of words need
    none.
    """
    with blank_pictures():
        yield


@pytest.fixture
def run(capsys, tables, tmp_path, monkeypatch):
    """Runs a command in an empty folder: exit code, stdout, stderr.

    The first words, and options with their values, may stand in one text.
    """
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv("PLACE_RSUS_CACHE", str(tables))

    def run_command(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        words = []
        for one in arguments:
            is_line = isinstance(one, str) and (one.startswith("--") or not words)
            words += one.split() if is_line else [str(one)]
        with pytest.raises(SystemExit) as ended:
            main.main(words)
        code = ended.value.code
        assert isinstance(code, int)
        return code, *capsys.readouterr()

    return run_command


@pytest.fixture
def ask(run):
    """Runs a command that succeeds: the object that it prints."""

    def ask_command(*arguments: object) -> Any:
        text = answer(run(*arguments, "--json --quiet"))
        return json.loads(text, parse_constant=pytest.fail)

    return ask_command


@pytest.fixture
def layout(camera):
    """Two units with numbers that no short decimal equals, and one at the origin."""
    poses = (
        Pose(
            position_m=[-115.1 / 3.0, 8.7 / 7.0, 7.0],
            yaw_deg=100.0 / 3.0,
            pitch_deg=-20.0 / 3.0,
        ),
        Pose(position_m=[0.1 + 0.2, -1.0e-7, 5.5], yaw_deg=180.0, pitch_deg=-90.0),
        Pose(position_m=[0.0, 0.0, 6.0], yaw_deg=0.0, pitch_deg=0.0),
    )
    return Layout(
        name='two, "quoted"',
        units=tuple(
            CandidatePose(
                id=f"pole, {index}/ü",
                site_id=f"site-{index}",
                pose=pose,
                sensor=camera,
            )
            for index, pose in enumerate(poses)
        ),
    )
