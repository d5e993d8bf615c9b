"""The ground around a junction of a map, and things upon it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from geometry.maps.cut import build_scene, cut_out
from geometry.maps.importing import ImportOptions, import_scene
from geometry.maps.source_map import (
    MapJunction,
    MapLane,
    Pole,
    SourceMap,
    Thing,
    extrude,
)
from geometry.scene_files import load_scene_folder, save_scene
from geometry.terrain import ground_height_m, terrain_of

SQUARE_M = np.array(
    [
        [-8.0, -8.0],
        [8.0, -8.0],
        [8.0, 8.0],
        [-8.0, 8.0],
    ]
)
HOUSE_M = np.array(
    [
        [-5.0, -5.0],
        [5.0, -5.0],
        [5.0, 5.0],
        [-5.0, 5.0],
    ]
)
SLOPE = np.array([0.05, -0.02])
ZERO_M = 312.0  # of the junction's middle above the sea
RADIUS_M = 60.0


def on_slope(points, up_m=0.0):
    """Points of the slope, or above it: (n, 3)."""
    points = np.asarray(points, dtype=float)
    return np.column_stack([points, points @ SLOPE + ZERO_M + up_m])


def arm(name, ends, **junctions):
    """A lane on the slope from one place to another."""
    line = on_slope(np.linspace(*np.array(ends), 30))
    return MapLane(
        id=name,
        kind="driving",
        width_m=3.5,
        centreline_m=line,
        **junctions,
    )


def house(name, middle, bottom_m, *, kind="building"):
    """A house of 10 m by 10 m, 9 m high."""
    corners = HOUSE_M + middle
    vertices, triangles = extrude(corners, bottom_m=bottom_m, top_m=bottom_m + 9.0)
    return Thing(
        id=name,
        class_name=kind,
        vertices_m=vertices,
        triangles=triangles,
    )


def roads(*things):
    """A map of a road on the slope, with these things and a lamp beside it."""
    lanes = (
        arm("in", [(-150.0, -2.0), (-8.0, -2.0)], to_junction="7"),
        arm("out", [(8.0, -2.0), (150.0, -2.0)], from_junction="7"),
    )
    line = np.linspace(-160.0, 160.0, 81)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    lamp = Pole(id="lamp", kind="lamp post", position_m=np.array([20.0, 12.0, 0.0]))
    return SourceMap(
        name="roads.xodr",
        crs="",
        heights="absolute",
        lanes=lanes,
        junctions=(JUNCTION,),
        ground_m=on_slope(grid),
        poles=(lamp,),
        things=things,
    )


def cut(*sources):
    """What lies around the junction."""
    return cut_out(sources, JUNCTION, radius_m=RADIUS_M)


def scene_around(found):
    """The scene of what lies around the junction."""
    return build_scene(found, name="a", source_crs="", sites=(), radius_m=RADIUS_M)


def lowest_m(thing):
    """Height of a thing's lowest point."""
    return thing.vertices_m[:, 2].min()


JUNCTION = MapJunction(
    id="7",
    name="",
    outline_m=SQUARE_M,
    height_m=ZERO_M,
)


def test_ground_is_that_of_the_roads_and_everything_stands_on_it():
    aside = np.array(
        [
            [30.0, 30.0],
            [-30.0, 30.0],
        ]
    )
    ground_m = on_slope(aside)[:, 2]
    afloat = house("set", aside[0], ground_m[0] + 1.2)
    with_cellar = house("base", aside[1], ZERO_M - 4.0)
    found = cut(roads(afloat, with_cellar))

    assert found.terrain.at([40.0, -20.0]) == pytest.approx(2.4, abs=1e-3)

    # The floating house is set down on the lowest ground at its walls, the one with a
    # cellar stays.
    afloat, with_cellar = found.things
    assert lowest_m(afloat) == pytest.approx(0.9 - 5.0 * 0.07, abs=2e-3)
    assert lowest_m(with_cellar) == pytest.approx(-4.0, abs=1e-3)
    assert [skip.what for skip in found.skipped] == [
        "heights of roads.xodr",
        "1 buildings in roads.xodr",
    ]

    scene = scene_around(found)
    assert scene.instances[3].id == "lamp"

    pole = scene.vertices_m[scene.triangles[scene.triangle_instance == 3]]
    assert pole[..., 2].min() == pytest.approx(20.0 * 0.05 - 12.0 * 0.02, abs=1e-3)


def test_a_slope_of_centimetres_is_a_plane():
    source = roads()
    ground_m = source.ground_m.copy()
    ground_m[:, 2] = 0.04
    found = cut(replace(source, ground_m=ground_m))

    assert found.terrain is None

    scene = scene_around(found)
    assert terrain_of(scene) is None
    assert len(scene.triangles[scene.triangle_instance == 0]) == 2


@pytest.mark.long
def test_a_bridge_over_the_junction_is_not_its_ground():
    across = np.column_stack([np.full(60, 3.0), np.linspace(-160.0, 160.0, 60)])
    source = roads()
    with_bridge = np.concatenate([source.ground_m, on_slope(across, 7.0)])
    plain = cut(source).terrain
    bridged = cut(replace(source, ground_m=with_bridge)).terrain
    inside = np.random.default_rng(0).uniform(-40.0, 40.0, size=(200, 2))

    assert_allclose(bridged.at(inside), plain.at(inside), atol=2e-3)


@pytest.mark.long
def test_a_file_of_heights_comes_before_the_roads_and_carries_what_they_carry():
    rng = np.random.default_rng(0)
    places = rng.uniform(-180.0, 180.0, size=(8000, 2))
    hill_m = np.column_stack([places, 50.0 + 0.1 * places[:, 1]])
    hill = SourceMap(name="dem.tif", crs="", ground_m=hill_m)
    aside = np.array([30.0, 30.0])
    bottom_m = float(on_slope([aside])[0, 2]) + 5.0
    found = cut(roads(house("sign", aside, bottom_m)), hill)

    assert found.terrain.at([0.0, 40.0]) == pytest.approx(4.0, abs=0.02)
    assert lowest_m(found.things[0]) == pytest.approx(3.0 + 5.0, abs=0.05)


def test_things_above_the_ground_stand_on_its_lowest_point_and_walls_follow_it():
    corners = np.array(
        [
            [-150.0, -150.0],
            [150.0, -150.0],
            [150.0, 150.0],
            [-150.0, 150.0],
        ]
    )
    ground_m = np.column_stack([corners, 0.04 * corners[:, 1]])
    aside = np.array([20.0, 30.0])
    source = roads(house("home", aside, 0.0), house("fence", -aside, 0.0, kind="wall"))
    found = cut(replace(source, heights="above ground", ground_m=ground_m))
    home, fence = found.things

    assert lowest_m(home) == pytest.approx(0.04 * 25.0, abs=5e-3)

    heights = np.unique(fence.vertices_m[:, 2].round(2))
    assert_allclose(heights, [-1.4, -1.0, 7.6, 8.0], atol=0.011)


def test_maps_that_count_from_another_zero_are_brought_to_the_ground():
    aside = np.array(
        [
            [30.0, 30.0],
            [-30.0, 30.0],
            [-30.0, -30.0],
        ]
    )
    feet = on_slope(aside)[:, 2] + 47.3  # above the ellipsoid

    things = []
    for number, (place, foot) in enumerate(zip(aside, feet, strict=True)):
        things.append(house(f"b{number}", place, foot))

    city = SourceMap(
        name="city.gml",
        crs="",
        heights="absolute",
        things=tuple(things),
    )
    found = cut(roads(), city)

    for thing, place in zip(found.things, aside, strict=True):
        ground_m = (place - [5.0, -5.0]) @ SLOPE
        assert lowest_m(thing) == pytest.approx(ground_m, abs=5e-3)


def test_a_scene_with_terrain_comes_back_from_its_folder(tmp_path):
    scene = scene_around(cut(roads()))
    save_scene(tmp_path, scene)
    again = load_scene_folder(tmp_path)
    places = np.random.default_rng(0).uniform(-150.0, 150.0, size=(200, 2))
    heights = ground_height_m(scene, places)

    assert heights.any()
    assert_allclose(ground_height_m(again, places), heights, atol=1e-3)


# Quickly: test_ground_is_that_of_the_roads_and_everything_stands_on_it
@pytest.mark.long
def test_sites_of_a_real_map_with_slopes_stand_on_the_ground(real_input):
    path = real_input("opendrive/Town03.xodr")
    scene = import_scene([path], ImportOptions(junction="222")).scene
    feet = np.array([site.position_m for site in scene.sites])

    assert_allclose(feet[:, 2], ground_height_m(scene, feet[:, :2]), atol=1e-9)
    assert np.ptp(feet[:, 2]) > 0.3
