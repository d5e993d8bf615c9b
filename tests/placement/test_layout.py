"""Layouts: read, written, and named where they are wrong; certificates' gaps."""

import copy
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
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


def _message(function, *arguments):
    """Words in which something is refused."""
    with pytest.raises(InputError) as caught:
        function(*arguments)
    return str(caught.value)


def _changed(**changes):
    """Records whose second unit is changed."""
    records = copy.deepcopy(GOOD)
    for key, value in changes.items():
        records[1][key] = value
    return records


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

    assert [unit.sensor for unit in back.units] == [unit.sensor for unit in units]

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
        assert layout_from_records("l", records, "f.json").units[1].sensor is zoom

    records = _changed(camera=zoom.name, fov_deg=40)
    sensor = layout_from_records("l", records, "f.json").units[1].sensor

    assert sensor.name == zoom.name
    assert sensor.horizontal_fov_deg == 40.0
    assert sensor.focal_length_px > zoom.focal_length_px


def test_a_lidar_has_no_field_of_view_to_set():
    records = _changed(lidar="carla-ncap-lidar", fov_deg=40.0)
    del records[1]["camera"]

    assert (
        _message(layout_from_records, "l", records, "f.json")
        == "f.json: layout[1].fov_deg: got 40.0; expected nothing: only cameras have"
        " lenses"
    )


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


@pytest.mark.parametrize("key", ["id", "camera"])
def test_a_missing_field_is_named(key):
    records = _changed()
    del records[1][key]

    assert (
        _message(layout_from_records, "l", records, "f.json")
        == f"f.json: layout[1].{key}: got nothing; expected a value"
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"x_m": math.nan}, "layout[1].x_m: got nan; expected a finite number"),
        ({"yaw_deg": True}, "layout[1].yaw_deg: got True; expected a finite number"),
        (
            {"x_m": 10**400},
            f"layout[1].x_m: got 1{199 * '0'}..; expected a finite number",
        ),
        (
            {"pitch_deg": -90.5},
            "layout[1].pitch_deg: got -90.5; expected -90 .. 90 degrees",
        ),
        ({"id": 3}, "layout[1].id: got 3; expected text"),
        ({"site": 7}, "layout[1].site: got 7; expected text"),
        (
            {"lidar": "carla-ncap-lidar"},
            "layout[1]: got camera and lidar; expected one of them",
        ),
        (
            {"fov_deg": 60.0},
            (
                "layout[1].fov_deg: got 60.0; expected 90 degrees: carla-ncap-rgb-90"
                " has a fixed lens"
            ),
        ),
        (
            {"camera": "varifocal-1080p", "fov_deg": 120},
            (
                "layout[1].fov_deg: got 120.0; expected 26.2 .. 89.6 degrees, the lens"
                " of varifocal-1080p"
            ),
        ),
        (
            {"latency_s": -0.1},
            "layout[1].latency_s: got -0.1; expected seconds, at least 0",
        ),
    ],
)
def test_a_field_of_the_wrong_kind_is_named(changes, message):
    assert (
        _message(layout_from_records, "l", _changed(**changes), "f.json")
        == f"f.json: {message}"
    )


def test_a_unit_that_is_no_object_is_named():
    assert (
        _message(layout_from_records, "l", [5], "f.json")
        == "f.json: layout[0]: got 5; expected an object with the fields of a unit"
    )


def test_an_unknown_camera_lists_the_known_ones():
    known = ", ".join(sorted(load_cameras()))
    records = _changed(camera="periscope")

    assert (
        _message(layout_from_records, "l", records, "f.json")
        == f"f.json: layout[1].camera: got 'periscope'; expected one of {known}"
    )


def test_a_lidar_is_written_and_read_as_one_and_is_no_camera():
    records = _changed(latency_s=0.125)
    del records[1]["camera"]
    records[1]["lidar"] = "carla-ncap-lidar"

    layout = layout_from_records("l", records, "f.json")

    assert layout.units[1].sensor is load_lidars()["carla-ncap-lidar"]

    written = layout_records(layout)

    assert written[1]["lidar"] == "carla-ncap-lidar"
    assert written[1]["latency_s"] == 0.125
    assert "camera" not in written[1]
    assert "latency_s" not in written[0]

    records[1]["lidar"] = "carla-ncap-rgb"

    assert _message(layout_from_records, "l", records, "f.json") == (
        "f.json: layout[1].lidar: got 'carla-ncap-rgb'; expected one of "
        + ", ".join(sorted(load_lidars()))
    )


def test_a_repeated_id_is_named():
    assert (
        _message(layout_from_records, "l", _changed(id="A"), "f.json")
        == "layout l: id: got 'A'; expected every id once"
    )


@pytest.mark.parametrize("name", RESERVED_IDS)
def test_a_unit_is_not_called_like_another_sensing_party(name):
    assert (
        _message(layout_from_records, "l", _changed(id=name), "f.json")
        == f"layout l: id: got '{name}'; expected another name: vut, rsu_all,"
        " vut_and_rsus, vam, all_sources mean other sensing parties"
    )


@pytest.mark.parametrize("text", ["a\nb", "\x1b[2K", "\ud800"])
def test_names_and_ids_can_be_printed(text):
    expected = f"layout: name or id: got {text!r}; expected printable text"
    assert _message(layout_from_records, "l", _changed(id=text), "f.json") == expected
    assert _message(layout_from_records, text, GOOD, "f.json") == expected


def test_a_layout_without_units_is_refused():
    assert (
        _message(layout_from_records, "l", [], "f.json")
        == "layout l: got no unit; expected at least one unit"
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            b"{",
            (
                "got Expecting property name enclosed in double quotes: line 1 column 2"
                " (char 1); "
            ),
        ),
        (b"not JSON", "got Expecting value: line 1 column 1 (char 0); "),
        (
            b"\xff",
            (
                "got 'utf-8' codec can't decode byte 0xff in position 0: invalid start"
                " byte; "
            ),
        ),
    ],
)
def test_a_file_that_is_not_json_is_named(tmp_path, content, message):
    path = tmp_path / "a.json"
    path.write_bytes(content)

    assert _message(load_layout, path) == f"{path}: {message}expected JSON in UTF-8"


def test_a_file_nested_too_deep_is_named(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("[" * 100_000, encoding="utf-8")

    assert (
        _message(load_layout, path)
        == f"{path}: got JSON nested too deep; expected a layout"
    )


@pytest.mark.parametrize("content", ["[]", "{}", '{"layout": {}}', "null"])
def test_a_file_without_a_list_of_units_is_named(tmp_path, content):
    path = tmp_path / "a.json"
    path.write_text(content, encoding="utf-8")

    assert (
        _message(load_layout, path)
        == f"{path}: got no list 'layout'; expected an object {{\"layout\": [units]}}"
    )


@pytest.mark.parametrize(
    "schema", ["place-rsus/layout/2", "place-rsus/scene/1", 1, None]
)
def test_a_file_of_another_version_is_refused_and_not_guessed_at(tmp_path, schema):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"schema": schema, "layout": GOOD}))
    message = _message(load_layout, path)

    assert message.startswith(f"{path}: schema: got ")

    known = (SCHEMA, *RESULT_SCHEMAS)

    assert message.endswith(f"expected {', '.join(known)}, or none of it")


@pytest.mark.parametrize("schema", [SCHEMA, *RESULT_SCHEMAS])
def test_layouts_are_read_from_layout_files_and_from_results(tmp_path, schema):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"schema": schema, "layout": GOOD}))

    assert [unit.id for unit in load_layout(path).units] == ["A", "B"]


def test_a_missing_file_is_named(tmp_path):
    path = tmp_path / "gone.json"
    assert (
        _message(load_layout, path)
        == f"{path}: got No such file or directory; expected a readable file"
    )


def test_a_field_error_names_the_file(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"layout": _changed(x_m=math.nan)}), encoding="utf-8")

    assert (
        _message(load_layout, path)
        == f"{path}: layout[1].x_m: got nan; expected a finite number"
    )


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
