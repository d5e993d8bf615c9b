import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from geometry.actors import load_actors
from placement.visibility.build import N_POINTS
from placement.visibility.surface import build_surface

BODIES = ("adult", "cyclist")


@pytest.fixture(scope="module", params=BODIES)
def surface(request):
    return build_surface(load_actors()[request.param], n_points=N_POINTS, seed=0)


def _parts(actor):
    """Triangle corners, (n, 3, 3), of each closed part."""
    n = len(actor.vertices_m)
    pairs = actor.triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n))
    n_parts, label = connected_components(graph, directed=False)
    of_triangle = label[actor.triangles[:, 0]]
    return [actor.vertices_m[actor.triangles[of_triangle == part]] for part in range(n_parts)]


def _distance_m(points, corners):
    """Distance of each point to the nearest triangle: to its plane if above it, else its sides."""
    a, b, c = (corners[None, :, i] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    offset = points[:, None] - a
    height = (offset * normal).sum(-1)
    foot = points[:, None] - height[..., None] * normal
    is_above = np.ones(height.shape, dtype=bool)
    best = np.full(height.shape, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        side = end - start
        is_above &= (np.cross(np.broadcast_to(side, foot.shape), foot - start) * normal).sum(
            -1
        ) >= -1e-12
        share = np.clip(((points[:, None] - start) * side).sum(-1) / (side**2).sum(-1), 0.0, 1.0)
        best = np.minimum(
            best, np.linalg.norm(points[:, None] - start - share[..., None] * side, axis=-1)
        )
    return np.where(is_above, np.abs(height), best).min(axis=1)


def _is_inside(points, corners):
    """Whether a closed part surrounds each point: the solid angle of its triangles."""
    a, b, c = np.moveaxis(corners[None] - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
    volume = (a * np.cross(b, c)).sum(-1)
    product = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    # A point on the part's own surface fills half the sphere.
    return np.abs(2.0 * np.arctan2(volume, product).sum(axis=1)) > 3.0 * np.pi


def test_points_lie_on_the_mesh(surface):
    actor = surface.actor
    assert surface.points_m.shape == (N_POINTS, 3)
    assert _distance_m(surface.points_m, actor.vertices_m[actor.triangles]).max() < 1e-9


def test_no_point_lies_inside_another_part(surface):
    for corners in _parts(surface.actor):
        inside = surface.points_m[_is_inside(surface.points_m, corners)]
        # Two millimetres are within the tolerance of the rays that look for them.
        assert not len(inside) or _distance_m(inside, corners).max() < 2.5e-3


def test_the_box_around_the_points_is_the_bodys_own(surface):
    actor, points = surface.actor, surface.points_m
    half = 0.5 * np.array([actor.length_m, actor.width_m])
    assert points.min(axis=0) == pytest.approx([*-half, 0.0], abs=1e-3)
    assert points.max(axis=0) == pytest.approx([*half, actor.height_m], abs=1e-3)


def test_in_any_direction_the_points_reach_nearly_as_far_as_the_body(surface):
    directions = np.random.default_rng(1).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    body = (surface.actor.vertices_m @ directions.T).max(axis=0)
    points = (surface.points_m @ directions.T).max(axis=0)
    assert (points <= body + 1e-9).all()
    assert (body - points).max() < 0.04
    assert (body - points).mean() < 0.01


def test_points_are_evenly_spread(surface):
    n_extremes = 26
    assert pdist(surface.points_m[n_extremes:]).min() > 0.05
    # A thicker sample of the same surface: nothing is far from a point.
    fine = build_surface(surface.actor, n_points=4 * N_POINTS, seed=7).points_m
    assert cKDTree(surface.points_m).query(fine)[0].max() < 0.12


def test_the_seed_decides(surface):
    again = build_surface(surface.actor, n_points=N_POINTS, seed=0)
    other = build_surface(surface.actor, n_points=N_POINTS, seed=1)
    assert np.array_equal(again.points_m, surface.points_m)
    assert not np.array_equal(other.points_m, surface.points_m)
    with pytest.raises(ValueError, match="read-only"):
        surface.points_m[0] = 0.0


def test_fewer_points_than_extremes_can_be_asked_for(actors):
    assert build_surface(actors["adult"], n_points=5, seed=0).points_m.shape == (5, 3)
