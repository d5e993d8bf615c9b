"""Small files that would cost gigabytes, hang, or be refused for another reason than
theirs.
"""

import dataclasses
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
from json_files import write_json

from experiments.results.folders import MARKER, new_result_folder
from geometry import gltf
from geometry.errors import InputError, clean_name
from geometry.maps.mesh_files import read_mesh
from geometry.maps.place_lists import read_sites
from geometry.maps.point_clouds import open_points
from geometry.maps.source_map import MapJunction, MapLane
from geometry.scene_files import THINGS_FILE, load_scene_folder, save_scene
from geometry.scene_sources import SCENE_FILE
from geometry.study_scene import load_study_scene

HOSTILE = Path(__file__).parents[3] / "shared/inputs/trials4/hostile"
FAR = "metres within 10,000 of the origin"
_LIMIT_BYTES = 4_000_000_000
_LIMIT_S = 120


@pytest.fixture
def folder(tmp_path):
    """The study's junction as a folder."""
    path = tmp_path / "scene"
    path.mkdir()
    save_scene(path, load_study_scene())
    return path


def _change_toml(folder, key, value):
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
            "[[1e9, 0.0], [9.0, 1.0]]",
            r"centreline_m\[0\]: got \[1\S+, 0.0\]; ",
        ),
        ("width_m", "1e-300", r"width_m: got 1e-300; expected 0\.5 to 30 metres"),
        (
            "position_m",
            "[0.0, 1e9, 0.0]",
            rf"position_m: got \[0.0, 1\S+, 0.0\]; expected {FAR}",
        ),
        (
            "ends_m",
            "[[1.0, 2.0], [1e9, 2.0]]",
            rf"crosswalks_m\[0\]\[1\]: .* expected {FAR}",
        ),
        (
            "ends_m",
            "[[-150, 10], [150, 10]]",
            "got 300 metres from end to end; expected at most",
        ),
        (
            "outline_m",
            "[[0, 0], [1e9, 0], [0, 9]]",
            rf"outline_m\[1\]: .* expected {FAR}",
        ),
        (
            "height_range_m",
            "[2.0, 1e9]",
            "expected .*low, high.* 0 < low <= high <= 10,000",
        ),
    ],
)
def test_a_scene_with_a_size_that_no_junction_has_is_refused(
    folder, key, value, message
):
    _change_toml(folder, key, value)
    with pytest.raises(InputError, match=message) as caught:
        load_scene_folder(folder)
    assert str(caught.value).startswith(f"{folder}/{SCENE_FILE}: ")


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


def test_lanes_that_go_to_and_fro_without_end_are_refused():
    scene = load_study_scene()
    there_and_back_m = np.array([[-9_000.0, 0.0], [9_000.0, 0.0]] * 40)
    lane = dataclasses.replace(scene.lanes[0], centreline_m=there_and_back_m)

    with pytest.raises(
        InputError, match="lanes: got 1,422,000 metres of them; expected at most"
    ):
        dataclasses.replace(scene, lanes=(lane,))


def _add_to_glb(path, fields):
    """Set fields of a binary glTF's JSON."""
    data = path.read_bytes()
    (n_bytes,) = struct.unpack_from("<I", data, 12)
    table = json.loads(data[20 : 20 + n_bytes]) | fields
    text = json.dumps(table).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + n_bytes :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    path.write_bytes(head + struct.pack("<I4s", len(text), b"JSON") + text + rest)


@pytest.mark.parametrize("kind", ["buffers", "images"])
@pytest.mark.parametrize("name", ["/dev/zero", "fifo", "other.bin", "../other.bin"])
def test_a_scenes_mesh_with_data_in_another_file_is_refused(folder, kind, name):
    os.mkfifo(folder / "fifo")
    (folder / "other.bin").write_bytes(bytes(1000))
    _add_to_glb(folder / THINGS_FILE, {kind: [{"byteLength": 984, "uri": name}]})

    with pytest.raises(
        InputError, match=rf"{kind}\[0\]\.uri: got .* all data in the file itself"
    ):
        load_scene_folder(folder)


def test_an_image_in_a_scenes_mesh_itself_is_taken(folder):
    texture = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    images = [{"uri": "data:image/png;base64,AAAA"}]
    fields = {"images": images, "textures": [{"source": 0}], "materials": [texture]}
    _add_to_glb(folder / THINGS_FILE, fields)

    assert load_scene_folder(folder).instances == load_study_scene().instances


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("fifo", "got a pipe; expected a regular file"),
        ("link", "got a reference to 'link'; expected files in its own folder"),
        ("folder", "expected a readable file"),
    ],
)
def test_a_gltf_opens_plain_files_of_its_folder_alone(tmp_path, name, message):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "link").symlink_to("/dev/zero")
    (tmp_path / "folder").mkdir()
    path = tmp_path / "house.gltf"
    write_json(path, {"asset": {"version": "2.0"}, "buffers": [{"uri": name}]})

    with pytest.raises(InputError, match=message):
        read_mesh(path)


def test_all_buffers_of_a_gltf_have_the_size_of_one_mesh(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf, "MAX_FILE_BYTES", 1500)
    (tmp_path / "a.bin").write_bytes(bytes(1000))
    path = tmp_path / "house.gltf"
    buffers = [{"uri": "a.bin", "byteLength": 1000}] * 2
    write_json(path, {"asset": {"version": "2.0"}, "buffers": buffers})

    with pytest.raises(InputError, match="got 1,000 bytes; expected at most 500"):
        read_mesh(path)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.obj", "mtllib fifo\nusemtl x\nv 0 0 0\nv 5 0 0\nv 0 5 0\nf 1 2 3\n"),
        (
            "a.ply",
            (
                "ply\nformat ascii 1.0\ncomment TextureFile fifo\nelement vertex 3\n"
                "property float x\nproperty float y\nproperty float z\nelement face 1\n"
                "property list uchar int vertex_indices\nend_header\n"
                "0 0 0\n5 0 0\n0 5 0\n3 0 1 2\n"
            ),
        ),
    ],
)
def test_materials_of_a_mesh_are_not_opened(tmp_path, name, text):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / name).write_text(text)

    assert len(read_mesh(tmp_path / name, unit="m", up="z").things) == 1


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
    path.write_text(f"id,x,y\nLP{hidden}12,1,2\n")

    with pytest.raises(
        InputError, match=r"poles\.csv: line 2: id: got .*; expected printable"
    ):
        read_sites(path, crs="")


def test_a_character_that_nobody_sees_in_a_site_of_geojson_is_refused_at_reading(
    tmp_path,
):
    path = tmp_path / "poles.geojson"
    point = {"type": "Point", "coordinates": [10.0, 48.0]}
    feature = {"type": "Feature", "geometry": point, "properties": {"id": "a\u00adb"}}
    write_json(path, {"type": "FeatureCollection", "features": [feature]})

    with pytest.raises(
        InputError, match=r"poles\.geojson: .*: id: got .*; expected printable"
    ):
        read_sites(path, crs="EPSG:32632")


def test_names_of_a_map_lose_what_nobody_sees():
    assert clean_name("Haupt\u00adstra\u00dfe\u200b\u00a01\n") == "Hauptstra\u00dfe 1 "

    outline_m = np.array(
        [
            [0.0, 0.0],
            [9.0, 0.0],
            [0.0, 9.0],
        ]
    )
    junction = MapJunction(id="n\u200b1", name="A\u00ad/B", outline_m=outline_m)

    assert junction.id == "n1"
    assert junction.name == "A/B"

    line_m = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    fields = {"kind": "driving", "width_m": 3.0, "centreline_m": line_m}
    lane = MapLane(id="w\u20601", to_junction="n\u200b1", **fields)

    assert lane.id == "w1"
    assert lane.to_junction == "n1"


@pytest.mark.parametrize("key", ["name", "id", "kind"])
def test_a_character_that_nobody_sees_in_a_scenes_ids_is_refused(folder, key):
    _change_toml(folder, key, '"a\u200bb"')
    with pytest.raises(
        InputError, match=rf"scene\.toml: .*{key}: got .*; expected printable text"
    ):
        load_scene_folder(folder)


def _fail_while_writing(folder, error):
    """Fail once a summary is written."""
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

    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (_LIMIT_BYTES, _LIMIT_BYTES))

    done = subprocess.run(
        [sys.executable, "-m", "experiments.start", "scene", "check", str(copy)],
        capture_output=True,
        text=True,
        timeout=_LIMIT_S,
        preexec_fn=limit,
    )

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
