"""Verdicts on points by kernels, against numpy array by array."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from numpy_sensing import NumpySensing
from placed_bodies import parked_at, poses_beside
from tiny_worlds import WALLS

from geometry.image_boxes import box_height_px
from geometry.lidar import load_lidars
from placement.detectors import load_planning_detector
from placement.detectors.geometric import GeometricDetector
from placement.visibility.build import N_POINTS
from placement.visibility.casting import build_world, cast_sight
from placement.visibility.sensing import build_sensing, cast_for

DETECTORS = {
    "far-sighted": GeometricDetector(
        min_iou=0.5,
        min_box_height_px=3.0,
        min_contrast=0.05,
    ),
    "geometric": load_planning_detector("geometric"),
    "response": load_planning_detector("response"),
}


@pytest.fixture(scope="module")
def world(build_scene, build_run):
    """Road users that jump about among walls and a van, by day and in fog, the VUT near
    them.
    """
    rng = default_rng(12)
    van = parked_at("parked-van", -3.0, -4.0, 30.0)
    runs = []
    for body in ("adult", "child", "cyclist"):
        vru = rng.uniform(-1.0, 1.0, (90, 3)) * [20.0, 20.0, 180.0]
        vut = poses_beside(rng, vru, 2.5, 6.0)
        free = build_run(vru, vut, vru=body, name=f"{body}/day")
        behind = build_run(
            vru,
            vut,
            vru=body,
            obstruction=(van,),
            name=f"{body}/fog",
        )
        runs += [free, replace(behind, weather="fog")]

    return build_world(
        build_scene(*WALLS),
        runs,
        n_points=N_POINTS,
        seed=0,
    )


def _sensing(world, candidates, detector, *, for_lidar=False):
    """What candidates at one mount sense."""
    position_m = candidates[0].pose.position_m
    near_m = candidates[0].sensor.near_m
    sight = cast_sight(
        world,
        position_m,
        near_m=near_m,
        max_distance_m=1000.0,
        for_lidar=for_lidar,
    )
    return build_sensing(world, sight, position_m, detector)


def _random_looks(mount, rng, small_camera, n):
    """Cameras of several lenses and sizes at one place, in any direction."""
    position_m = [*rng.uniform(-15.0, 15.0, 2), rng.uniform(0.5, 9.0)]
    return [
        mount(
            f"{number}",
            position_m,
            yaw_deg=rng.uniform(-180.0, 180.0),
            pitch_deg=rng.uniform(-60.0, 15.0),
            camera=replace(
                small_camera,
                width_px=int(rng.integers(200, 2500)),
                height_px=int(rng.integers(200, 1600)),
                horizontal_fov_deg=rng.uniform(15.0, 150.0),
            ),
        )
        for number in range(n)
    ]


@pytest.mark.long
@pytest.mark.parametrize("detector", DETECTORS)
@pytest.mark.parametrize("seed", range(4))
def test_every_verdict_is_that_of_numpy(world, mount, small_camera, detector, seed):
    looks = _random_looks(mount, default_rng(seed), small_camera, 12)
    sensing = _sensing(world, looks, DETECTORS[detector])
    found = sensing.detected(looks)
    expected = np.array([NumpySensing(sensing).detected(look) for look in looks])

    assert np.array_equal(found, expected)
    assert found.shape == (12, 2, len(sensing.distance_m))
    assert found.any()
    assert not sensing.sight.is_whole.all()


@pytest.mark.parametrize("seed", range(3))
def test_evidence_is_that_of_numpy_wherever_anything_is_seen(
    world, mount, small_camera, seed
):
    looks = _random_looks(
        mount,
        default_rng(100 + seed),
        small_camera,
        8,
    )
    sensing = _sensing(world, looks, DETECTORS["geometric"])
    parts = list(sensing.evidence(looks))
    rows_of_parts = [rows for rows, _ in parts]
    row_index = np.concatenate(rows_of_parts)

    for row, look in enumerate(looks):
        expected = NumpySensing(sensing).evidence(look)

        height_px = box_height_px(expected.visible_px)
        seen = np.flatnonzero(height_px >= sensing.detector.min_box_height_px)
        picked = [np.flatnonzero(rows == row) for rows, _ in parts]
        entries = np.concatenate(
            [
                part.draw_index[some]
                for (_, part), some in zip(parts, picked, strict=True)
            ]
        )
        sorted_entries = np.sort(entries)

        assert np.array_equal(sorted_entries, seen)

        for name in (
            "visible_px",
            "amodal_px",
            "inside_share",
            "visible_share",
            "aspect_deg",
        ):
            values = np.concatenate(
                [
                    getattr(part, name)[some]
                    for (_, part), some in zip(parts, picked, strict=True)
                ]
            )
            # Far outside the image single precision is coarse.
            assert_allclose(
                values,
                getattr(expected, name)[entries],
                rtol=1e-5,
                atol=1e-3,
            )

    assert len(row_index) > 0


def test_many_sensors_at_once_detect_what_each_does_alone(
    world, mount, small_camera, monkeypatch
):
    looks = _random_looks(mount, default_rng(5), small_camera, 6)
    lidar = replace(load_lidars()["carla-ncap-lidar"], near_m=small_camera.near_m)
    by_lidar = replace(looks[0], id="lidar", sensor=lidar)
    looks.insert(3, by_lidar)
    sensing = _sensing(
        world,
        looks,
        DETECTORS["far-sighted"],
        for_lidar=True,
    )
    together = sensing.detected(looks)

    assert together[3].any()

    detected_alone = [sensing.detected([look]) for look in looks]
    alone = np.concatenate(detected_alone)

    assert np.array_equal(together, alone)

    detected_by_numpy = [NumpySensing(sensing).detected(look) for look in looks]
    expected = np.array(detected_by_numpy)

    assert np.array_equal(together, expected)

    # In parts, as many as fit: the same.
    monkeypatch.setattr("placement.visibility.sensing._PAIRS", 1000)
    detected = sensing.detected(looks)

    assert np.array_equal(detected, together)


@pytest.mark.parametrize("detector", DETECTORS)
def test_a_camera_need_not_know_what_a_whole_body_hides_of_itself(
    world, mount, small_camera, detector
):
    looks = _random_looks(mount, default_rng(9), small_camera, 12)
    detector = DETECTORS[detector]

    some = _sensing(world, looks, detector, for_lidar=False)
    every = _sensing(world, looks, detector, for_lidar=True)
    expected = every.packed(looks)
    packed = some.packed(looks)

    assert np.array_equal(some.sight.is_whole, every.sight.is_whole)
    assert np.array_equal(some.sight.visible_share, every.sight.visible_share)
    assert np.array_equal(packed, expected)

    part = ~some.sight.is_whole
    some_points = some.sight.is_visible[part]
    every_point = every.sight.is_visible[part]
    n_some = some.sight.is_visible.sum()
    n_every = every.sight.is_visible.sum()

    assert np.array_equal(some_points, every_point)
    assert n_some > n_every


@pytest.mark.parametrize("detector", DETECTORS)
@pytest.mark.parametrize("seed", range(3))
def test_no_view_is_left_out_that_a_sensor_detects(
    world, mount, small_camera, detector, seed
):
    looks = _random_looks(
        mount,
        default_rng(20 + seed),
        small_camera,
        5,
    )
    lidar = load_lidars()["carla-ncap-lidar"]
    sensor = replace(lidar, near_m=small_camera.near_m)
    by_sensor = replace(looks[0], sensor=sensor)
    looks.insert(2, by_sensor)
    detector = DETECTORS[detector]
    position_m = looks[0].pose.position_m

    for some in (looks, looks[:1]):
        asked = [(look, detector) for look in some]
        sight = cast_for(world, position_m, asked)
        every = _sensing(world, some, detector, for_lidar=True)

        sensing = build_sensing(world, sight, position_m, detector)
        found = sensing.packed(some)
        expected = every.packed(some)

        assert np.array_equal(found, expected)
        assert found.any() or some is not looks

    n_views = len(sight.view_index)
    n_every_view = len(every.sight.view_index)

    # One camera looks one way.
    assert n_views < n_every_view
