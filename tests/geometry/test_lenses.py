"""Lenses that distort, against closed forms and OpenCV."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from strategies import cameras, numbers, poses

from geometry.calibrations import CalibratedCamera, ground_points, project_distorted
from geometry.catalogue import pick_camera
from geometry.errors import InputError
from geometry.lenses import BrownConrady, Fisheye, TsaiRadial
from geometry.poses import camera_rotation
from geometry.sensors import (
    is_shown,
    picture_rays,
    pixel_grid,
    project_points,
    shown_points,
)


def terms_within(*limits):
    """Tuples of numbers within limits."""
    return st.tuples(*[numbers(-limit, limit) for limit in limits])


TERMS = terms_within(0.4, 0.4, 0.02, 0.02, 0.2)
LENSES = st.one_of(
    TERMS.map(
        lambda k: BrownConrady(
            k1=k[0],
            k2=k[1],
            p1=k[2],
            p2=k[3],
            k3=k[4],
        )
    ),
    numbers(-0.4, 0.4).map(lambda kappa: TsaiRadial(kappa=kappa)),
    TERMS.map(
        lambda k: Fisheye(
            k1=0.5 * k[0],
            k2=0.5 * k[1],
            k3=k[2],
            k4=k[4] / 20.0,
        )
    ),
)
POINTS = np.random.default_rng(1).uniform([-8, -8, -2], [8, 8, 6], (200, 3))


CAMERA = CalibratedCamera(
    width_px=1280,
    height_px=720,
    fx_px=900.0,
    fy_px=880.0,
    cx_px=640.0,
    cy_px=360.0,
    R_camera_world=np.eye(3),
    position_m=np.zeros(3),
)


def calibrated(pose, camera, lens):
    """A pinhole camera at a pose, as a calibration with a lens."""
    return CalibratedCamera(
        width_px=camera.width_px,
        height_px=camera.height_px,
        fx_px=camera.focal_length_px,
        fy_px=camera.focal_length_px,
        cx_px=0.5 * camera.width_px,
        cy_px=0.5 * camera.height_px,
        R_camera_world=camera_rotation(pose.yaw_deg, pose.pitch_deg).T,
        position_m=pose.position_m,
        lens=lens,
    )


def matrix_of(camera):
    """Focal lengths and principal point as OpenCV takes them."""
    fx = camera.fx_px
    fy = camera.fy_px
    return np.array(
        [
            [fx, 0, camera.cx_px],
            [0, fy, camera.cy_px],
            [0, 0, 1],
        ]
    )


PLAIN_LENSES = st.sampled_from([BrownConrady(), TsaiRadial(kappa=0.0)])


@given(poses(), cameras(), PLAIN_LENSES)
def test_a_lens_without_distortion_is_the_pinhole(pose, camera, lens):
    points = POINTS * 5.0 + pose.position_m
    ours = project_distorted(points, calibrated(pose, camera, lens))
    pinhole = project_points(points, pose, camera)

    assert ours == pytest.approx(pinhole, rel=1e-9, nan_ok=True)


@given(terms_within(0.2, 0.2, 0.01, 0.01, 0.05), terms_within(3.0, 3.0, 3.0))
def test_brown_conrady_agrees_with_opencv_wherever_the_lens_keeps_the_order(
    terms, turn
):
    turn = np.array(turn)
    rotation, _ = cv2.Rodrigues(turn)
    k1, k2, p1, p2, k3 = terms
    camera = replace(
        CAMERA,
        R_camera_world=rotation,
        position_m=np.array([1.0, 2.0, 3.0]),
        lens=BrownConrady(
            k1=k1,
            k2=k2,
            p1=p1,
            p2=p2,
            k3=k3,
        ),
    )
    ours = project_distorted(POINTS, camera)
    shown = np.isfinite(ours[:, 0])
    assume(shown.any())
    offset = -rotation @ camera.position_m
    theirs, _ = cv2.projectPoints(
        POINTS[shown],
        turn,
        offset,
        matrix_of(camera),
        np.array(terms),
    )

    assert ours[shown, :2] == pytest.approx(theirs[:, 0], rel=1e-8, abs=1e-6)


def test_points_that_the_polynomial_would_fold_back_are_not_shown():
    lens = BrownConrady(k1=-0.4)  # r - 0.4 r^3 stops rising at r^2 = 1 / 1.2
    edge = (1.0 / 1.2) ** 0.5
    before, behind = lens.distort(np.outer([edge - 1e-6, edge + 1e-6], [1.0, 0.0]))

    assert np.isfinite(before).all()
    assert not np.isfinite(behind).all()


@given(numbers(-0.3, 0.5), numbers(-0.8, 0.8), numbers(-0.8, 0.8))
def test_tsais_lens_and_its_inverse_cancel(kappa, x, y):
    lens = TsaiRadial(kappa=kappa)
    points = np.array([[x, y]])
    shown = lens.distort(points)

    if np.isfinite(shown).all():
        assert lens.undistort(shown) == pytest.approx(points, abs=1e-8)
    else:
        # Beyond the largest radius that it shows, 2 / 3 of the turning point.
        turning_point = (-1.0 / (3.0 * kappa)) ** 0.5
        assert np.hypot(x, y) > 2.0 / 3.0 * turning_point - 1e-6


@given(numbers(-0.05, 0.3))
def test_a_ground_point_projects_to_its_pixel(kappa):
    camera = replace(
        CAMERA,
        width_px=768,
        height_px=576,
        fx_px=1185.0,
        fy_px=1195.0,
        cx_px=324.0,
        cy_px=283.0,
        R_camera_world=camera_rotation(30.0, -20.0).T,
        position_m=np.array([-5.0, 3.0, 7.0]),
        lens=TsaiRadial(kappa=kappa),
    )
    pixels = np.array(
        [
            [10.0, 500.0],
            [400.0, 300.0],
            [760.0, 20.0],
            [324.0, -2000.0],
        ]
    )
    points = ground_points(pixels, camera)

    assert points[:3, 2] == pytest.approx(0.0, abs=1e-9)

    again = project_distorted(points[:3], camera)
    assert again[:, :2] == pytest.approx(pixels[:3], abs=1e-6)
    assert np.isnan(points[3]).all()  # above the horizon


def test_a_matrix_that_is_no_rotation_is_refused():
    with pytest.raises(InputError, match=r"R_camera_world: got .* expected a rotation"):
        replace(CAMERA, R_camera_world=np.ones((3, 3)))


@given(terms_within(0.1, 0.1, 0.1, 0.1), terms_within(1.0, 1.0, 1.0))
@example((0.0, 0.0625, 0.0625, 1.401298464324817e-45), (0.0, 0.0, 0.0))
def test_a_fisheye_agrees_with_opencv_wherever_the_lens_keeps_the_order(terms, turn):
    turn = np.array(turn)
    rotation, _ = cv2.Rodrigues(turn)
    k1, k2, k3, k4 = terms
    camera = replace(
        CAMERA,
        fx_px=500.0,
        fy_px=490.0,
        R_camera_world=rotation,
        lens=Fisheye(
            k1=k1,
            k2=k2,
            k3=k3,
            k4=k4,
        ),
    )
    ours = project_distorted(POINTS, camera)[:, :2]
    theirs, _ = cv2.fisheye.projectPoints(
        POINTS[:, None],
        turn[:, None],
        np.zeros((3, 1)),
        matrix_of(camera),
        np.array(terms),
    )
    shown = ~np.isnan(ours[:, 0])

    assert ours[shown] == pytest.approx(theirs[shown, 0], rel=1e-7, abs=1e-6)

    # So near the axis these terms turn nothing round.
    x, y, z = (POINTS @ rotation.T).T
    straight = (z > 0) & (np.hypot(x, y) < 0.3 * z)

    assert shown[straight].all()


@given(LENSES, st.integers(0, 2**32 - 1))
def test_to_undistort_what_is_distorted_finds_the_ray_again(lens, seed):
    rng = np.random.default_rng(seed)
    radius = 0.98 * min(lens.reach, 3.0) * rng.random(200)
    turn = rng.uniform(0.0, 7.0, 200)
    rays = radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    shown = lens.distort(rays)

    assert np.isfinite(shown).all()

    found = lens.undistort(shown)
    assert np.abs(found - rays).max() < 1e-6


def test_what_is_too_far_out_for_numbers_is_not_shown():
    far = np.array([1e300])
    tsai = TsaiRadial(kappa=-0.1)

    assert np.isnan(BrownConrady(k1=0.1, k3=0.2).angle_of(1e300))
    assert np.isnan(tsai.shown_radius(far)).all()


def test_large_terms_show_the_whole_picture_and_endless_ones_are_refused():
    lens = BrownConrady(k3=1e9)
    assert lens.angle_of(lens.shown_at(0.9)) == pytest.approx(0.9)

    wide = pick_camera("carla-ncap-rgb", "name")
    small = replace(
        wide,
        lens=lens,
        width_px=64,
        height_px=36,
    )

    assert np.isfinite(pixel_grid(small)).all()

    told = r"carla-ncap-rgb.lens: got .*1e\+300.*; expected terms"
    with pytest.raises(InputError, match=told):
        replace(wide, lens=BrownConrady(k1=1e300))


@given(
    cameras(),
    LENSES,
    numbers(0.1, 0.95),
    numbers(-30.0, 30.0),
    st.integers(0, 2**32 - 1),
)
def test_every_point_of_a_picture_is_where_its_ray_is_projected(
    camera, lens, share, roll, seed
):
    most_deg = min(2.0 * np.degrees(lens.widest_rad), 150.0)
    camera = replace(
        camera,
        lens=lens,
        horizontal_fov_deg=share * most_deg,
        principal_point=(0.45, 0.52),
        pixel_aspect=1.03,
        roll_deg=roll,
    )
    size = np.array([camera.width_px, camera.height_px])
    pixels = np.random.default_rng(seed).random((100, 2)) * size
    rays = picture_rays(*pixels.T, camera)
    lit = np.isfinite(rays).all(axis=1)

    assert is_shown(rays[lit], camera).all()

    again = shown_points(rays[lit], camera)
    off = np.abs(again - pixels[lit]) / camera.focal_length_px

    assert off.max(initial=0.0) < 1e-9

    # Half a width from the middle is half of the field of view.
    edge_px = camera.middle_px[0] + 0.5 * camera.width_px
    middle = picture_rays([edge_px], [camera.middle_px[1]], camera)
    if isinstance(lens, BrownConrady) and (lens.p1 or lens.p2):
        return
    radius = np.linalg.norm(middle)
    angle = np.degrees(np.arctan(radius))

    assert angle == pytest.approx(0.5 * camera.horizontal_fov_deg, abs=1e-6)
