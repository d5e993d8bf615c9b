"""Machine code for the root of the tree: detections laid out by chains, what windows are asked for.

Everything here works on plain arrays; :mod:`placement.optimiser.set_tree` says what they hold.
"""

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.kernels import kernel

from .presolve import WordArray


@kernel
def first_windows(
    bits: WordArray,
    n_phases: int,
    start: IntArray,
    asked: WordArray,
    part_start: IntArray,
    part_place: IntArray,
    part_links: WordArray,
    none: int,
    first: IntArray,
    begin: int,
    end: int,
) -> None:
    """First window of each chain of which each pose sees what is asked for, (n_poses, n_chains).

    Poses begin .. end - 1 are looked at. `asked`, (n_phases, n_words), has a bit where a window is
    asked for a phase: seen is the window if a pose sees that. Others are asked for tails: parts of
    words, those of word w from ``part_start[w]`` on, whose windows, ``part_links``, all need the
    tail at ``part_place``.
    """
    for pose in range(begin, end):
        for chain in range(len(start) - 1):
            first[pose, chain] = none
            for word in range(start[chain], start[chain + 1]):
                seen = np.uint64(0)
                for part in range(part_start[word], part_start[word + 1]):
                    place = part_place[part]
                    if (bits[pose, place >> 6, n_phases] >> np.uint64(place & 63)) & np.uint64(1):
                        seen |= part_links[part]
                for phase in range(n_phases):
                    seen |= bits[pose, word, phase] & asked[phase, word]
                if seen != 0:
                    link = 64 * (word - start[chain])
                    while seen & np.uint64(1) == 0:
                        seen >>= np.uint64(1)
                        link += 1
                    first[pose, chain] = link
                    break


@kernel
def add_up(bits: WordArray, row: int, poses: IntArray, share: FloatArray, seen: FloatArray) -> None:
    """How often some poses see each bit of a row, at most once, (64 n_words,), by their shares."""
    seen[:] = 0.0
    for number in range(len(poses)):
        for word in range(bits.shape[1]):
            left, place = bits[poses[number], word, row], 64 * word
            while left:
                if left & np.uint64(1):
                    seen[place] += share[number]
                left >>= np.uint64(1)
                place += 1
    for place in range(len(seen)):
        seen[place] = min(seen[place], 1.0)


@kernel
def ask_for_tails(
    start: IntArray,
    tail_links: IntArray,
    tail_start: IntArray,
    seen_of_tail: FloatArray,
    seen: FloatArray,
    asked_place: IntArray,
) -> None:
    """Ask every window for the tail that is seen least of those that it needs.

    `seen_of_tail`, (n_tails,), is how much of each is seen; `seen`, (64 n_words,), becomes that of
    the tail that a window is asked for, and `asked_place`, (64 n_words,), where its bit is.
    """
    for chain in range(len(start) - 1):
        first, last = tail_start[chain], tail_start[chain + 1]
        begin = 64 * start[chain]
        least, tail = first, first
        while tail < last:
            if seen_of_tail[tail] < seen_of_tail[least]:
                least = tail
            n_links = tail_links[tail]
            tail += 1
            fewer = tail_links[tail] if tail < last else 0
            for link in range(fewer, n_links):
                seen[begin + link] = seen_of_tail[least]
                asked_place[begin + link] = begin + least - first
