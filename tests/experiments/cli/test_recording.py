"""Recorded drives on the command line: chosen, evaluated, refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_results import answer, refusal

from placement.recordings import WrittenDrive, write_recording

BOX = np.array([100.0, 200.0, 140.0, 300.0])
BESIDE = (
    "got it beside --recording; expected one of them: a recording has units and drives"
    " of its own"
)
KEYS = {
    "layout",
    "budget",
    "fusion",
    "runs",
    "apr",
    "bound",
    "gap",
    "apr_without_worst_unit",
    "evaluation",
    "baseline",
    "surrogate_disagreement",
    "seconds",
    "versions",
    "skipped",
}


@pytest.fixture
def recording(tmp_path):
    """Unit 0 detects in the first half of a drive of 20 frames, unit 1 nowhere, the car
    always.
    """
    n_frames = 20
    share = {
        "0": np.arange(n_frames) < 10,
        "1": np.zeros(n_frames),
        "car": np.ones(n_frames),
    }
    drive = WrittenDrive(
        scenario=3,
        vru_class="bicycle",
        vut_speed_mps=10.0,
        vru_speed_mps=4.0,
        distance_m=2.0 + np.arange(n_frames)[::-1],
        labels_px={unit: np.tile(BOX, (n_frames, 1)) for unit in share},
        detections_px={unit: np.outer(seen, BOX) for unit, seen in share.items()},
        label_distance_m={unit: np.full(n_frames, 20.0) for unit in share},
    )
    write_recording(tmp_path / "ncap_data", [drive])
    return tmp_path / "ncap_data"


def test_a_recording_is_evaluated(run, recording):
    code, out, err = run("evaluate --recording", recording, "--json")
    assert code == 0
    assert err == "read recording ...\nevaluate ...\n"

    summary = json.loads(out, parse_constant=pytest.fail)
    assert set(summary) >= KEYS

    evaluation = summary["evaluation"]
    assert [evaluation[key]["all"] for key in ("vut", "rsu_all", "vut_and_rsus")] == [
        1.0
    ] * 3
    assert [evaluation["units"][unit]["all"] for unit in ("RSU0", "RSU1")] == [1.0, 0.0]
    assert evaluation["units"]["RSU0"]["by_case"] == {"scenario-3-bicycle": 1.0}
    assert summary["detected_share"]["units"] == {"RSU0": 0.5, "RSU1": 0.0}
    assert list(Path().iterdir()) == []


def test_the_best_recorded_unit_is_chosen(ask, recording):
    summary = ask("--budget 1 --recording", recording)
    assert set(summary) >= KEYS | {
        "stages",
        "solver",
        "baseline_name",
        "greedy",
        "candidates",
    }
    assert summary["layout"] == [{"id": "RSU0", "folder": "0"}]
    assert summary["apr"] == 1.0
    assert summary["bound"] == 1.0
    assert summary["gap"] == 0.0
    assert summary["baseline"]["rsu_all"]["all"] == 1.0
    assert list(Path().iterdir()) == []


def test_tables_are_printed(run, recording):
    out = answer(run("evaluate --recording", recording, "--quiet"))
    assert "RSU0" in out
    assert "Skipped: 30 frames between drives (bodies back at their starts)." in out

    out = answer(run("--budget 1 --recording", recording, "--quiet --fusion single"))
    assert out.startswith(
        "Best 1 of 2 recorded units on 1 drives (fusion single): RSU0\n"
    )


@pytest.mark.long
def test_braking_and_confidence_are_heard(run, recording):
    # Unit 0 is confirmed at -1.7 s; 10 / (2 * 2.9) = 1.72 s.
    for arguments, apr in (
        (["--deceleration", 2.9], 0.0),
        (["--deceleration", 3.0], 1.0),
        (["--latency", 1.5], 0.0),
        (["--confirmations", 11], 0.0),
        (["--track-memory", "inf"], 1.0),
        (
            ["--track-memory", 0.4],
            1.0,
        ),  # last seen at -1 s, 0.33 s before the last moment
        (["--track-memory", 0.3], 0.0),
        (["--min-confidence", 1], 1.0),
    ):
        out = answer(
            run("evaluate --recording", recording, "--json --quiet", *arguments)
        )
        assert json.loads(out)["apr"] == apr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("evaluate --layout carlancap-12", f"--layout: {BESIDE}"),
        ("evaluate --cases CBNA", f"--cases: {BESIDE}"),
        ("--budget 1 --cases CBNA", f"--cases: {BESIDE}"),
        ("--budget 1 --no-cache", f"--cache: {BESIDE}"),
        ("--budget 3", "--budget: got 3; expected at most 2, the units recorded"),
        (
            "evaluate --recording a --min-confidence -1",
            "--min-confidence: got '-1'; expected a confidence, 0 to 1",
        ),
    ],
)
def test_what_makes_no_sense_beside_a_recording_is_one_line(
    run, recording, arguments, message
):
    assert refusal(run(arguments, "--recording", recording, "--quiet")) == f"{message}"


def test_a_confidence_needs_a_recording(run):
    for command in ("evaluate --layout carlancap-12", "--budget 1"):
        assert run(command, "--min-confidence 0.5") == (
            2,
            "",
            "place-rsus: --min-confidence: got it without --recording; expected both\n",
        )


def test_a_bad_recording_is_one_line(run, recording):
    (recording / "0/3_4.txt").write_text("pedestrian 1 2 nan 4 5\n")
    for command in (["evaluate"], ["--budget", 1]):
        assert run(*command, "--recording", recording, "--quiet") == (
            2,
            "",
            (
                f"place-rsus: {recording}/0/3_4.txt:1: max_x: got 'nan'; expected a"
                " finite number\n"
            ),
        )
    assert run("evaluate --recording nowhere --quiet") == (
        2,
        "",
        "place-rsus: nowhere: got No such file or directory; expected a recording\n",
    )
