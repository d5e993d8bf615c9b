"""Tables kept on disk, and all that their fingerprints depend on."""

import logging
import os
from dataclasses import replace

import numpy as np
import pytest
from changes import changed
from placed_bodies import parked_at

from geometry.lidar import load_lidar_detection, load_lidars
from geometry.weather import load_weathers
from placement import cache
from placement.cache import content_hash
from placement.detection_table import pack_table
from placement.detectors import load_planning_detector
from placement.detectors.geometric import GeometricDetector
from placement.packing import from_bytes, to_bytes
from placement.visibility import build as build_module
from placement.visibility import load_table, save_table, table_fingerprint
from scenarios.paths import StraightPath
from scenarios.runs import Run

LIDAR = load_lidars()["carla-ncap-lidar"]
THIN_FOG = replace(load_weathers()["fog"], visibility_m=51.0)
DETECTOR = GeometricDetector(min_iou=0.5, min_box_height_px=20.0)
FINGERPRINT = "0123456789abcdef" * 2


@pytest.fixture
def inputs(build_scene, build_run, mount, small_camera):
    """Arguments of ``table_fingerprint``, by name."""
    tele = replace(small_camera, name="tele", horizontal_fov_deg=40.0)
    poses = np.column_stack(
        [np.linspace(5.0, 9.0, 11), np.zeros(11), np.full(11, 90.0)]
    )
    return {
        "scene": build_scene(((4, -6, 0), (4.3, 1, 2.2))),
        "candidates": [
            mount("a", [0.0, 0.0, 5.0]),
            mount("b", [0.0, 0.0, 5.0], camera=tele),
            mount("c", [1.0, 0.0, 5.0], camera=tele),
        ],
        "runs": (
            build_run(poses, poses + [5.0, 5.0, 0.0]),
            build_run(poses, vru="cyclist"),
        ),
        "detector": DETECTOR,
        "seed": 0,
    }


def _fingerprint(inputs):
    """Fingerprint of inputs."""
    return table_fingerprint(
        inputs["scene"],
        inputs["candidates"],
        inputs["runs"],
        inputs["detector"],
        seed=inputs["seed"],
    )


@pytest.fixture
def stored(inputs, axis_of, tmp_path):
    """A table, its file, and what ``load_table`` needs besides."""
    axis = axis_of(inputs["runs"])
    detected = np.random.default_rng(0).random((3, axis.n_frames)) < 0.5
    table = pack_table(tuple(c.id for c in inputs["candidates"]), axis, detected)
    path = tmp_path / "new" / "folder" / "table.npz"
    save_table(path, table, fingerprint=FINGERPRINT)
    return table, path, {"candidates": inputs["candidates"], "axis": axis}


def _load(stored, fingerprint=FINGERPRINT):
    """The stored table, read back."""
    _, path, rest = stored
    return load_table(path, fingerprint=fingerprint, **rest)


def test_runs_that_were_kept_on_disk_have_the_same_fingerprint(inputs):
    van = parked_at("parked-van", 3.0, 2.0)
    runs = tuple(replace(run, obstruction=(van,)) for run in inputs["runs"])

    # With a van of its own.
    kept = from_bytes(to_bytes(runs[0]), Run, classes=(StraightPath,))

    assert kept.obstruction[0].actor is not van.actor

    fresh = _fingerprint(inputs | {"runs": runs})

    assert _fingerprint(inputs | {"runs": (kept, runs[1])}) == fresh
    assert _fingerprint(inputs) != fresh


# There and back


def test_a_table_comes_back_as_it_was_saved(stored, caplog):
    table, path, rest = stored
    loaded = _load(stored)

    assert np.array_equal(loaded.packed, table.packed)
    assert loaded.pose_ids == table.pose_ids
    assert loaded.axis is rest["axis"]
    assert [file.name for file in path.parent.iterdir()] == ["table.npz"]
    assert not caplog.records


def test_a_table_that_is_not_there_is_not_worth_a_line(stored, caplog):
    _, path, rest = stored
    missing = path.with_name("other.npz")

    assert load_table(missing, fingerprint=FINGERPRINT, **rest) is None

    missing = path.parent / "no" / "folder" / "other.npz"

    assert load_table(missing, fingerprint=FINGERPRINT, **rest) is None
    assert not caplog.records


# Files that cannot be trusted


def _assert_one_line(caplog, path):
    """One line of warning names the file."""
    (record,) = caplog.records
    assert record.levelno == logging.WARNING

    message = record.getMessage()

    assert message.startswith(f"cached detection table not used, made anew: {path}: ")
    assert "\n" not in message


def _foreign(**arrays):
    """Writes arrays of something else."""

    def write(path):
        np.savez(path, **arrays)

    return write


def _single_array(path):
    """Write an array that is no archive."""
    with path.open("wb") as file:
        np.save(file, np.zeros(3))


DAMAGES = {
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("table", encoding="utf-8"),
    "truncated": lambda path: path.write_bytes(path.read_bytes()[:-40]),
    "half": lambda path: path.write_bytes(
        path.read_bytes()[: path.stat().st_size // 2]
    ),
    "foreign": _foreign(packed=np.zeros((3, 3), np.uint8)),
    "foreign format": _foreign(
        format="place-rsus/table/0",
        fingerprint=FINGERPRINT,
        packed=np.zeros((3, 3), np.uint8),
    ),
    "single array": _single_array,
    "pickled": _foreign(format=np.array([{}], dtype=object)),
    "wrong shape": _foreign(
        format=build_module._FORMAT,
        fingerprint=FINGERPRINT,
        packed=np.zeros((3, 99), np.uint8),
    ),
    "folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_or_foreign_file_is_not_used_and_logged_once(stored, caplog, damage):
    _, path, _ = stored
    DAMAGES[damage](path)

    assert _load(stored) is None

    _assert_one_line(caplog, path)


def test_a_table_made_from_other_inputs_is_not_used(stored, caplog):
    _, path, _ = stored

    assert _load(stored, fingerprint="f" * 32) is None

    _assert_one_line(caplog, path)

    assert caplog.messages[0].endswith(": made from other inputs")


def _saved_again(**changes):
    """The file saved anew by a program that knows no hash of its content, or not
    which.
    """

    def write(path):
        with np.load(path) as stored:
            arrays = dict(stored)
        np.savez(
            path, **{**arrays, **{name: new(arrays) for name, new in changes.items()}}
        )

    return write


def _turned(arrays):
    """Bits of which one is turned."""
    bits = arrays["packed"].copy()
    bits[0, 0] ^= 1
    return bits


@pytest.mark.parametrize(
    "change",
    [
        {"packed": lambda arrays: np.zeros_like(arrays["packed"])},
        {"packed": _turned},
        {"packed": lambda arrays: arrays["packed"][::-1]},
        {
            "packed": _turned,
            "content": lambda arrays: content_hash(
                {"packed": _turned(arrays)}, "f" * 32
            ),
        },
    ],
    ids=["zeros", "a bit", "rows", "the hash of another fingerprint"],
)
def test_bits_that_were_changed_and_saved_under_the_same_name_are_not_used(
    stored, caplog, change
):
    _, path, _ = stored
    _saved_again(**change)(path)

    assert _load(stored) is None

    _assert_one_line(caplog, path)

    assert caplog.messages[0].endswith(": its content is not what was written")


@pytest.mark.skipif(
    not hasattr(os, "getuid") or os.getuid() != 0, reason="only root gives away"
)
def test_a_table_of_another_user_is_not_believed(stored, caplog):
    _, path, _ = stored
    os.chown(path, 4321, 4321)

    assert _load(stored) is None

    _assert_one_line(caplog, path)

    assert "another user may have written it" in caplog.messages[0]


# Folders that cannot be written to


def test_a_full_disk_is_logged_and_leaves_the_old_table(stored, caplog, monkeypatch):
    table, path, _ = stored
    before = path.read_bytes()

    def full(file, **arrays):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache.np, "savez", full)

    save_table(path, table, fingerprint="f" * 32)

    assert caplog.messages == [
        f"detection table not cached: {path}: No space left on device"
    ]
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["table.npz"]  # noqa: PTH208


# Fingerprints


def _parked(name, *, north_m=3.0, yaw_deg=10.0):
    """One body that is parked, 3 m east."""
    return (parked_at(name, 3.0, north_m, yaw_deg),)


def _nudged(values):
    """Values off by 1e-6."""
    return values + 1e-6


def _without_last_triangle(scene):
    """The scene but for its last triangle."""
    return replace(
        scene,
        triangles=scene.triangles[:-1],
        triangle_instance=scene.triangle_instance[:-1],
    )


def changes(actors):
    """Paths of what is changed, and what it is then; each change by itself."""
    van = _parked("parked-van")
    return [
        ("scene.vertices_m", _nudged),
        ("scene", _without_last_triangle),
        ("scene.outline_m", _nudged),
        ("candidates.pose.position_m", _nudged),
        ("candidates.pose.yaw_deg", 1e-9),
        ("candidates.pose.pitch_deg", 1e-9),
        ("candidates.id", "z"),
        ("candidates", lambda candidates: candidates[::-1]),
        ("candidates", lambda candidates: candidates[:-1]),
        ("candidates.sensor.horizontal_fov_deg", 89.999),
        ("candidates.sensor.width_px", 641),
        ("candidates.sensor.height_px", 361),
        ("candidates.sensor.near_m", 0.36),
        ("candidates.sensor", LIDAR),
        ("candidates.sensor", replace(LIDAR, reference_probability=0.91)),
        ("detector.min_iou", 0.51),
        ("detector.min_contrast", 0.01),
        ("detector.min_box_height_px", 20.001),
        ("detector", load_planning_detector("response")),
        ("seed", 1),
        ("runs.time_s", _nudged),
        ("runs.vut_position_m", _nudged),
        ("runs.vut_yaw_deg", _nudged),
        ("runs.vru_position_m", _nudged),
        ("runs.vru_yaw_deg", _nudged),
        ("runs.vru_shape", lambda shape: (shape + 1) % 8),
        ("runs.encounter.vru", actors["cyclist"]),
        ("runs.encounter.vru.shapes.vertices_m", _nudged),
        *(("runs.weather", weather) for weather in ("night", "rain", "fog")),
        ("runs.obstruction", van),
        ("runs.obstruction", _parked("parked-van", north_m=3.1)),
        ("runs.obstruction", _parked("parked-van", yaw_deg=11.0)),
        ("runs.obstruction", _parked("parked-car-small")),
        ("runs", lambda runs: (runs[0], replace(runs[1], obstruction=van))),
        ("runs", lambda runs: runs[::-1]),
    ]


def test_all_changes_have_fingerprints_of_their_own(inputs, actors):
    asked = changes(actors)
    found = [_fingerprint(changed(inputs, *change)) for change in asked]

    assert len({*found, _fingerprint(inputs)}) == len(asked) + 1


def test_what_a_weather_does_is_part_of_the_fingerprint(inputs, monkeypatch):
    inputs["runs"] = tuple(replace(run, weather="fog") for run in inputs["runs"])
    before = _fingerprint(inputs)
    monkeypatch.setattr(build_module, "pick_weather", lambda name, where: THIN_FOG)

    assert _fingerprint(inputs) != before


def test_what_it_takes_to_find_somebody_by_lidar_is_part_of_the_fingerprint(
    inputs, monkeypatch
):
    with_lidar = changed(inputs, "candidates.sensor", LIDAR)
    by_camera = _fingerprint(inputs)
    by_lidar = _fingerprint(with_lidar)
    other = replace(
        load_lidar_detection(), min_points={"pedestrian": 1, "child": 1, "cyclist": 1}
    )

    monkeypatch.setattr(build_module, "load_lidar_detection", lambda: other)

    assert _fingerprint(inputs) == by_camera
    assert _fingerprint(with_lidar) != by_lidar


def test_the_number_of_points_is_part_of_the_fingerprint(inputs, monkeypatch):
    before = _fingerprint(inputs)
    monkeypatch.setattr(build_module, "N_POINTS", 161)

    assert _fingerprint(inputs) != before


def test_a_fingerprint_is_the_same_for_equal_inputs(inputs):
    before = _fingerprint(inputs)

    assert len(before) == 32
    assert int(before, 16) >= 0

    scene = inputs["scene"]
    vertices_m = scene.vertices_m.copy()
    equal = {
        **inputs,
        "scene": replace(scene, vertices_m=vertices_m),
        "candidates": [
            replace(c, pose=replace(c.pose), sensor=replace(c.sensor))
            for c in inputs["candidates"]
        ],
        "runs": tuple(replace(run, time_s=run.time_s.copy()) for run in inputs["runs"]),
        "detector": replace(DETECTOR),
    }

    assert _fingerprint(equal) == before


def test_cameras_of_the_same_name_are_told_apart(inputs, small_camera):
    a, b, c = inputs["candidates"]
    other = replace(small_camera, horizontal_fov_deg=50.0)
    turned = replace(b, sensor=other)
    found = set()
    for third in (small_camera, other):
        candidates = [a, turned, replace(c, sensor=third)]
        found.add(_fingerprint(inputs | {"candidates": candidates}))

    assert len(found) == 2
