"""Lines of points, (n, 2) or (n, 3), seen from above.

Lengths, and places along them, are in metres.
"""

import numpy as np

from .arrays import BoolArray, FloatArray, IntArray


def steps_m(line_m: FloatArray) -> FloatArray:
    """Lengths of the pieces from point to point, (n - 1,)."""
    return np.asarray(np.hypot(*np.diff(line_m[:, :2], axis=0).T))


def length_m(line_m: FloatArray) -> float:
    """Length from end to end."""
    return float(steps_m(line_m).sum())


def along_m(line_m: FloatArray) -> FloatArray:
    """Distance of each point from the first one along the line, (n,)."""
    return np.append(0.0, np.cumsum(steps_m(line_m)))


def points_at(line_m: FloatArray, stations_m: FloatArray) -> FloatArray:
    """Points (k, 2) or (k, 3) at distances (k,) along a line.

    Beyond an end it is that end.
    """
    along = along_m(line_m)
    return np.stack([np.interp(stations_m, along, axis) for axis in line_m.T], axis=-1)


def apart(line_m: FloatArray, least_m: float) -> FloatArray:
    """The line without points that are not farther than this from the point before."""
    return np.asarray(line_m[np.append(True, steps_m(line_m) > least_m)])


def unit(vector: FloatArray) -> FloatArray:
    """A vector (2,) at length 1; zero where it has none."""
    return np.asarray(vector / max(float(np.hypot(*vector)), 1e-9))


def cross(one: FloatArray, other: FloatArray) -> float:
    """Third component of the cross product of two vectors (2,).

    Positive where the other one points to the left of the first.
    """
    return float(one[0] * other[1] - one[1] * other[0])


def true_runs(mask: BoolArray) -> IntArray:
    """Begins and ends of the runs of True in a mask, (k, 2)."""
    # Runs begin and end where neighbours differ, the mask's ends included.
    padded = np.concatenate([[False], mask, [False]])
    return np.flatnonzero(padded[1:] != padded[:-1]).reshape(-1, 2)
