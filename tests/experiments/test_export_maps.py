"""Tables and maps, read back by pandas and GDAL (geopandas)."""

import io
import sqlite3
from dataclasses import replace

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from defusedxml import ElementTree
from export_layouts import (
    MAP_CRS,
    awkward_layout,
    large_layout,
    map_scene,
    placeless_scene,
)
from numpy.testing import assert_allclose
from pyproj import Transformer
from refusals import refused_with

from experiments.export.geojson import to_geojson
from experiments.export.gpkg import to_geopackage
from experiments.export.kml import to_kml
from experiments.export.places import drawn_records
from geometry.study_scene import load_study_scene
from placement.layout import layout_records

LAYOUTS = [awkward_layout, large_layout]


def in_map(layout):
    """East and north of the units in the map's coordinates."""
    to_map = Transformer.from_crs(load_study_scene().crs, MAP_CRS, always_xy=True)
    position = np.array([unit.pose.position_m for unit in layout.units])
    return np.column_stack(
        [*to_map.transform(position[:, 0], position[:, 1]), position[:, 2]]
    )


def assert_same(found, expected, *, rtol=0.0):
    """Equal tables, whether nothing is None or NaN."""
    assert found.dtypes.equals(expected.dtypes)
    found, expected = (
        frame.astype(object).where(frame.notna(), None) for frame in (found, expected)
    )
    pd.testing.assert_frame_equal(found, expected, check_exact=not rtol, rtol=rtol)


def coordinates(frame):
    """Places of a table of points, (n, 3)."""
    return np.column_stack([frame.geometry.x, frame.geometry.y, frame.geometry.z])


@pytest.mark.parametrize("build", LAYOUTS)
def test_a_geopackage_lies_in_the_map_with_every_field(build, tmp_path):
    layout = build()
    path = tmp_path / "units.gpkg"
    path.write_bytes(to_geopackage(layout, map_scene()))
    frame = gpd.read_file(path, layer="units")

    assert frame.crs == MAP_CRS
    assert_allclose(coordinates(frame), in_map(layout), atol=1e-6)

    expected = pd.DataFrame(drawn_records(layout, map_scene()))
    assert "map_x" in expected.columns
    assert_same(pd.DataFrame(frame.drop(columns="geometry")), expected)

    with sqlite3.connect(path) as database:
        rows = database.execute(
            "select table_name, z from gpkg_geometry_columns"
        ).fetchall()
    database.close()
    assert rows == [("units", 1)]


def test_a_geopackage_of_a_map_in_degrees_is_in_degrees(tmp_path):
    layout = awkward_layout()
    path = tmp_path / "units.gpkg"
    path.write_bytes(
        to_geopackage(layout, replace(map_scene(), source_crs="EPSG:4326"))
    )
    frame = gpd.read_file(path)

    assert frame.crs == "EPSG:4326"
    assert_allclose(coordinates(frame.to_crs(MAP_CRS)), in_map(layout), atol=1e-6)


def test_a_geopackage_of_a_scene_without_a_map_lies_in_the_world_frame(tmp_path):
    layout = awkward_layout()
    scene = load_study_scene()
    path = tmp_path / "units.gpkg"
    path.write_bytes(to_geopackage(layout, scene))
    frame = gpd.read_file(path)

    np.testing.assert_array_equal(
        coordinates(frame), [unit.pose.position_m for unit in layout.units]
    )

    again = frame.to_crs("EPSG:4326")
    geojson = gpd.read_file(io.StringIO(to_geojson(layout, scene.crs, scene)))
    assert_allclose(coordinates(again), coordinates(geojson), atol=1e-9)


@pytest.mark.parametrize("build", LAYOUTS)
def test_geojson_is_read_by_geopandas(build, tmp_path):
    layout = build()
    path = tmp_path / "units.geojson"
    path.write_text(to_geojson(layout, map_scene().crs, map_scene()))
    frame = gpd.read_file(path)

    assert frame.crs == "EPSG:4979"  # WGS 84 with heights

    ground = frame.set_crs("EPSG:4326", allow_override=True).to_crs(MAP_CRS)
    assert_allclose(coordinates(ground), in_map(layout), atol=1e-6)

    expected = pd.DataFrame(drawn_records(layout, map_scene()))
    assert_same(pd.DataFrame(frame[expected.columns]), expected, rtol=1e-14)


@pytest.mark.parametrize("build", LAYOUTS)
def test_kml_is_read_by_gdal(build, tmp_path):
    layout = build()
    path = tmp_path / "units.kml"
    path.write_text(to_kml(layout, map_scene()))
    frame = gpd.read_file(path)

    assert frame.crs == "EPSG:4326"

    ground = frame.set_crs("EPSG:4326", allow_override=True).to_crs(MAP_CRS)
    assert_allclose(coordinates(ground), in_map(layout), atol=1e-6)
    assert frame.Name.tolist() == [unit.id for unit in layout.units]
    assert set(frame.altitudeMode) == {"relativeToGround"}
    for record, (_, row) in zip(
        drawn_records(layout, map_scene()), frame.iterrows(), strict=True
    ):
        for key, value in record.items():
            assert type(value)(row[key]) == value, key


def test_the_kml_camera_looks_where_the_unit_looks():
    layout = awkward_layout()
    root = ElementTree.fromstring(to_kml(layout, load_study_scene()))
    space = {"k": "http://www.opengis.net/kml/2.2"}

    assert root.find("k:Document/k:name", space).text == layout.name

    for unit, camera in zip(
        layout.units, root.iterfind(".//k:Camera", space), strict=True
    ):
        heading, tilt = (
            np.radians(float(camera.find(f"k:{name}", space).text))
            for name in ("heading", "tilt")
        )
        # Heading from north by east; tilt from straight down.
        axis = [
            np.sin(tilt) * np.sin(heading),
            np.sin(tilt) * np.cos(heading),
            -np.cos(tilt),
        ]
        yaw, pitch = np.radians([unit.pose.yaw_deg, unit.pose.pitch_deg])
        expected = [
            np.cos(pitch) * np.cos(yaw),
            np.cos(pitch) * np.sin(yaw),
            np.sin(pitch),
        ]
        assert_allclose(axis, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "export"),
    [
        ("geojson", lambda layout, scene: to_geojson(layout, scene.crs, scene)),
        ("gpkg", to_geopackage),
        ("kml", to_kml),
    ],
)
def test_maps_need_a_place_on_earth(name, export):
    with refused_with(
        f"{name}: got a scene without crs; expected one that says where on earth it"
        " lies"
    ):
        export(awkward_layout(), placeless_scene())


def test_the_records_of_a_layout_are_all_there():
    keys = {key for record in layout_records(awkward_layout()) for key in record}
    # Or the tests above say little.
    assert {
        "camera",
        "lidar",
        "latency_s",
        "fov_deg",
    } <= keys
