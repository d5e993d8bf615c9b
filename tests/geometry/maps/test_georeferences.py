"""Where on earth points lie, by what files say of their coordinates."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod, Transformer

from geometry.errors import InputError
from geometry.maps.georeferences import georeference, horizontal_crs

BERLIN_UTM = np.array(
    [
        [390_000.0, 5_819_000.0],
        [390_300.0, 5_819_400.0],
    ]
)
IN_DEGREES = [
    (13.4, 52.5),
    (13.41, 52.51),
]
BERLIN_GK = np.array(
    [
        [4_590_000.0, 5_820_000.0],
        [4_590_100.0, 5_820_300.0],
    ]
)


def in_wgs84(crs, points):
    """Longitude and latitude of points (n, 2), in degrees."""
    transformer = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    return np.stack(transformer.transform(*points.T), axis=1)


def distance_m(lonlat):
    """Distance of two points on the ellipsoid."""
    _, _, found_m = Geod(ellps="WGS84").inv(*lonlat[0], *lonlat[1])
    return found_m


def test_projected_metres_stay():
    place = georeference(BERLIN_UTM, "EPSG:25833", where="f")
    assert place.crs == "EPSG:25833"
    assert place.source_crs == "EPSG:25833"
    assert place.notes == ()
    assert np.array_equal(place.to_metres(BERLIN_UTM, "f"), BERLIN_UTM)


@pytest.mark.parametrize(
    "spelling",
    [
        "urn:ogc:def:crs:EPSG::25833",
        "http://www.opengis.net/def/crs/EPSG/0/25833",
        "http://www.opengis.net/gml/srs/epsg.xml#25833",
        "urn:adv:crs:ETRS89_UTM33*DE_DHHN2016_NH",
        "urn:ogc:def:crs,crs:EPSG::25833,crs:EPSG::5783",
        "EPSG:25833+5783",
    ],
)
def test_spellings_of_one_reference_system_mean_the_same(spelling):
    assert georeference(BERLIN_UTM, spelling, where="f").crs == "EPSG:25833"


@given(lon=st.floats(-179.0, 178.0), lat=st.floats(-80.0, 80.0))
def test_degrees_become_metres_on_the_ground(lon, lat):
    points = np.array(
        [
            [lon, lat],
            [lon + 0.002, lat + 0.001],
        ]
    )
    place = georeference(points, "EPSG:4326", where="f")
    a, b = place.to_metres(points, "f")

    assert np.linalg.norm(b - a, axis=-1) == pytest.approx(distance_m(points), abs=1e-3)


def test_web_mercator_becomes_metres_on_the_ground():
    points = np.array(
        [
            [1_489_000.0, 6_894_000.0],
            [1_489_100.0, 6_894_000.0],
        ]
    )
    place = georeference(points, "EPSG:3857", where="f")
    a, b = place.to_metres(points, "f")
    true_m = distance_m(in_wgs84("EPSG:3857", points))

    assert np.linalg.norm(b - a, axis=-1) == pytest.approx(true_m, abs=1e-3)
    assert true_m < 62.0


def test_feet_become_metres_also_upwards():
    points = np.array(
        [
            [985_000.0, 200_000.0, 10.0],
            [985_100.0, 200_000.0, 20.0],
        ]
    )
    place = georeference(points[:, :2], "EPSG:2263", where="f")
    a, b = place.to_metres(points, "f")

    assert np.linalg.norm((b - a)[:2]) == pytest.approx(30.48, rel=1e-3)
    assert b[2] - a[2] == pytest.approx(3.048, rel=1e-5)


@pytest.mark.parametrize(
    "points",
    [
        pytest.param(BERLIN_GK[:, ::-1], id="northing first, as the definition says"),
        pytest.param(BERLIN_GK, id="the order that lies where the system is meant for"),
    ],
)
def test_of_two_orders_that_of_the_definition_is_taken_if_it_can_be(points):
    place = georeference(
        points,
        "urn:ogc:def:crs:EPSG::31468",
        where="f",
        follows_authority=True,
    )

    assert place.crs == "EPSG:31468"
    assert np.array_equal(place.to_metres(points, "f"), BERLIN_GK)


def test_latitude_comes_first_where_the_definition_says_so():
    points = np.array(
        [
            [35.68, 139.76],
            [35.681, 139.762],
        ]
    )
    place = georeference(
        points,
        "urn:ogc:def:crs:EPSG::6697",
        where="f",
        follows_authority=True,
    )
    back = in_wgs84(place.crs, place.to_metres(points, "f"))

    assert back == pytest.approx(points[:, ::-1], abs=1e-5)


def test_coordinates_from_nowhere_lose_their_reference_system_with_a_note():
    place = georeference([[0.0, 0.0], [100.0, 100.0]], "EPSG:3068", where="f")
    assert place.crs == ""
    assert "Berlin" in place.notes[0].why


def test_data_beside_an_area_of_use_keep_their_reference_system():
    # Passau is at 13.4 E; UTM 32 ends at 12.
    passau = np.array(
        [
            [830_000.0, 5_390_000.0],
            [830_100.0, 5_390_100.0],
        ]
    )

    assert georeference(passau, "EPSG:25832", where="f").crs == "EPSG:25832"


@pytest.mark.long
@pytest.mark.parametrize(
    "declared", ["EPSG:999999", "somewhere", "EPSG:5783", "+proj=nonsense"]
)
def test_unknown_reference_systems_are_noted(declared):
    place = georeference(BERLIN_UTM, declared, where="f")
    assert place.crs == ""
    assert declared in place.notes[0].what


@pytest.mark.parametrize("declared", ["", None])
def test_no_reference_system_needs_no_note(declared):
    place = georeference(BERLIN_UTM, declared, where="f")
    assert place.crs == ""
    assert place.notes == ()


@pytest.mark.parametrize(
    ("points", "declared", "message"),
    [
        (
            IN_DEGREES,
            "EPSG:25833",
            "degrees where metres are meant",
        ),
        (IN_DEGREES, "", "degrees where metres are meant"),
        (
            BERLIN_UTM,
            "EPSG:4326",
            "or another CRS where degrees are expected",
        ),
        (
            [(35.6, 139.7), (35.61, 139.71)],
            "EPSG:4326",
            "latitude and longitude swapped",
        ),
        ([(np.nan, 1.0)], "EPSG:25833", "not finite"),
        ([(np.inf, 1.0)], "", "not finite"),
        ([(1e15, 1.0), (0.0, 0.0)], "", "places on earth"),
        ([(1e15, 1.0), (0.0, 0.0)], "EPSG:25833", "places on earth"),
    ],
)
def test_impossible_coordinates_are_refused(points, declared, message):
    with pytest.raises(InputError, match=message):
        georeference(points, declared, where="f")


def test_vertical_parts_are_stripped():
    assert horizontal_crs("EPSG:7415").to_epsg() == 28992
