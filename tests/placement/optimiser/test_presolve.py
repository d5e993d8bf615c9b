from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser import (
    Limits,
    PlacementProblem,
    PlacementValue,
    PresolveStatistics,
    placement_value,
    presolve,
)
from placement.optimiser.bit_kernels import ByteArray, transpose_chosen
from placement.optimiser.bitsets import set_values
from placement.optimiser.presolve import (
    distinct_rows,
    is_dominated,
    pack_words,
    unpack_words,
)

ANY_PROBLEM = st.from_type(PlacementProblem)
BestValue = Callable[[PlacementProblem, Iterable[int]], PlacementValue]


@given(problem=ANY_PROBLEM)
def test_presolve_changes_no_best_value(
    problem: PlacementProblem, best_value: BestValue
) -> None:
    reduced = presolve(problem)
    everywhere = best_value(problem, range(problem.table.n_poses))
    assert best_value(problem, reduced.pose_index.tolist()) == pytest.approx(
        everywhere, abs=1e-9
    )


@given(problem=ANY_PROBLEM)
def test_reduced_problem_values_every_set_as_the_table_does(
    problem: PlacementProblem,
) -> None:
    reduced = presolve(problem)
    n_units = min(problem.limits.max_units, reduced.n_poses)
    sets = np.array(list(combinations(range(reduced.n_poses), n_units)), dtype=np.int64)
    if n_units:
        sets = sets.reshape(-1, n_units)
    else:
        sets = np.empty((1, 0), dtype=np.int64)
    expected = [
        placement_value(problem, reduced.pose_index[units].tolist()) for units in sets
    ]
    values = set_values(reduced, sets).gains[:, 1:] * [1.0, 1.0, 1.0, 1.0, -1.0]
    np.testing.assert_allclose(values, np.array(expected), atol=1e-9)


@given(st.integers(0, 200), st.integers(0, 2**32 - 1))
def test_packing_words_loses_nothing(n_bits: int, seed: int) -> None:
    bits = np.random.default_rng(seed).random((3, n_bits)) < 0.5
    np.testing.assert_array_equal(unpack_words(pack_words(bits), n_bits), bits)


def packed_rows(rng: np.random.Generator, n_rows: int, n_bytes: int) -> ByteArray:
    """Bits as a table has them: not to be written to, or kernels would be compiled once
    more.
    """
    rows = rng.integers(0, 256, (n_rows, n_bytes), dtype=np.uint8)
    rows.setflags(write=False)
    return rows


@given(st.integers(0, 150), st.integers(0, 20), st.integers(0, 2**32 - 1))
def test_a_table_turned_round_has_the_same_bits(
    n_rows: int, n_bytes: int, seed: int
) -> None:
    rows = packed_rows(np.random.default_rng(seed), n_rows, n_bytes)
    columns = np.empty((8 * n_bytes, -(-n_rows // 64)), dtype=np.uint64)
    transpose_chosen(rows, np.arange(n_rows), np.arange(8 * n_bytes), columns)
    bits = np.unpackbits(rows, axis=1, bitorder="little").view(bool)
    np.testing.assert_array_equal(unpack_words(columns, n_rows), bits.T)


@given(
    st.integers(1, 1200),
    st.integers(0, 1200),
    st.integers(1, 20),
    st.integers(0, 2**32 - 1),
)
def test_part_of_a_table_turned_round_has_its_bits(
    n_rows: int, n_chosen: int, n_bytes: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rows = packed_rows(rng, n_rows, n_bytes)
    chosen = rng.integers(0, n_rows, n_chosen)
    left = np.flatnonzero(rng.random(8 * n_bytes) < 0.7)
    place = np.full(8 * n_bytes, -1)
    place[left] = rng.permutation(len(left))
    columns = np.empty((len(left), -(-n_chosen // 64)), dtype=np.uint64)
    transpose_chosen(rows, chosen, place, columns)
    bits = np.unpackbits(rows, axis=1, bitorder="little").view(bool)
    np.testing.assert_array_equal(
        unpack_words(columns[place[left]], n_chosen), bits[np.ix_(chosen, left)].T
    )


@given(st.integers(0, 60), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_rows_are_numbered_by_their_first_appearance(
    n_rows: int, n_words: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, 4, (n_rows, n_words)).astype(np.uint64)
    mask = rng.integers(0, 4, n_words).astype(np.uint64)
    first, number = distinct_rows(rows, mask)
    seen = [tuple(row) for row in (rows & mask).tolist()]
    distinct = list(dict.fromkeys(seen))
    assert number.tolist() == [distinct.index(row) for row in seen]
    assert first.tolist() == [seen.index(row) for row in distinct]


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_poses_are_dominated_as_one_by_one(seed: int, max_units: int) -> None:
    rng = np.random.default_rng(seed)
    n_poses = 30
    n_sites = 8
    bits = rng.random((n_poses, 100)) < rng.choice([0.02, 0.05, 0.98])
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
        n_blockers = int(np.minimum(n_at_site, limits.site_capacity).sum())
        expected.append(
            n_at_site[own] >= limits.site_capacity[own] or n_blockers >= max_units
        )
    assert (
        is_dominated(pack_words(bits), limits, max_units=max_units).tolist() == expected
    )


def test_dominated_pose_stays_while_its_dominators_can_be_used_up() -> None:
    words = pack_words(np.array([[1, 1], [1, 0]], dtype=bool))
    site = np.array([0, 1])
    capacity = np.array([1, 1])
    # With one unit the first pose does it; with two, the second pose is wanted beside
    # it.
    assert is_dominated(
        words, Limits(site_index=site, site_capacity=capacity), max_units=1
    ).tolist() == [False, True]
    assert is_dominated(
        words, Limits(site_index=site, site_capacity=capacity), max_units=2
    ).tolist() == [False, False]


def test_dominated_pose_goes_when_its_own_site_has_room_for_the_dominator_alone() -> (
    None
):
    words = pack_words(np.array([[1, 0], [1, 1]], dtype=bool))
    for capacity, expected in ((1, [True, False]), (2, [False, False])):
        limits = Limits(site_index=np.array([0, 0]), site_capacity=np.array([capacity]))
        assert is_dominated(words, limits, max_units=3).tolist() == expected


def test_a_pose_that_sees_more_dominates_only_where_it_costs_no_more() -> None:
    words = pack_words(np.array([[1, 1], [1, 0]], dtype=bool))
    limits = Limits(site_index=np.array([0, 0]), site_capacity=np.array([1]))
    for prices, expected in (((5.0, 5.0), [False, True]), ((6.0, 5.0), [False, False])):
        priced = replace(limits, unit_cost_eur=np.array(prices))
        assert is_dominated(words, priced, max_units=1).tolist() == expected
    forced = replace(limits, is_forced=np.array([False, True]))
    assert is_dominated(words, forced, max_units=1).tolist() == [False, False]


def test_a_site_that_must_be_paid_does_not_dominate_another() -> None:
    words = pack_words(np.array([[1, 1], [1, 0]], dtype=bool))
    limits = Limits(site_index=np.array([0, 1]), site_capacity=np.array([1, 1]))
    assert is_dominated(words, limits, max_units=1).tolist() == [False, True]
    paid = replace(limits, site_cost_eur=np.array([9.0, 0.0]))
    assert is_dominated(words, paid, max_units=1).tolist() == [False, False]
    asked = replace(limits, is_forced_site=np.array([False, True]))
    assert is_dominated(words, asked, max_units=1).tolist() == [False, False]


def test_of_equal_poses_the_earlier_stays() -> None:
    words = pack_words(np.ones((3, 1), dtype=bool))
    site = np.zeros(3, dtype=np.int64)
    capacity = np.array([1])
    assert is_dominated(
        words, Limits(site_index=site, site_capacity=capacity), max_units=1
    ).tolist() == [False, True, True]


def test_statistics_read_as_sizes_before_and_after() -> None:
    statistics = PresolveStatistics(
        n_poses=(8640, 384),
        n_frames=(11668, 497),
        n_windows=(11436, 534),
        n_runs=(116, 104),
    )
    assert (
        str(statistics)
        == "8640 -> 384 poses, 11668 -> 497 frames, 11436 -> 534 windows, 116 -> 104"
        " runs"
    )
