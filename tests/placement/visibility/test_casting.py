"""What rays see of bodies, against rays cast one by one."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng
from placed_bodies import one_mesh, parked_at, parts_of_frame, poses_within
from tiny_worlds import WALLS

from geometry import raycast
from geometry.actors import load_actors
from geometry.poses import Pose, to_world
from geometry.raycast import CASTERS
from geometry.study_scene import load_study_scene
from placement.visibility import casting
from placement.visibility.casting import build_shared_scene, build_world, cast_sight

NEAR_M = 0.35
FAR_M = 1000.0
N_POINTS = 60
# Where a ray ends before its point, and by how much the point is shaken to tell grazing
# rays.
END_M = 1e-3
SHAKE_M = 2e-4
N_SHAKEN = 6


def _naive_visible(caster, middle, eye, points):
    """Ray by ray: start `NEAR_M` from the eye, end a millimetre before the point."""
    visible = []
    for point in points:
        length = np.linalg.norm(point - eye)
        ahead = (point - eye) / length
        origin = (eye + NEAR_M * ahead - middle).astype(np.float32)
        to_point = (length - NEAR_M - END_M) * ahead
        vector = to_point.astype(np.float32)
        is_blocked = caster.is_blocked(origin[None], vector[None])
        visible.append(not is_blocked[0])

    return np.array(visible)


def _world(scene, runs, **options):
    """The world that runs are looked at in."""
    return build_world(
        scene,
        runs,
        n_points=N_POINTS,
        seed=0,
        **options,
    )


def _look(world, eye_m, **options):
    """What is seen from a place, by default up to a kilometre away."""
    defaults = {"near_m": NEAR_M, "max_distance_m": FAR_M}
    limits = defaults | options
    eye = np.array(eye_m)
    return cast_sight(world, eye, **limits)


def _visible_by_frame(sight):
    """Points that are seen in each frame, (n_frames, n_points)."""
    nothing = np.zeros((1, N_POINTS), dtype=bool)
    rows = np.vstack([sight.is_visible, nothing])
    return rows[sight.entry_of_frame]


def _compare(scene, runs, eye, frames):
    """Points that are as by single rays or graze, and shares seen, by frame."""
    world = _world(scene, runs)
    sight = _look(world, eye)
    rng = default_rng(5)
    places = [(run, local) for run in runs for local in range(len(run.time_s))]
    same = []
    grazing = []
    seen = []
    for frame in frames:
        run, local = places[frame]
        surface = next(
            s
            for s in world.surfaces
            if s.actor is run.encounter.vru and s.shape_index == run.vru_shape[local]
        )
        # The middle only keeps the numbers small: rays are cast in single precision.
        middle = np.append(run.vru_position_m[local], 0.0)
        pose = Pose(position_m=middle, yaw_deg=run.vru_yaw_deg[local])
        points = to_world(surface.points_m, pose)
        parts = parts_of_frame(scene, run, local)
        vertices_m, triangles, _ = one_mesh(parts)
        caster = CASTERS["embree"](vertices_m - middle, triangles)

        expected = _naive_visible(caster, middle, eye, points)
        is_grazing = np.zeros(N_POINTS, dtype=bool)
        for shake in rng.normal(scale=SHAKE_M, size=(N_SHAKEN, 3)):
            shake_m = rng.normal(scale=SHAKE_M, size=3)
            beside = eye + shake_m
            shaken = _naive_visible(
                caster,
                middle,
                beside,
                points + shake,
            )
            is_grazing |= shaken != expected

        entry = sight.entry_of_frame[frame]
        actual = np.zeros(N_POINTS, dtype=bool)
        if entry >= 0:
            actual = sight.is_visible[entry]

        assert (entry >= 0) == actual.any()

        same.append(actual == expected)
        grazing.append(is_grazing)
        seen.append(expected.mean())

    return np.array(same), np.array(grazing), np.array(seen)


def _assert_same(same, grazing):
    """Rays agree in nearly all points, and wherever none grazes."""
    assert same.mean() >= 0.995
    assert grazing.mean() <= 0.2  # or else nothing would be compared
    assert same[~grazing].all()


def _random_runs(build_run, rng, n_frames, *, vut_between_of, obstruction=()):
    """Random places; the VUT stands between eye and VRU in about half of the frames."""
    vru = poses_within(rng, n_frames, 12.0)
    vut = poses_within(rng, n_frames, 20.0)
    between = rng.random(n_frames) < 0.5
    share = rng.uniform(0.4, 0.9, (n_frames, 1))
    to_vru = vru[:, :2] - vut_between_of
    on_the_way = vut_between_of + share * to_vru
    vut[between, :2] = on_the_way[between]

    # Bodies that stand in one another are no sight worth seeing.
    offset_m = (vru - vut)[:, :2]
    distance_m = np.hypot(*offset_m.T)
    apart = distance_m > 3.2
    return tuple(
        build_run(
            vru[apart][part::2],
            vut[apart][part::2],
            vru=body,
            obstruction=obstruction,
            name=f"run-{body}",
        )
        for part, body in enumerate(("adult", "cyclist"))
    )


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_sight_is_what_rays_one_by_one_see_in_the_world(build_scene, build_run, seed):
    rng = default_rng(seed)
    eye = np.array([*rng.uniform(-15, 15, 2), rng.uniform(1.0, 8.0)])
    scene = build_scene(*WALLS)
    runs = _random_runs(build_run, rng, 24, vut_between_of=eye[:2])
    n_frames = sum(len(run.time_s) for run in runs)

    same, grazing, seen = _compare(scene, runs, eye, range(n_frames))
    is_hidden = (seen == 0.0).any()

    _assert_same(same, grazing)

    # The worlds are worth the test: some VRUs are seen, some in part only, some not.
    assert 0.0 < np.median(seen) < 0.6
    assert is_hidden or (seen < 0.2).any()


@pytest.mark.long
def test_sight_is_the_naive_one_with_parked_bodies_of_one_run_only(
    build_scene, build_run
):
    eye = np.array([-14.0, -3.0, 2.5])
    plain, cyclist = _random_runs(
        build_run,
        default_rng(11),
        30,
        vut_between_of=eye[:2],
    )
    parked = (
        parked_at("parked-van", -9.0, -2.0, 80.0),
        parked_at("parked-car-large", -6.0, 4.0, 15.0),
    )
    by_parked = replace(plain, id="parked", obstruction=parked)
    runs = (plain, by_parked, cyclist)
    n = len(plain.time_s)

    same, grazing, seen = _compare(
        build_scene(*WALLS),
        runs,
        eye,
        range(2 * n),
    )
    seen_parked = seen[n:].sum()
    seen_plain = seen[:n].sum()
    is_less = seen[n:] <= seen[:n] + 1e-12

    _assert_same(same, grazing)

    # The van hides something, and only in its own run.
    assert seen_parked < 0.8 * seen_plain
    assert is_less.all()


def test_worlds_that_share_a_scene_are_seen_as_each_alone(build_scene, build_run):
    """Other things stand there, and some views are asked for only later."""
    rng = default_rng(21)
    scene = build_scene(*WALLS)
    middle_m = np.zeros(2)
    runs = _random_runs(build_run, rng, 24, vut_between_of=middle_m)
    common = build_shared_scene(
        scene,
        runs,
        n_points=N_POINTS,
        seed=0,
        caches="all",
    )
    eyes = rng.uniform([-15, -15, 1], [15, 15, 8], (3, 3))
    n_hidden = set()

    for _ in range(3):
        east_m, north_m = rng.uniform(-10, 10, 2)
        van = parked_at(
            "parked-van",
            east_m,
            north_m,
            rng.uniform(-180, 180),
        )
        with_van = replace(runs[1], obstruction=(van,))
        changed = [runs[0], with_van]
        sharing = _world(scene, changed, shared=common)
        apart = _world(scene, changed)
        n_views = len(sharing.views.yaw_deg)
        drawn = rng.random(n_views)
        is_asked = drawn < 0.6
        views = {
            "near_m": NEAR_M,
            "is_asked": is_asked,
            "is_foreseen": is_asked,
        }

        for eye in eyes:
            cached = cast_sight(sharing, eye, **views)

            alone = cast_sight(apart, eye, **views)

            for name in (
                "view_index",
                "is_visible",
                "is_whole",
                "visible_share",
                "entry_of_frame",
            ):
                expected = getattr(alone, name)
                found = getattr(cached, name)
                assert np.array_equal(found, expected)

            n_invisible = (~cached.is_visible).sum()
            n_hidden.add(int(n_invisible))

    assert len(n_hidden) > 3


def test_no_entry_is_a_frame_in_which_nothing_is_seen(build_scene, build_run):
    wall = (
        (3.0, -20.0, 0.0),
        (3.4, 20.0, 9.0),
    )
    run = build_run(
        [
            [9.0, 0.0, 0.0],
            [-9.0, 0.0, 0.0],
            [9.0, 2.0, 30.0],
            [0.0, 3.0, 0.0],
        ]
    )

    world = _world(build_scene(wall), [run])
    sight = _look(world, [-3.0, 0.0, 4.0])
    is_left_out = (sight.entry_of_frame == -1).tolist()
    has_points = sight.is_visible.any(axis=1)

    assert is_left_out == [True, False, True, False]
    assert has_points.all()
    assert sight.is_whole.all()


def test_bodies_beyond_the_distance_are_not_looked_at(build_scene, build_run):
    places = [[10.0, 0.0, 0.0], [30.0, 0.0, 0.0]]
    run = build_run(places)
    world = _world(build_scene(), [run])

    sight = _look(world, [0.0, 0.0, 3.0], max_distance_m=20.0)
    is_entered = (sight.entry_of_frame >= 0).tolist()

    assert is_entered == [True, False]


@pytest.mark.parametrize(
    ("near_m", "is_seen"),
    [
        (0.1, False),
        (0.45, True),
    ],
)
def test_what_is_nearer_than_the_near_distance_hides_nothing(
    build_scene, build_run, near_m, is_seen
):
    plate = (
        (0.2, -1.0, 2.0),
        (0.3, 1.0, 4.0),
    )
    run = build_run([[10.0, 0.0, 0.0]])

    world = _world(build_scene(plate), [run])

    sight = _look(world, [0.0, 0.0, 3.0], near_m=near_m)
    has_entry = sight.entry_of_frame[0] >= 0

    assert has_entry == is_seen


@pytest.mark.parametrize("seed", range(6))
def test_the_sieve_keeps_every_frame_in_which_the_vut_blocks_a_ray(
    build_scene, build_run, monkeypatch, seed
):
    rng = default_rng(100 + seed)
    place_m = rng.uniform(-8, 8, 2)
    height_m = rng.uniform(0.3, 9.0)
    eye = np.array([*place_m, height_m])
    runs = _random_runs(build_run, rng, 400, vut_between_of=eye[:2])
    world = _world(build_scene(), runs)
    sieve = casting._find_between
    sieved = []

    def watched(*given):
        sieved.append(sieve(*given))
        return sieved[-1]

    monkeypatch.setattr(casting, "_find_between", watched)
    with_sieve = _visible_by_frame(_look(world, eye))
    # Nothing passes a box as large.
    monkeypatch.setattr(casting, "AROUND_BODY_M", 1.0e6)
    without = _visible_by_frame(_look(world, eye))

    assert np.array_equal(with_sieve, without)

    n_frames = sum(len(run.time_s) for run in runs)
    n_sieved = len(sieved[1][0])

    assert 0 < n_sieved < 0.8 * n_frames


@pytest.mark.long
@pytest.mark.system
def test_both_ray_libraries_see_the_same(build_scene, build_run):
    if raycast.open3d_problem() is not None:
        pytest.skip("Open3D cannot load here")

    rng = default_rng(2)
    eye = np.array([-13.0, -9.0, 5.0])
    runs = _random_runs(build_run, rng, 60, vut_between_of=eye[:2])
    scene = build_scene(*WALLS)
    seen = []

    for name in CASTERS:
        world = _world(scene, runs, rays=name)
        shared = world.shared
        casters = (shared.caster, *shared.bodies, *world.vehicles.casters)
        kinds = {type(caster) for caster in casters}

        assert kinds == {CASTERS[name]}

        sight = _look(world, eye)
        visible = _visible_by_frame(sight)
        seen.append(visible)

    first, second = seen

    assert first.any()
    assert (first == second).mean() >= 0.999


def test_equal_obstructions_are_one_static_world(build_scene, build_run):
    van = parked_at("parked-van", 3.0, 2.0, 5.0)
    here = (van,)
    van_again = parked_at("parked-van", 3.0, 2.0, 5.0)
    again = (van_again,)
    van_elsewhere = parked_at("parked-van", 3.5, 2.0, 5.0)
    elsewhere = (van_elsewhere,)
    runs = [
        build_run([[10.0, 0.0, 0.0]], obstruction=obstruction, name=f"{number}")
        for number, obstruction in enumerate((here, (), again, elsewhere))
    ]

    world = _world(build_scene(), runs)
    steps = np.diff(world.standing.first)

    assert steps.tolist() == [1, 0, 1]
    assert len(world.standing.casters) == 1

    obstruction = world.views.obstruction_index[world.views.view_of_frame]

    assert obstruction[0] == obstruction[2]
    assert len(world.views.yaw_deg) == 3


def test_the_same_pose_at_another_speed_is_cast_once(study_runs):
    world = _world(load_study_scene(), study_runs)
    n_frames = sum(len(run.time_s) for run in study_runs)
    n_views = len(world.views.yaw_deg)

    assert len(world.views.view_of_frame) == n_frames
    # Two speeds per placement: half of the views, or fewer where the VRU still waits.
    assert n_views <= 0.5 * n_frames

    in_scene_m = world.views.position_m[world.views.view_of_frame]
    position = in_scene_m + world.origin_m[:2]

    positions = [run.vru_position_m for run in study_runs]
    expected = np.concatenate(positions)
    vut = world.vehicles.actors[0]

    assert position == pytest.approx(expected, abs=1e-4)
    assert load_actors()["vut"] is vut
