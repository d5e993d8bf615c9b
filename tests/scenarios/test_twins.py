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


def corners_of_vru(run):
    """Corners of who is met, frame by frame."""
    return corners(run.encounter.vru, run.vru_position_m, run.vru_yaw_deg)


@pytest.mark.long
def test_no_twin_comes_nearer_than_the_clearance_to_where_the_car_ever_is(twins):
    """The car's way is looked at every 0.3 m, also far behind the impact."""
    for twin in twins:
        run = twin.run
        motion = run.encounter.vut_motion
        begin_m = motion.distance_m(run.time_s[0])
        along_m = begin_m + np.arange(0.0, 120.0, 0.3)
        position_m, yaw_deg = motion.path.at(along_m)
        car = corners(run.encounter.vut, position_m, yaw_deg)
        user = corners_of_vru(run)
        gaps_m = footprint_separation(car[:, None], user[None])

        assert gaps_m.min() >= RULE.clearance_m - 0.02, (run.id, twin.kind)


def test_who_crosses_stops_or_turns_off_and_who_rides_ahead_moves_aside(
    twins, crossing_runs
):
    kinds = {(twin.run.case.family, twin.kind) for twin in twins}
    expected = {("CBNA", "stops"), ("CBNA", "turns off"), ("CBLA", "aside")}

    assert expected <= kinds

    ahead = {kind for family, kind in kinds if family == "CBLA"}
    have_twins = {twin.of_run for twin in twins}

    assert ahead == {"aside"}
    assert len(have_twins) == len(crossing_runs)


def test_who_stops_slows_down_as_the_rule_says_and_stands_at_the_clearance(twins):
    """By differences of places from frame to frame."""
    stopping = [twin.run for twin in twins if twin.kind == "stops"]
    assert stopping

    for run in stopping:
        step_s = np.diff(run.time_s).mean()
        steps_m = np.diff(run.vru_position_m, axis=0)
        speed = np.linalg.norm(steps_m, axis=-1) / step_s
        slowing = -np.diff(speed) / step_s

        assert slowing.max() <= RULE.stop_mps2 + 1e-6

        # It could still stop where it has to: nobody is nearer than that.
        own_mps = run.encounter.vru_motion.speed_mps
        assert speed[-1] < 0.75 * own_mps


def test_bodies_occluders_and_the_car_stay_as_they_are(twins, crossing_runs):
    """They are the same objects, not equal ones."""
    for twin in twins:
        run = crossing_runs[twin.of_run]
        assert twin.run.obstruction is run.obstruction
        assert twin.run.encounter is run.encounter
        np.testing.assert_array_equal(twin.run.vut_position_m, run.vut_position_m)
        assert len(twin.run.vru_position_m) == len(run.time_s)


def test_nobody_walks_through_what_is_parked(twins):
    """Whoever gets out of the way takes none that is occupied."""
    hidden = [twin.run for twin in twins if twin.run.obstruction]
    assert hidden

    for run in hidden:
        user = corners_of_vru(run)
        for parked in run.obstruction:
            pose = parked.pose
            there = corners(parked.actor, pose.position_m[:2], pose.yaw_deg)
            gaps_m = footprint_separation(user, there)
            assert gaps_m.min() > 0.0
