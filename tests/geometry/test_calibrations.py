"""Calibrations with lenses, read, written and read again."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from readers import READERS
from scipy.spatial.transform import Rotation
from strategies import numbers, poses

from experiments.export.calibration import calibrations
from experiments.export.opencv import opencv_text
from experiments.export.ros import ros_text
from geometry.calibrations import CalibratedCamera, project_distorted, read_cameras
from geometry.catalogue import load_cameras, own_sensor_record, read_sensor
from geometry.errors import InputError
from geometry.lenses import BrownConrady, Fisheye, TsaiRadial
from geometry.poses import Pose, camera_rotation
from geometry.sensors import project_points
from placement.layout import layout_from_records, layout_records, load_layout

POSE = Pose(position_m=np.zeros(3), yaw_deg=0.0, pitch_deg=0.0)
TERMS = st.tuples(*[numbers(-0.3, 0.3)] * 5)


def camera_with(lens, pose):
    """A camera somewhere, with a picture of 1280 x 720."""
    return CalibratedCamera(
        width_px=1280,
        height_px=720,
        fx_px=900.0,
        fy_px=880.0,
        cx_px=633.0,
        cy_px=361.5,
        R_camera_world=camera_rotation(pose.yaw_deg, pose.pitch_deg).T,
        position_m=pose.position_m,
        lens=lens,
    )


def lens_of(terms, *, is_fisheye):
    """A lens with five terms, of which one of a fish-eye takes the first four."""
    first, second, third, fourth, fifth = terms
    if is_fisheye:
        return Fisheye(
            k1=first,
            k2=second,
            k3=third,
            k4=fourth,
        )
    return BrownConrady(
        k1=first,
        k2=second,
        p1=third,
        p2=fourth,
        k3=fifth,
    )


@given(pose=poses(), terms=TERMS, is_fisheye=st.booleans(), is_ros=st.booleans())
def test_what_is_written_is_read_again(
    pose, terms, is_fisheye, is_ros, tmp_path_factory
):
    lens = lens_of(terms, is_fisheye=is_fisheye)
    camera = camera_with(lens, pose)
    named = {"north 1": camera, "south": camera}
    path = tmp_path_factory.mktemp("read") / "cameras.yaml"
    if is_ros:
        text = ros_text(named)
    else:
        text = opencv_text(named, "both")
    path.write_text(text)
    found = read_cameras(path)

    assert list(found) == ["north 1", "south"]
    for one in found.values():
        assert one.lens == lens
        for name in ["width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px"]:
            assert getattr(one, name) == getattr(camera, name)
        assert one.R_camera_world == pytest.approx(camera.R_camera_world, abs=1e-9)
        assert one.position_m == pytest.approx(pose.position_m, rel=1e-9, abs=1e-9)


def test_files_of_others_are_told_apart(tmp_path):
    for kind in ("tsai", "opencv", "kitti"):
        entry, files = READERS["recorded calibrations"].seeds()[kind]
        (tmp_path / entry).write_bytes(files[entry])
    (tsai,) = read_cameras(tmp_path / "tsai.xml").values()

    assert isinstance(tsai.lens, TsaiRadial)

    (opencv,) = read_cameras(tmp_path / "intrinsic.xml", size_px=(1920, 1080)).values()
    assert opencv.lens == BrownConrady(
        k1=-0.4,
        k2=0.6,
        p1=0.008,
        p2=0.001,
        k3=-0.6,
    )
    assert (opencv.R_camera_world == np.eye(3)).all()  # the file does not say

    (kitti,) = read_cameras(tmp_path / "calib.txt", size_px=(1242, 375)).values()
    assert kitti.lens == BrownConrady()
    with pytest.raises(
        InputError, match=r"calib\.txt: got no size of pictures; expected their"
    ):
        read_cameras(tmp_path / "calib.txt")
    with pytest.raises(
        InputError, match="tsai: lens: got Tsai's radial term; expected Brown-Con"
    ):
        ros_text({"tsai": tsai})


ROS = """image_width: 1280
image_height: 720
camera_matrix: {rows: 3, cols: 3, data: [900, 0, 640, 0, 900, 360, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, 0, 0, 0, 0]}
"""


@pytest.mark.parametrize(
    ("words", "old", "new"),
    [
        ("", "plumb_bob", "rational_polynomial"),
        (
            "distortion_model: got",
            "data: [0.1, 0, 0, 0, 0]",
            "data: [0.1, 0, 0, 0, 0, 1, 0, 0]",
        ),
        (
            "got 'equidistant with 5 terms'; expected plumb_bob, or 4",
            "plumb_bob",
            "equidistant",
        ),
        (
            "distortion_coefficients: got 5 of another kind",
            "data: [0.1, ",
            "data: [[0.1], ",
        ),
        ("camera_matrix: got [[900.0, 1.0, 640.0", "[900, 0, 640", "[900, 1, 640"),
        ("fx_px: got -9.0; expected pixels, > 0", "[900, 0, 640", "[-9, 0, 640"),
        ("; expected a calibration in YAML", "360, 0, 0, 1]}", "360, 0"),
        (
            "image_height: got nothing; expected 1 finite numbers",
            "image_height: 720\n",
            "",
        ),
        ("camera_matrix: got 9 of another kind or size", "data: [900", "data: [.nan"),
        (
            "cameras: got 1; expected maps with camera_matrix",
            "1280\n",
            "1280\ncameras: [1]\n",
        ),
        ("image_width: got 1280.5; expected a whole number", "1280\n", "1280.5\n"),
        ("got no camera; expected at least one", "1280\n", "1280\ncameras: []\n"),
        (
            "a rotation",
            "plumb_bob",
            "plumb_bob\nR: [-1, 0, 0, 0, 1, 0, 0, 0, 1]\nt: [0, 0, 1]",
        ),
        (
            "translation: got nothing",
            "1280\n",
            "1280\nstatic_transform: {transform: 1}\n",
        ),
    ]
    + [
        (
            "got cameras camera, camera; expected at least one, each",
            "1280\n",
            f"1280\n---\n{ROS}",
        )
    ],
)
def test_what_is_wrong_in_a_calibration_is_one_line(words, old, new, tmp_path):
    path = tmp_path / "camera.yaml"
    assert old in ROS

    path.write_text(ROS.replace(old, new))
    if not words:
        assert read_cameras(path)["camera"].lens == BrownConrady(k1=0.1)
        return
    with pytest.raises(InputError) as caught:
        read_cameras(path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.long
@given(pose=poses(), terms=TERMS, is_fisheye=st.booleans(), roll=numbers(-20.0, 20.0))
def test_a_calibration_as_a_layout_sees_what_the_camera_saw(
    pose, terms, is_fisheye, roll, tmp_path_factory
):
    scale = 0.3 * np.ones(5)
    if not is_fisheye:
        scale *= [1.0, 1.0, 0.05, 0.05, 0.0]
    lens = lens_of(scale * terms, is_fisheye=is_fisheye)
    camera = camera_with(lens, pose)
    turn = Rotation.from_euler("z", -roll, degrees=True).as_matrix()
    camera = replace(camera, R_camera_world=turn @ camera.R_camera_world)
    assume(np.isfinite(lens.angle_of(640.0 / 900.0)))
    path = tmp_path_factory.mktemp("layout") / "cameras.yaml"
    path.write_text(opencv_text({"north": camera}, "one"))
    layout = load_layout(path)
    (unit,) = layout.units

    assert unit.sensor.lens == lens
    assert unit.sensor.focal_length_px == pytest.approx(900.0, rel=1e-9)

    ahead = camera.R_camera_world[2]
    offsets = np.random.default_rng(2).uniform(-8, 8, (300, 3))
    points = camera.position_m + 12.0 * ahead + offsets
    theirs = project_distorted(points, camera)
    ours = project_points(points, unit.pose, unit.sensor)
    # A calibration's first pixel is at 0, here at 0.5.
    both = np.isfinite(ours[:, 0])

    assert both.any()
    assert ours[both, :2] - 0.5 == pytest.approx(theirs[both, :2], abs=1e-4)

    # It is written down again as a layout, and as a calibration.
    record = own_sensor_record(unit.sensor)
    sensors = {"north": read_sensor("north", record, "camera", "here")}
    records = layout_records(layout)
    again = layout_from_records("again", records, "here", sensors=sensors)

    assert again.units[0].sensor == unit.sensor

    (found,) = calibrations(layout, "opencv").values()
    assert found.lens == lens
    assert found.K[[0, 1, 0, 1], [0, 1, 2, 2]] == pytest.approx([900, 880, 633, 361.5])
    assert found.R_camera_world == pytest.approx(camera.R_camera_world, abs=1e-6)


def test_the_pole_that_carries_a_calibrated_camera_is_not_seen(tmp_path):
    """Nothing is drawn that is as near as the catalogue says of poles and brackets."""
    path = tmp_path / "camera.yaml"
    path.write_text(ROS)
    (unit,) = load_layout(path).units

    assert {unit.sensor.near_m} == {camera.near_m for camera in load_cameras().values()}


def test_a_calibration_that_folds_before_its_edge_is_no_layout(tmp_path):
    camera = camera_with(BrownConrady(k1=-0.9), POSE)
    path = tmp_path / "folds.yaml"
    path.write_text(opencv_text({"north": camera}, "one"))

    with pytest.raises(
        InputError, match="north: distortion: got a lens that folds the picture bef"
    ):
        load_layout(path)
