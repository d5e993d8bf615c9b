"""Where on earth a file lies."""

import pytest
from opendrive_text import document, read_text, road

_DEGREES = "degrees or geocentric, while roads are in metres on a plane"
_WKT = (
    'PROJCRS["x",BASEGEOGCRS["WGS 84",DATUM["World Geodetic System 1984",ELLIPSOID["WGS'
    ' 84",'
    '6378137,298.257223563]]],CONVERSION["tm",METHOD["Transverse'
    ' Mercator"],PARAMETER["Latitude of '
    'natural origin",49,ANGLEUNIT["degree",0.0174532925199433]],PARAMETER["Longitude of'
    " natural "
    'origin",8,ANGLEUNIT["degree",0.0174532925199433]],PARAMETER["Scale factor at'
    ' natural origin",'
    '1],PARAMETER["False easting",0],PARAMETER["False'
    ' northing",0]],CS[Cartesian,2],AXIS["e",east],'
    'AXIS["n",north],LENGTHUNIT["metre",1]]'
)


def _read(tmp_path, reference):
    """What is read of a document with a header."""
    header = f"<geoReference><![CDATA[{reference}]]></geoReference>"
    return read_text(tmp_path, document(road(), header=header))


@pytest.mark.parametrize(
    "reference",
    [
        "EPSG:32632",
        "+proj=tmerc +lat_0=49 +lon_0=8 +datum=WGS84",
        "+init=epsg:25832",
        _WKT,
    ],
)
def test_a_projection_in_metres_is_taken(tmp_path, reference):
    source = _read(tmp_path, f"\n  {reference}\n ")
    assert source.crs == source.source_crs == reference
    assert not source.skipped


def test_carla_writes_a_point_and_means_a_projection(tmp_path):
    source = _read(tmp_path, "+lat_0=4.9e+1 +lon_0=8")
    assert source.crs == source.source_crs
    assert source.crs.startswith("+proj=tmerc +lat_0=4.9e+1 +lon_0=8 +k=1 ")
    assert not source.skipped


def test_what_a_projection_says_about_heights_is_left_out(tmp_path):
    reference = "+proj=utm +zone=32 +geoidgrids=egm96_15.gtx +vunits=m +ellps=GRS80"
    source = _read(tmp_path, reference)

    assert source.crs == "+proj=utm +zone=32 +ellps=GRS80"
    assert source.source_crs == reference


@pytest.mark.long
@pytest.mark.parametrize(
    ("reference", "why"),
    [
        ("EPSG:4326", _DEGREES),
        ("+proj=longlat +datum=WGS84", _DEGREES),
        ("EPSG:2263", "not in metres"),
        ("somewhere", "not a coordinate reference system that pyproj knows"),
        ("+proj=tmerc " * 5000, "longer than 20000 characters"),
    ],
)
def test_others_are_noted(tmp_path, reference, why):
    source = _read(tmp_path, reference)
    assert source.crs == ""
    assert source.source_crs == reference.strip()
    assert [note.why for note in source.skipped] == [why]


def test_a_file_need_not_say_where_it_lies(tmp_path):
    source = read_text(tmp_path, document(road()))
    assert source.crs == ""
    assert source.source_crs == ""
    assert source.skipped == ()
    assert source.heights == "absolute"


def test_the_offset_brings_lanes_into_the_projection(tmp_path):
    header = '<offset x="500000" y="5400000" z="100" hdg="0"/>'
    source = read_text(tmp_path, document(road(), header=header))
    lane = next(one for one in source.lanes if one.id == "1/-1")

    assert lane.centreline_m[0].tolist() == [500000.0, 5399998.25, 100.0]
