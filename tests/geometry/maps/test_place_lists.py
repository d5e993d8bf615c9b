"""Lists of sites as people have them: columns, units, and every mistake in them."""

import json

import numpy as np
import pytest
from pyproj import Transformer

from geometry.errors import InputError
from geometry.maps.place_lists import read_sites

UTM = "EPSG:25833"
AT_M = np.array([390_000.0, 5_819_000.0])
LON, LAT = Transformer.from_crs(UTM, "EPSG:4326", always_xy=True).transform(*AT_M)
LOCAL = (
    f"+proj=tmerc +lat_0={LAT} +lon_0={LON} +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m"
    " +no_defs"
)

FULL = (
    "ID;X_m;Y_m;Z;Min_Height_m;max_height;Kind;"
    "Cost_EUR;Power;fibre;Capacity;Forbidden;Remark\n"
    "a;390000;5819000;35.5;4;8;Lamp_Post;2500;yes;no;2;no;the old one\n"
    "b;390010.5;5819000;;;;;;;;;YES;\n"
)


def write(tmp_path, text, name="sites.csv"):
    """A file of a text."""
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def write_json(tmp_path, *features, **members):
    """A file of features, with further members of the collection."""
    table = {"type": "FeatureCollection", "features": features} | members
    return write(tmp_path, json.dumps(table), "sites.geojson")


def point(*position, **properties):
    """A feature: a point with properties."""
    geometry = {"type": "Point", "coordinates": position}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


@pytest.mark.parametrize("separator", [";", ",", "\t"])
def test_every_field_is_read_and_what_is_not_said_is_none(tmp_path, separator):
    a, b = read_sites(write(tmp_path, FULL.replace(";", separator)), crs=UTM)
    expected = {
        "id": "a",
        "kind": "lamp post",
        "z_m": 35.5,
        "min_height_m": 4.0,
        "max_height_m": 8.0,
        "cost_eur": 2500.0,
        "capacity_units": 2,
        "has_power": True,
        "has_fibre": False,
        "is_forbidden": False,
    }
    unsaid = [
        "z_m",
        "min_height_m",
        "max_height_m",
        "cost_eur",
        "capacity_units",
        "has_power",
        "has_fibre",
    ]

    assert {name: getattr(a, name) for name in expected} == expected
    assert a.position_m.tolist() == AT_M.tolist()
    assert b.id == "b"
    assert b.kind == ""
    assert b.position_m.tolist() == [390_010.5, 5_819_000.0]
    assert {getattr(b, name) for name in unsaid} == {None}
    assert b.is_forbidden
    assert a.n_said > b.n_said == 1


@pytest.mark.parametrize(
    ("crs", "at_m"),
    [
        (UTM, AT_M),
        (LOCAL, np.zeros(2)),
    ],
)
def test_degrees_are_projected(tmp_path, crs, at_m):
    text = f"id,latitude_deg,Longitude\na,{LAT:.9f},{LON:.9f}\n"
    (site,) = read_sites(write(tmp_path, text), crs=crs)
    assert site.position_m == pytest.approx(at_m, abs=0.01)


def test_geojson_points_are_read_with_their_heights_and_properties(tmp_path):
    path = write_json(
        tmp_path,
        point(LON, LAT, 35.0, id=7, power="no", cost_eur=10),
        point(LON, LAT, ID="b"),
    )
    a, b = read_sites(path, crs=UTM)

    assert a.id == "7"
    assert a.z_m == 35.0
    assert not a.has_power
    assert a.cost_eur == 10.0
    assert b.id == "b"
    assert a.position_m == pytest.approx(AT_M, abs=0.01)


def test_geojson_in_another_reference_system_is_projected(tmp_path):
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::3857"}}
    x, y = Transformer.from_crs(UTM, "EPSG:3857", always_xy=True).transform(*AT_M)
    (site,) = read_sites(write_json(tmp_path, point(x, y, id="a"), crs=crs), crs=UTM)

    assert site.position_m == pytest.approx(AT_M, abs=0.01)


def test_sites_of_a_scene_from_nowhere_are_in_its_metres(tmp_path):
    (site,) = read_sites(write(tmp_path, "id,x,y\na,3.5,-2\n"), crs="")
    assert site.position_m.tolist() == [3.5, -2.0]
    with pytest.raises(InputError, match="where on earth"):
        read_sites(write(tmp_path, "id,lat,lon\na,52,13\n"), crs="")


@pytest.mark.parametrize(
    ("where", "text"),
    [
        ("no sites", ""),
        ("line 2: got 2 fields", "id,x,y\na,1\n"),
        ("line 3: id", "id,x,y\na,1,2\n,1,2\n"),
        ("line 3: id", "id,x,y\na,1,2\na,1,2\n"),
        ("line 2: x", "id,x,y\na,one,2\n"),
        ("line 2: x", "id,x,y\na,nan,2\n"),
        ("columns id, x: got no y; expected one of y, northing, hochw", "id,x\na,1\n"),
        ("columns id, lat: got no lon; expected one of lon, lng", "id,lat\na,1\n"),
        (r"columns id: got no place; expected x and y \(x, easting, .*lat", "id\na\n"),
        ("columns x, y: got no id; expected one of id, .*mastnummer", "x,y\n1,2\n"),
        ("line 2: cost", "id,x,y,cost_eur\na,1,2,-3\n"),
        ("line 2: capacity", "id,x,y,capacity\na,1,2,0\n"),
        ("line 2: power", "id,x,y,power\na,1,2,maybe\n"),
        ("line 2: max_height", "id,x,y,min_height_m,max_height_m\na,1,2,8,4\n"),
        ("metres and euros", "id,x,y,max_height_ft\na,1,2,8\n"),
        ("a second x", "id,x,y,X_m\na,1,2,8\n"),
        ("CSV", 'id,x,y\n"a,1,2\n'),
        ("latitude and longitude swapped", "id,lat,lon\na,13.4,52.5\n"),
        ("line 2: lon", "id,lat,lon\na,52,500\n"),
    ],
)
@pytest.mark.parametrize("crs", [UTM, LOCAL])
def test_every_mistake_names_line_and_field(tmp_path, where, text, crs):
    with pytest.raises(InputError, match=where) as caught:
        read_sites(write(tmp_path, text), crs=crs)
    assert "\n" not in str(caught.value)
    assert "sites.csv" in str(caught.value)


@pytest.mark.parametrize(
    ("feature", "where"),
    [
        (point(LAT, LON, id="a"), "swapped"),
        (point(390_000.0, 5_819_000.0, id="a"), r"features\[0\]: lat"),
        (point(LON, LAT), "columns: got no id; expected one of id,"),
        (point(LON, LAT, id=""), r"features\[0\]: id"),
        (point(LON, LAT, id="a", capacity="many"), r"features\[0\]: capacity"),
        (point(LON, LAT, id="a", cost=[1]), r"features\[0\]: cost"),
        (
            {"geometry": {"type": "LineString", "coordinates": [[1, 2], [3, 4]]}},
            "a Point",
        ),
        ({"geometry": None, "properties": {"id": "a"}}, "lat and lon"),
    ],
)
def test_every_mistake_in_geojson_names_feature_and_field(tmp_path, feature, where):
    with pytest.raises(InputError, match=where):
        read_sites(write_json(tmp_path, feature), crs=UTM)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="one of"):
        read_sites(tmp_path / "sites.xlsx", crs=UTM)
    with pytest.raises(InputError, match="readable"):
        read_sites(tmp_path / "sites.csv", crs=UTM)


def test_lists_as_people_have_them(tmp_path, caplog):
    lon_text = f"{LON:.9f}".replace(".", ",")
    text = (
        "Name;Breite [°];Länge (deg);Höhe (m);Kosten in EUR;Art;Eigentümer\n"
        f"Mast 1;{LAT:.9f};{lon_text};7,5;1.250,50;Mast;Stadt\n"
    )
    path = write(tmp_path, text)
    (site,) = read_sites(path, crs=UTM)

    assert site.position_m == pytest.approx(AT_M, abs=0.01)
    assert site.max_height_m == 7.5
    assert site.cost_eur == 1250.5
    assert site.kind == "mast"
    assert caplog.messages == [
        f"{path}: columns that are not known, and not read: Eigentümer"
    ]


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("7,5", 7.5),
        ("1.234,5", 1234.5),
        ("1,234.5", 1234.5),
        ("-2,25", -2.25),
    ],
)
def test_a_comma_may_be_the_decimal_point(tmp_path, text, number):
    (site,) = read_sites(write(tmp_path, f"id;x;y\na;{text};0\n"), crs="")
    assert site.position_m[0] == number
