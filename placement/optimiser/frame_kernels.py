"""Machine code on merged frames: which windows of chains sets of poses see, and are live.

Everything here works on plain arrays; :mod:`placement.optimiser.presolve` says what they hold.
"""

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

from .chain_kernels import lowest_bit
from .problem import Chains, WordArray


@kernel
def turn_blocks(block: WordArray) -> None:
    """Exchange rows and bits of each column, (64, n).

    Blocks of 64 x 64 bits are turned by exchanging their quarters, down to single bits (Warren,
    Hacker's Delight, 7-3).
    """
    width, mask, n_words = 32, np.uint64(0x00000000FFFFFFFF), np.uint64(block.shape[1])
    while width:
        shift = np.uint64(width)
        for begin in range(0, 64, 2 * width):
            for one in range(begin, begin + width):
                for word in range(n_words):
                    swapped = ((block[one, word] >> shift) ^ block[one + width, word]) & mask
                    block[one, word] ^= swapped << shift
                    block[one + width, word] ^= swapped
        width >>= 1
        mask ^= mask << np.uint64(width)


@kernel
def look_through(
    union: WordArray,
    window_frames: IntArray,
    window: IntArray,
    start: IntArray,
    tail_frame: IntArray,
    tail_links: IntArray,
    tail_start: IntArray,
    order: IntArray,
    lost: FloatArray,
    most_lost: float,
    first: IntArray,
) -> int:
    """First live windows of chains in some order, until too much is lost: how many that took.

    ``lost[g, k]`` is what is lost in chain g if the k-th of its windows is the first live one of a
    union of merged frames; it has no rows if nothing can be lost. ``first[g]`` is the number of the
    chain's windows where none is live.
    """
    total = 0.0
    for rank in range(len(order)):
        chain = order[rank]
        place, end = start[chain], start[chain + 1]
        for tail in range(tail_start[chain], tail_start[chain + 1]):
            frame = tail_frame[tail]
            if (union[frame >> 6] >> np.uint64(frame & 63)) & np.uint64(1) == 0:
                place += tail_links[tail]
                break
        while place < end:
            is_seen = np.uint64(1)
            for number in range(window_frames.shape[1]):
                frame = window_frames[window[place], number]
                is_seen &= union[frame >> 6] >> np.uint64(frame & 63)
            if is_seen:
                break
            place += 1
        first[chain] = place - start[chain]
        if len(lost):
            total += lost[chain, first[chain]]
            if total > most_lost:
                return rank
    return len(order)


@kernel
def first_live_windows(unions: WordArray, chains: Chains, first: IntArray) -> None:
    """First live window of each chain for each union of merged frames, (n_unions, n_chains)."""
    order, nothing = np.arange(len(chains.start) - 1), np.empty((0, 0))
    for row in range(len(unions)):
        look_through(
            unions[row],
            chains.window_frames,
            chains.window,
            chains.start,
            chains.tail_frame,
            chains.tail_links,
            chains.tail_start,
            order,
            nothing,
            0.0,
            first[row],
        )


@kernel
def first_live_with_each(
    columns: WordArray,
    is_seen: BoolArray,
    chains: Chains,
    begin: int,
    end: int,
    first: NDArray[np.int32],
) -> None:
    """First live window of chains begin .. end - 1 for a set with each pose: (n_chains, n_poses).

    `columns` has bits along the poses, (n_frames, n_words), `is_seen` (n_frames,) what the set sees
    by itself.
    """
    window_frames, window, start, tail_frame, tail_links, tail_start = chains
    n_words, n_poses = columns.shape[1], first.shape[1]
    every = ~np.uint64(0)
    # Row t: poses with which the first t tails of the chain are seen, those that most windows need.
    most = 0
    for chain in range(begin, end):
        most = max(most, tail_start[chain + 1] - tail_start[chain])
    held = np.empty((most + 1, n_words), dtype=np.uint64)
    held[0] = every
    left = np.empty(n_words, dtype=np.uint64)  # poses with which no window has been live so far
    live = np.empty(n_words, dtype=np.uint64)  # those with which a window is
    for chain in range(begin, end):
        tail, n_tails = tail_start[chain], tail_start[chain + 1] - tail_start[chain]
        for number in range(n_tails):
            frame = tail_frame[tail + number]
            for word in range(n_words):
                seen = every if is_seen[frame] else columns[frame, word]
                held[number + 1, word] = held[number, word] & seen
        n_links = start[chain + 1] - start[chain]
        first[chain] = n_links
        left[:] = every
        if n_poses & 63:
            left[n_words - 1] = (np.uint64(1) << np.uint64(n_poses & 63)) - np.uint64(1)
        for link in range(n_links):
            while n_tails > 0 and tail_links[tail + n_tails - 1] <= link:
                n_tails -= 1
            # Frame by frame the compiler takes several words at a time.
            for word in range(n_words):
                live[word] = left[word] & held[n_tails, word]
            for frame in window_frames[window[start[chain] + link]]:
                if not is_seen[frame]:
                    for word in range(n_words):
                        live[word] &= columns[frame, word]
            for word in range(n_words):
                left[word] &= ~live[word]
                new = live[word]
                while new != 0:
                    first[chain, 64 * word + lowest_bit(new)] = link
                    new &= new - np.uint64(1)


@kernel
def lose_little(
    words: WordArray,
    sets: IntArray,
    with_failures: bool,
    chains: Chains,
    lost: FloatArray,
    most_lost: float,
    kept: BoolArray,
) -> None:
    """Whether sets lose no more than so much: all their units, or whichever one of them fails.

    ``lost[g, k]`` is what is lost in chain g if the k-th of its windows is the first live one. Few
    sets are looked at as a whole: the chains at which others before failed come first.
    """
    n_chains = len(chains.start) - 1
    order, first = np.arange(n_chains), np.empty(n_chains, dtype=np.int64)
    union = np.empty(words.shape[1], dtype=np.uint64)
    for row in range(len(sets)):
        kept[row] = most_lost >= 0.0
        for case in range(sets.shape[1] if with_failures else 1):
            failed = case if with_failures else -1
            for word in range(len(union)):
                union[word] = 0
            for unit in range(sets.shape[1]):
                if unit != failed:
                    of_unit = words[sets[row, unit]]
                    for word in range(len(union)):
                        union[word] |= of_unit[word]
            rank = look_through(
                union,
                chains.window_frames,
                chains.window,
                chains.start,
                chains.tail_frame,
                chains.tail_links,
                chains.tail_start,
                order,
                lost,
                most_lost,
                first,
            )
            if rank < n_chains:
                kept[row] = False
                before = rank // 2  # nearer to the front, not all the way: some fail by chance
                order[rank], order[before] = order[before], order[rank]
            if not kept[row]:
                break
