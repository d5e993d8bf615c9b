"""Calibrations, read back by OpenCV and PyYAML, against geometry.sensors' own
projection.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from command_results import answer
from export_layouts import awkward_layout, large_layout, level_layout
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from refusals import refused_with
from scipy.spatial.transform import Rotation

from experiments.export.calibration import calibrations, quaternion
from experiments.export.opencv import to_opencv
from experiments.export.ros import camera_names, to_ros
from geometry.poses import to_world
from geometry.sensors import CameraModel, project_points
from placement.layout import Layout

HALF_PIXEL = 0.5
"""Here the middle of the first pixel is (0.5, 0.5); in OpenCV and ROS (0, 0)."""

BUILDS = [awkward_layout, pytest.param(large_layout, marks=pytest.mark.long)]


def cameras_of(layout):
    """Units that are cameras."""
    return [unit for unit in layout.units if isinstance(unit.sensor, CameraModel)]


def points_before(unit):
    """Points of the world frame in front of a unit, beside its optical axis, too."""
    rng = np.random.default_rng(7)
    return to_world(
        rng.uniform([3.0, -9.0, -5.0], [40.0, 9.0, 5.0], (20, 3)), unit.pose
    )


def expected_px(unit, points_m):
    """Where points are in a unit's picture, in OpenCV's pixels."""
    return project_points(points_m, unit.pose, unit.sensor)[:, :2] - HALF_PIXEL


def read_opencv(text, tmp_path):
    """Name and cameras of a file, read by OpenCV."""
    path = tmp_path / "cameras.yaml"
    path.write_text(text)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.isOpened()
    node = storage.getNode("cameras")
    cameras = []
    for index in range(node.size()):
        entry = node.at(index)
        texts = {"id": entry.getNode("id").string()}
        sizes = {
            key: int(entry.getNode(key).real())
            for key in ("image_width", "image_height")
        }
        matrices = {
            key: entry.getNode(key).mat()
            for key in ("camera_matrix", "distortion_coefficients", "R", "rvec", "t")
        }
        cameras.append(texts | sizes | matrices)
    name = storage.getNode("layout").string()
    storage.release()
    return name, cameras


@pytest.mark.parametrize("build", BUILDS)
def test_opencv_projects_as_the_camera_model_does(build, tmp_path):
    layout = build()
    name, cameras = read_opencv(to_opencv(layout), tmp_path)
    assert name == layout.name

    for unit, camera in zip(cameras_of(layout), cameras, strict=True):
        assert camera["id"] == unit.id

        size = (camera["image_width"], camera["image_height"])
        assert size == (unit.sensor.width_px, unit.sensor.height_px)

        points_m = points_before(unit)
        for rotation in (camera["rvec"], cv2.Rodrigues(camera["R"])[0]):
            found, _ = cv2.projectPoints(
                points_m,
                rotation,
                camera["t"],
                camera["camera_matrix"],
                camera["distortion_coefficients"],
            )
            assert_allclose(found[:, 0], expected_px(unit, points_m), atol=1e-6)


def test_the_principal_point_is_in_the_middle_of_the_image(tmp_path):
    layout = level_layout(yaw_deg=90.0)  # looks north, over the origin
    _, (camera,) = read_opencv(to_opencv(layout), tmp_path)
    found, _ = cv2.projectPoints(
        np.array(
            [
                [0.0, 10.0, 6.0],
                [1.0, 10.0, 6.0],
                [0.0, 10.0, 5.0],
            ]
        ),
        camera["rvec"],
        camera["t"],
        camera["camera_matrix"],
        None,
    )
    middle, east, below = found[:, 0]

    assert_allclose(middle, [959.5, 539.5])  # pixels 0 .. 1919 and 0 .. 1079
    assert east[0] > middle[0]
    assert below[1] > middle[1]


@pytest.mark.parametrize("build", BUILDS)
def test_ros_camera_infos_and_transforms_project_as_the_camera_model_does(build):
    layout = build()
    documents = list(yaml.safe_load_all(to_ros(layout)))
    assert len({document["camera_name"] for document in documents}) == len(documents)

    for unit, info in zip(cameras_of(layout), documents, strict=True):
        assert info["unit"] == unit.id
        assert info["image_width"] == unit.sensor.width_px
        assert info["image_height"] == unit.sensor.height_px
        assert info["distortion_model"] == "plumb_bob"

        matrices = {}
        for key, shape in (
            ("camera_matrix", (3, 3)),
            ("distortion_coefficients", (1, 5)),
            ("rectification_matrix", (3, 3)),
            ("projection_matrix", (3, 4)),
        ):
            assert (info[key]["rows"], info[key]["cols"]) == shape
            assert all(isinstance(value, float) for value in info[key]["data"])
            matrices[key] = np.array(info[key]["data"]).reshape(shape)

        np.testing.assert_array_equal(matrices["rectification_matrix"], np.eye(3))
        assert not matrices["distortion_coefficients"].any()

        frames = info["static_transform"]
        assert frames["header"]["frame_id"] == "map"
        assert frames["child_frame_id"] == f"{info['camera_name']}_optical_frame"

        move = frames["transform"]
        turn = Rotation.from_quat([move["rotation"][axis] for axis in "xyzw"])
        place_m = np.array([move["translation"][axis] for axis in "xyz"])
        points_m = points_before(unit)
        optical = np.column_stack(
            [turn.inv().apply(points_m - place_m), np.ones(len(points_m))]
        )
        projected = optical @ matrices["projection_matrix"].T
        found = projected[:, :2] / projected[:, 2:]

        assert_allclose(found, expected_px(unit, points_m), atol=1e-6)
        np.testing.assert_array_equal(
            matrices["projection_matrix"][:, :3], matrices["camera_matrix"]
        )


def test_ros_names_are_legal_and_each_is_there_once():
    one = awkward_layout().units[0]
    ids = ["A b", "a_b", "a-b", "a_b_2", "ü", "7", "ß", "<&>"]
    layout = Layout(name="names", units=tuple(replace(one, id=name) for name in ids))
    names = camera_names(calibrations(layout, "ros"))

    assert len(set(names)) == len(names) == len(ids)
    assert all(name.replace("_", "").isalnum() and name.isascii() for name in names)
    assert all(name[0].isalpha() for name in names)
    assert names[0] == "a_b"


@pytest.mark.parametrize("export", [to_opencv, to_ros])
def test_lidars_are_left_out_and_named(export):
    text = export(awkward_layout())
    assert "# Left out, for they are no cameras: lidar ä, lidar b\n" in text

    cameras = Layout(name="cameras", units=tuple(cameras_of(awkward_layout())))
    assert "Left out" not in export(cameras)


@pytest.mark.parametrize(
    ("name", "export"),
    [
        ("opencv", to_opencv),
        ("ros", to_ros),
    ],
)
def test_lidars_alone_are_refused(name, export):
    with refused_with(
        f"{name}: got a layout of LiDARs only; expected at least one camera"
    ):
        export(level_layout(0.0, kind="lidar"))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_yaml_numbers_come_back_bit_by_bit(value):
    unit = level_layout(0.0).units[0]
    pose = replace(unit.pose, position_m=[value, 0.0, 7.0])
    document = yaml.safe_load(
        to_ros(Layout(name="far", units=(replace(unit, pose=pose),)))
    )
    again = document["static_transform"]["transform"]["translation"]["x"]

    assert isinstance(again, float)
    assert again == value


@given(st.text(st.characters(exclude_categories=["C", "Z"], include_characters=" ")))
def test_yaml_texts_come_back(value):
    unit = replace(level_layout(0.0).units[0], id=value)
    text = to_ros(Layout(name="names", units=(unit,)))
    assert yaml.safe_load(text)["unit"] == value


def test_a_calibration_is_written_for_ros_with_its_lens(run, tmp_path):
    path = tmp_path / "north.xml"
    path.write_text(
        "<opencv_storage><camera_matrix><data>1743 0 934 0 1735 444 0 0"
        " 1</data></camera_matrix><distortion_coefficients><data>-0.4 0.6 0.008 0.001"
        " -0.6</data></distortion_coefficients></opencv_storage>"
    )
    asked = ("export --calibration", path, "--size 1920 1080 --quiet --format")
    out = answer(run(*asked, "ros"))
    (document,) = yaml.safe_load_all(out)

    assert document["distortion_coefficients"]["data"] == [
        -0.4,
        0.6,
        0.008,
        0.001,
        -0.6,
    ]
    assert document["unit"] == "north"
    assert document["distortion_model"] == "plumb_bob"

    (tmp_path / "north.yaml").write_text(run(*asked, "opencv")[1])
    again = run("export --calibration", tmp_path / "north.yaml", "--quiet --format ros")

    assert again == (0, out, "")
    assert run(*asked, "carla")[::2] == (
        2,
        (
            "place-rsus: --format: got carla beside --calibration; expected opencv or"
            " ros\n"
        ),
    )

    both = run(*asked, "ros", "--layout carlancap-12")
    assert (
        both[2]
        == "place-rsus: --calibration: got it with --layout; expected one of them\n"
    )


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 170.0, 190.0, 270.0])
def test_of_the_two_quaternions_of_a_rotation_the_one_with_positive_w_is_written(
    turn_deg,
):
    rotation = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()
    written = quaternion(rotation)

    assert written[3] >= 0.0
    assert_allclose(Rotation.from_quat(written).as_matrix(), rotation, atol=1e-12)
