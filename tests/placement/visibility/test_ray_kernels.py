from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from geometry.actors import PlacedActor
from geometry.poses import Pose
from geometry.raycast import build_caster
from geometry.study_scene import load_study_scene
from placement.visibility import casting, ray_kernels
from placement.visibility.build import N_POINTS
from placement.visibility.casting import build_world, cast_sight
from placement.visibility.ray_kernels import (
    N_AROUND,
    N_UP,
    BodyViews,
    Rays,
    find_unclear_points,
    mark_nearest,
)

WALLS = (
    ((4, -6, 0), (4.3, 1, 2.2)),
    ((-9, 3, 0), (-2, 3.4, 1.2)),
    ((8, -9, 0), (12, -5, 6)),
)


class Counter:
    """A caster that counts its rays."""

    def __init__(self, caster):
        self.caster = caster
        self.n_rays = 0

    def is_blocked(self, origins_m, vectors_m):
        self.n_rays += len(origins_m)
        return self.caster.is_blocked(origins_m, vectors_m)


def _sight_and_rays(world, eye, **options):
    scene = Counter(world.shared.caster)
    vut = Counter(world.vehicles.casters[0])
    parked = [Counter(caster) for caster in world.standing.casters]
    counted = replace(
        world,
        shared=replace(world.shared, caster=scene),
        standing=replace(world.standing, casters=tuple(parked)),
        vehicles=replace(world.vehicles, casters=(vut,)),
    )
    options = {"near_m": 0.35, "max_distance_m": 300.0} | options
    sight = cast_sight(counted, eye, **options)
    return sight, scene.n_rays + sum(each.n_rays for each in parked), vut.n_rays


def _assert_nothing_is_missed(world, eye, monkeypatch, **options):
    """The same is seen where every ray is cast; returns the shares of the rays that are
    needed.
    """
    sight, n_static, n_vut = _sight_and_rays(world, eye, **options)
    with monkeypatch.context() as patch:
        patch.setattr(
            ray_kernels, "find_unclear_points", lambda *given: given[-1].fill(True)
        )
        patch.setattr(casting, "AROUND_BODY_M", 1.0e6)
        every, n_every_static, n_every_vut = _sight_and_rays(world, eye, **options)

    for field in fields(sight):
        assert np.array_equal(getattr(sight, field.name), getattr(every, field.name)), (
            field.name
        )

    return n_static / n_every_static, n_vut / max(n_every_vut, 1)


@pytest.mark.parametrize("for_lidar", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_no_ray_is_spared_that_something_stops(
    build_scene, build_run, actors, monkeypatch, seed, for_lidar
):
    rng = np.random.default_rng(seed)
    boxes = []
    for _ in range(12):
        corner = np.append(
            rng.uniform(-25.0, 25.0, 2), rng.choice([0.0, rng.uniform(0.5, 4.0)])
        )
        boxes.append((corner, corner + rng.uniform(0.05, 4.0, 3)))

    van = PlacedActor(
        actor=actors["parked-van"],
        pose=Pose(
            position_m=[*rng.uniform(-9.0, 9.0, 2), 0.0], yaw_deg=rng.uniform(-180, 180)
        ),
    )
    vru = np.column_stack([rng.uniform(-30, 30, (300, 2)), rng.uniform(-180, 180, 300)])
    vut = vru + np.column_stack(
        [rng.uniform(-7, 7, (300, 2)), rng.uniform(-180, 180, 300)]
    )
    runs = [
        build_run(vru[:200], vut[:200], vru="adult", name="a"),
        build_run(vru[200:], vut[200:], vru="cyclist", obstruction=(van,), name="b"),
    ]
    world = build_world(build_scene(*boxes), runs, n_points=N_POINTS, seed=0)
    eye = np.array([*rng.uniform(-20.0, 20.0, 2), rng.uniform(0.3, 9.0)])
    shares = _assert_nothing_is_missed(world, eye, monkeypatch, for_lidar=for_lidar)

    assert shares[0] < 0.8


@pytest.mark.long
def test_no_ray_is_spared_that_something_stops_at_the_studys_junction(
    study_runs, monkeypatch
):
    scene = load_study_scene()
    world = build_world(scene, study_runs, n_points=N_POINTS, seed=0)
    rng = np.random.default_rng(3)

    for site in rng.choice(len(scene.sites), 4, replace=False):
        eye = scene.sites[site].position_m + [0.3, 0.2, 6.0]
        shares = _assert_nothing_is_missed(world, eye, monkeypatch, near_m=0.5)
        assert shares[0] < 0.5
        assert shares[1] < 0.8


def test_from_within_the_box_of_a_parked_body_all_rays_are_cast(
    build_scene, build_run, actors, monkeypatch
):
    van = PlacedActor(
        actor=actors["parked-van"], pose=Pose(position_m=[0.0, 0.0, 0.0], yaw_deg=20.0)
    )
    run = build_run([[8.0, 1.0, 0.0], [-9.0, 2.0, 50.0]], obstruction=(van,))
    world = build_world(build_scene(), [run], n_points=N_POINTS, seed=0)
    inside = np.array([0.5, 0.0, 1.2])
    # All of those to the van, none of as many to the empty scene.
    shares = _assert_nothing_is_missed(world, inside, monkeypatch)

    assert shares[0] == 0.5

    shares = _assert_nothing_is_missed(world, np.array([0.5, 0.0, 6.0]), monkeypatch)

    assert shares[0] < 0.5


@given(st.integers(0, 2**32 - 1))
def test_a_point_that_a_triangle_hides_is_never_clear(seed):
    """Triangles of all sizes, near and far, above and below, round the eye and beside
    it.
    """
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.uniform(-2.0, 2.0, (8, 1, 1))
    triangles = rng.uniform(-20.0, 20.0, (8, 1, 3)) + sizes * rng.uniform(
        -1.0, 1.0, (8, 3, 3)
    )
    eye = rng.uniform(-5.0, 5.0, 3)
    # Half of the points are just behind a triangle.
    shares = rng.dirichlet(np.ones(3), (8, 50))
    behind = np.einsum("ijk,ikl->ijl", shares, triangles).reshape(-1, 3)
    behind = eye + (behind - eye) * rng.uniform(1.001, 1.5, (400, 1))
    points = np.concatenate([behind, rng.uniform(-60.0, 60.0, (400, 3))])
    nearest = np.full((N_UP, N_AROUND), np.inf, dtype=np.float32)
    limits = (points[:, 2].min(), points[:, 2].max())
    mark_nearest(nearest, triangles, eye, 0.1, 300.0, *limits)
    axes = points.astype(np.float32).reshape(10, 80, 3).swapaxes(1, 2).copy()
    middle = axes.mean(axis=2, dtype=np.float64)
    radius = np.linalg.norm(axes - middle[:, :, None], axis=1).max(axis=1)
    unclear = np.zeros((10, 80), dtype=bool)
    find_unclear_points(
        nearest, BodyViews(axes, middle, radius), eye, np.arange(10), unclear
    )
    asked = np.ones((10, 80), dtype=bool)
    starts, vectors = (np.empty((800, 3), np.float32) for _ in range(2))
    rays = Rays(0.1, 1.0e-3, starts, vectors)
    ray_kernels.fill_rays(axes, np.arange(10), asked, eye, rays)
    caster = build_caster(triangles.reshape(-1, 3), np.arange(24).reshape(8, 3))
    blocked = caster.is_blocked(starts, vectors).reshape(10, 80)

    assert not (blocked & ~unclear).any()


def test_where_nothing_is_nearer_nothing_is_asked():
    """A ball 10 m away: points before, beside and below it are clear."""
    ball = trimesh.creation.icosphere(radius=1.0).triangles + [10.0, 0.0, 0.0]
    nearest = np.full((N_UP, N_AROUND), np.inf, dtype=np.float32)
    eye = np.zeros(3)
    mark_nearest(nearest, ball, eye, 0.1, 100.0, -20.0, 20.0)
    points = np.array(
        [
            [8.5, 0, 0],
            [20, 0, 0],
            [20, 3.0, 0],
            [20, 0, -3.0],
            [-20, 0, 0],
            [20.0, 1.5, 0.5],
        ]
    )
    axes = points.astype(np.float32)[:, :, None].copy()
    unclear = np.zeros((6, 1), dtype=bool)
    find_unclear_points(
        nearest, BodyViews(axes, points, np.zeros(6)), eye, np.arange(6), unclear
    )

    assert unclear[:, 0].tolist() == [False, True, False, False, False, True]

    # Of all directions it fills the share of a cone of 5.7 degrees, and little more.
    share = np.isfinite(nearest).mean()
    cone = 0.5 * (1.0 - np.sqrt(0.99))

    assert cone < share < 3.0 * cone


def test_the_ground_below_all_feet_and_what_is_above_the_lens_count_for_nothing():
    ground = np.array([[[-50.0, -50, 0], [50, -50, 0], [50, 50, 0]]])
    roof = ground + [0.0, 0.0, 7.0]
    for triangles, is_in_the_way in (
        (ground, False),
        (roof, False),
        (ground + 0.1, True),
    ):
        nearest = np.full((N_UP, N_AROUND), np.inf, dtype=np.float32)
        mark_nearest(
            nearest, triangles, np.array([1.0, 2.0, 6.0]), 0.1, 100.0, 0.0, 1.8
        )
        assert np.isfinite(nearest).any() == is_in_the_way
