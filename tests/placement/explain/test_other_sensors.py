from dataclasses import replace

import numpy as np
import pytest

from geometry.catalogue import load_cameras
from geometry.lidar import load_lidars
from geometry.poses import Pose
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose
from placement.detectors import load_detector, load_planning_detector
from placement.explain.other_sensors import find_other_sensors
from placement.optimiser import apr
from placement.setting import Setting
from placement.visibility import build_detection_table
from placement.wishes import Wishes, build_problem
from scenarios.runs import build_frame_axis
from scenarios.weights import weight_per_run

CAMERAS = load_cameras()
WAYS = ("CBNA/east/60", "CPNC-50/east/55", "CPNC-50/west/60", "CBNA/south/60", "CBLA/east/25")
LONG = CAMERAS["basler-aca1920-50gc-16mm"]


@pytest.fixture(scope="module")
def setting(runs, rule):
    few = tuple(run for run in runs if run.id in WAYS)
    return Setting(
        scene=load_study_scene(),
        runs=few,
        axis=build_frame_axis(few, weight_per_run(few)),
        rule=rule,
        detector=load_detector(),
        table_detector=load_planning_detector(),
    )


def unit(name, x, y, yaw_deg):
    pose = Pose(position_m=np.array([x, y, 6.0]), yaw_deg=yaw_deg, pitch_deg=-30.0)
    return CandidatePose(id=name, site_id="", pose=pose, sensor=CAMERAS["carla-ncap-rgb"])


UNITS = (unit("ne", -113.9, 11.1, 0.0), unit("sw", -138.4, -9.4, -100.0))


def aprs_of(setting, layouts, fusion):
    """APR of each, by the optimiser's own table and arithmetic."""
    poses = [pose for layout in layouts for pose in layout]
    named = [replace(pose, id=f"u{row}") for row, pose in enumerate(poses)]
    table = build_detection_table(
        setting.scene, named, setting.runs, setting.axis, detector=setting.table_detector
    )
    wishes = Wishes(budget_units=len(named))
    problem = build_problem(setting, named, table, wishes=wishes, fusion=fusion)
    return [apr(problem, [2 * number, 2 * number + 1]) for number in range(len(layouts))]


@pytest.mark.parametrize("fusion", ["any", "single"])
def test_other_sensors_prevent_what_the_optimiser_s_table_says(setting, fusion):
    models = [CAMERAS["varifocal-1080p"], LONG, load_lidars()["ouster-os1-128"]]
    found = find_other_sensors(setting, UNITS, models=models, fusion=fusion)
    assert {other.sensor.name for other in found.models} == {model.name for model in models}
    assert len({other.apr_one for other in found.models}) > 1
    said, layouts = [found.apr], [UNITS]
    for other in found.models:
        assert other.one.sensor.name == other.sensor.name
        said += [other.apr_one, other.apr_all, other.apr_not_turned]
        exchanged = [other.one, UNITS[1]] if other.unit_index == 0 else [UNITS[0], other.one]
        hanging = [replace(pose, sensor=other.sensor) for pose in UNITS]
        layouts += [exchanged, other.all, hanging]
        assert other.apr_all >= other.apr_not_turned
    assert said == pytest.approx(aprs_of(setting, layouts, fusion))
    ranked = [other.apr_one for other in found.models]
    assert ranked == sorted(ranked, reverse=True)


def test_units_turn_but_stay_where_they_hang(setting):
    """They do not look up, and what is kept is not exchanged."""
    (other,) = find_other_sensors(setting, UNITS, models=[LONG], kept=("sw",)).models
    assert other.unit_index == 0
    assert [pose.id for pose in other.all] == ["ne"]
    for pose in (other.one, *other.all):
        assert np.array_equal(pose.pose.position_m, UNITS[0].pose.position_m)
        assert abs(pose.pose.yaw_deg - UNITS[0].pose.yaw_deg) <= 45.0
        assert -30.0 <= pose.pose.pitch_deg <= 0.0


def test_poses_that_must_not_look_are_left_out(setting):
    def only_not_turned(poses):
        return np.array([pose.pose.yaw_deg in (0.0, -100.0) for pose in poses])

    (other,) = find_other_sensors(setting, UNITS, models=[LONG], may_look=only_not_turned).models
    assert {pose.pose.yaw_deg for pose in other.all} == {0.0, -100.0}


def test_nothing_is_said_where_nothing_can_be_exchanged(setting):
    own = [UNITS[0].sensor]
    assert find_other_sensors(setting, UNITS, models=own) is None
    assert find_other_sensors(setting, UNITS, models=[LONG], kept=("ne", "sw")) is None
    nowhere = find_other_sensors(
        setting, UNITS, models=[LONG], may_look=lambda poses: np.zeros(len(poses), dtype=bool)
    )
    assert nowhere is None
