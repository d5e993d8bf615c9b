"""Courses along lanes: closed forms of circles, and what every course keeps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import distance_to_chain_m

from geometry.errors import InputError
from geometry.junction import Line
from scenarios.courses import follow_lane, follow_lanes, join_by_turn, pick_turn
from scenarios.encounters import Encounter, first_contact_s
from scenarios.paths import CoursePath, Motion, TowedPath, TurnPath

AXLES = {"wheelbase_m": 2.7, "front_axle_ahead_m": 1.3}
LANE_M = 3.5


def circle(radius_m, *, step_m=1.0, turn_deg=150.0):
    """Points of a lane that turns left round the origin, from the east on."""
    angle = np.arange(0.0, np.radians(turn_deg), step_m / radius_m)
    on_circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return radius_m * on_circle


def lengths_m(steps):
    """Lengths of vectors."""
    return np.linalg.norm(steps, axis=-1)


def length_of_m(points):
    """Length of a way from point to point."""
    return lengths_m(np.diff(points, axis=0)).sum()


@pytest.mark.parametrize("radius_m", [12.0, 30.0, 120.0])
def test_a_course_along_a_circle_has_its_radius_heading_and_length(radius_m):
    """Courses are smoothed, and lanes are chords: both keep within the slack."""
    points = circle(radius_m)
    course = follow_lane(points, is_in=True)
    # Away from the ends.
    shares = np.linspace(-0.62, -0.38, 50)
    stations = shares * length_of_m(points)
    position, yaw_rad = course.at(stations)

    # Between its points the lane is a chord, 1 / (8 R) metres inside; smoothing takes
    # 16 / R^3.
    slack_m = 0.125 / radius_m + 17.0 / radius_m**3

    assert lengths_m(position) == pytest.approx(radius_m, abs=slack_m)

    east, north = position.T
    angle = np.unwrap(np.arctan2(north, east))
    off_rad = yaw_rad - angle - 0.5 * np.pi
    arcs_m = radius_m * np.diff(angle)

    assert np.abs(off_rad).max() < np.radians(0.2)
    assert np.diff(stations) == pytest.approx(arcs_m, rel=4e-3)
    assert course.max_bend_per_m == pytest.approx(1.0 / radius_m, rel=0.08)


def test_two_bodies_on_a_circle_touch_when_their_corners_do(actors):
    # Equal boxes meet with the inner corners, on the ray between them: seen from the
    # centre, each corner is atan(a / (R - w)) ahead of or behind its body's middle.
    radius_m = 25.0
    ahead_m = 20.0
    body = replace(actors["vut"], name="other")
    course = follow_lane(circle(radius_m, step_m=0.5), is_in=True)
    fast_mps = 12.0
    slow_mps = 4.0

    def motion(start_m, speed_mps):
        path = CoursePath(course=course, start_m=start_m)
        return Motion(path=path, speed_mps=speed_mps, start_time_s=-3.0)

    encounter = Encounter(
        vut=body,
        vut_motion=motion(-55.0, fast_mps),
        vru=body,
        vru_motion=motion(-55.0 + ahead_m, slow_mps),
    )
    inner_m = radius_m - 0.5 * body.width_m
    corner = np.arctan2(0.5 * body.length_m, inner_m)
    gap_m = ahead_m - 2.0 * corner * radius_m
    contact_s = -3.0 + gap_m / (fast_mps - slow_mps)

    assert first_contact_s(encounter) == pytest.approx(contact_s, abs=2e-3)


@pytest.mark.parametrize(
    ("side", "speed_kmh"),
    [
        ("near", 10.0),
        ("far", 10.0),
        ("far", 20.0),
    ],
)
def test_a_turn_between_straight_lanes_is_the_protocols(side, speed_kmh):
    """The protocol's curve and the body towed along the course are the same way."""
    turn = pick_turn(side, speed_kmh)
    into = np.array(
        [
            [-80.0, 0.0],
            [0.0, 0.0],
        ]
    )
    entry = follow_lane(into, is_in=True)
    out = np.array(
        [
            [25.0, 25.0 * turn.side],
            [25.0, 125.0 * turn.side],
        ]
    )
    leaving = follow_lane(out, is_in=False)
    course, fitted = join_by_turn(entry, leaving, turn)

    assert fitted.angle_deg == pytest.approx(90.0, abs=1e-6)

    protocols = TurnPath(
        start_m=course.at(-20.0)[0],
        yaw_deg=0.0,
        straight_m=20.0,
        turn=fitted,
        **AXLES,
    )
    towed = TowedPath(course=course, start_m=-20.0, **AXLES)
    distances = np.linspace(0.0, 80.0, 400)

    position, yaw_deg = protocols.at(distances)
    towed_position, towed_yaw_deg = towed.at(distances)

    assert position == pytest.approx(towed_position, abs=1e-4)
    assert yaw_deg == pytest.approx(towed_yaw_deg, abs=1e-4)


def test_a_straight_lane_gives_a_straight_course():
    """It goes on beyond both ends of the lane in the same direction."""
    line = Line(point_m=[3.0, -2.0], direction=[3.0, 4.0])
    points = []
    for along_m in (-60.0, -20.0, -19.0, 0.0):
        points.append(line.at(along_m))

    course = follow_lane(points, is_in=True)
    stations = np.linspace(-90.0, 40.0, 60)
    position, yaw_rad = course.at(stations)

    along_m, left_m = line.coordinates(position).T

    assert left_m == pytest.approx(0.0, abs=1e-9)
    # The origin is a point of the table, which has one every centimetre.
    assert along_m == pytest.approx(stations, abs=0.0051)
    assert np.degrees(yaw_rad) == pytest.approx(line.yaw_deg, abs=1e-9)
    assert course.max_bend_per_m < 1e-9


def test_lanes_one_after_the_other_are_one_course_with_its_origin_between_them():
    """The kink between both is rounded off by at most a quarter of a metre."""
    first = np.array(
        [
            [-40.0, 0.0],
            [0.0, 0.0],
        ]
    )
    second = np.array(
        [
            [0.0, 0.0],
            [30.0, 8.0],
        ]
    )
    course = follow_lanes([first, second])
    origin, _ = course.at(0.0)
    beyond, _ = course.at(25.0)
    across = [-8.0, 30.0]

    assert origin == pytest.approx([0.0, 0.0], abs=0.25)
    assert beyond @ across == pytest.approx(0.0, abs=2.0)


def test_a_lane_without_length_has_no_course():
    with pytest.raises(InputError, match="at least two different points"):
        follow_lane(np.ones((2, 2)), is_in=True)


def test_beside_a_bend_sharper_than_asked_for_there_is_no_course():
    course = follow_lane(circle(12.0), is_in=True)

    with pytest.raises(InputError, match="left_m: got 14"):
        course.offset(14.0)


@st.composite
def lanes(draw):
    """Lanes that bend to and fro, as maps draw them: chords of up to 4 m, radii from 14
    m.
    """
    sharpest_per_m = 1.0 / 14.0
    bend = st.floats(-sharpest_per_m, sharpest_per_m)
    bends = draw(st.lists(bend, min_size=1, max_size=4))
    step_m = draw(st.floats(0.5, 4.0))
    first_yaw = draw(st.floats(-3.1, 3.1))
    place_m = draw(st.floats(-300.0, 300.0))

    curvature = np.repeat(bends, int(18.0 / step_m) + 2)
    turned = np.append(0.0, np.cumsum(curvature * step_m))
    yaw = first_yaw + turned
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    steps = step_m * ahead
    return np.cumsum(steps, axis=0) + place_m


@given(lane=lanes(), is_in=st.booleans(), body=st.sampled_from(["vru", "vut"]))
def test_no_path_leaves_its_lane_or_jumps(lane, is_in, body):
    """A path's turning, and how fast this changes, keep below what the path says."""
    course = follow_lane(lane, is_in=is_in)
    length_m = length_of_m(lane)
    if is_in:
        begin_m = -length_m
    else:
        begin_m = 0.0
    # The towed body is aligned with the lane from its begin on; the path starts there.
    if body == "vru":
        path = CoursePath(course=course, start_m=begin_m)
    else:
        path = TowedPath(course=course, start_m=begin_m + 1.3, **AXLES)
    step_m = 0.25
    end_m = 0.99 * length_m - 2.0
    distances = np.arange(0.0, end_m, step_m)
    position, yaw_deg = path.at(distances)

    off_m = distance_to_chain_m(position, lane)

    # A body 1.8 m wide stays in its lane.
    assert off_m.max() <= 0.5 * LANE_M - 0.9

    steps_m = lengths_m(np.diff(position, axis=0))
    assert steps_m.max() <= step_m + 1e-9

    turns = np.diff(np.radians(yaw_deg)) / step_m
    assert np.abs(turns).max() <= path.max_turn_rad_per_m + 1e-9

    changes = np.diff(turns) / step_m
    assert np.abs(changes).max() <= path.max_turn_change_rad_per_m2 + 1e-6

    bends = np.diff(position, n=2, axis=0) / step_m**2
    sharpest_per_m = lengths_m(bends).max()

    assert sharpest_per_m <= 3.0 * path.max_turn_rad_per_m + 1e-3


@given(lane=lanes(), left_m=st.floats(-4.0, 4.0))
def test_the_course_beside_another_keeps_its_distance_and_direction(lane, left_m):
    """Driven the other way, a course has the same places and opposite directions."""
    course = follow_lane(lane, is_in=True)
    beside = course.offset(left_m)
    station = 0.3 * course.begin_m
    place = course.tangent(station)
    aside_m = place.at(0.0, left_m)
    there = beside.tangent(beside.station_of(aside_m))

    assert there.point_m == pytest.approx(aside_m, abs=0.01)
    assert there.direction == pytest.approx(place.direction, abs=2e-3)

    back = course.reversed().tangent(-station)
    assert back.point_m == pytest.approx(place.point_m, abs=1e-6)
    assert back.direction == pytest.approx(-place.direction, abs=1e-6)
