"""From points to detections: weathers, pixels, plates and LiDARs."""

from bisect import bisect_left
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.random import default_rng
from placed_bodies import poses_beside
from tiny_worlds import WALLS, block_actor

from geometry.actors import Shape
from geometry.lidar import (
    LidarDetection,
    beams_per_steradian,
    load_lidar_detection,
    load_lidars,
)
from placement.detectors import VRU_CLASSES, load_detector, load_planning_detector
from placement.detectors.geometric import GeometricDetector
from placement.evaluator import perceive
from placement.evaluator.perceive import perceive_frames, scan_frames
from placement.evaluator.surroundings import build_surroundings
from placement.visibility import build_detection_table, sensing
from placement.visibility.build import N_POINTS
from placement.visibility.casting import build_world, cast_sight
from placement.visibility.sensing import build_sensing

WEATHERS = ("day", "night", "rain", "fog")
STUDY = load_lidars()["carla-ncap-lidar"]
SURE = replace(STUDY, reference_range_m=1.0e6)  # whatever it hits comes back
RESPONSE = load_planning_detector("response")
FAR_SIGHTED = GeometricDetector(min_iou=0.5, min_box_height_px=3.0, min_contrast=0.05)


@pytest.fixture(scope="module")
def random_runs(build_run):
    """An adult, a child and a cyclist that jump about among walls, with the VUT near
    them.
    """
    return _jumping(build_run, 14.0)


def _jumping(build_run, reach_m):
    """Runs whose VRU jumps at random within a reach, with the VUT near it."""
    rng = default_rng(8)
    runs = []
    for body in ("adult", "child", "cyclist"):
        vru = rng.uniform(-1.0, 1.0, (80, 3)) * [reach_m, reach_m, 180.0]
        vut = poses_beside(rng, vru, 3.0, 6.0)
        run = build_run(vru, vut, vru=body, name=body)
        runs.append(run)

    return tuple(runs)


@pytest.fixture(scope="module")
def table_of(axis_of):
    """Builds the detections of candidates."""

    def build(scene, candidates, runs, detector=FAR_SIGHTED):
        table = build_detection_table(
            scene,
            candidates,
            runs,
            axis_of(runs),
            detector=detector,
        )
        return table.detected(slice(None))

    return build


def _in_weathers(runs):
    """Each run in each weather."""
    return [
        replace(run, id=f"{run.id}/{weather}", weather=weather)
        for weather in WEATHERS
        for run in runs
    ]


# Weather


def test_in_fog_the_table_loses_what_is_beyond_the_visibility_and_nothing_else(
    build_scene, build_run, mount, table_of
):
    """5 % of the contrast is left 50 m away: that is what the detector asks for."""
    distance_m = np.linspace(10.0, 100.0, 181)
    run = build_run(np.column_stack([distance_m, np.zeros(181), np.full(181, 90.0)]))
    camera = mount("a", [0.0, 0.0, 0.9])
    found = table_of(build_scene(), [camera], _in_weathers([run])).reshape(4, -1)
    by_day, at_night, in_rain, in_fog = found

    assert by_day.all()
    assert at_night.all()  # 0.6 of the contrast, and clear air
    assert in_rain.all()
    # The middle of the points may lie a few centimetres beside that of the footprint.
    assert in_fog[distance_m < 49.8].all()
    assert not in_fog[distance_m > 50.2].any()


@pytest.mark.parametrize("detector", [FAR_SIGHTED, RESPONSE], ids=lambda d: d.name)
def test_no_weather_shows_what_the_day_does_not(
    build_scene,
    build_run,
    mount,
    small_camera,
    table_of,
    detector,
):
    random_runs = _jumping(build_run, 40.0)
    candidates = [
        mount(
            f"{name}/{yaw:g}",
            [-10.0, -12.0, 6.0],
            yaw_deg=yaw,
            pitch_deg=-20.0,
            camera=sensor,
        )
        for yaw in (20.0, 60.0)
        for name, sensor in (("camera", small_camera), ("lidar", STUDY))
    ]
    scene = build_scene(*WALLS)
    found = table_of(
        scene,
        candidates,
        _in_weathers(random_runs),
        detector,
    )
    found = found.reshape(4, 4, -1)  # candidate, weather, frame
    by_day = found[:, 0]
    expected = table_of(scene, candidates, random_runs, detector)

    assert (found <= by_day[:, None]).all()
    # Cameras: LiDARs do not see that far.
    assert (found[::2, 3] < by_day[::2]).any(axis=1).all()
    assert np.array_equal(by_day, expected)
    # At night a laser sees what it sees by day.
    assert np.array_equal(found[1::2, 1], by_day[1::2])


# Response


def _evidence_of_frames(scene, runs, candidate, detector):
    """What the table and what the evaluator get to see, in the frames that the table
    casts.
    """
    world = build_world(scene, runs, n_points=N_POINTS, seed=0)
    position = candidate.pose.position_m
    pose = candidate.pose
    camera = candidate.sensor
    sight = cast_sight(
        world,
        position,
        near_m=camera.near_m,
        max_distance_m=1000.0,
    )
    made = build_sensing(world, sight, position, detector)
    (_, whole), (_, part) = made.evidence([candidate])
    fields = (
        *("visible_px", "amodal_px", "visible_share", "inside_share", "aspect_deg"),
        *("vru_class", "draw_index"),
    )
    every = {n: np.concatenate([getattr(whole, n), getattr(part, n)]) for n in fields}
    row_of_entry = np.full(len(sight.view_index) + 1, -1)
    row_of_entry[every["draw_index"]] = np.arange(len(every["draw_index"]))
    frames = np.flatnonzero(row_of_entry[sight.entry_of_frame] >= 0)
    rows = row_of_entry[sight.entry_of_frame[frames]]
    by_points = replace(whole, **{name: values[rows] for name, values in every.items()})
    by_points = replace(by_points, contrast=made.contrast[0, by_points.draw_index])
    by_pixels = perceive_frames(
        build_surroundings(scene, runs).take(frames), (pose, camera)
    )
    return by_points, by_pixels


def test_the_response_foretold_by_points_is_that_of_pixels(
    build_scene, random_runs, mount
):
    """Points are 10 cm apart, and a share of them is no share of pixels: a tenth on
    most frames.
    """
    candidate = mount(
        "a",
        [-10.0, -12.0, 6.0],
        yaw_deg=50.0,
        pitch_deg=-20.0,
    )
    evidence = _evidence_of_frames(
        build_scene(*WALLS),
        random_runs,
        candidate,
        RESPONSE,
    )
    by_points, by_pixels = (RESPONSE.probability(one) for one in evidence)
    is_seen = (by_points > 0.05) | (by_pixels > 0.05)

    assert is_seen.sum() > 100

    off = np.abs(by_points - by_pixels)[is_seen]

    assert np.median(off) < 0.02
    assert (off < 0.1).mean() > 0.9
    # Nobody is left out of the image by one of them only.
    assert np.array_equal(evidence[0].vru_class, evidence[1].vru_class)
    assert evidence[0].aspect_deg == pytest.approx(evidence[1].aspect_deg, abs=3.0)
    assert evidence[0].contrast == pytest.approx(evidence[1].contrast, abs=0.01)

    cut_off = np.abs(evidence[0].inside_share - evidence[1].inside_share)[is_seen]

    assert (cut_off < 0.1).mean() > 0.95


# LiDAR


@pytest.fixture
def expected_points(monkeypatch, build_scene, axis_of):
    """Points that the table expects on the VRU in the only frame, up to one."""

    def count(candidate, run):
        def is_too_much(n_points):
            detection = LidarDetection(
                min_points=dict.fromkeys(VRU_CLASSES, n_points),
                reflectivity=load_lidar_detection().reflectivity,
            )
            monkeypatch.setattr(sensing, "load_lidar_detection", lambda: detection)
            table = build_detection_table(
                build_scene(),
                [candidate],
                [run],
                axis_of([run]),
                detector=FAR_SIGHTED,
            )
            return not table.detected(slice(None))[0, 0]

        return bisect_left(range(1, 4000), True, key=is_too_much)

    return count


@pytest.fixture
def block_run(build_run):
    """A block 1 m wide, 1.8 m high and 0.5 m deep whose face is at a distance, facing
    west.
    """

    def build(distance_m):
        mesh = trimesh.creation.box((0.5, 1.0, 1.8)).subdivide().subdivide()
        fine = Shape(vertices_m=mesh.vertices + [0.0, 0.0, 0.9], triangles=mesh.faces)
        block = replace(block_actor(), shapes=(fine,))
        return build_run([[distance_m + 0.25, 0.0, 0.0]], vru=block)

    return build


@pytest.mark.parametrize("distance_m", [8.0, 12.0, 20.0])
def test_a_plate_gets_its_area_by_the_square_of_the_distance_times_the_density(
    mount, block_run, expected_points, distance_m
):
    found = expected_points(
        mount("a", [0.0, 0.0, 0.9], camera=SURE), block_run(distance_m)
    )
    expected = 1.0 * 1.8 / distance_m**2 * float(beams_per_steradian(SURE, 0.0))

    assert found == pytest.approx(expected, rel=0.06, abs=1.0)


@pytest.mark.long
@pytest.mark.parametrize("body", ["adult", "child", "cyclist"])
def test_as_many_points_are_expected_on_a_body_as_beams_end_on_it(
    build_scene,
    build_run,
    mount,
    expected_points,
    monkeypatch,
    body,
):
    """On average over poses all around, in the open: within 8 %."""
    candidate = mount("a", [0.0, 0.0, 1.2], camera=SURE)
    n_expected = 0
    n_beams = []
    monkeypatch.setattr(
        perceive,
        "_is_enough",
        lambda echoes, *given: n_beams.append(len(echoes.distance_m)),
    )

    for yaw_deg in range(0, 360, 60):
        run = build_run([[8.0, 0.5, yaw_deg]], vru=body)
        n_expected += expected_points(candidate, run)
        scan_frames(
            build_surroundings(build_scene(), [run]),
            candidate.pose,
            SURE,
            default_rng(0),
        )

    assert n_expected == pytest.approx(sum(n_beams), rel=0.08)


def test_a_lidars_table_leaves_of_those_with_enough_points_who_are_near_enough(
    build_scene, random_runs, mount, table_of
):
    at = mount(
        "a",
        [-30.0, -12.0, 6.0],
        yaw_deg=20.0,
        pitch_deg=-12.0,
        camera=SURE,
    )
    rule = load_planning_detector()
    table = load_detector("pointrcnn-2019").lidar
    half_at_30_m = replace(
        table,
        distance_m=((0.0, 60.0),) * 5,
        recall=((1.0, 0.0),) * 5,
    )
    by_points = table_of(build_scene(), [at], random_runs, replace(rule, lidar=None))[0]
    found = table_of(
        build_scene(),
        [at],
        random_runs,
        replace(rule, lidar=half_at_30_m),
    )[0]
    vru = np.concatenate([run.vru_position_m[:, :2] for run in random_runs])
    distance = np.hypot(*(vru - at.pose.position_m[:2]).T)
    clear = abs(distance - 30.0) > 0.5  # the table measures to the body's points

    assert (found == (by_points & (distance < 30.0)))[clear].all()
    assert found.any()
    assert (found < by_points).any()


@pytest.mark.long
@pytest.mark.parametrize("lidar", [STUDY, SURE], ids=["study", "sure"])
def test_the_table_detects_in_the_frames_in_which_a_scan_does(
    build_scene, random_runs, mount, table_of, lidar
):
    scene = build_scene(*WALLS)
    candidates = [
        mount(
            f"{x:g}/{yaw:g}",
            [x, -12.0, 6.0],
            yaw_deg=yaw,
            pitch_deg=-18.0,
            camera=lidar,
        )
        for x in (-10.0, 3.0)
        for yaw in (60.0, 90.0, 120.0)
    ]
    found = table_of(scene, candidates, random_runs)
    surroundings = build_surroundings(scene, random_runs)

    scans = np.array(
        [scan_frames(surroundings, c.pose, lidar, default_rng(0)) for c in candidates]
    )
    agreement = (found == scans).mean(axis=1)

    assert agreement.min() > 0.93
    assert agreement.mean() > 0.96
    assert 0.2 < scans.mean() < 0.8


RING = replace(
    STUDY,
    horizontal_fov_deg=360.0,
    vertical_fov_deg=60.0,
    points_per_second=10.0 * 52 * 360,
)


def test_a_level_ring_has_the_same_row_however_it_is_turned(
    build_scene, random_runs, mount, table_of
):
    yaws_deg = (0.0, 1.0, 90.0, 179.0, 180.0, -63.0)
    candidates = [
        mount(f"{yaw:g}", [1.0, -2.0, 5.0], yaw_deg=yaw, pitch_deg=0.0, camera=RING)
        for yaw in yaws_deg
    ]

    found = table_of(build_scene(*WALLS), candidates, random_runs)

    assert (found == found[0]).all()
    assert 0.2 < found[0].mean() < 0.9


@pytest.mark.long
@pytest.mark.parametrize("pitch_deg", [0.0, -25.0])
def test_the_table_of_a_ring_detects_in_the_frames_in_which_a_scan_does(
    build_scene, random_runs, mount, table_of, pitch_deg
):
    scene = build_scene(*WALLS)
    candidates = [
        mount(f"{x:g}", [x, -2.0, 5.0], yaw_deg=30.0, pitch_deg=pitch_deg, camera=RING)
        for x in (-10.0, 3.0)
    ]
    found = table_of(scene, candidates, random_runs)
    surroundings = build_surroundings(scene, random_runs)

    scans = np.array(
        [scan_frames(surroundings, c.pose, RING, default_rng(0)) for c in candidates]
    )

    assert (found == scans).mean(axis=1).min() > 0.93
    assert 0.2 < scans.mean() < 0.9
