"""Inputs that once ended in a traceback, for ever, or in gigabytes: one line each, in
time.
"""

import io
import os
import zipfile

import numpy as np
import pytest
from json_files import write_json

from experiments import main as program
from geometry.errors import InputError
from geometry.maps import point_clouds as voxels
from geometry.maps.importing import read_map
from geometry.scene import Scene
from geometry.scene_files import THINGS_FILE
from geometry.scene_sources import SCENE_FILE, load_scene
from geometry.text_formats import load_toml
from placement.layout import load_layout
from placement.private_ground import load_private_ground
from placement.recordings import read_recording
from placement.verification.certificates import load_certificate
from placement.verification.instances import load_problem
from scenarios.weight_tables import weight_from_csv


def refusal(function, *arguments):
    """The line in which a function refuses."""
    with pytest.raises(InputError) as caught:
        function(*arguments)
    message = str(caught.value)

    assert "\n" not in message
    assert len(message) < 3000

    return message


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a = " + "[" * 100_000, "nested too deeply"),
        ("a = " + "{a = " * 100_000, "nested too deeply"),
        ("a = " + "9" * 10_000, "digits"),
    ],
    ids=["lists", "tables", "digits"],
)
def test_toml_that_overwhelms_its_reader(tmp_path, text, reason):
    path = tmp_path / "a.toml"
    path.write_text(text)

    assert reason in refusal(load_toml, path)


def test_toml_of_a_size_that_takes_minutes(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b"#" * 20_000_001)

    assert "20,000,001 bytes; expected at most 20,000,000" in refusal(load_toml, path)


def test_an_origin_of_400_digits(tmp_path):
    with pytest.raises(InputError, match="source_origin_m"):
        Scene(
            name="a",
            vertices_m=np.zeros((0, 3)),
            triangles=np.zeros((0, 3), dtype=np.int32),
            triangle_instance=np.zeros(0, dtype=np.int32),
            instances=(),
            sites=(),
            lanes=(),
            outline_m=np.array(
                [
                    [0.0, 0.0],
                    [1.0, 0.0],
                    [1.0, 1.0],
                ]
            ),
            crs="",
            source_origin_m=[10**400, 0],
        )


def packed(path, *, encrypts=False, damages=False):
    """A scene's archive with something wrong in it."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(SCENE_FILE, "# a scene\n" * 100)
        archive.writestr(THINGS_FILE, b"glTF" * 100)
    data = bytearray(buffer.getvalue())
    if encrypts:  # bit 0 of the flags, in the local header and in the directory
        for magic, offset in (
            (b"PK\x03\x04", 6),
            (b"PK\x01\x02", 8),
        ):
            data[data.index(magic) + offset] |= 1
    if damages:
        start = data.index(SCENE_FILE.encode()) + len(SCENE_FILE)
        data[start : start + 8] = b"\xff" * 8
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("wrong", ["encrypts", "damages"])
def test_scene_archives_that_cannot_be_unpacked(tmp_path, wrong):
    path = packed(tmp_path / "scene.zip", **{wrong: True})
    assert refusal(load_scene, path).endswith("expected a scene: a folder or .zip file")


@pytest.mark.parametrize("name", [SCENE_FILE, THINGS_FILE])
def test_scene_archives_that_unpack_to_far_more(tmp_path, name):
    path = tmp_path / "scene.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for each in (SCENE_FILE, THINGS_FILE):
            archive.writestr(each, b"#" * (19_000_000 if each == name else 10))

    assert "expected at most 200 times as many" in refusal(load_scene, path)


def test_cityjson_whose_type_is_an_object(tmp_path):
    path = tmp_path / "a.city.json"
    geometry = {"type": {}, "lod": "1", "boundaries": []}
    write_json(
        path,
        {
            "type": "CityJSON",
            "version": "2.0",
            "transform": {"scale": [1, 1, 1], "translate": [0, 0, 0]},
            "vertices": [[0, 0, 0]],
            "CityObjects": {"a": {"type": "Building", "geometry": [geometry]}},
        },
    )

    assert "a.geometry[0].type: got {}; expected text" in refusal(read_map, path)


@pytest.mark.parametrize(
    "vertex",
    [[1e308, 0.0], [200.0, 91.0]],
)
def test_private_ground_that_lies_nowhere(tmp_path, vertex):
    path = tmp_path / "a.geojson"
    ring = [[0.0, 0.0], vertex, [0.0, 1.0], [0.0, 0.0]]
    polygon = {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": {}, "geometry": polygon}
    write_json(path, {"type": "FeatureCollection", "features": [feature]})

    assert "coordinates that cannot be" in refusal(
        load_private_ground, path, load_scene()
    )


def test_point_clouds_whose_roofs_are_kilometres_high():
    columns = np.arange(1, 40, dtype=np.int64)
    cells = np.stack(
        [columns, columns, np.full(39, voxels.MAX_VOXELS_PER_AXIS)], axis=1
    )
    message = refusal(voxels.columns_to, np.sort(voxels.to_keys(cells)), 1, "roofs.las")

    assert message.startswith(
        "roofs.las: got walls of 40,894,386 voxels; expected at most "
    )


def test_instances_that_unpack_to_more_than_memory(tmp_path, monkeypatch):
    path = tmp_path / "instance.npz"
    np.savez_compressed(path, kind="x", packed=np.zeros(2_000_000, dtype=np.uint8))
    monkeypatch.setattr("geometry.archives.MAX_UNPACKED_BYTES", 1_000_000)

    assert (
        "bytes or more when unpacked; expected at most 1,000,000, the budget"
        in refusal(load_problem, path)
    )


def test_instances_with_something_else_under_the_name_of_an_array(tmp_path):
    path = tmp_path / "instance.npz"
    np.savez(path, kind="place-rsus/instance/1", packed=np.zeros(1))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("pose_ids.npy", b"no array")
    refusal(load_problem, path)


READERS = {
    "--within, --sensors, --detector": load_toml,
    "--layout": load_layout,
    "--scene, scene import": load_scene,
    "certificate": load_certificate,
    "instance": load_problem,
    "--weights": lambda path: weight_from_csv(path, []),
    "--no-look": lambda path: load_private_ground(path, load_scene()),
    "map": read_map,
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
@pytest.mark.parametrize("suffix", [".toml", ".json", ".zip", ".xodr"])
@pytest.mark.parametrize("reader", READERS)
def test_a_pipe_keeps_nobody_waiting(tmp_path, reader, suffix):
    path = tmp_path / f"pipe{suffix}"
    os.mkfifo(path)
    refusal(READERS[reader], path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_a_pipe_in_a_recording_keeps_nobody_waiting(tmp_path):
    for name in ("labels", "WorldData", "Eval"):
        (tmp_path / name).mkdir()
        os.mkfifo(tmp_path / name / "a.txt")
    refusal(read_recording, tmp_path)


def test_names_of_any_length_and_with_line_breaks_stay_one_line():
    error = InputError(
        "scene.toml: " + "x" * 10_000 + "\n", "a\nb", "a name\nof one line"
    )
    assert "\n" not in str(error)
    assert len(str(error)) < 700


# ---------- the last net


@pytest.fixture
def crash(monkeypatch, tmp_path, capsys):
    """Runs the program with a fault in it: exit code and what stands on stderr."""

    def fail(*arguments, **values):
        raise ZeroDivisionError("a fault of ours")

    def run(*arguments):
        monkeypatch.setattr("experiments.main.cli.invoke", fail)
        monkeypatch.setenv("TMPDIR", str(tmp_path))
        monkeypatch.setattr("tempfile.tempdir", None)

        with pytest.raises(SystemExit) as ended:
            program.main(list(arguments))
        return int(str(ended.value.code)), capsys.readouterr().err

    return run


def test_an_unexpected_error_is_one_line_and_a_file(crash, tmp_path):
    code, told = crash("--budget", "3")
    (kept,) = tmp_path.glob("place-rsus-error-*.txt")

    assert code == 70
    assert (
        told
        == "place-rsus: unexpected error in stage 'start': ZeroDivisionError: a fault"
        f" of ours; nothing was written. Please report it, with {kept}\n"
    )
    assert "Traceback" in kept.read_text()
