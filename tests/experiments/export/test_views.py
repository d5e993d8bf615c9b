"""What cameras see of the ground, as polygons, and drawings with it."""

import io
import json
import re
from dataclasses import replace

import geopandas as gpd
import numpy as np
import pytest
import shapely
from export_layouts import level_layout, map_scene, placeless_scene
from numpy.testing import assert_allclose

from experiments.export import load_format
from experiments.export.dxf import to_dxf
from experiments.export.views import UNSEEN, find_views
from geometry.errors import InputError
from geometry.frames import transform
from geometry.scene import road_area
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout

SCENE = load_study_scene()
TWO = replace(load_carlancap_layout(), units=load_carlancap_layout().units[:2])


@pytest.fixture(scope="module")
def views():
    return find_views(TWO, SCENE)


def test_a_view_is_ahead_of_its_camera_within_the_field_of_view(views):
    for unit, view in zip(TWO.units, views[:-1], strict=True):
        assert view.unit == unit.id

        ways = shapely.get_coordinates(view.area) - unit.pose.position_m[:2]
        off_deg = np.degrees(np.arctan2(ways[:, 1], ways[:, 0])) - unit.pose.yaw_deg
        off_deg = (off_deg + 180.0) % 360.0 - 180.0
        # Tilted down, a camera sees farther to the sides below itself; corners stick
        # out of cells.
        far = np.linalg.norm(ways, axis=1) > 25.0

        assert np.abs(off_deg[far]).max() < 0.5 * unit.sensor.horizontal_fov_deg + 12.0
        assert view.area.area > 100.0
        assert shapely.is_valid(view.area)


def test_what_no_camera_sees_is_road_outside_of_all_views(views):
    unseen = views[-1]
    assert unseen.unit == ""
    assert unseen.area.area > 0.0

    for view in views[:-1]:
        assert unseen.area.intersection(view.area).area == pytest.approx(0.0, abs=1e-6)

    nobody = find_views(
        replace(TWO, units=level_layout(0.0, kind="lidar").units), SCENE
    )
    assert len(nobody) == 1  # LiDARs take no pictures: all of the road is unseen
    assert nobody[0].area.area > unseen.area.area


@pytest.mark.parametrize("name", ["geojson", "gpkg", "kml"])
def test_other_programs_read_the_same_areas(name, views, tmp_path):
    path = tmp_path / f"views.{name}"
    content = load_format(name).write(TWO, SCENE, views=find_views)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    if name == "gpkg":
        table = gpd.read_file(path, layer="views")
    else:
        table = gpd.read_file(path)
    areas = table[table.geom_type.isin(["Polygon", "MultiPolygon"])].to_crs(SCENE.crs)

    assert len(areas) == len(views)
    assert_allclose(
        areas.area,
        [view.area.area for view in views],
        rtol=1e-5,
        atol=1e-3,
    )

    names = areas["Name" if name == "kml" else "id"].tolist()
    assert names == [*(f"view of {unit.id}" for unit in TWO.units), UNSEEN]
    assert sum(table.geom_type == "Point") == (0 if name == "gpkg" else len(TWO.units))


ezdxf = pytest.importorskip("ezdxf", reason="the extra dxf is not installed")


def rings_of(space, layer):
    """Polygons of the closed lines on a layer."""
    lines = space.query(f'LWPOLYLINE[layer=="{layer}"]')
    return [
        shapely.Polygon([point[:2] for point in line]) for line in lines if line.closed
    ]


def test_a_drawing_has_poles_units_and_views_on_their_layers(views):
    drawing = ezdxf.read(io.StringIO(to_dxf(TWO, SCENE)))
    assert drawing.audit().errors == []
    assert drawing.units == 6  # metres

    space = drawing.modelspace()
    poles = space.query('CIRCLE[layer=="POLES"]')
    feet = np.array([list(pole.dxf.center)[:2] for pole in poles])

    assert_allclose(feet, [site.position_m[:2] for site in SCENE.sites], atol=1e-9)

    for unit, arrow in zip(TWO.units, space.query('LINE[layer=="UNITS"]'), strict=True):
        assert_allclose(list(arrow.dxf.start), unit.pose.position_m, atol=1e-9)

        way = np.array(arrow.dxf.end) - np.array(arrow.dxf.start)
        yaw_deg = np.degrees(np.arctan2(way[1], way[0]))
        assert (yaw_deg - unit.pose.yaw_deg + 180.0) % 360.0 - 180.0 == pytest.approx(
            0.0, abs=1e-6
        )

    for view in views:
        if view.unit:
            layer = f"VIEWS-{view.unit}"
        else:
            layer = "UNSEEN"
        rings = rings_of(space, layer)
        # A hole's ring lies within another one's.
        area = shapely.Polygon()
        for ring in sorted(rings, key=lambda one: -one.area):
            area = area.symmetric_difference(ring)
        assert area.area == pytest.approx(view.area.area, rel=1e-6)


def test_a_drawing_has_junction_kerbs_and_buildings_as_closed_lines_and_a_legend():
    drawing = ezdxf.read(io.StringIO(to_dxf(TWO, SCENE)))
    space = drawing.modelspace()
    (junction,) = rings_of(space, "JUNCTION")

    assert junction.area == pytest.approx(shapely.Polygon(SCENE.outline_m).area)

    # One ring around all lanes: no line between two that touch.
    (road,) = rings_of(space, "KERBS")
    assert road.area == pytest.approx(road_area(SCENE).area, rel=2e-3)

    buildings = rings_of(space, "BUILDING")
    kinds = [thing.class_name for thing in SCENE.instances]

    assert len(buildings) == kinds.count("building") == 4

    texts = [text.dxf.text for text in space.query('TEXT[layer=="LEGEND"]')]
    drawn = {entity.dxf.layer.partition("-")[0] for entity in space}

    assert drawn <= {text.partition(":")[0] for text in texts}
    assert texts[0].startswith("Coordinates: +proj=tmerc")


def test_a_drawing_lies_in_the_coordinates_that_are_asked_for():
    degrees = replace(SCENE, source_crs="EPSG:4326")
    for scene, crs, expected in (
        (SCENE, "EPSG:25832", "EPSG:25832"),
        (degrees, "", "EPSG:32632"),  # the UTM zone of 8 degrees east
        (map_scene(), "", map_scene().source_crs),
    ):
        drawing = ezdxf.read(io.StringIO(to_dxf(TWO, scene, crs=crs)))
        poles = drawing.modelspace().query('CIRCLE[layer=="POLES"]')
        feet = np.array([list(pole.dxf.center)[:2] for pole in poles])
        where = np.array([site.position_m[:2] for site in scene.sites])
        assert_allclose(feet, transform(where, scene.crs, expected), atol=1e-6)


@pytest.mark.parametrize(
    ("scene", "crs", "message"),
    [
        (SCENE, "EPSG:4326", "--crs: got 'EPSG:4326'; expected one in metres"),
        (SCENE, "EPSG:1", "--crs: got 'EPSG:1'; expected one that pyproj knows"),
        (placeless_scene(), "EPSG:25832", "--crs EPSG:25832: got a scene without crs"),
    ],
)
def test_a_drawing_refuses_coordinates_that_it_cannot_have(scene, crs, message):
    with pytest.raises(InputError, match=re.escape(message)):
        to_dxf(TWO, scene, crs=crs)


@pytest.mark.parametrize("scene", [map_scene(), placeless_scene()])
def test_a_drawing_is_in_the_maps_own_metres(scene):
    layout = level_layout(0.0)
    drawing = ezdxf.read(io.StringIO(to_dxf(layout, scene)))
    (arrow,) = drawing.modelspace().query('LINE[layer=="UNITS"]')
    records = [json.loads(load_format("json").write(layout, scene))["layout"]]
    (record,) = records[0]
    length_m = np.linalg.norm(np.array(arrow.dxf.end) - np.array(arrow.dxf.start))

    assert length_m == pytest.approx(4.0, rel=2e-3)  # a map's scale
    assert arrow.dxf.start[2] == record["z_m"]
