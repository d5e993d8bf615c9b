"""A floor, a wall, a lamp post: scenes whose light can be worked out by hand."""

import pytest
from tiny_cameras import tiny_camera
from tiny_worlds import scene_of_boxes

from geometry.actors import pick_actor
from geometry.study_scene import load_study_scene
from geometry.weather import load_weathers
from placement.imaging import build_backdrop
from scenarios.aeb import load_aeb_rule
from scenarios.cases import select_cases
from scenarios.runs import build_runs


@pytest.fixture(scope="session")
def day():
    """Clear weather by day."""
    return load_weathers()["day"]


@pytest.fixture(scope="session")
def small():
    """A camera of 240 by 160 pixels."""
    return tiny_camera(240, 160, near_m=0.1)


@pytest.fixture(scope="session")
def build_plain_scene():
    """A level ground and boxes on it: (class name, lowest corner, highest corner)."""

    def build(*boxes, sites=()):
        return scene_of_boxes(
            *((low, high) for _, low, high in boxes),
            ground_m=300.0,
            classes=[class_name for class_name, _, _ in boxes],
            sites=sites,
        )

    return build


@pytest.fixture(scope="session")
def study_run():
    """The study's pedestrian from behind a parked car, at 40 km/h."""
    runs, _ = build_runs(
        load_study_scene(),
        select_cases("CPNC-50", speeds="40").cases,
        vut=pick_actor("vut", "test"),
        rule=load_aeb_rule(),
        approaches=["east"],
    )
    return runs[0]


@pytest.fixture(scope="session")
def backdrop(study_run):
    """What stands still in the study's run."""
    return build_backdrop(load_study_scene(), study_run.obstruction)
