"""Frames of coordinates: CARLA's, the project's, and those on earth."""

import numpy as np
import pytest
from hypothesis import given
from strategies import angles_deg, pitches_deg, points_m

from geometry.frames import (
    from_carla_points,
    from_carla_pose,
    from_carla_yaw,
    to_carla_points,
    to_carla_yaw,
    to_geographic,
)
from geometry.poses import body_rotation

TOWN05_CRS = "+proj=tmerc +lat_0=49 +lon_0=8 +datum=WGS84 +units=m"


@given(points_m)
def test_points_come_back_from_carla_bit_by_bit(point):
    world = from_carla_points(point)
    back = to_carla_points(world)
    on_ground = from_carla_points(point[:2])

    assert np.array_equal(back, point)
    assert np.array_equal(on_ground, world[:2])


@given(angles_deg)
def test_yaw_comes_back_from_carla_as_the_same_direction(yaw_deg):
    back = to_carla_yaw(from_carla_yaw(yaw_deg))
    turned = np.radians(back - yaw_deg)

    assert np.cos(turned) == pytest.approx(1.0, abs=1e-12)
    assert -180.0 < back <= 180.0


def test_carla_is_left_handed_and_the_world_is_not():
    """Its axes are east, south and up."""
    basis = from_carla_points(np.eye(3))
    assert np.linalg.det(basis) == -1.0

    east, south, up = basis
    assert np.array_equal(np.cross(east, -south), up)


@given(angles_deg, pitches_deg)
def test_a_direction_in_carla_is_the_same_direction_in_the_world(yaw_deg, pitch_deg):
    yaw, pitch = np.radians([yaw_deg, pitch_deg])
    ahead_carla = [
        np.cos(pitch) * np.cos(yaw),
        np.cos(pitch) * np.sin(yaw),
        np.sin(pitch),
    ]
    pose = from_carla_pose(
        position_m=[1.0, 2.0, 3.0],
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
    )
    ahead, _, _ = body_rotation(pose.yaw_deg, pose.pitch_deg).T
    expected = from_carla_points(ahead_carla)

    assert ahead == pytest.approx(expected, abs=1e-12)


def test_pitch_is_kept():
    pose = from_carla_pose(position_m=[0, 0, 7.5], yaw_deg=-138.75, pitch_deg=-26.64)
    assert pose.yaw_deg == 138.75
    assert pose.pitch_deg == -26.64


def test_to_geographic_agrees_with_the_radii_of_the_wgs84_ellipsoid():
    """10 m north and 10 m east, by the radii of curvature at 49 degrees north."""
    a = 6378137.0
    f = 1.0 / 298.257223563
    e2 = f * (2.0 - f)
    latitude = np.radians(49.0)
    w = np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    meridian_m = a * (1.0 - e2) / w**3
    parallel_m = a / w * np.cos(latitude)
    points = [
        [0.0, 10.0, 5.0],
        [10.0, 0.0, 5.0],
    ]
    north, east = to_geographic(points, TOWN05_CRS)
    north_deg = np.degrees(10.0 / meridian_m)
    east_deg = np.degrees(10.0 / parallel_m)

    assert north == pytest.approx([8.0, 49.0 + north_deg], abs=1e-9)
    assert east == pytest.approx([8.0 + east_deg, 49.0], abs=1e-9)
