"""Loops that draw detections frame by frame.

Every random number is a function of a key and a counter, so that only those are made
that are looked at, in any order: the bits of SplitMix64, and the ziggurat of Marsaglia
and Tsang.

References
----------
.. [1] G. L. Steele, D. Lea, C. H. Flood, "Fast splittable pseudorandom number
   generators", 2014.
.. [2] G. Marsaglia, W. W. Tsang, "The ziggurat method for generating random variables",
   2000.
.. [3] J. A. Doornik, "An improved ziggurat method to generate normal random samples",
   2005: the
   layer comes from other bits than the number, as here.
"""

import math
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


_N_LAYERS = 128  # of the ziggurat
# where its lowest layer ends, and the tail begins: of 128 layers [2]
_TAIL = 3.442619855899


def _layers() -> tuple[Array, Array]:
    """Half widths of the layers from the lowest on, the last one 0, and the density there."""
    density = np.exp(-0.5 * _TAIL**2)
    area = _TAIL * density + math.sqrt(math.pi / 2.0) * math.erfc(
        _TAIL / math.sqrt(2.0)
    )
    widths = [area / density, _TAIL]
    while len(widths) < _N_LAYERS:
        widths.append(
            math.sqrt(
                -2.0 * math.log(area / widths[-1] + math.exp(-0.5 * widths[-1] ** 2))
            )
        )
    half = np.array([*widths, 0.0])
    return half, np.exp(-0.5 * half**2)


_HALF_WIDTH, _DENSITY = _layers()


@kernel
def _share(bits: Any) -> Any:
    """A number from 0 to 1, of the upper 52 of 64 random bits; neither is reached."""
    return (np.float64(bits >> np.uint64(12)) + 0.5) / 2.0**52


@kernel
def _normal(key: Any, counter: int) -> Any:
    """A standard normal number."""
    bits = random_bits(key, counter)
    while True:
        layer = np.int64(
            bits & np.uint64(_N_LAYERS - 1)
        )  # these bits are not in the share
        x = (2.0 * _share(bits) - 1.0) * _HALF_WIDTH[layer]
        if abs(x) < _HALF_WIDTH[layer + 1]:
            return x
        more = random_bits(bits, 0)
        if layer == 0:
            tail = -np.log(_share(more)) / _TAIL
            if -2.0 * np.log(_share(random_bits(bits, 1))) > tail * tail:
                if x > 0.0:
                    return _TAIL + tail
                return -_TAIL - tail
        else:
            low = _DENSITY[layer]
            high = _DENSITY[layer + 1]
            if low + _share(more) * (high - low) < np.exp(-0.5 * x * x):
                return x
        bits = random_bits(bits, 2)


@kernel
def _linked(
    key: Any,
    correlation: float,
    step: float,
    run: int,
    place: int,
    before: int,
    last: float,
) -> float:
    """Noise at a place of a run, from that at a place before; -1 is before the first.

    Standard normal, a first-order autoregression: the frame of number `place` of a run
    has the fresh random number of counter `run` + `place`; `correlation` is that of a
    frame with the next.
    """
    for here in range(before + 1, place + 1):
        fresh = _normal(key, run + here)
        # The first one stands for all that came before.
        if here > 0:
            last = step * fresh + correlation * last
        else:
            last = fresh
    return last


@kernel
def draw_frames(
    limit: Array,
    weather_of_frame: Array,
    entry_of_frame: Array,
    run_of_frame: Array,
    place_of_frame: Array,
    key: Any,
    correlation: float,
    person: Array,
    own_key: Any,
    deviations: Array,
    packed: Array,
) -> None:
    """Bits (n_bytes,) of the frames whose noise is below the limit of what they show.

    `limit` (n_weathers, n_entries); a frame whose entry is -1 shows nothing. Noise is
    the sum of what the `person` (n_frames,) adds, of a number that lasts for a run, and
    of one that is linked from frame to frame, with this `correlation`; `deviations`
    (2,) are those of the last two.
    """
    step = np.sqrt(1.0 - correlation**2)
    run = -1
    before = -1
    last = 0.0
    own = 0.0
    for frame in range(len(entry_of_frame)):
        entry = entry_of_frame[frame]
        if entry < 0:
            continue
        least = limit[weather_of_frame[frame], entry]
        if least == -np.inf:
            continue
        if least < np.inf:
            place = place_of_frame[frame]
            if run_of_frame[frame] != run or place < before:
                run = run_of_frame[frame]
                before = -1
                last = 0.0
                own = deviations[0] * _normal(own_key, run)
            last = _linked(key, correlation, step, run, place, before, last)
            before = place
            if not deviations[1] * last + own + person[frame] < least:
                continue
        packed[frame >> 3] |= np.uint8(1 << (frame & 7))


@kernel
def draw_coins(counter: Array, key: Any, coins: Array) -> None:
    """Numbers from 0 to 1, one for each counter (n,)."""
    for index in range(len(counter)):
        coins[index] = _share(random_bits(key, counter[index]))


@kernel
def lose_frames(
    run_of_frame: Array,
    place_of_frame: Array,
    key: Any,
    loss: float,
    again_key: Any,
    again: float,
    packed: Array,
) -> None:
    """Take a share of the frames out of bits (n_bytes,), with counters `run` + `place`.

    Whether a frame is lost is drawn anew with the probability `again`, and is else as
    in the frame before: a chain of two states (E. N. Gilbert, "Capacity of a
    burst-noise channel", Bell System Technical Journal 39, 1960), with the same share
    of lost frames whatever `again` is.
    """
    for frame in range(len(run_of_frame)):
        bit = np.uint8(1 << (frame & 7))
        if not packed[frame >> 3] & bit:
            continue
        run = run_of_frame[frame]
        drawn = place_of_frame[frame]
        while drawn > 0 and not _share(random_bits(again_key, run + drawn)) < again:
            drawn -= 1
        if _share(random_bits(key, run + drawn)) < loss:
            packed[frame >> 3] &= np.uint8(~bit)
