"""Machine code on detections that are laid out by chains: what sets of poses are worth.

Bit k of the words of chain g in phase i says whether a pose sees the i-th frame of the chain's k-th
window. A set sees a window if every phase has its bit in the union. Behind the phases there is a
row for tails, if there are any: bit t says whether a pose sees the chain's t-th tail. The first one
that the union lacks ends most windows; the first of the others that is seen is the first live one.
A chain is then worth ``worth[g, k]`` with k that window.
"""

from typing import NamedTuple

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.kernels import kernel

from .problem import WordArray


class Layout(NamedTuple):
    """Detections by chains."""

    # (n_poses, n_words, n_phases), and a row more if there are tails; padding behind the tails is
    # set. Who loops over chains takes all arrays as arguments: to look them up in here, or to call
    # a function per chain, takes five times as long as the chain.
    bits: WordArray
    n_phases: int
    start: IntArray  # (n_chains + 1,): first word of each chain
    tail_links: IntArray  # (n_tails,): windows that need each tail, falling in each chain
    tail_start: IntArray  # (n_chains + 1,): tails of each chain


@kernel
def lowest_bit(word: np.uint64) -> int:
    """Place of the lowest bit of a word that is not 0."""
    lowest = word & (~word + np.uint64(1))
    place = 0
    if lowest & np.uint64(0xFFFFFFFF00000000):
        place += 32
    if lowest & np.uint64(0xFFFF0000FFFF0000):
        place += 16
    if lowest & np.uint64(0xFF00FF00FF00FF00):
        place += 8
    if lowest & np.uint64(0xF0F0F0F0F0F0F0F0):
        place += 4
    if lowest & np.uint64(0xCCCCCCCCCCCCCCCC):
        place += 2
    if lowest & np.uint64(0xAAAAAAAAAAAAAAAA):
        place += 1
    return place


@kernel
def join(bits: WordArray, pose: int, union: WordArray, joined: WordArray) -> None:
    """What a union and a pose see together."""
    for word in range(bits.shape[1]):
        for row in range(bits.shape[2]):
            joined[word, row] = union[word, row] | bits[pose, word, row]


@kernel
def lost_with(
    seen: WordArray,
    union: WordArray,
    n_phases: int,
    start: IntArray,
    tail_links: IntArray,
    tail_start: IntArray,
    worth: FloatArray,
    chains: IntArray,
    n_chains: int,
    most: float,
    first: IntArray,
) -> float:
    """What a union and a pose, which has `seen`, lose in the first of some chains.

    It ends once that is more than `most`. `first` takes the first live window of each chain that
    was looked at, in their order.
    """
    none = worth.shape[1] - 1
    lost = 0.0
    for number in range(n_chains):
        chain = chains[number]
        begin, end = start[chain], start[chain + 1]
        lowest, tail = 0, tail_start[chain]
        if tail < tail_start[chain + 1]:
            for word in range(begin, end):
                unseen = ~(seen[word, n_phases] | union[word, n_phases])
                if unseen != 0:
                    lowest = tail_links[tail + 64 * (word - begin) + lowest_bit(unseen)]
                    break
        mask = ~np.uint64(0) << np.uint64(lowest & 63)
        link = none
        for word in range(begin + (lowest >> 6), end):
            live = mask
            for phase in range(n_phases):
                live &= seen[word, phase] | union[word, phase]
            if live != 0:
                link = 64 * (word - begin) + lowest_bit(live)
                break
            mask = ~np.uint64(0)
        first[number] = link
        lost += worth[chain, 0] - worth[chain, link]
        if lost > most:
            break
    return lost


@kernel
def set_links(
    layout: Layout, worth: FloatArray, sets: IntArray, left_out: int, first: IntArray
) -> None:
    """First live window of each chain for each set, one unit left out, (n_sets, n_chains).

    A negative number leaves none out.
    """
    n_chains = len(layout.start) - 1
    every = np.arange(n_chains)
    union = np.empty(layout.bits.shape[1:], dtype=np.uint64)
    for row in range(len(sets)):
        union[:] = 0
        n_units = 0
        for unit in range(sets.shape[1]):
            if unit != left_out:
                join(layout.bits, sets[row, unit], union, union)
                n_units += 1
        first[row] = worth.shape[1] - 1
        if n_units > 0:
            lost_with(
                union,
                union,
                layout.n_phases,
                layout.start,
                layout.tail_links,
                layout.tail_start,
                worth,
                every,
                n_chains,
                np.inf,
                first[row],
            )
