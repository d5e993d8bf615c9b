"""Machine code on merged frames: which windows of chains sets of poses see, and are live.

Everything here works on plain arrays; :mod:`placement.optimiser.presolve` says what they hold.
"""

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

from .presolve import Chains, WordArray


@kernel
def has_frame(union: WordArray, frame: int) -> bool:
    """Whether a union has a merged frame."""
    return bool((union[frame >> 6] >> np.uint64(frame & 63)) & np.uint64(1) != 0)


@kernel
def first_live_link(union: WordArray, chains: Chains, chain: int) -> int:
    """First live window of a chain that a union of merged frames sees; their number if none."""
    begin, end = chains.start[chain], chains.start[chain + 1]
    place = begin
    for tail in range(chains.tail_start[chain], chains.tail_start[chain + 1]):
        if not has_frame(union, chains.tail_frame[tail]):
            place += chains.tail_links[tail]
            break
    while place < end:
        is_seen = True
        for frame in chains.window_frames[chains.window[place]]:
            is_seen &= has_frame(union, frame)
        if is_seen:
            break
        place += 1
    return int(place - begin)


@kernel
def first_live_windows(unions: WordArray, chains: Chains, first: IntArray) -> None:
    """First live window of each chain for each union of merged frames, (n_unions, n_chains).

    The number of the chain's windows where none is live.
    """
    for row in range(len(unions)):
        for chain in range(len(chains.start) - 1):
            first[row, chain] = first_live_link(unions[row], chains, chain)


@kernel
def drop_lost_windows(seen: WordArray, frames: WordArray, chains: Chains) -> None:
    """Clear windows that are not live; bits along sets: (n_links, n_words), (n_frames, n_words)."""
    held = np.empty(seen.shape[1], dtype=np.uint64)
    for chain in range(len(chains.start) - 1):
        held[:] = ~np.uint64(0)
        tail, last = chains.tail_start[chain], chains.tail_start[chain + 1]
        for number in range(chains.start[chain + 1] - chains.start[chain] - 1, -1, -1):
            while tail < last and chains.tail_links[tail] > number:
                held &= frames[chains.tail_frame[tail]]
                tail += 1
            seen[chains.start[chain] + number] &= held


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
    order = np.arange(n_chains)
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
            total = 0.0
            for rank in range(n_chains):
                chain = order[rank]
                total += lost[chain, first_live_link(union, chains, chain)]
                if total > most_lost:
                    kept[row] = False
                    before = rank // 2  # nearer to the front, not all the way: some fail by chance
                    order[rank], order[before] = order[before], chain
                    break
            if not kept[row]:
                break
