"""Houses and trees out of CityJSON."""

import json
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose

from geometry.errors import InputError
from geometry.maps.city_models import read_cityjson
from geometry.maps.source_map import is_closed, kind_of_class, volume_m3

# A house of 6 m x 8 m x 5 m in millimetres.
CORNERS = list(product((0, 6000), (0, 8000), (0, 5000)))
SHELL = json.loads(
    "[[[0,1,3,2]], [[4,6,7,5]], [[0,4,5,1]], [[2,3,7,6]], [[0,2,6,4]], [[1,5,7,3]]]"
)


def shape(boundaries, kind="Solid", lod="2"):
    """A geometry of CityJSON."""
    return {"type": kind, "lod": lod, "boundaries": boundaries}


def building(*geometries, **more):
    """A building of CityJSON."""
    return {"type": "Building", "geometry": geometries} | more


HOUSE = building(shape([SHELL]))
FOOTPRINT = shape([[[0, 4, 6, 2]]], kind="MultiSurface", lod="0")
CITY = {
    "type": "CityJSON",
    "version": "2.0",
    "transform": {"scale": [0.001] * 3, "translate": [390_000.0, 5_819_000.0, 30.0]},
    "metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/25833"},
    "CityObjects": {"house": HOUSE},
    "vertices": CORNERS,
}


@pytest.fixture
def read(tmp_path):
    """A function that reads a city."""

    def build(city):
        path = tmp_path / "city.json"
        path.write_text(json.dumps(city))
        return read_cityjson(path)

    return build


@pytest.fixture
def only_thing(read):
    """A function that reads a city with one building: its thing."""

    def build(house):
        (thing,) = read(city_of(house=house)).things
        return thing

    return build


def city_of(**objects):
    """A city with these objects."""
    return CITY | {"CityObjects": objects}


def volume(thing):
    """Volume of a thing. [m3]"""
    return volume_m3(thing.vertices_m, thing.triangles)


@pytest.mark.parametrize("version", ["1.0", "1.1", "2.0"])
def test_a_solid_is_read_where_it_stands(read, version):
    source = read(CITY | {"version": version})
    (thing,) = source.things

    assert source.crs == "EPSG:25833"
    assert source.heights == "absolute"
    assert thing.class_name == "building"
    assert_allclose(thing.vertices_m.min(axis=0), [390_000.0, 5_819_000.0, 30.0])
    assert volume(thing) == pytest.approx(240.0)
    assert is_closed(thing.triangles)


@pytest.mark.parametrize(
    ("kind", "boundaries"),
    [
        ("MultiSurface", SHELL),
        ("CompositeSurface", SHELL),
        ("Solid", [SHELL]),
        ("MultiSolid", [[SHELL]]),
        ("CompositeSolid", [[SHELL]]),
    ],
)
def test_every_kind_of_geometry_gives_the_same_solid(only_thing, kind, boundaries):
    thing = only_thing(building(shape(boundaries, kind, lod="2.2")))
    assert volume(thing) == pytest.approx(240.0)


@pytest.mark.parametrize(
    ("levels", "best"),
    [
        (["1.2", "2.2", "1.3"], 1),
        (["0", "1"], 1),
        (["2.2", "3.1"], 0),
        (["0", "3"], 1),
    ],
)
def test_the_level_of_detail_that_serves_best_is_taken(only_thing, levels, best):
    geometries = []
    for index, level in enumerate(levels):
        shell = SHELL[:3]
        if index == best:
            shell = SHELL
        geometries.append(shape(shell, kind="MultiSurface", lod=level))
    assert len(only_thing(building(*geometries)).triangles) == 12


def test_footprints_are_raised_by_their_measured_height(only_thing):
    house = building(FOOTPRINT, attributes={"measuredHeight": 7.5})
    thing = only_thing(house)

    assert volume(thing) == pytest.approx(48.0 * 7.5)
    assert np.ptp(thing.vertices_m[:, 2]) == pytest.approx(7.5)
    assert not thing.is_height_assumed


@pytest.mark.parametrize("height", [None, 1e9, "tall", True])
def test_footprints_without_a_possible_height_get_the_default(only_thing, height):
    thing = only_thing(building(FOOTPRINT, attributes={"measuredHeight": height}))
    default_m = kind_of_class("building").height_m

    assert thing.is_height_assumed
    assert np.ptp(thing.vertices_m[:, 2]) == pytest.approx(default_m)


def test_a_footprint_gives_way_to_the_parts_of_its_building(read):
    house = building(FOOTPRINT, children=["part"])
    part = HOUSE | {"type": "BuildingPart", "parents": ["house"]}
    source = read(city_of(house=house, part=part))

    assert [thing.id for thing in source.things] == ["part"]


TYPES = {
    "tree": "SolitaryVegetationObject",
    "kiosk": "CityFurniture",
    "lamp": "CityFurniture",
    "tower": "OtherConstruction",
    "deck": "Bridge",
    "meadow": "LandUse",
    "soil": "LandUse",
}


def test_classes_follow_types_and_the_names_of_furniture(read):
    objects = {name: HOUSE | {"type": kind} for name, kind in TYPES.items()}
    objects["lamp"]["attributes"] = {"function": "street lamp"}
    source = read(city_of(**objects))

    assert {thing.id: thing.class_name for thing in source.things} == {
        "tree": "vegetation",
        "kiosk": "wall",
        "lamp": "lamp post",
        "tower": "wall",
    }
    assert [skip.what for skip in source.skipped] == ["1 Bridge", "2 LandUse"]


def test_copies_of_templates_are_told(read):
    placed = {"type": "GeometryInstance", "template": 0, "boundaries": [7]}
    tree = {"type": "SolitaryVegetationObject", "geometry": [placed]}
    source = read(city_of(house=HOUSE, tree=tree))

    assert [thing.id for thing in source.things] == ["house"]
    assert [skip.what for skip in source.skipped] == ["1 SolitaryVegetationObject"]


def house_with(boundaries):
    """A change of the city: a house of this solid."""
    return {"CityObjects": {"house": building(shape(boundaries))}}


NO_NUMBER = {"scale": [1, 1, 1], "translate": [0, 0, None]}
TOO_LARGE = {"scale": [1e9] * 3, "translate": [0] * 3}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"type": "FeatureCollection"}, "type"),
        ({"version": "3.7"}, "version"),
        ({"transform": NO_NUMBER}, "transform.translate"),
        ({"vertices": [[1, 2]]}, "vertices"),
        ({"vertices": [[1e308] * 3] * 8, "transform": TOO_LARGE}, "finite"),
        ({"CityObjects": {}}, "no building"),
        (house_with([[[[0, 1, 99]]]]), "house.geometry"),
        (house_with([[[0, 1, 2]]]), "boundaries"),
        (house_with([[[[0, 0, 0]]]]), "no surface with an area"),
    ],
)
def test_broken_files_are_refused_in_one_line(read, changes, message):
    with pytest.raises(InputError, match=message) as caught:
        read(CITY | changes)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "{", "[" * 100_000, "\n\n", "1", "\ufeff{}", '{"type": NaN}']
)
def test_what_is_no_city_is_refused(tmp_path, text):
    path = tmp_path / "city.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"CityJSON|city\.json: type: got"):
        read_cityjson(path)


def test_what_is_no_text_is_refused(tmp_path):
    path = tmp_path / "city.json"
    path.write_bytes(b"\xff\xfe\x00")

    with pytest.raises(InputError, match="UTF-8"):
        read_cityjson(path)
    with pytest.raises(InputError, match="readable"):
        read_cityjson(tmp_path / "none.json")


def test_real_houses_have_the_volumes_that_their_source_gives(real_input):
    path = real_input("buildings/3dbag_b2.city.json")
    source = read_cityjson(path)

    said = []
    for entry in json.loads(path.read_text())["CityObjects"].values():
        if entry["type"] == "Building":
            said.append(entry["attributes"]["b3_volume_lod22"])

    found = [volume(thing) for thing in source.things]

    assert source.crs == "EPSG:28992"
    assert sorted(found) == pytest.approx(sorted(said), rel=1e-3)


def test_real_city_without_reference_system(real_input):
    source = read_cityjson(real_input("buildings/rotterdam_subset.city.json"))
    assert len(source.things) == 16
    assert source.crs == ""
    for thing in source.things:
        assert 8.0 < np.ptp(thing.vertices_m[:, 2]) < 30.0
