import numpy as np
import pytest
from coverages import best_value, coverages
from hypothesis import given
from hypothesis import strategies as st

from geometry.clock import now_s
from placement.optimiser.bounds import Coverage, Supply, prove
from placement.optimiser.greedy import lazy_greedy
from placement.optimiser.relaxation import (
    PoolSizes,
    first_multipliers,
    generate_columns,
    polish,
    tighten,
    worthiest,
)

SEED = st.integers(0, 2**32 - 1)
SMALL_POOL = PoolSizes(n_first=5, n_more=4, n_most=20, n_rounds=30)


def draw_coverage(seed: int, n_poses: int, n_rows: int = 12) -> Coverage:
    random = np.random.default_rng(seed)
    values = random.random((n_poses, n_rows))
    values[random.random(values.shape) < 0.6] = 0.0
    return Coverage(
        values=values.astype(np.float32),
        supply=Supply(
            max_units=3, site_index=random.integers(0, 8, n_poses), site_capacity=np.ones(8, int)
        ),
    )


@given(coverages(), SEED)
def test_steps_only_lower_a_limit_that_stays_one(coverage: Coverage, seed: int) -> None:
    start = np.random.default_rng(seed).random(coverage.n_rows)
    best = best_value(coverage)
    tightened = tighten(coverage, start, target=best, n_steps=60)
    assert best * (1.0 - 1e-12) <= tightened.bound.limit <= prove(coverage, start).limit
    again = prove(coverage, tightened.bound.multipliers)
    assert again.limit == pytest.approx(tightened.bound.limit)
    assert ((tightened.shares >= 0.0) & (tightened.shares <= 1.0)).all()


def test_steps_stop_where_the_bound_is_good_enough() -> None:
    coverage = draw_coverage(0, 50)
    start = first_multipliers(coverage, lazy_greedy(coverage))
    high = prove(coverage, start).limit
    good = tighten(coverage, start, target=0.9 * high, stop_below=high - 1e-3)
    best = tighten(coverage, start, target=0.9 * high)
    assert best.bound.limit < good.bound.limit < high


@given(SEED)
def test_column_generation_reaches_the_bound_of_all_poses_at_once(seed: int) -> None:
    coverage = draw_coverage(seed, 80)
    chosen = lazy_greedy(coverage)
    whole = polish(
        coverage,
        tighten(coverage, first_multipliers(coverage, chosen), target=coverage.value(chosen)),
    )
    columns = generate_columns(
        coverage, chosen, improve=polish, sizes=SMALL_POOL, tolerance=1e-5, workers=2
    )
    lowest = min(whole.bound.limit, float(coverage.values.max(axis=0).sum(dtype=np.float64)))
    assert columns.limit == pytest.approx(lowest, rel=2e-3)
    assert columns.limit <= columns.bound.limit
    assert columns.bound.limit == pytest.approx(
        prove(coverage, columns.bound.multipliers).limit, rel=1e-9
    )
    assert set(chosen.tolist()) <= set(columns.pool.tolist())
    assert len(columns.pool) == len(columns.shares)


@given(coverages())
def test_column_generation_is_never_below_the_best(coverage: Coverage) -> None:
    columns = generate_columns(
        coverage, lazy_greedy(coverage), sizes=PoolSizes(n_first=2, n_more=2, n_most=4)
    )
    assert columns.limit >= best_value(coverage) * (1.0 - 1e-7)


def test_no_round_begins_after_the_time() -> None:
    coverage = draw_coverage(1, 60)
    chosen = lazy_greedy(coverage)
    short = generate_columns(coverage, chosen, sizes=SMALL_POOL, end_s=now_s() - 1.0)
    full = generate_columns(coverage, chosen, sizes=SMALL_POOL)
    assert full.bound.limit < short.bound.limit
    assert len(short.pool) <= SMALL_POOL.n_first + len(chosen)


def test_worthiest_are_the_largest_in_order_of_index() -> None:
    worth = np.array([1.0, 5.0, 3.0, 4.0])
    assert worthiest(worth, 2).tolist() == [1, 3]
    assert worthiest(worth, 9).tolist() == [0, 1, 2, 3]
