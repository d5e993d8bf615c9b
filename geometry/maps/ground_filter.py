"""The ground under a point cloud."""

import numpy as np

from ..arrays import FloatArray, IntArray
from ..errors import InputError, Unquoted

CELL_M = 1.0
_MAX_CELLS = 16_000_000  # 4 km x 4 km
_WINDOWS = (3, 5, 9, 17, 33, 65, 129)  # cells; buildings wider than the last are taken for hills
_STEP_M, _SLOPE = 0.5, 0.1  # higher and steeper than this is not ground


class LowestPoints:
    """Lowest point of every square metre, collected a piece at a time."""

    def __init__(self) -> None:
        self._cells: IntArray = np.empty((0, 2), dtype=np.int64)
        self._z_m: FloatArray = np.empty(0)

    def add(self, points_m: FloatArray) -> None:
        """Take more points, (n, 3)."""
        if not len(points_m):
            return
        cells = np.concatenate([self._cells, np.floor(points_m[:, :2] / CELL_M).astype(np.int64)])
        z_m = np.concatenate([self._z_m, points_m[:, 2]])
        order = np.lexsort((z_m, cells[:, 1], cells[:, 0]))
        cells, z_m = cells[order], z_m[order]
        is_first = np.ones(len(cells), dtype=np.bool_)
        is_first[1:] = (cells[1:] != cells[:-1]).any(axis=1)
        self._cells, self._z_m = cells[is_first], z_m[is_first]

    def __len__(self) -> int:
        return len(self._z_m)

    def grid(self, where: str) -> tuple[IntArray, FloatArray]:
        """First cell (2,), and heights of all cells of the box, (n, m); NaN: no points. [m].

        Raises
        ------
        InputError
            The box is too large.
        """
        low = self._cells.min(axis=0)
        shape = self._cells.max(axis=0) - low + 1
        if np.prod(shape.astype(np.float64)) > _MAX_CELLS:
            size = " x ".join(f"{length * CELL_M / 1000.0:.1f} km" for length in shape)
            raise InputError(
                where, Unquoted(f"points over {size}"), "at most 16 km2; cut them out first"
            )
        heights = np.full(tuple(shape), np.nan)
        heights[tuple((self._cells - low).T)] = self._z_m
        return low, heights


def fill_gaps(heights_m: FloatArray) -> FloatArray:
    """Heights with those of the nearest cell where there are none (NaN), (n, m). [m]."""
    from scipy.ndimage import distance_transform_edt

    if not np.isnan(heights_m).any():
        return heights_m
    _, nearest = distance_transform_edt(np.isnan(heights_m), return_indices=True)
    filled: FloatArray = heights_m[tuple(nearest)]
    return filled


def filter_ground(heights_m: FloatArray) -> FloatArray:
    """Ground under the lowest points of cells.

    A surface is opened with growing windows; what an opening takes off by more than the ground
    could rise within half the window stands on it, and under it lies the height of the nearest
    ground. Of a house that ground behind it overtops, a part is taken for ground.

    Parameters
    ----------
    heights_m : (n, m) float
        Lowest points; NaN: none. [m]

    Returns
    -------
    ground_m : (n, m) float
        [m]

    References
    ----------
    .. [1] K. Zhang et al., "A progressive morphological filter for removing nonground measurements
       from airborne lidar data", 2003.
    """
    from scipy.ndimage import grey_closing, grey_opening

    surface = fill_gaps(heights_m)
    if min(surface.shape) >= 5:
        closed = grey_closing(surface, size=(3, 3))  # single points below the ground
        surface = np.where(closed - surface > 2.0 * _STEP_M, closed, surface)
    is_ground = np.ones(surface.shape, dtype=np.bool_)
    opened, last = surface, 1
    for window in _WINDOWS:
        if last >= max(surface.shape):
            break
        lower = grey_opening(opened, size=(window, window), mode="nearest")
        is_ground &= opened - lower <= _STEP_M + 0.5 * _SLOPE * (window - last) * CELL_M
        opened, last = lower, window
    if not is_ground.any():
        return opened
    return fill_gaps(np.where(is_ground, surface, np.nan))
