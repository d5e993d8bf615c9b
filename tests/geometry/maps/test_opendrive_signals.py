"""Signals: traffic lights, signs, paint, and their poles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from opendrive_text import cubic, document, read_text, road

from geometry.maps.opendrive.objects import merge_poles
from geometry.maps.source_map import POLE_KINDS, Pole


def signal(name="", *, s=50.0, t=-6.0, **more):
    """A signal 3 m above the road, 50 m along it and 6 m to its right."""
    known = {"dynamic": "no", "type": "-1", "zOffset": 3, "height": 1} | more
    attributes = " ".join(f'{key}="{value}"' for key, value in known.items())
    return f'<signal id="5" name="{name}" s="{s}" t="{t}" {attributes}/>'


@pytest.fixture
def read(tmp_path):
    """A function that reads a road with signals."""

    def build(signals, **more):
        return read_text(tmp_path, document(road(signals=signals, **more)))

    return build


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
def test_kinds_of_signals(read, name, more, kind):
    climb = cubic("elevation", 0.0, 7.0)
    (pole,) = read(signal(name, **more), elevation=climb).poles

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
def test_paint_is_no_pole(read, name, more):
    source = read(signal(name, **more))
    assert not source.poles
    assert [note.what for note in source.skipped] == ["road 1 signal 5"]


def test_a_painted_crosswalk_is_a_crosswalk(read):
    text = signal(
        type="1000003",
        t=0,
        zOffset=0,
        height=0.01,
        width=10,
    )
    source = read(text)

    (ends,) = source.crosswalks_m
    assert_allclose(
        sorted(ends.tolist()), np.array([[50.0, -5.0], [50.0, 5.0]]), atol=1e-9
    )
    assert not source.poles


def test_a_painted_crosswalk_without_width_spans_the_driving_lanes(read):
    painted = signal(type="1000003", t=0, zOffset=0, height=0)
    (ends,) = read(painted).crosswalks_m
    assert_allclose(
        sorted(ends.tolist()), np.array([[50.0, -3.5], [50.0, 3.5]]), atol=1e-9
    )


def test_the_height_of_a_head_near_the_ground_says_nothing_about_its_pole(read):
    text = signal(type="1000001", dynamic="yes", zOffset=-0.7, height=1.16)
    (pole,) = read(text).poles

    assert pole.kind == "traffic light"
    assert pole.height_m is None


def test_what_hangs_over_a_lane_has_no_pole_there(read):
    source = read(signal(type="1000001", dynamic="yes", t=-1, zOffset=5))
    assert not source.poles
    assert source.skipped[0].why == "it hangs over a lane: there is no pole below it"


def test_signals_beyond_their_road_are_noted(read):
    source = read(signal(s=150.0))
    assert not source.poles
    assert source.skipped[0].why == "beyond its road's end"


def test_several_signals_at_one_place_are_one_pole_as_high_as_the_highest(read):
    lamp = '<object id="7" type="pole" s="50.1" t="-6" height="6" radius="0.05"/>'
    signals = (
        signal(zOffset=2, height=0.8)
        + signal(
            type="1000001",
            dynamic="yes",
            s=50.4,
            zOffset=3.4,
            height=0.8,
        )
        + signal(s=51.0)
    )
    poles = read(signals, objects=lamp).poles

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
    poles = []
    for index, (x, y, kind) in enumerate(rows):
        place = [x, y, 0.0]
        height_m = index + 1.0
        pole = Pole(
            id=str(index),
            kind=kind,
            position_m=place,
            height_m=height_m,
        )
        poles.append(pole)

    group = list(range(len(poles)))
    for i, one in enumerate(poles):
        for j, other in enumerate(poles):
            distance_m = np.linalg.norm(
                (one.position_m - other.position_m)[:2], axis=-1
            )
            if abs(distance_m - 0.5) < 0.1:
                return  # places are told apart to a few centimetres
            if distance_m < 0.5:
                group = [group[i] if number == group[j] else number for number in group]

    members = {}
    for one, number in zip(poles, group, strict=True):
        members.setdefault(number, []).append(one)

    merged = merge_poles(poles)
    heights_m = [max(one.height_m for one in found) for found in members.values()]

    assert sorted(pole.height_m for pole in merged) == sorted(heights_m)
    for pole in merged:
        kinds = {one.kind for one in members[group[int(pole.id)]]}
        assert ("traffic light" in kinds) == (pole.kind == "traffic light")


@pytest.mark.long
def test_thousands_of_poles_at_one_place_are_one():
    poles = [
        Pole(id=str(index), kind="sign", position_m=[0.0, 0.0, 0.0])
        for index in range(20_000)
    ]
    assert len(merge_poles(poles)) == 1
