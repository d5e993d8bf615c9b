"""Boxes and cylinders are those of trimesh, to the last bit."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from geometry.solids import box_mesh, cylinder_mesh

LENGTHS = st.floats(min_value=0.01, max_value=200.0)
PLACES = st.floats(min_value=-300.0, max_value=300.0)


@given(st.tuples(LENGTHS, LENGTHS, LENGTHS))
def test_a_box_is_that_of_trimesh(size_m):
    corners, triangles = box_mesh(size_m)
    theirs = trimesh.creation.box(extents=size_m)

    np.testing.assert_array_equal(corners, theirs.vertices)
    np.testing.assert_array_equal(triangles, theirs.faces)


@given(st.tuples(PLACES, PLACES), st.floats(3.0, 12.0), st.floats(0.05, 0.5))
def test_a_pole_is_that_of_trimesh(foot_m, height_m, radius_m):
    ends = [
        [*foot_m, 0.0],
        [*foot_m, height_m],
    ]
    _check_cylinder(ends, radius_m, n_sides=10)


@pytest.mark.parametrize("n_sides", [3, 10, 17])
@given(
    start_m=st.tuples(PLACES, PLACES, PLACES),
    yaw_deg=st.floats(-180.0, 180.0),
    length_m=st.floats(1.0, 30.0),
)
def test_a_level_arm_is_that_of_trimesh(start_m, yaw_deg, length_m, n_sides):
    yaw = np.radians(yaw_deg)
    ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    end_m = start_m + length_m * ahead
    ends = [
        list(start_m),
        end_m.tolist(),
    ]
    _check_cylinder(ends, 0.2, n_sides=n_sides)


def _check_cylinder(ends, radius_m, *, n_sides):
    """A mesh is a closed cylinder with this radius and length."""
    corners, triangles = cylinder_mesh(ends, radius_m=radius_m, n_sides=n_sides)
    theirs = trimesh.creation.cylinder(
        radius=radius_m,
        segment=ends,
        sections=n_sides,
    )

    np.testing.assert_array_equal(corners, theirs.vertices)
    np.testing.assert_array_equal(triangles, theirs.faces)
    assert theirs.is_watertight
    assert theirs.volume > 0.0
