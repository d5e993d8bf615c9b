"""Paths that name no plain file, files that hold more than they seem, options without
effect.
"""

import json
import os
import socket
import sqlite3
import stat
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from json_files import write_json
from refusals import refused_with

from experiments import main as program
from experiments import start
from experiments.results.tables import csv_text
from geometry.errors import InputError
from geometry.frames import parse_crs
from geometry.lidar import load_lidars
from geometry.maps.gis_files import read_features
from geometry.opening import open_file, read_text
from geometry.parquet_files import open_parquet
from geometry.scene import Site
from geometry.writing import check_target, write_atomically

pytestmark = pytest.mark.skipif(
    not hasattr(os, "mkfifo"), reason="pipes and devices of Unix"
)


def make_pipe(path):
    os.mkfifo(path)


def make_socket(path):
    """A socket of this machine."""
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


def make_link(path):
    """A link to a file beside it."""
    (path.parent / "target").write_text("theirs")
    path.symlink_to("target")


def make_dangling(path):
    """A link to nothing."""
    path.symlink_to("nowhere")


def make_loop(path):
    """A link to itself."""
    path.symlink_to(path.name)


def make_link_to_device(path):
    path.symlink_to("/dev/full")


def identity(path):
    """Not when it was last accessed: to read where a link leads may count as an
    access.
    """
    found = path.lstat()
    return found.st_ino, found.st_mode, found.st_size, found.st_mtime_ns


KINDS = {
    make_pipe: "a pipe",
    make_socket: "a socket",
    make_link: "a link to target",
    make_dangling: "a link to nowhere",
    make_loop: "a link to a.json",
    make_link_to_device: "a link to /dev/full",
}


@pytest.mark.parametrize("make", KINDS)
def test_nothing_but_a_regular_file_is_written_over(tmp_path, monkeypatch, make):
    monkeypatch.chdir(tmp_path)  # the name of a socket is short
    path = Path("a.json")
    make(path)
    before = identity(path)

    with pytest.raises(
        FileExistsError, match=f"{KINDS[make]}, no regular file: 'a.json'"
    ):
        write_atomically(path, b"ours")

    with refused_with(
        f"a.json: got {KINDS[make]}; expected a regular file's name, or one that is"
        " free"
    ):
        check_target(path)
    assert identity(path) == before
    assert not Path("nowhere").exists()
    assert not Path("target").exists() or Path("target").read_text() == "theirs"


@pytest.mark.parametrize("name", ["/dev/full", "/dev/null", "/dev/zero"])
def test_devices_are_not_written_over(name):
    with pytest.raises(FileExistsError, match="a device, no regular file"):
        write_atomically(Path(name), b"ours")
    assert stat.S_ISCHR(os.lstat(name).st_mode)


@pytest.mark.parametrize(
    "make", [make_pipe, make_socket, make_dangling, make_loop, Path.mkdir]
)
def test_nothing_but_a_regular_file_is_read(tmp_path, monkeypatch, make):
    monkeypatch.chdir(tmp_path)
    make(Path("a.json"))

    with pytest.raises(InputError, match=r"a\.json: got "):
        open_file(Path("a.json"))


@pytest.mark.parametrize("name", ["/dev/zero", "a\0b", "missing"])
def test_what_is_no_file_is_refused(name):
    with pytest.raises(InputError, match=r"got .*; expected a re"):
        read_text(Path(name), "JSON")


@pytest.mark.parametrize("option", ["export --layout carlancap-12 --format json --out"])
def test_the_program_keeps_devices(option, capsys):
    with pytest.raises(SystemExit) as ended:
        program.main([*option.split(), "/dev/full"])
    assert ended.value.code == 2
    assert (
        "--out: got /dev/full: a device, no regular file; expected"
        in capsys.readouterr().err
    )
    assert stat.S_ISCHR(os.lstat("/dev/full").st_mode)


# ---------- more than they seem


def test_a_parquet_file_of_ten_million_rows(tmp_path):
    path = tmp_path / "runs.parquet"
    pd.DataFrame({"a": np.zeros(10_000_000)}).to_parquet(path)

    assert path.stat().st_size < 50_000
    with (
        pytest.raises(
            InputError, match=r"80,0\d\d,\d{3} bytes or more out of .* 200 times"
        ),
        open_parquet(path, max_bytes=10**6, expected="a table"),
    ):
        pass


def test_a_long_text_that_is_repeated_stays_one(tmp_path):
    path = tmp_path / "runs.parquet"
    texts = pd.Series(["x" * 10_000] * 2_000)
    pd.DataFrame({"a": texts, "b": np.arange(2_000.0)}).to_parquet(path)
    with open_parquet(path, max_bytes=10**7, expected="a table") as file:
        assert file.read().nbytes < 1_000_000  # 20 MB as texts


@pytest.mark.parametrize(
    "made",
    [
        (
            "CREATE VIEW roofs AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x"
            " FROM c) SELECT x FROM c"
        ),
        "CREATE TABLE roofs (a, b AS (zeroblob(1000000000)))",
        "CREATE VIRTUAL TABLE roofs USING fts5(a)",
    ],
)
def test_geopackages_that_compute_what_they_hold(tmp_path, made):
    path = tmp_path / "a.gpkg"
    with sqlite3.connect(path) as database:
        database.execute(made)
    database.close()

    with pytest.raises(
        InputError, match="got roofs, a view or a table with computed columns"
    ):
        read_features(path)


def test_a_pipe_in_place_of_a_shapefile_s_table(tmp_path):
    (tmp_path / "a.shp").write_bytes(b"\0\0\x27\x0a" + bytes(96))
    os.mkfifo(tmp_path / "a.dbf")

    with pytest.raises(
        InputError, match=r"a\.dbf: got a pipe; expected a regular file"
    ):
        read_features(tmp_path / "a.shp")


@pytest.mark.parametrize(
    "text",
    ["+init=/tmp/pipe:1", "+proj=longlat +nadgrids=@/dev/zero", "../x", "/dev/zero:1"],
)
def test_reference_systems_name_no_files(text):
    from pyproj.exceptions import CRSError

    with pytest.raises(CRSError, match="a file, named by its path"):
        parse_crs(text)


# ---------- numbers beyond all bounds


def test_sensors_and_sites_have_bounds(camera):
    from dataclasses import replace

    lidar = next(iter(load_lidars().values()))
    pole = {
        "id": "a",
        "position_m": [0, 0, 0],
        "kind": "lamp post",
        "height_range_m": [3, 8],
    }

    for make, message in (
        (
            lambda: replace(camera, width_px=10**9),
            "1000000000 times .* at most 100,000,000",
        ),
        (
            lambda: replace(lidar, points_per_second=1e12),
            "at most 10,000,000 points per frame",
        ),
        (lambda: Site(**pole, capacity_units=10**30), "a whole number, 1 to 1,000"),
        (
            lambda: Site(**pole, capacity_units=1, cost_eur=1e308),
            "euros, 0 to 1,000,000,000",
        ),
    ):
        with pytest.raises(InputError, match=message):
            make()


# ---------- the command line


def refusal(capsys, *arguments):
    """The line in which a command refuses."""
    with pytest.raises(SystemExit) as ended:
        program.main(arguments)
    told = capsys.readouterr().err

    assert ended.value.code == 2, told

    return told.splitlines()[-1].removeprefix("place-rsus: ")


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--least cost", "--least: got it without --target; expected both"),
        (
            "--uncertainty none",
            "--uncertainty: got it without --samples; expected both",
        ),
        ("--uncertainty none --samples 0", "--uncertainty: got it without --samples"),
        ("--traffic sumo", "--traffic: got it without --samples; expected both"),
        ("--risk worst", "--risk: got it without --samples; expected both"),
        (
            "--no-look-share 0.1",
            "--no-look-share: got it without --no-look; expected both",
        ),
        (
            "--junction a",
            (
                "--junction: got it with the study's junction; expected --scene FILE, a"
                " map with roads"
            ),
        ),
        (
            "--sensors a --within carlancap-12",
            "--sensors: got it beside --within; expected one",
        ),
        (
            "--forbid-site=",
            "--forbid-site: got nothing; expected a value, or no --forbid-site",
        ),
        (
            "--vut-sensors camera,camera",
            "--vut-sensors: got 'camera,camera'; expected names with",
        ),
        (
            "--force-site a,,b",
            "--force-site: got 'a,,b'; expected names with commas between",
        ),
        (
            "--deceleration 1e-300",
            "--deceleration: got 1e-300; expected a number, 1 to 15",
        ),
        (
            "--brake-build-up 1e308",
            "--brake-build-up: got 1e+308; expected a number, 0 to 2",
        ),
        (
            "--site-capacity 1000000000000000000000",
            "expected units per site, 1 to 1,000",
        ),
        (
            "--yaw-step 1e-9",
            "--yaw-step: got '1e-9'; expected degrees that divide 360 evenly, at lea",
        ),
        ("--time-limit 1e308", "expected seconds, more than 0, at most 10,000,000"),
    ],
)
def test_options_without_effect_or_bounds_are_refused(capsys, arguments, message):
    assert message in refusal(capsys, "--budget", "3", "--quiet", *arguments.split())


def test_an_unknown_reference_system_of_private_ground(tmp_path, capsys):
    path = tmp_path / "a.geojson"
    write_json(
        path,
        {
            "type": "FeatureCollection",
            "crs": {"properties": {"name": "EPSG:nonsense"}},
            "features": [],
        },
    )
    told = refusal(capsys, "--budget", "3", "--quiet", "--no-look", str(path))

    assert told.endswith(
        "crs: got 'EPSG:nonsense'; expected one that pyproj knows, or none"
    )


def test_too_little_memory_is_one_line(monkeypatch, capsys):
    def fail(*_arguments, **_values):
        raise MemoryError

    monkeypatch.setattr("experiments.main.cli.invoke", fail)

    assert refusal(capsys, "--budget", "3").startswith(
        "memory: got too little in stage 'start'"
    )


def test_too_little_address_space_is_told_before(monkeypatch, capsys):
    monkeypatch.setattr("resource.getrlimit", lambda _: (10**9, 10**9))
    assert (
        refusal(capsys, "--budget", "3")
        == "ulimit -v: got 1,000,000 kB; expected 2,000,000 or no limit"
    )


def test_ctrl_c_while_modules_load(monkeypatch):
    ended = []
    monkeypatch.setattr(os, "_exit", ended.append)
    monkeypatch.setattr(os, "write", lambda *given: ended.append(given))
    start._end(2, None)

    assert ended == [(2, b"place-rsus: interrupted\n"), 130]


# ---------- texts that act


def test_no_text_reaches_a_terminal_as_a_command(capsys):
    from experiments.progress import printable, tell

    hostile = "\x1b[2J\x9b31m\u202egnp.exe\x7f\U000e0041"
    tell(f"a {hostile}\nb")
    told = capsys.readouterr().out

    assert told.replace("\n", "").isprintable()
    assert json.loads(printable(json.dumps(hostile, ensure_ascii=False))) == hostile
    assert printable("Straße \u0645\u200c\u0647") == "Straße \u0645\u200c\u0647"


def test_formulas_in_any_column_are_texts():
    table = pd.DataFrame({"kind": ["=1+1", "\uff1d1"], "n": [1, -2]})
    assert csv_text(table) == "kind,n\n'=1+1,1\n'\uff1d1,-2\n"
