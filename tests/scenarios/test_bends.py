"""No car drives where no car can: sideways accelerations of runs, and bends of
lanes.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from junctions import LANE_M, MOUTH_M, build_scene, protocol_scene, turned
from oracles import distance_to_chain_m
from scenario_lanes import arm_lanes, build_lane, exchanged

from scenarios.bends import find_sharp_bends
from scenarios.courses import follow_gently, follow_lane
from scenarios.staging import lateral_mps2, load_way_rules


def with_corner(angle_deg, *, before_m=40.0):
    """The protocol's junction; the lane from the west has a corner some metres before
    its mouth.
    """
    mouth = np.array([-MOUTH_M, -0.5 * LANE_M])
    corner = mouth - [before_m, 0.0]
    begin = corner - turned([150.0, 0.0], angle_deg)
    lane = build_lane("west-in-0", [begin, corner, mouth])
    return build_scene(exchanged(arm_lanes(), lane)), lane


@pytest.mark.parametrize("angle_deg", [-150.0, 25.0, 60.0])
def test_a_corner_is_driven_no_faster_than_it_can_be(lay, vut, angle_deg):
    """4 m/s^2 to the side at most; faster runs are refused with the speed allowed."""
    scene, lane = with_corner(angle_deg)
    speeds = (20.0, 30.0, 60.0)
    runs, refusals = lay(
        scene,
        ["CBLA-50"],
        speeds_kmh=speeds,
        approaches=["west"],
    )

    n_refused = sum(len(one.speeds_kmh) for one in refusals)

    assert len(runs) + n_refused == len(speeds)
    # 60 km/h is too fast.
    assert refusals

    for run in runs:
        aside_mps2 = lateral_mps2(run.encounter.vut_motion, run.encounter.vut)
        assert aside_mps2 <= load_way_rules().max_lateral_mps2

        # As seen from outside, by the body's turning from frame to frame.
        yaw = np.unwrap(np.radians(run.vut_yaw_deg))
        turning = np.abs(np.diff(yaw)) * 10.0

        assert turning.max() * run.vut_speed_kmh / 3.6 < 4.4

        ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        front = run.vut_position_m + vut.front_axle_ahead_m * ahead
        mapped = front[front[:, 0] > -60.0]

        off_m = distance_to_chain_m(mapped, lane.centreline_m)

        assert off_m.max() < 0.7

    for one in refusals:
        assert one.reason.startswith("the lanes curve")
        assert not one.is_possible
        allowed_kmh = float(one.reason.rsplit(" ", 3)[1])
        assert min(one.speeds_kmh) >= allowed_kmh


def test_kinks_that_a_car_takes_within_its_lane_cost_no_run(lay):
    scene, _ = with_corner(10.0)
    speeds = (25.0, 60.0)
    runs, refusals = lay(
        scene,
        ["CBLA-50"],
        speeds_kmh=speeds,
        approaches=["west"],
    )

    assert len(runs) == 2
    assert not refusals


@pytest.mark.long
@given(angle_deg=st.floats(-30.0, 30.0), free_m=st.floats(0.1, 0.6))
def test_a_gentle_course_bends_less_and_stays_as_near_as_it_must(angle_deg, free_m):
    corner = np.array([80.0, 0.0])
    end = corner + turned(corner, angle_deg)
    chain = np.array([[0.0, 0.0], corner, end])
    gentle = follow_gently([chain], [free_m], origin=1)
    x = gentle.points_m[:, 0]
    points = gentle.points_m[(x > 0.0) & (x < 145.0)]

    # Samples lie 0.5 m apart.
    off_m = distance_to_chain_m(points[::50], chain)

    assert off_m.max() <= free_m + 0.07

    if abs(angle_deg) > 1.0 and free_m > 0.3:
        exact = follow_lane(chain, is_in=True)
        assert gentle.max_bend_per_m <= exact.max_bend_per_m


@pytest.mark.long
def test_sharp_bends_of_a_scene_are_found_with_the_speed_that_they_allow():
    gentle, _ = with_corner(10.0)
    sharp, _ = with_corner(60.0)

    assert not list(find_sharp_bends(protocol_scene()))
    assert not list(find_sharp_bends(gentle))

    (finding,) = find_sharp_bends(sharp)
    assert finding.level == "warning"
    assert finding.what == "arm west"
    assert finding.why.startswith("lane west-in-0 bends 4")

    told = "m from the junction: a lateral acceleration of 4 m/s^2 allows 1"
    assert told in finding.why
