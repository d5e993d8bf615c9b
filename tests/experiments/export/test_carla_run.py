"""Runs as scripts for CARLA, driven by a server that stands in for it."""

import runpy
import sys
from dataclasses import replace

import carla_server
import numpy as np
import pytest
from carla_recordings import RUNS, SCENE, STUDY, TWO, compare
from export_layouts import level_layout
from short_runs import cut_run

from experiments.export.carla import carla_points, to_carla
from experiments.export.carla_run import build_scenario, to_carla_run
from experiments.export.watched import find_run
from geometry.catalogue import load_cameras
from geometry.errors import InputError
from placement.layout import Layout


def drive(script, tmp_path, monkeypatch, *arguments):
    path, out = tmp_path / "drive.py", tmp_path / "recording"
    path.write_text(script, encoding="utf-8")
    carla_server.Client.worlds.clear()
    monkeypatch.setitem(sys.modules, "carla", carla_server.as_module())
    monkeypatch.setattr(sys, "argv", [str(path), "--out", str(out), *arguments])
    runpy.run_path(str(path), run_name="__main__")
    (world,) = carla_server.Client.worlds
    return out, world


def end_of(run, n_frames=16):
    """Its last frames: the server draws millions of pixels in each."""
    return cut_run(run, slice(-n_frames, None))


@pytest.mark.parametrize("blueprint", RUNS)
def test_a_script_records_the_run_that_it_was_made_from(blueprint, tmp_path, monkeypatch):
    run = end_of(find_run(RUNS[blueprint], SCENE))
    if "0048" in blueprint and run.encounter.vru.name != "child":
        pytest.fail("the case has no child any more")
    out, world = drive(to_carla_run(TWO, SCENE, run), tmp_path, monkeypatch, "--map", "Town05")
    compare(out, run, blueprint)
    assert world.log == [(True, 0.1), (False, None)]  # as it was before
    assert world.actors == []
    n_bodies = 2 + len(run.obstruction)
    assert len(build_scenario(TWO, SCENE, run)["bodies"]) == n_bodies
    assert world.frame == 100 + 10 + len(run.time_s)
    assert (out / "0" / "0_0.png").read_bytes() == b"picture"


def test_a_server_that_fails_gets_its_settings_back(tmp_path, monkeypatch):
    run = find_run("CPNC-50/east/40", SCENE)
    monkeypatch.setattr(carla_server.World, "draw", lambda *_given: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        drive(to_carla_run(TWO, SCENE, run), tmp_path, monkeypatch)
    (world,) = carla_server.Client.worlds
    assert world.log == [(True, 0.1), (False, None)]
    assert world.actors == []


def test_a_folder_that_is_not_empty_is_refused(tmp_path, monkeypatch):
    (tmp_path / "recording").mkdir()
    (tmp_path / "recording" / "old").write_text("")
    run = end_of(find_run("CPNC-50/east/40", SCENE))
    with pytest.raises(SystemExit, match="got a folder that is not empty; expected a new one"):
        drive(to_carla_run(TWO, SCENE, run), tmp_path, monkeypatch)


@pytest.mark.parametrize(
    ("layout", "run_id", "told"),
    [
        (level_layout(0.0, kind="lidar"), "CPNC-50/east/40", "a layout of LiDARs only"),
        (TWO, "CMCscp-near/north/30x50", "a road user by motorcycle; expected a run with somebody"),
        (TWO, "CCFtap/north/10x30", "a road user by car; expected a run with somebody on foot"),
        (
            Layout(
                name="a", scene_name=STUDY.scene_name,
                units=(replace(STUDY.units[0], sensor=load_cameras()["basler-aca1920-50gc-8mm"]),),
            ),
            "CPNC-50/east/40",
            "expected 1920 x 1080 px, as recordings have",
        ),
    ],
)  # fmt: skip
def test_what_a_recording_cannot_hold_is_refused(layout, run_id, told):
    with pytest.raises(InputError, match=told):
        to_carla_run(layout, SCENE, find_run(run_id, SCENE))


def test_places_count_from_the_zero_of_the_scenes_map():
    """A scene that was cut out of a map lies around the junction, CARLA's world does not."""
    moved = replace(SCENE, crs="", source_origin_m=np.array([100.0, -20.0]))
    at_m = np.array([[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(carla_points(at_m, moved), [[101.0, 18.0, 3.0]])
    np.testing.assert_array_equal(carla_points(at_m, SCENE), [[1.0, -2.0, 3.0]])
    assert to_carla(TWO, SCENE) == to_carla(TWO)
    assert to_carla(TWO, moved) != to_carla(TWO)
