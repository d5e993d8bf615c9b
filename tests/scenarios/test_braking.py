"""How fast and how far the VUT is when it brakes."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused_with
from strategies import KMH, numbers

from scenarios.aeb import (
    braking_distance_m,
    braking_speed_mps,
    load_aeb_rule,
    standstill_time_s,
)

RULE = load_aeb_rule()
vut_speeds = numbers(10.0, 80.0).map(lambda kmh: kmh * KMH)
decelerations_mps2 = numbers(1.0, 12.0)
# The VUT may stand within them.
build_ups_s = st.one_of(st.just(0.0), numbers(0.01, 2.0))


def rule_with(deceleration_mps2, build_up_s):
    """The rule with another deceleration."""
    return dataclasses.replace(
        RULE,
        deceleration_mps2=deceleration_mps2,
        build_up_s=build_up_s,
    )


# Motion


@given(vut_speeds, decelerations_mps2, build_ups_s, numbers(0.001, 12.0))
def test_speed_and_distance_are_the_areas_under_deceleration_and_speed(
    speed_mps, deceleration_mps2, build_up_s, until_s
):
    rule = rule_with(deceleration_mps2, build_up_s)
    step_s = until_s / 4000
    middles = step_s * (np.arange(4000) + 0.5)
    if build_up_s > 0.0:
        share = np.minimum(1.0, middles / build_up_s)
    else:
        share = np.ones(4000)
    speed = np.maximum(0.0, speed_mps - np.cumsum(deceleration_mps2 * share) * step_s)
    # Exact but for the two steps with a kink.
    left_mps = braking_speed_mps(until_s, speed_mps=speed_mps, rule=rule)

    assert left_mps == pytest.approx(speed[-1], abs=2.0 * deceleration_mps2 * step_s)

    area_m = np.trapezoid(np.append(speed_mps, speed), dx=step_s)
    driven_m = braking_distance_m(until_s, speed_mps=speed_mps, rule=rule)
    slack_m = deceleration_mps2 * step_s * until_s

    assert driven_m == pytest.approx(area_m, abs=slack_m)


@given(vut_speeds, decelerations_mps2, build_ups_s, numbers(0.0, 1.0))
def test_speed_is_the_slope_of_the_distance(
    speed_mps, deceleration_mps2, build_up_s, share
):
    rule = rule_with(deceleration_mps2, build_up_s)
    time_s = 1e-3 + share * float(standstill_time_s(speed_mps, rule=rule))
    around_s = [time_s - 1e-4, time_s + 1e-4]
    before_m, after_m = braking_distance_m(around_s, speed_mps=speed_mps, rule=rule)
    slope_mps = (after_m - before_m) / 2e-4
    left_mps = braking_speed_mps(time_s, speed_mps=speed_mps, rule=rule)

    assert left_mps == pytest.approx(slope_mps, abs=deceleration_mps2 * 1e-4)


@given(vut_speeds, decelerations_mps2, build_ups_s, numbers(0.0, 100.0))
def test_braking_ends_at_standstill(speed_mps, deceleration_mps2, build_up_s, later_s):
    rule = rule_with(deceleration_mps2, build_up_s)
    standstill_s = float(standstill_time_s(speed_mps, rule=rule))
    around_s = [standstill_s - 1e-3, standstill_s + later_s]
    before_mps, after_mps = braking_speed_mps(around_s, speed_mps=speed_mps, rule=rule)

    assert after_mps < 1e-9
    if standstill_s > 1e-3:
        assert before_mps > 0.0

    stopped_m = braking_distance_m(around_s[1], speed_mps=speed_mps, rule=rule)
    a = deceleration_mps2
    b = build_up_s

    if speed_mps >= 0.5 * a * b:
        assert standstill_s >= b - 1e-9
        expected = speed_mps**2 / (2.0 * a) + 0.5 * speed_mps * b - a * b**2 / 24.0
    else:
        assert standstill_s <= b
        expected = 2.0 / 3.0 * speed_mps * math.sqrt(2.0 * speed_mps * b / a)
    assert stopped_m == pytest.approx(expected, rel=1e-9)


def test_without_build_up_braking_is_that_of_constant_deceleration():
    rule = rule_with(8.0, 0.0)
    assert standstill_time_s(20.0, rule=rule) == 2.5

    times_s = [0.0, 1.0, 2.5, 9.0]
    distances_m = braking_distance_m(times_s, speed_mps=20.0, rule=rule)
    speeds_mps = braking_speed_mps(times_s, speed_mps=20.0, rule=rule)

    assert distances_m.tolist() == [0.0, 16.0, 25.0, 25.0]
    assert speeds_mps.tolist() == [20.0, 12.0, 0.0, 0.0]


def test_one_who_stands_already_stays():
    for build_up_s in (0.0, 0.5):
        rule = rule_with(8.0, build_up_s)
        assert standstill_time_s(0.0, rule=rule) == 0.0
        assert braking_distance_m(3.0, speed_mps=0.0, rule=rule) == 0.0


# The rule


def test_rule_is_that_of_the_study():
    # CarlaNCAP: 7.72 m/s^2 without build-up, 25 ms, three consecutive frames at 10 Hz.
    assert RULE.deceleration_mps2 == 7.72
    assert RULE.build_up_s == 0.0
    assert RULE.latency_s == 0.025
    assert RULE.n_confirmations == 3
    assert RULE.frame_rate_hz == 10.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"deceleration_mps2": 0.0},
            "aeb.deceleration_mps2: got 0.0; expected a number, 1 to 15",
        ),
        (
            {"deceleration_mps2": math.nan},
            "aeb.deceleration_mps2: got nan; expected a number, 1 to 15",
        ),
        (
            {"frame_rate_hz": math.inf},
            "aeb.frame_rate_hz: got inf; expected a positive number",
        ),
        (
            {"deceleration_mps2": 1e-300},
            "aeb.deceleration_mps2: got 1e-300; expected a number, 1 to 15",
        ),
        (
            {"build_up_s": 1000.0},
            "aeb.build_up_s: got 1000.0; expected a number, 0 to 2",
        ),
        ({"build_up_s": -0.1}, "aeb.build_up_s: got -0.1; expected a number, 0 to 2"),
        (
            {"build_up_s": math.inf},
            "aeb.build_up_s: got inf; expected a number, 0 to 2",
        ),
        ({"latency_s": -0.1}, "aeb.latency_s: got -0.1; expected a number, 0 to 60"),
        (
            {"n_confirmations": 0},
            "aeb.n_confirmations: got 0; expected a number, 1 to 1000",
        ),
        (
            {"n_confirmations": True},
            "aeb.n_confirmations: got True; expected a whole number",
        ),
        (
            {"n_confirmations": 2.5},
            "aeb.n_confirmations: got 2.5; expected a whole number",
        ),
    ],
)
def test_rule_says_what_is_wrong(change, message):
    with refused_with(message):
        dataclasses.replace(RULE, **change)
