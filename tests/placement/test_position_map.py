"""Errors of reported places, cell by cell."""

import numpy as np
import pytest

from geometry.poses import Pose
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose
from placement.detectors import load_detector
from placement.layout import load_carlancap_layout
from placement.position_map import find_position_map
from placement.positions import aim_sd_deg, camera_errors
from placement.sampling.uncertainty import CALIBRATED
from scenarios.decision import load_decision_rule

SCENE = load_study_scene()
DETECTOR = load_detector()
UNITS = load_carlancap_layout().units


@pytest.fixture(scope="module")
def by_one():
    """The map of one unit."""
    return find_position_map(SCENE, UNITS[:1], DETECTOR)


def test_a_cell_has_the_largest_error_of_the_camera_there(by_one):
    is_seen = np.isfinite(by_one.sd_m[0])
    seen = np.argwhere(is_seen)

    assert len(seen) > 100

    for row, column in seen[:: len(seen) // 7]:
        place_m = [by_one.east_m[column], by_one.north_m[row], 0.0]
        foot_m = np.array([place_m])
        rule = load_decision_rule()

        errors = camera_errors(
            UNITS[0].pose.position_m,
            foot_m,
            np.array([[1.8, 0.5]]),
            rule=rule,
            box_noise_share=rule.box_noise_share,
            aim_sd_deg=aim_sd_deg(CALIBRATED),
        )
        along_of_rows = np.hypot(errors.box_along_m, errors.aim_along_m)
        along_m = along_of_rows[0]
        across_of_rows = np.hypot(errors.box_across_m, errors.aim_across_m)
        across_m = across_of_rows[0]
        expected = max(along_m, across_m)
        found_m = by_one.sd_m[0, row, column]

        # The body's own width is not that of this one.
        assert found_m == pytest.approx(expected, rel=0.02)


def test_better_aims_and_more_cameras_never_know_less(by_one):
    calibrated, by_eye = by_one.sd_m

    assert (calibrated <= by_eye).all()
    assert (calibrated < by_eye).any()

    by_three = find_position_map(SCENE, UNITS[:3], DETECTOR)
    is_no_worse = by_three.sd_m <= by_one.sd_m + 1e-9
    seen_by_three = np.isfinite(by_three.sd_m)
    seen_by_one = np.isfinite(by_one.sd_m)

    assert is_no_worse.all()
    assert seen_by_three.sum() > seen_by_one.sum()


def test_a_camera_that_looks_away_knows_nothing():
    up = Pose(position_m=[0.0, 0.0, 8.0], yaw_deg=0.0, pitch_deg=90.0)
    unit = CandidatePose(
        id="up",
        site_id="",
        pose=up,
        sensor=UNITS[0].sensor,
    )

    found = find_position_map(SCENE, [unit], DETECTOR)
    is_unknown = np.isinf(found.sd_m)

    assert is_unknown.all()
