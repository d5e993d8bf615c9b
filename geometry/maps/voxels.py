"""Points to solids: cubes where there are points, joined to clusters, and their outer faces."""

import numpy as np
from numpy.typing import NDArray

from ..arrays import BoolArray, FloatArray, IntArray
from ..errors import InputError, Unquoted

_BITS = 20  # per axis in a key: 1,048,575 voxels, 262 km of 0.25 m
_MASK = (1 << _BITS) - 1
MAX_VOXELS_PER_AXIS = _MASK - 1
MAX_COLUMN_VOXELS = 20_000_000  # of a thing: 10,000 m^2 of roof 30 m above ground, 0.25 m
MAX_WALL_VOXELS = 100_000_000  # of all things of a file
_MAX_DENSE = 30_000_000  # cells of a cluster's box that is searched for voids
_HALF_OF_NEIGHBOURS = tuple(  # differences of keys
    (x << 2 * _BITS) + (y << _BITS) + z
    for x in (-1, 0, 1)
    for y in (-1, 0, 1)
    for z in (-1, 0, 1)
    if (x, y, z) > (0, 0, 0)
)


def to_keys(cells: IntArray) -> IntArray:
    """One integer per cell (n, 3), ordered as x, y, z: each from 1 to ``MAX_VOXELS_PER_AXIS``."""
    keys: IntArray = (cells[:, 0] << 2 * _BITS) | (cells[:, 1] << _BITS) | cells[:, 2]
    return keys


def to_cells(keys: IntArray) -> IntArray:
    """Inverse of :func:`to_keys`."""
    return np.stack([keys >> 2 * _BITS, (keys >> _BITS) & _MASK, keys & _MASK], axis=1)


def is_in(keys: IntArray, sorted_keys: IntArray) -> BoolArray:
    """Which keys are in `sorted_keys`."""
    if not len(sorted_keys):
        return np.zeros(len(keys), dtype=np.bool_)
    places = np.minimum(np.searchsorted(sorted_keys, keys), len(sorted_keys) - 1)
    found: BoolArray = sorted_keys[places] == keys
    return found


def clusters(keys: IntArray) -> IntArray:
    """Cluster number of every voxel: voxels that touch at a face, an edge or a corner are one.

    `keys` are sorted and unique; numbers follow the order of the clusters' first voxels.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(keys)
    pairs = []
    for step in _HALF_OF_NEIGHBOURS:
        moved = keys + step
        here = np.flatnonzero(is_in(moved, keys))
        pairs.append(np.stack([here, np.searchsorted(keys, moved[here])]))
    first, second = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(len(first), dtype=np.bool_), (first, second)), shape=(n, n))
    _, labels = connected_components(graph, directed=False)
    _, seen, inverse = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(seen))
    numbers: IntArray = order[inverse].astype(np.int64)
    return numbers


def bridged(keys: IntArray) -> IntArray:
    """Voxels, and those between two that lie opposite one another, sorted."""
    between = [keys]
    for step in _HALF_OF_NEIGHBOURS:
        between.append(keys[is_in(keys + 2 * step, keys)] + step)
    return np.unique(np.concatenate(between))


def mean_neighbours(keys: IntArray) -> float:
    """Mean number of a voxel's 26 neighbours that exist."""
    n_pairs = sum(int(is_in(keys + step, keys).sum()) for step in _HALF_OF_NEIGHBOURS)
    return 2.0 * n_pairs / max(1, len(keys))


def filled(keys: IntArray, floor: int) -> IntArray:
    """Voxels of one cluster, and the voids that they enclose together with the ground, sorted.

    `floor` is the lowest z above ground. A cluster whose box is too large stays as it is.
    """
    from scipy.ndimage import binary_fill_holes

    cells = to_cells(keys)
    low = cells.min(axis=0)
    low[2] = min(low[2], floor)
    shape = cells.max(axis=0) - low + 1
    if np.prod(shape.astype(np.float64)) > _MAX_DENSE:
        return keys
    stands = bool((cells[:, 2] <= floor + 1).any())
    dense = np.zeros(tuple(shape + [0, 0, 1]), dtype=np.bool_)
    dense[tuple((cells - low + [0, 0, 1]).T)] = True
    dense[:, :, 0] = stands  # the ground closes clusters that stand on it
    dense = binary_fill_holes(dense)[:, :, 1:]
    return np.sort(to_keys(np.argwhere(dense).astype(np.int64) + low))


def columns_to(
    keys: IntArray, floor: int, where: str, *, n_left: int = MAX_WALL_VOXELS
) -> IntArray:
    """Voxels from the floor to the highest of every column, sorted.

    Raises InputError if they are more than any building has, or than `n_left` of what all buildings
    of a file may have: heights in another unit, or damaged.
    """
    columns, start = np.unique(keys >> _BITS, return_index=True)
    top = np.maximum.reduceat(keys & _MASK, start)
    counts = np.maximum(top - floor + 1, 0)
    total = int(counts.sum())
    for n_voxels, most, whose in (
        (total, MAX_COLUMN_VOXELS, "a thing"),
        (MAX_WALL_VOXELS - n_left + total, MAX_WALL_VOXELS, "a file"),
    ):
        if n_voxels > most:
            raise InputError(
                where, Unquoted(f"walls of {n_voxels:,} voxels"), f"at most {most:,} of {whose}"
            )
    # Ascending, for columns are: one array, and no sorting.
    walls = np.repeat((columns << _BITS) + floor - (np.cumsum(counts) - counts), counts)
    walls += np.arange(total)
    below = keys[(keys & _MASK) < floor]
    return np.sort(np.concatenate([below, walls])) if len(below) else walls


def faces(
    keys: IntArray, *, origin_m: FloatArray, voxel_m: float, max_triangles: int, where: str
) -> tuple[FloatArray, NDArray[np.int32]]:
    """The surface of sorted voxels: rectangles as large as possible, of two triangles each.

    It is closed, though a rectangle's edge may meet several smaller ones. `origin_m` (3,) is the
    lower corner of cell (0, 0, 0). Triangles run counter-clockwise seen from outside. Raises
    InputError if there are more than `max_triangles`.
    """
    quads = np.concatenate([_rectangles(keys, axis, sign) for axis in range(3) for sign in (-1, 1)])
    if 2 * len(quads) > max_triangles:
        raise InputError(
            where, Unquoted(f"{2 * len(quads):,} triangles"), "a larger voxel, or fewer points"
        )
    unique, inverse = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    index = inverse.reshape(-1, 4)
    triangles = np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]]).astype(np.int32)
    return origin_m + voxel_m * unique, triangles


def _rectangles(keys: IntArray, axis: int, sign: int) -> IntArray:
    """Corners of the rectangles that face along an axis, (n, 4, 3), as indices of cells."""
    step = sign << (2 - axis) * _BITS  # to the neighbour's key
    cells = to_cells(keys[~is_in(keys + step, keys)])
    u, v = [other for other in range(3) if other != axis]
    slab, a, b = cells[:, axis], cells[:, u], cells[:, v]
    # Runs of faces that follow one another along v, then of equal runs along u.
    order = np.lexsort((b, a, slab))
    slab, a, b = slab[order], a[order], b[order]
    is_start = np.ones(len(slab), dtype=np.bool_)
    is_start[1:] = (np.diff(slab) != 0) | (np.diff(a) != 0) | (np.diff(b) != 1)
    start = np.flatnonzero(is_start)
    end = np.append(start[1:], len(slab))
    slab, a, b_low, b_high = slab[start], a[start], b[start], b[end - 1] + 1
    order = np.lexsort((a, b_high, b_low, slab))
    slab, a, b_low, b_high = slab[order], a[order], b_low[order], b_high[order]
    is_start = np.ones(len(slab), dtype=np.bool_)
    is_start[1:] = (
        (np.diff(slab) != 0) | (np.diff(b_low) != 0) | (np.diff(b_high) != 0) | (np.diff(a) != 1)
    )
    start = np.flatnonzero(is_start)
    end = np.append(start[1:], len(slab))
    slab, a_low, a_high = slab[start], a[start], a[end - 1] + 1
    b_low, b_high = b_low[start], b_high[start]
    plane = slab + (sign > 0)
    quads = np.empty((len(slab), 4, 3), dtype=np.int64)
    quads[:, :, axis] = plane[:, None]
    quads[:, :, u] = np.stack([a_low, a_high, a_high, a_low], axis=1)
    quads[:, :, v] = np.stack([b_low, b_low, b_high, b_high], axis=1)
    # u, v, axis are right-handed for x and z as axes, left-handed for y.
    is_outward = (sign > 0) == (axis != 1)
    return quads if is_outward else quads[:, ::-1]
