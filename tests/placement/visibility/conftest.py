"""Tiny worlds: boxes for walls, catalogue bodies, runs given frame by frame."""

import pytest
from short_runs import cut_run
from tiny_cameras import tiny_camera
from tiny_worlds import run_of_frames, scene_of_boxes, unit_at

from geometry.study_scene import load_study_scene
from scenarios.aeb import load_aeb_rule
from scenarios.cases import select_cases
from scenarios.runs import build_frame_axis, build_runs
from scenarios.weights import weight_per_run


@pytest.fixture(scope="session")
def build_scene():
    """Builds scenes of boxes."""
    return scene_of_boxes


@pytest.fixture(scope="session")
def build_run():
    """Builds runs frame by frame."""
    return run_of_frames


@pytest.fixture(scope="session")
def axis_of():
    """Builds the frame axis of runs."""

    def build(runs):
        return build_frame_axis(runs, weight_per_run(runs))

    return build


@pytest.fixture(scope="session")
def small_camera():
    """A camera of 640 by 360 pixels."""
    return tiny_camera(640, 360)


@pytest.fixture(scope="session")
def study_runs(actors):
    """Three cases of the study at two speeds, the last four seconds of each."""
    cases = select_cases("CPNC-50,CBNA,CBLA", speeds="30,60").cases
    runs, _ = build_runs(
        load_study_scene(),
        cases,
        vut=actors["vut"],
        rule=load_aeb_rule(),
    )
    return tuple(cut_run(run, slice(-40, None)) for run in runs)


@pytest.fixture(scope="session")
def mount(small_camera):
    """A candidate pose; a mount of the camera "small" unless told otherwise."""

    def build(name, position_m, *, camera=small_camera, **direction):
        return unit_at(name, position_m, sensor=camera, **direction)

    return build
