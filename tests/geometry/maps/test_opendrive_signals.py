"""Signals: traffic lights, signs, paint, and their poles."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from opendrive_text import cubic, document, read_text, road
from plane_vectors import lengths

from geometry.maps.opendrive.objects import merge_poles
from geometry.maps.source_map import POLE_KINDS, Pole


def _signal(name="", *, s=50.0, t=-6.0, inside="", **more):
    given_attributes = {"dynamic": "no", "type": "-1", "zOffset": 3, "height": 1} | more
    attributes = " ".join(f'{key}="{value}"' for key, value in given_attributes.items())
    return (
        f'<signal id="5" name="{name}" s="{s}" t="{t}" {attributes}>{inside}</signal>'
    )


def _read(tmp_path, signals, header="", **more):
    return read_text(tmp_path, document(road(signals=signals, **more), header=header))


@pytest.mark.parametrize(
    ("name", "more", "kind"),
    [
        ("", {"type": "1000001", "dynamic": "yes"}, "traffic light"),
        ("Signal_3Light_Post01", {"dynamic": "yes"}, "traffic light"),
        ("TrafficLightAhead", {"dynamic": "no"}, "sign"),
        ("", {"type": "trafficLight", "dynamic": "yes"}, "traffic light"),
        ("Ampel 3", {"country": "DE", "dynamic": "yes"}, "traffic light"),
        ("", {"type": "206", "country": "DE"}, "sign"),
        ("Sg306Vorfahrtstrasse02.flt", {"type": "306"}, "sign"),
    ],
)
def test_kinds_of_signals(tmp_path, name, more, kind):
    source = _read(
        tmp_path, _signal(name, **more), elevation=cubic("elevation", 0.0, 7.0)
    )
    (pole,) = source.poles

    assert pole.kind == kind
    assert pole.id == "road 1 signal 5"
    assert_allclose(pole.position_m, [50, -6, 7])
    assert pole.height_m == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("SgRMArrowLeft.flt", {}),
        ("Stencil_STOP", {}),
        ("", {"type": "294", "zOffset": 0, "height": 0.03}),
    ],
)
def test_paint_is_no_pole(tmp_path, name, more):
    source = _read(tmp_path, _signal(name, **more))
    assert not source.poles
    assert [note.what for note in source.skipped] == ["road 1 signal 5"]


def test_a_painted_crosswalk_is_a_crosswalk(tmp_path):
    text = _signal(type="1000003", t=0, zOffset=0, height=0.01, width=10)
    source = _read(tmp_path, text)

    assert_allclose(
        sorted(source.crosswalks_m[0].tolist()), [[50, -5], [50, 5]], atol=1e-9
    )
    assert not source.poles


def test_a_painted_crosswalk_without_width_spans_the_driving_lanes(tmp_path):
    (ends,) = _read(
        tmp_path, _signal(type="1000003", t=0, zOffset=0, height=0)
    ).crosswalks_m
    assert_allclose(sorted(ends.tolist()), [[50, -3.5], [50, 3.5]], atol=1e-9)


def test_the_height_of_a_head_near_the_ground_says_nothing_about_its_pole(tmp_path):
    text = _signal(type="1000001", dynamic="yes", zOffset=-0.7, height=1.16)
    (pole,) = _read(tmp_path, text).poles

    assert pole.kind == "traffic light"
    assert pole.height_m is None


def test_what_hangs_over_a_lane_has_no_pole_there(tmp_path):
    source = _read(tmp_path, _signal(type="1000001", dynamic="yes", t=-1, zOffset=5))
    assert not source.poles
    assert source.skipped[0].why == "it hangs over a lane: there is no pole below it"


def test_signals_beyond_their_road_are_noted(tmp_path):
    source = _read(tmp_path, _signal(s=150.0))
    assert not source.poles
    assert source.skipped[0].why == "beyond its road's end"


def test_several_signals_at_one_place_are_one_pole_as_high_as_the_highest(tmp_path):
    lamp = '<object id="7" type="pole" s="50.1" t="-6" height="6" radius="0.05"/>'
    signals = (
        _signal(zOffset=2, height=0.8)
        + _signal(type="1000001", dynamic="yes", s=50.4, zOffset=3.4, height=0.8)
        + _signal(s=51.0)
    )
    poles = _read(tmp_path, signals, objects=lamp).poles

    assert [pole.kind for pole in poles] == ["traffic light", "sign"]
    assert poles[0].id == "road 1 object 7"
    assert poles[0].height_m == pytest.approx(6.0)
    assert_allclose(poles[0].position_m, [50.1, -6, 0])


_POLES = st.lists(
    st.tuples(st.floats(0.0, 3.0), st.floats(0.0, 3.0), st.sampled_from(POLE_KINDS)),
    max_size=12,
)


@given(_POLES)
def test_merged_poles_are_the_groups_of_those_close_to_one_another(rows):
    poles = [
        Pole(
            id=str(index), kind=kind, position_m=[x, y, 0.0], height_m=float(index + 1)
        )
        for index, (x, y, kind) in enumerate(rows)
    ]
    group = list(range(len(poles)))
    for i, one in enumerate(poles):
        for j, other in enumerate(poles):
            distance_m = lengths((one.position_m - other.position_m)[:2])
            if abs(distance_m - 0.5) < 0.1:
                return  # places are told apart to a few centimetres
            if distance_m < 0.5 and group[i] != group[j]:
                group = [group[i] if number == group[j] else number for number in group]
    merged = merge_poles(poles)

    assert len(merged) == len(set(group))
    assert sorted(pole.height_m for pole in merged) == sorted(
        max(i + 1.0 for i, number in enumerate(group) if number == wanted)
        for wanted in set(group)
    )
    for pole in merged:
        members = [
            one
            for one, number in zip(poles, group, strict=True)
            if number == group[int(pole.id)]
        ]
        assert ("traffic light" in {one.kind for one in members}) == (
            pole.kind == "traffic light"
        )


@pytest.mark.long
def test_thousands_of_poles_at_one_place_are_one():
    poles = [
        Pole(id=str(index), kind="sign", position_m=[0.0, 0.0, 0.0])
        for index in range(20_000)
    ]
    assert len(merge_poles(poles)) == 1
