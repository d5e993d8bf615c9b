"""The motion that a recording tells: angle, closing speed, last moment."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from placement.recordings.evaluate import is_same_direction, last_brake_time_s
from placement.recordings.files import load_format
from placement.recordings.read import closing_speed_mps
from scenarios.aeb import load_aeb_rule

speeds_mps = st.floats(5.0, 20.0)
FORM = load_format()


def _relative_speed(v, u, angle_deg):
    """Length of the difference of two velocities at an angle."""
    angle = math.radians(angle_deg)
    return math.hypot(v - u * math.cos(angle), u * math.sin(angle))


@given(speeds_mps, st.floats(0.05, 0.9), st.floats(-180.0, 180.0))
def test_the_angle_between_the_paths_is_told_from_the_speeds(v, share, angle_deg):
    u = share * v
    told = is_same_direction(
        vut_speed_mps=v,
        vru_speed_mps=u,
        closing_speed_mps=_relative_speed(v, u, angle_deg),
        form=FORM,
    )
    if abs(abs(angle_deg) - 20.0) > 1.0e-6:
        assert told == (abs(angle_deg) < 20.0)


@pytest.mark.parametrize(
    ("v", "u"),
    [
        (10.0, 0.0),
        (4.0, 4.0),
        (4.0, 6.0),
    ],
)
def test_a_vru_that_stands_or_is_no_slower_than_the_vut_is_taken_as_crossing(v, u):
    assert not is_same_direction(
        vut_speed_mps=v,
        vru_speed_mps=u,
        closing_speed_mps=abs(v - u),
        form=FORM,
    )


def test_braking_sheds_the_closing_speed_behind_a_cyclist_else_all_speed():
    # a = 7.72: 10 / 15.44 = 0.647668.. and (10 - 4) / 15.44 = 0.388601..
    rule = load_aeb_rule()
    times = [
        last_brake_time_s(
            vut_speed_mps=10.0,
            vru_speed_mps=4.0,
            is_same_direction=same,
            rule=rule,
        )
        for same in (False, True)
    ]

    assert times == pytest.approx([-10.0 / 15.44, -6.0 / 15.44], abs=1e-12)


@given(speeds_mps, st.floats(0.0, 1.0))
def test_build_up_brings_the_last_moment_forward_by_half_of_it(v, build_up_s):
    # Standing needs v^2 / (2 a) + v b / 2 - a b^2 / 24 metres, at v metres a second.
    rule = load_aeb_rule()
    a = rule.deceleration_mps2
    slow = last_brake_time_s(
        vut_speed_mps=v,
        vru_speed_mps=0.0,
        is_same_direction=False,
        rule=replace(rule, build_up_s=build_up_s),
    )
    if 0.5 * build_up_s <= v / a:
        distance = v**2 / (2.0 * a) + v * build_up_s / 2.0 - a * build_up_s**2 / 24.0
        assert slow == pytest.approx(-distance / v, rel=1e-9)


@given(st.floats(-20.0, 20.0), st.floats(0.0, 100.0), st.integers(2, 30))
def test_the_closing_speed_of_a_straight_line_is_its_slope(slope, start, n_frames):
    time_s = np.arange(n_frames) / 10.0 + 3.0
    assert closing_speed_mps(time_s, start - slope * time_s) == pytest.approx(
        slope, abs=1e-9
    )
