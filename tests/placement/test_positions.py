"""Errors of ground positions, against the camera model itself."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from geometry.catalogue import pick_camera
from geometry.lidar import load_lidars
from geometry.poses import Pose, camera_rotation
from geometry.sensors import picture_rays, project_points
from placement.positions import (
    aim_sd_deg,
    camera_errors,
    lidar_errors,
)
from placement.sampling.uncertainty import BY_EYE, CALIBRATED
from scenarios.decision import load_decision_rule

RULE = replace(load_decision_rule(), body_sd_m=1e-9)
CAMERA = pick_camera("carla-ncap-rgb", "camera")
BODY_M = np.array([1.8, 0.5])


def on_ground(pixel, pose):
    """Where a point of a picture meets the plane z = 0."""
    rays = picture_rays([pixel[0]], [pixel[1]], CAMERA)
    ray = rays[0]
    R_world_camera = camera_rotation(pose.yaw_deg, pose.pitch_deg)
    way = R_world_camera @ [*ray, 1.0]
    to_ground = way * pose.position_m[2]
    foot_m = pose.position_m - to_ground / way[2]
    return foot_m[:2]


def pose_of(height_m, *, pitch_deg, yaw_deg=20.0):
    """A pose so high above the road."""
    return Pose(position_m=[3.0, -2.0, height_m], yaw_deg=yaw_deg, pitch_deg=pitch_deg)


PLACES = [
    (height_m, distance_m, off_deg)
    for height_m in (5.0, 8.0)
    for distance_m in (8.0, 20.0, 40.0)
    for off_deg in (0.0, 15.0, -25.0)
]


def foot_at(pose, distance_m, off_deg):
    """Foot of a body at a distance, and the sight towards it. [m]"""
    yaw = np.radians(pose.yaw_deg + off_deg)
    east = np.cos(yaw)
    north = np.sin(yaw)
    sight = np.array([east, north])
    foot_east_north = pose.position_m[:2] + distance_m * sight
    foot = np.append(foot_east_north, 0.0)
    return foot, sight


@pytest.mark.parametrize(("height_m", "distance_m", "off_deg"), PLACES)
def test_errors_of_the_aim_are_derivatives_of_the_camera_model(
    height_m, distance_m, off_deg
):
    pose = pose_of(height_m, pitch_deg=-15.0)
    foot, sight = foot_at(pose, distance_m, off_deg)
    left = np.array([-sight[1], sight[0]])
    found = camera_errors(
        pose.position_m,
        foot[None],
        BODY_M[None],
        rule=RULE,
        box_noise_share=0.1,
        aim_sd_deg=(0.2, 1.0),
    )
    pixels = project_points(foot[None], pose, CAMERA)
    pixel = pixels[0]
    step_deg = 1e-4

    def moved(**angles):
        """How far the place of the same pixel moves, per degree, with another aim."""
        turned_pose = replace(pose, **angles)
        now_m = on_ground(pixel, turned_pose)
        shift_m = now_m - foot[:2]
        return shift_m / step_deg

    tilted = moved(pitch_deg=pose.pitch_deg + step_deg)
    turned = moved(yaw_deg=pose.yaw_deg + step_deg)
    across = abs(turned @ left)

    # A bearing moves places across the line of sight, exactly.
    assert 0.2 * across == pytest.approx(found.aim_across_m[0], rel=1e-3)
    assert abs(turned @ sight) < 1e-3

    # A tilt is about the camera's axis across: off it, the place moves less along.
    off = np.radians(off_deg)
    along = abs(np.cos(off))

    expected = along * found.aim_along_m[0] / 1.0
    along_m = abs(tilted @ sight)

    assert along_m == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("height_m", "distance_m", "off_deg"), PLACES)
def test_errors_of_the_box_are_derivatives_of_the_camera_model(
    height_m, distance_m, off_deg
):
    pose = pose_of(height_m, pitch_deg=-15.0)
    foot, sight = foot_at(pose, distance_m, off_deg)
    share = 0.01
    found = camera_errors(
        pose.position_m,
        foot[None],
        BODY_M[None],
        rule=RULE,
        box_noise_share=share,
        aim_sd_deg=(0.2, 0.2),
    )
    head = foot + [0.0, 0.0, BODY_M[0]]

    ends = np.stack([foot, head])
    bottom, top = project_points(ends, pose, CAMERA)
    height_share = RULE.box_height_factor * share
    box_px = bottom[1] - top[1]
    off_px = height_share * box_px
    lower = (bottom[0], bottom[1] + off_px)
    new_foot = on_ground(lower, pose)
    moved = new_foot - foot[:2]
    along_m = abs(moved @ sight)

    # The formula takes angles to be small and the picture to be curved.
    assert along_m == pytest.approx(found.box_along_m[0], rel=0.12)

    # Where the body is low against the height, as the text says.
    expected = height_share * BODY_M[0] * distance_m / height_m

    assert found.box_along_m[0] == pytest.approx(expected, rel=0.35)


def test_covariances_have_the_errors_as_their_axes():
    pose = pose_of(7.0, pitch_deg=-20.0)
    foot, sight = foot_at(pose, 25.0, 10.0)

    found = camera_errors(
        pose.position_m,
        foot[None],
        BODY_M[None],
        rule=load_decision_rule(),
        box_noise_share=0.106,
        aim_sd_deg=aim_sd_deg(BY_EYE),
    )
    covariances = found.covariance_m2()
    ee, en, nn = covariances[0]
    matrix = np.array([[ee, en], [en, nn]])
    along_m = np.hypot(found.box_along_m, found.aim_along_m)
    along = along_m[0]
    across_m = np.hypot(found.box_across_m, found.aim_across_m)
    across = across_m[0]

    assert sight @ matrix @ sight == pytest.approx(along**2)

    expected = (along * across) ** 2
    determinant = np.linalg.det(matrix)

    assert determinant == pytest.approx(expected)


@pytest.mark.long
def test_drawn_errors_have_these_covariances_and_link_frames_of_a_run():
    rng = np.random.default_rng(1)
    pose = pose_of(7.0, pitch_deg=-20.0)
    foot, _ = foot_at(pose, 25.0, 10.0)
    n = 2000

    errors = camera_errors(
        pose.position_m,
        np.tile(foot, (n, 1)),
        np.tile(BODY_M, (n, 1)),
        rule=load_decision_rule(),
        box_noise_share=0.106,
        aim_sd_deg=aim_sd_deg(BY_EYE),
    )
    start = np.arange(0, n + 1, 2)
    drawn = np.concatenate(
        [
            errors.draw_m(rng.standard_normal(2), rng, start, correlation=0.8)
            for _ in range(60)
        ]
    )
    covariances = errors.covariance_m2()
    ee, en, nn = covariances[0]
    found_m2 = np.cov(drawn.T)
    expected_m2 = [[ee, en], [en, nn]]

    assert_allclose(found_m2, expected_m2, rtol=0.3)

    places = np.zeros(2)
    one = errors.draw_m(places, rng, start, correlation=0.8)
    frames_within = np.corrcoef(one[0::2, 0], one[1::2, 0])
    within = frames_within[0, 1]
    frames_between = np.corrcoef(one[1:-1:2, 0], one[2::2, 0])
    between = frames_between[0, 1]

    assert within == pytest.approx(0.8, abs=0.05)
    assert abs(between) < 0.08


def test_a_lidar_knows_the_range_and_a_camera_the_bearing():
    lidar = load_lidars()["carla-ncap-lidar"]
    pose = pose_of(7.0, pitch_deg=0.0)
    foot, _ = foot_at(pose, 30.0, 0.0)
    aims = aim_sd_deg(CALIBRATED)
    by_lidar = lidar_errors(
        pose.position_m,
        lidar,
        foot[None],
        rule=RULE,
        aim_sd_deg=aims,
    )

    by_camera = camera_errors(
        pose.position_m,
        foot[None],
        BODY_M[None],
        rule=RULE,
        box_noise_share=0.106,
        aim_sd_deg=aims,
    )

    assert by_lidar.box_along_m[0] == pytest.approx(lidar.range_noise_m, abs=1e-6)
    assert by_lidar.aim_along_m[0] < by_camera.aim_along_m[0]

    width_rad = np.radians(lidar.horizontal_fov_deg)
    spacing = width_rad / lidar.n_columns

    root_of_12 = np.sqrt(12.0)
    expected = 30.0 * spacing / root_of_12

    assert by_lidar.box_across_m[0] == pytest.approx(expected)


def test_a_camera_below_the_feet_does_not_know_how_far_away_they_are():
    below, above = (
        camera_errors(
            np.array([0.0, 0.0, height_m]),
            np.array([[20.0, 0.0, 2.0]]),
            BODY_M[None],
            rule=RULE,
            box_noise_share=0.1,
            aim_sd_deg=(0.2, 0.2),
        )
        for height_m in (1.0, 8.0)
    )

    assert 20.0 < below.box_along_m[0] < np.inf
    assert above.box_along_m[0] < 1.0
    assert below.box_across_m[0] == above.box_across_m[0]


def test_aims_are_those_of_the_uncertainty():
    assert aim_sd_deg(CALIBRATED) == (0.2, 0.2)
    assert aim_sd_deg(BY_EYE) == (1.0, 1.0)
