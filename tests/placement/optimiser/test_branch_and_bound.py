import numpy as np
import pytest
from coverages import best_value, coverages, feasible_sets, value_of
from hypothesis import given
from hypothesis import strategies as st

from geometry.arrays import IntArray
from placement.optimiser.bounds import Coverage
from placement.optimiser.window_cover import branch_and_bound

NOTHING: IntArray = np.empty(0, dtype=np.int64)


@given(coverages(), st.sampled_from([0.0, 0.1]))
def test_search_finds_the_best_set_from_nothing(coverage: Coverage, gap: float) -> None:
    search = branch_and_bound(coverage, NOTHING, np.ones(coverage.n_rows), gap=gap)
    best = best_value(coverage)
    assert search.is_finished
    assert coverage.supply.allows(search.poses)
    assert search.value == pytest.approx(coverage.value(search.poses))
    assert best <= search.limit * (1.0 + 1e-6) + 1e-9
    assert search.limit <= search.value * (1.0 + gap + 1e-6) + 1e-9


@given(coverages(max_poses=7, has_money=False), st.integers(0, 2**32 - 1))
def test_search_finds_the_truly_best_set_where_values_are_limits(
    coverage: Coverage, seed: int
) -> None:
    # What sets are truly worth: some row of each counts less than its best pose promises.
    less = np.random.default_rng(seed).random(coverage.n_rows)

    def evaluate(poses: IntArray) -> float:
        return value_of(coverage, poses.tolist()) - float(less[len(poses) % len(less)])

    best = max(evaluate(np.array(poses, dtype=np.int64)) for poses in feasible_sets(coverage))
    search = branch_and_bound(coverage, NOTHING, np.ones(coverage.n_rows), evaluate=evaluate)
    assert search.is_finished
    assert search.limit >= best - 1e-6
    assert search.value == pytest.approx(evaluate(search.poses))
    assert search.value == pytest.approx(best, abs=1e-6)


@given(coverages())
def test_stopped_search_says_what_is_proven(coverage: Coverage) -> None:
    search = branch_and_bound(coverage, NOTHING, np.ones(coverage.n_rows), max_nodes=1)
    assert search.n_nodes <= 1
    assert search.limit >= best_value(coverage) * (1.0 - 1e-6)
    assert search.limit <= search.value * (1.0 + 1e-6) or not search.is_finished
