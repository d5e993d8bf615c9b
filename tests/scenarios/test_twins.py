"""Twins of runs come near to nobody."""

import numpy as np
import pytest

from geometry.footprints import footprint_corners, footprint_separation
from scenarios.decision import load_decision_rule
from scenarios.twins import build_twins

RULE = load_decision_rule()


@pytest.fixture(scope="module")
def twins(crossing_runs):
    """Twins of runs: the same but for who is met, who gets out of the way."""
    return build_twins(crossing_runs, RULE)


def corners(actor, position_m, yaw_deg):
    """Corners of a body on the ground, at each place."""
    return footprint_corners(
        position_m,
        yaw_deg,
        length_m=actor.length_m,
        width_m=actor.width_m,
    )


@pytest.mark.long
def test_no_twin_comes_nearer_than_the_clearance_to_where_the_car_ever_is(twins):
    for twin in twins:
        run = twin.run
        motion = run.encounter.vut_motion
        along_m = motion.distance_m(run.time_s[0]) + np.arange(0.0, 120.0, 0.3)
        car = corners(run.encounter.vut, *motion.path.at(along_m))
        user = corners(run.encounter.vru, run.vru_position_m, run.vru_yaw_deg)
        gap_m = footprint_separation(car[:, None], user[None]).min()

        assert gap_m >= RULE.clearance_m - 0.02, (run.id, twin.kind)


def test_who_crosses_stops_or_turns_off_and_who_rides_ahead_moves_aside(
    twins, crossing_runs
):
    kinds = {(twin.run.case.family, twin.kind) for twin in twins}
    expected = {("CBNA", "stops"), ("CBNA", "turns off"), ("CBLA", "aside")}

    assert expected <= kinds
    assert {of for name, of in kinds if name == "CBLA"} == {"aside"}
    assert len({twin.of_run for twin in twins}) == len(crossing_runs)


def test_who_stops_slows_down_as_the_rule_says_and_stands_at_the_clearance(twins):
    stopping = [twin.run for twin in twins if twin.kind == "stops"]
    assert stopping
    for run in stopping:
        step_s = np.diff(run.time_s).mean()
        speed = np.linalg.norm(np.diff(run.vru_position_m, axis=0), axis=-1) / step_s
        slowing = -np.diff(speed) / step_s

        assert slowing.max() <= RULE.stop_mps2 + 1e-6

        # It could still stop where it has to: nobody is nearer than that.
        own_mps = run.encounter.vru_motion.speed_mps
        assert speed[-1] < 0.75 * own_mps


def test_bodies_occluders_and_the_car_stay_as_they_are(twins, crossing_runs):
    for twin in twins:
        run = crossing_runs[twin.of_run]
        assert twin.run.obstruction is run.obstruction
        assert twin.run.encounter is run.encounter
        np.testing.assert_array_equal(twin.run.vut_position_m, run.vut_position_m)
        assert len(twin.run.vru_position_m) == len(run.time_s)


def test_nobody_walks_through_what_is_parked(twins):
    hidden = [twin.run for twin in twins if twin.run.obstruction]
    assert hidden
    for run in hidden:
        user = corners(run.encounter.vru, run.vru_position_m, run.vru_yaw_deg)
        for parked in run.obstruction:
            pose = parked.pose
            there = corners(parked.actor, pose.position_m[:2], pose.yaw_deg)
            assert footprint_separation(user, there).min() > 0.0
