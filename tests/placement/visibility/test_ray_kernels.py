from dataclasses import fields, replace

import numpy as np
import pytest

from geometry.actors import PlacedActor
from geometry.poses import Pose
from geometry.study_scene import load_study_scene
from placement.visibility import casting
from placement.visibility.build import N_POINTS
from placement.visibility.casting import build_world, cast_sight

WALLS = (((4, -6, 0), (4.3, 1, 2.2)), ((-9, 3, 0), (-2, 3.4, 1.2)), ((8, -9, 0), (12, -5, 6)))


class Counter:
    """A caster that counts its rays."""

    def __init__(self, caster):
        self.caster, self.n_rays = caster, 0

    def is_blocked(self, origins_m, vectors_m):
        self.n_rays += len(origins_m)
        return self.caster.is_blocked(origins_m, vectors_m)


def _sight_and_rays(world, eye, **options):
    vut = Counter(world.vehicles.casters[0])
    parked = [Counter(caster) for caster in world.standing.casters]
    counted = replace(
        world,
        standing=replace(world.standing, casters=tuple(parked)),
        vehicles=replace(world.vehicles, casters=(vut,)),
    )
    options = {"near_m": 0.35, "max_distance_m": 300.0} | options
    sight = cast_sight(counted, eye, **options)
    return sight, sum(each.n_rays for each in parked), vut.n_rays


def _assert_nothing_is_missed(world, eye, monkeypatch, **options):
    """The same is seen where every ray is cast; returns the shares of the rays that are needed."""
    sight, n_static, n_vut = _sight_and_rays(world, eye, **options)
    with monkeypatch.context() as patch:
        patch.setattr(casting, "AROUND_BODY_M", 1.0e6)
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
    shares = _assert_nothing_is_missed(world, inside, monkeypatch)
    assert shares[0] == 1.0
    shares = _assert_nothing_is_missed(world, np.array([0.5, 0.0, 6.0]), monkeypatch)
    assert shares[0] < 0.5
