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
    find_first_touch,
    first_contact_s,
)
from scenarios.paths import Motion, StraightPath, TurnPath


def _later(encounter, vut_s, vru_s):
    return replace(
        encounter,
        **{
            name: replace(motion, start_time_s=motion.start_time_s + delay_s)
            for name, motion, delay_s in (
                ("vut_motion", encounter.vut_motion, vut_s),
                ("vru_motion", encounter.vru_motion, vru_s),
            )
        },
    )


def _set_off_together(encounter):
    """The VRU waits at the place that it had reached when the VUT set off."""
    vru = encounter.vru_motion
    start_s = encounter.vut_motion.start_time_s
    path = replace(vru.path, start_m=vru.path.at(vru.distance_m(start_s))[0])
    motion = replace(vru, path=path, start_time_s=start_s)
    return replace(encounter, vru_motion=motion)


together = encounters().map(
    _set_off_together
)  # else a cyclist might ride through the waiting VUT


def _moving(start_m, yaw_deg, speed_mps, start_time_s=0.0):
    return Motion(
        path=StraightPath(start_m=start_m, yaw_deg=yaw_deg),
        speed_mps=speed_mps,
        start_time_s=start_time_s,
    )


def _turning():
    path = TurnPath(
        start_m=[0.0, 0.0],
        yaw_deg=0.0,
        straight_m=5.0,
        turn=pick_turn("far", 15.0),
        wheelbase_m=2.85,
        front_axle_ahead_m=1.45,
    )
    return Encounter(
        vut=load_actors()["vut"],
        vut_motion=Motion(path=path, speed_mps=15.0 / 3.6, start_time_s=0.0),
        vru=load_actors()["adult"],
        vru_motion=Motion(
            path=StraightPath(start_m=[15.5, 9.0], yaw_deg=0.0),
            speed_mps=1.4,
            start_time_s=0.5,
            acceleration_distance_m=1.0,
        ),
    )


# Encounter


def test_separation_is_that_of_the_bodies_corners():
    encounter = _turning()
    vut_distance = np.linspace(0.0, 30.0, 7)[:, None]
    vru_distance = np.linspace(0.0, 9.0, 5)
    separation = encounter.separation_m(vut_distance, vru_distance)
    assert separation.shape == (7, 5)
    corners = [
        footprint_corners(
            *motion.path.at(distance), length_m=body.length_m, width_m=body.width_m
        )
        for body, motion, distance in (
            (encounter.vut, encounter.vut_motion, vut_distance),
            (encounter.vru, encounter.vru_motion, vru_distance),
        )
    ]
    assert separation == pytest.approx(footprint_separation(*corners), abs=1e-9)


@given(
    numbers(1.0, 9.0),
    numbers(1.0, 9.0),
    numbers(0.001, 0.2),
    st.sampled_from([0.0, 0.3]),
)
def test_between_two_looks_gaps_sag_no_deeper_than_declared(
    middle_s, onset_s, half_s, build_up_s
):
    encounter = _turning()
    vut = encounter.vut_motion
    vru = encounter.vru_motion
    rule = replace(load_aeb_rule(), build_up_s=build_up_s)
    speed = encounter.vut_reach * vut.speed_mps + encounter.vru_reach * vru.speed_mps
    half_s = min(half_s, encounter.small_m / speed)
    time = middle_s + half_s * np.linspace(-1.0, 1.0, 201)
    driven = vut.distance_m(np.minimum(time, onset_s)) + braking_distance_m(
        np.maximum(time - onset_s, 0.0), speed_mps=vut.speed_mps, rule=rule
    )
    gaps = encounter.gaps_m(driven, vru.distance_m(time))
    separation = gaps.max(axis=0)
    if separation[0] <= encounter.near_m:
        ends = gaps[:, [0, -1]].min(axis=1).max()
        sag_m = 0.5 * encounter.max_gap_bend_mps2(rule.deceleration_mps2) * half_s**2
        # Overlaps may be deeper.
        assert ends - sag_m <= 0.0 or separation.min() >= ends - sag_m - 1e-6


def test_a_vut_that_sets_off_from_rest_is_refused():
    encounter = _turning()
    motion = replace(encounter.vut_motion, acceleration_distance_m=2.0)
    with refused_with(
        "encounter.vut_motion.acceleration_distance_m: got 2.0; "
        "expected 0: the VUT is up to speed when it sets off"
    ):
        replace(encounter, vut_motion=motion)


# First contact


@given(together, numbers(-30.0, 30.0))
def test_bodies_built_to_touch_at_time_0_first_touch_then(encounter, later_s):
    assert first_contact_s(encounter) == pytest.approx(0.0, abs=1e-6)
    assert first_contact_s(_later(encounter, later_s, later_s)) == pytest.approx(
        later_s, abs=1e-6
    )


@given(together, numbers(-0.3, 0.3))
def test_first_contact_is_the_first_of_many_looks(encounter, later_s):
    encounter = _later(encounter, 0.0, later_s)
    time = np.arange(-1.0, 2.0, 1e-4)
    touches = (
        encounter.separation_m(
            encounter.vut_motion.distance_m(time), encounter.vru_motion.distance_m(time)
        )
        <= 0.0
    )
    contact_s = first_contact_s(encounter)
    if touches.any():
        first = int(np.argmax(touches))
        assert time[max(first - 1, 0)] - 1e-6 <= contact_s <= time[first] + 1e-6
    else:
        nearby = contact_s + np.array([0.0, 1e-7])  # a touch between two looks
        assert (
            contact_s > time[-1]
            or (
                encounter.separation_m(
                    encounter.vut_motion.distance_m(nearby),
                    encounter.vru_motion.distance_m(nearby),
                )
                <= 1e-6
            ).any()
        )


def test_first_contact_on_a_turn_is_the_first_of_many_looks():
    encounter = _turning()
    time = np.arange(0.0, 12.0, 1e-4)
    separation = encounter.separation_m(
        encounter.vut_motion.distance_m(time), encounter.vru_motion.distance_m(time)
    )
    assert first_contact_s(encounter) == pytest.approx(
        time[np.argmax(separation <= 0.0)], abs=1e-4
    )


def test_a_short_touch_of_two_corners_is_not_overlooked():
    # Crossing at right angles; the VRU's rear corner passes the VUT's front corner 1
    # micrometre inside.
    actors = load_actors()
    vut = actors["vut"]
    vru = actors["adult"]
    v = 15.0
    u = 3.0
    depth_m = 1e-6
    leaves_s = 100.0 / v
    start_m = [
        100.0 + 0.5 * vut.length_m + 0.5 * vru.width_m,
        0.5 * vut.width_m + 0.5 * vru.length_m - u * leaves_s,
    ]

    def encounter(inside_m):
        return Encounter(
            vut=vut,
            vut_motion=_moving([0.0, 0.0], 0.0, v),
            vru=vru,
            vru_motion=_moving(np.subtract(start_m, [0.0, inside_m]), 90.0, u),
        )

    assert first_contact_s(encounter(depth_m)) == pytest.approx(leaves_s, abs=1e-6)
    assert first_contact_s(encounter(-depth_m)) == np.inf


@pytest.mark.parametrize(
    ("yaw_deg", "speed_mps"),
    [(0.0, 5.0), (90.0, 5.0), (180.0, 0.1)],  # as fast beside it, away, slowly past it
)
def test_bodies_that_never_touch_have_no_first_contact(yaw_deg, speed_mps):
    actors = load_actors()
    encounter = Encounter(
        vut=actors["vut"],
        vut_motion=_moving([0.0, 0.0], 0.0, 5.0),
        vru=actors["cyclist"],
        vru_motion=_moving([0.0, 2.0], yaw_deg, speed_mps),
    )
    assert first_contact_s(encounter) == np.inf


def test_a_late_contact_is_found_and_one_from_the_start_is_at_the_start():
    actors = load_actors()
    vut = actors["vut"]
    vru = actors["adult"]
    length_m = 0.5 * (vut.length_m + vru.length_m)
    slow = Encounter(
        vut=vut,
        vut_motion=_moving([0.0, 0.0], 0.0, 2.1),
        vru=vru,
        vru_motion=_moving([length_m + 40.0, 0.0], 0.0, 2.0),
    )
    assert first_contact_s(slow) == pytest.approx(400.0, abs=1e-6)
    at_once = replace(slow, vru_motion=_moving([1.0, 0.0], 0.0, 2.0, start_time_s=-7.0))
    assert first_contact_s(at_once) == pytest.approx(-7.0, abs=1e-6)


def test_a_contact_before_the_later_one_sets_off_counts():
    encounter = build_encounter(
        vru=load_actors()["adult"],
        vut_speed_mps=10.0,
        vru_speed_mps=1.0,
        angle_deg=90.0,
        touch=0.0,
        vut_drive_s=8.0,
    )
    # The VRU walks over the line while the VUT still stands there.
    parked = replace(encounter.vut_motion, start_time_s=50.0)
    path = replace(parked.path, start_m=parked.path.at(80.0)[0] + [2.0, 0.0])
    met = replace(encounter, vut_motion=replace(parked, path=path))
    assert first_contact_s(met) == pytest.approx(
        -0.5 * (encounter.vut.width_m + encounter.vru.length_m) / 1.0, abs=1e-6
    )


# The search


@given(
    st.lists(
        st.tuples(numbers(0.0, 10.0), numbers(0.0, 3.0), numbers(1e-4, 1.0)),
        min_size=0,
        max_size=5,
    )
)
def test_search_finds_the_leftmost_point_of_discs_however_small(discs):
    """Contact sets in, vanishes and sets in again: the first of all counts."""

    def measure(cells: Cells) -> Measures:
        distance = np.full(cells.first_s.shape, np.inf)
        for first, second, radius in discs:
            away = np.hypot(cells.first_s - first, cells.second_s - second) - radius
            distance = np.minimum(distance, away)
        moves = np.hypot(cells.half_first_s, cells.half_second_s)
        may_touch = distance <= moves
        return Measures(
            may_touch=may_touch,
            touches=(distance <= 0.0) | (may_touch & (moves <= GRAZING_M)),
            is_cut_along_first=cells.half_first_s >= cells.half_second_s,
        )

    first, second = (
        grid.ravel() for grid in np.meshgrid(np.arange(-2.0, 13.0), np.arange(-2, 6))
    )
    half = np.full(first.shape, 0.5)
    cells = Cells(
        first_s=first, second_s=second * 1.0, half_first_s=half, half_second_s=half
    )
    safe_s, touch_s = find_first_touch(cells, measure, tolerance_s=1e-6)
    if not discs:
        assert safe_s == touch_s == np.inf
    else:
        leftmost = min(first - radius for first, _, radius in discs)
        assert safe_s <= leftmost + 1e-12
        assert leftmost - 2.0 * GRAZING_M <= touch_s <= safe_s + 1e-6
