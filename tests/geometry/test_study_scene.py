import copy
import json
import tomllib
from importlib.resources import files

import numpy as np
import pytest
from refusals import refused_with

from geometry.actors import load_actors
from geometry.footprints import footprint_corners, footprint_separation
from geometry.frames import from_carla_points, to_geographic
from geometry.scene import CLASS_NAMES, containing_instance
from geometry.study_scene import load_box_scene, load_study_scene

TOWN05 = tomllib.loads(
    (files("geometry") / "data" / "town05.toml").read_text(encoding="utf-8")
)

# Town05's road network, as published with CARLA and Scenic. CARLA's frame.
GOLDEN_LANES = {
    "-1_0": ("driving", 3.5, [[-61.76, -4.31], [-111.4, -4.18]]),
    "5_0": ("parking", 3.0, [[-118.26, -25.88], [-117.91, -76.82]]),
    "-50_1": ("driving", 3.5, [[-131.61, 13.85], [-131.58, 15.83], [-131.48, 27.38]]),
    "2_1": ("driving", 3.5, [[-177.29, 2.98], [-143.17, 2.89]]),
}
GOLDEN_OUTLINE = {0: [-111.41, -5.93], 6: [-116.36, 13.66], 24: [-113.05, -6.12]}


@pytest.fixture(scope="module")
def scene():
    return load_study_scene()


def _vertices(scene, index):
    return scene.vertices_m[
        np.unique(scene.triangles[scene.triangle_instance == index])
    ]


def _of_class(scene, *names):
    return [
        index
        for index, instance in enumerate(scene.instances)
        if instance.class_name in names
    ]


# The study's junction


def test_the_study_scene_has_28_sites_on_poles_and_mast_arms(scene):
    kinds = [site.kind for site in scene.sites]
    assert len(scene.sites) == 28
    assert {kind: kinds.count(kind) for kind in kinds} == {
        "lamp post": 20,
        "traffic light": 4,
        "mast arm": 4,
    }
    assert {site.capacity_units for site in scene.sites} == {2}


def test_every_site_is_at_the_thing_it_is_named_after_and_within_its_height(scene):
    by_id = {instance.id: index for index, instance in enumerate(scene.instances)}
    for site in scene.sites:
        vertices = _vertices(scene, by_id[site.id])
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
        assert lanes[name].kind == kind
        assert lanes[name].width_m == width_m
        assert (
            lanes[name].centreline_m.tolist() == (np.array(points) * [1, -1]).tolist()
        )
    for index, point in GOLDEN_OUTLINE.items():
        assert scene.outline_m[index].tolist() == [point[0], -point[1]]
    # All others, from the file.
    assert len(scene.lanes) == len(TOWN05["lanes"]) == 32
    for entry in TOWN05["lanes"]:
        assert np.array_equal(
            lanes[entry["id"]].centreline_m,
            np.array(entry["centreline_m"]) * [1.0, -1.0],
        )
    assert np.array_equal(scene.outline_m, np.array(TOWN05["outline_m"]) * [1.0, -1.0])


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
        assert np.einsum("ij,ij->", a - a.mean(axis=0), np.cross(b - a, c - a)) > 0.0
        assert np.cross(b - a, c - a).sum(axis=0) == pytest.approx(
            np.zeros(3), abs=1e-6
        )
        assert _vertices(scene, index)[:, 2].min() > -1e-9
        if instance.class_name != "traffic light":
            assert _vertices(scene, index)[:, 2].min() < 0.2


def test_walls_go_from_end_to_end_and_close_the_corner(scene):
    for index, entry in zip(_of_class(scene, "wall"), TOWN05["walls"], strict=True):
        ends = from_carla_points([entry["from_m"], entry["to_m"]])
        half = 0.5 * entry["thickness_m"]
        vertices = _vertices(scene, index)
        assert vertices.min(axis=0) == pytest.approx([*(ends.min(axis=0) - half), 0.0])
        assert vertices.max(axis=0) == pytest.approx(
            [*(ends.max(axis=0) + half), entry["height_m"]]
        )


def test_no_solid_body_of_the_study_scene_stands_in_another(scene):
    solid = _of_class(scene, "building", "wall", "parked vehicle")
    boxes = {index: _vertices(scene, index) for index in solid}
    for first in solid:
        for second in solid:
            walls = {scene.instances[i].class_name for i in (first, second)} == {"wall"}
            if first >= second or walls:  # walls meet at corners
                continue
            a = boxes[first][:, :2]
            b = boxes[second][:, :2]
            apart = np.maximum(
                a.min(axis=0) - b.max(axis=0), b.min(axis=0) - a.max(axis=0)
            )
            assert apart.max() > 0.0, (scene.instances[first], scene.instances[second])


@pytest.mark.long
def test_every_path_of_every_run_is_clear_of_all_that_stands(scene, runs):
    """Footprints of VUT and VRU in every frame against the boxes of all instances."""
    nearest_m = np.inf
    for index, instance in enumerate(scene.instances):
        vertices = _vertices(scene, index)
        if instance.class_name == "ground" or vertices[:, 2].min() > 2.0:
            continue  # mast arms hang above all heads
        low = vertices[:, :2].min(axis=0)
        high = vertices[:, :2].max(axis=0)
        length_m, width_m = high - low
        box = footprint_corners(
            0.5 * (low + high), 0.0, length_m=length_m, width_m=width_m
        )
        for run in runs:
            for body, position, yaw in (
                (run.encounter.vut, run.vut_position_m, run.vut_yaw_deg),
                (run.encounter.vru, run.vru_position_m, run.vru_yaw_deg),
            ):
                # All along the way, not only in the frames: from first to last, swept.
                middle = 0.5 * (position[0] + position[-1])
                swept = footprint_corners(
                    middle,
                    yaw[0],
                    length_m=body.length_m + np.hypot(*(position[-1] - position[0])),
                    width_m=body.width_m,
                )
                separation_m = float(footprint_separation(swept, box))
                nearest_m = min(nearest_m, separation_m)
    assert nearest_m > 0.08


# Files

SMALL = {
    "name": "small",
    "frame": "carla-left-handed",
    "crs": "EPSG:25832",
    "outline_m": [[0.0, 0.0], [10.0, 0.0], [10.0, 5.0]],
    "ground": {"position_m": [5.0, 2.0], "half_size_m": 20.0},
    "buildings": [
        {
            "id": "house",
            "position_m": [10.0, 4.0],
            "yaw_deg": 30.0,
            "length_m": 6.0,
            "width_m": 4.0,
            "height_m": 8.0,
        }
    ],
    "walls": [
        {
            "id": "wall",
            "from_m": [0.0, 0.0],
            "to_m": [0.0, 5.0],
            "thickness_m": 0.2,
            "height_m": 2.0,
        }
    ],
    "parked_rows": [
        {
            "id": "row",
            "first_m": [0.0, -9.0],
            "yaw_deg": 0.0,
            "gap_m": 1.0,
            "actors": ["parked-van", "parked-car-small"],
        }
    ],
    "poles": [
        {
            "id": "pole",
            "kind": "lamp post",
            "position_m": [3.0, -4.0],
            "radius_m": 0.1,
            "height_m": 9.0,
            "height_range_m": [4.0, 8.0],
            "capacity_units": 1,
        }
    ],
    "mast_arms": [
        {
            "id": "arm",
            "from_m": [3.0, -4.0],
            "to_m": [3.0, 0.0],
            "height_m": 7.0,
            "radius_m": 0.05,
            "height_range_m": [6.0, 6.5],
            "capacity_units": 3,
        }
    ],
    "lanes": [
        {
            "id": "lane",
            "kind": "driving",
            "width_m": 3.5,
            "centreline_m": [[0.0, 1.0], [9.0, 2.0]],
        }
    ],
}


def _toml(table) -> str:
    """Numbers, texts, lists and tables as TOML: JSON's values inline."""
    lines = []
    for key, value in table.items():
        text = json.dumps(value).replace("NaN", "nan").replace("Infinity", "inf")
        lines.append(
            f"{key} = {_inline(value) if isinstance(value, dict | list) else text}"
        )
    return "\n".join(lines)


def _inline(value) -> str:
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(f"{key} = {_inline(item)}" for key, item in value.items())
            + "}"
        )
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return json.dumps(value).replace("NaN", "nan").replace("Infinity", "inf")


def _load(tmp_path, table):
    path = tmp_path / "small.toml"
    path.write_text(_toml(table), encoding="utf-8")
    return load_box_scene(path)


def _changed(key, value):
    """`key` like "walls.0.height_m"; None leaves it out."""
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


def test_a_scene_is_built_as_its_file_says(tmp_path):
    scene = _load(tmp_path, SMALL)
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

    house = _vertices(scene, 1) - [10.0, -4.0, 0.0]
    turn = np.radians(-30.0)  # clockwise in CARLA's frame
    along = house[:, :2] @ [np.cos(turn), np.sin(turn)]
    assert (along.min(), along.max()) == pytest.approx((-3.0, 3.0))
    pole = _vertices(scene, 5)
    arm = _vertices(scene, 6)
    assert (pole[:, 2].min(), pole[:, 2].max()) == pytest.approx((0.0, 9.0))
    assert np.hypot(*(pole[:, :2] - [3.0, 4.0]).T).max() == pytest.approx(0.1)
    assert (arm[:, 1].min(), arm[:, 1].max()) == pytest.approx((0.0, 4.0))
    assert arm[:, 2].mean() == pytest.approx(7.0, abs=1e-6)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("name", None, "{}: name: got nothing; expected a value"),
        ("crs", "", "{}: crs: got ''; expected text"),
        ("frame", None, "{}: frame: got nothing; expected a value"),
        ("frame", "enu", "{}: frame: got 'enu'; expected one of carla-left-handed"),
        ("ground", None, "{}: ground: got nothing; expected a value"),
        ("ground", 3, "{}: ground: got 3; expected a table"),
        (
            "ground.half_size_m",
            0.0,
            "{}: ground.half_size_m: got 0.0; expected a number > 0",
        ),
        ("outline_m", None, "{}: outline_m: got nothing; expected a value"),
        (
            "outline_m",
            [[1.0, 2.0, 3.0]],
            "{}: outline_m: got shape (1, 3); expected shape (-1, 2)",
        ),
        (
            "outline_m",
            [[1.0, 2.0], [3.0]],
            "{}: outline_m: got [[1.0, 2.0], [3.0]]; expected numbers of shape (-1, 2)",
        ),
        ("walls", 3, "{}: walls: got 3; expected a list"),
        ("walls", [3], "{}: walls[0]: got 3; expected a table"),
        ("walls.0.id", None, "{}: walls[0].id: got nothing; expected a value"),
        (
            "walls.0.height_m",
            None,
            "{}: walls[0].height_m: got nothing; expected a value",
        ),
        (
            "walls.0.height_m",
            -2.0,
            "{}: walls[0].height_m: got -2.0; expected a number > 0",
        ),
        (
            "walls.0.thickness_m",
            float("nan"),
            "{}: walls[0].thickness_m: got nan; expected a finite number",
        ),
        (
            "walls.0.to_m",
            [1.0],
            "{}: walls[0].to_m: got shape (1,); expected shape (2,)",
        ),
        (
            "walls.0.to_m",
            [1.0, float("inf")],
            "{}: walls[0].to_m: got [1.0, inf]; expected finite numbers",
        ),
        ("walls.0.to_m", "there", "{}: walls[0].to_m: got 'there'; expected a list"),
        (
            "buildings.0.yaw_deg",
            "north",
            "{}: buildings[0].yaw_deg: got 'north'; expected a finite number",
        ),
        (
            "buildings.0.length_m",
            0.0,
            "{}: buildings[0].length_m: got 0.0; expected a number > 0",
        ),
        (
            "parked_rows.0.gap_m",
            -0.5,
            "{}: parked_rows[0].gap_m: got -0.5; expected a number, at least 0",
        ),
        (
            "parked_rows.0.gap_m",
            True,
            "{}: parked_rows[0].gap_m: got True; expected a finite number",
        ),
        (
            "poles.0.radius_m",
            -1.0,
            "{}: poles[0].radius_m: got -1.0; expected a number > 0",
        ),
        ("poles.0.kind", None, "{}: poles[0].kind: got nothing; expected a value"),
        (
            "poles.0.kind",
            "tree",
            "instance pole.class_name: got 'tree'; expected one of "
            + ", ".join(CLASS_NAMES),
        ),
        (
            "poles.0.capacity_units",
            None,
            "{}: poles[0].capacity_units: got nothing; expected a value",
        ),
        (
            "poles.0.capacity_units",
            0,
            "site pole.capacity_units: got 0; expected a whole number, 1 to 1,000",
        ),
        (
            "poles.0.height_range_m",
            [8.0, 5.0],
            (
                "site pole.height_range_m: got [8.0, 5.0]; "
                "expected [low, high] in metres, 0 < low <= high"
            ),
        ),
        (
            "poles.0.height_range_m",
            [8.0],
            "{}: poles[0].height_range_m: got shape (1,); expected shape (2,)",
        ),
        (
            "mast_arms.0.height_m",
            None,
            "{}: mast_arms[0].height_m: got nothing; expected a value",
        ),
        (
            "lanes.0.width_m",
            0.0,
            "{}: lanes[0].width_m: got 0.0; expected a number > 0",
        ),
        (
            "lanes.0.centreline_m",
            [1.0, 2.0],
            "{}: lanes[0].centreline_m: got shape (2,); expected shape (-1, 2)",
        ),
        (
            "walls.0.id",
            "house",
            "small: instances: got 'house'; expected every id once",
        ),
        ("mast_arms.0.id", "pole", "small: sites: got 'pole'; expected every id once"),
    ],
)
def test_a_scene_file_says_what_is_wrong(tmp_path, key, value, message):
    with refused_with(message.format("small.toml")):
        _load(tmp_path, _changed(key, value))


def test_an_unknown_body_in_a_row_lists_the_known_ones(tmp_path):
    with refused_with(
        "small.toml: parked_rows[0].actors[1]: got 'bus'; expected one of "
        + ", ".join(sorted(load_actors()))
    ):
        _load(tmp_path, _changed("parked_rows.0.actors", ["parked-van", "bus"]))


def test_a_file_that_is_not_there_is_named(tmp_path):
    path = tmp_path / "none.toml"
    with refused_with(
        f"{path}: got No such file or directory; expected a readable file"
    ):
        load_box_scene(path)
