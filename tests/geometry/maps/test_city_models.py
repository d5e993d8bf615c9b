import copy
import json

import numpy as np
import pytest
from refusal_words import refused_about

from geometry.maps.city_models import read_cityjson
from geometry.maps.source_map import is_closed, kind_of_class, volume_m3

# A house of 6 m x 8 m x 5 m in millimetres.
CORNERS = [[x, y, z] for x in (0, 6000) for y in (0, 8000) for z in (0, 5000)]
SHELL = [
    [[0, 1, 3, 2]],
    [[4, 6, 7, 5]],
    [[0, 4, 5, 1]],
    [[2, 3, 7, 6]],
    [[0, 2, 6, 4]],
    [[1, 5, 7, 3]],
]
HOUSE = {
    "type": "Building",
    "geometry": [{"type": "Solid", "lod": "2", "boundaries": [SHELL]}],
}
FOOTPRINT = {"type": "MultiSurface", "lod": "0", "boundaries": [[[0, 4, 6, 2]]]}
CITY = {
    "type": "CityJSON",
    "version": "2.0",
    "transform": {"scale": [0.001] * 3, "translate": [390_000.0, 5_819_000.0, 30.0]},
    "metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/25833"},
    "CityObjects": {"house": HOUSE},
    "vertices": CORNERS,
}


def write(tmp_path, city, name="city.json"):
    path = tmp_path / name
    path.write_text(json.dumps(city))
    return path


def city_of(**objects):
    return CITY | {"CityObjects": objects}


def volume(thing):
    return volume_m3(thing.vertices_m, thing.triangles)


@pytest.mark.parametrize("version", ["1.0", "1.1", "2.0"])
def test_a_solid_is_read_where_it_stands(tmp_path, version):
    source = read_cityjson(write(tmp_path, CITY | {"version": version}))
    (thing,) = source.things

    assert source.crs == "EPSG:25833"
    assert source.heights == "absolute"
    assert thing.class_name == "building"
    assert np.allclose(thing.vertices_m.min(axis=0), [390_000.0, 5_819_000.0, 30.0])
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
def test_every_kind_of_geometry_gives_the_same_solid(tmp_path, kind, boundaries):
    house = {
        "type": "Building",
        "geometry": [{"type": kind, "lod": "2.2", "boundaries": boundaries}],
    }
    (thing,) = read_cityjson(write(tmp_path, city_of(house=house))).things
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
def test_the_level_of_detail_that_serves_best_is_taken(tmp_path, levels, best):
    geometries = []
    for index, level in enumerate(levels):
        if index == best:
            shell = SHELL
        else:
            shell = SHELL[:3]
        geometries.append({"type": "MultiSurface", "lod": level, "boundaries": shell})
    house = {"type": "Building", "geometry": geometries}
    (thing,) = read_cityjson(write(tmp_path, city_of(house=house))).things

    assert len(thing.triangles) == 12


def test_footprints_are_raised_by_their_measured_height(tmp_path):
    house = {
        "type": "Building",
        "attributes": {"measuredHeight": 7.5},
        "geometry": [FOOTPRINT],
    }
    (thing,) = read_cityjson(write(tmp_path, city_of(house=house))).things

    assert volume(thing) == pytest.approx(48.0 * 7.5)
    assert np.ptp(thing.vertices_m[:, 2]) == pytest.approx(7.5)
    assert not thing.is_height_assumed


@pytest.mark.parametrize("height", [None, 1e9, "tall", True])
def test_footprints_without_a_possible_height_get_the_default(tmp_path, height):
    house = {
        "type": "Building",
        "attributes": {"measuredHeight": height},
        "geometry": [FOOTPRINT],
    }
    (thing,) = read_cityjson(write(tmp_path, city_of(house=house))).things

    assert thing.is_height_assumed
    assert np.ptp(thing.vertices_m[:, 2]) == pytest.approx(
        kind_of_class("building").height_m
    )


def test_a_footprint_gives_way_to_the_parts_of_its_building(tmp_path):
    house = {"type": "Building", "geometry": [FOOTPRINT], "children": ["part"]}
    part = HOUSE | {"type": "BuildingPart", "parents": ["house"]}
    source = read_cityjson(write(tmp_path, city_of(house=house, part=part)))

    assert [thing.id for thing in source.things] == ["part"]


def test_classes_follow_types_and_the_names_of_furniture(tmp_path):
    objects = {
        "tree": HOUSE | {"type": "SolitaryVegetationObject"},
        "kiosk": HOUSE | {"type": "CityFurniture"},
        "lamp": HOUSE
        | {"type": "CityFurniture", "attributes": {"function": "street lamp"}},
        "tower": HOUSE | {"type": "OtherConstruction"},
        "deck": HOUSE | {"type": "Bridge"},
        "meadow": HOUSE | {"type": "LandUse"},
        "soil": HOUSE | {"type": "LandUse"},
    }
    source = read_cityjson(write(tmp_path, city_of(**objects)))

    assert {thing.id: thing.class_name for thing in source.things} == {
        "tree": "vegetation",
        "kiosk": "wall",
        "lamp": "lamp post",
        "tower": "wall",
    }
    assert [skip.what for skip in source.skipped] == ["1 Bridge", "2 LandUse"]


def test_copies_of_templates_are_told(tmp_path):
    placed = {"type": "GeometryInstance", "template": 0, "boundaries": [7]}
    tree = {"type": "SolitaryVegetationObject", "geometry": [placed]}
    source = read_cityjson(write(tmp_path, city_of(house=HOUSE, tree=tree)))

    assert [thing.id for thing in source.things] == ["house"]
    assert [skip.what for skip in source.skipped] == ["1 SolitaryVegetationObject"]


def broken(**changes):
    city = copy.deepcopy(CITY)
    for key, value in changes.items():
        city[key] = value
    return city


def house_with(boundaries, kind="Solid"):
    return city_of(
        house={
            "type": "Building",
            "geometry": [{"type": kind, "lod": "2", "boundaries": boundaries}],
        }
    )


@pytest.mark.parametrize(
    ("city", "message"),
    [
        (broken(type="FeatureCollection"), "type"),
        (broken(version="3.7"), "version"),
        (
            broken(transform={"scale": [1, 1, 1], "translate": [0, 0, None]}),
            "transform.translate",
        ),
        (broken(vertices=[[1, 2]]), "vertices"),
        (
            broken(
                vertices=[[1e308, 1e308, 1e308]] * 8,
                transform={"scale": [1e9] * 3, "translate": [0] * 3},
            ),
            "finite",
        ),
        (broken(CityObjects={}), "no building"),
        (house_with([[[[0, 1, 99]]]]), "house.geometry"),
        (house_with([[[0, 1, 2]]]), "boundaries"),
        (house_with([[[[0, 0, 0]]]]), "no surface with an area"),
    ],
)
def test_broken_files_are_refused_in_one_line(tmp_path, city, message):
    with refused_about(message) as caught:
        read_cityjson(write(tmp_path, city))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "{", "[" * 100_000, "\n\n", "1", "\ufeff{}", '{"type": NaN}']
)
def test_what_is_no_city_is_refused(tmp_path, text):
    path = tmp_path / "city.json"
    path.write_text(text)
    with refused_about(r"CityJSON|city\.json: type: got"):
        read_cityjson(path)


def test_what_is_no_text_is_refused(tmp_path):
    path = tmp_path / "city.json"
    path.write_bytes(b"\xff\xfe\x00")

    with refused_about("UTF-8"):
        read_cityjson(path)
    with refused_about("readable"):
        read_cityjson(tmp_path / "none.json")


def test_real_houses_have_the_volumes_that_their_source_gives(real_input):
    path = real_input("buildings/3dbag_b2.city.json")
    source = read_cityjson(path)
    said = [
        entry["attributes"]["b3_volume_lod22"]
        for entry in json.loads(path.read_text())["CityObjects"].values()
        if entry["type"] == "Building"
    ]

    assert source.crs == "EPSG:28992"
    assert sorted(volume(thing) for thing in source.things) == pytest.approx(
        sorted(said), rel=1e-3
    )


def test_real_city_without_reference_system(real_input):
    source = read_cityjson(real_input("buildings/rotterdam_subset.city.json"))
    assert len(source.things) == 16
    assert source.crs == ""
    assert all(8.0 < np.ptp(thing.vertices_m[:, 2]) < 30.0 for thing in source.things)
