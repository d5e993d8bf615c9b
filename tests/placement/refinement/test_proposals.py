"""Poses that refinement proposes: in their ranges, and not in walls."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import numbers
from tiny_worlds import unit_at

from geometry.catalogue import pick_sensor
from geometry.study_scene import load_study_scene
from placement import refinement
from placement.candidates import CandidateGrid, build_candidates
from placement.optimiser import Limits
from placement.refinement import build_places, moved


def _limits(candidates, **fields):
    """Limits with one unit at each site."""
    sites = sorted({candidate.site_id or candidate.id for candidate in candidates})
    site_capacity = np.ones(len(sites), dtype=int)
    return Limits(
        site_index=[sites.index(c.site_id or c.id) for c in candidates],
        site_capacity=site_capacity,
        budget_units=1,
        **fields,
    )


@pytest.fixture(scope="module")
def places(meadow, meadow_grid):
    """Where the grid's poses may move."""
    return build_places(meadow.scene, meadow_grid, _limits(meadow_grid))


@given(
    st.integers(0, 15),
    numbers(-50.0, 50.0),
    numbers(-900.0, 900.0),
    numbers(-200.0, 200.0),
)
def test_a_moved_pose_is_at_its_place_and_within_all_ranges(
    places, origin, height_m, yaw_deg, pitch_deg
):
    pose = moved(
        places,
        origin,
        height_m=height_m,
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
    )
    grid = places.candidates[origin]

    assert pose.site_id == grid.site_id
    assert pose.sensor == grid.sensor
    assert np.array_equal(pose.pose.position_m[:2], grid.pose.position_m[:2])
    assert pose.pose.position_m[2] == pytest.approx(
        np.clip(height_m, 4.0, 8.0), abs=0.0051
    )
    assert 4.0 <= pose.pose.position_m[2] <= 8.0
    assert -180.0 < pose.pose.yaw_deg <= 180.0
    assert abs((pose.pose.yaw_deg - yaw_deg + 180.0) % 360.0 - 180.0) <= 0.0051
    assert pose.pose.pitch_deg == pytest.approx(
        np.clip(pitch_deg, -90.0, 90.0), abs=0.0051
    )


def test_a_pose_of_the_grid_keeps_its_name(places):
    for origin, candidate in enumerate(places.candidates):
        pose = candidate.pose

        same = moved(
            places,
            origin,
            height_m=pose.position_m[2],
            yaw_deg=pose.yaw_deg,
            pitch_deg=pose.pitch_deg,
        )

        assert same.id == candidate.id
        assert np.array_equal(same.pose.position_m, pose.position_m)


def test_a_pose_of_no_site_stays_at_its_height(meadow, narrow_camera):
    drone = unit_at(
        "drone",
        [3.0, 4.0, 30.0],
        pitch_deg=-80.0,
        sensor=narrow_camera,
    )
    places = build_places(meadow.scene, [drone], _limits([drone]))

    pose = moved(
        places,
        0,
        height_m=20.0,
        yaw_deg=10.0,
        pitch_deg=-70.0,
    )

    assert pose.pose.position_m.tolist() == [3.0, 4.0, 30.0]
    assert pose.id == "drone/30m/10/-70/narrow"


def test_a_pose_that_hangs_outside_of_its_sites_range_may_stay_there(
    meadow, narrow_camera
):
    """An existing unit, 9 m up and half a metre beside a pole for 4 to 8 m."""
    high = unit_at(
        "RSU9",
        [0.5, 0.0, 9.0],
        pitch_deg=-10.0,
        site_id="west",
        sensor=narrow_camera,
    )

    places = build_places(meadow.scene, [high], _limits([high]))

    assert places.height_range_m(0) == (4.0, 9.0)

    pose = moved(
        places,
        0,
        height_m=12.0,
        yaw_deg=0.0,
        pitch_deg=-10.0,
    )

    assert pose.pose.position_m.tolist() == [0.5, 0.0, 9.0]
    assert pose.id == "RSU9/9m/0/-10/narrow"


def test_nothing_is_moved_into_a_wall(narrow_camera):
    scene = load_study_scene()
    wall = next(
        index
        for index, item in enumerate(scene.instances)
        if item.class_name == "building"
    )
    corners = scene.vertices_m[
        scene.triangles[scene.triangle_instance == wall]
    ].reshape(-1, 3)
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))

    assert corners[:, 2].max() > 4.5

    site = replace(
        scene.sites[0],
        position_m=[*middle[:2], 0.0],
        height_range_m=[4.0, corners[:, 2].max() + 9],
    )
    scene = replace(scene, sites=(site,))
    grid = CandidateGrid(
        heights_m=[corners[:, 2].max() + 5.0],
        yaw_step_deg=360.0,
        pitches_deg=[-15.0],
        sensors=(narrow_camera,),
    )
    candidates = build_candidates(scene, grid)

    places = build_places(scene, candidates, _limits(candidates))

    assert moved(places, 0, height_m=4.1, yaw_deg=0.0, pitch_deg=0.0) is None
    assert moved(places, 0, height_m=1e3, yaw_deg=0.0, pitch_deg=0.0) is not None


def test_a_varifocal_lens_is_set_within_its_range(meadow):
    camera = pick_sensor("varifocal-1080p", "test")
    grid = CandidateGrid(
        heights_m=[5.0],
        yaw_step_deg=360.0,
        pitches_deg=[-15.0],
        sensors=(camera,),
    )
    candidates = build_candidates(meadow.scene, grid)

    places = build_places(meadow.scene, candidates, _limits(candidates))
    pose = {
        "height_m": 5.0,
        "yaw_deg": 0.0,
        "pitch_deg": -15.0,
    }

    for asked, got in (
        (1.0, 26.2),
        (170.0, 89.6),
        (50.123, 50.12),
        (None, 89.6),
    ):
        zoomed = moved(places, 0, **pose, fov_deg=asked)
        assert zoomed.sensor.horizontal_fov_deg == got
        assert zoomed.id.endswith(f"/varifocal-1080p/{got:g}")

    zooms = {
        pose.sensor.horizontal_fov_deg for pose in refinement._turned(zoomed, 0, places)
    }

    assert max(zooms) == 89.6
    assert min(zooms) < 80.0


def test_a_level_ring_is_tilted_and_never_only_turned(meadow):
    ring = pick_sensor("ouster-os1-128", "test")
    grid = CandidateGrid(
        heights_m=[6.0],
        yaw_step_deg=90.0,
        pitches_deg=[-20.0],
        sensors=(ring,),
    )
    candidates = build_candidates(meadow.scene, grid)

    places = build_places(meadow.scene, candidates, _limits(candidates))

    steps = refinement._turned(candidates[0], 0, places)

    assert steps
    assert all(step.pose.pitch_deg != 0.0 for step in steps)

    tilted = replace(candidates[0].pose, pitch_deg=-8.0)
    steps = refinement._turned(
        replace(candidates[0], id="tilted", pose=tilted), 0, places
    )

    # Eight degrees up it is level again: then it is not turned.
    assert [step.pose.yaw_deg for step in steps if step.pose.pitch_deg == 0.0] == [0.0]
    assert any(
        step.pose.yaw_deg != 0.0 and step.pose.pitch_deg == -8.0 for step in steps
    )
