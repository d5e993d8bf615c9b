import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import Polygon

from geometry.maps.source_map import is_closed, surface_mesh, triangulate, volume_m3

SQUARE = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]], dtype=float)
HOLE = np.array([[1, 1, 0], [1, 2, 0], [2, 2, 0], [2, 1, 0]], dtype=float)


def normals(vertices, triangles):
    a, b, c = np.swapaxes(vertices[triangles], 0, 1)
    return 0.5 * np.cross(b - a, c - a)


def rotation(yaw, pitch):
    cy = np.cos(yaw)
    sy = np.sin(yaw)
    cp = np.cos(pitch)
    sp = np.sin(pitch)
    return np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ np.array(
        [[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]
    )


@st.composite
def star(draw):
    """A polygon without crossings: one corner per direction."""
    n = draw(st.integers(3, 12))
    radius = draw(st.lists(st.floats(0.5, 20.0), min_size=n, max_size=n))
    angle = 2.0 * np.pi * np.arange(n) / n
    return np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.zeros(n)], axis=1
    )


@given(star(), st.floats(0, 6), st.floats(0, 6), st.booleans())
def test_triangles_have_the_area_of_the_polygon_and_look_where_it_looks(
    ring, yaw, pitch, is_turned
):
    turn = rotation(yaw, pitch)
    ring_3d = (ring[::-1] if is_turned else ring) @ turn.T + [1e5, 5e6, 100.0]
    vertices, triangles = triangulate([ring_3d])
    total = normals(vertices, triangles)
    up = turn[:, 2] * (-1.0 if is_turned else 1.0)
    area = Polygon(ring[:, :2]).area

    assert np.linalg.norm(total, axis=1).sum() == pytest.approx(
        area, rel=1e-5, abs=1e-5
    )
    assert total.sum(axis=0) @ up == pytest.approx(area, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("hole", [HOLE, HOLE[::-1]])
def test_holes_stay_open_whichever_way_they_run(hole):
    vertices, triangles = triangulate([SQUARE, hole])
    assert np.allclose(normals(vertices, triangles).sum(axis=0), [0, 0, 15.0])

    middles = vertices[triangles].mean(axis=1)[:, :2]
    assert not shapely.contains_xy(Polygon(HOLE[:, :2]), middles).any()


def test_closing_points_and_repeated_points_change_nothing():
    closed = np.concatenate([SQUARE[:1], SQUARE, SQUARE[:1]])
    vertices, triangles = triangulate([closed])

    assert len(triangles) == 2
    assert np.allclose(normals(vertices, triangles).sum(axis=0), [0, 0, 16.0])


@pytest.mark.parametrize(
    "rings",
    [
        [],
        [np.empty((0, 3))],
        [SQUARE[:2]],
        [np.zeros((5, 3))],
        [np.outer(np.arange(5), [1.0, 2.0, 3.0])],
        [SQUARE[:2], HOLE],
    ],
)
def test_what_has_no_area_gives_no_triangles(rings):
    assert len(triangulate(rings)[1] if rings else surface_mesh([])[1]) == 0


def box_polygons(size, *, is_inverted=False):
    x, y, z = size
    corners = np.array(
        [[i, j, k] for i in (0, x) for j in (0, y) for k in (0, z)], dtype=float
    )
    faces = [
        [0, 1, 3, 2],
        [4, 6, 7, 5],
        [0, 4, 5, 1],
        [2, 3, 7, 6],
        [0, 2, 6, 4],
        [1, 5, 7, 3],
    ]
    return [[corners[face[::-1] if is_inverted else face]] for face in faces]


@given(st.tuples(*[st.floats(0.1, 100.0)] * 3), st.booleans())
def test_closed_surfaces_look_outwards_and_hold_their_volume(size, is_inverted):
    vertices, triangles = surface_mesh(box_polygons(size, is_inverted=is_inverted))
    assert is_closed(triangles)
    assert len(vertices) == 8
    assert volume_m3(vertices, triangles) == pytest.approx(np.prod(size), rel=1e-9)


def test_a_box_without_its_lid_is_open_and_kept_as_it_is():
    vertices, triangles = surface_mesh(box_polygons((1, 1, 1), is_inverted=True)[:-1])
    assert not is_closed(triangles)
    assert len(triangles) == 10
    assert (vertices[triangles].mean(axis=1) - 0.5)[0] @ normals(vertices, triangles)[
        0
    ] < 0
