import numpy as np
import pytest
from coverages import best_value, coverages, feasible_sets, value_of
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser.bounds import (
    Coverage,
    Supply,
    can_matter,
    gains,
    prove,
)

SEED = st.integers(0, 2**32 - 1)


@given(coverages(), SEED)
def test_limit_is_never_below_the_best_value(coverage: Coverage, seed: int) -> None:
    multipliers = np.random.default_rng(seed).normal(0.4, 0.5, size=coverage.n_rows)
    assert prove(coverage, multipliers).limit >= best_value(coverage) * (1.0 - 1e-12)


@given(coverages(), SEED)
def test_no_pose_of_a_better_set_is_ruled_out(coverage: Coverage, seed: int) -> None:
    random = np.random.default_rng(seed)
    bound = prove(coverage, random.normal(0.4, 0.5, size=coverage.n_rows))
    need = random.uniform(0.5, 1.0) * best_value(coverage)
    mask = can_matter(coverage, bound, need)
    for poses in feasible_sets(coverage):
        if value_of(coverage, poses) > need + 1e-6:
            assert mask[poses].all()


@given(coverages(has_money=False), SEED)
def test_no_pose_of_a_better_set_with_all_groups_is_ruled_out(
    coverage: Coverage, seed: int
) -> None:
    random = np.random.default_rng(seed)
    site = coverage.supply.site_index[random.integers(coverage.n_poses)]
    group = np.flatnonzero(coverage.supply.site_index == site)
    grouped = Coverage(
        values=coverage.values,
        supply=coverage.supply.with_groups((group,)),
        reached=coverage.reached,
    )
    need = random.uniform(0.5, 1.0) * best_value(coverage)
    mask = can_matter(grouped, prove(grouped, random.random(coverage.n_rows)), need)
    for poses in feasible_sets(coverage):
        if set(poses) & set(group.tolist()) and value_of(coverage, poses) > need + 1e-6:
            assert mask[poses].all()


@given(coverages())
def test_value_is_the_sum_of_the_best(coverage: Coverage) -> None:
    for poses in feasible_sets(coverage):
        expected = pytest.approx(value_of(coverage, poses), rel=1e-6)
        assert coverage.value(np.array(poses, dtype=np.int64)) == expected


def test_gains_in_threads_and_of_some_poses_are_the_same() -> None:
    random = np.random.default_rng(0)
    values = random.random((40_000, 70), dtype=np.float32)
    level = random.random(70, dtype=np.float32)
    expected = np.maximum(values.astype(np.float64) - level, 0.0).sum(axis=1)
    np.testing.assert_allclose(gains(values, level, workers=3), expected, rtol=1e-6)
    some = random.integers(0, 40_000, 5_000)
    np.testing.assert_array_equal(gains(values, level, some), gains(values, level)[some])


def test_ceiling_as_multipliers_gives_what_all_poses_reach() -> None:
    coverage = Coverage(
        values=np.array([[1.0, 0.0], [0.0, 2.0], [0.5, 0.5]]),
        supply=Supply(max_units=1, site_index=np.zeros(3, np.int64), site_capacity=np.array([1])),
    )
    assert prove(coverage, np.array([1.0, 2.0])).limit == 3.0
    assert prove(coverage, np.zeros(2)).limit == pytest.approx(2.0)


def test_numbers_of_poses_must_agree() -> None:
    supply = Supply(max_units=1, site_index=np.array([0]), site_capacity=np.array([1]))
    with pytest.raises(ValueError, match="1 poses; expected 2"):
        Coverage(values=np.ones((2, 3)), supply=supply)
