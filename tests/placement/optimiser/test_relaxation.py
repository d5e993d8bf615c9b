import numpy as np
import pytest
from coverages import best_value, coverages
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from placement.optimiser.bounds import Coverage, Supply, prove
from placement.optimiser.relaxation import Relaxation, polish, tighten


def draw_coverage(seed: int, n_poses: int = 30, n_rows: int = 10) -> Coverage:
    random = np.random.default_rng(seed)
    values = random.integers(0, 5, (n_poses, n_rows)) * random.choice([0.0, 1.0], (n_poses, n_rows))
    return Coverage(
        values=values,
        supply=Supply(
            max_units=3, site_index=random.integers(0, 6, n_poses), site_capacity=np.ones(6, int)
        ),
        reached=random.integers(0, 2, n_rows).astype(np.float64),
    )


def lp_value(coverage: Coverage, max_units: int) -> float:
    """The p-median LP as it is usually written: x per pose, y per pose and row."""
    gain = np.maximum(coverage.values - coverage.floor, 0.0)
    n_poses, n_rows = gain.shape
    supply = coverage.supply
    sites = (supply.site_index == np.arange(len(supply.site_capacity))[:, None]).astype(float)
    each_row = np.tile(np.eye(n_rows), n_poses)
    opened = np.kron(np.eye(n_poses), np.ones((n_rows, 1)))
    rows = np.block(
        [
            [-opened, np.eye(n_poses * n_rows)],
            [np.zeros((n_rows, n_poses)), each_row],
            [np.ones((1, n_poses)), np.zeros((1, n_poses * n_rows))],
            [sites, np.zeros((len(sites), n_poses * n_rows))],
        ]
    )
    limits = np.concatenate(
        [np.zeros(n_poses * n_rows), np.ones(n_rows), [max_units], supply.site_capacity]
    )
    cost = np.concatenate([np.zeros(n_poses), -gain.ravel()])
    result = linprog(cost, A_ub=rows, b_ub=limits, bounds=(0.0, 1.0))
    return float(-result.fun + coverage.floor.sum())


@given(coverages(max_poses=7, max_units=3))
def test_repaired_bound_is_never_below_the_best_however_few_steps(coverage: Coverage) -> None:
    relaxation = Relaxation(coverage)
    for max_steps in (1, 50):
        relaxed = relaxation.solve(coverage.supply.max_units, max_steps=max_steps)
        assert relaxed.bound.limit >= best_value(coverage) * (1.0 - 1e-7)
        assert relaxed.shares.shape == (coverage.n_poses,)


@given(st.integers(0, 2**32 - 1))
def test_bound_is_that_of_the_linear_relaxation(seed: int) -> None:
    coverage = draw_coverage(seed)
    relaxation = Relaxation(coverage)
    for max_units in (2, 3):
        relaxed = relaxation.solve(max_units, max_steps=5000)
        exact = lp_value(coverage, max_units)
        # Of 1,000 instances all but two end within 3e-4, one (seed 690) only at 2e-3.
        assert relaxed.bound.limit == pytest.approx(exact, rel=1e-2)
        assert relaxed.bound.limit >= exact - 1e-6


def test_sweep_from_the_last_solution_gives_what_a_new_start_gives() -> None:
    coverage = draw_coverage(3, n_poses=60, n_rows=20)
    warm = Relaxation(coverage, tolerance=1e-4)
    for max_units in (1, 2, 3, 4, 5):
        swept = warm.solve(max_units, max_steps=20_000)
        fresh = Relaxation(coverage, tolerance=1e-4).solve(max_units, max_steps=20_000)
        assert swept.is_solved
        assert fresh.is_solved
        assert swept.bound.limit == pytest.approx(fresh.bound.limit, rel=2e-3)
        assert swept.bound.limit == pytest.approx(lp_value(coverage, max_units), rel=5e-3)


def test_a_start_near_the_solution_is_closer_to_it_after_few_steps() -> None:
    coverage = draw_coverage(5, n_poses=60, n_rows=20)
    solved = Relaxation(coverage).solve(3, max_steps=20_000)
    near = Relaxation(coverage)
    near.start_at(solved.shares, prove(coverage, solved.bound.multipliers))
    far = Relaxation(coverage).solve(3, max_steps=10)
    exact = lp_value(coverage, 3)
    assert near.solve(3, max_steps=10).bound.limit - exact < 0.1 * (far.bound.limit - exact)


@given(st.integers(0, 2**32 - 1))
@settings(derandomize=True, max_examples=10)
def test_polish_ends_at_the_linear_relaxation(seed: int) -> None:
    coverage = draw_coverage(seed, n_poses=60)
    rough = tighten(coverage, np.ones(coverage.n_rows), target=0.0, n_steps=5)
    polished = polish(coverage, rough, n_core=25, n_rounds=8, n_steps=2000)
    exact = lp_value(coverage, 3)
    assert polished.bound.limit <= rough.bound.limit
    assert polished.bound.limit == pytest.approx(exact, rel=5e-3)
    assert polished.bound.limit >= exact - 1e-6


def test_nothing_to_gain_is_bounded_by_what_is_reached() -> None:
    supply = Supply(max_units=1, site_index=np.array([0]), site_capacity=np.array([1]))
    coverage = Coverage(values=np.zeros((1, 2)), supply=supply, reached=np.array([1.0, 2.0]))
    assert Relaxation(coverage).solve(1).bound.limit == 3.0
