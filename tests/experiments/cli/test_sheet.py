import json
from dataclasses import replace

import msgspec
import pytest
from command_results import answer
from kept_backdrops import kept_backdrop

from experiments.cli.export import sheet_text
from experiments.parts import sheet
from experiments.parts.sheet import SheetResult


@pytest.fixture
def run_sheet(run, small_setting, monkeypatch):
    monkeypatch.setattr("placement.imaging.picture.build_backdrop", kept_backdrop)
    few = replace(small_setting)
    monkeypatch.setattr(sheet, "build_setting", lambda question, scene, **options: few)
    return lambda *arguments: run("sheet", *arguments)


# Quickly: test_no_word_of_a_sheet_is_left_over in tests/experiments/test_language.py
@pytest.mark.long
def test_a_page_for_each_unit(run_sheet, tmp_path):
    unit = {"site": "", "z_m": 8.0, "yaw_deg": -135.0, "pitch_deg": -25.0}
    camera = unit | {
        "id": "a$b_雪",
        "x_m": -115.0,
        "y_m": 8.6,
        "camera": "carla-ncap-rgb",
    }
    lidar = unit | {"id": "L", "x_m": -113.5, "y_m": 8.6, "lidar": "carla-ncap-lidar"}
    layout = tmp_path / "layout.json"
    layout.write_text(json.dumps({"name": "mine", "layout": [camera, lidar]}))
    out = tmp_path / "new/sheet.pdf"
    summary = json.loads(
        answer(run_sheet("--layout", layout, "--out", out, "--json --quiet"))
    )
    assert [entry["unit_id"] for entry in summary["units"]] == ["a$b_雪", "L"]
    pdf = out.read_bytes()
    assert pdf.startswith(b"%PDF")
    assert pdf.count(b"/Type /Page\n") == 2 or pdf.count(b"/Type /Page ") == 2
    assert (
        max(
            map(
                len, sheet_text(msgspec.convert(summary, SheetResult)).splitlines()[:-1]
            )
        )
        <= 80
    )


def test_bad_input_is_one_line(run_sheet, tmp_path):
    for arguments, message in (
        (["--out", tmp_path / "a.pdf"], "--layout: got nothing; expected it once"),
        (
            ["--layout", "carlancap-12", "--out", tmp_path],
            "a folder; expected a PDF file",
        ),
        (["--layout", "gone.json", "--out", tmp_path / "a.pdf"], "gone.json"),
        (["--layout", "carlancap-12"], "Missing option '--out'"),
    ):
        code, _, err = run_sheet(*arguments, "--quiet")
        assert (code, message in err) == (2, True), err
