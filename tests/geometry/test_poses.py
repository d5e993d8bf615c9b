"""Rotations and poses: axes, angles and coordinates."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from refusals import refused_with
from strategies import angles_deg, numbers, points_m, poses

from geometry.poses import Pose, body_rotation, camera_rotation, to_world, wrap_deg


@given(angles_deg, angles_deg)
def test_rotations_are_orthonormal_and_right_handed(yaw_deg, pitch_deg):
    for rotation in (
        body_rotation(yaw_deg, pitch_deg),
        camera_rotation(yaw_deg, pitch_deg),
    ):
        product = rotation @ rotation.T
        determinant = np.linalg.det(rotation)
        assert product == pytest.approx(np.eye(3), abs=1e-12)
        assert determinant == pytest.approx(1.0, abs=1e-12)


@given(st.lists(st.tuples(angles_deg, angles_deg), min_size=1, max_size=5))
def test_rotations_of_many_angles_are_those_of_each(pairs):
    """Arrays of angles give an array of matrices."""
    yaw, pitch = np.array(pairs).T
    many = body_rotation(yaw, pitch)

    assert many.shape == (len(pairs), 3, 3)

    for rotation, (yaw_deg, pitch_deg) in zip(many, pairs, strict=True):
        alone = body_rotation(yaw_deg, pitch_deg)
        assert rotation == pytest.approx(alone, abs=1e-15)


def test_body_axes_are_ahead_left_up():
    """ISO 8855: x, y and z of a body that looks north."""
    ahead, left, up = body_rotation(90.0, 0.0).T
    assert ahead == pytest.approx([0, 1, 0], abs=1e-15)  # looking north
    assert left == pytest.approx([-1, 0, 0], abs=1e-15)  # left is west
    assert up == pytest.approx([0, 0, 1], abs=1e-15)


@given(angles_deg, numbers(-90.0, 90.0))
def test_positive_pitch_looks_up_and_left_stays_level(yaw_deg, pitch_deg):
    ahead, left, _ = body_rotation(yaw_deg, pitch_deg).T
    up = np.sin(np.radians(pitch_deg))

    assert ahead[2] == pytest.approx(up, abs=1e-12)
    assert left[2] == 0.0


def test_camera_axes_are_right_down_ahead():
    """OpenCV: x, y and z of a camera that looks east."""
    right, down, ahead = camera_rotation(0.0, 0.0).T
    assert ahead == pytest.approx([1, 0, 0], abs=1e-15)  # looking east
    assert right == pytest.approx([0, -1, 0], abs=1e-15)  # right is south
    assert down == pytest.approx([0, 0, -1], abs=1e-15)


@given(poses(), points_m, points_m)
def test_to_world_keeps_distances_and_puts_the_origin_at_the_pose(pose, a, b):
    points = np.stack([a, b, np.zeros(3)])
    world_a, world_b, origin = to_world(points, pose)
    before_m = np.linalg.norm(a - b)
    after_m = np.linalg.norm(world_a - world_b)

    assert after_m == pytest.approx(before_m, abs=1e-9)
    assert np.array_equal(origin, pose.position_m)


def test_to_world_of_a_point_ahead():
    """A body looks north: ahead is north, left is west."""
    pose = Pose(position_m=[1.0, 2.0, 3.0], yaw_deg=90.0)
    points = [
        [5.0, 0.0, 0.0],
        [0.0, 5.0, 0.0],
    ]
    ahead, left = to_world(points, pose)

    assert ahead == pytest.approx([1.0, 7.0, 3.0])
    assert left == pytest.approx([-4.0, 2.0, 3.0])


@given(numbers(-1.0e4, 1.0e4))
@example(np.nextafter(180.0, 200.0))
@example(-180.0)
@example(540.0)
@example(-0.0)
def test_wrap_deg_lies_in_the_half_open_turn_and_keeps_the_direction(angle_deg):
    wrapped = float(wrap_deg(angle_deg))
    assert -180.0 < wrapped <= 180.0

    turns = (wrapped - angle_deg) / 360.0
    assert turns == pytest.approx(round(turns), abs=1e-12)
    assert wrap_deg(wrapped) == wrapped


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"position_m": [0.0, 1.0], "yaw_deg": 0.0},
            "position_m: got shape (2,); expected shape (3,)",
        ),
        (
            {"position_m": [0.0, 1.0, 2.0], "yaw_deg": np.nan},
            "yaw_deg: got nan; expected finite numbers",
        ),
        (
            {"position_m": [0.0, 1.0, 2.0], "yaw_deg": 0.0, "pitch_deg": np.inf},
            "pitch_deg: got inf; expected finite numbers",
        ),
    ],
)
def test_pose_says_what_is_wrong(fields, message):
    with refused_with(message):
        Pose(**fields)
