"""Rows of tables for refined poses, against the builder of tables."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng
from tiny_worlds import table_of, unit_at

from geometry.catalogue import pick_sensor
from geometry.sensors import with_fov
from placement.compute import Compute
from placement.detectors import load_planning_detector
from placement.live import LiveTable
from scenarios.runs import build_frame_axis
from scenarios.weights import weight_per_run

SENSORS = ("carla-ncap-rgb", "varifocal-1080p", "carla-ncap-lidar")


def _random_poses(n_poses, seed):
    """Cameras, zooms and LiDARs at three positions."""
    rng = default_rng(seed)
    positions = (
        [0.0, 0.0, 5.0],
        [34.0, 4.0, 6.5],
        [0.0, 0.0, 6.1],
    )
    poses = []
    for index in range(n_poses):
        sensor = pick_sensor(SENSORS[index % 3], "test")
        if index % 3 == 1:
            drawn_deg = rng.uniform(*sensor.fov_range_deg)
            fov_deg = float(drawn_deg)
            sensor = with_fov(sensor, fov_deg, "test")
        pose = unit_at(
            str(index),
            positions[rng.integers(3)],
            yaw_deg=rng.uniform(-180.0, 180.0),
            pitch_deg=rng.uniform(-45.0, 0.0),
            sensor=sensor,
        )
        poses.append(pose)

    return poses


@pytest.fixture(scope="module")
def settings(meadow):
    """By day, and by response in fog, too."""
    runs = (
        *meadow.runs,
        *(replace(run, id=f"{run.id}/fog", weather="fog") for run in meadow.runs),
    )
    foggy = replace(
        meadow,
        runs=runs,
        axis=build_frame_axis(runs, weight_per_run(runs)),
        table_detector=load_planning_detector("response"),
    )
    return {"day": meadow, "fog": foggy}


@pytest.mark.parametrize("name", ["day", "fog"])
def test_rows_are_those_of_the_builder_of_tables_in_any_order(settings, name):
    setting = settings[name]
    poses = _random_poses(36, seed=3)
    table = table_of(setting, poses)
    rows = table.detected(slice(None))
    is_seen = rows.any(axis=1)
    n_seen = is_seen.sum()

    assert n_seen > 8

    compute = Compute(workers=2)
    builder = LiveTable(setting, compute=compute, max_mounts=16)
    packed = builder.packed(poses)

    assert np.array_equal(packed, table.packed)

    order = default_rng(0).permutation(36)

    for part in np.array_split(order, 7):
        assert np.array_equal(
            builder.packed([poses[row] for row in part]), table.packed[part]
        )


def test_another_setting_of_the_lens_needs_no_new_rays_either(meadow):
    builder = LiveTable(meadow, max_mounts=16)
    zooms = _random_poses(2, seed=0)
    zoom = zooms[1]
    for fov_deg in (89.6, 26.2, 50.0):
        sensor = with_fov(zoom.sensor, fov_deg, "test")
        other_fov = replace(zoom, sensor=sensor)
        builder.packed([other_fov])

    assert builder.n_casts == 1


def test_a_sensor_that_reaches_farther_gets_its_own_rays(meadow):
    """First one that is blind beyond a few metres, then one that is not."""
    builder = LiveTable(meadow, max_mounts=16)
    (near,) = _random_poses(1, seed=0)
    coarse = replace(near.sensor, width_px=64, height_px=36)
    pose = replace(
        near.pose,
        position_m=[0.0, 0.0, 5.0],
        yaw_deg=45.0,
        pitch_deg=-15.0,
    )
    near = replace(near, pose=pose)
    coarser = replace(near, sensor=coarse)
    builder.packed([coarser])
    table = table_of(meadow, [near])
    detected = table.detected([0])
    packed = builder.packed([near])

    assert detected.any()
    assert np.array_equal(packed, table.packed)
    assert builder.n_casts == 2

    coarser = replace(near, sensor=coarse)
    builder.packed([coarser])

    assert builder.n_casts == 2
