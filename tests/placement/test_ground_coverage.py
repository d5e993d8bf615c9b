"""Pixels per metre on the road."""

from dataclasses import replace

import numpy as np
import pytest
from junctions import protocol_scene
from tiny_worlds import unit_at

from geometry.actors import LOOK_AT_M
from geometry.catalogue import load_cameras
from geometry.lidar import load_lidars
from placement.ground import BANDS, find_ground_coverage

CAMERA = load_cameras()["carla-ncap-rgb-90"]


def unit(*, yaw_deg=0.0, pitch_deg=0.0, sensor=CAMERA, x=-30.0):
    """A camera 6 m high that looks east."""
    place_m = [x, 0.0, 6.0]
    return unit_at(
        "a",
        place_m,
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
        sensor=sensor,
    )


def at(coverage, x, y):
    """Density and east of the nearest cell. [px/m, m]"""
    row = int(np.argmin(abs(coverage.north_m - y)))
    column = int(np.argmin(abs(coverage.east_m - x)))
    return coverage.density[row, column], coverage.east_m[column]


def test_density_is_focal_length_over_depth():
    coverage = find_ground_coverage(protocol_scene(), [unit()])
    density, east_m = at(coverage, 20.0, 0.5)

    # F = 1920 / 2 / tan 45 deg.
    assert density == pytest.approx(960.0 / (east_m + 30.0))
    assert at(coverage, -40.0, 0.5)[0] == 0.0  # behind

    down = find_ground_coverage(protocol_scene(), [unit(pitch_deg=-90.0)])

    expected = 960.0 / (6.0 - LOOK_AT_M)

    assert at(down, -30.0, 0.5)[0] == pytest.approx(expected)


def test_shares_of_the_road_add_up_to_one_and_walls_take_some():
    free = find_ground_coverage(protocol_scene(), [unit()]).shares()
    wall = ("wall", -20.0, 0.0, 0.5, 30.0, 8.0)

    hidden = find_ground_coverage(protocol_scene(boxes=[wall]), [unit()]).shares()

    for shares in (free, hidden):
        assert list(shares) == [*(name for name, _ in BANDS), "coarser", "unseen"]
        assert sum(shares.values()) == pytest.approx(1.0)
        assert min(shares.values()) >= 0.0

    assert hidden["unseen"] > free["unseen"]


def test_more_cameras_see_no_less_and_lidars_take_no_pictures():
    scene = protocol_scene()
    one = find_ground_coverage(scene, [unit()])

    two = find_ground_coverage(scene, [unit(), unit(yaw_deg=180.0, x=30.0)])

    assert (two.density >= one.density).all()
    assert two.shares()["unseen"] < one.shares()["unseen"]

    lidar = unit(sensor=load_lidars()["carla-ncap-lidar"])

    assert find_ground_coverage(scene, [lidar]).shares()["unseen"] == 1.0


def test_roads_are_lanes_and_the_junction():
    coverage = find_ground_coverage(protocol_scene(), [])
    n_cells = coverage.is_road.sum()

    # A square of 23 m, and four arms of 7 m up to 45 m: 529 + 4 x 7 x 33.5 square
    # metres.
    assert n_cells == pytest.approx(529 + 4 * 7 * 33.5, rel=0.05)

    moved = replace(protocol_scene(), lanes=())

    assert find_ground_coverage(moved, []).is_road.sum() == pytest.approx(529, rel=0.1)
