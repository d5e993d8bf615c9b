"""Areas of the ground that cameras see."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from junctions import protocol_scene
from refusals import refused_with
from shapely import MultiPolygon, Polygon, box
from tiny_worlds import unit_at

from geometry.catalogue import load_cameras
from geometry.errors import InputError
from geometry.lidar import load_lidars
from geometry.registry import load_entry
from geometry.study_scene import load_study_scene
from placement import forbidden_views
from placement.private_ground import (
    build_private_ground,
    load_private_ground,
    private_shares,
)

YARD = Path(__file__).parents[2] / "docs/maps/school_yard.geojson"
CAMERA = load_cameras()["carla-ncap-rgb-90"]


def unit(x, y, yaw_deg, *, pitch_deg=0.0, sensor=CAMERA):
    """A camera 6 m high."""
    name = f"{x}/{y}/{yaw_deg}"
    place_m = [x, y, 6.0]
    return unit_at(
        name,
        place_m,
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
        sensor=sensor,
    )


def garden_share(box_in_the_way):
    """Share of a garden 20 m east that a camera at the origin sees past a box."""
    area = box(20, -5, 30, 5)
    garden = build_private_ground([("garden", area)])
    scene = protocol_scene(boxes=[box_in_the_way])
    camera = unit(0, 0, 0.0)
    (share,) = private_shares(scene, [camera], garden)
    return share[0]


def test_points_stand_for_square_metres():
    ground = build_private_ground(
        [("garden", box(10, 10, 30, 20)), ("step", box(0.1, 0.1, 0.3, 0.3))]
    )
    counts = np.bincount(ground.area_index)

    assert counts.tolist() == [200, 1]
    assert ground.area_m2 == pytest.approx([200.0, 0.04])

    outer = box(0, 0, 10, 10)
    inner = box(2, 2, 8, 8)
    hole = Polygon(outer.exterior, [inner.exterior])
    apart = box(20, 0, 21, 1)
    two = MultiPolygon([hole, apart])

    points = build_private_ground([("two", two)]).points_m

    assert len(points) == 65

    is_above = (points[:, :2] > 2.0).all(axis=1)
    is_below = (points[:, :2] < 8.0).all(axis=1)
    inside = is_above & is_below

    assert not inside.any()


def test_a_camera_sees_what_is_in_its_picture_and_nothing_behind_it():
    scene = protocol_scene()
    ground = build_private_ground(
        [("garden", box(20, -5, 30, 5)), ("yard", box(-30, -5, -20, 5))]
    )
    poses = [
        unit(0, 0, 0.0),
        unit(0, 0, 180.0),
        unit(0, 0, 90.0),
        unit(0, 0, 0.0, pitch_deg=80.0),
    ]

    share = private_shares(scene, poses, ground)

    assert share.tolist() == [
        [1.0, 0.0],
        [0.0, 1.0],
        [0.0, 0.0],
        [0.0, 0.0],
    ]

    lidar = unit(0, 0, 0.0, sensor=load_lidars()["carla-ncap-lidar"])
    shares = private_shares(scene, [lidar], ground)

    assert shares.tolist() == [[0.0, 0.0]]


def test_half_of_an_area_at_the_edge_of_the_picture_counts_half():
    area = box(20, 10, 30, 40)
    ground = build_private_ground([("garden", area)])

    # The right edge of the picture, 45 degrees right of north-east, is the x axis
    # turned up to ..
    share = private_shares(
        protocol_scene(), [unit(0, 0, 0.0), unit(0, 0, 45.0)], ground
    )
    points = ground.points_m
    is_seen = points[:, 1] < points[:, 0]
    expected = is_seen.mean()  # left edge: 45 degrees from east

    assert share[0, 0] == pytest.approx(expected, abs=0.02)
    assert share[1, 0] == 1.0


def test_walls_hide():
    wall = ("wall", 15.0, 0.0, 0.5, 60.0, 8.0)
    hedge = ("hedge", 15.0, 0.0, 0.5, 60.0, 1.0)

    assert garden_share(wall) == 0.0
    assert garden_share(hedge) == 1.0


def test_without_cameras_there_are_no_shares():
    area = box(20, -5, 30, 5)
    garden = build_private_ground([("garden", area)])
    scene = replace(protocol_scene(), sites=())
    shares = private_shares(scene, [], garden)

    assert shares.shape == (0, 1)


def test_areas_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="no_look: line: got no area"):
        build_private_ground([("line", Polygon())])
    park = box(0, 0, 1000, 1000)
    with pytest.raises(InputError, match="square metres; expected at most 20,000"):
        build_private_ground([("park", park)])


def test_areas_of_another_place_are_refused():
    told = (
        r"school_yard.geojson.*: got an area [0-9,]+ km away from the junction;"
        r" expected areas with"
    )
    with pytest.raises(InputError, match=told):
        load_private_ground(YARD, load_study_scene())


def test_the_pole_that_carries_a_camera_hides_nothing():
    pole = ("pole", 0.0, 0.0, 0.2, 0.2, 9.0)
    post = ("post", 5.0, 0.0, 0.2, 0.2, 9.0)
    share = garden_share(post)

    assert garden_share(pole) == 1.0
    assert 0.5 < share < 1.0


@pytest.mark.parametrize("suffix", forbidden_views.READERS)
def test_every_reader_of_areas_loads(suffix):
    assert load_entry(forbidden_views.READERS[suffix]) is load_private_ground


def test_areas_of_an_unknown_kind_are_refused(tmp_path):
    path = tmp_path / "areas.dwg"
    with refused_with(
        f"{path}: got '.dwg'; expected one of .geojson, .json, .gpkg, .shp, .zip"
    ):
        forbidden_views.load_forbidden_areas(path, load_study_scene())
