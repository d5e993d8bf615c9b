"""Programs of others on what this project writes; skipped where they cannot be had."""

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import carla_recordings
import carla_server
import numpy as np
import pytest

from experiments.export import carla, carla_run, opendrive, openlabel, openscenario
from experiments.export.watched import find_run
from experiments.study import judges
from geometry.errors import MissingExtraError

pytestmark = pytest.mark.judges


@pytest.fixture(scope="module")
def all_runs():
    return judges.lay_all_cases()


def ask(judge, *arguments, **options):
    try:
        return judge(*arguments, **options)
    except MissingExtraError as error:
        pytest.skip(str(error))


def test_asams_checker_finds_no_issue_in_any_case(all_runs):
    found = ask(judges.judge_openscenario, all_runs)
    assert found.is_passed, found
    assert "147 cases" in found.checked
    assert re.search(r"2,?499 completed", found.checked)  # 17 checks of each


def test_asams_checker_finds_an_actor_that_is_nobody(all_runs, monkeypatch):
    write = openscenario.to_openscenario
    monkeypatch.setattr(
        openscenario,
        "to_openscenario",
        lambda *given, **options: write(*given, **options).replace(
            '<EntityRef entityRef="vru"', '<EntityRef entityRef="nobody"', 1
        ),
    )
    found = ask(judges.judge_openscenario, all_runs[:1])
    assert not found.is_passed
    assert "Entity not declared" in found.result


def test_asams_checker_finds_no_issue_in_roads_but_those_made(monkeypatch):
    found = ask(judges.judge_opendrive)
    assert found.is_passed, found
    write = opendrive.to_opendrive
    monkeypatch.setattr(
        opendrive,
        "to_opendrive",
        lambda *given: write(*given).replace('contactPoint="end"', 'contactPoint="start"'),
    )
    found = judges.judge_opendrive()
    assert not found.is_passed
    assert "gaps" in found.result


def test_commonroad_finds_the_impacts_within_a_hundredth_of_a_second(all_runs):
    found = ask(judges.judge_impacts, all_runs)
    assert found.is_passed, found


def test_commonroad_finds_a_body_that_is_too_long(all_runs):
    run = all_runs[0]
    longer = replace(run.encounter.vut, length_m=run.encounter.vut.length_m + 1.0)
    wrong = replace(run, encounter=replace(run.encounter, vut=longer))
    assert not ask(judges.judge_impacts, [wrong], n_runs=1).is_passed


@pytest.mark.skipif(
    importlib.util.find_spec("openlabel_checker") is None, reason="openlabel-checker is missing"
)
def test_openlabel_checker_finds_no_issue_but_those_made(monkeypatch):
    assert judges.judge_openlabel().is_passed
    write = openlabel.to_openlabel
    monkeypatch.setattr(
        openlabel, "to_openlabel", lambda layout: write(layout).replace('"sensor_cs"', "7")
    )
    assert not judges.judge_openlabel().is_passed


def test_carlas_classes_turn_cameras_as_ours(monkeypatch):
    assert ask(judges.judge_carla).is_passed
    write = carla.to_carla
    monkeypatch.setattr(
        carla, "to_carla", lambda layout: write(layout).replace('"pitch": -', '"pitch": ')
    )
    assert not judges.judge_carla().is_passed


def test_the_script_for_carla_runs_on_its_package(tmp_path):
    """CARLA's own values and names; a server that stands in, for there is none."""
    uv = shutil.which("uv")
    blueprint = "walker.pedestrian.0005"
    run = find_run(carla_recordings.RUNS[blueprint], carla_recordings.SCENE)
    script, out = tmp_path / "drive.py", tmp_path / "recording"
    text = carla_run.to_carla_run(carla_recordings.TWO, carla_recordings.SCENE, run)
    script.write_text(text, encoding="utf-8")
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    base = [uv, "run", "--quiet", "--isolated", "--no-project", "--python", python]
    base += ["--with", *judges.APART["carla"], "--with", "numpy", "python"]
    if uv is None or subprocess.run([*base, "-c", ""], check=False).returncode:
        pytest.skip("uv cannot make an environment with carla")
    server = Path(carla_server.__file__)
    done = subprocess.run(
        [*base, str(server), str(script), str(out)], capture_output=True, check=True, text=True
    )
    answer = json.loads(done.stdout)
    assert answer["missing"] == []
    assert answer["tags"] == {"Pedestrians": 12, "Rider": 13, "Bicycle": 19}
    assert answer["off"] < 1e-6  # of single precision
    assert answer["log"] == [[True, 0.1], [False, None]]
    carla_recordings.compare(out, run, blueprint)


needs_scip = pytest.mark.skipif(
    importlib.util.find_spec("pyscipopt") is None, reason="pyscipopt is missing"
)


@needs_scip
def test_scip_proves_the_same_apr_of_the_main_job():
    found = judges.judge_proof()
    assert found.is_passed, found


@pytest.fixture
def one_unit(tmp_path):
    """Every 20th run of the main job with one unit, and its APR by trying each pose."""
    with np.load("results/budget-3/instance.npz") as file:
        whole = dict(file)
    runs = np.arange(0, len(whole["weight"]), 20)
    spans = [np.arange(*whole["run_start"][run : run + 2]) for run in runs]
    frames = np.concatenate(spans)
    sees = np.unpackbits(whole["packed"], axis=1, bitorder="little")[:, frames].astype(bool)
    weight = whole["weight"][runs] / whole["weight"][runs].sum()
    part = whole | {
        "packed": np.packbits(sees, axis=1, bitorder="little"),
        "time_s": whole["time_s"][frames],
        "run_start": np.cumsum([0, *map(len, spans)]),
        "weight": weight,
        "last_brake_time_s": whole["last_brake_time_s"][runs],
        "budget_units": np.array(1),
    }
    apr = np.zeros(len(sees))
    for index, run in enumerate(runs):
        moment_s = whole["last_brake_time_s"][run] - 0.025
        first, time_s = part["run_start"][index], whole["time_s"][spans[index]]
        timely = np.flatnonzero(time_s <= moment_s + 1e-6)
        for pose in range(len(sees)):
            # In words: three frames in a row, then never more than a second without one.
            seen = timely[sees[pose, first + timely]]
            is_third = np.isin(seen - 1, seen) & np.isin(seen - 2, seen)
            if not is_third.any():
                continue
            ends = np.append(time_s[seen], moment_s)
            late = np.flatnonzero(np.diff(ends) > 1.0 + 1e-6)
            alive = is_third[late[-1] + 1 :] if len(late) else is_third
            apr[pose] += weight[index] * alive.any()
    np.savez(tmp_path / "instance.npz", **part)
    return tmp_path, float(apr.max())


@needs_scip
@pytest.mark.parametrize("off", [0.0, 0.001])
@pytest.mark.parametrize("gives_up", [False, True])
def test_scip_agrees_with_trying_each_pose_and_with_nothing_else(one_unit, off, gives_up):
    folder, apr = one_unit
    proof = {"stages": [{"objective": apr + off, "bound": apr + off}]}
    answer = {"stages": [], "highest": proof} if gives_up else proof | {"highest": None}
    (folder / "summary.json").write_text(json.dumps(answer), encoding="utf-8")
    assert judges.judge_proof(folder).is_passed == (off == 0.0)
