"""The VUT's own sensors where the road is not level."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from placed_bodies import ahead_of, poses_within
from ray_renderer import render_frame

from geometry.scene import Instance
from geometry.terrain import GROUND, Terrain, pitch_on_ground_deg, terrain_of
from placement.evaluator.perceive import perceive_frames, scan_frames
from placement.evaluator.pictures import vut_camera_pose
from placement.evaluator.surroundings import (
    VutCamera,
    build_surroundings,
    load_vut_camera,
    load_vut_lidar,
)

LINE = np.linspace(-120.0, 120.0, 25)


def terrain(height):
    """Terrain whose height is a function of east and north. [m]"""
    east, north = np.meshgrid(LINE, LINE)
    height_m = height(east, north)
    return Terrain(east_m=LINE, north_m=LINE, height_m=height_m)


def on(scene, ground):
    """The scene with a ground, and what it has there."""
    vertices, triangles = ground.mesh()
    return replace(
        scene,
        vertices_m=np.concatenate([scene.vertices_m, vertices]),
        triangles=np.concatenate([scene.triangles, triangles + len(scene.vertices_m)]),
        triangle_instance=np.concatenate(
            [scene.triangle_instance, np.full(len(triangles), len(scene.instances))]
        ),
        instances=(*scene.instances, Instance(id=GROUND, class_name=GROUND)),
    )


MOUNTED = {"ahead_per_half_length": 0.8, "up_per_half_height": 1.3}
"""Where the VUT's camera is."""


@given(grade=st.floats(-0.3, 0.3), yaw_deg=st.floats(-180.0, 180.0))
def test_on_a_plane_the_pitch_is_the_grade_along_the_heading(grade, yaw_deg):
    slope = terrain(lambda east, north: grade * east)

    pitch_deg = pitch_on_ground_deg(
        [[3.0, -7.0]],
        [yaw_deg],
        slope,
        front_m=1.4,
        wheelbase_m=2.9,
    )
    yaw = np.radians(yaw_deg)
    ahead = np.cos(yaw)
    along = grade * ahead
    pitch = np.radians(pitch_deg)

    assert np.tan(pitch) == pytest.approx(along)


def test_over_a_crest_the_pitch_is_that_of_the_chord_between_the_axles():
    crest = terrain(lambda east, north: -0.1 * np.abs(east))

    pitch_deg = pitch_on_ground_deg(
        [
            [-1.0, 0.0],
            [0.0, 0.0],
            [2.0, 0.0],
        ],
        [0.0] * 3,
        crest,
        front_m=1.5,
        wheelbase_m=3.0,
    )
    pitch = np.radians(pitch_deg)

    # Front axles at 0.5, 1.5 and 3.5 m, rear ones at -2.5, -1.5 and 0.5 m.
    assert np.tan(pitch) == pytest.approx([0.2 / 3.0, 0.0, -0.1])

    flat = pitch_on_ground_deg(
        [[1.0, 2.0]],
        [30.0],
        None,
        front_m=1.5,
        wheelbase_m=3.0,
    )

    assert flat.tolist() == [0.0]


@pytest.mark.parametrize("grade", [-0.12, 0.0, 0.12])
def test_on_a_slope_whoever_is_ahead_is_seen_at_the_row_of_the_level_road(
    build_scene, build_run, camera, block, grade
):
    slope = terrain(lambda east, north: grade * east)
    level = build_run(block, [[12.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]])
    run = replace(level, terrain=slope)
    scene = on(build_scene(), slope)
    surroundings = build_surroundings(scene, [run])
    mount = VutCamera(camera=camera, **MOUNTED)

    evidence = perceive_frames(surroundings, mount)
    (box,) = evidence.amodal_px

    pose = mount.pose_on(run.encounter.vut)
    ahead_m, _, up_m = pose.position_m
    # Turned with the road, the foot of the body's middle is as low as the road, 12 m /
    # cos away.
    pitch = np.arctan(grade)
    cos = np.cos(pitch)
    sin = np.sin(pitch)
    turn = np.array([[cos, sin], [-sin, cos]])
    corners = np.array(
        [
            [-0.25, 0.0],
            [-0.25, 1.8],
            [0.25, 0.0],
            [0.25, 1.8],
        ]
    )
    offset_m = [12.0 / cos - ahead_m, -up_m]
    turned_m = corners @ turn.T + offset_m
    away_m, above_m = turned_m.T
    rows = 90.0 - camera.focal_length_px * above_m / away_m
    top_px = rows.min()
    bottom_px = rows.max()
    sides_px = box[[0, 2]]

    assert box[1] == pytest.approx(top_px, abs=1.0)
    assert box[3] == pytest.approx(bottom_px, abs=1.0)
    assert sides_px.mean() == pytest.approx(160.0, abs=1.0)


@pytest.mark.long
def test_boxes_on_hills_equal_the_plain_render_from_where_the_camera_is_and_looks(
    build_scene, build_run, camera, block
):
    rng = default_rng(5)
    hills = terrain(
        lambda east, north: 3.0 * np.sin(east / 15.0) + 2.0 * np.cos(north / 12.0)
    )
    vut = poses_within(rng, 40, 30.0)
    drawn_m = rng.uniform(6.0, 15.0, (40, 1))
    ahead = ahead_of(vut[:, 2])
    ahead_m = drawn_m * ahead
    place_m = vut[:, :2] + ahead_m
    yaw_deg = vut[:, 2] + 40.0
    vru = np.column_stack([place_m, yaw_deg])
    level = build_run(block, vru, vut)
    run = replace(level, terrain=hills)

    flat = build_scene(((-6.0, 3.0, -9.0), (-2.0, 6.0, 4.0)))
    scene = on(flat, hills)

    assert terrain_of(scene) is not None

    surroundings = build_surroundings(scene, [run])
    mount = VutCamera(camera=camera, **MOUNTED)

    boxes = perceive_frames(surroundings, mount)
    pitches_deg = []
    n_hidden = 0
    for frame in range(40):
        pose = vut_camera_pose(mount, run, frame)
        pitches_deg.append(pose.pitch_deg)
        view = render_frame(
            surroundings,
            frame,
            pose,
            camera,
            with_vut=False,
        )
        amodal_off = boxes.amodal_px[frame] - view.amodal_box_px
        visible_off = boxes.visible_px[frame] - view.visible_box_px

        assert np.abs(amodal_off).max() <= 1.0
        assert np.abs(visible_off).max() <= 1.0

        n_hidden += (view.visible_box_px != view.amodal_box_px).any()

    assert np.ptp(pitches_deg) > 10.0
    assert n_hidden


def test_the_vuts_lidar_tilts_with_the_road(build_scene, build_run, block):
    slope = terrain(lambda east, north: 0.5 * east)  # so steep that level beams miss
    vru = [
        [14.0, 0.0, 0.0],
        [-14.0, 0.0, 0.0],
        [2.0, 14.0, 0.0],
    ]
    level_run = build_run(block, vru, [[0.0, 0.0, 0.0]] * 3)
    run = replace(level_run, terrain=slope)
    scene = on(build_scene(), slope)
    surroundings = build_surroundings(scene, [run])

    def found(around):
        rng = default_rng(0)
        is_found = scan_frames(
            around,
            load_vut_camera(),
            load_vut_lidar(),
            rng,
        )
        return is_found.tolist()

    assert found(surroundings) == [True, False, False]

    no_pitch = np.zeros(3)
    level = replace(surroundings, vut_pitch_deg=no_pitch)

    assert found(level) == [False, False, False]
