"""What is written and shown where the ground is not flat."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from defusedxml import ElementTree
from interactive_pages import build_layout

from experiments.cli.answers import _units_table
from experiments.export.cpm import to_cpm
from experiments.export.geojson import to_geojson
from experiments.export.kml import to_kml
from experiments.export.openscenario import to_openscenario
from experiments.export.places import placed_records
from experiments.parts.units import unit_table
from experiments.results.record import build_unit_records
from geometry.errors import InputError
from geometry.poses import Pose
from geometry.scene_files import save_scene
from geometry.scene_sources import load_scene
from geometry.study_scene import load_study_scene
from geometry.terrain import GROUND, Terrain, terrain_of
from placement.candidates import above_ground
from placement.layout import Layout, check_layout, layout_records

ZERO_M = 371.25


def hillside(scene):
    """A scene whose ground rises by 8 % to the east and 3 % to the north, 0 in the
    middle.
    """
    east = np.arange(-227.0, -26.0, 5.0)
    north = np.arange(-100.0, 101.0, 5.0)
    height_m = 0.08 * (east[None, :] + 127.0) + 0.03 * north[:, None]
    vertices, triangles = Terrain(east_m=east, north_m=north, height_m=height_m).mesh()
    names = [thing.class_name for thing in scene.instances]
    is_solid = scene.triangle_instance != names.index(GROUND)
    return replace(
        scene,
        vertices_m=np.concatenate([vertices, scene.vertices_m]),
        triangles=np.concatenate(
            [triangles, scene.triangles[is_solid] + len(vertices)]
        ),
        triangle_instance=np.concatenate(
            [
                np.full(len(triangles), names.index(GROUND)),
                scene.triangle_instance[is_solid],
            ]
        ),
        zero_height_m=ZERO_M,
    )


def lifted(layout, scene):
    """Units of a layout as high above the ground as they were above the plane."""
    terrain = terrain_of(scene)
    units = []
    for unit in layout.units:
        up_m = terrain.at(unit.pose.position_m[:2])
        pose = replace(unit.pose, position_m=unit.pose.position_m + [0.0, 0.0, up_m])
        units.append(replace(unit, pose=pose))
    return replace(layout, units=tuple(units))


@pytest.fixture(scope="module")
def hill():
    """The study's junction on a slope."""
    return hillside(load_study_scene())


@pytest.fixture(scope="module")
def layout(hill):
    """Four units 6 m above the slope."""
    return lifted(build_layout(4), hill)


def test_heights_are_those_above_the_ground_below(hill, layout):
    assert min(unit.pose.position_m[2] for unit in layout.units) < 5.0
    for unit in layout.units:
        assert above_ground(unit, hill).pose.position_m[2] == pytest.approx(6.0)
        assert above_ground(unit, load_study_scene()) is unit
    assert [row[5] for row in unit_table("hill", layout, hill).rows] == ["6.00"] * 4
    assert [one.height_m for one in build_unit_records(layout, hill)] == [6.0] * 4

    flat = build_unit_records(layout, load_study_scene())
    assert [one.height_m for one in flat] == [None] * 4


def test_the_terminal_tells_heights_above_the_ground_below(hill, layout):
    table = _units_table(build_unit_records(layout, hill), [layout.units[0].id])
    assert [row[2] for row in table.rows] == ["6.00"] * 4
    assert ["(existing)" in row[-1] for row in table.rows] == [True] + [False] * 3


def test_a_unit_may_hang_below_the_height_of_the_middle_but_not_in_the_ground(hill):
    (unit,) = build_layout(1).units
    low = replace(
        unit, pose=Pose(position_m=np.array([-200.0, -30.0, -1.0]), yaw_deg=0.0)
    )
    check_layout(Layout(name="low", units=(low,)), hill)

    with pytest.raises(
        InputError, match=r"unit 1.z_m: got -1\.0; expected a height above the ro"
    ):
        check_layout(Layout(name="low", units=(low,)), load_study_scene())

    buried = replace(
        unit, pose=Pose(position_m=np.array([-60.0, 0.0, 5.0]), yaw_deg=0.0)
    )
    with pytest.raises(
        InputError, match=r"unit 1.z_m: got -0\.36\d*; expected a height above"
    ):
        check_layout(Layout(name="buried", units=(buried,)), hill)


def test_a_scene_keeps_how_high_it_lies(hill, tmp_path):
    save_scene(tmp_path, hill)
    assert load_scene(str(tmp_path)).zero_height_m == ZERO_M

    save_scene(tmp_path, replace(hill, zero_height_m=None))
    assert load_scene(str(tmp_path)).zero_height_m is None


def test_tables_and_maps_have_heights_above_the_ground_and_those_of_the_map(
    hill, layout
):
    z_m = [unit.pose.position_m[2] for unit in layout.units]
    table = pd.DataFrame(placed_records(layout, hill))

    assert table["height_m"].to_numpy() == pytest.approx(6.0, abs=1e-3)
    assert table["z_m"].tolist() == z_m
    assert table["map_z"].to_numpy() == pytest.approx(np.array(z_m) + ZERO_M, abs=1e-3)

    features = json.loads(to_geojson(layout, hill.crs, hill))["features"]
    found = [feature["geometry"]["coordinates"][2] for feature in features]
    assert found == table["map_z"].tolist()

    nowhere = placed_records(layout, replace(hill, zero_height_m=None))
    assert all("map_z" not in record and "height_m" in record for record in nowhere)
    assert placed_records(layout, load_study_scene()) == layout_records(layout)


def test_globes_are_told_heights_above_the_ground(hill, layout):
    root = ElementTree.fromstring(to_kml(layout, hill))
    name = "{http://www.opengis.net/kml/2.2}"
    altitudes = [float(one.text) for one in root.iter(f"{name}altitude")]

    assert altitudes == pytest.approx([6.0] * 4, abs=1e-3)

    points = [one.find(f"{name}coordinates").text for one in root.iter(f"{name}Point")]
    assert [float(text.split(",")[2]) for text in points] == altitudes


def test_messages_count_from_the_ground_below_the_station(hill, layout):
    stations = json.loads(to_cpm(layout, hill))["stations"]
    for station in stations:
        (sensor,) = station["messages"][0]["payload"]["cpmContainers"][1][
            "containerData"
        ]
        offset = sensor["perceptionRegionShape"]["radial"]["shapeReferencePoint"]
        assert offset["zCoordinate"] == pytest.approx(600, abs=1)


ON_ELLIPSOID = "+proj=utm +zone=32 +datum=WGS84 +units=m +vunits=m +no_defs"


def test_messages_have_an_altitude_where_the_map_counts_from_the_ellipsoid(
    hill, layout
):
    """The ground rises by 8 % to the east and by 3 % to the north of 371.25 m."""
    measured = replace(hill, source_crs=ON_ELLIPSOID)
    stations = json.loads(to_cpm(layout, measured))["stations"]
    feet_m = {unit.id: unit.pose.position_m[:2] for unit in layout.units}
    for station in stations:
        east_m, north_m = np.mean([feet_m[name] for name in station["units"]], axis=0)
        altitude = station["messages"][0]["payload"]["managementContainer"][
            "referencePosition"
        ]["altitude"]
        expected_m = ZERO_M + 0.08 * (east_m + 127.0) + 0.03 * north_m

        assert altitude["altitudeValue"] == pytest.approx(100.0 * expected_m, abs=1.0)
        assert altitude["altitudeConfidence"] == "unavailable"


@pytest.mark.parametrize(
    ("changes", "value"),
    [
        ({"source_crs": "EPSG:25832"}, 800_001),  # no heights of its own
        ({"source_crs": "EPSG:5555"}, 800_001),  # above the sea
        ({"source_crs": ""}, 800_001),
        ({"source_crs": ON_ELLIPSOID, "zero_height_m": None}, 800_001),
        ({"source_crs": ON_ELLIPSOID, "zero_height_m": 9_000.0}, 800_000),
        ({"source_crs": ON_ELLIPSOID, "zero_height_m": -2_000.0}, -100_000),
    ],
)
def test_messages_without_a_known_altitude_say_so(hill, layout, changes, value):
    (station, *_) = json.loads(to_cpm(layout, replace(hill, **changes)))["stations"]
    place = station["messages"][0]["payload"]["managementContainer"][
        "referencePosition"
    ]
    assert place["altitude"]["altitudeValue"] == value


@pytest.mark.long
def test_scenarios_drive_on_the_ground(small_setting, hill):
    terrain = terrain_of(hill)
    run = replace(small_setting.runs[0], terrain=terrain)
    root = ElementTree.fromstring(to_openscenario(run, road_network="a.xodr"))
    places = [one.attrib for one in root.iter("WorldPosition")]

    assert len(places) > 20

    at = np.array([[float(one[axis]) for axis in "xyz"] for one in places])
    assert at[:, 2] == pytest.approx(terrain.at(at[:, :2]), abs=1e-3)

    flat = ElementTree.fromstring(
        to_openscenario(small_setting.runs[0], road_network="a.xodr")
    ).iter("WorldPosition")
    assert {float(one.attrib["z"]) for one in flat} == {0.0}
