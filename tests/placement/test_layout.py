"""Layouts: read, written, and named where they are wrong; certificates' gaps."""

import copy
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused_with
from strategies import numbers, poses

from geometry.catalogue import load_cameras
from geometry.errors import InputError
from geometry.lidar import load_lidars
from geometry.sensors import CameraModel, with_fov
from placement.candidates import CandidatePose
from placement.layout import (
    RESERVED_IDS,
    RESULT_SCHEMAS,
    SCHEMA,
    Certificate,
    Layout,
    Stage,
    layout_from_records,
    layout_records,
    load_layout,
    relative_gap,
)

CAMERAS = ", ".join(sorted(load_cameras()))
LIDARS = ", ".join(sorted(load_lidars()))
GOOD = [
    {
        "id": "A",
        "site": "pole-1",
        "x_m": 1.0,
        "y_m": -2.0,
        "z_m": 7.5,
        "yaw_deg": 90.0,
        "pitch_deg": -25.0,
        "camera": "carla-ncap-rgb",
    },
    {
        "id": "B",
        "x_m": 5,
        "y_m": 6,
        "z_m": 7,
        "yaw_deg": 0,
        "pitch_deg": 0,
        "camera": "carla-ncap-rgb-90",
    },
]


def _changed(without=(), **changes):
    """Records whose second unit is changed, and lacks some fields."""
    records = copy.deepcopy(GOOD)
    records[1] |= changes
    for key in without:
        del records[1][key]

    return records


def _read(records):
    """The layout of records."""
    return layout_from_records("l", records, "f.json")


def _is_id(text):
    """May a text be the name of a unit?"""
    return text != "" and text not in RESERVED_IDS


@st.composite
def _layouts(draw):
    """Random layouts."""
    texts = st.text(max_size=8).filter(str.isprintable)
    ids = draw(st.lists(texts.filter(_is_id), min_size=1, max_size=5, unique=True))
    sensors = [*load_cameras().values(), *load_lidars().values()]
    return Layout(
        name=draw(texts),
        units=tuple(
            CandidatePose(
                id=unit_id,
                site_id=draw(st.sampled_from(["", "pole-1", "pole-2"])),
                pose=draw(poses()),
                sensor=draw(st.sampled_from(sensors)),
                latency_s=draw(st.none() | st.floats(0.0, 5.0)),
            )
            for unit_id in ids
        ),
    )


def _zoomed(sensor, share):
    """A camera with its lens set somewhere in its range."""
    if not isinstance(sensor, CameraModel) or sensor.fov_range_deg is None:
        return sensor
    low, high = sensor.fov_range_deg
    return with_fov(sensor, low + share * (high - low), "test")


@given(_layouts(), numbers(0.0, 1.0))
def test_a_lens_that_is_set_comes_back_from_its_records(layout, share):
    units = tuple(
        replace(unit, sensor=_zoomed(unit.sensor, share)) for unit in layout.units
    )
    layout = replace(layout, units=units)
    records = json.loads(json.dumps(layout_records(layout), allow_nan=False))

    back = layout_from_records(layout.name, records, "f.json")
    expected = [unit.sensor for unit in units]

    assert [unit.sensor for unit in back.units] == expected

    for record, unit in zip(records, units, strict=True):
        model = load_cameras().get(unit.sensor.name)
        is_set = (
            model is not None
            and model.horizontal_fov_deg != unit.sensor.horizontal_fov_deg
        )
        assert ("fov_deg" in record) == is_set


def test_a_lens_as_in_the_catalogue_may_be_told_or_not():
    zoom = load_cameras()["varifocal-1080p"]

    for more in ({}, {"fov_deg": None}, {"fov_deg": zoom.horizontal_fov_deg}):
        records = _changed(camera=zoom.name, **more)
        assert _read(records).units[1].sensor is zoom

    sensor = _read(_changed(camera=zoom.name, fov_deg=40)).units[1].sensor

    assert sensor.name == zoom.name
    assert sensor.horizontal_fov_deg == 40.0
    assert sensor.focal_length_px > zoom.focal_length_px


@given(_layouts())
def test_a_layout_comes_back_from_its_records_bit_by_bit(layout):
    text = json.dumps(layout_records(layout), allow_nan=False)

    back = layout_from_records(layout.name, json.loads(text), "f.json")

    assert back.name == layout.name

    for unit, other in zip(layout.units, back.units, strict=True):
        assert unit.id == other.id
        assert unit.site_id == other.site_id
        assert np.array_equal(unit.pose.position_m, other.pose.position_m)
        assert unit.pose.yaw_deg == other.pose.yaw_deg
        assert unit.pose.pitch_deg == other.pose.pitch_deg
        assert unit.sensor is other.sensor
        assert unit.latency_s == other.latency_s

    assert layout_records(back) == layout_records(layout)


def test_a_layout_is_read_from_a_file(tmp_path):
    path = tmp_path / "mine.json"
    path.write_text(json.dumps({"layout": GOOD}), encoding="utf-8")
    layout = load_layout(path)

    assert layout.name == "mine"
    assert [unit.id for unit in layout.units] == ["A", "B"]
    assert layout.units[0].pose.position_m.tolist() == [1.0, -2.0, 7.5]
    assert [unit.site_id for unit in layout.units] == ["pole-1", ""]

    path.write_text(
        json.dumps({"name": "ours", "layout": GOOD, "more": 1}), encoding="utf-8"
    )

    assert load_layout(path).name == "ours"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"without": ["id"]}, "id: got nothing; expected a value"),
        ({"without": ["camera"]}, "camera: got nothing; expected a value"),
        ({"x_m": math.nan}, "x_m: got nan; expected a finite number"),
        ({"yaw_deg": True}, "yaw_deg: got True; expected a finite number"),
        ({"x_m": 10**400}, f"x_m: got 1{199 * '0'}..; expected a finite number"),
        ({"pitch_deg": -90.5}, "pitch_deg: got -90.5; expected -90 .. 90 degrees"),
        ({"id": 3}, "id: got 3; expected text"),
        ({"site": 7}, "site: got 7; expected text"),
        ({"latency_s": -0.1}, "latency_s: got -0.1; expected seconds, at least 0"),
        (
            {"camera": "periscope"},
            f"camera: got 'periscope'; expected one of {CAMERAS}",
        ),
        (
            {"without": ["camera"], "lidar": "carla-ncap-rgb"},
            f"lidar: got 'carla-ncap-rgb'; expected one of {LIDARS}",
        ),
        (
            {
                "without": ["camera"],
                "lidar": "carla-ncap-lidar",
                "fov_deg": 40.0,
            },
            "fov_deg: got 40.0; expected nothing: only cameras have lenses",
        ),
        (
            {"fov_deg": 60.0},
            "fov_deg: got 60.0; expected 90 degrees: carla-ncap-rgb-90 has a fixed"
            " lens",
        ),
        (
            {"camera": "varifocal-1080p", "fov_deg": 120},
            "fov_deg: got 120.0; expected 26.2 .. 89.6 degrees, the lens of"
            " varifocal-1080p",
        ),
    ],
)
def test_a_field_of_the_wrong_kind_is_named(changes, message):
    with refused_with(f"f.json: layout[1].{message}"):
        _read(_changed(**changes))


@pytest.mark.parametrize(
    ("records", "message"),
    [
        ([], "layout l: got no unit; expected at least one unit"),
        (
            [5],
            "f.json: layout[0]: got 5; expected an object with the fields of a unit",
        ),
        (
            _changed(lidar="carla-ncap-lidar"),
            "f.json: layout[1]: got camera and lidar; expected one of them",
        ),
        (_changed(id="A"), "layout l: id: got 'A'; expected every id once"),
        *(
            (
                _changed(id=name),
                f"layout l: id: got '{name}'; expected another name: vut, rsu_all,"
                " vut_and_rsus, vam, all_sources mean other sensing parties",
            )
            for name in RESERVED_IDS
        ),
    ],
)
def test_units_that_cannot_be_are_named(records, message):
    with refused_with(message):
        _read(records)


def test_a_lidar_is_written_and_read_as_one_and_is_no_camera():
    records = _changed(["camera"], latency_s=0.125, lidar="carla-ncap-lidar")

    layout = _read(records)
    first, second = layout_records(layout)

    assert layout.units[1].sensor is load_lidars()["carla-ncap-lidar"]
    assert second["lidar"] == "carla-ncap-lidar"
    assert second["latency_s"] == 0.125
    assert "camera" not in second
    assert "latency_s" not in first


@pytest.mark.parametrize("text", ["a\nb", "\x1b[2K", "\ud800"])
def test_names_and_ids_can_be_printed(text):
    message = f"layout: name or id: got {text!r}; expected printable text"

    with refused_with(message):
        _read(_changed(id=text))

    with refused_with(message):
        layout_from_records(text, GOOD, "f.json")


NO_LIST = "got no list 'layout'; expected an object {\"layout\": [units]}"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            b"{",
            "got Expecting property name enclosed in double quotes: line 1 column 2"
            " (char 1); expected JSON in UTF-8",
        ),
        (
            b"not JSON",
            "got Expecting value: line 1 column 1 (char 0); expected JSON in UTF-8",
        ),
        (
            b"\xff",
            "got 'utf-8' codec can't decode byte 0xff in position 0: invalid start"
            " byte; expected JSON in UTF-8",
        ),
        (b"[" * 100_000, "got JSON nested too deep; expected a layout"),
        (b"[]", NO_LIST),
        (b"{}", NO_LIST),
        (b'{"layout": {}}', NO_LIST),
        (b"null", NO_LIST),
        (None, "got No such file or directory; expected a readable file"),
        (
            json.dumps({"layout": _changed(x_m=math.nan)}).encode(),
            "layout[1].x_m: got nan; expected a finite number",
        ),
    ],
)
def test_a_file_that_is_no_layout_is_named(tmp_path, content, message):
    path = tmp_path / "a.json"
    if content is not None:
        path.write_bytes(content)

    with refused_with(f"{path}: {message}"):
        load_layout(path)


@pytest.mark.parametrize(
    "schema", ["place-rsus/layout/2", "place-rsus/scene/1", 1, None]
)
def test_a_file_of_another_version_is_refused_and_not_guessed_at(tmp_path, schema):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"schema": schema, "layout": GOOD}))

    with pytest.raises(InputError) as caught:
        load_layout(path)

    message = str(caught.value)
    known = ", ".join([SCHEMA, *RESULT_SCHEMAS])

    assert message.startswith(f"{path}: schema: got ")
    assert message.endswith(f"expected {known}, or none of it")


@pytest.mark.parametrize("schema", [SCHEMA, *RESULT_SCHEMAS])
def test_layouts_are_read_from_layout_files_and_from_results(tmp_path, schema):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"schema": schema, "layout": GOOD}))

    assert [unit.id for unit in load_layout(path).units] == ["A", "B"]


# Certificates


@given(st.floats(0.01, 1.0), st.floats(0.0, 1.0))
def test_the_gap_is_the_distance_as_a_share_of_the_objective(objective, more):
    gap = relative_gap(objective, objective + more)
    assert gap >= 0.0
    assert gap == pytest.approx(more / objective, rel=1e-6, abs=2e-7)


def test_the_gap_is_zero_where_objective_and_bound_agree_and_infinite_above_nothing():
    assert relative_gap(0.3, 0.1 + 0.2) == 0.0
    assert relative_gap(0.0, 0.0) == 0.0
    assert relative_gap(0.0, 0.5) == math.inf
    assert relative_gap(-0.5, -0.4) == pytest.approx(0.2)


def test_a_certificate_is_proven_when_every_gap_is_closed():
    def stage(gap):
        return Stage(
            name="apr",
            objective=1.0,
            bound=1.0 + gap,
            gap=gap,
            seconds=0.1,
        )

    assert Certificate(stages=(stage(0.0), stage(0.0)), solver="HiGHS").is_proven
    assert not Certificate(stages=(stage(0.0), stage(1e-6)), solver="HiGHS").is_proven
