"""Turns of the protocol: clothoids and arcs, against integrals."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from refusals import refused_with
from scipy.integrate import cumulative_simpson
from strategies import numbers

from scenarios.courses import LEFT, RIGHT, Turn, load_turns, pick_turn


@st.composite
def turns(draw):
    """Turns that come out of a straight line or of a wider bend."""
    radius_m = draw(numbers(3.0, 30.0))
    clothoid_deg = draw(numbers(1.0, 60.0))
    times_wider = draw(st.one_of(st.just(np.inf), numbers(1.05, 300.0)))
    arc_deg = draw(numbers(0.0, 0.95 * (180.0 - 2.0 * clothoid_deg)))
    return Turn(
        first_radius_m=times_wider * radius_m,
        radius_m=radius_m,
        clothoid_deg=clothoid_deg,
        arc_deg=arc_deg,
        side=draw(st.sampled_from([LEFT, RIGHT])),
    )


@given(turns())
def test_points_are_the_integral_of_the_direction_and_that_of_the_curvature(turn):
    arc_begin_m = turn.clothoid_length_m
    arc_end_m = arc_begin_m + turn.arc_length_m
    distance = np.linspace(-1.0, turn.length_m + 1.0, 4001)
    step = distance[1] - distance[0]
    bend = 1.0 / turn.radius_m
    first_bend = 1.0 / turn.first_radius_m
    curvature = np.interp(
        distance,
        [0.0, arc_begin_m, arc_end_m, turn.length_m],
        [first_bend, bend, bend, first_bend],
        left=0.0,
        right=0.0,
    )
    position, angle_deg = turn.at(distance)

    def integral(values):
        return cumulative_simpson(values, dx=step, initial=0.0)

    # The curvature jumps where the turn begins and ends.
    slack = 2.0 * step / turn.radius_m
    angle = turn.side * np.radians(angle_deg)

    assert_allclose(
        angle,
        integral(curvature),
        rtol=0.0,
        atol=slack,
    )

    yaw = np.radians(angle_deg)
    east = integral(np.cos(yaw)) - 1.0
    north = integral(np.sin(yaw))

    assert_allclose(
        position,
        np.stack([east, north], axis=-1),
        rtol=0.0,
        atol=5e-6,
    )


@given(turns())
def test_a_turn_ends_on_the_exit_line_at_the_tangents_length_behind_the_corner(turn):
    end, end_deg = turn.at(turn.length_m)
    angle = turn.side * np.radians(turn.angle_deg)
    corner = np.array([turn.tangent_m, 0.0])
    exit_direction = np.array([np.cos(angle), np.sin(angle)])

    assert end == pytest.approx(corner + turn.tangent_m * exit_direction, abs=1e-9)
    assert end_deg == pytest.approx(turn.side * turn.angle_deg, abs=1e-9)


@given(turns(), numbers(0.0, 1.0))
def test_another_angle_changes_the_arc_only(turn, share):
    clothoids_deg = 2.0 * turn.clothoid_deg
    angle_deg = clothoids_deg + share * (179.0 - clothoids_deg)
    other = turn.turned_by(angle_deg)

    assert other.angle_deg == pytest.approx(angle_deg, abs=1e-9)
    assert other == replace(turn, arc_deg=other.arc_deg)

    arc_m = np.radians(angle_deg - clothoids_deg) * turn.radius_m
    assert other.length_m == pytest.approx(2.0 * turn.clothoid_length_m + arc_m)


def test_speeds_pick_the_turns_of_the_protocol_and_faster_ones_take_the_fastest():
    turns = {name: entry.turn for name, entry in load_turns().items()}
    assert list(turns) == ["far_10", "far_15", "far_20", "near_10"]

    for name, turn in turns.items():
        side, speed_kmh = name.split("_")
        assert pick_turn(side, float(speed_kmh)) == turn
        assert turn.side == {"far": LEFT, "near": RIGHT}[side]
        assert turn.angle_deg == pytest.approx(90.0, abs=1e-12)

    assert pick_turn("far", 25.0) == turns["far_20"]  # 2026 protocol, CPTA and CBTA
    assert pick_turn("far", 5.0) == turns["far_10"]
    assert pick_turn("near", 20.0) == turns["near_10"]


@pytest.mark.parametrize(
    ("side", "message", "speed_kmh"),
    [
        ("left", "turn: got 'left'; expected one of far, near", 10.0),
        (
            "far",
            (
                "speed of a far turn: got 12.0; expected 10, 15, 20 km/h, or "
                "beyond the first or the last"
            ),
            12.0,
        ),
        (
            "near",
            (
                "speed of a near turn: got 0.0; expected 10 km/h, or beyond the "
                "first or the last"
            ),
            0.0,
        ),
        (
            "near",
            (
                "speed of a near turn: got nan; expected 10 km/h, or beyond the "
                "first or the last"
            ),
            np.nan,
        ),
    ],
)
def test_a_turn_that_is_not_tabulated_is_refused(side, message, speed_kmh):
    with refused_with(message):
        pick_turn(side, speed_kmh)


@pytest.mark.parametrize("angle_deg", [0.0, 180.0, -90.0, np.nan])
def test_lanes_at_an_angle_that_no_turn_serves_are_refused(angle_deg):
    with refused_with(f"angle_deg: got {angle_deg}; expected 0 < degrees < 180"):
        load_turns()["far_10"].turn.turned_by(angle_deg)


@pytest.mark.parametrize("angle_deg", [41.24, 30.0, 5.0])
def test_clothoids_alone_serve_small_angles(angle_deg):
    turn = load_turns()["far_10"].turn.turned_by(angle_deg)
    assert turn.arc_deg == 0.0
    assert turn.angle_deg == pytest.approx(angle_deg)

    _, end_deg = turn.at(turn.length_m)
    assert end_deg == pytest.approx(angle_deg)
    assert turn.length_m == pytest.approx(2.0 * turn.clothoid_length_m)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radius_m": 0.0}, "turn.radius_m: got 0.0; expected > 0 metres"),
        ({"radius_m": np.nan}, "turn.radius_m: got nan; expected > 0 metres"),
        (
            {"first_radius_m": 9.0},
            "turn.first_radius_m: got 9.0; expected more than radius_m",
        ),
        (
            {"clothoid_deg": 0.0},
            "turn.clothoid_deg: got 0.0; expected 0 < degrees < 90",
        ),
        (
            {"arc_deg": 140.0},
            (
                "turn.arc_deg: got 140.0; expected degrees >= 0, less than 180 "
                "with both clothoids"
            ),
        ),
        ({"side": 0}, "turn.side: got 0; expected 1 (left) or -1 (right)"),
    ],
)
def test_a_turn_says_what_is_wrong(change, message):
    with refused_with(message):
        replace(load_turns()["far_10"].turn, **change)
