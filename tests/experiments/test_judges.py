"""Programs of others on what this project writes; skipped where they cannot be had.

ETSI's modules are no package: the variable ETSI_ASN1 names their folders, separated by
":".
"""

import importlib.util
import os
from dataclasses import replace
from pathlib import Path

import judging
import numpy as np
import pytest
from json_files import write_json
from judging import NoJudge, prove_with_scip

pytestmark = pytest.mark.judges


@pytest.fixture(scope="module")
def all_runs():
    return judging.lay_all_cases()


def ask(judge, *arguments, **options):
    """Answer of a judge; the test is skipped where it cannot be had."""
    try:
        return judge(*arguments, **options)
    except NoJudge as error:
        pytest.skip(str(error))


def test_asams_checker_finds_no_issue_in_any_case(all_runs, tmp_path):
    said = ask(judging.judge_openscenario, all_runs, tmp_path)
    assert said["issues"] == []
    assert said["n"] == 147
    assert said["checks"] == {"completed": 17 * 147}


def test_asams_checker_finds_an_actor_that_is_nobody(all_runs, tmp_path, monkeypatch):
    write = judging.to_openscenario

    def write_nobody(*given, **options):
        text = write(*given, **options)
        return text.replace(
            '<EntityRef entityRef="vru"', '<EntityRef entityRef="nobody"', 1
        )

    monkeypatch.setattr(judging, "to_openscenario", write_nobody)
    said = ask(judging.judge_openscenario, all_runs[:1], tmp_path)

    assert "Entity not declared" in said["issues"][0]


def test_asams_checker_finds_no_issue_in_roads_but_those_made(tmp_path, monkeypatch):
    said = ask(judging.judge_opendrive, tmp_path)
    assert said["issues"] == []
    assert said["checks"]["completed"] > 0

    write = judging.to_opendrive

    def write_gaps(*given):
        return write(*given).replace('contactPoint="end"', 'contactPoint="start"')

    monkeypatch.setattr(judging, "to_opendrive", write_gaps)

    assert "gaps" in judging.judge_opendrive(tmp_path)["issues"][0]


def test_commonroad_finds_the_impacts_within_a_hundredth_of_a_second(
    all_runs, tmp_path
):
    off_s = ask(judging.judge_impacts, all_runs, tmp_path)
    assert len(off_s) == 100
    assert off_s.max() <= judging.STEP_S + 1.0e-6


def test_commonroad_finds_a_body_that_is_too_long(all_runs, tmp_path):
    run = all_runs[0]
    longer = replace(run.encounter.vut, length_m=run.encounter.vut.length_m + 1.0)
    wrong = replace(run, encounter=replace(run.encounter, vut=longer))
    off_s = ask(judging.judge_impacts, [wrong], tmp_path, n_runs=1)

    assert off_s.max() > judging.STEP_S + 1.0e-6


def test_carlas_classes_turn_cameras_as_ours(tmp_path, monkeypatch):
    assert ask(judging.judge_carla, tmp_path) < 1.0e-4  # of single precision

    write = judging.to_carla
    monkeypatch.setattr(
        judging,
        "to_carla",
        lambda layout: write(layout).replace('"pitch": -', '"pitch": '),
    )
    assert judging.judge_carla(tmp_path) > 1.0e-4


FOLDERS = [
    Path(name) for name in os.environ.get("ETSI_ASN1", "").split(os.pathsep) if name
]


@pytest.mark.skipif(not FOLDERS, reason="ETSI_ASN1 names no folder with ETSI's modules")
def test_etsis_modules_decode_collective_perception_messages_to_what_was_written():
    for folder in FOLDERS:
        is_equal = judging.judge_messages(folder)
        assert len(is_equal) > 100
        assert all(is_equal), folder


needs_scip = pytest.mark.skipif(
    importlib.util.find_spec("pyscipopt") is None, reason="pyscipopt is missing"
)


@needs_scip
def test_scip_proves_the_same_apr_of_the_main_job():
    found = prove_with_scip()
    assert found.is_same, found


@pytest.fixture
def one_unit(tmp_path):
    """Every 20th run of the main job with one unit, and its APR by trying each pose."""
    with np.load("results/budget-3/instance.npz") as file:
        whole = dict(file)
    runs = np.arange(0, len(whole["weight"]), 20)
    spans = [np.arange(*whole["run_start"][run : run + 2]) for run in runs]
    frames = np.concatenate(spans)
    sees = np.unpackbits(whole["packed"], axis=1, bitorder="little")[:, frames].astype(
        bool
    )
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
        first = part["run_start"][index]
        time_s = whole["time_s"][spans[index]]
        timely = np.flatnonzero(time_s <= moment_s + 1e-6)
        for pose in range(len(sees)):
            # In words: three frames in a row, then never more than a second without
            # one.
            seen = timely[sees[pose, first + timely]]
            is_third = np.isin(seen - 1, seen) & np.isin(seen - 2, seen)
            if not is_third.any():
                continue
            ends = np.append(time_s[seen], moment_s)
            late = np.flatnonzero(np.diff(ends) > 1.0 + 1e-6)
            if len(late):
                alive = is_third[late[-1] + 1 :]
            else:
                alive = is_third
            apr[pose] += weight[index] * alive.any()
    np.savez(tmp_path / "instance.npz", **part)
    return tmp_path, float(apr.max())


@needs_scip
@pytest.mark.parametrize("off", [0.0, 0.001])
@pytest.mark.parametrize("gives_up", [False, True])
def test_scip_agrees_with_trying_each_pose_and_with_nothing_else(
    one_unit, off, gives_up
):
    folder, apr = one_unit
    proof = {"stages": [{"objective": apr + off, "bound": apr + off}]}
    if gives_up:
        answer = {"stages": [], "highest": proof}
    else:
        answer = proof | {"highest": None}
    write_json((folder / "summary.json"), answer)

    assert prove_with_scip(folder).is_same == (off == 0.0)
