"""Layouts as text of each format, read back."""

import csv
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from refusals import refused_with
from tiny_worlds import unit_at

from experiments.export import load_format
from experiments.export.carla import to_carla
from experiments.export.csv import to_csv
from experiments.export.geojson import to_geojson
from experiments.export.json import to_json_text
from geometry.frames import from_carla_pose
from geometry.lidar import load_lidars
from geometry.study_scene import load_study_scene
from placement.layout import Layout, layout_records, load_carlancap_layout

CRS = load_study_scene().crs


def test_csv_reads_back_bit_by_bit(layout, tmp_path):
    """By Python's own reader; pandas' parser may be off by the last bit."""
    records = layout_records(layout)
    path = tmp_path / "layout.csv"
    path.write_text(to_csv(layout))

    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))

    for row, record in zip(rows, records, strict=True):
        typed = {}
        for key, value in row.items():
            kind = type(record[key])
            typed[key] = kind(value)
        assert typed == record

    by_pandas = pd.read_csv(path)
    expected = pd.DataFrame(records)
    pd.testing.assert_frame_equal(by_pandas, expected, rtol=1e-15)


def test_geojson_is_at_the_junction_with_bearings():
    """Bearings turn clockwise from north, yaws the other way from east."""
    layout = load_carlancap_layout()
    document = json.loads(to_geojson(layout, CRS))

    assert document["type"] == "FeatureCollection"

    for feature in document["features"]:
        longitude, latitude, _ = feature["geometry"]["coordinates"]
        # West of 8 degrees east: the study's junction has negative x.
        assert 7.99 < longitude < 8.0
        assert 48.99 < latitude < 49.01

    expected = []
    for record in layout_records(layout):
        bearing_deg = (90.0 - record["yaw_deg"]) % 360.0
        expected.append(record | {"bearing_deg": bearing_deg})

    properties = [feature["properties"] for feature in document["features"]]
    assert properties == expected


@pytest.mark.long
def test_geojson_says_which_crs_is_unknown(layout):
    with refused_with(
        "crs: got 'no such system'; expected a coordinate reference system that"
        " pyproj knows"
    ):
        to_geojson(layout, "no such system")


def test_geojson_refuses_a_layout_outside_its_crs():
    unit = unit_at("far", [1.0e12, 0.0, 7.0])
    far = Layout(name="far", units=(unit,))
    told = (
        f"crs: got {CRS!r}; expected a coordinate reference system that contains the"
        " layout"
    )

    with refused_with(told):
        to_geojson(far, CRS)


@pytest.mark.parametrize("build", [load_carlancap_layout, None])
def test_carla_transforms_come_back_as_the_poses(layout, build):
    """CARLA is left-handed, and writes numbers as text."""
    if build:
        layout = build()
    records = json.loads(to_carla(layout))

    ids = [unit.id for unit in layout.units]

    assert [record["id"] for record in records] == ids

    for unit, record in zip(layout.units, records, strict=True):
        location = record["transform"]["location"]
        rotation = record["transform"]["rotation"]
        pose = from_carla_pose(
            position_m=[location["x"], location["y"], location["z"]],
            yaw_deg=rotation["yaw"],
            pitch_deg=rotation["pitch"],
        )

        np.testing.assert_array_equal(pose.position_m, unit.pose.position_m)
        assert pose.yaw_deg == pytest.approx(unit.pose.yaw_deg, abs=1e-12)
        assert pose.pitch_deg == unit.pose.pitch_deg
        assert rotation["roll"] == 0.0
        assert record["blueprint"] == "sensor.camera.rgb"
        assert record["attributes"] == {
            "image_size_x": "1920",
            "image_size_y": "1080",
            "fov": "110.0",
            "sensor_tick": "0.1",
        }


def test_a_lidar_is_exported_with_its_scan_pattern(layout):
    lidar = load_lidars()["carla-ncap-lidar"]
    unit = replace(layout.units[0], sensor=lidar, latency_s=0.1)
    mixed = Layout(name="mixed", units=(unit, layout.units[1]))
    first, second = json.loads(to_carla(mixed))

    assert first["blueprint"] == "sensor.lidar.ray_cast"
    assert second["blueprint"] == "sensor.camera.rgb"
    # CarlaNCAP, table of sensors: 72 x 30 deg, 52 lines, 10 Hz, 250 m, 90 k points/s.
    assert first["attributes"] == {
        "channels": "52",
        "range": "250.0",
        "points_per_second": "90000",
        "rotation_frequency": "10.0",
        "upper_fov": "15.0",
        "lower_fov": "-15.0",
        "horizontal_fov": "72.0",
        "sensor_tick": "0.1",
    }

    lines = to_csv(mixed).splitlines()
    first, second = csv.DictReader(lines)

    assert first["lidar"] == "carla-ncap-lidar"
    assert first["camera"] == ""
    assert first["latency_s"] == "0.1"
    assert second["lidar"] == ""
    assert second["camera"] == "carla-ncap-rgb"
    assert second["latency_s"] == ""


def test_carla_has_no_minus_zero(layout):
    """At the origin, the flipped axis would have one."""
    origin = Layout(name="origin", units=layout.units[2:])
    assert "-0.0" not in to_carla(origin)


def test_every_format_is_text_of_the_whole_layout(layout):
    scene = load_study_scene()

    for name in ("json", "csv", "geojson", "kml", "carla", "opencv", "ros", "cpm"):
        text = load_format(name).write(layout, scene)
        assert text.endswith("\n")
        for unit in layout.units:
            assert unit.id in text


def test_json_text_has_null_for_what_json_lacks():
    document = {
        "a": [np.inf, -np.inf, np.nan, 1.0],
        "b": {"c": np.float64("nan")},
        "d": np.int64(3),
        "e": (np.array([0.5, np.inf]), True, None, "Inf"),
    }
    text = to_json_text(document)

    assert json.loads(text) == {
        "a": [None, None, None, 1.0],
        "b": {"c": None},
        "d": 3,
        "e": [[0.5, None], True, None, "Inf"],
    }
