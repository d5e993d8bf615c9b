import time

import numpy as np
import pytest
from covering_oracle import EverySet, instances
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser.covering import search
from placement.optimiser.covering.instance import build_covering_instance
from placement.optimiser.covering.search import search_best_columns

NONE = np.empty(0, dtype=np.int64)


def random_instance(seed, n_columns=12, n_rows=30, density=0.25, is_whole=True):
    rng = np.random.default_rng(seed)
    weight = rng.integers(1, 9, n_rows) if is_whole else rng.random(n_rows)
    return build_covering_instance(rng.random((n_columns, n_rows)) < density, weight=weight)


@given(instance=instances(), n_units=st.integers(1, 6))
def test_search_matches_brute_force(instance, n_units):
    # Fewer columns than units: nothing to look for.
    n_units = min(n_units, instance.n_columns)
    if n_units == 0:
        return
    result = search_best_columns(
        instance.covers, instance.weight, n_units=n_units, start=NONE, time_limit_s=60.0
    )
    optimum = EverySet(instance).most_weight(n_units)
    assert result.covered_weight == pytest.approx(optimum)
    assert result.bound == pytest.approx(optimum)
    assert instance.covered_weight(result.chosen) == pytest.approx(optimum)
    assert len(result.chosen) <= n_units


@pytest.mark.parametrize("n_units", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("is_whole", [True, False])
@pytest.mark.parametrize("density", [0.1, 0.5])
def test_search_matches_brute_force_on_larger_instances(n_units, is_whole, density):
    for seed in range(5):
        instance = random_instance(seed, density=density, is_whole=is_whole)
        result = search_best_columns(
            instance.covers, instance.weight, n_units=n_units, start=NONE, time_limit_s=60.0
        )
        optimum = EverySet(instance).most_weight(n_units)
        assert instance.covered_weight(result.chosen) == pytest.approx(optimum)


@pytest.mark.parametrize("penalty", [0, 1 << 60])
@pytest.mark.parametrize("block", [1, 50])
def test_both_ways_to_count_triples_agree_in_blocks_of_any_size(monkeypatch, penalty, block):
    monkeypatch.setattr(search, "_GATHER_PENALTY", penalty)
    monkeypatch.setattr(search, "_BLOCK", block)
    instance = random_instance(9, density=0.4)
    result = search_best_columns(
        instance.covers, instance.weight, n_units=3, start=NONE, time_limit_s=60.0
    )
    assert result.covered_weight == EverySet(instance).most_weight(3)


@pytest.mark.parametrize("n_units", [2, 3, 4])
def test_an_interrupted_search_gives_a_valid_bound(monkeypatch, n_units):
    instance = random_instance(3, density=0.3)
    optimum = EverySet(instance).most_weight(n_units)
    for n_steps in range(12):
        now = iter(range(1000))
        monkeypatch.setattr(time, "perf_counter", lambda now=now: float(next(now)))
        result = search_best_columns(
            instance.covers,
            instance.weight,
            n_units=n_units,
            start=np.array([0]),
            time_limit_s=n_steps + 0.5,
        )
        assert result.covered_weight <= optimum <= result.bound
        assert result.covered_weight == instance.covered_weight(result.chosen)
    assert result.covered_weight >= instance.covered_weight([0])


def test_a_gap_ends_the_search_earlier_and_is_kept():
    instance = random_instance(4)
    optimum = EverySet(instance).most_weight(3)
    result = search_best_columns(
        instance.covers, instance.weight, n_units=3, start=NONE, time_limit_s=60.0, gap=0.3
    )
    assert result.covered_weight * 1.3 >= result.bound >= optimum


def test_what_is_too_large_is_left_to_others(monkeypatch):
    monkeypatch.setattr(search, "_MAX_CELLS", 10)
    instance = random_instance(5)
    assert (
        search_best_columns(
            instance.covers, instance.weight, n_units=3, start=NONE, time_limit_s=60.0
        )
        is None
    )
