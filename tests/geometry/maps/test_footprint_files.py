"""Footprints of houses and walls from files of GIS programs."""

import json
import zipfile

import geopandas as gpd
import numpy as np
import pytest
import shapely
from numpy.testing import assert_array_equal
from shapely.geometry import (
    GeometryCollection,
    LineString,
    MultiPolygon,
    Point,
    Polygon,
    box,
)

from geometry.errors import InputError
from geometry.maps import gis_files
from geometry.maps.gis_files import read_footprints
from geometry.maps.source_map import is_closed, kind_of_class, thing_defaults, volume_m3

X = 390_000.0
Y = 5_819_000.0
HOUSE = box(X, Y, X + 10, Y + 8)
AROUND = box(X + 20, Y, X + 40, Y + 20)
YARD = AROUND - box(X + 25, Y + 5, X + 30, Y + 10)
DRIVERS = {"a.gpkg": "GPKG", "a.shp": "ESRI Shapefile", "a.geojson": "GeoJSON"}
DEFAULT_M = kind_of_class("building").height_m


def write(tmp_path, rows, geometries, name="a.gpkg", crs="EPSG:25833", **options):
    """A file that geopandas writes."""
    frame = gpd.GeoDataFrame(rows, geometry=geometries, crs=crs)
    frame.to_file(tmp_path / name, driver=DRIVERS[name], **options)
    return tmp_path / name


def write_json(tmp_path, *features, **members):
    """A file of GeoJSON."""
    path = tmp_path / "a.geojson"
    table = {"type": "FeatureCollection", "features": features} | members
    path.write_text(json.dumps(table))
    return path


def feature(geometry, **properties):
    """A feature of GeoJSON."""
    table = json.loads(shapely.to_geojson(geometry))
    return {"type": "Feature", "properties": properties, "geometry": table}


def line_east(y):
    """A line of 10 m."""
    return LineString([(X, y), (X + 10, y)])


def polygon_at(corners):
    """A polygon with corners that are told from where the house is."""
    return Polygon(np.array(corners) + [X, Y])


def only_thing(tmp_path, geometry, **properties):
    """The thing that is read from one feature, in metres."""
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25833"}}
    path = write_json(tmp_path, feature(geometry, **properties), crs=crs)
    (thing,) = read_footprints(path).things
    return thing


def volume(thing):
    """Volume of a thing. [m3]"""
    return volume_m3(thing.vertices_m, thing.triangles)


def heights(thing):
    """Heights of a thing's lowest and highest point."""
    z = thing.vertices_m[:, 2]
    return z.min(), z.max()


def ids(things):
    """Ids of things."""
    return [thing.id for thing in things]


def told(source):
    """What is told of a reading."""
    return [skip.what for skip in source.skipped]


@pytest.mark.parametrize("name", list(DRIVERS))
def test_what_geopandas_writes_is_read_back(tmp_path, name):
    one = box(X, Y + 30, X + 5, Y + 35)
    other = box(X + 10, Y + 30, X + 15, Y + 35)
    two = MultiPolygon([one, other])
    rows = {"id": ["a", "b", "c"], "height": [6.0, 12.0, 3.0]}
    source = read_footprints(write(tmp_path, rows, [HOUSE, YARD, two], name))

    assert source.crs == "EPSG:25833"
    assert source.heights == "above ground"
    assert source.skipped == ()
    assert ids(source.things) == ["a", "b", "c"]

    volumes = [80.0 * 6.0, 375.0 * 12.0, 50.0 * 3.0]
    for thing, volume_there in zip(source.things, volumes, strict=True):
        assert is_closed(thing.triangles)
        assert volume(thing) == pytest.approx(volume_there, rel=1e-6)
        assert not thing.is_height_assumed


def test_zipped_shapefiles_are_read(tmp_path):
    path = write(tmp_path, {"height": [6.0]}, [HOUSE], "a.shp")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for file in tmp_path.glob("a.*"):
            if file.suffix != ".zip":
                archive.write(file, f"houses/{file.name}")

    zipped = read_footprints(tmp_path / "a.zip")
    plain = read_footprints(path)

    assert_array_equal(zipped.things[0].vertices_m, plain.things[0].vertices_m)
    assert zipped.crs == plain.crs


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:3857", "EPSG:25833"])
def test_houses_have_their_size_on_the_ground_in_every_reference_system(tmp_path, crs):
    frame = gpd.GeoSeries([HOUSE, YARD], crs="EPSG:25833").to_crs(crs)
    path = write(tmp_path, {"height": [6.0, 12.0]}, list(frame), crs=crs)
    source = read_footprints(path)

    for thing, volume_there in zip(source.things, (480.0, 4500.0), strict=True):
        assert volume(thing) == pytest.approx(volume_there, rel=2e-3)


@pytest.mark.parametrize(
    ("columns", "expected_m"),
    [
        ({"HEIGHT": 6}, (0.0, 6.0)),
        ({"bldg_height": "6.5 m"}, (0.0, 6.5)),
        ({"Hoehe": "6,5"}, (0.0, 6.5)),
        ({"measuredHeight": 9}, (0.0, 9.0)),
        ({"height_ft": 20}, (0.0, 6.096)),
        ({"height_cm": 450}, (0.0, 4.5)),
        ({"h": 5, "height": 6}, (0.0, 6.0)),
        ({"building:levels": "3"}, (0.0, 9.0)),
        ({"storeys": 2}, (0.0, 6.0)),
        ({"height": 10, "building:levels": 2}, (0.0, 10.0)),
        ({"height": 10, "min_height": 4}, (4.0, 10.0)),
        ({"height": 10, "building:min_level": 1}, (3.0, 10.0)),
        ({"height": 3, "base": 4}, (0.0, 3.0)),
    ],
)
def test_columns_say_from_where_to_where(tmp_path, columns, expected_m):
    thing = only_thing(tmp_path, HOUSE, **columns)
    assert heights(thing) == pytest.approx(expected_m)
    assert not thing.is_height_assumed


@pytest.mark.parametrize(
    "columns",
    [
        {},
        {"height": 0},
        {"height": 5000},
        {"height": "high"},
        {"height": True},
        {"height": [1]},
        {"height": 10**400},
        {"building:levels": 1000},
    ],
)
def test_impossible_heights_give_way_to_the_default(tmp_path, columns):
    thing = only_thing(tmp_path, HOUSE, **columns)
    assert thing.is_height_assumed
    assert heights(thing)[1] == DEFAULT_M


def test_lines_become_walls_where_something_says_so(tmp_path):
    lines = [line_east(Y), line_east(Y + 5)]
    rows = {"barrier": ["hedge", "kerb"], "height": [None, 2.0]}
    path = write(tmp_path, rows, lines)
    source = read_footprints(path)
    (hedge,) = source.things
    kinds = {kind.kind: kind for kind in thing_defaults().kinds}

    assert hedge.class_name == "vegetation"
    assert hedge.is_height_assumed

    size = [10.0, kinds["hedge"].thickness_m, kinds["hedge"].height_m]
    assert np.ptp(hedge.vertices_m, axis=0) == pytest.approx(size)
    assert told(source) == ["1 lines"]
    assert len(read_footprints(path, class_name="wall").things) == 2


def test_points_and_rows_without_geometry_are_counted(tmp_path):
    point = Point(X, Y)
    path = write(tmp_path, {"n": range(4)}, [HOUSE, point, None, point])
    source = read_footprints(path)

    assert len(source.things) == 1
    assert told(source) == ["2 points", "1 rows without geometry"]


def test_polygons_in_collections_are_taken(tmp_path):
    mixed = GeometryCollection([Point(X, Y), HOUSE])
    assert volume(only_thing(tmp_path, mixed, height=5)) == pytest.approx(400.0)


def test_footprints_that_cross_themselves_are_mended_and_those_without_area_are_told(
    tmp_path,
):
    bow = polygon_at(
        [
            (0.0, 0.0),
            (10.0, 10.0),
            (10.0, 0.0),
            (0.0, 10.0),
        ]
    )
    flat = polygon_at(
        [
            (0.0, 0.0),
            (10.0, 0.0),
            (5.0, 0.0),
        ]
    )
    rows = {"id": ["bow", "flat"], "height": [2.0, 2.0]}
    source = read_footprints(write(tmp_path, rows, [bow, flat]))

    assert ids(source.things) == ["bow"]
    assert volume(source.things[0]) == pytest.approx(100.0)
    assert told(source) == ["building flat"]


def test_the_same_id_twice_becomes_two(tmp_path):
    path = write(tmp_path, {"id": ["a", "a"], "height": [2.0, 2.0]}, [HOUSE, YARD])
    assert ids(read_footprints(path).things) == ["a", "a-2"]


def test_a_file_with_several_layers_is_refused(tmp_path):
    write(tmp_path, {"height": [2.0]}, [HOUSE], layer="houses")
    path = write(tmp_path, {"height": [4.0]}, [YARD], layer="yards", mode="a")
    message = "got 2 layers: houses, yards; expected a file"

    with pytest.raises(InputError, match=message):
        read_footprints(path)


@pytest.mark.filterwarnings("ignore:.crs. was not provided")
@pytest.mark.parametrize("name", ["a.gpkg", "a.shp"])
def test_files_without_a_reference_system_have_none(tmp_path, name):
    path = write(tmp_path, {"h": [2.0]}, [HOUSE], name, crs=None)
    assert read_footprints(path).crs == ""


DEGREES = box(13.37, 52.5, 13.371, 52.501)
SWAPPED = box(52.5, 133.37, 52.501, 133.371)
NO_POINT = {"geometry": {"type": "Polygon", "coordinates": [[1]]}}


@pytest.mark.parametrize(
    ("features", "message"),
    [
        ([], "an empty layer"),
        ([feature(Point(13.0, 52.0))], "no areas: 1 points"),
        ([feature(HOUSE)], "metres or another CRS where degrees are expected"),
        ([feature(SWAPPED)], "latitude and longitude swapped"),
        ([feature(Polygon([(1, 1)] * 4))], "no footprint with an area"),
        ([3], r"features\[0\]"),
        ([NO_POINT], r"features\[0\].geometry"),
        ([{"properties": 3, "geometry": None}], r"features\[0\].properties"),
    ],
)
def test_impossible_geojson_is_refused_in_one_line(tmp_path, features, message):
    with pytest.raises(InputError, match=message) as caught:
        read_footprints(write_json(tmp_path, *features))
    assert "\n" not in str(caught.value)


def test_coordinates_that_are_not_finite_are_refused(tmp_path):
    text = write_json(tmp_path, feature(DEGREES)).read_text()
    for word in ("NaN", "1e999"):
        (tmp_path / "a.geojson").write_text(text.replace("13.371", word))
        with pytest.raises(InputError, match="finite"):
            read_footprints(tmp_path / "a.geojson")


def test_reference_systems_by_link_are_not_fetched(tmp_path):
    crs = {"type": "link", "properties": {"href": "http://example.com/crs"}}
    with pytest.raises(InputError, match="crs"):
        read_footprints(write_json(tmp_path, feature(DEGREES), crs=crs))


@pytest.mark.filterwarnings("ignore:.crs. was not provided")
@pytest.mark.parametrize("crs", [None, "EPSG:25833"])
def test_degrees_where_metres_are_meant_are_refused(tmp_path, crs):
    path = write(tmp_path, {"h": [2.0]}, [DEGREES], crs=crs)
    with pytest.raises(InputError, match="degrees where metres are meant"):
        read_footprints(path)


@pytest.mark.parametrize("name", ["a.gpkg", "a.shp"])
def test_what_is_not_what_its_ending_says_is_refused(tmp_path, name):
    text = '<OGRVRTDataSource><OGRVRTLayer name="a"/></OGRVRTDataSource>'
    (tmp_path / name).write_text(text)

    with pytest.raises(InputError, match="something else"):
        read_footprints(tmp_path / name)
    with pytest.raises(InputError, match="readable"):
        read_footprints(tmp_path / "none" / name)
    with pytest.raises(InputError, match="one of"):
        read_footprints(tmp_path / "a.dxf")


def test_too_many_features_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(gis_files, "MAX_FEATURES", 1)
    path = write(tmp_path, {"h": [2.0] * 2}, [HOUSE, YARD])
    with pytest.raises(InputError, match="more than 1 features"):
        read_footprints(path)
