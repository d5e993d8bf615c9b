"""What rays see of bodies, against rays cast one by one."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_worlds import WALLS

from geometry import raycast
from geometry.actors import PlacedActor, load_actors
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


def _placed(shape, position_m, yaw_deg):
    """Vertices of a shape that stands in the world, and its triangles. [m]"""
    return (
        to_world(
            shape.vertices_m,
            Pose(position_m=np.append(position_m, 0.0), yaw_deg=yaw_deg),
        ),
        shape.triangles,
    )


def _vru_shape(run, frame):
    """Shape of the VRU in a frame."""
    return run.encounter.vru.shapes[run.vru_shape[frame]]


def _naive_caster(scene, run, frame, library):
    """One mesh of everything, in the world frame, as it stands in one frame."""
    bodies = [
        (scene.vertices_m, scene.triangles),
        *(
            _placed(
                parked.actor.shapes[0], parked.pose.position_m[:2], parked.pose.yaw_deg
            )
            for parked in run.obstruction
        ),
        _placed(
            run.encounter.vut.shapes[0],
            run.vut_position_m[frame],
            run.vut_yaw_deg[frame],
        ),
        _placed(
            _vru_shape(run, frame), run.vru_position_m[frame], run.vru_yaw_deg[frame]
        ),
    ]
    first = np.cumsum([0, *(len(vertices) for vertices, _ in bodies)])
    # The middle only keeps the numbers small: rays are cast in single precision.
    middle = np.append(run.vru_position_m[frame], 0.0)
    caster = CASTERS[library](
        np.concatenate([vertices for vertices, _ in bodies]) - middle,
        np.concatenate(
            [triangles + n for (_, triangles), n in zip(bodies, first, strict=False)]
        ),
    )
    return caster, middle


def _naive_visible(caster, middle, eye, points):
    """Ray by ray: start `NEAR_M` from the eye, end a millimetre before the point."""
    visible = []
    for point in points:
        length = np.linalg.norm(point - eye)
        ahead = (point - eye) / length
        origin = (eye + NEAR_M * ahead - middle).astype(np.float32)
        vector = ((length - NEAR_M - END_M) * ahead).astype(np.float32)
        visible.append(not caster.is_blocked(origin[None], vector[None])[0])

    return np.array(visible)


def _compare(scene, runs, eye, frames, *, library="embree"):
    """Agreement with the naive oracle: (same, grazing) per point, over the frames asked
    for.
    """
    world = build_world(scene, runs, n_points=N_POINTS, seed=0)
    sight = cast_sight(world, np.asarray(eye), near_m=NEAR_M, max_distance_m=FAR_M)
    rng = np.random.default_rng(5)
    run_of = np.repeat(np.arange(len(runs)), [len(run.time_s) for run in runs])
    first = np.cumsum([0, *(len(run.time_s) for run in runs)])
    same = []
    grazing = []
    seen = []
    for frame in frames:
        run = runs[run_of[frame]]
        local = frame - first[run_of[frame]]
        surface = next(
            s
            for s in world.surfaces
            if s.actor is run.encounter.vru and s.shape_index == run.vru_shape[local]
        )
        points, _ = _placed(
            replace(_vru_shape(run, local), vertices_m=surface.points_m),
            run.vru_position_m[local],
            run.vru_yaw_deg[local],
        )
        caster, middle = _naive_caster(scene, run, local, library)
        expected = _naive_visible(caster, middle, eye, points)
        shaken = np.array(
            [
                _naive_visible(
                    caster,
                    middle,
                    eye + rng.normal(scale=SHAKE_M, size=3),
                    points + shake,
                )
                for shake in rng.normal(scale=SHAKE_M, size=(N_SHAKEN, 3))
            ]
        )
        entry = sight.entry_of_frame[frame]
        if entry >= 0:
            actual = sight.is_visible[entry]
        else:
            actual = np.zeros(N_POINTS, dtype=bool)

        assert (entry >= 0) == actual.any()

        same.append(actual == expected)
        grazing.append((shaken != expected).any(axis=0))
        seen.append(expected.mean())

    return np.array(same), np.array(grazing), np.array(seen)


def _assert_same(same, grazing):
    """Rays agree in nearly all points, and wherever none grazes."""
    assert same.mean() >= 0.995
    assert grazing.mean() <= 0.2  # or else nothing would be compared
    assert same[~grazing].all()


def _random_runs(build_run, rng, n_frames, *, vut_between_of, obstruction=()):
    """Random places; the VUT stands between eye and VRU in about half of the frames."""
    vru = np.column_stack(
        [rng.uniform(-12, 12, (n_frames, 2)), rng.uniform(-180, 180, n_frames)]
    )
    vut = np.column_stack(
        [rng.uniform(-20, 20, (n_frames, 2)), rng.uniform(-180, 180, n_frames)]
    )
    between = rng.random(n_frames) < 0.5
    share = rng.uniform(0.4, 0.9, (n_frames, 1))
    vut[between, :2] = (vut_between_of + share * (vru[:, :2] - vut_between_of))[between]
    # Bodies that stand in one another are no sight worth seeing.
    apart = np.hypot(*(vru - vut)[:, :2].T) > 3.2
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
    rng = np.random.default_rng(seed)
    eye = np.array([*rng.uniform(-15, 15, 2), rng.uniform(1.0, 8.0)])
    scene = build_scene(*WALLS)
    runs = _random_runs(build_run, rng, 24, vut_between_of=eye[:2])
    n_frames = sum(len(run.time_s) for run in runs)
    same, grazing, seen = _compare(scene, runs, eye, range(n_frames))

    _assert_same(same, grazing)

    # The worlds are worth the test: some VRUs are seen, some in part only, some not.
    assert 0.0 < np.median(seen) < 0.6
    assert (seen == 0.0).any() or (seen < 0.2).any()


@pytest.mark.long
def test_sight_is_the_naive_one_with_parked_bodies_of_one_run_only(
    build_scene, build_run, actors
):
    eye = np.array([-14.0, -3.0, 2.5])
    (plain, cyclist) = _random_runs(
        build_run, np.random.default_rng(11), 30, vut_between_of=eye[:2]
    )
    parked = tuple(
        PlacedActor(actor=actors[name], pose=Pose(position_m=[x, y, 0.0], yaw_deg=yaw))
        for name, x, y, yaw in (
            ("parked-van", -9.0, -2.0, 80.0),
            ("parked-car-large", -6.0, 4.0, 15.0),
        )
    )
    runs = (plain, replace(plain, id="parked", obstruction=parked), cyclist)
    n = len(plain.time_s)
    frames = range(2 * n)
    same, grazing, seen = _compare(build_scene(*WALLS), runs, eye, frames)

    _assert_same(same, grazing)

    # The van hides something, and only in its own run.
    assert seen[n:].sum() < 0.8 * seen[:n].sum()
    assert (seen[n:] <= seen[:n] + 1e-12).all()


def test_worlds_that_share_a_scene_are_seen_as_each_alone(
    build_scene, build_run, actors
):
    """Other things stand there, and some views are asked for only later."""
    rng = np.random.default_rng(21)
    scene = build_scene(*WALLS)
    runs = _random_runs(build_run, rng, 24, vut_between_of=np.zeros(2))
    common = build_shared_scene(scene, runs, n_points=N_POINTS, seed=0, caches="all")
    eyes = rng.uniform([-15, -15, 1], [15, 15, 8], (3, 3))
    n_hidden = set()

    for _ in range(3):
        pose = Pose(
            position_m=[*rng.uniform(-10, 10, 2), 0.0], yaw_deg=rng.uniform(-180, 180)
        )
        parked = (PlacedActor(actor=actors["parked-van"], pose=pose),)
        changed = [runs[0], replace(runs[1], obstruction=parked)]
        options = {"n_points": N_POINTS, "seed": 0}
        worlds = [
            build_world(scene, changed, **options, shared=shared)
            for shared in (common, None)
        ]
        is_asked = rng.random(len(worlds[0].views.yaw_deg)) < 0.6

        for eye in eyes:
            cached, alone = (
                cast_sight(
                    world, eye, near_m=NEAR_M, is_asked=is_asked, is_foreseen=is_asked
                )
                for world in worlds
            )
            for name in (
                "view_index",
                "is_visible",
                "is_whole",
                "visible_share",
                "entry_of_frame",
            ):
                assert np.array_equal(getattr(cached, name), getattr(alone, name))
            n_hidden.add(int((~cached.is_visible).sum()))

    assert len(n_hidden) > 3


def test_no_entry_is_a_frame_in_which_nothing_is_seen(build_scene, build_run):
    wall = ((3.0, -20.0, 0.0), (3.4, 20.0, 9.0))
    run = build_run(
        [[9.0, 0.0, 0.0], [-9.0, 0.0, 0.0], [9.0, 2.0, 30.0], [0.0, 3.0, 0.0]]
    )
    world = build_world(build_scene(wall), [run], n_points=N_POINTS, seed=0)

    sight = cast_sight(
        world, np.array([-3.0, 0.0, 4.0]), near_m=NEAR_M, max_distance_m=FAR_M
    )

    assert (sight.entry_of_frame == -1).tolist() == [True, False, True, False]
    assert sight.is_visible.any(axis=1).all()
    assert sight.is_whole.all()


def test_bodies_beyond_the_distance_are_not_looked_at(build_scene, build_run):
    run = build_run([[10.0, 0.0, 0.0], [30.0, 0.0, 0.0]])
    world = build_world(build_scene(), [run], n_points=N_POINTS, seed=0)

    sight = cast_sight(
        world, np.array([0.0, 0.0, 3.0]), near_m=NEAR_M, max_distance_m=20.0
    )

    assert (sight.entry_of_frame >= 0).tolist() == [True, False]


def test_what_is_nearer_than_the_near_distance_hides_nothing(build_scene, build_run):
    plate = ((0.2, -1.0, 2.0), (0.3, 1.0, 4.0))
    run = build_run([[10.0, 0.0, 0.0]])
    world = build_world(build_scene(plate), [run], n_points=N_POINTS, seed=0)
    eye = np.array([0.0, 0.0, 3.0])

    seen = [
        cast_sight(world, eye, near_m=near, max_distance_m=FAR_M).entry_of_frame[0] >= 0
        for near in (0.1, 0.45)
    ]

    assert seen == [False, True]


@pytest.mark.parametrize("seed", range(6))
def test_the_sieve_keeps_every_frame_in_which_the_vut_blocks_a_ray(
    build_scene, build_run, monkeypatch, seed
):
    rng = np.random.default_rng(100 + seed)
    eye = np.array([*rng.uniform(-8, 8, 2), rng.uniform(0.3, 9.0)])
    runs = _random_runs(build_run, rng, 400, vut_between_of=eye[:2])
    world = build_world(build_scene(), runs, n_points=N_POINTS, seed=0)

    def cast():
        sight = cast_sight(world, eye, near_m=NEAR_M, max_distance_m=FAR_M)
        padded = np.vstack([sight.is_visible, np.zeros((1, N_POINTS), dtype=bool)])
        return padded[sight.entry_of_frame]

    sieve = casting._find_between
    sieved = []

    def watched(*given):
        sieved.append(sieve(*given))
        return sieved[-1]

    monkeypatch.setattr(casting, "_find_between", watched)
    with_sieve = cast()
    # Nothing passes a box as large.
    monkeypatch.setattr(casting, "AROUND_BODY_M", 1.0e6)

    assert np.array_equal(with_sieve, cast())

    n_frames = sum(len(run.time_s) for run in runs)

    assert 0 < len(sieved[1][0]) < 0.8 * n_frames


@pytest.mark.long
@pytest.mark.system
def test_both_ray_libraries_see_the_same(build_scene, build_run):
    if raycast.open3d_problem() is not None:
        pytest.skip("Open3D cannot load here")
    rng = np.random.default_rng(2)
    eye = np.array([-13.0, -9.0, 5.0])
    runs = _random_runs(build_run, rng, 60, vut_between_of=eye[:2])
    scene = build_scene(*WALLS)
    seen = {}

    for name in CASTERS:
        world = build_world(scene, runs, n_points=N_POINTS, seed=0, rays=name)

        assert {
            type(caster)
            for caster in (
                world.shared.caster,
                *world.shared.bodies,
                *world.vehicles.casters,
            )
        } == {CASTERS[name]}

        sight = cast_sight(world, eye, near_m=NEAR_M, max_distance_m=FAR_M)
        padded = np.vstack([sight.is_visible, np.zeros((1, N_POINTS), dtype=bool)])
        seen[name] = padded[sight.entry_of_frame]

    first, second = seen.values()

    assert first.any()
    assert (first == second).mean() >= 0.999


def test_equal_obstructions_are_one_static_world(build_scene, build_run, actors):
    def park(x_m):
        pose = Pose(position_m=[x_m, 2.0, 0.0], yaw_deg=5.0)
        return (PlacedActor(actor=actors["parked-van"], pose=pose),)

    runs = [
        build_run([[10.0, 0.0, 0.0]], obstruction=obstruction, name=f"{number}")
        for number, obstruction in enumerate((park(3.0), (), park(3.0), park(3.5)))
    ]
    world = build_world(build_scene(), runs, n_points=N_POINTS, seed=0)

    assert np.diff(world.standing.first).tolist() == [1, 0, 1]
    assert len(world.standing.casters) == 1

    obstruction = world.views.obstruction_index[world.views.view_of_frame]

    assert obstruction[0] == obstruction[2]
    assert len(world.views.yaw_deg) == 3


def test_the_same_pose_at_another_speed_is_cast_once(study_runs):
    world = build_world(load_study_scene(), study_runs, n_points=N_POINTS, seed=0)
    n_frames = sum(len(run.time_s) for run in study_runs)

    assert len(world.views.view_of_frame) == n_frames
    # Two speeds per placement: half of the views, or fewer where the VRU still waits.
    assert len(world.views.yaw_deg) <= 0.5 * n_frames

    position = world.views.position_m[world.views.view_of_frame] + world.origin_m[:2]

    assert position == pytest.approx(
        np.concatenate([run.vru_position_m for run in study_runs]), abs=1e-4
    )
    assert load_actors()["vut"] is world.vehicles.actors[0]
