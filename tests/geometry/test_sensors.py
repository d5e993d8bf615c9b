"""Cameras: where points are in the picture, and lenses that zoom."""

import math
from dataclasses import replace

import numpy as np
import pytest
from camera_rays import pixel_rays
from hypothesis import assume, given
from hypothesis import strategies as st
from refusals import refused_with
from strategies import cameras, numbers, points_m, poses

from geometry.poses import Pose, body_rotation
from geometry.sensors import project_points, with_fov


@given(poses(), cameras(), st.data(), numbers(0.1, 300.0))
def test_a_point_on_a_pixel_ray_projects_to_the_centre_of_that_pixel(
    pose, camera, data, depth_m
):
    column = data.draw(st.integers(0, camera.width_px - 1))
    row = data.draw(st.integers(0, camera.height_px - 1))
    (direction,) = pixel_rays([column], [row], pose, camera)
    (projected,) = project_points([pose.position_m + depth_m * direction], pose, camera)
    # The point's coordinates are rounded at 300 m: the error in pixels grows with focal
    # / depth.
    reach = 1.0 + np.abs(direction).max()
    slack_px = 1e-7 + 1e-10 * camera.focal_length_px / depth_m * reach

    assert projected[:2] == pytest.approx([column + 0.5, row + 0.5], abs=slack_px)
    assert projected[2] == pytest.approx(depth_m, abs=1e-9)


def test_focal_length_of_the_studys_camera(camera):
    half_angle = math.tan(math.radians(55.0))

    assert camera.focal_length_px == pytest.approx(672.2, abs=0.05)
    assert camera.focal_length_px == pytest.approx(960.0 / half_angle, rel=1e-15)


@given(cameras())
def test_vertical_and_diagonal_fov_are_those_of_the_image_edges(camera):
    half_width = math.tan(math.radians(0.5 * camera.horizontal_fov_deg))
    half_height = half_width * camera.height_px / camera.width_px
    half_diagonal = math.hypot(half_width, half_height)
    vertical_deg = 2.0 * math.degrees(math.atan(half_height))
    diagonal_deg = 2.0 * math.degrees(math.atan(half_diagonal))

    assert camera.vertical_fov_deg == pytest.approx(vertical_deg)
    assert camera.diagonal_fov_deg == pytest.approx(diagonal_deg)


@given(poses(), cameras(), points_m)
def test_nothing_outside_the_diagonal_cone_is_in_the_image(pose, camera, point):
    ahead = body_rotation(pose.yaw_deg, pose.pitch_deg)[:, 0]
    offset = point - pose.position_m
    away_m = np.linalg.norm(offset)
    assume(away_m > 1e-3)
    cosine = np.clip(offset @ ahead / away_m, -1.0, 1.0)
    off_axis_deg = math.degrees(math.acos(cosine))

    if off_axis_deg > 0.5 * camera.diagonal_fov_deg + 1e-6:
        ((column, row, _),) = project_points([point], pose, camera)
        is_beside = not 0.0 <= column <= camera.width_px
        is_above_or_below = not 0.0 <= row <= camera.height_px
        assert is_beside or is_above_or_below


def test_the_optical_axis_is_the_middle_and_right_is_right(camera):
    pose = Pose(position_m=[1.0, 2.0, 5.0], yaw_deg=90.0, pitch_deg=0.0)  # looks north
    ahead, east, above = project_points(
        [
            [1.0, 12.0, 5.0],
            [2.0, 12.0, 5.0],
            [1.0, 12.0, 6.0],
        ],
        pose,
        camera,
    )
    tenth = camera.focal_length_px / 10.0

    assert ahead == pytest.approx([960.0, 540.0, 10.0])
    assert east == pytest.approx([960.0 + tenth, 540.0, 10.0])
    assert above == pytest.approx([960.0, 540.0 - tenth, 10.0])


def test_what_lies_behind_the_camera_has_no_pixel(camera):
    pose = Pose(position_m=[0.0, 0.0, 5.0], yaw_deg=0.0)
    behind, beside = project_points([[-3.0, 0.0, 5.0], [0.0, 1.0, 5.0]], pose, camera)

    assert np.isnan(behind[:2]).all()
    assert behind[2] == -3.0
    assert np.isnan(beside[:2]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"width_px": 0},
            "cam.width_px: got 0; expected a whole number of pixels, > 0",
        ),
        (
            {"height_px": 1.5},
            "cam.height_px: got 1.5; expected a whole number of pixels, > 0",
        ),
        (
            {"width_px": True},
            "cam.width_px: got True; expected a whole number of pixels, > 0",
        ),
        (
            {"horizontal_fov_deg": 180.0},
            "cam.horizontal_fov_deg: got 180.0; expected 0 < degrees < 180",
        ),
        (
            {"horizontal_fov_deg": math.nan},
            "cam.horizontal_fov_deg: got nan; expected 0 < degrees < 180",
        ),
        (
            {"frame_rate_hz": 0.0},
            "cam.frame_rate_hz: got 0.0; expected a positive number",
        ),
        (
            {"frame_rate_hz": 5.0},
            (
                "cam.frame_rate_hz: got 5.0; expected at least 10: so often all "
                "units are taken to look"
            ),
        ),
        ({"near_m": math.inf}, "cam.near_m: got inf; expected a positive number"),
        (
            {"price_eur": -1.0},
            "cam.price_eur: got -1.0; expected euros, 0 to 1,000,000,000",
        ),
        (
            {"fov_range_deg": (120.0, 30.0)},
            (
                "cam.fov_range_deg: got [120.0, 30.0]; expected [low, high] in "
                "degrees, 0 < low < high < 180"
            ),
        ),
        (
            {"fov_range_deg": (30.0, 100.0)},
            (
                "cam.horizontal_fov_deg: got 110.0; expected 30 .. 100 degrees, "
                "its fov_range_deg"
            ),
        ),
    ],
)
def test_camera_model_says_what_is_wrong(camera, change, message):
    with refused_with(message):
        replace(camera, name="cam", **change)


# Varifocal lenses


@given(numbers(30.0, 120.0))
def test_a_lens_is_set_to_any_field_of_view_in_its_range(camera, fov_deg):
    zoom = replace(camera, fov_range_deg=(30.0, 120.0))
    set_to = with_fov(zoom, fov_deg, "test")

    assert set_to.horizontal_fov_deg == fov_deg
    assert with_fov(set_to, zoom.horizontal_fov_deg, "test") == zoom
    assert with_fov(set_to, fov_deg, "test") is set_to


def test_a_fixed_lens_has_one_field_of_view(camera):
    assert with_fov(camera, 110.0, "test") is camera
    with refused_with(
        "f.json: fov_deg: got 90.0; expected 110 degrees: carla-ncap-rgb has a fixed"
        " lens"
    ):
        with_fov(camera, 90.0, "f.json: fov_deg")


@pytest.mark.parametrize("fov_deg", [29.0, 121.0, math.nan])
def test_a_lens_does_not_go_beyond_its_range(camera, fov_deg):
    zoom = replace(camera, name="zoom", fov_range_deg=(30.0, 120.0))
    with refused_with(
        f"here: got {fov_deg}; expected 30 .. 120 degrees, the lens of zoom"
    ):
        with_fov(zoom, fov_deg, "here")
