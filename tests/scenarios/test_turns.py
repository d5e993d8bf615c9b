from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from refusals import refused_with
from scipy.constants import kmh
from scipy.integrate import cumulative_simpson
from scipy.optimize import brentq
from strategies import numbers

from scenarios.courses import LEFT, RIGHT, Turn, load_turns, pick_turn

# Lengths and places of the protocol's turns, computed apart from this code (numerical
# integration, four decimals) from the numbers of Euro NCAP AEB/LSS VRU v4.5.1. Frame:
# origin at the middle of a junction of lanes whose middles are 1.75 m from the roads'
# axes, x along the VUT's approach.
PROTOCOL = {
    "far_10": {
        "clothoid_length_m": 6.4393,
        "arc_length_m": 7.6592,
        "curve_length_m": 20.5379,
        "clothoid_long_extent_m": 6.3559,
        "clothoid_short_extent_m": 0.7699,
        "arc_extent_each_axis_m": 5.2539,
        "total_extent_m": 12.3798,
        "curve_start_m": [-10.6298, -1.75],
        "curve_end_m": [1.75, 10.6298],
        "lateral_acceleration_mps2": 0.857,
        "heading_at_pedestrian_line_deg": 89.33,
        "short_of_exit_lane_centre_m": 0.0045,
        "path_after_curve_start_m": 19.4081,
    },
    "far_15": {
        "clothoid_length_m": 8.5178,
        "arc_length_m": 9.8724,
        "curve_length_m": 26.9079,
        "clothoid_long_extent_m": 8.4039,
        "clothoid_short_extent_m": 1.0353,
        "arc_extent_each_axis_m": 6.7773,
        "total_extent_m": 16.2165,
        "curve_start_m": [-14.4665, -1.75],
        "curve_end_m": [1.75, 14.4665],
        "lateral_acceleration_mps2": 1.478,
        "heading_at_pedestrian_line_deg": 82.78,
        "short_of_exit_lane_centre_m": 0.2114,
        "path_after_curve_start_m": 21.9335,
    },
    "far_20": {
        "clothoid_length_m": 11.1098,
        "arc_length_m": 11.9502,
        "curve_length_m": 34.1698,
        "clothoid_long_extent_m": 10.9486,
        "clothoid_short_extent_m": 1.4075,
        "arc_extent_each_axis_m": 8.2208,
        "total_extent_m": 20.5769,
        "curve_start_m": [-18.8269, -1.75],
        "curve_end_m": [1.75, 18.8269],
        "lateral_acceleration_mps2": 2.092,
        "heading_at_pedestrian_line_deg": 74.35,
        "short_of_exit_lane_centre_m": 0.8606,
        "path_after_curve_start_m": 24.7723,
    },
    "near_10": {
        "clothoid_length_m": 6.3471,
        "arc_length_m": 6.1854,
        "curve_length_m": 18.8796,
        "clothoid_long_extent_m": 6.2463,
        "clothoid_short_extent_m": 0.8386,
        "arc_extent_each_axis_m": 4.2656,
        "total_extent_m": 11.3506,
        "curve_start_m": [-13.1006, -1.75],
        "curve_end_m": [-1.75, -13.1006],
        "lateral_acceleration_mps2": 0.965,
        "heading_at_pedestrian_line_deg": 82.56,
        "short_of_exit_lane_centre_m": 0.1573,
        "path_after_curve_start_m": 15.2729,
    },
}
LANE_M = 1.75
PEDESTRIAN_LINE_M = 9.5


@st.composite
def turns(draw) -> Turn:
    radius_m = draw(numbers(3.0, 30.0))
    clothoid_deg = draw(numbers(1.0, 60.0))
    return Turn(
        first_radius_m=draw(
            st.one_of(st.just(np.inf), numbers(1.05, 300.0).map(radius_m.__mul__))
        ),
        radius_m=radius_m,
        clothoid_deg=clothoid_deg,
        arc_deg=draw(numbers(0.0, 0.95 * (180.0 - 2.0 * clothoid_deg))),
        side=draw(st.sampled_from([LEFT, RIGHT])),
    )


@pytest.mark.parametrize("name", PROTOCOL)
def test_turns_of_the_protocol_have_the_lengths_and_places_computed_elsewhere(name):
    entry = load_turns()[name]
    golden = PROTOCOL[name]
    turn = entry.turn
    clothoid_end, _ = turn.at(turn.clothoid_length_m)
    arc_end, _ = turn.at(turn.clothoid_length_m + turn.arc_length_m)
    end, end_deg = turn.at(turn.length_m)
    start = np.array([turn.side * LANE_M - turn.tangent_m, -LANE_M])

    def short_of_line_m(distance_m):
        return turn.side * (start + turn.at(distance_m)[0])[1] - PEDESTRIAN_LINE_M

    on_line_m = brentq(short_of_line_m, 0.0, turn.length_m, xtol=1e-12)
    on_line, on_line_deg = turn.at(on_line_m)
    ours = {
        "clothoid_length_m": turn.clothoid_length_m,
        "arc_length_m": turn.arc_length_m,
        "curve_length_m": turn.length_m,
        "clothoid_long_extent_m": clothoid_end[0],
        "clothoid_short_extent_m": turn.side * clothoid_end[1],
        "arc_extent_each_axis_m": arc_end[0] - clothoid_end[0],
        "total_extent_m": turn.tangent_m,
        "curve_start_m": start,
        "curve_end_m": start + end,
        "short_of_exit_lane_centre_m": end[0] - on_line[0],
    }
    for key, value in ours.items():
        assert value == pytest.approx(golden[key], abs=5.1e-5), key
    assert turn.side * (arc_end - clothoid_end)[1] == pytest.approx(
        golden["arc_extent_each_axis_m"], abs=5.1e-5
    )
    # The numbers from elsewhere are up to 0.12 mm off here; ours integrate to within a
    # micrometre.
    assert on_line_m == pytest.approx(golden["path_after_curve_start_m"], abs=1.5e-4)
    assert turn.side * end_deg == pytest.approx(90.0, abs=1e-12)
    assert turn.side * on_line_deg == pytest.approx(
        golden["heading_at_pedestrian_line_deg"], abs=5.1e-3
    )
    assert (entry.speed_kmh * kmh) ** 2 / turn.radius_m == pytest.approx(
        golden["lateral_acceleration_mps2"], abs=5.1e-4
    )


@given(turns())
def test_points_are_the_integral_of_the_direction_and_that_of_the_curvature(turn):
    clothoid_m = turn.clothoid_length_m
    arc_m = turn.arc_length_m
    distance = np.linspace(-1.0, turn.length_m + 1.0, 4001)
    curvature = np.interp(
        distance,
        [0.0, clothoid_m, clothoid_m + arc_m, turn.length_m],
        1.0
        / np.array(
            [turn.first_radius_m, turn.radius_m, turn.radius_m, turn.first_radius_m]
        ),
    )
    curvature[(distance < 0.0) | (distance > turn.length_m)] = 0.0
    step = distance[1] - distance[0]
    angle = cumulative_simpson(curvature, dx=step, initial=0.0)
    position, angle_deg = turn.at(distance)
    # The curvature jumps where the turn begins and ends.
    assert_allclose(
        turn.side * np.radians(angle_deg),
        angle,
        rtol=0.0,
        atol=2.0 * step / turn.radius_m,
    )
    east = cumulative_simpson(np.cos(np.radians(angle_deg)), dx=step, initial=0.0) - 1.0
    north = cumulative_simpson(np.sin(np.radians(angle_deg)), dx=step, initial=0.0)
    assert_allclose(position, np.stack([east, north], axis=-1), rtol=0.0, atol=5e-6)


@given(turns())
def test_a_turn_ends_on_the_exit_line_at_the_tangents_length_behind_the_corner(turn):
    end, end_deg = turn.at(turn.length_m)
    angle = turn.side * np.radians(turn.angle_deg)
    corner = np.array([turn.tangent_m, 0.0])
    exit_direction = np.array([np.cos(angle), np.sin(angle)])
    assert end == pytest.approx(corner + turn.tangent_m * exit_direction, abs=1e-9)
    assert end_deg == pytest.approx(turn.side * turn.angle_deg, abs=1e-9)


@given(turns(), numbers(-1.0, 2.0))
def test_a_turn_is_the_same_from_its_other_end(turn, share):
    distance_m = share * turn.length_m
    point, angle_deg = turn.at(distance_m)
    other, other_deg = turn.at(turn.length_m - distance_m)
    assert angle_deg + other_deg == pytest.approx(turn.side * turn.angle_deg, abs=1e-9)
    end, _ = turn.at(turn.length_m)
    # Backwards, mirrored: into the frame of the other end.
    angle = turn.side * np.radians(turn.angle_deg)
    back = np.array([-np.cos(angle), -np.sin(angle)])
    left_of_back = np.array([back[1], -back[0]])
    assert [(point - end) @ back, (point - end) @ left_of_back] == pytest.approx(
        other, abs=1e-9
    )


@given(turns(), numbers(-20.0, 80.0))
def test_left_and_right_are_mirror_images(turn, distance_m):
    other = replace(turn, side=-turn.side)
    point, angle_deg = turn.at(distance_m)
    mirrored, mirrored_deg = other.at(distance_m)
    assert (point * [1.0, -1.0] == mirrored).all()
    assert angle_deg == -mirrored_deg
    assert turn.tangent_m == other.tangent_m


@given(turns(), numbers(0.0, 1.0))
def test_another_angle_changes_the_arc_only(turn, share):
    clothoids_deg = 2.0 * turn.clothoid_deg
    angle_deg = clothoids_deg + share * (179.0 - clothoids_deg)
    other = turn.turned_by(angle_deg)
    assert other.angle_deg == pytest.approx(angle_deg, abs=1e-9)
    assert other == replace(turn, arc_deg=other.arc_deg)
    assert other.length_m == pytest.approx(
        2.0 * turn.clothoid_length_m
        + np.radians(angle_deg - clothoids_deg) * turn.radius_m
    )


def test_a_clothoid_that_begins_straight_is_the_limit_of_ever_larger_first_radii():
    straight = Turn(
        first_radius_m=np.inf, radius_m=9.0, clothoid_deg=20.0, arc_deg=50.0, side=LEFT
    )
    nearly = replace(straight, first_radius_m=1e9)
    assert straight.at(5.0)[0] == pytest.approx(nearly.at(5.0)[0], abs=1e-6)
    # The known series of the clothoid: x = s - s^5 / (40 A^4), y = s^3 / (6 A^2).
    a_squared = 9.0 * straight.clothoid_length_m
    x = 1.0 - 1.0 / (40.0 * a_squared**2)
    y = 1.0 / (6.0 * a_squared) * (1.0 - 1.0 / (56.0 * a_squared**2))
    assert straight.at(1.0)[0] == pytest.approx([x, y], abs=1e-9)


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
    ("side", "speed_kmh", "message"),
    [
        ("left", 10.0, "turn: got 'left'; expected one of far, near"),
        (
            "far",
            12.0,
            (
                "speed of a far turn: got 12.0; "
                "expected 10, 15, 20 km/h, or beyond the first or the last"
            ),
        ),
        (
            "near",
            0.0,
            (
                "speed of a near turn: got 0.0; expected 10 km/h, or beyond the first"
                " or the last"
            ),
        ),
        (
            "near",
            np.nan,
            (
                "speed of a near turn: got nan; expected 10 km/h, or beyond the first"
                " or the last"
            ),
        ),
    ],
)
def test_a_turn_that_is_not_tabulated_is_refused(side, speed_kmh, message):
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
                "turn.arc_deg: got 140.0; expected degrees >= 0, less than 180 with"
                " both clothoids"
            ),
        ),
        ({"side": 0}, "turn.side: got 0; expected 1 (left) or -1 (right)"),
    ],
)
def test_a_turn_says_what_is_wrong(change, message):
    with refused_with(message):
        replace(load_turns()["far_10"].turn, **change)
