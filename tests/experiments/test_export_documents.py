"""The layout file against its JSON schema, and the sensor information of CPMs."""

import copy
import json
from dataclasses import replace
from importlib.resources import files

import jsonschema
import numpy as np
import pytest
from export_layouts import (
    awkward_layout,
    large_layout,
    level_layout,
    map_scene,
    placeless_scene,
)
from hypothesis import given
from hypothesis import strategies as st
from json_files import write_json
from pyproj import Transformer

from experiments.export.cpm import to_cpm
from experiments.export.json import to_json
from geometry.actors import load_actors
from geometry.errors import InputError
from geometry.lidar import LidarModel, load_lidars
from geometry.poses import Pose
from geometry.study_scene import load_study_scene
from placement.layout import (
    RESERVED_IDS,
    SCHEMA,
    Layout,
    layout_records,
    load_carlancap_layout,
    load_layout,
)


@pytest.fixture(scope="module")
def validator():
    """Validator of layout files, whose schema is one."""
    text = (files("experiments") / "data/layout.schema.json").read_text()
    schema = json.loads(text)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["properties"]["schema"]["const"] == SCHEMA
    assert schema["$defs"]["unit"]["properties"]["id"]["not"]["enum"] == list(
        RESERVED_IDS
    )
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("build", [awkward_layout, large_layout, load_carlancap_layout])
def test_layout_files_are_as_the_schema_says_and_read_back(build, validator, tmp_path):
    layout = build()
    text = to_json(layout)
    validator.validate(json.loads(text))
    path = tmp_path / "layout.json"
    path.write_text(text)
    again = load_layout(path)

    assert again.name == layout.name
    assert again.scene_name == layout.scene_name
    assert layout_records(again) == layout_records(layout)
    assert [unit.sensor for unit in again.units] == [
        unit.sensor for unit in layout.units
    ]


OWN = 'my "own", camera'
GONE = object()
DAMAGE = {  # where, and what stands there then
    "nothing": (["name"], "a name"),
    "no name": (["name"], GONE),
    "no scene": (["scene"], GONE),
    "no schema": (["schema"], GONE),
    "no site": (["layout", 0, "site"], GONE),
    "another key": (["layout", 0, "note"], "painted green"),
    "null latency": (["layout", 0, "latency_s"], None),
    "no layout": (["layout"], GONE),
    "no units": (["layout"], []),
    "text for a unit": (["layout"], ["a"]),
    "no id": (["layout", 0, "id"], GONE),
    "empty id": (["layout", 0, "id"], ""),
    "reserved id": (["layout", 0, "id"], "rsu_all"),
    "number for an id": (["layout", 0, "id"], 7),
    "no camera": (["layout", 0, "camera"], GONE),
    "camera and lidar": (["layout", 0, "lidar"], "carla-ncap-lidar"),
    "text for a number": (["layout", 0, "x_m"], "1"),
    "truth for a number": (["layout", 0, "yaw_deg"], True),
    "no height": (["layout", 0, "z_m"], GONE),
    "overturned": (["layout", 0, "pitch_deg"], -90.5),
    "late before": (["layout", 0, "latency_s"], -0.1),
    "number for a site": (["layout", 0, "site"], 3),
    "list of sensors": (["sensors"], []),
    "sensor of no kind": (["sensors", OWN, "kind"], GONE),
    "sensor without a width": (["sensors", OWN, "width_px"], GONE),
    "flat sensor": (["sensors", OWN, "height_px"], 0),
    "sensor all around": (["sensors", OWN, "horizontal_fov_deg"], 180.0),
    "sensor for less than nothing": (["sensors", OWN, "price_eur"], -1),
}
FINE = list(DAMAGE)[:7]


@pytest.mark.parametrize("what", DAMAGE)
def test_the_schema_refuses_what_the_reader_refuses(what, validator, tmp_path):
    damaged = json.loads(to_json(awkward_layout()))
    (*way, key), value = DAMAGE[what]
    place = damaged
    for step in way:
        place = place[step]
    if value is GONE:
        del place[key]
    else:
        place[key] = value
    path = tmp_path / "layout.json"
    write_json(path, damaged)
    if what in FINE:
        load_layout(path)
        assert validator.is_valid(damaged)
    else:
        with pytest.raises(InputError):
            load_layout(path)
        assert not validator.is_valid(damaged)


def test_an_own_lidar_is_in_the_schema(validator):
    layout = level_layout(0.0, kind="lidar")
    (one,) = layout.units
    own = replace(one, sensor=replace(one.sensor, name="mine"))
    document = json.loads(to_json(replace(layout, units=(own,))))

    assert document["sensors"]["mine"]["kind"] == "lidar"

    validator.validate(document)
    for key in list(document["sensors"]["mine"]):
        damaged = copy.deepcopy(document)
        del damaged["sensors"]["mine"][key]
        assert not validator.is_valid(damaged), key
    for fov_deg, is_fine in (
        (360.0, True),
        (360.1, False),
    ):
        document["sensors"]["mine"]["horizontal_fov_deg"] = fov_deg
        assert validator.is_valid(document) == is_fine


# Ranges of ETSI TS 102 894-2 V2.1.1; values that mean "unknown" or are not used are
# left out.
ANGLE = range(3600)
OFFSET = range(-32767, 32767)
LENGTH = range(1, 4094)


def stations_of(layout, scene):
    """Stations of a file of messages."""
    document = json.loads(to_cpm(layout, scene))
    assert document["standard"].startswith("ETSI TS 103 324")
    return document["stations"]


def sensors_of(station):
    """Sensors of a station."""
    rsu, information = station["messages"][0]["payload"]["cpmContainers"]
    assert rsu == {"containerId": 2, "containerData": {}}
    assert information["containerId"] == 3
    sensors = information["containerData"]
    assert 1 <= len(sensors) <= 128
    assert [sensor["sensorId"] for sensor in sensors] == list(
        range(len(station["units"]))
    )
    return sensors


@pytest.mark.parametrize("build", [awkward_layout, large_layout, load_carlancap_layout])
@pytest.mark.parametrize("scene", [load_study_scene(), map_scene()])
def test_cpm_sensors_are_where_the_units_are(build, scene):
    layout = build()
    to_local = Transformer.from_crs("EPSG:4326", scene.crs, always_xy=True)
    units = {unit.id: unit for unit in layout.units}
    named = []
    for station in stations_of(layout, scene):
        reference = station["messages"][0]["payload"]["managementContainer"][
            "referencePosition"
        ]
        assert all(isinstance(reference[key], int) for key in ("latitude", "longitude"))

        origin = to_local.transform(
            reference["longitude"] / 1e7, reference["latitude"] / 1e7
        )
        for name, sensor in zip(station["units"], sensors_of(station), strict=True):
            unit = units[name]
            assert unit.site_id == station["site"]
            assert sensor["sensorType"] == (
                2 if isinstance(unit.sensor, LidarModel) else 3
            )

            shape = sensor["perceptionRegionShape"]["radial"]
            offset = [
                shape["shapeReferencePoint"][f"{axis}Coordinate"] for axis in "xyz"
            ]
            assert all(value in OFFSET for value in offset)

            found_m = np.append(origin, 0.0) + np.array(offset) / 100.0
            # n stands for more than n - 1 and at most n centimetres.
            above_m = found_m - unit.pose.position_m

            assert above_m.min() > -1e-4
            assert above_m.max() < 0.0101
            assert shape["range"] in LENGTH
            assert all(value in ANGLE for key, value in shape.items() if "Angle" in key)
        named += station["units"]

    assert sorted(named) == sorted(units)


@given(
    yaw_deg=st.floats(-180.0, 180.0),
    pitch_deg=st.floats(-45.0, 45.0),
    kind=st.sampled_from(["camera", "lidar"]),
)
def test_cpm_opens_from_left_to_right_and_from_below_to_above(yaw_deg, pitch_deg, kind):
    layout = level_layout(yaw_deg, pitch_deg, kind=kind)
    (station,) = stations_of(layout, load_study_scene())
    shape = sensors_of(station)[0]["perceptionRegionShape"]["radial"]
    sensor = layout.units[0].sensor
    for start, end, middle_deg, fov_deg in (
        (
            "stationaryHorizontalOpeningAngleStart",
            "stationaryHorizontalOpeningAngleEnd",
            90.0 - yaw_deg,
            sensor.horizontal_fov_deg,
        ),
        (
            "verticalOpeningAngleStart",
            "verticalOpeningAngleEnd",
            pitch_deg,
            sensor.vertical_fov_deg,
        ),
    ):
        opening = (shape[end] - shape[start]) % 3600 / 10.0
        assert opening == pytest.approx(fov_deg, abs=0.11)

        middle = shape[start] / 10.0 + 0.5 * opening
        assert (middle - middle_deg + 180.0) % 360.0 - 180.0 == pytest.approx(
            0.0, abs=0.16
        )


def test_cpm_by_hand():
    layout = level_layout(90.0, -10.0)  # looks north, 110 degrees wide
    (station,) = stations_of(layout, load_study_scene())

    assert station["site"] == ""
    assert station["units"] == ["one"]

    (sensor,) = sensors_of(station)
    # 2 atan(tan(55 deg) 1080 / 1920) = 77.56 deg high: -48.8 .. 28.8 deg, tenths
    # rounded up. As far as an adult is 40 px high.
    shape = sensor["perceptionRegionShape"]["radial"]
    adult_m = load_actors()["adult"].height_m

    assert shape.pop("range") == int(np.ceil(10.0 * 672.2 * adult_m / 40.0))
    assert shape == {
        "shapeReferencePoint": {"xCoordinate": 0, "yCoordinate": 0, "zCoordinate": 600},
        "stationaryHorizontalOpeningAngleStart": 3050,
        "stationaryHorizontalOpeningAngleEnd": 550,
        "verticalOpeningAngleStart": 3113,
        "verticalOpeningAngleEnd": 288,
    }
    assert sensor["shadowingApplies"] is True

    reference = station["messages"][0]["payload"]["managementContainer"][
        "referencePosition"
    ]
    assert reference["latitude"] == 490000000
    assert reference["longitude"] == 80000000

    lidar = stations_of(level_layout(0.0, kind="lidar"), load_study_scene())[0]
    assert sensors_of(lidar)[0]["perceptionRegionShape"]["radial"]["range"] == 2500


@pytest.mark.parametrize("yaw_deg", [0.0, 45.0, 180.0])
@pytest.mark.parametrize(
    ("pitch_deg", "low", "high"),
    [(0.0, 3375, 225), (-30.0, 3075, 525)],
)
def test_cpm_opens_all_but_a_tenth_of_a_turn_where_a_lidar_scans_all_round(
    yaw_deg, pitch_deg, low, high
):
    """A start that equals the end may mean nothing as well as all."""
    (unit,) = level_layout(yaw_deg, pitch_deg, kind="lidar").units
    ring = replace(unit, sensor=load_lidars()["ouster-os1-128"])
    (station,) = stations_of(Layout(name="ring", units=(ring,)), load_study_scene())
    shape = sensors_of(station)[0]["perceptionRegionShape"]["radial"]

    assert shape["stationaryHorizontalOpeningAngleStart"] == 0
    assert shape["stationaryHorizontalOpeningAngleEnd"] == 3599
    assert shape["verticalOpeningAngleStart"] == low
    assert shape["verticalOpeningAngleEnd"] == high
    assert shape["range"] == 1200


def test_cpm_does_not_open_beyond_straight_down():
    (station,) = stations_of(level_layout(0.0, -90.0), load_study_scene())
    shape = sensors_of(station)[0]["perceptionRegionShape"]["radial"]
    assert shape["verticalOpeningAngleStart"] == 2700


def test_cpm_refuses_what_the_standard_has_no_numbers_for():
    with pytest.raises(InputError, match=r"^cpm: got a scene without crs"):
        to_cpm(awkward_layout(), placeless_scene())

    one = level_layout(0.0).units[0]
    many = tuple(replace(one, id=f"{index}", site_id="mast") for index in range(129))
    with pytest.raises(
        InputError, match=r"^cpm: mast: got 129 units; expected at most 128$"
    ):
        to_cpm(Layout(name="many", units=many), load_study_scene())

    far = replace(
        one,
        id="far",
        site_id="mast",
        pose=Pose(position_m=[700.0, 0.0, 6.0], yaw_deg=0.0),
    )
    near = replace(one, site_id="mast")
    with pytest.raises(
        InputError, match=r"^cpm: mast: got .* expected at most 327.66 m$"
    ):
        to_cpm(Layout(name="far", units=(near, far)), load_study_scene())
