"""The study's junction, and scenes of boxes from files."""

import copy
import math
import re
import tomllib
from collections import Counter
from importlib.resources import files
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from refusals import refused_with

from geometry import study_scene
from geometry.actors import load_actors
from geometry.footprints import footprint_corners, footprint_separation
from geometry.frames import from_carla_points, to_geographic
from geometry.scene import CLASS_NAMES, containing_instance
from geometry.study_scene import load_box_scene, load_study_scene

FILE = files("geometry") / "data" / "town05.toml"
TOWN05 = tomllib.loads(FILE.read_text(encoding="utf-8"))
KNOWN = ", ".join(CLASS_NAMES)
NORTH = np.array([1.0, -1.0])  # CARLA's frame is left-handed

# Town05's road network, as published with CARLA and Scenic. CARLA's frame.
GOLDEN_LANES = {
    "-1_0": ("driving", 3.5, [(-61.76, -4.31), (-111.4, -4.18)]),
    "5_0": ("parking", 3.0, [(-118.26, -25.88), (-117.91, -76.82)]),
    "-50_1": (
        "driving",
        3.5,
        [
            (-131.61, 13.85),
            (-131.58, 15.83),
            (-131.48, 27.38),
        ],
    ),
    "2_1": ("driving", 3.5, [(-177.29, 2.98), (-143.17, 2.89)]),
}
GOLDEN_OUTLINE = np.array(
    [
        [-111.41, -5.93],
        [-116.36, 13.66],
        [-113.05, -6.12],
    ]
)


@pytest.fixture(scope="module")
def scene():
    """The study's junction."""
    return load_study_scene()


def vertices_of(scene, index):
    """Vertices of an instance, (n, 3)."""
    triangles = scene.triangles[scene.triangle_instance == index]
    return scene.vertices_m[np.unique(triangles)]


def of_class(scene, *names):
    """Indices of instances of some classes."""
    found = []
    for index, instance in enumerate(scene.instances):
        if instance.class_name in names:
            found.append(index)
    return found


# The study's junction


def test_the_study_scene_has_28_sites_on_poles_and_mast_arms(scene):
    kinds = Counter(site.kind for site in scene.sites)
    assert kinds == {"lamp post": 20, "traffic light": 4, "mast arm": 4}
    assert {site.capacity_units for site in scene.sites} == {2}


def test_every_site_is_at_the_thing_it_is_named_after_and_within_its_height(scene):
    by_id = {instance.id: index for index, instance in enumerate(scene.instances)}
    for site in scene.sites:
        vertices = vertices_of(scene, by_id[site.id])
        apart = np.linalg.norm(vertices[:, :2] - site.position_m[:2], axis=1)
        assert apart.min() < 0.15, site.id
        assert site.position_m[2] == 0.0
        assert site.height_range_m[1] <= vertices[:, 2].max(), site.id


def test_sites_are_in_the_open_air_at_their_lowest_and_highest(scene):
    for site in scene.sites:
        for height_m in site.height_range_m:
            position = site.position_m + [0.0, 0.0, height_m]
            assert containing_instance(scene, position) is None, site.id


def test_lanes_and_outline_are_the_published_ones_flipped_to_the_north(scene):
    lanes = {lane.id: lane for lane in scene.lanes}
    for name, (kind, width_m, points) in GOLDEN_LANES.items():
        lane = lanes[name]
        assert lane.kind == kind
        assert lane.width_m == width_m
        assert_array_equal(lane.centreline_m, np.array(points) * NORTH)

    assert_array_equal(scene.outline_m[[0, 6, 24]], GOLDEN_OUTLINE * NORTH)
    # All others, from the file.
    assert len(scene.lanes) == len(TOWN05["lanes"]) == 32

    for entry in TOWN05["lanes"]:
        line = np.array(entry["centreline_m"]) * NORTH
        assert_array_equal(lanes[entry["id"]].centreline_m, line)

    assert_array_equal(scene.outline_m, np.array(TOWN05["outline_m"]) * NORTH)


def test_the_junction_lies_where_the_maps_reference_says(scene):
    ((lon_deg, lat_deg),) = to_geographic(scene.outline_m.mean(axis=0)[None], scene.crs)
    # 126.5 m west of 8 deg E, 1 m south of 49 deg N.
    assert lon_deg == pytest.approx(8.0 - 126.5 / 73_170.0, abs=1e-5)
    assert lat_deg == pytest.approx(49.0, abs=2e-5)


def test_the_study_scene_is_made_of_closed_bodies_on_the_road(scene):
    assert {instance.class_name for instance in scene.instances} <= set(CLASS_NAMES)
    assert set(np.unique(scene.triangle_instance)) == set(range(len(scene.instances)))
    for index, instance in enumerate(scene.instances):
        if instance.class_name == "ground":
            continue
        triangles = scene.triangles[scene.triangle_instance == index]
        a, b, c = np.moveaxis(scene.vertices_m[triangles], 1, 0)
        # Outward normals of a closed mesh: positive volume, and the areas cancel out.
        normals = np.cross(b - a, c - a)

        assert np.einsum("ij,ij->", a - a.mean(axis=0), normals) > 0.0
        assert normals.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-6)

        lowest_m = vertices_of(scene, index)[:, 2].min()
        assert lowest_m > -1e-9
        if instance.class_name != "traffic light":
            assert lowest_m < 0.2


def test_walls_go_from_end_to_end_and_close_the_corner(scene):
    for index, entry in zip(of_class(scene, "wall"), TOWN05["walls"], strict=True):
        ends = from_carla_points([entry["from_m"], entry["to_m"]])
        half = 0.5 * entry["thickness_m"]
        vertices = vertices_of(scene, index)
        low = [*(ends.min(axis=0) - half), 0.0]
        high = [*(ends.max(axis=0) + half), entry["height_m"]]

        assert vertices.min(axis=0) == pytest.approx(low)
        assert vertices.max(axis=0) == pytest.approx(high)


def test_no_solid_body_of_the_study_scene_stands_in_another(scene):
    solid = of_class(scene, "building", "wall", "parked vehicle")
    for first, second in combinations(solid, 2):
        instances = (scene.instances[first], scene.instances[second])
        if {one.class_name for one in instances} == {"wall"}:
            continue  # walls meet at corners
        a = vertices_of(scene, first)[:, :2]
        b = vertices_of(scene, second)[:, :2]
        a_then_b = b.min(axis=0) - a.max(axis=0)
        b_then_a = a.min(axis=0) - b.max(axis=0)

        assert max(*a_then_b, *b_then_a) > 0.0, instances


@pytest.mark.long
def test_every_path_of_every_run_is_clear_of_all_that_stands(scene, runs):
    """Footprints of VUT and VRU in every frame against the boxes of all instances."""
    nearest_m = np.inf
    for index, instance in enumerate(scene.instances):
        vertices = vertices_of(scene, index)
        if instance.class_name == "ground" or vertices[:, 2].min() > 2.0:
            continue  # mast arms hang above all heads
        low = vertices[:, :2].min(axis=0)
        high = vertices[:, :2].max(axis=0)
        length_m, width_m = high - low
        middle = 0.5 * (low + high)
        box = footprint_corners(
            middle,
            0.0,
            length_m=length_m,
            width_m=width_m,
        )
        for run in runs:
            for body, position, yaw in (
                (run.encounter.vut, run.vut_position_m, run.vut_yaw_deg),
                (run.encounter.vru, run.vru_position_m, run.vru_yaw_deg),
            ):
                # All along the way, not only in the frames: from first to last, swept.
                begin = position[0]
                end = position[-1]
                swept = footprint_corners(
                    0.5 * (begin + end),
                    yaw[0],
                    length_m=body.length_m + np.linalg.norm(end - begin),
                    width_m=body.width_m,
                )
                separation_m = float(footprint_separation(swept, box))
                nearest_m = min(nearest_m, separation_m)
    assert nearest_m > 0.08


# Files

TEXT = """
name = "small"
frame = "carla-left-handed"
crs = "EPSG:25832"
outline_m = [[0.0, 0.0], [10.0, 0.0], [10.0, 5.0]]

[ground]
position_m = [5.0, 2.0]
half_size_m = 20.0

[[buildings]]
id = "house"
position_m = [10.0, 4.0]
yaw_deg = 30.0
length_m = 6.0
width_m = 4.0
height_m = 8.0

[[walls]]
id = "wall"
from_m = [0.0, 0.0]
to_m = [0.0, 5.0]
thickness_m = 0.2
height_m = 2.0

[[parked_rows]]
id = "row"
first_m = [0.0, -9.0]
yaw_deg = 0.0
gap_m = 1.0
actors = ["parked-van", "parked-car-small"]

[[poles]]
id = "pole"
kind = "lamp post"
position_m = [3.0, -4.0]
radius_m = 0.1
height_m = 9.0
height_range_m = [4.0, 8.0]
capacity_units = 1

[[mast_arms]]
id = "arm"
from_m = [3.0, -4.0]
to_m = [3.0, 0.0]
height_m = 7.0
radius_m = 0.05
height_range_m = [6.0, 6.5]
capacity_units = 3

[[lanes]]
id = "lane"
kind = "driving"
width_m = 3.5
centreline_m = [[0.0, 1.0], [9.0, 2.0]]
"""
SMALL = tomllib.loads(TEXT)


@pytest.fixture
def load(monkeypatch):
    """A function that makes the scene of a table, as if it stood in small.toml."""

    def build(table):
        monkeypatch.setattr(study_scene, "load_toml", lambda path: table)
        return load_box_scene(Path("small.toml"))

    return build


def changed(key, value):
    """The table with another value at a `key` like "walls.0.height_m".

    None leaves it out.
    """
    table = copy.deepcopy(SMALL)
    *path, last = [int(part) if part.isdigit() else part for part in key.split(".")]
    entry = table

    for part in path:
        entry = entry[part]
    if value is None:
        del entry[last]
    else:
        entry[last] = value
    return table


def test_a_scene_is_built_as_its_file_says(load):
    scene = load(SMALL)
    assert scene.name == "small"
    assert scene.crs == "EPSG:25832"
    assert [(i.id, i.class_name) for i in scene.instances] == [
        ("ground", "ground"),
        ("house", "building"),
        ("wall", "wall"),
        ("row-1", "parked vehicle"),
        ("row-2", "parked vehicle"),
        ("pole", "lamp post"),
        ("arm", "traffic light"),
    ]
    assert [(s.id, s.kind, s.capacity_units) for s in scene.sites] == [
        ("pole", "lamp post", 1),
        ("arm", "mast arm", 3),
    ]
    # Sites: the pole's foot, and the road below the free end of the arm.
    assert scene.sites[0].position_m.tolist() == [3.0, 4.0, 0.0]
    assert scene.sites[1].position_m.tolist() == [3.0, 0.0, 0.0]
    assert scene.outline_m.tolist() == [[0.0, 0.0], [10.0, 0.0], [10.0, -5.0]]
    assert scene.lanes[0].centreline_m.tolist() == [[0.0, -1.0], [9.0, -2.0]]

    house = vertices_of(scene, 1) - [10.0, -4.0, 0.0]
    turn = np.radians(-30.0)  # clockwise in CARLA's frame
    along = house[:, :2] @ [np.cos(turn), np.sin(turn)]

    assert (along.min(), along.max()) == pytest.approx((-3.0, 3.0))

    x, y, z = vertices_of(scene, 5).T
    assert (z.min(), z.max()) == pytest.approx((0.0, 9.0))
    assert np.hypot(x - 3.0, y - 4.0).max() == pytest.approx(0.1)

    _, y, z = vertices_of(scene, 6).T
    assert (y.min(), y.max()) == pytest.approx((0.0, 4.0))
    assert z.mean() == pytest.approx(7.0, abs=1e-6)


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("name", None, "got nothing; expected a value"),
        ("crs", "", "got ''; expected text"),
        ("frame", None, "got nothing; expected a value"),
        ("frame", "enu", "got 'enu'; expected one of carla-left-handed"),
        ("ground", None, "got nothing; expected a value"),
        ("ground", 3, "got 3; expected a table"),
        ("ground.half_size_m", 0.0, "got 0.0; expected a number > 0"),
        ("outline_m", None, "got nothing; expected a value"),
        ("outline_m", [[1.0, 2.0, 3.0]], "got shape (1, 3); expected shape (-1, 2)"),
        (
            "outline_m",
            [[1.0, 2.0], [3.0]],
            "got [[1.0, 2.0], [3.0]]; expected numbers of shape (-1, 2)",
        ),
        ("walls", 3, "got 3; expected a list"),
        ("walls.0", 3, "got 3; expected a table"),
        ("walls.0.id", None, "got nothing; expected a value"),
        ("walls.0.height_m", None, "got nothing; expected a value"),
        ("walls.0.height_m", -2.0, "got -2.0; expected a number > 0"),
        ("walls.0.thickness_m", math.nan, "got nan; expected a finite number"),
        ("walls.0.to_m", [1.0], "got shape (1,); expected shape (2,)"),
        ("walls.0.to_m", [1.0, math.inf], "got [1.0, inf]; expected finite numbers"),
        ("walls.0.to_m", "there", "got 'there'; expected a list"),
        ("buildings.0.yaw_deg", "north", "got 'north'; expected a finite number"),
        ("buildings.0.length_m", 0.0, "got 0.0; expected a number > 0"),
        ("parked_rows.0.gap_m", -0.5, "got -0.5; expected a number, at least 0"),
        ("parked_rows.0.gap_m", True, "got True; expected a finite number"),
        ("poles.0.radius_m", -1.0, "got -1.0; expected a number > 0"),
        ("poles.0.kind", None, "got nothing; expected a value"),
        ("poles.0.capacity_units", None, "got nothing; expected a value"),
        ("poles.0.height_range_m", [8.0], "got shape (1,); expected shape (2,)"),
        ("mast_arms.0.height_m", None, "got nothing; expected a value"),
        ("lanes.0.width_m", 0.0, "got 0.0; expected a number > 0"),
        ("lanes.0.centreline_m", [1.0, 2.0], "got shape (2,); expected shape (-1, 2)"),
    ],
)
def test_a_scene_file_says_which_field_is_wrong(load, key, value, told):
    where = re.sub(r"\.(\d)", r"[\1]", key)
    with refused_with(f"small.toml: {where}: {told}"):
        load(changed(key, value))


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        (
            "poles.0.kind",
            "tree",
            f"instance pole.class_name: got 'tree'; expected one of {KNOWN}",
        ),
        (
            "poles.0.capacity_units",
            0,
            "site pole.capacity_units: got 0; expected a whole number, 1 to 1,000",
        ),
        (
            "poles.0.height_range_m",
            [8.0, 5.0],
            "site pole.height_range_m: got [8.0, 5.0]; expected [low, high] in metres,"
            " 0 < low <= high",
        ),
        (
            "walls.0.id",
            "house",
            "small: instances: got 'house'; expected every id once",
        ),
        ("mast_arms.0.id", "pole", "small: sites: got 'pole'; expected every id once"),
    ],
)
def test_what_the_values_of_a_scene_check_is_said_in_their_words(
    load, key, value, message
):
    with refused_with(message):
        load(changed(key, value))


def test_an_unknown_body_in_a_row_lists_the_known_ones(load):
    known = ", ".join(sorted(load_actors()))
    row = changed("parked_rows.0.actors", ["parked-van", "bus"])
    with refused_with(
        f"small.toml: parked_rows[0].actors[1]: got 'bus'; expected one of {known}"
    ):
        load(row)


def test_a_file_that_is_not_there_is_named(tmp_path):
    path = tmp_path / "none.toml"
    with refused_with(
        f"{path}: got No such file or directory; expected a readable file"
    ):
        load_box_scene(path)
