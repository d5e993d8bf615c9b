"""The table through lenses: by numpy, point by point, and against the pinhole's own
loops.
"""

from dataclasses import replace

import numpy as np
import pytest
from lens_cameras import MODELS, random_camera
from numpy.random import default_rng
from numpy.testing import assert_allclose
from numpy_sensing import boxes
from placed_bodies import parked_at
from tiny_worlds import WALLS

from geometry.image_boxes import box_height_px
from geometry.lenses import BrownConrady
from geometry.poses import camera_rotation
from geometry.sensors import is_shown, shown_points
from placement.detectors.geometric import GeometricDetector
from placement.visibility.build import N_POINTS
from placement.visibility.casting import build_world, cast_sight
from placement.visibility.sensing import build_sensing, cast_for

DETECTOR = GeometricDetector(min_iou=0.5, min_box_height_px=12.0, min_contrast=0.05)
MOUNT = (1.0, -2.0, 6.0)


@pytest.fixture(scope="module")
def world(build_scene, build_run):
    """Road users that jump about among walls and a van."""
    rng = default_rng(3)
    van = parked_at("parked-van", -3.0, -4.0, 30.0)
    runs = []
    for body in ("adult", "child", "cyclist"):
        places = rng.uniform(-1.0, 1.0, (120, 3))
        vru = places * [20.0, 20.0, 180.0]
        vut = vru + [4.0, 3.0, 20.0]
        run = build_run(
            vru,
            vut,
            vru=body,
            obstruction=(van,),
            name=body,
        )
        runs.append(run)

    return build_world(
        build_scene(*WALLS),
        runs,
        n_points=N_POINTS,
        seed=0,
    )


def sensing_of(world, near_m, detector=DETECTOR):
    """What is sensed from the mount."""
    sight = cast_sight(
        world,
        np.array(MOUNT),
        near_m=near_m,
        max_distance_m=1000.0,
        for_lidar=False,
    )
    mount_m = np.array(MOUNT)
    return build_sensing(world, sight, mount_m, detector)


def looks_of(mount, rng, cameras):
    """Cameras that look at random from the mount."""
    return [
        mount(
            f"{number}",
            MOUNT,
            yaw_deg=float(rng.uniform(-180.0, 180.0)),
            pitch_deg=float(rng.uniform(-60.0, 10.0)),
            camera=camera,
        )
        for number, camera in enumerate(cameras)
    ]


def evidence_of(sensing, candidate):
    """What a camera sees of every entry, by numpy, whatever its picture shows."""
    camera = candidate.sensor
    sight = sensing.sight
    pose = candidate.pose
    points = (
        sensing.world.views.points_m[sight.view_index].astype(float) - sensing.eye_m
    )
    right, down, depth = np.moveaxis(
        points @ camera_rotation(pose.yaw_deg, pose.pitch_deg), -1, 0
    )
    offsets = np.stack([right, down], axis=-1)
    depth_ahead = np.maximum(depth, 0.01)
    at = offsets / depth_ahead[..., None]
    shown_flat = shown_points(at.reshape(-1, 2), camera)
    shown = shown_flat.reshape(at.shape)
    columns, rows = np.moveaxis(shown, -1, 0)
    in_columns = (columns >= 0) & (columns <= camera.width_px)
    in_picture = in_columns & (rows >= 0)
    in_picture &= (rows <= camera.height_px) & (depth > 0.01)
    is_shown_flat = is_shown(at.reshape(-1, 2), camera)
    in_picture &= is_shown_flat.reshape(depth.shape)
    is_cut = ~in_picture.all(axis=1)
    hidden = ~sight.is_visible & ~sight.is_whole[:, None]
    out = is_cut[:, None] & ~in_picture
    seen_boxes = boxes(columns, rows, hidden | out)
    whole_boxes = boxes(columns, rows, out)
    return seen_boxes, whole_boxes


@pytest.mark.long
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(3))
def test_boxes_through_lenses_are_those_of_numpy(
    world, mount, small_camera, model, seed
):
    rng = default_rng(seed)
    looks = looks_of(
        mount, rng, [random_camera(rng, small_camera, model) for _ in range(6)]
    )
    sensing = sensing_of(world, small_camera.near_m)
    parts = list(sensing.evidence(looks))
    n_seen = 0
    for row, look in enumerate(looks):
        visible, amodal = evidence_of(sensing, look)
        high = box_height_px(visible)
        for rows, part in parts:
            some = rows == row
            entries = part.draw_index[some]
            # Of whole bodies the corners of the hull are projected: a lens bends what
            # is between.
            near = {"rtol": 1e-5, "atol": 0.2 if part is parts[0][1] else 1e-2}

            assert_allclose(part.visible_px[some], visible[entries], **near)
            assert_allclose(part.amodal_px[some], amodal[entries], **near)

            n_seen += len(entries)

        named = [part.draw_index[rows == row] for rows, part in parts]
        sure = np.flatnonzero(high > DETECTOR.min_box_height_px + 0.01)
        heights_px = high[np.concatenate(named)]

        assert np.isin(sure, np.concatenate(named)).all()
        assert (heights_px > DETECTOR.min_box_height_px - 0.01).all()

    assert n_seen > 50


def test_a_lens_of_zeros_has_the_pinholes_bits(world, mount, small_camera):
    rng = default_rng(9)
    looks = looks_of(mount, rng, [small_camera] * 5)
    zero = [
        replace(look, sensor=replace(look.sensor, lens=BrownConrady(), roll_deg=0.0))
        for look in looks
    ]

    sensing = sensing_of(world, small_camera.near_m)
    expected = sensing.packed(zero)
    found = sensing.packed(looks)

    assert np.array_equal(found, expected)
    assert sensing.packed(looks).any()


@pytest.mark.long
@pytest.mark.parametrize("model", MODELS)
def test_no_view_is_left_out_that_a_lens_detects(world, mount, small_camera, model):
    rng = default_rng(11)
    looks = looks_of(
        mount, rng, [random_camera(rng, small_camera, model) for _ in range(8)]
    )
    every = sensing_of(world, small_camera.near_m).packed(looks)

    alone = [[look] for look in looks]
    for some in alone + [looks]:
        mount_m = np.array(MOUNT)
        asked = [(look, DETECTOR) for look in some]
        sight = cast_for(world, mount_m, asked)

        sensing = build_sensing(
            world,
            sight,
            np.array(MOUNT),
            DETECTOR,
        )
        rows = [looks.index(look) for look in some]
        found = sensing.packed(some)

        assert np.array_equal(found, every[rows])

    assert every.any()


def test_evidence_says_how_much_of_a_body_the_picture_cuts_off(
    world, mount, small_camera
):
    rng = default_rng(2)
    camera = random_camera(rng, small_camera, "fisheye")

    ((_, plain), (_, part)) = sensing_of(world, 0.35).evidence(
        looks_of(mount, rng, [camera])
    )
    is_share = (part.inside_share >= 0.0) & (part.inside_share <= 1.0)

    assert (plain.inside_share == 1.0).all()
    assert is_share.all()

    size_px = [camera.width_px, camera.height_px]
    size = size_px * 2
    is_cut = part.inside_share < 1.0
    is_right_of_zero = part.amodal_px[is_cut] >= 0.0
    is_inside = part.amodal_px[is_cut] <= size

    assert is_cut.any()
    assert (is_right_of_zero & is_inside).all()
