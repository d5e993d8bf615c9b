"""Loops that draw detections frame by frame."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.kernels import kernel

Array = NDArray[Any]


@kernel
def link_noise(fresh: Array, correlation: float) -> None:
    """Make independent standard normal numbers, (n_runs, n), a first-order autoregression in each.

    In place; `correlation` is that of a number with the next, 0 .. 1.
    """
    step = np.sqrt(1.0 - correlation**2)
    for run in range(fresh.shape[0]):
        last = fresh[run, 0]  # the first one stands for all that came before
        for frame in range(1, fresh.shape[1]):
            last = step * fresh[run, frame] + correlation * last
            fresh[run, frame] = last


@kernel
def draw_frames(
    limit: Array,
    weather_of_frame: Array,
    entry_of_frame: Array,
    noise: Array,
    cell_of_frame: Array,
    packed: Array,
) -> None:
    """Bits (n_bytes,) of the frames whose noise is below the limit of what they show.

    `limit` (n_weathers, n_entries); a frame whose entry is -1 shows nothing. `noise` is that of all
    cells, of which each frame has one.
    """
    for frame in range(len(entry_of_frame)):
        entry = entry_of_frame[frame]
        if entry >= 0 and noise[cell_of_frame[frame]] < limit[weather_of_frame[frame], entry]:
            packed[frame >> 3] |= np.uint8(1 << (frame & 7))
