"""Points and rows of numbers written as text, as in "8 -6, -8 6"."""

import numpy as np


def points_of(text):
    """Tuples of floats, one for each part between commas."""
    return [tuple(map(float, part.split())) for part in text.split(",")]


def array_of(text):
    """An (n, k) array of floats: a row for each part between commas."""
    return np.array(points_of(text))
