"""Groups of runs that tables have rows for: by case, by speed of the car, by direction."""

from collections.abc import Sequence

import numpy as np

from geometry.arrays import BoolArray
from scenarios.runs import FrameAxis

RunGroup = tuple[str, BoolArray]
"""Its name, and which runs are in it: (n_runs,) bool."""


def groups_by_case(axis: FrameAxis) -> list[RunGroup]:
    """A group per case, in the order in which the cases first appear."""
    return _equal(axis.cases)


def groups_by_direction(axis: FrameAxis) -> list[RunGroup]:
    """A group per approach from which the car comes, in the order in which they first appear."""
    return _equal(axis.approaches)


def groups_by_speed(axis: FrameAxis) -> list[RunGroup]:
    """A group per speed of the car, the slowest first."""
    speeds = axis.vut_speed_kmh
    return [(f"{speed:g}", speeds == speed) for speed in np.unique(speeds)]


def _equal(words: Sequence[str]) -> list[RunGroup]:
    of_run = np.array(words)
    return [(word, of_run == word) for word in dict.fromkeys(words)]
