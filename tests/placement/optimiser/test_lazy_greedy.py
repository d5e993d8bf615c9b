import numpy as np
import pytest
from coverages import best_value, coverages, value_of
from hypothesis import given
from hypothesis import strategies as st

from geometry.arrays import IntArray
from placement.optimiser.bounds import Coverage, Supply, gains
from placement.optimiser.greedy import (
    fill,
    lazy_greedy,
    round_shares,
    search_around,
    swap,
    swap_gains,
)
from placement.optimiser.window_cover import choose_greedily

SEED = st.integers(0, 2**32 - 1)


def coverage_supply(random: np.random.Generator, *, n_poses: int) -> Supply:
    return Supply(
        max_units=6,
        site_index=random.integers(0, 5, n_poses),
        site_capacity=np.full(5, 2),
    )


def plain_greedy(coverage: Coverage, *, per_euro: bool) -> list[int]:
    chosen: list[int] = []
    while True:
        poses = np.array(chosen, dtype=np.int64)
        gain = gains(coverage.values, coverage.level(poses))
        gain[~coverage.supply.has_room(poses)] = 0.0
        if per_euro:
            gain = gain / np.maximum(coverage.supply.extra_cost_eur(poses), 1e-9)
        if not gain.max() > 0.0:
            return chosen
        chosen.append(int(gain.argmax()))


@given(coverages(), st.booleans())
def test_lazy_greedy_is_plain_greedy(coverage: Coverage, per_euro: bool) -> None:
    expected = plain_greedy(coverage, per_euro=per_euro)
    assert lazy_greedy(coverage, per_euro=per_euro).tolist() == expected
    worth = gains(coverage.values, coverage.floor) + 0.5
    assert lazy_greedy(coverage, per_euro=per_euro, worth=worth).tolist() == expected


@given(SEED)
def test_lazy_greedy_is_plain_greedy_among_many(seed: int) -> None:
    random = np.random.default_rng(seed)
    values = random.integers(0, 3, (500, 12)).astype(np.float32)
    values[random.random(values.shape) < 0.7] = 0.0
    supply = coverage_supply(random, n_poses=500)
    coverage = Coverage(values=values, supply=supply)
    assert lazy_greedy(coverage).tolist() == plain_greedy(coverage, per_euro=False)


@given(coverages(has_money=False))
def test_lazy_greedy_keeps_its_guarantee(coverage: Coverage) -> None:
    base = value_of(coverage, [])
    reached = value_of(coverage, lazy_greedy(coverage).tolist()) - base
    best = best_value(coverage) - base
    capacity = coverage.supply.site_capacity[coverage.supply.site_index]
    is_cardinality = (capacity >= coverage.supply.max_units).all()
    assert reached >= (1.0 - np.exp(-1.0) if is_cardinality else 0.5) * best - 1e-6


@given(coverages(), SEED)
def test_exchanges_and_rounding_stay_feasible_and_never_lose(coverage: Coverage, seed: int) -> None:
    random = np.random.default_rng(seed)
    start = fill(coverage, np.empty(0, dtype=np.int64), random.permutation(coverage.n_poses)[:3])
    every = np.arange(coverage.n_poses)
    shares = random.random(coverage.n_poses)
    for better in (
        swap(coverage, start),
        search_around(coverage, start, every, n_restarts=3, seed=seed, preference=shares),
        round_shares(coverage, every, shares),
    ):
        assert coverage.supply.allows(better)
    assert coverage.value(swap(coverage, start)) >= coverage.value(start) - 1e-9
    assert coverage.value(search_around(coverage, start, every, n_restarts=3, seed=seed)) >= (
        coverage.value(start) - 1e-9
    )


@given(coverages())
def test_no_exchange_helps_after_exchanging(coverage: Coverage) -> None:
    chosen = swap(coverage, lazy_greedy(coverage))
    value = coverage.value(chosen)
    for unit in range(len(chosen)):
        for pose in range(coverage.n_poses):
            trial = chosen.copy()
            trial[unit] = pose
            assert not coverage.supply.allows(trial) or coverage.value(trial) <= value + 1e-5


@given(coverages(), SEED)
def test_swap_gains_are_differences_of_values(coverage: Coverage, seed: int) -> None:
    random = np.random.default_rng(seed)
    n_units = int(random.integers(1, coverage.n_poses + 1))
    chosen: IntArray = random.permutation(coverage.n_poses)[:n_units]
    pool = np.arange(coverage.n_poses)
    gain = swap_gains(coverage, chosen, pool)
    for pose, unit in np.ndindex(gain.shape):
        trial = chosen.copy()
        trial[unit] = pose
        difference = coverage.value(trial) - coverage.value(chosen)
        assert gain[pose, unit] == pytest.approx(difference, abs=1e-5)


def test_rounding_begins_with_the_largest_shares() -> None:
    values = np.eye(3)
    coverage = Coverage(values=values, supply=coverage_supply(np.random.default_rng(0), n_poses=3))
    coverage = coverage.with_units(1)
    chosen = round_shares(coverage, np.arange(3), np.array([0.2, 0.5, 0.3]))
    assert chosen.tolist() == [1]


@given(coverages(has_money=True))
def test_with_money_the_better_greedy_choice_is_taken(coverage: Coverage) -> None:
    chosen = choose_greedily(coverage)
    assert coverage.supply.allows(chosen)
    assert coverage.value(chosen) <= best_value(coverage) * (1.0 + 1e-6)
