"""Kernels on bits against a few lines of plain Python each."""

from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from kernel_cases import (
    N_FRAMES,
    columns_of,
    first_live,
    n_chains_of,
    random_chains,
    random_sights,
)
from numpy.random import default_rng
from numpy.testing import assert_array_equal

from placement.optimiser import bit_kernels as kernels
from placement.optimiser.presolve import pack_words, unpack_words

SEEDS = st.integers(0, 2**32 - 1)
WORDS = st.integers(0, 2**64 - 1)


@given(WORDS)
def test_bits_of_a_word_are_counted(word):
    counted = kernels.count_bits(np.uint64(word))
    expected = word.bit_count()
    assert counted == expected


@given(st.integers(0, 63), WORDS)
def test_the_lowest_bit_is_the_number_of_zeros_below_it(place, above):
    bits = above << (place + 1) | 1 << place
    word = bits % 2**64
    lowest = kernels.lowest_bit(np.uint64(word))

    assert lowest == place


@given(SEEDS)
def test_a_range_of_rows_has_the_bits_of_all_its_rows(seed):
    rng = default_rng(seed)
    bits = rng.random((8, 100)) < 0.2
    begin = rng.integers(0, 9, 6)
    lengths = rng.integers(0, 4, 6)
    end = np.minimum(begin + lengths, 8)
    joined = np.full((6, 2), 7, dtype=np.uint64)  # what stands there is overwritten

    kernels.join_ranges(pack_words(bits), begin, end, joined)
    expected = np.array(
        [bits[one:other].any(axis=0) for one, other in zip(begin, end, strict=True)]
    )

    assert_array_equal(unpack_words(joined, 100), expected)


def runs_of_windows(rng):
    """Frames of windows, run by run, and tails: a frame, and how many first windows
    need it.
    """
    n_windows = rng.integers(2, 7, 2)
    n_all_windows = n_windows.sum()
    frames_of = rng.integers(0, 4, (n_all_windows, 2))
    sets = np.sort(frames_of, axis=1)
    tail_frame = []
    n_links = []
    n_tails = []
    for most in n_windows.tolist():
        links = sorted(
            rng.integers(1, most + 1, int(rng.integers(0, 3))).tolist(), reverse=True
        )
        n_links += links
        shuffled = rng.permutation(4)
        tail_frame += shuffled[: len(links)].tolist()
        n_tails.append(len(links))

    window_start = np.cumsum([0, *n_windows])
    tail_start = np.cumsum([0, *n_tails])
    starts = window_start, tail_start
    return (
        sets,
        starts[0],
        np.array(tail_frame, dtype=np.int64),
        starts[1],
        np.array(n_links, dtype=np.int64),
    )


@given(SEEDS)
def test_windows_that_are_thinned_out_are_never_the_first_live_ones(seed):
    sets, start, tail_frame, tail_start, n_links = runs_of_windows(default_rng(seed))
    before = n_links.copy()
    is_kept = np.zeros(len(sets), dtype=bool)
    kernels.thin_out(
        sets,
        start,
        tail_frame,
        tail_start,
        n_links,
        is_kept,
    )
    unions = [set(seen) for size in range(5) for seen in combinations(range(4), size)]

    for run in range(2):
        windows = range(start[run], start[run + 1])
        tails = range(tail_start[run], tail_start[run + 1])
        kept = [window for window in windows if is_kept[window]]

        for seen in unions:
            live = [
                window
                for window in windows
                if seen.issuperset(sets[window])
                and all(
                    tail_frame[t] in seen
                    for t in tails
                    if window - windows[0] < before[t]
                )
            ]
            # The same by what is left: the kept windows, and the tails that their first
            # ones need.
            left = [
                window
                for place, window in enumerate(kept)
                if seen.issuperset(sets[window])
                and all(tail_frame[t] in seen for t in tails if place < n_links[t])
            ]
            assert live[:1] == left[:1]


def drawn(seed):
    """A generator and random chains."""
    rng = default_rng(seed)
    return rng, random_chains(rng)


@given(SEEDS)
def test_the_first_live_window_has_all_frames_and_tails(seed):
    rng, chains = drawn(seed)
    seen = random_sights(rng, 5, share=0.7)
    shape = (5, n_chains_of(chains))
    first = np.empty(shape, dtype=np.int64)

    kernels.first_live_windows(pack_words(seen), chains, first)

    for row, union in enumerate(seen):
        seen_frames = np.flatnonzero(union)
        frames = seen_frames.tolist()
        for chain in range(n_chains_of(chains)):
            expected = first_live(chains, chain, frames)
            assert first[row, chain] == expected


@given(SEEDS, st.sampled_from([1, 63, 64, 70]))
def test_first_live_windows_with_each_pose_are_those_of_the_unions(seed, n_poses):
    rng, chains = drawn(seed)
    sees = random_sights(rng, n_poses)
    alone = rng.random(N_FRAMES) < 0.3
    n_chains = n_chains_of(chains)
    drawn_begin = rng.integers(0, n_chains + 1)
    begin = int(drawn_begin)
    first = np.full((n_chains, n_poses), -1, dtype=np.int32)

    kernels.first_live_with_each(
        columns_of(sees),
        alone,
        chains,
        begin,
        n_chains,
        first,
    )

    assert (first[:begin] == -1).all()

    for chain in range(begin, n_chains):
        for pose in range(n_poses):
            seen_frames = np.flatnonzero(sees[pose] | alone)
            frames = seen_frames.tolist()
            expected = first_live(chains, chain, frames)

            assert first[chain, pose] == expected
