"""Paths of bodies, and motions along them."""

import dataclasses

import numpy as np
import pytest
from dragged import front_axle_at
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from refusals import refused_with
from scipy.interpolate import CubicHermiteSpline
from strategies import angles_deg, coordinates_m, numbers

from scenarios.courses import pick_turn
from scenarios.paths import Motion, StraightPath, TurnPath, _hermite, travel_time_s

TABLE_M = 1e-6  # what the table of a turn may be off
speeds = numbers(0.5, 30.0)
accelerations_m = st.one_of(st.just(0.0), numbers(0.1, 10.0))


TURN_PATH = TurnPath(
    start_m=[0.0, 0.0],
    yaw_deg=0.0,
    straight_m=5.0,
    turn=pick_turn("far", 10.0),
    wheelbase_m=2.85,
    front_axle_ahead_m=1.45,
)


TURNS = (
    ("far", 10),
    ("far", 15),
    ("far", 20),
    ("near", 10),
)


@st.composite
def turn_paths(draw):
    """Turns of the protocol by several angles, anywhere, of cars of several sizes."""
    turn = pick_turn(*draw(st.sampled_from(TURNS)))
    wheelbase_m = draw(st.sampled_from([2.0, 2.85, 4.0]))
    return TurnPath(
        turn=turn.turned_by(draw(st.sampled_from([60.0, 90.0, 120.0]))),
        start_m=[draw(coordinates_m), draw(coordinates_m)],
        yaw_deg=draw(angles_deg),
        straight_m=draw(numbers(0.0, 40.0)),
        wheelbase_m=wheelbase_m,
        front_axle_ahead_m=draw(numbers(0.0, 1.0)) * wheelbase_m,
    )


def unit(yaw_deg):
    """Unit vectors in directions."""
    yaw = np.radians(yaw_deg)
    return np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)


def rear_axle_m(path, distance_m):
    """Middle of the rear axle after a distance."""
    middle, yaw_deg = path.at(distance_m)
    return middle - (path.wheelbase_m - path.front_axle_ahead_m) * unit(yaw_deg)


# Straight on


def test_paths_answer_for_any_shape_of_distances():
    straight = StraightPath(start_m=[1.0, 2.0], yaw_deg=90.0)
    for path in (straight, TURN_PATH):
        position, heading = path.at(np.arange(6.0).reshape(2, 3))
        assert position.shape == (2, 3, 2)
        assert heading.shape == (2, 3)

    position, _ = straight.at(np.arange(6.0).reshape(2, 3))
    assert position[1, 2] == pytest.approx([1.0, 7.0])


# Round a turn


@given(turn_paths(), numbers(-30.0, 120.0))
def test_the_front_axle_follows_the_line_and_is_ahead_of_the_middle_of_the_body(
    path, distance_m
):
    middle, yaw_deg = path.at(distance_m)
    front_axle, path_yaw_deg = front_axle_at(path, distance_m)
    before_middle = middle + path.front_axle_ahead_m * unit(yaw_deg)

    assert before_middle == pytest.approx(front_axle, abs=TABLE_M)

    point, angle_deg = path.turn.at(distance_m - path.straight_m)
    ahead = (path.straight_m + point[0]) * unit(path.yaw_deg)
    left = point[1] * unit(path.yaw_deg + 90.0)

    assert front_axle == pytest.approx(path.start_m + ahead + left, abs=1e-9)
    assert path_yaw_deg == pytest.approx(path.yaw_deg + angle_deg, abs=1e-9)


@given(turn_paths(), numbers(-30.0, 120.0))
def test_the_rear_axle_never_slips_sideways_and_rolls_by_the_cosine_of_the_lag(
    path, distance_m
):
    step_m = 0.05
    _, yaw_deg = path.at(distance_m)
    _, path_yaw_deg = front_axle_at(path, distance_m)
    after, before = rear_axle_m(path, distance_m + np.array([0.5, -0.5]) * step_m)
    rolled = (after - before) / step_m

    assert rolled @ unit(yaw_deg + 90.0) == pytest.approx(0.0, abs=1e-4)

    lag = np.radians(path_yaw_deg - yaw_deg)
    assert rolled @ unit(yaw_deg) == pytest.approx(np.cos(lag), abs=2e-4)


@given(turn_paths(), numbers(0.0, 1.0))
def test_before_the_turn_the_body_goes_straight_however_far_back(path, share):
    distance_m = path.straight_m - 100.0 * share
    middle, yaw_deg = path.at(distance_m)
    ahead_m = distance_m - path.front_axle_ahead_m

    assert yaw_deg == path.yaw_deg

    expected = path.start_m + ahead_m * unit(path.yaw_deg)
    assert middle == pytest.approx(expected, abs=1e-9)


@given(turn_paths())
def test_paths_keep_the_bounds_that_they_declare(path):
    step_m = 0.05
    distance = np.arange(-2.0, path.straight_m + path.turn.length_m + 10.0, step_m)
    middle, yaw_deg = path.at(distance)
    yaw = np.radians(yaw_deg)
    turn = path.max_turn_rad_per_m
    slack = TABLE_M / step_m
    moves_m = np.linalg.norm(np.diff(middle, axis=0), axis=1)

    assert (moves_m <= step_m * (1.0 + slack)).all()

    turned = np.abs(np.diff(yaw))
    assert (turned <= step_m * (turn + slack)).all()

    slack = 4.0 * TABLE_M / step_m**2
    changes_m = np.diff(middle, 2, axis=0)
    bend = np.linalg.norm(changes_m, axis=1) / step_m**2

    assert (bend <= 3.0 * turn + slack).all()

    turn_change = np.abs(np.diff(yaw, 2)) / step_m**2
    assert (turn_change <= path.max_turn_change_rad_per_m2 + slack).all()


def test_a_straight_path_declares_that_it_never_turns():
    path = StraightPath(start_m=[0.0, 0.0], yaw_deg=30.0)
    assert path.max_turn_rad_per_m == path.max_turn_change_rad_per_m2 == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start_m": [0.0]}, "start_m: got shape (1,); expected shape (2,)"),
        ({"yaw_deg": np.inf}, "yaw_deg: got inf; expected finite degrees"),
        ({"straight_m": -1.0}, "straight_m: got -1.0; expected metres, at least 0"),
        ({"wheelbase_m": 0.0}, "wheelbase_m: got 0.0; expected > 0 metres"),
        (
            {"front_axle_ahead_m": 2.9},
            "front_axle_ahead_m: got 2.9; expected 0 <= metres <= wheelbase",
        ),
    ],
)
def test_a_turn_path_says_what_is_wrong(change, message):
    with refused_with(message):
        dataclasses.replace(TURN_PATH, **change)


# Motion


def motion_of(speed_mps, start_time_s=0.0, acceleration_distance_m=0.0):
    """A motion straight on."""
    return Motion(
        path=StraightPath(start_m=[0.0, 0.0], yaw_deg=0.0),
        speed_mps=speed_mps,
        start_time_s=start_time_s,
        acceleration_distance_m=acceleration_distance_m,
    )


@given(
    speeds,
    numbers(-20.0, 0.0),
    numbers(-30.0, 10.0),
    numbers(0.0, 10.0),
)
def test_a_motion_stands_until_its_start_and_then_keeps_its_speed(
    speed, start_s, time_s, later_s
):
    motion = motion_of(speed, start_s)
    if time_s <= start_s:
        assert motion.distance_m(time_s) == 0.0
    else:
        driven = motion.distance_m(time_s + later_s) - motion.distance_m(time_s)
        assert driven == pytest.approx(speed * later_s, abs=1e-9)
    assert motion.distance_m(start_s) == 0.0


@given(
    speeds,
    numbers(0.1, 10.0),
    numbers(0.0, 1.0),
    numbers(0.0, 10.0),
)
def test_a_motion_from_rest_reaches_its_speed_after_twice_the_distance_over_the_speed(
    speed, acceleration_m, share, later_s
):
    motion = motion_of(speed, -3.0, acceleration_m)
    up_to_speed_s = 2.0 * acceleration_m / speed

    # v^2 / (2 a) for so long, and then the speed itself.
    assert motion.acceleration_mps2 * up_to_speed_s == pytest.approx(speed)

    gaining_s = share * up_to_speed_s
    gained_m = 0.5 * motion.acceleration_mps2 * gaining_s**2

    assert motion.distance_m(-3.0 + gaining_s) == pytest.approx(gained_m, abs=1e-9)

    at_speed_m = motion.distance_m(-3.0 + up_to_speed_s + later_s)
    assert at_speed_m == pytest.approx(acceleration_m + speed * later_s, abs=1e-9)
    assert motion.distance_m(-3.5) == 0.0


@example(1.0, 2.0, 1.0)  # not yet up to speed
@given(speeds, accelerations_m, numbers(0.0, 60.0))
def test_travel_time_inverts_the_distance(speed, acceleration_m, time_s):
    motion = motion_of(speed, 0.0, acceleration_m)
    distance_m = float(motion.distance_m(time_s))
    travel_s = travel_time_s(
        distance_m,
        speed_mps=speed,
        acceleration_distance_m=acceleration_m,
    )

    assert travel_s == pytest.approx(time_s, abs=1e-6)
    assert motion.distance_m(travel_s) == pytest.approx(distance_m, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"speed_mps": -1.0},
            "motion.speed_mps: got -1.0; expected > 0 metres per second",
        ),
        (
            {"speed_mps": np.nan},
            "motion.speed_mps: got nan; expected > 0 metres per second",
        ),
        (
            {"start_time_s": np.inf},
            "motion.start_time_s: got inf; expected a finite time",
        ),
        (
            {"acceleration_distance_m": -0.1},
            ("motion.acceleration_distance_m: got -0.1; expected metres, at least 0"),
        ),
    ],
)
def test_a_motion_says_what_is_wrong(change, message):
    with refused_with(message):
        dataclasses.replace(motion_of(1.0), **change)


@pytest.mark.parametrize(
    ("distance_m", "speed_mps", "acceleration_m", "message"),
    [
        (-1.0, 1.0, 0.0, "distance_m: got -1.0; expected metres, at least 0"),
        (1.0, -1.0, 0.0, "speed_mps: got -1.0; expected > 0 metres per second"),
        (
            1.0,
            1.0,
            np.inf,
            "acceleration_distance_m: got inf; expected metres, at least 0",
        ),
    ],
)
def test_a_travel_time_of_nonsense_is_refused(
    distance_m, speed_mps, acceleration_m, message
):
    with refused_with(message):
        travel_time_s(
            distance_m,
            speed_mps=speed_mps,
            acceleration_distance_m=acceleration_m,
        )


@pytest.mark.parametrize(
    ("n_nodes", "stride"),
    [
        (2, 4),
        (5, 4),
        (60, 8),
    ],
)
def test_headings_between_nodes_are_scipys_cubics(n_nodes, stride):
    rng = np.random.default_rng(n_nodes)
    nodes = np.cumsum(rng.normal(size=n_nodes))
    slope = rng.normal(size=n_nodes)
    at = stride * np.arange(n_nodes)
    every = np.minimum(np.arange(at[-1] + 3), at[-1])
    expected = CubicHermiteSpline(at, nodes, slope)(every)

    assert_array_equal(_hermite(nodes, slope, stride, len(every)), expected)
