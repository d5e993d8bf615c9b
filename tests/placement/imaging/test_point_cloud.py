"""Point clouds of frames: on the beams, on the bodies, within the range."""

from dataclasses import replace

import numpy as np
import pytest
from changes import changed
from placed_bodies import ahead_of

from geometry.actors import load_actors
from geometry.lidar import beam_directions, load_lidars, load_surface_reflectivity
from geometry.poses import Pose, to_world
from geometry.scene import CLASS_NAMES
from geometry.study_scene import load_study_scene
from geometry.weather import load_weathers
from placement.imaging.mesh import build_frame_mesh, build_static_mesh, scan_mesh

DAY = load_weathers()["day"]
LIDAR = load_lidars()["carla-ncap-lidar"]
EXACT = replace(LIDAR, range_noise_m=0.0)


@pytest.fixture(scope="module")
def run(runs):
    """A pedestrian from the west."""
    return next(run for run in runs if run.id == "CPNC-50/west/40")


@pytest.fixture(scope="module")
def scene():
    """The study's junction."""
    return load_study_scene()


@pytest.fixture(scope="module")
def pose(run):
    """Twelve metres from the VRU at the impact, looking at it."""
    east, north = run.vru_position_m[-1]
    position_m = [east - 12.0, north, 4.0]
    return Pose(position_m=position_m, yaw_deg=0.0, pitch_deg=-12.0)


def _scan(scene, run, pose, lidar=EXACT, weather=DAY, *, with_vut=True, **options):
    """The point cloud of a run's last frame."""
    static = build_static_mesh(scene, run.obstruction)
    frame = len(run.time_s) - 1
    mesh = build_frame_mesh(
        static,
        run,
        frame,
        pose.position_m,
        with_vut=with_vut,
    )
    return scan_mesh(
        mesh,
        run,
        pose,
        lidar,
        weather=weather,
        **options,
    )


def _distance_m(cloud):
    """Distance of each point from the LiDAR, (n,)."""
    return np.linalg.norm(cloud.points_m, axis=1)


def _of_vru(cloud, pose):
    """Points on the VRU in the world frame, (n, 3). [m]"""
    vru_index = cloud.names.index("vru")
    is_of_vru = cloud.instance == vru_index
    return to_world(cloud.points_m[is_of_vru], pose)


@pytest.mark.long
def test_points_lie_on_beams_at_most_as_far_as_the_range_and_no_beam_has_two(
    scene, run, pose
):
    cloud = _scan(scene, run, pose)
    distance_m = _distance_m(cloud)
    beams = beam_directions(EXACT).reshape(-1, 3)
    towards = cloud.points_m / distance_m[:, None]
    nearest = (towards @ beams.T).argmax(axis=1)
    along_m = np.einsum("ni,ni->n", cloud.points_m, beams[nearest])
    distinct = np.unique(nearest)

    assert distance_m.max() <= EXACT.range_m + 1e-3
    assert distance_m.min() >= EXACT.near_m
    assert along_m == pytest.approx(distance_m, rel=1e-6)
    assert len(distinct) == len(nearest)


def test_ground_points_lie_on_the_road_and_those_of_the_vru_on_its_body(
    scene, run, pose
):
    cloud = _scan(scene, run, pose)
    world = to_world(cloud.points_m, pose)
    classes = {instance.id: instance.class_name for instance in scene.instances}
    is_ground_name = [classes.get(name) == "ground" for name in cloud.names]
    is_of_ground = np.array(is_ground_name)
    is_ground = is_of_ground[cloud.instance]
    height_m = np.abs(world[is_ground, 2])

    assert is_ground.sum() > 1000
    assert height_m.max() < 0.2

    of_vru = _of_vru(cloud, pose)
    offset_m = of_vru[:, :2] - run.vru_position_m[-1]
    aside_m = np.linalg.norm(offset_m, axis=1)
    highest_m = of_vru[:, 2].max()

    assert len(of_vru) >= 10  # the parked row hides its legs
    assert aside_m.max() < 0.6
    assert highest_m <= run.encounter.vru.height_m


@pytest.mark.parametrize(
    ("name", "box_height_m"),
    [
        ("motorcyclist", 1.7),
        ("car", 1.427),
    ],
)
def test_points_of_a_motorcyclist_and_a_car_lie_in_their_boxes(
    scene, run, pose, name, box_height_m
):
    actor = load_actors()[name]
    n_frames = len(run.time_s)
    vru_shape = np.zeros(n_frames, dtype=np.int64)
    met = replace(
        changed(run, "encounter.vru", actor),
        vru_shape=vru_shape,
        obstruction=(),
    )

    cloud = _scan(scene, met, pose)
    points = _of_vru(cloud, pose)

    assert len(points) > 30

    ahead = ahead_of(met.vru_yaw_deg[-1])
    away_m = points[:, :2] - met.vru_position_m[-1]
    ahead_m = away_m @ ahead
    to_left = [-ahead[1], ahead[0]]
    left_m = away_m @ to_left
    along_off_m = np.abs(ahead_m)
    across_off_m = np.abs(left_m)
    highest_m = points[:, 2].max()

    assert along_off_m.max() < 0.5 * actor.length_m + 0.01
    assert across_off_m.max() < 0.5 * actor.width_m + 0.01
    assert 0.7 * box_height_m < highest_m < box_height_m + 0.01


def test_noise_moves_points_along_their_beams_only(scene, run, pose):
    exact = _scan(scene, run, pose, seed=3)
    noisy = _scan(scene, run, pose, LIDAR, seed=3)

    assert np.array_equal(exact.instance, noisy.instance)

    exact_m = _distance_m(exact)
    noisy_m = _distance_m(noisy)
    exact_ways = exact.points_m / exact_m[:, None]
    noisy_ways = noisy.points_m / noisy_m[:, None]
    error_m = (noisy_m - exact_m).std()

    assert error_m == pytest.approx(LIDAR.range_noise_m, rel=0.05)
    assert noisy_ways == pytest.approx(exact_ways, abs=1e-5)


def test_fog_takes_far_points_and_adds_none(scene, run, pose):
    clear = _scan(scene, run, pose)
    fog = _scan(scene, run, pose, weather=load_weathers()["fog"])
    fog_distance_m = _distance_m(fog).max()
    clear_distance_m = _distance_m(clear).max()

    assert len(fog.points_m) < len(clear.points_m)
    assert fog_distance_m < 0.6 * clear_distance_m


def test_the_vut_is_there_only_if_asked_for(scene, run, pose):
    with_vut = _scan(scene, run, pose)
    vut_index = with_vut.names.index("vut")
    is_vut = with_vut.instance == vut_index
    without_vut = _scan(scene, run, pose, with_vut=False)

    assert is_vut.any()
    assert "vut" not in without_vut.names


def test_the_same_seed_gives_the_same_cloud(scene, run, pose):
    one = _scan(scene, run, pose, LIDAR, seed=1)
    two = _scan(scene, run, pose, LIDAR, seed=1)
    other = _scan(scene, run, pose, LIDAR, seed=2)
    is_same = np.array_equal(one.points_m, other.points_m)
    is_share = (one.intensity > 0.0) & (one.intensity <= 1.0)

    assert np.array_equal(one.points_m, two.points_m)
    assert not is_same
    assert is_share.all()


def test_every_class_of_a_scene_has_a_reflectivity():
    known = load_surface_reflectivity()
    assert set(known) == {*CLASS_NAMES, "vehicle"}
    for share in known.values():
        assert 0.0 < share <= 1.0
