"""``place-rsus verify``: what an optimisation has written, checked without the
optimiser.
"""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import lanelet_text
import numpy as np
import opendrive_text
import pytest
from command_results import answer, refusal
from json_files import change_json, read_json
from osm_text import LAT_DEG, LON_DEG, OsmText
from osm_text import crossing as crossing_streets
from small_results import lay_runs_of, place_small

from experiments.cli import first_answer
from experiments.jobs import placement, search
from experiments.results.record import to_plain
from geometry.errors import InputError
from geometry.scene_files import pack_scene, save_scene
from geometry.scene_sources import load_scene
from geometry.study_scene import load_study_scene
from placement.proof_files import save_problem, scene_hash
from placement.question import Question
from placement.verification.instances import load_problem, load_stored_problem


@pytest.fixture(scope="module")
def written(small_setting, tmp_path_factory):
    """The result folder of a small optimisation, without its figures."""
    folder = tmp_path_factory.mktemp("placed") / "results"
    with pytest.MonkeyPatch.context() as patch:
        lay_runs_of(patch, small_setting)
        patch.setattr(placement, "write_report", lambda *given, **options: None)
        asked = {"budget": 2, "give_up": 0.0, "time_limit_s": 60.0}
        place_small(Question(within="carlancap-12", **asked), folder)
    return folder


@pytest.fixture
def results(written, tmp_path):
    """A copy of it to spoil."""
    return Path(shutil.copytree(written, tmp_path / "results"))


@pytest.mark.long
def test_what_was_written_is_verified_in_a_line_per_check(run, results):
    out = answer(run("verify", results, "--quiet"))
    assert max(map(len, out.splitlines())) <= 80 + len(str(results))

    checks = [line for line in out.splitlines() if line.startswith("  OK ")]
    left_out = "Not checked: verdicts, bill, report (--deep), who made it (--key)."

    assert out.splitlines()[-1] == f"{len(checks)} checks: all OK. {left_out}"
    assert "FAILED" not in out
    for words in (
        "instance: SHA-256",
        "apr: recomputed",
        "layout file: it shows the same 2 units",
    ):
        assert f"  OK     {words}" in out
    assert "Proven again, without a solver:\n  apr: " in out
    assert "Not checked here:\n  whether the detection table is right" in out


def test_json_says_the_same(ask, results):
    summary = ask("verify", results)
    assert summary["is_verified"]
    assert all(check["passed"] for check in summary["checks"])
    assert [stage["name"] for stage in summary["stages"]] == [
        "apr",
        "apr_one_failed",
        "smallest_margin_s",
        "mean_margin_s",
        "cost_eur",
    ]
    assert all(stage["is_proven_again"] for stage in summary["stages"])
    assert not any("rests on" in line for line in summary["not_checked"])

    written = read_json(results / "summary.json")
    assert summary["solver"] == written["solver"]
    assert [stage["objective"] for stage in summary["stages"]] == [
        stage["objective"] for stage in written["stages"]
    ]


@pytest.mark.long
def test_what_was_changed_fails_with_exit_code_1(run, results):
    def move(document):
        document["layout"][0]["yaw_deg"] += 1.0

    change_json(results / "layout.json", move)
    code, out, err = run("verify", results, "--quiet")

    assert code == 1
    assert err == ""
    assert "  FAILED layout file: it does not show the certificate's units" in out
    assert "  FAILED file layout.json: changed, says SHA256SUMS" in out
    assert "  FAILED layout.csv: another layout than layout.json" in out
    assert " checks: 5 FAILED. Not checked: " in out.splitlines()[-1]

    code, out, err = run("verify", results, "--quiet --json")
    assert code == 1
    assert err == ""
    assert not json.loads(out)["is_verified"]


def test_a_solver_that_lied_is_told(run, results):
    def lie(document):
        for stage in document["stages"]:
            stage |= {"objective": stage["objective"] / 2, "bound": stage["bound"] / 2}

    change_json(results / "certificate.json", lie)
    code, out, _ = run("verify", results, "--quiet")

    assert code == 1
    assert "  FAILED apr: recomputed 1, claimed 0.5" in out
    assert "disproved" not in out.partition("Not checked here")[2]


def test_another_instance_is_told(run, results):
    problem = load_problem(results / "instance.npz")
    packed = problem.table.packed.copy()
    packed[0, 0] ^= np.uint8(1)
    table = replace(problem.table, packed=packed)
    save_problem(results / "instance.npz", replace(problem, table=table))
    code, out, _ = run("verify", results, "--quiet")

    assert code == 1
    assert "  FAILED instance: SHA-256 " in out


def test_proofs_that_rest_on_the_solver_are_said_to(run, results, monkeypatch):
    monkeypatch.setattr("placement.verification.verify._MAX_LOOKS", 0)
    out = answer(run("verify", results, "--quiet"))
    assert "that no layout is better in mean_margin_s: this rests on" in out


@pytest.mark.parametrize("name", ["certificate.json", "instance.npz", "layout.json"])
def test_a_file_that_is_missing_or_damaged_is_named(run, results, name):
    path = results / name
    path.write_bytes(path.read_bytes()[:100])
    assert refusal(run("verify", results, "--quiet")).startswith(f"{path}: got ")

    path.unlink()
    assert refusal(run("verify", results, "--quiet")).startswith(
        f"{path}: got No such file or directory; expected "
    )


def test_a_folder_that_is_none_is_refused(run, tmp_path):
    for folder in (tmp_path / "none", __file__):
        line = refusal(run("verify", folder))
        assert line.endswith(f"{folder}: got no folder; expected a folder with results")


def test_a_folder_that_does_not_say_what_was_asked_cannot_be_made_anew(run, results):
    change_json(results / "summary.json", lambda d: d.pop("asked"))
    line = refusal(run("verify", results, "--deep --quiet"))

    assert "--deep: got " in line
    assert (
        "which does not say what was asked; expected a placement of this version"
        in line
    )


@pytest.mark.long
def test_a_network_that_a_folder_names_is_not_run(run, results):
    change_json(
        results / "summary.json",
        lambda d: d["asked"]["question"].update(detector="x.onnx"),
    )
    assert (
        "summary.json: asked: detector: got 'x.onnx'; expected no network, which is"
        in refusal(run("verify", results, "--deep --quiet"))
    )


# ---------- the scene that a result was made with
FOUR = [
    (1.0, 0.0),
    (0.0, 1.0),
    (-1.0, 0.0),
    (0.0, -1.0),
]


def street_map(folder):
    """A crossing in OpenStreetMap."""
    osm = OsmText()
    crossing_streets(osm, bearings=FOUR, highway="residential", lanes="2")
    return osm.write(folder)


def road_map(folder):
    """A crossing in OpenDRIVE."""
    (folder / "roads.xodr").write_text(
        opendrive_text.document(opendrive_text.crossing())
    )
    return folder / "roads.xodr"


def lane_map(folder):
    """A crossing of lanelets."""
    (folder / "lanes.osm").write_text(lanelet_text.lanelet2(lanelet_text.crossing()))
    return folder / "lanes.osm"


def scene_folder(folder):
    """The study's junction as a folder."""
    (folder / "scene").mkdir()
    save_scene(folder / "scene", load_study_scene())
    return folder / "scene"


def scene_archive(folder):
    """The study's junction as an archive."""
    pack_scene(scene_folder(folder), folder / "scene.zip")
    return folder / "scene.zip"


SCENES = {
    "a map": (street_map, []),
    "a junction of a map by its streets": (
        street_map,
        ["--junction", "Street 2 / Street 0"],
    ),
    "a junction of a map at a point": (street_map, ["--at", f"{LON_DEG},{LAT_DEG}"]),
    "a map with sites of its own": (street_map, ["--sites", "kerb:30"]),
    "a map of a country that keeps left": (street_map, ["--driving-side", "left"]),
    "OpenDRIVE": (road_map, []),
    "Lanelet2": (lane_map, []),
    "a folder": (scene_folder, []),
    "an archive": (scene_archive, []),
}


@pytest.mark.long
@pytest.mark.parametrize(
    "kind",
    SCENES,
)
def test_the_scene_is_read_as_the_job_read_it(
    kind, run, results, tmp_path, monkeypatch
):
    """Also where the map has moved since, and without its options being said again."""
    build, options = SCENES[kind]
    solved = []

    def stop(question, **given):
        solved.append(load_scene(question.scene))
        told = placement.build_asked_record(
            given["asked"], given["compute"], given["command"]
        )
        change_json(results / "summary.json", lambda d: d.update(asked=to_plain(told)))
        raise InputError("here", "the question", "nothing more")

    monkeypatch.setattr("experiments.scene.run._pictures", lambda scene: {})
    monkeypatch.setattr(search, "search", lambda *given, **more: None)
    monkeypatch.setattr(first_answer, "first_answer", lambda found: [])
    monkeypatch.setattr(placement, "run_placement", stop)
    monkeypatch.setenv("PLACE_RSUS_CACHE", str(tmp_path / "cache"))
    source = build(tmp_path)

    assert run("--scene", source, *options, "--budget 2 --quiet")[0] == 2

    problem, mounts = load_stored_problem(results / "instance.npz")
    (scene,) = solved
    stored = replace(mounts, scene_sha256=scene_hash(scene), scene_name=scene.name)
    save_problem(results / "instance.npz", problem, stored)
    (tmp_path / "elsewhere").mkdir()
    moved = source.rename(tmp_path / "elsewhere" / f"moved-{source.name}")
    monkeypatch.setenv("PLACE_RSUS_CACHE", str(tmp_path / "other cache"))
    _, out, _ = run("verify", results, "--scene", moved, "--quiet --json")
    details = {one["name"]: one["detail"] for one in json.loads(out)["checks"]}
    found = details["scene as it stands"]

    # The poses are the study's, and not at the sites of this scene: that is told of the
    # right one.
    assert "may have changed" not in found
    assert "is not where the others of" in found or found.endswith(
        "poses are at its sites"
    )


@pytest.mark.long
@pytest.mark.parametrize("kind", SCENES)
def test_a_result_of_any_scene_is_verified_with_it(kind, run, tmp_path, monkeypatch):
    build, options = SCENES[kind]
    monkeypatch.setattr("experiments.scene.run._pictures", lambda scene: {})
    monkeypatch.setattr(placement, "write_report", lambda *given, **options: None)
    monkeypatch.setenv("PLACE_RSUS_CACHE", str(tmp_path / "cache"))
    source = build(tmp_path)
    few = "--cases CBLA,CPLA-25 --speeds 50 --yaw-step 90 --heights 6"
    answer(
        run(
            "--scene",
            source,
            *options,
            "--budget 1",
            few,
            "--out",
            tmp_path / "r",
            "--quiet",
        )
    )
    code, out, err = run("verify", tmp_path / "r", "--scene", source, "--quiet")

    assert (code, err) == (0, ""), out
    assert "  OK     scene as it stands: SHA-256 " in out
