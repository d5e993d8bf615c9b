"""Loops that draw detections frame by frame.

Every random number is a function of a key and a counter, so that only those are made that are
looked at, in any order: the finaliser of SplitMix64, and the transform of Box and Muller.

References
----------
.. [1] G. L. Steele, D. Lea, C. H. Flood, "Fast splittable pseudorandom number generators", 2014.
.. [2] G. E. P. Box, M. E. Muller, "A note on the generation of random normal deviates", 1958.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.kernels import kernel

Array = NDArray[Any]


@kernel
def random_bits(key: Any, counter: int) -> Any:
    """Random 64 bits of a key (uint64): number `counter` of the sequence of SplitMix64."""
    bits = key + np.uint64(counter + 1) * np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


@kernel
def _normal(key: Any, counter: int) -> float:
    """A standard normal number; none is beyond 6.8."""
    bits = random_bits(key, counter)
    radius = (np.float64(bits >> np.uint64(32)) + 0.5) / 2.0**32
    turn = np.float64(bits & np.uint64(0xFFFFFFFF)) / 2.0**32
    return float(np.sqrt(-2.0 * np.log(radius)) * np.cos(2.0 * np.pi * turn))


@kernel
def _linked(
    key: Any, correlation: float, step: float, run: int, place: int, before: int, last: float
) -> float:
    """Noise at a place of a run (its first cell), from that of a place before; -1 is the start."""
    for here in range(before + 1, place + 1):
        fresh = _normal(key, run + here)
        # The first one stands for all that came before.
        last = step * fresh + correlation * last if here > 0 else fresh
    return last


@kernel
def link_noise(cell: Array, longest: int, key: Any, correlation: float, noise: Array) -> None:
    """Noise of cells (n,): standard normal, a first-order autoregression in each run.

    A run has `longest` cells; `correlation` is that of a cell with the next, 0 .. 1.
    """
    step = np.sqrt(1.0 - correlation**2)
    for index in range(len(cell)):
        place = cell[index] % longest
        noise[index] = _linked(key, correlation, step, cell[index] - place, place, -1, 0.0)


@kernel
def draw_frames(
    limit: Array,
    weather_of_frame: Array,
    entry_of_frame: Array,
    cell_of_frame: Array,
    longest: int,
    key: Any,
    correlation: float,
    packed: Array,
) -> None:
    """Bits (n_bytes,) of the frames whose noise is below the limit of what they show.

    `limit` (n_weathers, n_entries); a frame whose entry is -1 shows nothing. The noise of each
    frame's cell is as in :func:`link_noise`.
    """
    step = np.sqrt(1.0 - correlation**2)
    run, before, last = -1, -1, 0.0
    for frame in range(len(entry_of_frame)):
        entry = entry_of_frame[frame]
        if entry < 0:
            continue
        least = limit[weather_of_frame[frame], entry]
        if least == -np.inf:
            continue
        if least < np.inf:
            place = cell_of_frame[frame] % longest
            if cell_of_frame[frame] - place != run or place < before:
                run, before, last = cell_of_frame[frame] - place, -1, 0.0
            last = _linked(key, correlation, step, run, place, before, last)
            before = place
            if not last < least:
                continue
        packed[frame >> 3] |= np.uint8(1 << (frame & 7))


@kernel
def lose_frames(cell_of_frame: Array, key: Any, loss: float, packed: Array) -> None:
    """Take a share of the frames out of bits (n_bytes,), those of one cell alike."""
    for frame in range(len(cell_of_frame)):
        bit = np.uint8(1 << (frame & 7))
        if packed[frame >> 3] & bit:
            chance = np.float64(random_bits(key, cell_of_frame[frame]) >> np.uint64(11)) / 2.0**53
            if chance < loss:
                packed[frame >> 3] &= np.uint8(~bit)
