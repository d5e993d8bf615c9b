"""Small files that would cost gigabytes, hang, or be refused for another reason than
theirs.
"""

import json
import os
import resource
import struct
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest

from experiments.results.folders import MARKER, new_result_folder
from geometry.errors import InputError
from geometry.maps.place_lists import read_sites
from geometry.maps.point_clouds import open_points
from geometry.scene_files import SCENE_FILE, THINGS_FILE, load_scene_folder, save_scene
from geometry.study_scene import load_study_scene

HOSTILE = Path(__file__).parents[3] / "shared" / "inputs" / "trials4" / "hostile"
FAR = "-10,000 to 10,000 metres from the origin"
_LIMIT_BYTES = 4_000_000_000
_LIMIT_S = 120


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "scene"
    path.mkdir()
    save_scene(path, load_study_scene())
    return path


def _change_toml(folder: Path, key: str, value: str) -> None:
    """Give the first field of a name in a scene's TOML another value."""
    path = folder / SCENE_FILE
    lines = path.read_text().splitlines()
    at = next(at for at, line in enumerate(lines) if line.startswith(f"{key} = "))
    lines[at] = f"{key} = {value}"
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        (
            "centreline_m",
            "[[1e9, 0.0], [9.0, 1.75]]",
            rf"centreline_m: got 1\S+; expected {FAR}",
        ),
        (
            "centreline_m",
            "[[-1e200, 0.0], [9.0, 1.75]]",
            rf"got -1e\+200; expected {FAR}",
        ),
        ("width_m", "1e-300", r"width_m: got 1e-300; expected 0\.5 to 30 metres"),
        ("width_m", "30.5", r"width_m: got 30\.5; expected 0\.5 to 30 metres"),
        ("position_m", "[0.0, 1e9, 0.0]", rf"position_m: got 1\S+; expected {FAR}"),
        (
            "ends_m",
            "[[-1e9, 10.0], [1e9, 10.0]]",
            rf"crosswalks_m: got -1\S+; expected {FAR}",
        ),
        (
            "outline_m",
            "[[0, 0], [1e9, 0], [0, 9]]",
            rf"outline_m: got 1\S+; expected {FAR}",
        ),
    ],
)
def test_a_scene_with_a_size_that_no_junction_has_is_refused(
    folder, key, value, message
):
    _change_toml(folder, key, value)
    with pytest.raises(InputError, match=message):
        load_scene_folder(folder)


def test_a_lane_with_too_many_points_is_refused(folder):
    points = [[0.001 * index, 0.0] for index in range(10_001)]
    _change_toml(folder, "centreline_m", str(points))
    with pytest.raises(
        InputError, match="centreline_m: got 10,001 of them; expected at most 10,"
    ):
        load_scene_folder(folder)


def test_a_scene_with_too_many_crosswalks_is_refused(folder):
    path = folder / SCENE_FILE
    more = "\n[[crosswalks]]\nends_m = [[-3.5, 10.0], [3.5, 10.0]]\n" * 501
    path.write_text(path.read_text() + more)
    with pytest.raises(
        InputError, match=r"crosswalks_m: got .* of them; expected at most 500"
    ):
        load_scene_folder(folder)


def _add_to_glb(path: Path, fields: dict[str, object]) -> None:
    """Set fields of a binary glTF's JSON."""
    data = path.read_bytes()
    (n_bytes,) = struct.unpack_from("<I", data, 12)
    table = json.loads(data[20 : 20 + n_bytes]) | fields
    text = json.dumps(table).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + n_bytes :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    path.write_bytes(head + struct.pack("<I4s", len(text), b"JSON") + text + rest)


@pytest.mark.parametrize("name", ["/dev/zero", "fifo", "other.bin", "../other.bin"])
def test_a_buffer_of_a_scenes_mesh_in_another_file_is_refused(folder, name):
    os.mkfifo(folder / "fifo")
    (folder / "other.bin").write_bytes(bytes(1000))
    _add_to_glb(folder / THINGS_FILE, {"buffers": [{"byteLength": 984, "uri": name}]})
    with pytest.raises(InputError, match="all of its data in the file itself"):
        load_scene_folder(folder)


@pytest.mark.parametrize("name", ["/dev/zero", "fifo"])
def test_an_image_of_a_scenes_mesh_is_not_opened(folder, name):
    os.mkfifo(folder / "fifo")
    texture = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    fields = {
        "images": [{"uri": name}],
        "textures": [{"source": 0}],
        "materials": [texture],
    }
    _add_to_glb(folder / THINGS_FILE, fields)
    assert load_scene_folder(folder).instances == load_study_scene().instances


def test_a_packed_point_cloud_out_of_too_few_bytes_is_not_unpacked(tmp_path):
    path = tmp_path / "flat.laz"
    header = laspy.LasHeader(point_format=6, version="1.4")
    cloud = laspy.LasData(header)
    cloud.x = np.zeros(400_000)
    cloud.y = np.zeros(400_000)
    cloud.z = np.zeros(400_000)
    cloud.write(path)
    assert path.stat().st_size < 50_000
    with (
        pytest.raises(InputError, match="at most 200 times as many"),
        open_points(path),
    ):
        pass


@pytest.mark.parametrize("hidden", ["\u00ad", "\u200b", "\u2060", "\u00a0", "\u202e"])
def test_a_character_that_nobody_sees_in_a_sites_id_is_refused_at_reading(
    tmp_path, hidden
):
    path = tmp_path / "poles.csv"
    path.write_text(f"id,x,y\nLP{hidden}12,1,2\n", encoding="utf-8")
    with pytest.raises(
        InputError, match=r"poles\.csv: line 2: id: got .*; expected printable"
    ):
        read_sites(path, crs="")


@pytest.mark.parametrize("key", ["id"])
def test_a_character_that_nobody_sees_in_a_scenes_ids_is_refused(folder, key):
    _change_toml(folder, key, '"a\u200bb"')
    with pytest.raises(InputError, match="expected printable text"):
        load_scene_folder(folder)


def _fail_while_writing(folder: Path, error: Exception) -> None:
    with new_result_folder(folder) as new:
        (new / MARKER).write_text("{}")
        raise error


def test_a_fault_while_results_are_written_keeps_its_own_words(tmp_path):
    fault = InputError("lane 3.width_m", 0.0, "0.5 to 30 metres")
    with pytest.raises(InputError) as refused:
        _fail_while_writing(tmp_path / "out", fault)
    kept = tmp_path / "out.unfinished"
    words = (
        "lane 3.width_m: got 0.0; expected 0.5 to 30 metres; what was computed is"
        " kept in"
    )
    assert str(refused.value) == f"{words} {kept}"


def test_a_bug_while_results_are_written_is_not_blamed_on_the_folder(tmp_path):
    with pytest.raises(ZeroDivisionError) as caught:
        _fail_while_writing(tmp_path / "out", ZeroDivisionError("of nothing"))
    kept = tmp_path / "out.unfinished"
    assert caught.value.__notes__ == [f"what was computed is kept in {kept}"]


def test_another_file_that_is_gone_is_not_blamed_on_the_folder(tmp_path):
    gone = FileNotFoundError(2, "No such file or directory", "/fonts/gone.ttf")
    with pytest.raises(FileNotFoundError, match="gone"):
        _fail_while_writing(tmp_path / "out", gone)


@pytest.mark.long
@pytest.mark.skipif(not HOSTILE.is_dir(), reason="the hostile files are not here")
@pytest.mark.parametrize("path", sorted(HOSTILE.glob("*/")), ids=lambda path: path.name)
def test_each_hostile_scene_is_answered_in_one_line(path, tmp_path):
    copy = tmp_path / path.name
    copy.mkdir()
    for file in path.iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    os.mkfifo(copy / "fifo")

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (_LIMIT_BYTES, _LIMIT_BYTES))

    done = subprocess.run(
        [sys.executable, "-m", "experiments.start", "scene", "check", str(copy)],
        capture_output=True,
        text=True,
        timeout=_LIMIT_S,
        preexec_fn=limit,
    )
    if "image" in path.name:
        assert done.returncode in (0, 1)
    else:
        assert done.returncode == 2
        stage, *said = done.stderr.splitlines()
        assert stage == "check ..."
        assert len(said) == 1
        assert "; expected " in said[0]


@pytest.mark.skipif(not HOSTILE.is_dir(), reason="the hostile files are not here")
def test_the_hostile_lists_and_clouds_are_refused_at_reading():
    with pytest.raises(
        InputError, match=r"line 2: id: got .*; expected printable text"
    ):
        read_sites(HOSTILE / "poles_nbsp.csv", crs="EPSG:32633")
    packed = open_points(HOSTILE / "grid20M.laz")
    with pytest.raises(InputError, match="at most 200 times as many"), packed:
        pass
