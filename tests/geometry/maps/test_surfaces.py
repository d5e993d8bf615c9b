"""Surfaces made of triangles, and the volume inside them."""

import numpy as np
import pytest
import shapely
from box_faces import BOX_FACES
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from shapely.geometry import Polygon

from geometry.maps.source_map import is_closed, surface_mesh, triangulate, volume_m3

SQUARE = np.array(
    [
        [0.0, 0.0, 0.0],
        [4.0, 0.0, 0.0],
        [4.0, 4.0, 0.0],
        [0.0, 4.0, 0.0],
    ]
)
HOLE = np.array(
    [
        [1.0, 1.0, 0.0],
        [1.0, 2.0, 0.0],
        [2.0, 2.0, 0.0],
        [2.0, 1.0, 0.0],
    ]
)
CUBE = np.array(
    [
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 1.0, 0.0],
        [0.0, 1.0, 1.0],
        [1.0, 0.0, 0.0],
        [1.0, 0.0, 1.0],
        [1.0, 1.0, 0.0],
        [1.0, 1.0, 1.0],
    ]
)
FACES = np.array(BOX_FACES)


def normals(vertices, triangles):
    """Normals of triangles, as long as their areas."""
    a, b, c = np.swapaxes(vertices[triangles], 0, 1)
    return 0.5 * np.cross(b - a, c - a)


@st.composite
def star(draw):
    """A polygon without crossings: one corner per direction."""
    radii = draw(st.lists(st.floats(0.5, 20.0), min_size=3, max_size=12))
    n = len(radii)
    angle = 2.0 * np.pi * np.arange(n) / n
    x = radii * np.cos(angle)
    y = radii * np.sin(angle)
    return np.column_stack([x, y, np.zeros(n)])


@given(star(), st.floats(0, 6), st.floats(0, 6), st.booleans())
def test_triangles_have_the_area_of_the_polygon_and_look_where_it_looks(
    ring, yaw, pitch, is_turned
):
    turn = Rotation.from_euler("zy", [yaw, pitch]).as_matrix()
    up = turn[:, 2]
    drawn = ring
    if is_turned:
        up = -up
        drawn = ring[::-1]
    vertices, triangles = triangulate([drawn @ turn.T + [1e5, 5e6, 100.0]])
    found = normals(vertices, triangles)
    area = Polygon(ring[:, :2]).area

    total = np.linalg.norm(found, axis=1).sum()
    assert total == pytest.approx(area, rel=1e-5, abs=1e-5)
    assert found.sum(axis=0) @ up == pytest.approx(area, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("hole", [HOLE, HOLE[::-1]])
def test_holes_stay_open_whichever_way_they_run(hole):
    vertices, triangles = triangulate([SQUARE, hole])
    total = normals(vertices, triangles).sum(axis=0)

    assert_allclose(total, [0, 0, 15.0], atol=1e-8)

    middles = vertices[triangles].mean(axis=1)[:, :2]
    opening = Polygon(HOLE[:, :2])

    assert not shapely.contains_xy(opening, middles).any()


def test_closing_points_and_repeated_points_change_nothing():
    closed = np.concatenate([SQUARE[:1], SQUARE, SQUARE[:1]])
    vertices, triangles = triangulate([closed])

    assert len(triangles) == 2

    total = normals(vertices, triangles).sum(axis=0)
    assert_allclose(total, [0, 0, 16.0], atol=1e-8)


@pytest.mark.parametrize(
    "rings",
    [
        [np.empty((0, 3))],
        [SQUARE[:2]],
        [np.zeros((5, 3))],
        [np.outer(np.arange(5), [1.0, 2.0, 3.0])],
        [SQUARE[:2], HOLE],
    ],
)
def test_what_has_no_area_gives_no_triangles(rings):
    _, triangles = triangulate(rings)
    assert len(triangles) == 0


def test_no_surfaces_have_no_triangles():
    _, triangles = surface_mesh([])
    assert len(triangles) == 0


def box_polygons(size, *, is_inverted=False):
    """The six sides of a box, which look outwards unless inverted."""
    corners = CUBE * size
    faces = FACES
    if is_inverted:
        faces = FACES[:, ::-1]
    return [[corners[face]] for face in faces]


EDGE = st.floats(0.1, 100.0)


@given(st.tuples(EDGE, EDGE, EDGE), st.booleans())
def test_closed_surfaces_look_outwards_and_hold_their_volume(size, is_inverted):
    sides = box_polygons(size, is_inverted=is_inverted)
    vertices, triangles = surface_mesh(sides)
    volume = volume_m3(vertices, triangles)

    assert is_closed(triangles)
    assert len(vertices) == 8
    assert volume == pytest.approx(np.prod(size), rel=1e-9)


def test_a_box_without_its_lid_is_open_and_kept_as_it_is():
    sides = box_polygons((1, 1, 1), is_inverted=True)
    vertices, triangles = surface_mesh(sides[:-1])

    assert not is_closed(triangles)
    assert len(triangles) == 10

    from_middle = vertices[triangles[0]].mean(axis=0) - 0.5
    assert from_middle @ normals(vertices, triangles)[0] < 0
