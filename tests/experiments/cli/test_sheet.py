"""``place-rsus sheet``: a page for who mounts each unit, and what it says."""

import json
import re
from dataclasses import replace

import msgspec
import pytest
from command_results import answer
from json_files import write_json
from kept_backdrops import kept_backdrop
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.text import Text
from tiny_worlds import scene_of_boxes, unit_at

from experiments.cli.export import sheet_text
from experiments.parts import sheet
from experiments.parts.sheet import SheetResult, aiming_point_m
from geometry.catalogue import load_cameras
from geometry.sensors import project_points
from geometry.study_scene import load_study_scene
from placement.explain.tolerances import Tolerance
from placement.layout import Layout
from placement.question import Question

savefig = PdfPages.savefig


@pytest.fixture
def run_sheet(run, small_setting, monkeypatch):
    """Runs the command on a few runs, with pictures that were drawn before."""
    monkeypatch.setattr("placement.imaging.picture.build_backdrop", kept_backdrop)
    few = replace(small_setting)
    monkeypatch.setattr(sheet, "build_setting", lambda question, scene, **options: few)
    return lambda *arguments: run("sheet", *arguments)


# Quickly: test_no_word_of_a_sheet_is_left_over in tests/experiments/test_language.py
@pytest.mark.long
def test_a_page_for_each_unit(run_sheet, tmp_path, monkeypatch):
    pages = []
    monkeypatch.setattr(
        PdfPages,
        "savefig",
        lambda self, figure: (
            pages.append([text.get_text() for text in figure.findobj(Text)]),
            savefig(self, figure),
        ),
    )
    unit = {
        "site": "",
        "z_m": 8.0,
        "yaw_deg": -135.0,
        "pitch_deg": -25.0,
    }
    camera = unit | {
        "id": "a$b_雪",
        "x_m": -115.0,
        "y_m": 8.6,
        "camera": "carla-ncap-rgb",
    }
    lidar = unit | {
        "id": "L",
        "x_m": -113.5,
        "y_m": 8.6,
        "lidar": "carla-ncap-lidar",
    }
    layout = tmp_path / "layout.json"
    write_json(layout, {"name": "mine", "layout": [camera, lidar]})
    kept = tmp_path / "kept.json"
    write_json(kept, {"name": "kept", "layout": [camera]})
    out = tmp_path / "new/sheet.pdf"
    asked = ("--layout", layout, "--keep", kept, "--out", out, "--json --quiet")
    summary = json.loads(answer(run_sheet(*asked)))

    assert [entry["unit_id"] for entry in summary["units"]] == ["a$b_雪", "L"]

    first, second = pages
    assert any(text.endswith("existing, do not touch") for text in first)
    assert not any(text.endswith("existing, do not touch") for text in second)
    # Nobody aims what is not to be touched.
    assert ["Aim to within" in page for page in pages] == [False, True]

    pdf = out.read_bytes()
    assert pdf.startswith(b"%PDF")
    assert len(re.findall(rb"/Type /Page\s", pdf)) == 2

    told = sheet_text(msgspec.convert(summary, SheetResult)).splitlines()
    assert max(map(len, told[:-1])) <= 80  # but the path


def test_bad_input_is_one_line(run_sheet, tmp_path):
    for arguments, message in (
        (["--out", tmp_path / "a.pdf"], "--layout: got nothing; expected it once"),
        (
            ["--layout", "carlancap-12", "--out", tmp_path],
            "a folder; expected a PDF file",
        ),
        (["--layout", "gone.json", "--out", tmp_path / "a.pdf"], "gone.json"),
        (["--layout", "carlancap-12"], "Missing option '--out'"),
        (
            ["--layout carlancap-12 --keep no --out", tmp_path / "a.pdf"],
            "--keep: got 'no'",
        ),
    ):
        code, _, err = run_sheet(*arguments, "--quiet")
        assert code == 2
        assert message in err


CAMERA = load_cameras()["carla-ncap-rgb"]


def camera_at(x_m, y_m, *, yaw_deg, pitch_deg, unit_id="U1"):
    """A camera 8 m above a place."""
    return unit_at(unit_id, [x_m, y_m, 8.0], yaw_deg=yaw_deg, pitch_deg=pitch_deg)


def test_the_aiming_point_is_the_ground_in_the_middle_of_the_picture():
    down = camera_at(-126.0, -1.0, yaw_deg=0.0, pitch_deg=-45.0)
    aim_m = aiming_point_m(down, load_study_scene())
    assert aim_m == pytest.approx([-118.0, -1.0, 0.0])


def test_the_aiming_point_is_before_a_building_that_fills_the_middle_of_the_picture():
    # The building at the north-west corner begins at (-142, 14).
    unit = camera_at(-150.0, 5.0, yaw_deg=90.0, pitch_deg=-20.0)
    aim_m = aiming_point_m(unit, load_study_scene())
    assert 9.0 < aim_m[1] < 14.0

    ((column, row, _),) = project_points(aim_m[None], unit.pose, CAMERA)
    assert 0.0 <= column <= CAMERA.width_px
    assert 0.5 * CAMERA.height_px < row <= CAMERA.height_px


def test_a_camera_that_looks_up_has_no_aiming_point():
    up = camera_at(-126.0, -1.0, yaw_deg=0.0, pitch_deg=40.0)
    assert aiming_point_m(up, load_study_scene()) is None


def test_rows_say_what_one_sees_on_site_and_where_in_metres_of_the_map():
    scene = load_study_scene()
    unit = camera_at(-113.05, -9.5, yaw_deg=-150.0, pitch_deg=-45.0)
    none = Tolerance(
        unit_id="U1",
        yaw_deg=(0.0, 0.5),
        pitch_deg=(0.0, 15.0),
        height_m=(0.0, 0.05),
    )
    rows = dict(sheet._rows(unit, scene, {}))

    assert rows["Where"].startswith("UTM zone 32N: east 426744.86 m, north 542792")
    assert sheet._tolerance_text(none).splitlines()[:2] == [
        "0.5\N{DEGREE SIGN} to the left, less than 0.5\N{DEGREE SIGN} to the right",
        "15\N{DEGREE SIGN} or more up, less than 0.5\N{DEGREE SIGN} down",
    ]
    assert "yaw" not in " ".join(rows.values())

    names = {thing.id for thing in scene.instances}
    assert not {word for word in rows["Landmarks"].split() if word in names}
    assert "end of a crosswalk" in rows["Landmarks"]

    mapped = {"map_x": 1.0, "map_y": 2.0, "map_crs": "EPSG:25832"}
    where = sheet._coordinates(unit, scene, mapped)
    assert where.startswith("east 1.00 m, north 2.00 m (ETRS89 / UTM zone 32N)")


def test_units_are_existing_where_the_kept_file_has_them(tmp_path):
    kept = camera_at(-126.0, -1.0, yaw_deg=0.0, pitch_deg=-45.0)
    file = tmp_path / "kept.json"
    unit = {
        "id": "U1",
        "site": "",
        "x_m": -126.0,
        "y_m": -1.0,
        "z_m": 8.0,
    }
    unit |= {"yaw_deg": 0.0, "pitch_deg": -45.0, "camera": CAMERA.name}
    write_json(file, {"name": "kept", "layout": [unit]})
    elsewhere = replace(kept, id="U2")
    layout = Layout(name="both", units=(kept, elsewhere))
    question = Question(keep=str(file))

    assert sheet._mounted_already(question, layout, load_study_scene()) == {"U1"}
    assert sheet._mounted_already(Question(), layout, load_study_scene()) == set()


def test_a_landmark_is_one_that_nothing_hides_from_the_mount():
    building = ((10, -5, 0), (14, 3, 10))
    left_wall = ((5.9, 1, 0), (6.1, 6, 3))
    long_wall = ((5.9, -9, 0), (6.1, 6, 3))
    kinds = ("building", "wall")
    unit = camera_at(0.0, 0.0, yaw_deg=0.0, pitch_deg=-30.0)
    alone = scene_of_boxes(building, classes=kinds[:1])

    assert corner_of(unit, alone) == "10.44 m to the east: corner of a building"

    beside = scene_of_boxes(building, left_wall, classes=kinds)
    assert corner_of(unit, beside) == "11.18 m to the south-east: corner of a building"

    behind = scene_of_boxes(building, long_wall, classes=kinds)
    assert corner_of(unit, behind) == ""


def corner_of(unit, scene):
    """The landmark that is a corner of a building; empty if there is none."""
    words = [text for text in sheet._landmarks(unit, scene) if "a building" in text]
    assert len(words) <= 1
    return "".join(words)
