"""Runs in esmini; a program that writes its log stands in where it is not there."""

import json
import os
import re
import stat
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from experiments.export import esmini
from experiments.export.esmini import (
    Driven,
    describe,
    drive_in_esmini,
    find_esmini,
    worst_first,
)
from experiments.export.openscenario import reference_ahead_m, to_openscenario
from experiments.export.watched import find_run
from geometry.errors import InputError
from geometry.study_scene import load_study_scene


def program(tmp_path: Path, body: str) -> Path:
    path = tmp_path / "esmini"
    path.write_text(
        f"#!{sys.executable}\nimport sys, pathlib, xml.etree.ElementTree as ET\n"
        "given = dict(zip(sys.argv[1::1], sys.argv[2::1]))\n"
        "osc, log = pathlib.Path(given['--osc']), pathlib.Path(given['--logfile_path'])\n"
        f"{body}"
    )
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


IMPACT = (
    "one = {p.get('name'): float(p.get('value')) for p in"
    " ET.parse(osc).getroot().iter('ParameterDeclaration')}\n"
    "time_s = one['impact_time_s'] + OFF\n"
    "log.write_text(f'[0.000] [info] begins\\n"
    "[{time_s - 1:.3f}] [warn] Collision between vut and obstruction-1\\n"
    "[{time_s:.3f}] [warn] Collision between vut and vru\\n"
    "[{time_s + .01:.3f}] [warn] Collision between vut and vru dissolved\\n')\n"
)


FEW = ("--cases", "CPNC-50", "--speeds", "40,50", "--along-arms", "0", "--quiet")


@pytest.fixture(scope="module")
def runs():
    pytest.importorskip("scenariogeneration")
    scene = load_study_scene()
    return [find_run(name, scene) for name in ("CPNC-50/east/40", "CBTAns-0/north/10")]


@pytest.mark.parametrize(("off_s", "agrees"), [(0.0, True), (-0.02, True), (0.03, False)])
def test_the_touch_is_told_from_the_impact_on(tmp_path, runs, off_s, agrees):
    path = program(tmp_path, IMPACT.replace("OFF", str(off_s)))
    for one in drive_in_esmini(runs, load_study_scene(), path):
        assert one.touch_s == pytest.approx(off_s, abs=1e-3)
        assert one.agrees == agrees


def test_bodies_that_never_touch_are_told_first(tmp_path, runs):
    path = program(tmp_path, "log.write_text('[0.000] [info] begins\\n')\n")
    driven = drive_in_esmini(runs, load_study_scene(), path)
    assert [one.touch_s for one in driven] == [None, None]
    near, far = (Driven(run_id="a", touch_s=touch_s) for touch_s in (0.01, -0.5))
    assert worst_first([near, driven[0], far]) == [driven[0], far, near]


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("log.write_text('[0.000] [error] no such road\\n'); sys.exit(3)\n", "no such road"),
        ("sys.exit(0)\n", "exit 0"),
    ],
)
def test_a_program_that_fails_is_told(tmp_path, runs, body, told):
    with pytest.raises(InputError, match=told):
        drive_in_esmini(runs[:1], load_study_scene(), program(tmp_path, body))


def test_the_command_tells_where_nothing_is_checked(run, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    code, out, err = run("scenarios", "check-esmini", "--cases", "CPNC-50", "--quiet")
    assert (code, err) == (0, "")
    assert out.startswith("Nothing was checked")
    code, _, err = run("scenarios", "check-esmini", "--esmini", tmp_path / "none")
    assert code == 2
    assert "--esmini: got" in err


def test_the_command_compares_every_run(run, tmp_path):
    pytest.importorskip("scenariogeneration")
    few = (*FEW, "--approaches", "east")
    path = program(tmp_path, IMPACT.replace("OFF", "0.0"))
    code, out, _ = run("scenarios", "check-esmini", *few, "--esmini", path)
    assert code == 0
    assert out.startswith("In ")
    code, out, _ = run(
        "scenarios", "check-esmini", *few, "--json",
        "--esmini", program(tmp_path, IMPACT.replace("OFF", "0.5")),
    )  # fmt: skip
    assert code == 1
    rows = json.loads(out)
    assert all(row["touch_s"] == pytest.approx(0.5, abs=1e-3) for row in rows)
    page = describe([Driven(run_id=row["run"], touch_s=row["touch_s"]) for row in rows], "a")
    assert f"In 0 of {len(rows)} runs" in page
    assert f"| 0.500 | {len(rows)} | {rows[0]['run']}, " in page


def test_a_page_of_all_runs_is_written(run, tmp_path):
    pytest.importorskip("scenariogeneration")
    few = (*FEW, "--approaches", "east,west")
    path = program(tmp_path, IMPACT.replace("OFF", "0.0"))
    out = ("--out", tmp_path / "a.md")
    code, _, _ = run("scenarios", "check-esmini", *few, *out, "--esmini", path)
    text = (tmp_path / "a.md").read_text(encoding="utf-8")
    assert code == 0
    assert str(tmp_path) not in text
    assert re.search(r"\| 0\.000 \| (\d+) \| \1 \| the others \|", text)


def test_turns_have_vertices_every_fiftieth_of_a_second_and_straight_ways_each_frame(runs):
    """A turn's vertices are on its way; a straight way has the run's frames alone."""
    pytest.importorskip("scenariogeneration")
    straight, turning = runs
    for one, is_dense in ((straight, False), (turning, True)):
        root = ET.fromstring(to_openscenario(one, road_network="a.xodr", after_s=0.2))
        line = root.find(".//Trajectory[@name='vut unbraked']//Polyline")
        vertices = line.findall("Vertex")
        times_s = np.array([float(vertex.get("time")) for vertex in vertices]) + one.time_s[0]
        found = [vertex.find(".//WorldPosition") for vertex in vertices]
        yaw_rad = np.array([float(place.get("h")) for place in found])
        at_m = np.array([[float(place.get(axis)) for axis in "xy"] for place in found])
        motion, body = one.encounter.vut_motion, one.encounter.vut
        middle_m, yaw_deg = motion.path.at(motion.distance_m(times_s))
        np.testing.assert_allclose(np.degrees(np.sin(yaw_rad - np.radians(yaw_deg))), 0, atol=1e-3)
        ahead = np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
        np.testing.assert_allclose(at_m, middle_m + reference_ahead_m(body) * ahead, atol=1e-5)
        turns = np.abs(np.diff(yaw_deg)) > 0.1
        steps_s = np.diff(times_s)
        assert bool(turns.any()) == is_dense
        assert steps_s[turns].max(initial=0.0) < 0.0201
        if not is_dense:
            assert len(times_s) == len(one.time_s) + 1  # 0.2 s behind the impact


@pytest.mark.long
@pytest.mark.skipif(find_esmini() is None, reason="esmini is not on the path")
def test_esmini_finds_the_impacts(runs):
    found = find_esmini()
    assert found is not None
    touches = [one.touch_s for one in drive_in_esmini(runs, load_study_scene(), found)]
    assert np.abs(touches).max() <= esmini.MOST_S
    assert os.access(found, os.X_OK)
