"""Where a body is known to be hidden without a ray to each of its points."""

import numpy as np
import pytest
from tiny_worlds import WALLS

from geometry.actors import load_actors
from placement.visibility import casting
from placement.visibility.casting import build_shared_scene, shape_caster
from placement.visibility.views import build_surface

N_POINTS = 160


def all_rays(surface, caster, eyes_m):
    """Hidden points, by a ray to each that ends a millimetre before it."""
    away_m = np.linalg.norm(eyes_m, axis=1)
    share = (1.0 - 1.0e-3 / away_m).astype(np.float32)
    eyes = eyes_m.astype(np.float32)
    starts_m = eyes[:, None]
    points_m = surface.points_m.astype(np.float32)
    vectors_m = (points_m - starts_m) * share[:, None, None]
    starts_m = np.broadcast_to(starts_m, vectors_m.shape)
    starts = starts_m.reshape(-1, 3)
    vectors = vectors_m.reshape(-1, 3)
    hits = caster.is_blocked(starts, vectors)
    return hits.reshape(len(eyes_m), -1)


@pytest.mark.parametrize("name", ["adult", "child", "cyclist"])
def test_a_point_on_a_face_that_looks_away_is_hidden_as_its_ray_says(name):
    actor = load_actors()[name]
    surface = build_surface(actor, 0, n_points=N_POINTS, seed=0)
    caster = shape_caster(actor.shapes[0], "embree")
    rng = np.random.default_rng(0)
    away_m = rng.uniform(5.0, 90.0, 400)
    turn = rng.uniform(0.0, 2.0 * np.pi, 400)
    height_m = rng.uniform(0.5, 12.0, 400)
    east_m = away_m * np.cos(turn)
    north_m = away_m * np.sin(turn)
    eyes_m = np.column_stack([east_m, north_m, height_m])
    asked = []

    class Counting:
        """Counts the rays of a caster."""

        def is_blocked(self, starts_m, vectors_m):
            asked.append(len(starts_m))
            return caster.is_blocked(starts_m, vectors_m)

    found = casting._find_self_hidden(surface, Counting(), eyes_m)
    expected = all_rays(surface, caster, eyes_m)

    np.testing.assert_array_equal(found, expected)
    assert sum(asked) < 0.7 * expected.size


def test_an_eye_next_to_the_body_gets_a_ray_to_every_point():
    actor = load_actors()["adult"]
    surface = build_surface(actor, 0, n_points=N_POINTS, seed=0)
    caster = shape_caster(actor.shapes[0], "embree")
    # One eye is within the body.
    eyes_m = np.array([[0.0, 0.0, 1.0], [0.4, 0.1, 1.2]])

    found = casting._find_self_hidden(surface, caster, eyes_m)
    expected = all_rays(surface, caster, eyes_m)

    np.testing.assert_array_equal(found, expected)


def seen_from(scene, run, eye_m, near_m):
    """Bodies that one triangle is known to hide, and points that rays find hidden."""
    shared = build_shared_scene(
        scene,
        [run],
        n_points=N_POINTS,
        seed=0,
    )
    eye = eye_m - shared.origin_m
    n_places = len(shared.places.yaw_deg)
    every = np.arange(n_places)
    is_behind = casting._is_behind_one_triangle(
        shared,
        eye,
        every,
        near_m=near_m,
    )
    points = np.swapaxes(shared.places.axes_m, 1, 2)
    points_m = points.astype(float)
    ways_m = points_m - eye
    lengths_m = np.linalg.norm(ways_m, axis=2, keepdims=True)
    starts_m = eye + ways_m * (near_m / lengths_m)
    share = 1.0 - (near_m + 1.0e-3) / lengths_m
    vectors_m = ways_m * share
    hits = shared.caster.is_blocked(
        starts_m.reshape(-1, 3).astype(np.float32),
        vectors_m.reshape(-1, 3).astype(np.float32),
    )
    is_hidden = hits.reshape(points_m.shape[:2])
    return is_behind, is_hidden


def walk(build_run, frames):
    """A run whose VRU stands at places (n, 2), facing east."""
    poses = [(x, y, 0.0) for x, y in frames]
    return build_run(poses, shapes=0)


@pytest.mark.parametrize("seed", range(4))
def test_who_is_behind_one_triangle_has_no_visible_point(build_scene, build_run, seed):
    rng = np.random.default_rng(seed)
    places_m = rng.uniform(-25.0, 25.0, (400, 2))
    run = walk(build_run, places_m)
    place_m = rng.uniform(-6.0, 6.0, 2)
    height_m = rng.uniform(2.5, 8.0)
    eye_m = np.array([*place_m, height_m])

    is_behind, hidden = seen_from(
        build_scene(*WALLS),
        run,
        eye_m,
        0.35,
    )

    assert is_behind.any()
    assert hidden[is_behind].all()


def test_a_wall_that_is_too_near_hides_nobody(build_scene, build_run):
    run = walk(build_run, [(20.0, -10.0), (20.0, -12.0)])
    wall = ((1.0, -30.0, 0.0), (1.2, 30.0, 9.0))
    eye_m = np.array([0.0, 0.0, 4.0])

    is_behind, _ = seen_from(build_scene(wall), run, eye_m, 0.35)

    assert is_behind.all()

    is_behind, _ = seen_from(build_scene(wall), run, eye_m, 2.0)

    assert not is_behind.any()


def test_who_stands_before_a_wall_or_looks_past_its_edge_is_not_behind_it(
    build_scene, build_run
):
    run = walk(
        build_run,
        [
            (8.0, 0.0),
            (20.0, 30.0),
            (20.0, -4.0),
        ],
    )
    wall = ((10.0, -15.0, 0.0), (10.3, 15.0, 9.0))
    eye_m = np.array([0.0, 0.0, 4.0])
    is_behind, hidden = seen_from(build_scene(wall), run, eye_m, 0.35)
    places = hidden.all(axis=1)

    assert is_behind.tolist() == places.tolist()
    assert is_behind.sum() == 1
