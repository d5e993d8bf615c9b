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
    off_north_m = abs(coverage.north_m - y)
    row_index = np.argmin(off_north_m)
    row = int(row_index)
    off_east_m = abs(coverage.east_m - x)
    column_index = np.argmin(off_east_m)
    column = int(column_index)
    density = coverage.density[row, column]
    return density, coverage.east_m[column]


def test_density_is_focal_length_over_depth():
    coverage = find_ground_coverage(protocol_scene(), [unit()])
    density, east_m = at(coverage, 20.0, 0.5)
    behind = at(coverage, -40.0, 0.5)

    # F = 1920 / 2 / tan 45 deg.
    assert density == pytest.approx(960.0 / (east_m + 30.0))
    assert behind[0] == 0.0  # behind

    downwards = unit(pitch_deg=-90.0)
    down = find_ground_coverage(protocol_scene(), [downwards])

    expected = 960.0 / (6.0 - LOOK_AT_M)
    below = at(down, -30.0, 0.5)

    assert below[0] == pytest.approx(expected)


def test_shares_of_the_road_add_up_to_one_and_walls_take_some():
    free_coverage = find_ground_coverage(protocol_scene(), [unit()])
    free = free_coverage.shares()
    wall = ("wall", -20.0, 0.0, 0.5, 30.0, 8.0)

    walled = protocol_scene(boxes=[wall])
    hidden_coverage = find_ground_coverage(walled, [unit()])
    hidden = hidden_coverage.shares()

    for shares in (free, hidden):
        names = [*(name for name, _ in BANDS), "coarser", "unseen"]
        values = shares.values()

        assert list(shares) == names
        assert sum(values) == pytest.approx(1.0)
        assert min(shares.values()) >= 0.0

    assert hidden["unseen"] > free["unseen"]


def test_more_cameras_see_no_less_and_lidars_take_no_pictures():
    scene = protocol_scene()
    one = find_ground_coverage(scene, [unit()])

    opposite = unit(yaw_deg=180.0, x=30.0)
    two = find_ground_coverage(scene, [unit(), opposite])
    shares_of_two = two.shares()
    shares_of_one = one.shares()

    assert (two.density >= one.density).all()
    assert shares_of_two["unseen"] < shares_of_one["unseen"]

    lidar = unit(sensor=load_lidars()["carla-ncap-lidar"])
    by_lidar = find_ground_coverage(scene, [lidar])
    lidar_shares = by_lidar.shares()

    assert lidar_shares["unseen"] == 1.0


def test_roads_are_lanes_and_the_junction():
    coverage = find_ground_coverage(protocol_scene(), [])
    n_cells = coverage.is_road.sum()

    # A square of 23 m, and four arms of 7 m up to 45 m: 529 + 4 x 7 x 33.5 square
    # metres.
    assert n_cells == pytest.approx(529 + 4 * 7 * 33.5, rel=0.05)

    moved = replace(protocol_scene(), lanes=())
    coverage_moved = find_ground_coverage(moved, [])
    n_moved = coverage_moved.is_road.sum()

    assert n_moved == pytest.approx(529, rel=0.1)
