from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.actors import PlacedActor, pick_actor
from geometry.poses import Pose
from geometry.sensors import CameraModel, pixel_rays
from placement.evaluator.render import (
    STATIC,
    VRU,
    VUT,
    build_body,
    build_lens,
    build_static,
    cast_crops,
    crop_boxes,
    render_view,
)

HERE = np.zeros(3)
LEVEL = Pose(position_m=np.array([0.0, 0.0, 0.9]), yaw_deg=0.0)
ADULT = build_body(pick_actor("adult", "test").shapes[0])
TINY = CameraModel(
    name="tiny",
    width_px=64,
    height_px=48,
    horizontal_fov_deg=100.0,
    frame_rate_hz=10.0,
    near_m=0.35,
    price_eur=0.0,
)


@pytest.fixture
def nothing(build_scene):
    return build_static(build_scene(), (), middle_m=np.zeros(2)), HERE


def test_depth_of_a_plane_is_that_of_the_pixel_rays(build_scene, camera, block):
    pose = Pose(position_m=np.array([3.0, -2.0, 7.0]), yaw_deg=35.0, pitch_deg=-40.0)
    middle_m = np.array([20.0, 10.0])
    ground = build_static(
        build_scene(((-300.0, -300.0, -1.0), (300.0, 300.0, 0.0))), (), middle_m=middle_m
    )
    view = render_view(
        build_lens(pose, camera),
        static=(ground, np.array([*middle_m, 0.0])),
        vru=(build_body(block.shapes[0]), np.array([-50.0, -50.0, 0.0])),
    )
    rows, columns = np.indices(view.depth_m.shape)
    rays = pixel_rays(columns.ravel(), rows.ravel(), pose, camera)
    expected = -7.0 / rays[:, 2].reshape(view.depth_m.shape)
    assert np.allclose(view.depth_m, expected, rtol=1e-4)
    assert (view.instance == STATIC).all()


@pytest.mark.parametrize("distance_m", [2.0, 5.0, 12.0, 30.0])
def test_unobstructed_vru_has_the_pinhole_size(nothing, camera, block, distance_m):
    view = render_view(
        build_lens(LEVEL, camera),
        static=nothing,
        vru=(build_body(block.shapes[0]), np.array([distance_m, 0.0, 0.0])),
    )
    x_min, y_min, x_max, y_max = view.amodal_box_px
    assert (view.visible_box_px == view.amodal_box_px).all()
    scale = camera.focal_length_px / (distance_m - 0.25)
    assert x_max - x_min == pytest.approx(min(1.0 * scale, camera.width_px), abs=1.5)
    assert y_max - y_min == pytest.approx(min(1.8 * scale, camera.height_px), abs=1.5)


@pytest.mark.parametrize(
    ("low", "high", "side"),
    [
        ((5.0, 0.0, 0.0), (6.0, 9.0, 9.0), 0),  # the wall's right edge is ahead: left half hidden
        ((5.0, -9.0, 0.0), (6.0, 0.0, 9.0), 2),
        ((5.0, -9.0, 0.0), (6.0, 9.0, 0.9), 3),  # its top is as high as the lens
        ((5.0, -9.0, 0.9), (6.0, 9.0, 9.0), 1),
    ],
)
def test_wall_up_to_the_optical_axis_halves_the_box(build_scene, camera, block, low, high, side):
    wall = build_static(build_scene((low, high)), (), middle_m=np.zeros(2))
    view = render_view(
        build_lens(LEVEL, camera),
        static=(wall, HERE),
        vru=(build_body(block.shapes[0]), np.array([10.0, 0.0, 0.0])),
    )
    expected = view.amodal_box_px.copy()
    expected[side] = 0.5 * (camera.width_px if side % 2 == 0 else camera.height_px)
    assert np.abs(view.visible_box_px - expected).max() <= 1.0
    assert (view.depth_m[view.instance == VRU] > 9.0).all()


def test_box_ends_at_the_border_of_the_image(nothing, camera, block):
    left_edge = np.array([10.0, 10.0 - 0.25, 0.0])  # the image's edge runs at 45 degrees
    view = render_view(
        build_lens(LEVEL, camera), static=nothing, vru=(build_body(block.shapes[0]), left_edge)
    )
    assert view.amodal_box_px[0] == 0.0
    assert view.amodal_box_px[2] < 0.1 * camera.width_px


def test_nothing_is_drawn_behind_the_lens(nothing, camera, block):
    view = render_view(
        build_lens(LEVEL, camera),
        static=nothing,
        vru=(build_body(block.shapes[0]), np.array([-5.0, 0.0, 0.0])),
    )
    assert not view.amodal_box_px.any()
    assert not view.visible_box_px.any()
    assert np.isinf(view.depth_m).all()


@pytest.mark.parametrize(("near_m", "is_drawn"), [(0.35, False), (0.2, True)])
def test_nothing_is_drawn_nearer_than_the_nearest_distance(
    build_scene, camera, block, near_m, is_drawn
):
    lens = build_lens(LEVEL, replace(camera, near_m=near_m))
    plate = build_static(
        build_scene(((0.24, -0.05, 0.85), (0.26, 0.05, 0.95))), (), middle_m=np.zeros(2)
    )
    (shape,) = block.shapes
    speck = replace(shape, vertices_m=shape.vertices_m * [0.04, 0.1, 0.02] + [0.0, 0.0, 0.88])
    vru = (build_body(block.shapes[0]), np.array([10.0, 0.0, 0.0]))
    behind_plate = render_view(lens, static=(plate, HERE), vru=vru)
    assert (behind_plate.instance == VRU).any() != is_drawn
    near_vru = render_view(
        lens, static=(plate, HERE), vru=(build_body(speck), np.array([0.3, 0.0, 0.0]))
    )
    assert near_vru.amodal_box_px.any() == is_drawn


@pytest.mark.parametrize(("vut_distance_m", "is_hidden"), [(6.0, True), (16.0, False)])
def test_vut_hides_what_is_behind_it_only(nothing, camera, block, vut, vut_distance_m, is_hidden):
    view = render_view(
        build_lens(LEVEL, camera),
        static=nothing,
        vru=(build_body(block.shapes[0]), np.array([11.0, 0.0, 0.0])),
        vut=(build_body(vut.shapes[0]), np.array([vut_distance_m, 0.0, 90.0])),
    )
    assert (view.instance == VUT).any()
    lower = view.visible_box_px[3] < view.amodal_box_px[3]
    assert lower == is_hidden


def test_crop_renders_the_same_pixels_as_the_whole_image(nothing, camera, block):
    lens = build_lens(LEVEL, camera)
    vru = (build_body(block.shapes[0]), np.array([10.0, 1.0, 30.0]))
    whole = render_view(lens, static=nothing, vru=vru)
    part = render_view(lens, static=nothing, vru=vru, crop_px=(100, 60, 200, 130))
    assert (part.instance == whole.instance[60:130, 100:200]).all()
    assert (part.depth_m == whole.depth_m[60:130, 100:200]).all()
    assert (part.amodal_box_px == whole.amodal_box_px).all()


def test_parked_body_stands_where_a_box_of_the_scene_would(build_scene, camera, block):
    house = ((12.0, 2.0, 0.0), (14.0, 6.0, 3.0))
    parked = PlacedActor(actor=block, pose=Pose(position_m=np.array([5.0, 0.5, 0.0]), yaw_deg=90.0))
    as_box = ((4.5, 0.25, 0.0), (5.5, 0.75, 1.8))
    statics = [
        build_static(build_scene(house), (parked, parked), middle_m=np.zeros(2)),
        build_static(build_scene(house, as_box), (), middle_m=np.zeros(2)),
    ]
    depths = [
        render_view(
            build_lens(LEVEL, camera),
            static=(static, HERE),
            vru=(build_body(block.shapes[0]), np.array([-5.0, 0.0, 0.0])),
        ).depth_m
        for static in statics
    ]
    assert np.allclose(*depths, rtol=1e-5)
    assert {4.5, 12.0} <= set(np.unique(depths[0].round(3)).tolist())


@pytest.mark.parametrize("left_m", [-6.0, 6.0])
def test_body_beside_the_lens_needs_no_ray_though_it_reaches_behind(camera, block, left_m):
    body = build_body(block.shapes[0])
    crops, depths = crop_boxes(
        build_lens(LEVEL, camera), body.hull_m, np.array([[0.0, left_m, 0.0], [0.0, 0.0, 0.0]])
    )
    assert (depths[:, 0] < 0.0).all()
    assert not crops[0].any()
    assert crops[1].tolist() == [0, 0, camera.width_px, camera.height_px]  # around the lens


@settings(max_examples=100)
@given(
    ahead_m=st.floats(-2.0, 6.0),
    left_m=st.floats(-4.0, 4.0),
    up_m=st.floats(0.1, 4.0),
    yaw_deg=st.floats(-180.0, 180.0),
    pitch_deg=st.floats(-89.0, 30.0),
)
def test_crop_holds_every_pixel_of_the_body(ahead_m, left_m, up_m, yaw_deg, pitch_deg):
    lens = build_lens(
        Pose(position_m=np.array([0.0, 0.0, up_m]), yaw_deg=0.0, pitch_deg=pitch_deg), TINY
    )
    poses = np.array([[ahead_m, left_m, yaw_deg]])
    whole = np.array([[0, 0, TINY.width_px, TINY.height_px]])
    depth = cast_crops(lens, ADULT, poses, whole)[0].reshape(TINY.height_px, TINY.width_px)
    crops, depths = crop_boxes(lens, ADULT.hull_m, poses)
    x_min, y_min, x_max, y_max = crops[0]
    is_hit = np.isfinite(depth)
    assert is_hit[y_min:y_max, x_min:x_max].sum() == is_hit.sum()
    assert (depth[is_hit] >= depths[0, 0] - 1e-4).all()
    assert (depth[is_hit] <= depths[0, 1] + 1e-4).all()
