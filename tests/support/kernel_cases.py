"""Small random inputs of the optimiser's kernels, and their answers in plain loops."""

from collections.abc import Iterable

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from placement.optimiser.presolve import pack_words
from placement.optimiser.problem import Chains, WordArray

N_FRAMES = 9


def random_chains(rng: np.random.Generator, *, n_frames: int = N_FRAMES) -> Chains:
    """Up to four chains of up to five windows, with tails; some chains may have no
    windows.
    """
    n_windows = int(rng.integers(1, 7))
    n_chains = int(rng.integers(1, 5))
    n_links = rng.integers(0, 6, n_chains)
    tails: list[list[tuple[int, int]]] = []

    for most in n_links.tolist():
        if most:
            frames = rng.permutation(n_frames)[: rng.integers(0, 3)].tolist()
        else:
            frames = []
        links = sorted((int(rng.integers(1, most + 1)) for _ in frames), reverse=True)
        tails.append(list(zip(frames, links, strict=True)))

    flat = [tail for of_chain in tails for tail in of_chain]
    return Chains(
        window_frames=rng.integers(0, n_frames, (n_windows, int(rng.integers(1, 4)))),
        window=rng.integers(0, n_windows, int(n_links.sum())),
        start=np.cumsum([0, *n_links]),
        tail_frame=np.array([frame for frame, _ in flat], dtype=np.int64),
        tail_links=np.array([links for _, links in flat], dtype=np.int64),
        tail_start=np.cumsum([0, *map(len, tails)]),
    )


def n_chains_of(chains: Chains) -> int:
    """How many chains there are."""
    return len(chains.start) - 1


def n_links_of(chains: Chains, chain: int) -> int:
    """How many links a chain has."""
    return int(chains.start[chain + 1] - chains.start[chain])


def tails_of(chains: Chains, chain: int) -> list[tuple[int, int]]:
    """Frame of each tail of a chain, and how many of its first windows need it."""
    mine = range(chains.tail_start[chain], chains.tail_start[chain + 1])
    return [
        (int(chains.tail_frame[tail]), int(chains.tail_links[tail])) for tail in mine
    ]


def needed(chains: Chains, chain: int, link: int) -> tuple[set[int], set[int]]:
    """Frames of a window of a chain, and frames of the tails without which it is not
    live.
    """
    frames = set(
        chains.window_frames[chains.window[chains.start[chain] + link]].tolist()
    )
    return frames, {frame for frame, links in tails_of(chains, chain) if links > link}


def first_live(chains: Chains, chain: int, seen: Iterable[int]) -> int:
    """First window of a chain whose frames and tails are all seen; their number if none
    is.
    """
    for link in range(n_links_of(chains, chain)):
        frames, tails = needed(chains, chain, link)
        if frames | tails <= set(seen):
            return link

    return n_links_of(chains, chain)


def bits_of(words: WordArray, n_bits: int) -> set[int]:
    """Places of the bits that are set in a row of words."""
    return {bit for bit in range(n_bits) if int(words[bit // 64]) >> (bit % 64) & 1}


def random_sights(
    rng: np.random.Generator, n_poses: int, *, share: float = 0.5
) -> BoolArray:
    """What poses see, (n_poses, N_FRAMES)."""
    return rng.random((n_poses, N_FRAMES)) < share


def columns_of(sees: BoolArray) -> WordArray:
    """The same with bits along the poses, (N_FRAMES, n_words)."""
    return np.ascontiguousarray(pack_words(sees.T))


def whole_weights(rng: np.random.Generator, n: int) -> FloatArray:
    """Small whole numbers, whose sums are exact in any order."""
    return rng.integers(1, 6, n).astype(np.float64)


def random_rows(rng: np.random.Generator, chains: Chains) -> tuple[IntArray, IntArray]:
    """Chain of some rows, and how many of its first windows count; none for an empty
    chain.
    """
    row_chain = rng.integers(0, n_chains_of(chains), 6)
    row_chain = row_chain[[n_links_of(chains, chain) > 0 for chain in row_chain]]
    last = [int(rng.integers(1, n_links_of(chains, chain) + 1)) for chain in row_chain]
    return row_chain, np.array(last, dtype=np.int64)
