"""Rays that are spared because nothing can stop them."""

from dataclasses import fields, replace

import numpy as np
import pytest
from placed_bodies import parked_at, poses_within

from placement.visibility import casting, ray_kernels
from placement.visibility.build import N_POINTS
from placement.visibility.casting import build_world, cast_sight
from placement.visibility.ray_kernels import (
    N_AROUND,
    N_UP,
    fill_own_rays,
    mark_nearest,
)


class Counter:
    """A caster that counts its rays."""

    def __init__(self, caster):
        self.caster = caster
        self.n_rays = 0

    def is_blocked(self, origins_m, vectors_m):
        self.n_rays += len(origins_m)
        return self.caster.is_blocked(origins_m, vectors_m)

    def first_triangle(self, origins_m, vectors_m):
        self.n_rays += len(origins_m)
        return self.caster.first_triangle(origins_m, vectors_m)


def _all_own_rays(own, *given):
    """Rays to all points of a body, whatever its faces say."""
    n_points = len(own.points)
    nowhere = np.full(n_points, np.inf)
    unlimited = own._replace(least_sine=nowhere)
    return fill_own_rays(unlimited, *given)


def _sight_and_rays(world, eye, **options):
    """What is seen, and how many rays each caster cast."""
    scene = Counter(world.shared.caster)
    vut = Counter(world.vehicles.casters[0])
    parked = [Counter(caster) for caster in world.standing.casters]
    standing = replace(world.standing, casters=tuple(parked))
    vehicles = replace(world.vehicles, casters=(vut,))
    counted = replace(
        world,
        shared=replace(world.shared, caster=scene),
        standing=standing,
        vehicles=vehicles,
    )
    defaults = {"near_m": 0.35, "max_distance_m": 300.0}
    options = defaults | options
    sight = cast_sight(counted, eye, **options)
    n_parked = sum(each.n_rays for each in parked)
    return sight, scene.n_rays + n_parked, vut.n_rays


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
        patch.setattr(
            casting,
            "_is_behind_one_triangle",
            lambda _shared, _eye, places, **_: np.zeros(len(places), dtype=bool),
        )
        patch.setattr(ray_kernels, "fill_own_rays", _all_own_rays)
        every, n_every_static, n_every_vut = _sight_and_rays(world, eye, **options)

    for field in fields(sight):
        expected = getattr(every, field.name)
        found = getattr(sight, field.name)
        assert np.array_equal(found, expected), field.name

    n_vut_rays = max(n_every_vut, 1)
    return n_static / n_every_static, n_vut / n_vut_rays


@pytest.mark.parametrize("for_lidar", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_no_ray_is_spared_that_something_stops(
    build_scene, build_run, monkeypatch, seed, for_lidar
):
    rng = np.random.default_rng(seed)
    boxes = []
    for _ in range(12):
        place = rng.uniform(-25.0, 25.0, 2)
        height_m = rng.uniform(0.5, 4.0)
        up_m = rng.choice([0.0, height_m])
        corner = np.append(place, up_m)
        other_corner = rng.uniform(0.05, 4.0, 3)
        boxes.append((corner, corner + other_corner))

    east_m, north_m = rng.uniform(-9.0, 9.0, 2)
    van = parked_at(
        "parked-van",
        east_m,
        north_m,
        rng.uniform(-180, 180),
    )
    vru = poses_within(rng, 300, 30.0)
    offset = poses_within(rng, 300, 7.0)
    vut = vru + offset
    runs = [
        build_run(vru[:200], vut[:200], vru="adult", name="a"),
        build_run(
            vru[200:],
            vut[200:],
            vru="cyclist",
            obstruction=(van,),
            name="b",
        ),
    ]
    world = build_world(
        build_scene(*boxes),
        runs,
        n_points=N_POINTS,
        seed=0,
    )
    place_m = rng.uniform(-20.0, 20.0, 2)
    up_m = rng.uniform(0.3, 9.0)
    eye = np.array([*place_m, up_m])

    shares = _assert_nothing_is_missed(
        world,
        eye,
        monkeypatch,
        for_lidar=for_lidar,
    )

    assert shares[0] < 0.8


def test_from_within_the_box_of_a_parked_body_all_rays_are_cast(
    build_scene, build_run, monkeypatch
):
    van = parked_at("parked-van", 0.0, 0.0, 20.0)
    places = [[8.0, 1.0, 0.0], [-9.0, 2.0, 50.0]]
    run = build_run(places, obstruction=(van,))
    world = build_world(
        build_scene(),
        [run],
        n_points=N_POINTS,
        seed=0,
    )

    inside = np.array([0.5, 0.0, 1.2])

    shares = _assert_nothing_is_missed(world, inside, monkeypatch)

    # All of those to the van, none of as many to the empty scene.
    assert shares[0] == 0.5

    above = np.array([0.5, 0.0, 6.0])
    shares = _assert_nothing_is_missed(world, above, monkeypatch)

    assert shares[0] < 0.5


def test_the_ground_below_all_feet_and_what_is_above_the_lens_count_for_nothing():
    ground = np.array([[[-50.0, -50, 0], [50, -50, 0], [50, 50, 0]]])
    roof = ground + [0.0, 0.0, 7.0]
    eye = np.array([1.0, 2.0, 6.0])

    for triangles, is_in_the_way in (
        (ground, False),
        (roof, False),
        (ground + 0.1, True),
    ):
        nearest = np.full((N_UP, N_AROUND), np.inf, dtype=np.float32)
        mark_nearest(nearest, triangles, eye, 0.1, 100.0, 0.0, 1.8)
        is_met = np.isfinite(nearest)

        assert is_met.any() == is_in_the_way
