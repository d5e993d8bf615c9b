"""Distances of two bodies on their ways, and when they first touch."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused_with
from strategies import build_encounter, encounters, numbers

from geometry.actors import load_actors
from geometry.footprints import footprint_corners, footprint_separation
from scenarios.aeb import braking_distance_m, load_aeb_rule
from scenarios.courses import pick_turn
from scenarios.encounters import (
    GRAZING_M,
    Cells,
    Encounter,
    Measures,
    find_first_touches,
    first_contact_s,
)
from scenarios.paths import Motion, StraightPath, TurnPath

ACTORS = load_actors()
VUT = ACTORS["vut"]
ADULT = ACTORS["adult"]


def later(encounter, vut_s, vru_s):
    """An encounter in which both set off later."""
    vut = encounter.vut_motion
    vru = encounter.vru_motion
    return replace(
        encounter,
        vut_motion=replace(vut, start_time_s=vut.start_time_s + vut_s),
        vru_motion=replace(vru, start_time_s=vru.start_time_s + vru_s),
    )


def separation_at(encounter, time_s):
    """Separation of the bodies at times. [m]"""
    vut_m = encounter.vut_motion.distance_m(time_s)
    vru_m = encounter.vru_motion.distance_m(time_s)
    return encounter.separation_m(vut_m, vru_m)


def set_off_together(encounter):
    """The VRU waits at the place that it had reached when the VUT set off."""
    vru = encounter.vru_motion
    start_s = encounter.vut_motion.start_time_s
    start_m, _ = vru.path.at(vru.distance_m(start_s))
    path = replace(vru.path, start_m=start_m)
    motion = replace(vru, path=path, start_time_s=start_s)
    return replace(encounter, vru_motion=motion)


# Else a cyclist might ride through the waiting VUT.
together = encounters().map(set_off_together)


def moving(start_m, yaw_deg, speed_mps, **more):
    """A motion straight on, by default from 0 s."""
    more.setdefault("start_time_s", 0.0)
    path = StraightPath(start_m=start_m, yaw_deg=yaw_deg)
    return Motion(path=path, speed_mps=speed_mps, **more)


def met(vut_motion, vru_motion, vru=ADULT):
    """An encounter of the car with somebody, by default an adult."""
    return Encounter(
        vut=VUT,
        vut_motion=vut_motion,
        vru=vru,
        vru_motion=vru_motion,
    )


def turning():
    """A car that turns left, and an adult who walks along the arm there."""
    path = TurnPath(
        start_m=[0.0, 0.0],
        yaw_deg=0.0,
        straight_m=5.0,
        turn=pick_turn("far", 15.0),
        wheelbase_m=2.85,
        front_axle_ahead_m=1.45,
    )
    walks = moving(
        [15.5, 9.0],
        0.0,
        1.4,
        start_time_s=0.5,
        acceleration_distance_m=1.0,
    )
    turns = Motion(
        path=path,
        speed_mps=15.0 / 3.6,
        start_time_s=0.0,
    )
    return met(turns, walks)


# Encounter


def test_separation_is_that_of_the_bodies_corners():
    """At every pair of two distances, by the corners of the rectangles."""
    encounter = turning()
    vut_distance = np.linspace(0.0, 30.0, 7)[:, None]
    vru_distance = np.linspace(0.0, 9.0, 5)
    separation = encounter.separation_m(vut_distance, vru_distance)

    assert separation.shape == (7, 5)

    corners = []
    for body, motion, distance in (
        (encounter.vut, encounter.vut_motion, vut_distance),
        (encounter.vru, encounter.vru_motion, vru_distance),
    ):
        position, yaw_deg = motion.path.at(distance)
        corners.append(
            footprint_corners(
                position,
                yaw_deg,
                length_m=body.length_m,
                width_m=body.width_m,
            )
        )

    ours, theirs = corners
    expected = footprint_separation(ours, theirs)

    assert separation == pytest.approx(expected, abs=1e-9)


@given(
    numbers(1.0, 9.0),
    numbers(1.0, 9.0),
    numbers(0.001, 0.2),
    st.sampled_from([0.0, 0.3]),
)
def test_between_two_looks_gaps_sag_no_deeper_than_declared(
    middle_s, onset_s, half_s, build_up_s
):
    """The search may skip what lies between: gaps bend no more than is declared."""
    encounter = turning()
    vut = encounter.vut_motion
    vru = encounter.vru_motion
    rule = replace(load_aeb_rule(), build_up_s=build_up_s)
    speed = encounter.vut_reach * vut.speed_mps + encounter.vru_reach * vru.speed_mps
    half_s = min(half_s, encounter.small_m / speed)
    time = middle_s + half_s * np.linspace(-1.0, 1.0, 201)
    braking_s = np.maximum(time - onset_s, 0.0)
    braking_m = braking_distance_m(braking_s, speed_mps=vut.speed_mps, rule=rule)
    driven = vut.distance_m(np.minimum(time, onset_s)) + braking_m
    gaps = encounter.gaps_m(driven, vru.distance_m(time))
    separation = gaps.max(axis=0)

    if separation[0] <= encounter.near_m:
        ends = gaps[:, [0, -1]].min(axis=1)
        bend_mps2 = encounter.max_gap_bend_mps2(rule.deceleration_mps2)
        sag_m = 0.5 * bend_mps2 * half_s**2
        least_m = ends.max() - sag_m
        # Overlaps may be deeper.
        assert least_m <= 0.0 or separation.min() >= least_m - 1e-6


def test_a_vut_that_sets_off_from_rest_is_refused():
    """Its way until it brakes must be speed by time."""
    encounter = turning()
    motion = replace(encounter.vut_motion, acceleration_distance_m=2.0)
    with refused_with(
        "encounter.vut_motion.acceleration_distance_m: got 2.0; "
        "expected 0: the VUT is up to speed when it sets off"
    ):
        replace(encounter, vut_motion=motion)


# First contact


@given(together, numbers(-30.0, 30.0))
def test_bodies_built_to_touch_at_time_0_first_touch_then(encounter, later_s):
    """And when both set off later, they touch as much later."""
    assert first_contact_s(encounter) == pytest.approx(0.0, abs=1e-6)
    both_later = later(encounter, later_s, later_s)
    assert first_contact_s(both_later) == pytest.approx(later_s, abs=1e-6)


@given(together, numbers(-0.3, 0.3))
def test_first_contact_is_the_first_of_many_looks(encounter, later_s):
    """Looked at every 0.1 ms; a shorter touch may be found, too."""
    encounter = later(encounter, 0.0, later_s)
    time = np.arange(-1.0, 2.0, 1e-4)
    touches = separation_at(encounter, time) <= 0.0
    contact_s = first_contact_s(encounter)

    if touches.any():
        first = int(np.argmax(touches))
        before = max(first - 1, 0)
        assert time[before] - 1e-6 <= contact_s <= time[first] + 1e-6
    elif contact_s <= time[-1]:  # a touch between two looks
        nearby = contact_s + np.array([0.0, 1e-7])
        assert separation_at(encounter, nearby).min() <= 1e-6


def test_first_contact_on_a_turn_is_the_first_of_many_looks():
    encounter = turning()
    time = np.arange(0.0, 12.0, 1e-4)
    first = np.argmax(separation_at(encounter, time) <= 0.0)

    assert first_contact_s(encounter) == pytest.approx(time[first], abs=1e-4)


def test_a_short_touch_of_two_corners_is_not_overlooked():
    """It takes less than a microsecond; a micrometre farther there is none."""
    # Crossing at right angles; the VRU's rear corner passes the VUT's front corner 1
    # micrometre inside.
    v = 15.0
    u = 3.0
    depth_m = 1e-6
    leaves_s = 100.0 / v
    x = 100.0 + 0.5 * VUT.length_m + 0.5 * ADULT.width_m
    y = 0.5 * VUT.width_m + 0.5 * ADULT.length_m - u * leaves_s

    def encounter(inside_m):
        one = moving([0.0, 0.0], 0.0, v)
        other = moving([x, y - inside_m], 90.0, u)
        return met(one, other)

    inside = encounter(depth_m)
    outside = encounter(-depth_m)

    assert first_contact_s(inside) == pytest.approx(leaves_s, abs=1e-6)
    assert first_contact_s(outside) == np.inf


@pytest.mark.parametrize(
    ("yaw_deg", "speed_mps"),
    [
        (0.0, 5.0),
        (90.0, 5.0),
        (180.0, 0.1),
    ],  # as fast beside it, away, slowly past it
)
def test_bodies_that_never_touch_have_no_first_contact(yaw_deg, speed_mps):
    rides = moving([0.0, 2.0], yaw_deg, speed_mps)
    encounter = met(moving([0.0, 0.0], 0.0, 5.0), rides, ACTORS["cyclist"])
    assert first_contact_s(encounter) == np.inf


def test_a_late_contact_is_found_and_one_from_the_start_is_at_the_start():
    """The car comes nearer by 0.1 m/s only."""
    length_m = 0.5 * (VUT.length_m + ADULT.length_m)
    ahead = moving([length_m + 40.0, 0.0], 0.0, 2.0)
    slow = met(moving([0.0, 0.0], 0.0, 2.1), ahead)

    assert first_contact_s(slow) == pytest.approx(400.0, abs=1e-6)

    early = moving(
        [1.0, 0.0],
        0.0,
        2.0,
        start_time_s=-7.0,
    )
    at_once = replace(slow, vru_motion=early)

    assert first_contact_s(at_once) == pytest.approx(-7.0, abs=1e-6)


def test_a_contact_before_the_later_one_sets_off_counts():
    encounter = build_encounter(
        vru=ADULT,
        vut_speed_mps=10.0,
        vru_speed_mps=1.0,
        angle_deg=90.0,
        touch=0.0,
        vut_drive_s=8.0,
    )
    # The VRU walks over the line while the VUT still stands there.
    parked = replace(encounter.vut_motion, start_time_s=50.0)
    met_m, _ = parked.path.at(80.0)
    path = replace(parked.path, start_m=met_m + [2.0, 0.0])
    waiting = replace(encounter, vut_motion=replace(parked, path=path))
    half_m = 0.5 * (VUT.width_m + ADULT.length_m)

    assert first_contact_s(waiting) == pytest.approx(-half_m / 1.0, abs=1e-6)


# The search


DISCS = st.tuples(numbers(0.0, 10.0), numbers(0.0, 3.0), numbers(1e-4, 1.0))


def search_discs(searches, **options):
    """Leftmost points of discs, of each search between two limits."""

    def measure(cells):
        distance = np.full(cells.first_s.shape, np.inf)
        for number, discs in enumerate(searches):
            is_own = cells.search == number
            for first, second, radius in discs:
                away = np.hypot(cells.first_s - first, cells.second_s - second)
                distance[is_own] = np.minimum(distance, away - radius)[is_own]

        moves = np.hypot(cells.half_first_s, cells.half_second_s)
        may_touch = distance <= moves
        return Measures(
            may_touch=may_touch,
            touches=(distance <= 0.0) | (may_touch & (moves <= GRAZING_M)),
            is_cut_along_first=cells.half_first_s >= cells.half_second_s,
        )

    n_searches = len(searches)
    grids = np.meshgrid(np.arange(-2.0, 13.0), np.arange(-2.0, 6.0))
    first, second = (np.tile(grid.ravel(), n_searches) for grid in grids)
    half = np.full(first.shape, 0.5)
    cells = Cells(
        search=np.arange(n_searches).repeat(grids[0].size),
        first_s=first,
        second_s=second,
        half_first_s=half,
        half_second_s=half,
    )
    return find_first_touches(
        cells, measure, n_searches=n_searches, tolerance_s=1e-6, **options
    )


@given(
    st.lists(st.lists(DISCS, max_size=5), min_size=1, max_size=3),
    st.sampled_from([2, 8, 64]),
)
def test_search_finds_the_leftmost_point_of_discs_however_small(searches, n_parts):
    """Contact sets in, vanishes and sets in again: the first of all counts."""
    safe_s, touch_s = search_discs(searches, n_parts=n_parts)

    assert safe_s.shape == touch_s.shape == (len(searches),)
    for number, discs in enumerate(searches):
        if not discs:
            assert safe_s[number] == touch_s[number] == np.inf
            continue
        leftmost = min(first - radius for first, _, radius in discs)
        assert safe_s[number] <= leftmost + 1e-12
        assert leftmost - 2.0 * GRAZING_M <= touch_s[number] <= safe_s[number] + 1e-6


@given(st.lists(st.lists(DISCS, max_size=5), min_size=2, max_size=3))
def test_searches_side_by_side_find_what_each_finds_alone(searches):
    together = np.array(search_discs(searches))
    one_by_one = [np.array(search_discs([discs])) for discs in searches]

    assert together.tolist() == np.concatenate(one_by_one, axis=1).tolist()


def test_search_divides_the_earliest_of_many_cells_first(monkeypatch):
    """Cells that wait for their turn are not forgotten."""
    discs = [(4.0, 1.0, 0.5), (9.0, 2.0, 0.3)]
    at_once = np.array(search_discs([discs, discs[1:]]))
    monkeypatch.setattr("scenarios.encounters._N_TOGETHER", 3)

    in_turn = np.array(search_discs([discs, discs[1:]]))

    assert in_turn == pytest.approx(at_once, abs=1e-6)
