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
STUDY = load_carlancap_layout()
TWO = replace(STUDY, units=STUDY.units[:2])


@pytest.fixture(scope="module")
def views():
    """What each of two cameras sees, and last what none of them does."""
    return find_views(TWO, SCENE)


def turn_deg(yaw_deg):
    """An angle as a turn, -180 to 180."""
    return (yaw_deg + 180.0) % 360.0 - 180.0


def yaws_of(ways):
    """Directions of ways on the ground, from east. [deg]"""
    east, north = ways[..., :2].T
    return np.degrees(np.arctan2(north, east))


def drawing_of(*args, **options):
    """A drawing as another library reads it."""
    text = to_dxf(*args, **options)
    return ezdxf.read(io.StringIO(text))


def test_a_view_is_ahead_of_its_camera_within_the_field_of_view(views):
    """But for 12 degrees: the ground is seen in cells, whose corners stick out."""
    for unit, view in zip(TWO.units, views[:-1], strict=True):
        assert view.unit == unit.id

        corners = shapely.get_coordinates(view.area)
        ways = corners - unit.pose.position_m[:2]
        off_deg = turn_deg(yaws_of(ways) - unit.pose.yaw_deg)
        # Tilted down, a camera sees farther to the sides below itself.
        far = np.linalg.norm(ways, axis=1) > 25.0
        farthest_off_deg = np.abs(off_deg[far]).max()
        half_fov_deg = 0.5 * unit.sensor.horizontal_fov_deg

        assert farthest_off_deg < half_fov_deg + 12.0
        assert view.area.area > 100.0
        assert shapely.is_valid(view.area)


def test_what_no_camera_sees_is_road_outside_of_all_views(views):
    unseen = views[-1]

    assert unseen.unit == ""
    assert unseen.area.area > 0.0

    for view in views[:-1]:
        common = unseen.area.intersection(view.area)
        assert common.area == pytest.approx(0.0, abs=1e-6)

    # LiDARs take no pictures: all of the road is unseen.
    lidars = level_layout(0.0, kind="lidar")
    nobody = find_views(replace(TWO, units=lidars.units), SCENE)

    assert len(nobody) == 1
    assert nobody[0].area.area > unseen.area.area


@pytest.mark.parametrize("name", ["geojson", "gpkg", "kml"])
def test_other_programs_read_the_same_areas(name, views, tmp_path):
    """Areas are polygons, units are points; a GeoPackage has them on other layers."""
    path = tmp_path / f"views.{name}"
    content = load_format(name).write(TWO, SCENE, views=find_views)
    if isinstance(content, str):
        content = content.encode()
    path.write_bytes(content)

    if name == "gpkg":
        table = gpd.read_file(path, layer="views")
        n_points = 0
    else:
        table = gpd.read_file(path)
        n_points = len(TWO.units)
    is_area = table.geom_type.isin(["Polygon", "MultiPolygon"])
    is_point = table.geom_type == "Point"
    areas = table[is_area].to_crs(SCENE.crs)

    assert len(areas) == len(views)
    assert sum(is_point) == n_points
    assert_allclose(
        areas.area,
        [view.area.area for view in views],
        rtol=1e-5,
        atol=1e-3,
    )

    if name == "kml":
        column = "Name"
    else:
        column = "id"
    expected = [f"view of {unit.id}" for unit in TWO.units]
    expected.append(UNSEEN)

    assert areas[column].tolist() == expected


ezdxf = pytest.importorskip("ezdxf", reason="the extra dxf is not installed")


def rings_of(space, layer):
    """Polygons of the closed lines on a layer."""
    rings = []
    for line in space.query(f'LWPOLYLINE[layer=="{layer}"]'):
        if line.closed:
            corners = [point[:2] for point in line]
            rings.append(shapely.Polygon(corners))

    return rings


def feet_of(space):
    """Where the poles of a drawing stand."""
    poles = space.query('CIRCLE[layer=="POLES"]')
    return np.array([list(pole.dxf.center)[:2] for pole in poles])


def places_of(sites):
    """Where the poles of a scene stand."""
    return np.array([site.position_m[:2] for site in sites])


def way_of(arrow):
    """From the start of a line to its end."""
    return np.array(arrow.dxf.end) - np.array(arrow.dxf.start)


def test_a_drawing_has_poles_units_and_views_on_their_layers(views):
    """Units are arrows from where they hang to where they look."""
    drawing = drawing_of(TWO, SCENE)

    assert drawing.audit().errors == []
    assert drawing.units == 6  # metres

    space = drawing.modelspace()
    arrows = space.query('LINE[layer=="UNITS"]')
    places = places_of(SCENE.sites)

    assert_allclose(feet_of(space), places, atol=1e-9)

    for unit, arrow in zip(TWO.units, arrows, strict=True):
        start = list(arrow.dxf.start)
        yaw_deg = yaws_of(way_of(arrow))
        off_deg = turn_deg(yaw_deg - unit.pose.yaw_deg)

        assert_allclose(start, unit.pose.position_m, atol=1e-9)
        assert off_deg == pytest.approx(0.0, abs=1e-6)

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
    """The legend has a line for each layer, and says which coordinates these are."""
    drawing = drawing_of(TWO, SCENE)
    space = drawing.modelspace()
    (junction,) = rings_of(space, "JUNCTION")
    outline = shapely.Polygon(SCENE.outline_m)

    assert junction.area == pytest.approx(outline.area)

    # One ring around all lanes: no line between two that touch.
    (road,) = rings_of(space, "KERBS")
    expected = road_area(SCENE)

    assert road.area == pytest.approx(expected.area, rel=2e-3)

    buildings = rings_of(space, "BUILDING")
    kinds = [thing.class_name for thing in SCENE.instances]
    n_buildings = kinds.count("building")

    assert len(buildings) == n_buildings == 4

    legend = space.query('TEXT[layer=="LEGEND"]')
    texts = [text.dxf.text for text in legend]
    explained = {text.partition(":")[0] for text in texts}
    drawn = {entity.dxf.layer.partition("-")[0] for entity in space}

    assert drawn <= explained
    assert texts[0].startswith("Coordinates: +proj=tmerc")


def test_a_drawing_lies_in_the_coordinates_that_are_asked_for():
    """Those asked for, or the map's own, or UTM's where the map is in degrees."""
    degrees = replace(SCENE, source_crs="EPSG:4326")

    for scene, crs, expected in (
        (SCENE, "EPSG:25832", "EPSG:25832"),
        (degrees, "", "EPSG:32632"),  # the UTM zone of 8 degrees east
        (map_scene(), "", map_scene().source_crs),
    ):
        drawing = drawing_of(TWO, scene, crs=crs)
        feet = feet_of(drawing.modelspace())
        places = places_of(scene.sites)
        there = transform(places, scene.crs, expected)

        assert_allclose(feet, there, atol=1e-6)


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
    """The arrow of a unit is 4 m long, but for the map's scale."""
    layout = level_layout(0.0)
    drawing = drawing_of(layout, scene)
    space = drawing.modelspace()
    (arrow,) = space.query('LINE[layer=="UNITS"]')
    text = load_format("json").write(layout, scene)
    (record,) = json.loads(text)["layout"]
    length_m = np.linalg.norm(way_of(arrow))

    assert length_m == pytest.approx(4.0, rel=2e-3)
    assert arrow.dxf.start[2] == record["z_m"]
