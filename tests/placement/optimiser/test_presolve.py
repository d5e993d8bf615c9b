"""What presolving leaves: words of bits, equal and dominated poses."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_array_equal

from placement.optimiser import Limits, PresolveStatistics
from placement.optimiser.presolve import (
    distinct_rows,
    is_dominated,
    pack_words,
    transpose_chosen,
    unpack_words,
)


@given(st.integers(0, 200), st.integers(0, 2**32 - 1))
def test_packing_words_loses_nothing(n_bits, seed):
    drawn = default_rng(seed).random((3, n_bits))
    bits = drawn < 0.5
    unpacked = unpack_words(pack_words(bits), n_bits)

    assert_array_equal(unpacked, bits)


@given(
    st.integers(1, 1200),
    st.integers(0, 1200),
    st.integers(0, 20),
    st.integers(0, 2**32 - 1),
)
def test_part_of_a_table_turned_round_has_its_bits(n_rows, n_chosen, n_bytes, seed):
    rng = default_rng(seed)
    rows = rng.integers(0, 256, (n_rows, n_bytes), dtype=np.uint8)
    chosen = rng.integers(0, n_rows, n_chosen)
    is_left = rng.random(8 * n_bytes) < 0.7
    left = rng.permutation(np.flatnonzero(is_left))
    columns = np.empty((len(left), -(-n_chosen // 64)), dtype=np.uint64)

    transpose_chosen(rows, chosen, left, columns, 2)
    unpacked = np.unpackbits(rows, axis=1, bitorder="little")
    bits = unpacked.view(bool)

    assert_array_equal(unpack_words(columns, n_chosen), bits[np.ix_(chosen, left)].T)


@given(st.integers(0, 60), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_rows_are_numbered_by_their_first_appearance(n_rows, n_words, seed):
    rng = default_rng(seed)
    rows = rng.integers(0, 4, (n_rows, n_words)).astype(np.uint64)
    mask = rng.integers(0, 4, n_words).astype(np.uint64)

    first, number = distinct_rows(rows, mask)
    seen = [tuple(row) for row in (rows & mask).tolist()]
    distinct = list(dict.fromkeys(seen))
    expected_number = [distinct.index(row) for row in seen]
    expected_first = [seen.index(row) for row in distinct]

    assert number.tolist() == expected_number
    assert first.tolist() == expected_first


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_poses_are_dominated_as_one_by_one(seed, max_units):
    rng = default_rng(seed)
    n_poses = 30
    n_sites = 8
    drawn = rng.random((n_poses, 100))
    share = rng.choice([0.02, 0.05, 0.98])
    bits = drawn < share
    limits = Limits(
        site_index=rng.integers(0, n_sites, n_poses),
        site_capacity=rng.integers(1, 4, n_sites),
        unit_cost_eur=rng.integers(1, 3, n_poses).astype(float),
        site_cost_eur=rng.integers(0, 2, n_sites).astype(float),
    )
    expected = []
    for pose in range(n_poses):
        n_at_site = np.zeros(n_sites, dtype=np.int64)
        for other in range(n_poses):
            price = limits.unit_cost_eur[other]
            if limits.site_index[other] != limits.site_index[pose]:
                price += limits.site_cost_eur[limits.site_index[other]]
            is_first = (bits[pose].sum(), -limits.unit_cost_eur[pose], -pose) < (
                bits[other].sum(),
                -limits.unit_cost_eur[other],
                -other,
            )
            is_above = (
                not (bits[pose] & ~bits[other]).any()
                and price <= limits.unit_cost_eur[pose]
            )
            n_at_site[limits.site_index[other]] += is_first and is_above

        own = limits.site_index[pose]
        n_limited = np.minimum(n_at_site, limits.site_capacity)
        n_blockers = int(n_limited.sum())
        expected.append(
            n_at_site[own] >= limits.site_capacity[own] or n_blockers >= max_units
        )

    found = is_dominated(pack_words(bits), limits, max_units=max_units)

    assert found.tolist() == expected


def test_statistics_read_as_sizes_before_and_after():
    statistics = PresolveStatistics(
        n_poses=(8640, 384),
        n_frames=(11668, 497),
        n_windows=(11436, 534),
        n_runs=(116, 104),
    )
    words = (
        "8640 -> 384 poses, 11668 -> 497 frames, 11436 -> 534 windows, 116 -> 104 runs"
    )

    assert str(statistics) == words
