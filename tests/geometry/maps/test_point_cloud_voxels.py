"""Voxels of points: their keys, clusters, columns and faces."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from geometry.errors import InputError
from geometry.maps import point_clouds as voxels
from geometry.maps.source_map import volume_m3

SHAPE = (6, 5, 4)
FIRST = 1000


def keys_of(dense):
    """Sorted keys of a dense grid."""
    return np.sort(voxels.to_keys(np.argwhere(dense) + FIRST))


@st.composite
def blocks(draw):
    """A small dense grid, and the same as sorted keys."""
    filled = draw(st.lists(st.booleans(), min_size=120, max_size=120))
    dense = np.array(filled).reshape(SHAPE)
    dense[2, 2, 2] = True
    return dense, keys_of(dense)


def dense_of(keys):
    """The dense grid of keys."""
    grid = np.zeros(SHAPE, dtype=bool)
    grid[tuple((voxels.to_cells(keys) - FIRST).T)] = True
    return grid


INDICES = st.integers(1, voxels.MAX_VOXELS_PER_AXIS)


@given(st.lists(st.tuples(INDICES, INDICES, INDICES), min_size=1))
def test_keys_and_cells_are_inverse_and_equally_ordered(cells):
    drawn = np.array(cells)
    keys = voxels.to_keys(drawn)

    assert np.array_equal(voxels.to_cells(keys), drawn)

    in_order = np.lexsort(drawn.T[::-1])
    assert np.array_equal(np.argsort(keys, kind="stable"), in_order)


@given(blocks())
def test_clusters_are_those_of_dense_labelling(block):
    dense, keys = block
    labels = voxels.clusters(keys)
    cube = np.ones((3, 3, 3))
    truth, n = ndimage.label(dense, structure=cube)
    pairs = np.unique(np.stack([labels, truth[dense]]), axis=1)

    assert pairs.shape == (2, n)
    assert n == labels.max() + 1
    assert labels[0] == 0


@given(blocks())
def test_bridges_close_gaps_of_one_and_no_more(block):
    dense, keys = block
    between = dense.copy()
    padded = np.pad(dense, 1)

    for step in np.argwhere(np.ones((3, 3, 3))) - 1:
        if step.any():
            one = np.roll(padded, step, axis=(0, 1, 2))
            other = np.roll(padded, -step, axis=(0, 1, 2))
            between |= (one & other)[1:-1, 1:-1, 1:-1]

    assert np.array_equal(dense_of(voxels.bridged(keys)), between)


@given(blocks())
def test_columns_reach_from_the_floor_to_the_top(block):
    dense, keys = block
    from_top = np.flip(dense, 2)
    full = np.flip(np.maximum.accumulate(from_top, axis=2), 2)
    found = dense_of(voxels.columns_to(keys, FIRST, "x.las"))

    assert np.array_equal(found, full)


def faces_of(keys, **limits):
    """Faces around voxels, from the origin on."""
    return voxels.faces(keys, origin_m=np.zeros(3), where="f", **limits)


@given(blocks())
def test_faces_enclose_the_volume_of_the_voxels_and_no_other(block):
    dense, keys = block
    vertices, triangles = faces_of(keys, voxel_m=1.0, max_triangles=10_000)

    assert volume_m3(vertices, triangles) == pytest.approx(dense.sum())

    padded = np.pad(dense, 1)
    exposed = 0
    for axis in range(3):
        exposed += np.diff(padded, axis=axis).sum()

    assert trimesh.Trimesh(vertices, triangles).area == pytest.approx(exposed)


def test_a_large_box_has_twelve_triangles():
    keys = keys_of(np.ones((20, 30, 40)))
    _, triangles = faces_of(keys, voxel_m=0.25, max_triangles=12)

    assert len(triangles) == 12
    with pytest.raises(InputError, match="12 triangles"):
        faces_of(keys, voxel_m=0.25, max_triangles=11)


def test_hollow_things_that_stand_are_filled_and_gateways_stay():
    dense = np.ones((12, 12, 8), dtype=bool)
    dense[1:-1, 1:-1, :-1] = False  # a shell without a floor
    keys = keys_of(dense)

    assert len(voxels.filled(keys, FIRST)) == 12 * 12 * 8

    dense[0, 4:8, :4] = False  # and now with a gateway
    keys = keys_of(dense)

    assert np.array_equal(voxels.filled(keys, FIRST), keys)


def test_neighbours_are_counted_as_they_are():
    plate = keys_of(np.ones((30, 30, 1)))
    assert 7.0 < voxels.mean_neighbours(plate) < 8.0
    assert voxels.mean_neighbours(plate[:1]) == 0.0
