"""Tiny worlds: boxes for buildings, a block for the VRU, runs given frame by frame."""

from functools import partial

import pytest
from tiny_cameras import tiny_camera
from tiny_worlds import block_actor, run_of_frames, scene_of_boxes, setting_of

from geometry.actors import pick_actor
from geometry.study_scene import load_study_scene
from placement.detectors.geometric import GeometricDetector
from scenarios.aeb import load_aeb_rule
from scenarios.cases import select_cases
from scenarios.runs import build_runs


@pytest.fixture(scope="session")
def block():
    """A body that is a box."""
    return block_actor()


@pytest.fixture(scope="session")
def vut():
    """The study's VUT."""
    return pick_actor("vut", "test")


@pytest.fixture(scope="session")
def camera():
    """A small camera: few pixels to cast."""
    return tiny_camera(320, 180)


@pytest.fixture(scope="session")
def build_scene():
    """Boxes without ground."""
    return partial(scene_of_boxes, ground_m=0.0)


@pytest.fixture(scope="session")
def build_run():
    """Frames as given; the VRU runs through its shapes, one per frame."""

    def build(vru, vru_poses, vut_poses=None, obstruction=()):
        return run_of_frames(
            vru_poses,
            vut_poses,
            vru=vru,
            obstruction=obstruction,
        )

    return build


@pytest.fixture(scope="session")
def build_setting():
    """Runs that count alike, a detector that asks for little, no radio that fails."""
    detector = GeometricDetector(min_iou=0.5, min_box_height_px=10.0)
    return partial(setting_of, detector=detector, table_detector=detector)


@pytest.fixture(scope="session")
def study_runs(vut):
    """Three runs of the study's cases from one approach each, at two speeds."""
    runs = []
    for name, approach in (
        ("CPNC-50", "north"),
        ("CBNA", "east"),
        ("CBLA", "south"),
    ):
        cases = select_cases(name, speeds="30,60").cases
        some, _ = build_runs(
            load_study_scene(),
            cases,
            vut=vut,
            rule=load_aeb_rule(),
            approaches=[approach],
        )
        runs += some

    return tuple(runs)
