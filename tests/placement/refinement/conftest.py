"""A wide open place with two poles, and people who walk by."""

from dataclasses import replace

import numpy as np
import pytest
from placed_bodies import ahead_of
from tiny_cameras import tiny_camera
from tiny_worlds import run_of_frames, scene_of_boxes, setting_of

from geometry.scene import Site
from placement.candidates import CandidateGrid, build_candidates

N_FRAMES = 40


def _build_scene(*sites):
    """Flat ground and nothing on it; a site from each (id, east, north)."""
    poles = [
        Site(
            id=name,
            position_m=[east, north, 0.0],
            kind="lamp post",
            height_range_m=[4.0, 8.0],
            capacity_units=2,
        )
        for name, east, north in sites
    ]
    return scene_of_boxes(sites=poles)


def _build_walk(name, vru_m, *, last_brake_time_s=-1.0):
    """Someone at the places given, (n, 2); the VUT is far away."""
    vru_poses = np.column_stack([vru_m, np.zeros(len(vru_m))])
    return run_of_frames(
        vru_poses,
        name=name,
        shapes=0,
        last_brake_time_s=last_brake_time_s,
    )


def around_the_pole(radius_m, first_deg, last_deg, n_frames=N_FRAMES):
    """Places on an arc around the origin, (n, 2)."""
    return radius_m * ahead_of(np.linspace(first_deg, last_deg, n_frames))


@pytest.fixture(scope="session")
def arc():
    """Builds walks around the pole."""
    return around_the_pole


@pytest.fixture(scope="session")
def build_meadow():
    """Builds a scene of a pole on a meadow."""
    return _build_scene


@pytest.fixture(scope="session")
def build_walk():
    """Builds a run of somebody who walks."""
    return _build_walk


@pytest.fixture(scope="session")
def narrow_camera():
    """A camera of 640 by 480 pixels that costs 1000 EUR."""
    camera = tiny_camera(640, 480, name="narrow", fov_deg=40.0)
    return replace(camera, price_eur=1000.0)


@pytest.fixture(scope="session")
def build_small_setting():
    """Builds settings of few runs."""
    return setting_of


@pytest.fixture(scope="session")
def meadow(build_meadow, build_walk, build_small_setting):
    """Three walks that no pose of the grid below sees early."""
    scene = build_meadow(("west", 0.0, 0.0), ("east", 34.0, 4.0))
    return build_small_setting(
        scene,
        [
            build_walk("one", around_the_pole(16.0, 75.0, 25.0)),
            build_walk(
                "two", around_the_pole(22.0, 20.0, 68.0), last_brake_time_s=-0.6
            ),
            build_walk(
                "three", around_the_pole(19.0, -30.0, 10.0), last_brake_time_s=-1.4
            ),
        ],
    )


@pytest.fixture(scope="session")
def meadow_grid(meadow, narrow_camera):
    """Eight directions at the pole."""
    grid = CandidateGrid(
        heights_m=[5.0],
        yaw_step_deg=45.0,
        pitches_deg=[-15.0],
        sensors=(narrow_camera,),
    )
    return build_candidates(meadow.scene, grid)
