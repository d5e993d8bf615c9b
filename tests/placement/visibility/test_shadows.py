from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from geometry.actors import PlacedActor, load_actors
from geometry.poses import Pose
from geometry.raycast import build_caster
from geometry.study_scene import load_study_scene
from placement.visibility import casting, own_shadows, ray_kernels, shadow_kernels
from placement.visibility.build import N_POINTS
from placement.visibility.casting import build_world, cast_sight
from placement.visibility.own_shadows import find_own_visible, planes_around
from placement.visibility.shadow_kernels import (
    N_AROUND,
    N_UP,
    find_unclear_points,
    mark_covered,
    mark_nearest,
)
from placement.visibility.surfaces import build_surface

EVERY_BLOCK = np.ones((N_UP // 8, N_AROUND // 8), dtype=bool)
WALLS = (((4, -6, 0), (4.3, 1, 2.2)), ((-9, 3, 0), (-2, 3.4, 1.2)), ((8, -9, 0), (12, -5, 6)))


class Counter:
    """A caster that counts its rays."""

    def __init__(self, caster):
        self.caster, self.n_rays = caster, 0

    def is_blocked(self, origins_m, vectors_m):
        self.n_rays += len(origins_m)
        return self.caster.is_blocked(origins_m, vectors_m)


def _sight_and_rays(world, eye, **options):
    scene, vut = Counter(world.lasting.caster), Counter(world.vehicles.casters[0])
    parked = [Counter(caster) for caster in world.standing.casters]
    counted = replace(
        world,
        lasting=replace(world.lasting, caster=scene),
        standing=replace(world.standing, casters=tuple(parked)),
        vehicles=replace(world.vehicles, casters=(vut,)),
    )
    options = {"near_m": 0.35, "max_distance_m": 300.0} | options
    sight = cast_sight(counted, eye, **options)
    return sight, scene.n_rays + sum(each.n_rays for each in parked), vut.n_rays


def _assert_nothing_is_missed(world, eye, monkeypatch, **options):
    """The same is seen where every ray is cast; returns the shares of the rays that are needed."""
    sight, n_static, n_vut = _sight_and_rays(world, eye, **options)
    with monkeypatch.context() as patch:
        patch.setattr(shadow_kernels, "find_unclear_points", lambda *given: given[-1].fill(True))
        patch.setattr(casting, "AROUND_BODY_M", 1.0e6)
        nothing = np.zeros((N_POINTS, 1, 3))
        patch.setattr(own_shadows, "planes_around", lambda surface: nothing)
        every, n_every_static, n_every_vut = _sight_and_rays(world, eye, **options)
    for field in fields(sight):
        assert np.array_equal(getattr(sight, field.name), getattr(every, field.name)), field.name
    return n_static / n_every_static, n_vut / max(n_every_vut, 1)


@pytest.mark.parametrize("for_lidar", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_no_ray_is_spared_that_something_stops(
    build_scene, build_run, actors, monkeypatch, seed, for_lidar
):
    rng = np.random.default_rng(seed)
    boxes = []
    for _ in range(12):
        corner = np.append(rng.uniform(-25.0, 25.0, 2), rng.choice([0.0, rng.uniform(0.5, 4.0)]))
        boxes.append((corner, corner + rng.uniform(0.05, 4.0, 3)))
    van = PlacedActor(
        actor=actors["parked-van"],
        pose=Pose(position_m=[*rng.uniform(-9.0, 9.0, 2), 0.0], yaw_deg=rng.uniform(-180, 180)),
    )
    vru = np.column_stack([rng.uniform(-30, 30, (300, 2)), rng.uniform(-180, 180, 300)])
    vut = vru + np.column_stack([rng.uniform(-7, 7, (300, 2)), rng.uniform(-180, 180, 300)])
    runs = [
        build_run(vru[:200], vut[:200], vru="adult", name="a"),
        build_run(vru[200:], vut[200:], vru="cyclist", obstruction=(van,), name="b"),
    ]
    world = build_world(build_scene(*boxes), runs, n_points=N_POINTS, seed=0)
    eye = np.array([*rng.uniform(-20.0, 20.0, 2), rng.uniform(0.3, 9.0)])
    shares = _assert_nothing_is_missed(world, eye, monkeypatch, for_lidar=for_lidar)
    assert shares[0] < 0.8


@pytest.mark.long
def test_no_ray_is_spared_that_something_stops_at_the_studys_junction(study_runs, monkeypatch):
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
def test_a_point_that_a_triangle_hides_is_never_clear_and_one_that_none_hides_never_hidden(seed):
    """Triangles of all sizes, near and far, above and below, round the eye and beside it."""
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.uniform(-2.0, 2.0, (8, 1, 1))
    triangles = rng.uniform(-20.0, 20.0, (8, 1, 3)) + sizes * rng.uniform(-1.0, 1.0, (8, 3, 3))
    eye = rng.uniform(-5.0, 5.0, 3)
    # Half of the points are just behind a triangle.
    shares = rng.dirichlet(np.ones(3), (8, 50))
    behind = np.einsum("ijk,ikl->ijl", shares, triangles).reshape(-1, 3)
    behind = eye + (behind - eye) * rng.uniform(1.001, 1.5, (400, 1))
    points = np.concatenate([behind, rng.uniform(-60.0, 60.0, (400, 3))])
    nearest = np.full((N_UP, N_AROUND), np.inf, dtype=np.float32)
    limits = (points[:, 2].min(), points[:, 2].max())
    mark_nearest(nearest, triangles, eye, 0.1, 300.0, *limits)
    covered = np.full_like(nearest, np.inf)
    mark_covered(covered, triangles, eye, 0.1, *limits, EVERY_BLOCK)
    axes = points.astype(np.float32).reshape(10, 80, 3).swapaxes(1, 2).copy()
    middle = axes.mean(axis=2, dtype=np.float64)
    radius = np.linalg.norm(axes - middle[:, :, None], axis=1).max(axis=1)
    hidden, unclear = (np.zeros((10, 80), dtype=bool) for _ in range(2))
    views = (axes, middle, radius, eye, np.arange(10))
    find_unclear_points(nearest, covered, *views, hidden, unclear)
    asked = np.ones((10, 80), dtype=bool)
    starts, vectors = (np.empty((800, 3), np.float32) for _ in range(2))
    ray_kernels.fill_rays(axes, np.arange(10), asked, eye, 0.1, 1.0e-3, starts, vectors)
    caster = build_caster(triangles.reshape(-1, 3), np.arange(24).reshape(8, 3))
    blocked = caster.is_blocked(starts, vectors).reshape(10, 80)
    assert not (blocked & ~unclear & ~hidden).any()
    assert not (hidden & ~blocked).any()


def test_where_nothing_is_nearer_nothing_is_asked():
    """A ball 10 m away: points before, beside and below it are clear."""
    ball = trimesh.creation.icosphere(radius=1.0).triangles + [10.0, 0.0, 0.0]
    nearest = np.full((N_UP, N_AROUND), np.inf, dtype=np.float32)
    eye = np.zeros(3)
    mark_nearest(nearest, ball, eye, 0.1, 100.0, -20.0, 20.0)
    points = np.array(
        [[8.5, 0, 0], [20, 0, 0], [20, 3.0, 0], [20, 0, -3.0], [-20, 0, 0], [20.0, 1.5, 0.5]]
    )
    axes = points.astype(np.float32)[:, :, None].copy()
    hidden, unclear = (np.zeros((6, 1), dtype=bool) for _ in range(2))
    covered = np.full_like(nearest, np.inf)
    views = (axes, points, np.zeros(6), eye, np.arange(6))
    find_unclear_points(nearest, covered, *views, hidden, unclear)
    assert not hidden.any()
    assert unclear[:, 0].tolist() == [False, True, False, False, False, True]
    # Of all directions it fills the share of a cone of 5.7 degrees, and little more.
    share = np.isfinite(nearest).mean()
    cone = 0.5 * (1.0 - np.sqrt(0.99))
    assert cone < share < 3.0 * cone


def test_the_ground_below_all_feet_and_what_is_above_the_lens_count_for_nothing():
    ground = np.array([[[-50.0, -50, 0], [50, -50, 0], [50, 50, 0]]])
    roof = ground + [0.0, 0.0, 7.0]
    for triangles, is_in_the_way in ((ground, False), (roof, False), (ground + 0.1, True)):
        nearest = np.full((N_UP, N_AROUND), np.inf, dtype=np.float32)
        mark_nearest(nearest, triangles, np.array([1.0, 2.0, 6.0]), 0.1, 100.0, 0.0, 1.8)
        assert np.isfinite(nearest).any() == is_in_the_way


def test_behind_a_wall_all_is_hidden_but_at_its_rims():
    wall = np.array([[[10, -4, 0], [10, 4, 0], [10, 4, 5]], [[10, -4, 0], [10, 4, 5], [10, -4, 5]]])
    eye = np.array([0.0, 0.0, 2.5])
    nearest, covered = (np.full((N_UP, N_AROUND), np.inf, dtype=np.float32) for _ in range(2))
    mark_nearest(nearest, wall.astype(float), eye, 0.1, 100.0, -20.0, 20.0)
    mark_covered(covered, wall.astype(float), eye, 0.1, -20.0, 20.0, EVERY_BLOCK)
    # A cell that it fills is one that it touches, and most of those are filled: not at its rims
    # and at the seam of its triangles.
    filled, touched = np.isfinite(covered), np.isfinite(nearest)
    assert not (filled & ~touched).any()
    assert 0.8 * touched.sum() < filled.sum() < touched.sum()
    distance = 10.0 / covered[filled]
    assert (distance <= 1.0).all()
    # Nothing before the wall, or beside it; behind it all of a small body, and part of a wide one.
    points = np.array([[9.5, 1, 1], [20, 3, 2.2], [20, 12, 2], [20, 3, 2], [20, 8.0, 2]])
    axes = np.stack([points, points + [0.0, 1.0, 0.0]], axis=2).astype(np.float32)
    hidden, unclear = (np.zeros((5, 2), dtype=bool) for _ in range(2))
    views = (axes, axes.mean(axis=2, dtype=float), np.full(5, 0.6), eye, np.arange(5))
    find_unclear_points(nearest, covered, *views, hidden, unclear)
    assert hidden[[0, 1, 2, 3]].all(axis=1).tolist() == [False, True, False, True]
    assert not unclear[:4].any()
    assert hidden[4].tolist() == [False, False]


@given(st.integers(0, 2**32 - 1))
def test_what_planes_say_that_a_body_hides_of_itself_rays_say_too(seed):
    rng = np.random.default_rng(seed)
    actor = load_actors()[rng.choice(["adult", "child", "cyclist"])]
    surface = build_surface(actor, int(rng.integers(8)), n_points=N_POINTS, seed=0)
    shape = actor.shapes[surface.shape_index]
    caster = Counter(build_caster(shape.vertices_m, shape.triangles))
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    eyes = 10.0 ** rng.uniform(-0.5, 2.0, (20, 1)) * directions
    looks = {"surface_index": np.zeros(20, dtype=int), "eye_m": eyes}
    visible = find_own_visible([surface], [caster], **looks)
    n_rays = caster.n_rays
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(own_shadows, "planes_around", lambda surface: np.zeros((N_POINTS, 1, 3)))
        every = find_own_visible([surface], [caster], **looks)
    assert (visible == every).all()
    assert n_rays < caster.n_rays - n_rays == visible.size


def test_of_a_mesh_that_is_open_or_inside_out_nothing_is_said(actors):
    surface = build_surface(actors["adult"], 0, n_points=N_POINTS, seed=0)
    shape = actors["adult"].shapes[0]
    assert (planes_around(surface) != 0.0).any(axis=(1, 2)).mean() > 0.7
    for triangles in (shape.triangles[1:], shape.triangles[:, ::-1]):
        shapes = (replace(shape, triangles=triangles),)
        other = replace(actors["adult"], shapes=shapes, cycle_m=0.0)
        assert not planes_around(replace(surface, actor=other)).any()
