"""Detection tables built, against pixels and alone against together."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from placed_bodies import poses_beside, poses_within
from strategies import angles_deg, cameras, numbers, pitches_deg
from tiny_cameras import tiny_camera
from tiny_worlds import WALLS

from geometry.poses import Pose, camera_rotation
from geometry.sensors import project_points
from geometry.study_scene import load_study_scene
from placement.candidates import CandidateGrid, build_candidates
from placement.compute import Compute
from placement.detectors import load_planning_detector
from placement.detectors.geometric import GeometricDetector
from placement.evaluator.perceive import perceive_frames
from placement.evaluator.surroundings import build_surroundings
from placement.visibility import build as build_module
from placement.visibility import build_detection_table
from placement.visibility.build import at_each_mount
from placement.visibility.sensing import max_distance_m

DETECTOR = GeometricDetector(min_iou=0.5, min_box_height_px=15.0)


def _detected(table):
    """Detections of all poses, (n_poses, n_frames)."""
    return table.detected(slice(None))


def _random_world(build_scene, build_run, n_frames=150):
    """A world of walls, and two runs that jump about in it."""
    rng = np.random.default_rng(8)
    vru = poses_within(rng, n_frames, 14.0)
    vut = poses_beside(rng, vru, 3.0, 6.0)
    runs = tuple(
        build_run(vru[part::2], vut[part::2], vru=body, name=body)
        for part, body in enumerate(("adult", "cyclist"))
    )
    return build_scene(*WALLS), runs


@pytest.fixture(scope="module")
def world(build_scene, build_run, axis_of):
    """A random scene with runs, and their axis."""
    scene, runs = _random_world(build_scene, build_run)
    return scene, runs, axis_of(runs)


@pytest.fixture(scope="module")
def candidates(mount, small_camera):
    """Two mount positions, several directions and two camera models, in no order."""
    tele = replace(small_camera, name="tele", horizontal_fov_deg=50.0)
    close = replace(small_camera, name="close", near_m=0.6)
    return [
        mount(
            f"{name}/{x:g}/{yaw:g}",
            [x, -12.0, 6.0],
            yaw_deg=yaw,
            pitch_deg=-20.0,
            camera=camera,
        )
        for yaw in (60.0, 90.0, 150.0, -90.0)
        for name, camera in (
            ("small", small_camera),
            ("tele", tele),
            ("close", close),
        )
        for x in (-10.0, 3.0)
    ]


def _build(world, candidates, **options):
    """The table of candidates in a world: scene, runs and axis."""
    scene, runs, axis = world
    options = {"detector": DETECTOR} | options
    return build_detection_table(
        scene,
        candidates,
        runs,
        axis,
        **options,
    )


@pytest.fixture(scope="module")
def table(world, candidates):
    """The table of the candidates."""
    return _build(world, candidates)


def _agreement(scene, runs, candidates, detector, detected):
    """Share of frames in which pixels say the same as the table."""
    surroundings = build_surroundings(scene, runs)
    shares = []
    for row, candidate in enumerate(candidates):
        mount_and_sensor = (candidate.pose, candidate.sensor)
        evidence = perceive_frames(surroundings, mount_and_sensor)
        by_pixels = detector.is_expected(evidence)
        share = (by_pixels == detected[row]).mean()
        shares.append(share)

    return np.array(shares)


def test_the_table_detects_in_the_frames_in_which_pixels_do_at_the_studys_junction(
    study_runs, axis_of, camera
):
    scene = load_study_scene()
    grid = CandidateGrid(
        heights_m=[7.0],
        yaw_step_deg=90.0,
        pitches_deg=[-25.0],
        sensors=(camera,),
    )
    every_pose = build_candidates(scene, grid)
    some = every_pose[7::29]
    detector = load_planning_detector()
    runs = study_runs[::2]

    small_world = (scene, runs, axis_of(runs))
    table = _build(small_world, some, detector=detector)
    shares = _agreement(scene, runs, some, detector, _detected(table))

    assert len(shares) == 4
    assert shares.min() >= 0.97
    assert _detected(table).any()


def test_rows_do_not_depend_on_their_company(world, candidates, table):
    expected = tuple(candidate.id for candidate in candidates)

    assert table.pose_ids == expected

    numbered = list(enumerate(candidates))
    for row, candidate in numbered[::5]:
        alone = _build(world, [candidate])
        assert np.array_equal(_detected(alone)[0], _detected(table)[row])


def test_columns_do_not_depend_on_other_runs(world, candidates, table, axis_of):
    scene, runs, axis = world
    for index, run in enumerate(runs):
        alone = _build((scene, [run], axis_of([run])), candidates)
        frames = axis.frames_of(index)
        together = _detected(table)[:, frames]

        assert np.array_equal(_detected(alone), together)


def test_two_workers_build_the_same_table_as_one(world, candidates, table):
    compute = Compute(workers=2)
    two = _build(world, candidates, compute=compute)
    assert np.array_equal(two.packed, table.packed)


# Closed forms


def test_a_vru_above_the_lens_or_in_it_does_no_harm(
    build_scene, build_run, axis_of, mount
):
    run = build_run(
        [
            [0.0, 0.0, 0.0],
            [0.3, 0.0, 0.0],
            [1.0, 0.0, 90.0],
        ]
    )
    eyes = [mount(f"{z:g}", [0.0, 0.0, z]) for z in (0.4, 0.9, 1.8, 2.0)]

    axis = axis_of([run])
    small_world = (build_scene(), [run], axis)
    table = _build(small_world, eyes)

    assert _detected(table).shape == (4, 3)


def test_a_table_of_candidates_far_away_is_empty(world, mount):
    far = mount("far", [400.0, 0.0, 6.0], yaw_deg=180.0)
    assert not _build(world, [far]).packed.any()


@given(
    cameras(),
    numbers(1.0, 100.0),
    angles_deg,
    pitches_deg,
    st.tuples(numbers(-0.5, 0.5), numbers(-0.5, 0.5)),
    numbers(1.0, 3.0),
    st.tuples(numbers(-1.0, 1.0), numbers(-1.0, 1.0), numbers(-1.0, 1.0)),
    numbers(0.1, 5.0),
)
def test_nothing_beyond_the_largest_distance_is_high_enough(
    camera,
    min_height_px,
    yaw_deg,
    pitch_deg,
    pixel,
    times,
    direction,
    extent_m,
):
    """Two points of a body, both in the image, the nearer one just beyond the
    distance.
    """
    detector = GeometricDetector(min_iou=0.5, min_box_height_px=min_height_px)
    limit_m = max_distance_m(camera, detector, vru_height_m=extent_m)
    origin_m = np.zeros(3)
    pose = Pose(position_m=origin_m, yaw_deg=yaw_deg, pitch_deg=pitch_deg)
    in_camera = np.array(
        [
            pixel[0] * camera.width_px / camera.focal_length_px,
            pixel[1] * camera.height_px / camera.focal_length_px,
            1.0,
        ]
    )
    first = camera_rotation(yaw_deg, pitch_deg) @ in_camera
    length_m = np.linalg.norm(first)
    first *= times * limit_m / length_m
    direction_length = np.linalg.norm(direction)
    assume(direction_length > 1e-3)
    way = np.array(direction)
    length = np.linalg.norm(direction)
    second = first + extent_m * way / length
    share_along = first @ (first - second) / extent_m**2
    # The nearest point of the line between them counts.
    share = np.clip(share_along, 0.0, 1.0)
    nearest_point_m = first + share * (second - first)
    nearest_m = np.linalg.norm(nearest_point_m)
    assume(nearest_m >= limit_m)

    projected = project_points([first, second], pose, camera)
    size_px = [camera.width_px, camera.height_px]
    size = np.array(size_px)
    is_ahead = projected[:, 2] > 0.0
    assume(is_ahead.all())
    off_px = projected[:, :2] - 0.5 * size
    half_px = 0.5 * size * (1.0 + 1e-9)
    assume((np.abs(off_px) <= half_px).all())
    height_px = abs(projected[0, 1] - projected[1, 1])

    assert height_px <= min_height_px * (1.0 + 1e-6)


def test_the_largest_distance_is_reached_in_the_corner_of_the_image():
    """The bound is not only safe but the least one: a short rod in the corner attains
    it.
    """
    camera = tiny_camera(1, 1000, fov_deg=0.1, near_m=0.1)
    detector = GeometricDetector(min_iou=0.5, min_box_height_px=1.0)
    limit_m = max_distance_m(camera, detector, vru_height_m=0.01)
    half = np.radians(0.5 * camera.vertical_fov_deg)
    east = np.cos(half)
    down = np.sin(half)
    foot = limit_m * np.array([east, 0.0, -down])
    across = np.sin(half)
    up = np.cos(half)
    head = foot + 0.01 * np.array([across, 0.0, up])

    pose = Pose(position_m=[0.0, 0.0, 0.0], yaw_deg=0.0)

    pixels = project_points([foot, head], pose, camera)
    rows = pixels[:, 1]
    found_px = abs(rows[0] - rows[1])

    assert found_px == pytest.approx(1.0, rel=1e-2)


def test_any_distance_may_count_where_any_height_does(small_camera):
    detector = GeometricDetector(min_iou=0.5, min_box_height_px=0.0)
    found_m = max_distance_m(small_camera, detector, vru_height_m=1.8)
    assert found_m == np.inf


# Progress and interruption


def test_progress_counts_mount_positions(world, candidates):
    calls = []

    def told(stage, done, total):
        calls.append((done, total))

    compute = Compute(workers=2, progress=told)
    _build(world, candidates, compute=compute)
    expected = [(done, 4) for done in (1, 2, 3, 4)]

    # Two positions, one of them for the model with another near distance, each.
    assert calls == expected


@pytest.mark.parametrize("workers", [1, 2])
def test_an_interruption_stops_after_the_positions_at_work(mount, workers):
    many = [mount(f"{i}", [i, 0.0, 6.0]) for i in range(60)]
    begun = []

    def slow(rows):
        begun.append(many[rows[0]].id)
        time.sleep(0.02)

    def interrupt(stage, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        at_each_mount(
            many,
            slow,
            stage="look",
            compute=Compute(workers=workers, progress=interrupt),
        )

    assert 1 <= len(begun) <= 20

    n_begun = len(begun)
    time.sleep(0.1)

    assert len(begun) == n_begun


def test_an_error_in_a_worker_is_not_lost(world, mount, monkeypatch):
    def fail(world, position_m, looks):
        raise MemoryError("no room")

    monkeypatch.setattr(build_module, "cast_for", fail)
    one = mount("one", [0.0, 0.0, 6.0])
    compute = Compute(workers=2)

    with pytest.raises(MemoryError, match="no room"):
        _build(world, [one], compute=compute)
