"""Ground that is not flat, in the detection table and in the evaluator."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from placed_bodies import one_mesh, parked_at, parts_of_frame, poses_within

from geometry.actors import MovingActor, pick_actor
from geometry.raycast import build_caster
from geometry.terrain import Terrain, ground_height_m, on_ground, set_down
from placement.detectors import load_planning_detector
from placement.evaluator.perceive import perceive_frames, scan_frames
from placement.evaluator.surroundings import (
    build_surroundings,
    load_vut_camera,
    load_vut_lidar,
)
from placement.visibility.build import build_detection_table
from placement.visibility.casting import build_world, cast_sight

LINES_M = np.arange(-80.0, 81.0, 4.0)
WALL = (
    (3.0, 8.0, 0.0),
    (12.0, 8.3, 1.1),
)
NEAR_M = 0.35
FAR_M = 1000.0


def with_ground(scene, height_of):
    """A scene of boxes on a ground of heights; boxes stand on it by their middles."""
    east, north = np.meshgrid(LINES_M, LINES_M)
    height_m = height_of(east, north)
    terrain = Terrain(east_m=LINES_M, north_m=LINES_M, height_m=height_m)
    vertices, triangles = terrain.mesh()
    solid = scene.triangle_instance > 0
    lifted = scene.vertices_m.copy()
    for index in range(1, len(scene.instances)):
        corners = scene.triangles[scene.triangle_instance == index]
        own = np.unique(corners)
        middle_m = lifted[own, :2].mean(axis=0)
        lifted[own, 2] += terrain.at(middle_m)

    return replace(
        scene,
        vertices_m=np.concatenate([vertices, lifted]),
        triangles=np.concatenate([triangles, scene.triangles[solid] + len(vertices)]),
        triangle_instance=np.concatenate(
            [np.zeros(len(triangles), dtype=int), scene.triangle_instance[solid]]
        ),
    )


def some_runs(build_run, seed, n_frames=12):
    """Random runs of an adult and a cyclist, with a parked car and a driven van."""
    rng = default_rng(seed)
    runs = []
    for name in ("adult", "cyclist"):
        vru = poses_within(rng, n_frames, 25.0)
        vut = poses_within(rng, n_frames, 25.0)
        east_m, north_m = rng.uniform(-20, 20, 2)
        car = parked_at("parked-car-small", east_m, north_m, 30.0)
        driven = poses_within(rng, n_frames, 20.0)
        van = MovingActor(
            actor=pick_actor("parked-van", "test"),
            position_m=driven[:, :2],
            yaw_deg=driven[:, 2],
        )
        run = build_run(
            vru,
            vut,
            vru=name,
            obstruction=(car,),
            name=name,
        )
        with_van = replace(run, traffic=(van,))
        runs.append(with_van)

    return runs


def on(scene, runs):
    """Runs set down on a scene's terrain."""
    return [replace(run, obstruction=set_down(run.obstruction, scene)) for run in runs]


def test_a_lifted_world_looks_as_one_at_zero(
    build_scene, build_run, mount, camera, axis_of
):
    flat = build_scene(WALL)
    high = with_ground(flat, lambda east, north: 0.0 * east + 37.5)
    runs = some_runs(build_run, 3)
    axis = axis_of(runs)
    tables = []
    evidence = []
    scans = []
    own = []
    for scene, up_m in (
        (flat, 0.0),
        (high, 37.5),
    ):
        here = on(scene, runs)
        candidates = [
            mount(
                f"{x}/{yaw}",
                [x, -6.0, 6.0 + up_m],
                yaw_deg=yaw,
                pitch_deg=-15.0,
                camera=camera,
            )
            for x in (-12.0, 14.0)
            for yaw in (0.0, 90.0, 180.0)
        ]
        tables.append(
            build_detection_table(
                scene,
                candidates,
                here,
                axis,
                detector=load_planning_detector(),
            ).packed
        )
        surroundings = build_surroundings(scene, here)
        evidence.append(
            [perceive_frames(surroundings, (c.pose, camera)) for c in candidates]
        )
        seen = perceive_frames(surroundings, load_vut_camera())
        own.append(seen)
        rng = default_rng(0)
        scan = scan_frames(
            surroundings,
            candidates[0].pose,
            load_vut_lidar(),
            rng,
        )
        scans.append(scan)

    assert tables[0].any()
    assert_array_equal(*tables)
    assert_array_equal(*scans)

    for low, lifted in [*zip(*evidence, strict=True), own]:
        assert_allclose(lifted.amodal_px, low.amodal_px, atol=1.0)
        assert_allclose(lifted.visible_px, low.visible_px, atol=1.0)

    assert sum(one.visible_px.any(axis=1).sum() for one in evidence[0]) >= 10


@pytest.mark.long
@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_on_hills_the_table_sees_what_single_rays_reach(build_scene, build_run, seed):
    rng = default_rng(seed)
    a, b = rng.uniform(0.05, 0.2, 2)
    scene = with_ground(
        build_scene(WALL),
        lambda east, north: 2.0 * np.sin(a * east) + 1.5 * np.cos(b * north),
    )
    flat_runs = some_runs(build_run, seed)
    runs = on(scene, flat_runs)
    world = build_world(scene, runs, n_points=40, seed=0)
    place_m = rng.uniform(-20.0, 20.0, 2)
    foot_m = on_ground(place_m, None)
    eye = foot_m + [0.0, 0.0, 5.0]
    eye[2] += ground_height_m(scene, eye[:2])

    sight = cast_sight(world, eye, near_m=NEAR_M, max_distance_m=FAR_M)
    eye_m = eye - world.origin_m
    places = [(run, index) for run in runs for index in range(len(run.time_s))]

    for frame, (run, index) in enumerate(places):
        parts = parts_of_frame(scene, run, index)
        vertices_m, triangles, _ = one_mesh(parts)
        caster = build_caster(vertices_m - world.origin_m, triangles)
        view = world.views.view_of_frame[frame]
        points_m = world.views.points_m[view]
        ways = points_m - eye_m
        distance_m = np.linalg.norm(ways, axis=1)
        length = distance_m[:, None]
        starts = (eye_m + NEAR_M * ways / length).astype(np.float32)
        share = 1.0 - (NEAR_M + 1.0e-3) / length
        vectors = (ways * share).astype(np.float32)
        reached = ~caster.is_blocked(starts, vectors)
        entry = sight.entry_of_frame[frame]
        visible = np.zeros(len(reached), dtype=bool)
        if entry >= 0:
            visible = sight.is_visible[entry]

        # Rays along edges may go either way.
        assert (visible == reached).mean() >= 0.9
