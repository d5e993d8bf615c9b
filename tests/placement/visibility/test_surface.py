"""Points on bodies' surfaces that stand for all of it."""

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist, pdist

from geometry.actors import load_actors
from placement.visibility.build import N_POINTS
from placement.visibility.views import build_surface, farthest_samples

BODIES = (
    ("child", 3),
    ("cyclist", 1),
)


@pytest.fixture(scope="module", params=BODIES, ids=str)
def surface(request):
    """Points on a shape of a road user."""
    name, index = request.param
    return build_surface(
        load_actors()[name],
        index,
        n_points=N_POINTS,
        seed=0,
    )


def _shape(surface):
    """The shape that a surface is of."""
    return surface.actor.shapes[surface.shape_index]


def _distance_m(points, corners):
    """Distance of each point to the nearest triangle: to its plane if above it, else
    its sides.
    """
    a, b, c = (corners[None, :, i] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    offset = points[:, None] - a
    height = (offset * normal).sum(-1)
    above = height[..., None] * normal
    foot = points[:, None] - above
    is_above = np.ones(height.shape, dtype=bool)
    best = np.full(height.shape, np.inf)

    for start, end in (
        (a, b),
        (b, c),
        (c, a),
    ):
        side = end - start
        is_above &= (
            np.cross(np.broadcast_to(side, foot.shape), foot - start) * normal
        ).sum(-1) >= -1e-12
        from_start = points[:, None] - start
        along = (from_start * side).sum(-1)
        length_m2 = (side**2).sum(-1)
        share = np.clip(along / length_m2, 0.0, 1.0)
        best = np.minimum(
            best,
            np.linalg.norm(points[:, None] - start - share[..., None] * side, axis=-1),
        )

    over = np.abs(height)
    return np.where(is_above, over, best).min(axis=1)


@pytest.mark.long
def test_points_lie_on_the_mesh(surface):
    shape = _shape(surface)

    assert surface.points_m.shape == (N_POINTS, 3)

    corners = shape.vertices_m[shape.triangles]

    for points in np.array_split(surface.points_m, 8):
        distance_m = _distance_m(points, corners)
        assert distance_m.max() < 1e-9


def test_the_box_around_the_points_is_that_of_the_shape(surface):
    vertices = _shape(surface).vertices_m
    points = surface.points_m
    lowest_m = points.min(axis=0)
    lowest_vertex_m = vertices.min(axis=0)
    highest_m = points.max(axis=0)
    highest_vertex_m = vertices.max(axis=0)

    assert np.array_equal(lowest_m, lowest_vertex_m)
    assert np.array_equal(highest_m, highest_vertex_m)


def test_in_any_direction_the_points_reach_nearly_as_far_as_the_body(surface):
    directions = default_rng(1).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    along = _shape(surface).vertices_m @ directions.T
    body = along.max(axis=0)
    points = (surface.points_m @ directions.T).max(axis=0)

    assert (points <= body + 1e-9).all()
    assert (body - points).max() < 0.05
    assert (body - points).mean() < 0.01


@pytest.mark.long
def test_points_are_evenly_spread(surface):
    n_extremes = 26
    apart_m = pdist(surface.points_m[n_extremes:])

    assert apart_m.min() > 0.05

    # A thicker sample of the same surface: nothing is far from a point.
    fine = build_surface(
        surface.actor,
        surface.shape_index,
        n_points=4 * N_POINTS,
        seed=7,
    ).points_m
    tree = cKDTree(surface.points_m)
    nearest_m = tree.query(fine)[0]

    assert nearest_m.max() < 0.12


def test_the_seed_decides(surface):
    again = build_surface(
        surface.actor,
        surface.shape_index,
        n_points=N_POINTS,
        seed=0,
    )

    other = build_surface(
        surface.actor,
        surface.shape_index,
        n_points=N_POINTS,
        seed=1,
    )
    is_same = np.array_equal(other.points_m, surface.points_m)

    assert np.array_equal(again.points_m, surface.points_m)
    assert not is_same
    with pytest.raises(ValueError, match="read-only"):
        surface.points_m[0] = 0.0


def test_fewer_points_than_extremes_can_be_asked_for(actors):
    assert build_surface(actors["adult"], 0, n_points=5, seed=0).points_m.shape == (
        5,
        3,
    )


def test_the_parts_around_the_points_make_up_the_surface(surface):
    """Curved parts are a little less than their area; of a closed surface they cancel
    out.

    By 4800 random samples: to within four of their standard deviations of 1.4 %.
    """
    triangles = _shape(surface).vertices_m[_shape(surface).triangles]
    a, b, c = np.moveaxis(triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    doubled_m2 = np.linalg.norm(normals, axis=1)
    whole_m2 = 0.5 * doubled_m2.sum()
    parts_m2 = np.linalg.norm(surface.area_m2, axis=1)
    covered_m2 = parts_m2.sum()
    closed_m2 = surface.area_m2.sum(axis=0)
    leak_m2 = np.linalg.norm(closed_m2)

    assert surface.area_m2.shape == surface.points_m.shape
    assert 0.85 * whole_m2 < covered_m2 <= whole_m2 * (1.0 + 1e-9)
    assert leak_m2 < 0.06 * whole_m2
    # No part is left out, and none is much of the whole.
    assert (parts_m2 > 0.0).mean() > 0.95
    assert parts_m2.max() < 0.05 * whole_m2


def test_samples_are_chosen_one_by_one_the_farthest_from_all_before():
    rng = default_rng(2)
    samples = rng.normal(size=(400, 3))
    first = rng.normal(size=(4, 3))
    points = list(first)
    expected = []
    for _ in range(30):
        between_m = cdist(samples, points)
        nearest_m = between_m.min(axis=1)
        index = np.argmax(nearest_m)
        farthest = int(index)
        expected.append(farthest)
        points.append(samples[farthest])

    chosen = farthest_samples(samples, first, 30)
    none_chosen = farthest_samples(samples, first, 0)

    assert chosen.tolist() == expected
    assert none_chosen.tolist() == []
