"""Vectors of the plane: their lengths, and those of length 1."""

import numpy as np


def lengths(vectors):
    """Lengths (...) of vectors (..., 2)."""
    x, y = np.moveaxis(np.asarray(vectors), -1, 0)
    return np.hypot(x, y)


def unit_vectors(angle_rad):
    """Vectors (..., 2) of length 1 at angles (...), counter-clockwise from east."""
    return np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)
