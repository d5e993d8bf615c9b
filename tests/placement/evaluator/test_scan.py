"""LiDARs' pulses on bodies: range, weather, surfaces, and luck."""

from bisect import bisect_left
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.random import default_rng
from placed_bodies import ahead_of, one_mesh, parked_at, parts_of_frame

from geometry.actors import pick_actor
from geometry.lidar import (
    LidarDetection,
    beam_directions,
    beams_per_steradian,
    load_lidar_detection,
    load_lidars,
)
from geometry.poses import Pose, body_rotation
from geometry.raycast import build_caster
from placement.detectors import VRU_CLASSES
from placement.evaluator import perceive
from placement.evaluator.perceive import scan_frames
from placement.evaluator.surroundings import (
    build_surroundings,
    load_vut_camera,
    load_vut_lidar,
)

STUDY = load_lidars()["carla-ncap-lidar"]
SURE = replace(STUDY, reference_range_m=1.0e6)  # whatever it hits comes back
LOW = Pose(position_m=[0.0, 0.0, 0.9], yaw_deg=0.0)
HIGH = Pose(position_m=[-8.0, -6.0, 6.0], yaw_deg=40.0, pitch_deg=-25.0)
WALL = (
    (5.0, -3.0, 0.0),
    (5.4, 3.0, 4.0),
)


@pytest.fixture
def needs(monkeypatch):
    """Sets how many points it takes, whatever is looked at."""

    def set_points(n_points):
        detection = LidarDetection(
            min_points=dict.fromkeys(VRU_CLASSES, n_points),
            reflectivity=load_lidar_detection().reflectivity,
        )
        monkeypatch.setattr(perceive, "load_lidar_detection", lambda: detection)

    return set_points


@pytest.fixture
def count(needs):
    """Points on the VRU in the only frame: the most that may be asked for."""

    def count_points(surroundings, pose, lidar=SURE):
        def is_too_much(n_points):
            needs(n_points)
            is_found = scan_frames(
                surroundings,
                pose,
                lidar,
                default_rng(0),
            )
            return not is_found[0]

        return bisect_left(range(1, 10_000), True, key=is_too_much)

    return count_points


@pytest.fixture
def sees(build_scene, build_run, block):
    """Whether a LiDAR on the roadside detects the block in each frame."""

    def look(
        vru_poses,
        *boxes,
        vut_poses=None,
        pose=LOW,
        lidar=STUDY,
        weather="day",
        seed=0,
    ):
        by_day = build_run(block, vru_poses, vut_poses)
        run = replace(by_day, weather=weather)
        scene = build_scene(*boxes)
        surroundings = build_surroundings(scene, [run])
        is_found = scan_frames(
            surroundings,
            pose,
            lidar,
            default_rng(seed),
        )
        return is_found.tolist()

    return look


# What is in the way, and what is out of sight


def test_nothing_is_seen_beyond_the_range(sees):
    vru = [
        [19.0, 0.0, 0.0],
        [21.0, 0.0, 0.0],
    ]
    lidar = replace(STUDY, range_m=20.0)
    seen_within = sees(vru, lidar=lidar)

    assert seen_within == [True, False]
    assert sees(vru) == [True, True]


def test_fog_and_a_heavy_rain_take_what_is_far(sees):
    vru = [
        [8.0, 0.0, 0.0],
        [35.0, 0.0, 0.0],
    ]
    found = {name: sees(vru, weather=name) for name in ("day", "night", "rain", "fog")}

    assert found["day"] == found["night"] == found["rain"] == [True, True]
    assert found["fog"] == [True, False]


# How many beams


@pytest.mark.parametrize("distance_m", [4.0, 15.0])
def test_beams_on_a_block_are_its_face_by_the_square_of_the_distance(
    build_scene, build_run, block, count, distance_m
):
    """A face of 1 m by 1.8 m that is met squarely: every beam that ends inside it
    counts.
    """
    run = build_run(block, [[distance_m + 0.25, 0.0, 0.0]])
    surroundings = build_surroundings(build_scene(), [run])
    found = count(surroundings, LOW)

    beams = beam_directions(SURE).reshape(-1, 3)
    ahead, left, up = np.moveaxis(beams, -1, 0)
    y_m = distance_m * left / ahead
    z_m = 0.9 + distance_m * up / ahead
    is_on_block = (np.abs(y_m) < 0.5) & (z_m > 0.0) & (z_m < 1.8)

    assert found == is_on_block.sum()

    solid_angle = 4.0 * np.arctan(  # of a rectangle seen from above its middle
        0.5 * 0.9 / (distance_m * np.sqrt(distance_m**2 + 0.5**2 + 0.9**2))
    )

    beams_there = beams_per_steradian(SURE, 0.0)
    expected = solid_angle * float(beams_there)
    height_deg = np.degrees(1.8 / distance_m)
    # A row or a column more or less at the edges.
    rows = height_deg * SURE.n_lines / SURE.vertical_fov_deg
    width_deg = np.degrees(1.0 / distance_m)
    columns = width_deg * SURE.n_columns / SURE.horizontal_fov_deg

    assert found == pytest.approx(expected, abs=rows + columns)


def _plain_counts(scene, runs, pose, lidar):
    """Beams of the whole pattern that end on the VRU, by one mesh of all there is."""
    turn = body_rotation(pose.yaw_deg, pose.pitch_deg)
    directions = beam_directions(lidar).reshape(-1, 3)
    beams = directions @ turn.T
    starts_m = pose.position_m + lidar.near_m * beams
    starts = starts_m.astype(np.float32)
    counts = []
    for run in runs:
        for frame in range(len(run.time_s)):
            parts = parts_of_frame(scene, run, frame)
            vertices_m, triangles, owner = one_mesh(parts)
            caster = build_caster(vertices_m, triangles)
            directions_32 = beams.astype(np.float32)
            _, hit = caster.first_triangle(starts, directions_32)
            met = owner[hit[hit >= 0]]
            is_of_vru = met == 0
            n_beams = is_of_vru.sum()
            counts.append(int(n_beams))

    return np.array(counts)


@pytest.mark.long
@pytest.mark.parametrize("pose", [HIGH, replace(LOW, position_m=[-9.0, 1.0, 1.6])])
def test_frames_are_those_in_which_enough_beams_of_the_whole_pattern_end_on_the_vru(
    build_scene, build_run, needs, pose
):
    rng = default_rng(7)
    car = parked_at("parked-car-small", 1.0, -2.0, 10.0)
    scene = build_scene(
        ((3.0, 2.0, 0.0), (6.0, 5.0, 3.0)), ((-40.0, -40.0, -1.0), (40.0, 40.0, 0.0))
    )
    runs = []
    for name, obstruction in (
        ("adult", ()),
        ("cyclist", (car,)),
        ("child", (car,)),
    ):
        vru, vut = (
            np.column_stack(
                [rng.uniform(-6.0, 9.0, (16, 2)), rng.uniform(-180.0, 180.0, 16)]
            )
            for _ in range(2)
        )
        vru[8:] = vru[:8]  # some sights repeat, with the VUT elsewhere
        runs.append(build_run(pick_actor(name, "test"), vru, vut, obstruction))

    surroundings = build_surroundings(scene, runs)

    counts = _plain_counts(scene, runs, pose, SURE)
    hidden = _plain_counts(
        scene,
        [replace(run, vut_position_m=run.vut_position_m + 500.0) for run in runs],
        pose,
        SURE,
    )

    assert (hidden > counts).any()  # the VUT hides something somewhere

    for n_points in (1, 10, 40, 120):
        needs(n_points)

        found = scan_frames(surroundings, pose, SURE, default_rng(0))
        # A beam along an edge may go either way in single precision.
        off_by = np.abs(counts - n_points)
        is_clear = (counts == 0) | (off_by > 2)
        agrees = (found == (counts >= n_points))[is_clear]

        assert is_clear.mean() > 0.7
        assert agrees.all()

    dense_share = (counts >= 10).mean()

    assert 0.2 < dense_share < 0.9


@pytest.mark.parametrize(
    ("distance_m", "yaw_deg", "is_seen"),
    [
        (9.0, 0.0, True),
        (9.0, 45.0, False),
        (10.5, 0.0, False),
    ],
)
def test_grazing_and_dark_surfaces_send_less_back(
    build_scene,
    build_run,
    block,
    count,
    distance_m,
    yaw_deg,
    is_seen,
):
    """At the distance at which a pulse met squarely comes back half the time."""
    reflectivity = load_lidar_detection().reflectivity["pedestrian"]
    weak = replace(
        STUDY,
        reference_range_m=10.0,
        reference_reflectivity=reflectivity,
        reference_probability=0.5,
        threshold_width=1.0e-3,
    )
    run = build_run(block, [[distance_m + 0.25, 0.0, yaw_deg]])

    surroundings = build_surroundings(build_scene(), [run])
    n_found = count(surroundings, LOW, weak)

    assert (n_found > 0) == is_seen
    assert count(surroundings, LOW) > 50


# Seed, company, and the VUT's own LiDAR


def test_the_same_seed_brings_the_same_pulses_back(sees):
    vru = [[x_m, 0.0, 90.0] for x_m in np.linspace(20.0, 50.0, 60)]
    vague = replace(STUDY, threshold_width=9.0, reference_probability=0.5)

    one = sees(vru, seed=1, lidar=vague)
    same = sees(vru, seed=1, lidar=vague)
    other = sees(vru, seed=2, lidar=vague)

    assert one == same
    assert one != other
    assert any(one)
    assert not all(one)


def test_other_frames_do_not_matter(build_scene, build_run):
    rng = default_rng(3)
    vru, vut = (
        np.column_stack([rng.uniform(3.0, 30.0, 40), rng.uniform(-9.0, 9.0, (40, 2))])
        for _ in range(2)
    )
    adult = pick_actor("adult", "test")
    run = build_run(adult, vru, vut)
    surroundings = build_surroundings(build_scene(WALL), [run])
    some = np.arange(0, 40, 3)

    every = scan_frames(surroundings, LOW, SURE, default_rng(0))
    alone = scan_frames(
        surroundings.take(some),
        LOW,
        SURE,
        default_rng(0),
    )

    assert np.array_equal(alone, every[some])
    assert 0 < every.sum() < 40


def test_the_vut_looks_ahead_from_where_its_lidar_is(build_scene, build_run, block):
    """Wherever the VUT stands and faces: ahead is seen, aside, behind and hidden is
    not.
    """
    yaw_deg = np.repeat([0.0, 77.0, -160.0], 4)
    turns_deg = np.tile([0.0, 60.0, 180.0, 5.0], 3)
    bearing_deg = yaw_deg + turns_deg
    place = np.repeat(
        [
            [3.0, 5.0],
            [-20.0, 1.0],
            [40.0, -6.0],
        ],
        4,
        axis=0,
    )
    vut = np.column_stack([place, yaw_deg])
    place_of_vru = place + 14.0 * ahead_of(bearing_deg)
    vru = np.column_stack([place_of_vru, yaw_deg])
    run = build_run(block, vru, vut)

    def found(scene):
        surroundings = build_surroundings(scene, [run])
        seen = scan_frames(
            surroundings,
            load_vut_camera(),
            load_vut_lidar(),
            default_rng(0),
        )
        return seen.tolist()

    one_place = [True, False, False, True]

    assert found(build_scene()) == one_place * 3

    wall = ((3.0 + 7.0, 5.0 - 3.0, 0.0), (3.0 + 7.4, 5.0 + 3.0, 4.0))
    expected = [False] * 4 + one_place * 2

    assert found(build_scene(wall)) == expected


# All round


# Cells of a degree; a wide one leaves a gap behind, over which a cone reaches both
# edges.
RING = replace(
    SURE,
    horizontal_fov_deg=360.0,
    vertical_fov_deg=150.0,
    n_lines=150,
)
RING = replace(RING, points_per_second=10.0 * 150 * 360)
SECTOR = replace(RING, horizontal_fov_deg=120.0, points_per_second=10.0 * 150 * 120)
WIDE = replace(RING, horizontal_fov_deg=345.0, points_per_second=10.0 * 150 * 345)
OVERHEAD = Pose(position_m=[0.5, 0.5, 5.0], yaw_deg=0.0)


@pytest.fixture
def beams_on_vru(monkeypatch):
    """Beams that end on the VRU, frame by frame."""

    def look(surroundings, pose, lidar):
        counts = []
        with monkeypatch.context() as patch:
            patch.setattr(
                perceive,
                "_is_enough",
                lambda echoes, *given: counts.append(len(echoes.distance_m)),
            )
            # One by one: a scan has an order of its own.
            for frame in range(len(surroundings.vru_poses)):
                one = surroundings.take(np.array([frame]))
                scan_frames(one, pose, lidar, default_rng(0))

        return np.array(counts)

    return look


def _around(build_run, name, distance_m, n_frames):
    """A VRU all round the origin, with the VUT now and then before it."""
    bearing_deg = np.linspace(-180.0, 180.0, n_frames, endpoint=False)
    towards = ahead_of(bearing_deg)
    vru = np.column_stack([distance_m * towards, bearing_deg + 20.0])
    vut = np.column_stack([0.5 * distance_m * towards, bearing_deg + 90.0])
    vut[::2] += 500.0
    actor = pick_actor(name, "test")
    return build_run(actor, vru, vut)


@pytest.mark.long
@pytest.mark.parametrize(
    ("lidar", "pitch_deg", "distance_m"),
    [*product((RING, WIDE, SECTOR), (0.0, -35.0), (1.5, 9.0))],
)
def test_all_round_as_many_beams_end_on_the_vru_as_of_the_whole_pattern(
    build_scene,
    build_run,
    beams_on_vru,
    lidar,
    pitch_deg,
    distance_m,
):
    """Also over the seam behind, and below the LiDAR, where a VRU is at all azimuths at
    once.
    """
    scene = build_scene(((3.0, 2.0, 0.0), (6.0, 5.0, 3.0)))
    run = _around(build_run, "cyclist", distance_m, n_frames=10)

    # Looking east: the first frames are right behind.
    for yaw_deg in (0.0, 100.0):
        pose = replace(OVERHEAD, yaw_deg=yaw_deg, pitch_deg=pitch_deg)

        surroundings = build_surroundings(scene, [run])
        found = beams_on_vru(surroundings, pose, lidar)
        plain = _plain_counts(scene, [run], pose, lidar)
        off_by = np.abs(found - plain)

        # A beam along an edge may go either way in single precision.
        assert off_by.max() <= 2
        assert (found == plain).mean() > 0.7
        assert plain.max() > 20
