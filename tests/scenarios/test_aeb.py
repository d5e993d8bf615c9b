import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import (
    crossing_tau_s,
    naive_confirmed,
    simulated_contact,
    stop_tau_s,
)
from strategies import KMH, angles_deg, build_encounter, coordinates_m, encounters, numbers

from geometry.actors import load_actors
from geometry.errors import InputError
from scenarios.aeb import (
    braking_distance_m,
    confirmation_mask,
    confirmation_time_s,
    has_contact,
    is_in_time,
    last_brake_time_s,
    load_aeb_rule,
    smallest_separation_m,
)

A_MPS2 = 7.72
vut_speeds = numbers(20.0, 60.0).map(lambda kmh: kmh * KMH)
vru_speeds = numbers(3.0, 15.0).map(lambda kmh: kmh * KMH)
bodies = st.sampled_from(["adult", "cyclist"])
detections = st.lists(st.booleans(), min_size=1, max_size=15)


def _tau_s(encounter) -> float:
    return -last_brake_time_s(encounter, deceleration_mps2=A_MPS2)


# Braking


@given(vut_speeds, numbers(1.0, 12.0), numbers(0.0, 10.0))
def test_braking_distance_is_the_area_under_the_speed_curve(speed_mps, deceleration_mps2, until_s):
    time_s = np.linspace(0.0, until_s, 20_001)
    speed = np.maximum(0.0, speed_mps - deceleration_mps2 * time_s)
    area = np.trapezoid(speed, time_s)
    distance = braking_distance_m(until_s, speed_mps=speed_mps, deceleration_mps2=deceleration_mps2)
    # Exact but for the one interval with the kink, at most a dt^2 / 2.
    assert distance == pytest.approx(area, abs=deceleration_mps2 * (until_s / 20_000) ** 2 + 1e-9)


@given(vut_speeds, numbers(1.0, 12.0), numbers(0.0, 100.0))
def test_braking_ends_at_standstill(speed_mps, deceleration_mps2, later_s):
    standstill_s = speed_mps / deceleration_mps2
    distance = braking_distance_m(
        standstill_s + later_s, speed_mps=speed_mps, deceleration_mps2=deceleration_mps2
    )
    assert distance == pytest.approx(speed_mps**2 / (2.0 * deceleration_mps2), rel=1e-12)


# Last brake time: closed forms


def _slack_s(v: float, clear_s: float) -> float:
    """What looking every 1 ms may cost: contact that ends before the next look is missed.

    As the VRU leaves, the front gains v - a t metres per second; a second of onset is worth a t
    metres. Standing is looked at exactly.
    """
    lost_mps = A_MPS2 * math.sqrt(2.0 * v * clear_s / A_MPS2)
    return 1e-4 + 1e-3 * max(0.0, (v - lost_mps) / lost_mps)


@settings(deadline=None, max_examples=60)
@given(vut_speeds, vru_speeds, bodies, angles_deg, coordinates_m, coordinates_m)
def test_last_brake_time_behind_one_who_goes_ahead_is_half_the_closing_speed_over_a(
    v, u, body, turn_deg, east_m, north_m
):
    encounter = build_encounter(
        vru=load_actors()[body],
        vut_speed_mps=v,
        vru_speed_mps=u,
        angle_deg=0.0,
        touch=0.0,
        turn_deg=turn_deg,
        origin_m=(east_m, north_m),
    )
    assert _tau_s(encounter) == pytest.approx((v - u) / (2.0 * A_MPS2), abs=1e-4)


@settings(deadline=None, max_examples=60)
@given(
    vut_speeds,
    vru_speeds,
    bodies,
    st.sampled_from([90.0, -90.0]),
    numbers(-0.6, 0.6),
    angles_deg,
    coordinates_m,
)
def test_last_brake_time_before_one_who_crosses_is_to_stop_or_to_pass_behind(
    v, u, body, angle_deg, side, turn_deg, east_m
):
    vru = load_actors()[body]
    encounter = build_encounter(
        vru=vru,
        vut_speed_mps=v,
        vru_speed_mps=u,
        angle_deg=angle_deg,
        touch=side,
        turn_deg=turn_deg,
        origin_m=(east_m, 0.0),
    )
    # From its middle at side x half width, until its rear has passed the far edge.
    walked = side * math.copysign(1.0, angle_deg)
    clear_s = 0.5 * (encounter.vut.width_m * (1.0 - walked) + vru.length_m) / u
    expected = crossing_tau_s(v, A_MPS2, clear_s)
    assert _tau_s(encounter) == pytest.approx(expected, abs=_slack_s(v, clear_s))


@settings(deadline=None, max_examples=40)
@given(vut_speeds, vru_speeds, angles_deg)
def test_last_brake_time_towards_one_who_comes_closer_lets_the_vut_stand_first(v, u, turn_deg):
    encounter = build_encounter(
        vru=load_actors()["cyclist"],
        vut_speed_mps=v,
        vru_speed_mps=u,
        angle_deg=180.0,
        touch=0.0,
        turn_deg=turn_deg,
    )
    standstill_s = v / A_MPS2
    gap_m = 0.5 * v * standstill_s + u * standstill_s
    assert _tau_s(encounter) == pytest.approx(gap_m / (v + u), abs=1e-4)


def test_last_brake_time_of_cpnc_50_at_60_kmh_is_that_of_passing_behind(runs):
    # The adult has left the path 0.88 s after the impact: 10 ms later than stopping would allow.
    (run,) = (run for run in runs if run.id == "CPNC-50/east/60")
    v, u = 60.0 * KMH, 5.0 * KMH
    clear_s = (0.5 * 1.836 + 0.5 * 0.6) / u
    expected = -crossing_tau_s(v, A_MPS2, clear_s)
    assert expected == pytest.approx(-1.069, abs=1e-3)
    assert run.last_brake_time_s == pytest.approx(expected, abs=1e-3)
    assert -stop_tau_s(v, A_MPS2) == pytest.approx(-1.0795, abs=1e-3)


@pytest.mark.parametrize(
    ("vut_speed_kmh", "onset_s"),
    [
        # The first pass (a look every 10 ms) sees contact at this onset, the second (1 ms) does
        # not. It once took the whole bracket for free and was 0.1 s too early.
        (51.3845, -0.7471333671285152),
        (58.2852, -0.8125),  # the other way round
    ],
)
def test_last_brake_time_does_not_fall_between_two_time_steps(vut_speed_kmh, onset_s):
    v, u = vut_speed_kmh * KMH, 15.0 * KMH
    encounter = build_encounter(
        vru=load_actors()["adult"],
        vut_speed_mps=v,
        vru_speed_mps=u,
        angle_deg=90.0,
        touch=0.0,
        vut_drive_s=5.0 - onset_s,  # a multiple of the first pass's step before it
    )
    touches = [
        smallest_separation_m(
            encounter, onset_s, deceleration_mps2=A_MPS2, time_step_s=time_step_s
        ).item()
        <= 0.0
        for time_step_s in (0.01, 0.001)
    ]
    assert touches[0] != touches[1]
    clear_s = 0.5 * (1.836 + 0.6) / u
    assert _tau_s(encounter) == pytest.approx(
        crossing_tau_s(v, A_MPS2, clear_s), abs=_slack_s(v, clear_s)
    )


# Last brake time: properties and the fine-step simulation


@settings(deadline=None, max_examples=60)
@given(encounters(), numbers(0.0, 1.0))
def test_braking_avoids_up_to_the_last_brake_time_and_not_after(encounter, share):
    last_s = last_brake_time_s(encounter, deceleration_mps2=A_MPS2)
    start_s = encounter.vut_motion.start_time_s
    assert start_s < last_s <= 0.0
    earlier_s = start_s + share * (last_s - start_s)
    assert not has_contact(encounter, earlier_s, deceleration_mps2=A_MPS2)
    assert not has_contact(encounter, last_s, deceleration_mps2=A_MPS2)
    assert has_contact(encounter, last_s + 1e-4, deceleration_mps2=A_MPS2)


@settings(deadline=None, max_examples=40)
@given(encounters(), numbers(0.0, 1.0))
def test_last_brake_time_matches_a_simulation_in_small_steps(encounter, share):
    last_s = last_brake_time_s(encounter, deceleration_mps2=A_MPS2)
    before_s = last_s - 0.003 - 0.5 * share
    assert not simulated_contact(encounter, before_s, deceleration_mps2=A_MPS2)
    if last_s < -0.004:
        assert simulated_contact(encounter, last_s + 0.003, deceleration_mps2=A_MPS2)


@settings(deadline=None, max_examples=40)
@given(encounters(), numbers(1.0, 6.0), numbers(0.1, 5.0))
def test_harder_braking_may_begin_later(encounter, weak_mps2, more_mps2):
    weak = last_brake_time_s(encounter, deceleration_mps2=weak_mps2)
    hard = last_brake_time_s(encounter, deceleration_mps2=weak_mps2 + more_mps2)
    assert hard >= weak - 1e-3


@settings(deadline=None, max_examples=40)
@given(encounters(), angles_deg)
def test_last_brake_time_does_not_depend_on_where_north_is(encounter, turn_deg):
    turn = np.radians(turn_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def turned(motion):
        path = dataclasses.replace(
            motion.path,
            start_m=rotation @ motion.path.start_m,
            yaw_deg=motion.path.yaw_deg + turn_deg,
        )
        return dataclasses.replace(motion, path=path)

    other = dataclasses.replace(
        encounter,
        vut_motion=turned(encounter.vut_motion),
        vru_motion=turned(encounter.vru_motion),
    )
    assert _tau_s(other) == pytest.approx(_tau_s(encounter), abs=1e-4)


def test_a_start_too_close_to_avoid_anything_is_minus_infinity():
    encounter = build_encounter(
        vru=load_actors()["adult"],
        vut_speed_mps=60.0 * KMH,
        vru_speed_mps=5.0 * KMH,
        angle_deg=90.0,
        touch=0.0,
        vut_drive_s=0.5,
    )
    assert last_brake_time_s(encounter, deceleration_mps2=A_MPS2) == -np.inf


def test_braking_at_or_after_the_impact_or_never_is_too_late(runs):
    for onset_s in (0.0, 0.5, math.inf):
        assert has_contact(runs[0].encounter, onset_s, deceleration_mps2=A_MPS2)


def test_a_vut_that_brakes_before_it_sets_off_stays_where_it_is():
    encounter = build_encounter(
        vru=load_actors()["adult"],
        vut_speed_mps=60.0 * KMH,
        vru_speed_mps=5.0 * KMH,
        angle_deg=90.0,
        touch=0.0,
        vut_drive_s=0.5,  # 8 m: too near to stop from full speed
    )
    assert has_contact(encounter, -0.5, deceleration_mps2=A_MPS2)
    assert not has_contact(encounter, -0.6, deceleration_mps2=A_MPS2)


# Confirmation


@given(detections, st.integers(1, 6))
def test_confirmation_is_what_a_counter_of_consecutive_frames_says(detected, n):
    assert confirmation_mask(detected, n_confirmations=n).tolist() == naive_confirmed(detected, n)


@given(st.lists(detections, min_size=2, max_size=4), st.integers(1, 4))
def test_confirmation_of_many_records_is_that_of_each(records, n):
    n_frames = min(len(record) for record in records)
    table = np.array([record[:n_frames] for record in records])
    time_s = np.arange(1 - n_frames, 1) / 10.0
    together = confirmation_mask(table, n_confirmations=n)
    times = confirmation_time_s(table, time_s, n_confirmations=n)
    for row, record in enumerate(table):
        assert np.array_equal(together[row], confirmation_mask(record, n_confirmations=n))
        assert times[row] == confirmation_time_s(record, time_s, n_confirmations=n)


@given(detections, st.integers(1, 6))
def test_confirmation_time_is_that_of_the_first_confirmed_frame(detected, n):
    time_s = np.arange(1 - len(detected), 1) / 10.0
    naive = [t for t, seen in zip(time_s, naive_confirmed(detected, n), strict=True) if seen]
    assert confirmation_time_s(detected, time_s, n_confirmations=n) == (
        naive[0] if naive else math.inf
    )


@given(detections, st.integers(1, 6), st.data())
def test_one_more_detected_frame_never_delays_the_confirmation(detected, n, data):
    time_s = np.arange(1 - len(detected), 1) / 10.0
    more = list(detected)
    more[data.draw(st.integers(0, len(more) - 1))] = True
    assert confirmation_time_s(more, time_s, n_confirmations=n) <= confirmation_time_s(
        detected, time_s, n_confirmations=n
    )


@given(st.integers(-200, 0), st.integers(0, 50))
def test_a_confirmation_exactly_at_the_deadline_is_in_time(frame, latency_ms):
    latency_s = latency_ms / 1000.0
    on_grid_s = frame / 10.0
    accumulated_s = sum([0.1] * -frame) * -1.0  # the same instant with another rounding
    deadline_s = (100 * frame + latency_ms) / 1000.0
    for confirmation_s in (on_grid_s, accumulated_s):
        assert is_in_time(confirmation_s, deadline_s, latency_s=latency_s)
        assert not is_in_time(confirmation_s, deadline_s - 1e-6, latency_s=latency_s)


def test_no_confirmation_is_never_in_time_and_nothing_is_before_minus_infinity():
    assert is_in_time([math.inf, -3.0], [0.0, -math.inf], latency_s=0.025).tolist() == [
        False,
        False,
    ]


# The rule


def test_rule_is_that_of_the_study():
    # CarlaNCAP: 7.72 m/s^2 without build-up, 25 ms, three consecutive frames at 10 Hz.
    rule = load_aeb_rule()
    assert (rule.deceleration_mps2, rule.latency_s) == (7.72, 0.025)
    assert (rule.n_confirmations, rule.frame_rate_hz) == (3, 10.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"deceleration_mps2": 0.0}, "aeb.deceleration_mps2: got 0.0; expected a positive number"),
        (
            {"deceleration_mps2": math.nan},
            "aeb.deceleration_mps2: got nan; expected a positive number",
        ),
        ({"frame_rate_hz": math.inf}, "aeb.frame_rate_hz: got inf; expected a positive number"),
        ({"latency_s": -0.1}, "aeb.latency_s: got -0.1; expected seconds, at least 0"),
        ({"n_confirmations": 0}, "aeb.n_confirmations: got 0; expected a whole number, >= 1"),
        ({"n_confirmations": True}, "aeb.n_confirmations: got True; expected a whole number, >= 1"),
        ({"n_confirmations": 2.5}, "aeb.n_confirmations: got 2.5; expected a whole number, >= 1"),
    ],
)
def test_rule_says_what_is_wrong(rule, change, message):
    with pytest.raises(InputError) as caught:
        dataclasses.replace(rule, **change)
    assert str(caught.value) == message
