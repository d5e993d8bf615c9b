from dataclasses import replace

import numpy as np
import pytest

from geometry.errors import InputError
from geometry.scene_files import load_study_scene
from placement import planning
from placement.candidates import CandidatePose, load_candidate_grid
from placement.layout import Layout
from placement.planning import build_plan
from placement.question import Question


@pytest.fixture
def coarse(monkeypatch):
    grid = replace(
        load_candidate_grid(),
        heights_m=np.array([6.0]),
        yaw_step_deg=90.0,
        pitches_deg=np.array([-20.0]),
    )
    monkeypatch.setattr(planning, "load_candidate_grid", lambda: grid)


@pytest.fixture
def study(coarse):
    """A layout of the study's junction, off the grid."""
    scene = load_study_scene()
    (one, *_) = build_plan(Question(budget=1), scene).candidates
    turned = replace(one.pose, yaw_deg=one.pose.yaw_deg + 1.0)
    return Layout(
        name="study", units=(replace(one, id="mine", pose=turned),), scene_name=scene.name
    )


def ids(question, scene, **options):
    return {candidate.id for candidate in build_plan(question, scene, **options).candidates}


def test_the_studys_poses_are_candidates_at_its_own_junction(study):
    scene, question = load_study_scene(), Question(budget=1)
    grid = ids(question, scene)
    assert ids(question, scene, study=study) - grid == {"mine"}
    elsewhere = replace(scene, name="elsewhere")
    assert ids(question, elsewhere, study=study) == ids(question, elsewhere) == grid


def test_a_layout_is_kept_or_chosen_within_by_name(study):
    scene = load_study_scene()
    plan = build_plan(Question(budget=1, keep="carlancap-12"), scene, study=study)
    assert plan.kept is study
    assert plan.wishes.kept == ("mine",)
    assert ids(Question(budget=1, within="carlancap-12"), scene, study=study) == {"mine"}
    with pytest.raises(InputError, match="--budget: got 2; expected at most 1, the units of --w"):
        build_plan(Question(budget=2, within="carlancap-12"), scene, study=study)
    with pytest.raises(InputError, match="--keep: got 'carlancap-12'; expected carlancap-12, or"):
        build_plan(Question(budget=1, keep="carlancap-12"), scene)


def test_every_sensor_asked_for_is_tried_at_every_pose(coarse):
    def poses(sensors):
        found: dict[str, set[tuple[float, ...]]] = {}
        plan = build_plan(Question(budget=1, sensors=sensors), load_study_scene())
        for pose in plan.candidates:
            found.setdefault(pose.sensor.name, set()).add(_place(pose))
        return found

    names = ["carla-ncap-lidar", "carla-ncap-rgb"]
    default, lidars, both = map(poses, ("", names[0], "carla-ncap-rgb, carla-ncap-lidar"))
    assert [sorted(found) for found in (default, lidars, both)] == [names[1:], names[:1], names]
    assert both == default | lidars
    with pytest.raises(InputError, match=r"--sensors: got .radar.; expected one of .*carla-ncap-"):
        poses("radar")


def _place(candidate: CandidatePose) -> tuple[float, ...]:
    return (*candidate.pose.position_m.tolist(), candidate.pose.yaw_deg)
