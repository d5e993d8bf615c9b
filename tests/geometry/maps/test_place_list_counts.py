"""Counts and areas: read, snapped, refused."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose
from osm_text import LAT_DEG, LON_DEG

from geometry.errors import InputError
from geometry.frames import transform
from geometry.maps.place_lists import areas_of, read_areas, read_counts, snap

CRS = "EPSG:25833"
HERE = transform([LON_DEG, LAT_DEG], "EPSG:4326", CRS)


def geojson(path, *features):
    """A file of features: a geometry and values each."""
    told = []
    for geometry, values in features:
        told.append({"type": "Feature", "geometry": geometry, "properties": values})

    path.write_text(json.dumps({"type": "FeatureCollection", "features": told}))
    return path


def point(lon_deg=LON_DEG):
    """The geometry of a place on the latitude of the map."""
    return {"type": "Point", "coordinates": [lon_deg, LAT_DEG]}


def square(half_deg):
    """The geometry of a square around the place of the map."""
    ring = half_deg * np.array(
        [
            [-1.0, -1.0],
            [1.0, -1.0],
            [1.0, 1.0],
            [-1.0, 1.0],
            [-1.0, -1.0],
        ]
    ) + [LON_DEG, LAT_DEG]
    return {"type": "Polygon", "coordinates": [ring.tolist()]}


def test_counts_are_the_same_from_csv_and_geojson(tmp_path):
    table = tmp_path / "counts.csv"
    table.write_text(
        f"lat;lon;Accidents\n{LAT_DEG};{LON_DEG};3\n{LAT_DEG};{LON_DEG + 0.01};0.5\n"
    )
    points = geojson(
        tmp_path / "counts.geojson",
        (point(), {"accidents": 3}),
        (point(LON_DEG + 0.01), {"accidents": 0.5}),
    )
    one = read_counts(table, crs=CRS)
    other = read_counts(points, crs=CRS)

    assert one.column == "Accidents"
    assert other.column == "accidents"
    assert one.values.tolist() == other.values.tolist() == [3.0, 0.5]
    assert_allclose(one.positions_m, other.positions_m, atol=1e-3)
    assert_allclose(one.positions_m[0], HERE, atol=1e-3)


def test_places_without_a_count_count_once(tmp_path):
    table = tmp_path / "counts.csv"
    table.write_text("x,y\n1,2\n3,4\n")
    counts = read_counts(table, crs=CRS)

    assert counts.values.tolist() == [1.0, 1.0]
    assert counts.column == ""
    assert counts.positions_m.tolist() == [[1.0, 2.0], [3.0, 4.0]]


def test_counts_by_junction(tmp_path):
    table = tmp_path / "counts.csv"
    table.write_text("junction,cars,other\nn1,10,1\nA / B,20,2\n")
    counts = read_counts(table, crs="", column="cars")

    assert counts.positions_m is None
    assert counts.junctions == ("n1", "A / B")
    assert counts.values.tolist() == [10.0, 20.0]


@pytest.mark.parametrize(
    ("message", "column", "text"),
    [
        (
            "line 2: count: got '-1'; expected a number, at least 0",
            "",
            "x,y,count\n1,2,-1\n",
        ),
        (
            "count: got 'many'; expected a number, at least 0",
            "",
            "x,y,count\n1,2,many\n",
        ),
        ("column: got 'cars'; expected one of x, y", "cars", "x,y\n1,2\n"),
        (
            "lat and lon: got nothing; expected x and y, or lat and lon",
            "",
            "count\n1\n",
        ),
        ("got nothing; expected a row for each place", "", "x,y\n"),
    ],
)
def test_bad_counts_are_one_line(tmp_path, message, column, text):
    path = tmp_path / "counts.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_counts(path, crs=CRS, column=column)


def test_a_map_of_no_known_place_takes_no_layers(tmp_path):
    path = geojson(tmp_path / "areas.geojson", (square(0.01), {}))
    with pytest.raises(
        InputError, match=r"expected a map that says where on earth it lies"
    ):
        read_areas(path, crs="")


def test_points_snap_to_the_nearest_junction_within_a_distance():
    junctions = np.array(
        [
            [0.0, 0.0],
            [100.0, 0.0],
        ]
    )
    points = np.array(
        [
            [10.0, 0.0],
            [70.0, 0.0],
            [100.0, 31.0],
        ]
    )
    nearest, distance = snap(points, junctions, within_m=30.0)

    assert nearest.tolist() == [0, 1, -1]
    assert distance.tolist() == [10.0, 30.0, 31.0]


def test_areas_hold_what_lies_in_them_or_near(tmp_path):
    path = geojson(
        tmp_path / "areas.geojson",
        (square(0.001), {"name": "north"}),
        (point(), {"Min_APR": 0.5}),
    )
    areas = read_areas(path, crs=CRS)

    assert [area.name for area in areas] == ["north", "area 2"]
    assert areas[1].values["min_apr"] == 0.5

    points = np.array([HERE + [10.0, 0.0], HERE + [1000.0, 0.0]])
    assert areas_of(areas, points) == [[0], []]
    assert areas_of(areas, points, within_m=20.0) == [[0, 1], []]
