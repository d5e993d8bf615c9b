"""``place-rsus scenarios``, and the options that say what is driven."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from command_results import answer, refusal

from experiments.export.openscenario import load_xosc
from geometry.scene_files import save_scene
from geometry.study_scene import load_study_scene

KEYS = {
    *(
        "case",
        "title",
        "road_user",
        "approach",
        "position",
        "speeds_kmh",
        "vru_speeds_kmh",
    ),
    *("n_runs", "last_brake_time_s", "reason"),
}


@pytest.mark.long
def test_the_list_as_json_has_one_last_moment_per_speed(ask):
    rows = ask("scenarios list --cases study --approaches east")
    assert len(rows) == 13
    for row in rows:
        assert set(row) == KEYS
        assert len(row["speeds_kmh"]) == len(row["last_brake_time_s"]) == row["n_runs"]
        assert all(time_s < 0.0 for time_s in row["last_brake_time_s"])
        assert row["reason"] is None
    assert sum(row["n_runs"] for row in rows) == 60


def test_the_list_fits_a_terminal(run):
    out = answer(
        run(
            "scenarios list --cases CBTAns,CBLA-25 --approaches east,west",
            "--along-arms 0",
            "--quiet",
        )
    )
    assert max(map(len, out.splitlines())) <= 80
    assert "CBTAns-side" in out
    assert out.splitlines()[-1] == "18 runs of 3 cases"


@pytest.mark.long
@pytest.mark.parametrize(
    ("case", "speed"),
    [
        ("CCFtap", "10x30"),
        ("CMRs-50", "50"),
    ],
)
def test_both_speeds_of_a_run_make_a_file_name(run, case, speed):
    arguments = ("scenarios show", case, "--approach east --speed", speed, "--quiet")
    path = Path(f"results/scenarios/{case}_east_{speed}.png")

    assert run(*arguments) == (0, f"Written to {path}.\n", "")
    assert path.read_bytes().startswith(b"\x89PNG")


# Quickly: tests/scenarios/test_positions.py
@pytest.mark.long
def test_a_run_away_from_the_junction_is_shown(run):
    arguments = "scenarios show CPNA-25 --approach north --speed 40 --quiet"
    out = answer(run(arguments, "--position -15 --out away.png"))
    assert out == "Written to away.png.\n"

    line = refusal(run(arguments, "--position north"))
    assert line.startswith(
        "--position: got 'north'; expected 0, or metres before it such as -15"
    )


@pytest.mark.long
def test_a_run_is_exported_as_openscenario(run):
    pytest.importorskip("scenariogeneration")
    arguments = "scenarios export CPTAns-50 --approach east --speed 10"
    text = answer(run(arguments))

    assert '<LogicFile filepath="Town05.xodr"' in text
    assert run(arguments, "--out turn.xosc") == (0, "", "")
    assert Path("turn.xosc").read_text() == text


@pytest.mark.long
def test_a_scene_without_a_road_network_has_it_written_beside_the_run(run):
    pytest.importorskip("scenariogeneration")
    Path("bare").mkdir()
    save_scene(Path("bare"), replace(load_study_scene(), road_network=""))
    run_id = ("CPTAns-50", "--approach east --speed 10 --scene bare")
    line = refusal(run("scenarios export", *run_id))

    assert "road_network" in line
    assert run("scenarios export", *run_id, "--out turn.xosc") == (0, "", "")
    assert '<LogicFile filepath="turn.xodr"' in Path("turn.xosc").read_text()
    assert "<OpenDRIVE>" in Path("turn.xodr").read_text()


def test_an_export_without_the_library_names_the_extra(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "scenariogeneration.xosc", None)
    load_xosc.cache_clear()
    line = refusal(run("scenarios export CPNA-25 --approach east --speed 40"))

    assert "place-rsus[openscenario]" in line


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--cases", "CPXX"],
            "--cases: got 'CPXX'; expected one of default, study, protocol-4.5.1",
        ),
        (["--cases", ""], "--cases: got nothing; expected a value, or no --cases"),
        (
            ["--speeds", "fast"],
            "--speeds: got 'fast'; expected km/h with commas between",
        ),
        (
            ["--cases", "CBLA", "--speeds", "70"],
            "--speeds: got 70; expected 25 to 60 km/h",
        ),
        (
            ["--approaches", "up"],
            "--approaches: got 'up'; expected one or more of east, north,",
        ),
        (
            ["--along-arms", "nan"],
            "--along-arms: got 'nan'; expected metres along the arm, 0 to 5",
        ),
        (
            ["--weather", "snow"],
            "--weather: got 'snow'; expected one or more of day, night, rain",
        ),
        (
            ["--deceleration", "0"],
            "--deceleration: got '0'; expected m/s^2, more than 0",
        ),
        (
            ["--brake-build-up", "-1"],
            "--brake-build-up: got '-1'; expected seconds, at least 0",
        ),
        (["--latency", "inf"], "--latency: got 'inf'; expected seconds, at least 0"),
        (
            ["--track-memory", "-1"],
            "--track-memory: got '-1'; expected seconds, more than 0, or i",
        ),
        (
            ["--track-memory", "0.09"],
            "--track-memory: got 0.09; expected seconds, at least 0.1 (",
        ),
        (
            ["--confirmations", "0"],
            "--confirmations: got '0'; expected a number of frames, at le",
        ),
    ],
)
@pytest.mark.parametrize("command", [["--budget", "1"]])
def test_options_that_cannot_be_are_one_line(run, command, arguments, message):
    assert refusal(run(*command, *arguments, "--quiet")).startswith(message)
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["CPNA"],
            "CPNA: got 2 runs (CPNA-25/east/40, CPNA-75/east/40); expected one run",
        ),
        (
            ["CPTAns-50"],
            "--speeds: got 40; expected 10 to 10 km/h as the protocol drives",
        ),
        (
            ["CPNA-25", "--out", "film.mov"],
            "--out: got 'film.mov'; expected a name that ends in",
        ),
    ],
)
def test_shows_that_cannot_be_are_one_line(run, arguments, message):
    result = run("scenarios show", *arguments, "--approach east --speed 40 --quiet")
    assert refusal(result).startswith(message)


# ---------- recorded encounters
ROWS = [
    row
    for n in range(40)
    for row in (
        f"v,{0.1 * n:.1f},{n - 45.0},-1.75,0,car",
        f"p,{0.1 * n:.1f},2.7,{0.15 * n - 8.5},90,pedestrian",
    )
]


def test_recordings_become_cases_that_can_be_driven(run, tmp_path):
    path = tmp_path / "walk.csv"
    out = tmp_path / "near.toml"
    path.write_text("\n".join(["id,time,x,y,heading,class", *ROWS]))
    told = run("scenarios import", str(path), "--name a --out", str(out))

    assert told == (0, "1 encounter of 2 road users.\n", "") or "1 encounter" in told[2]

    text = out.read_text()
    assert text.startswith('[a-v-p]\nkind = "recorded"\n')
    assert run("scenarios import", str(path), "--name a")[1].endswith(text)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ("--ttc", "0.1"),
            "encounters: got none; expected a higher --ttc, or --within",
        ),
        (("--ttc", "nan"), "--ttc: got nan; expected a number, more than 0"),
        (
            ("--columns", "z=y"),
            "--columns: got 'z'; expected one of id, time, frame, x, y, headin",
        ),
    ],
)
def test_imports_that_cannot_be_are_refused(run, tmp_path, options, message):
    path = tmp_path / "walk.csv"
    path.write_text("\n".join(["id,time,x,y,heading,class", *ROWS]))
    code, _, err = run("scenarios import", str(path), *options)

    assert code == 2
    assert message in err.splitlines()[-1]
