"""The multiple-choice knapsack against going through all choices."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from placement.city.choose import Knapsack, best_prices, priced_choice, solve_knapsack


def build(sizes, seed, *, n_rows=1, tightness=0.5):
    """Groups of some sizes; the first option of each takes nothing and brings
    nothing.
    """
    rng = np.random.default_rng(seed)
    groups = np.arange(len(sizes))
    group = np.repeat(groups, sizes)
    drawn_profit = rng.integers(0, 1000, len(group))
    profit = drawn_profit / 8.0
    drawn_rows = rng.integers(1, 60, (n_rows, len(group)))
    rows = drawn_rows.astype(float)
    steps = np.diff(group, prepend=-1)
    first = np.flatnonzero(steps)
    profit[first] = 0.0
    rows[:, first] = 0.0
    highest = np.maximum.reduceat(rows, first, axis=1)
    most = highest.sum(axis=1)
    limits = np.floor(tightness * most)
    return Knapsack(
        group=group,
        profit=profit,
        rows=rows,
        limits=limits,
    )


def best_of_all(problem):
    """Highest sum of profits, by going through all choices; minus infinity: none is
    within.
    """
    starts = [*problem.starts, len(problem.group)]
    groups = [range(a, b) for a, b in pairwise(starts)]
    sums = (
        problem.profit[list(choice)].sum()
        for choice in product(*groups)
        if (problem.rows[:, list(choice)].sum(axis=1) <= problem.limits + 1e-9).all()
    )
    return max(sums, default=-np.inf)


@given(
    st.lists(st.integers(1, 4), min_size=1, max_size=6),
    st.integers(0, 10_000),
    st.integers(0, 3),
    st.floats(0.0, 1.0),
)
def test_the_choice_is_the_best_of_all(sizes, seed, n_rows, tightness):
    problem = build(sizes, seed, n_rows=n_rows, tightness=tightness)

    choice = solve_knapsack(problem)
    groups = problem.group[choice.chosen]
    every_group = np.arange(len(sizes))
    expected = pytest.approx(best_of_all(problem), abs=1e-9)

    assert choice.objective == expected
    assert choice.bound == choice.objective
    assert problem.is_within(choice.chosen)
    assert (groups == every_group).all()


@pytest.mark.long
@given(
    st.lists(st.integers(2, 4), min_size=4, max_size=6),
    st.integers(0, 10_000),
    st.integers(1, 2),
    st.integers(1, 5),
)
def test_a_core_of_any_size_finds_the_best_and_proves_it(sizes, seed, n_rows, core):
    problem = build(sizes, seed, n_rows=n_rows)

    choice = solve_knapsack(problem, core_options=core)

    assert choice.objective == pytest.approx(best_of_all(problem), abs=1e-9)
    assert choice.bound == pytest.approx(choice.objective, rel=1e-9)


@given(
    st.lists(st.integers(1, 4), min_size=1, max_size=6),
    st.integers(0, 10_000),
    st.integers(1, 3),
    st.lists(st.floats(0.0, 10.0), min_size=3, max_size=3),
)
def test_no_choice_exceeds_the_bound_of_any_prices(sizes, seed, n_rows, prices):
    problem = build(sizes, seed, n_rows=n_rows)
    row_prices = np.array(prices[:n_rows])
    _, bound = priced_choice(problem, row_prices)

    _, lowest = priced_choice(problem, best_prices(problem))
    scale = max(1.0, abs(bound))

    assert best_of_all(problem) <= lowest + 1e-9 <= bound + 2e-6 * scale


def test_a_limit_that_nothing_keeps_is_told():
    problem = Knapsack(
        group=np.array([0, 0, 1]),
        profit=np.array([1.0, 2.0, 3.0]),
        rows=np.array([[2.0, 3.0, 4.0]]),
        limits=np.array([5.0]),
    )

    choice = solve_knapsack(problem)

    assert choice.chosen is None
    assert choice.bound == -np.inf


def test_a_limit_may_ask_for_a_least_sum():
    """A row of negative numbers: at least 3 of the second kind, though it brings
    less.
    """
    problem = Knapsack(
        group=np.array([0, 0, 1, 1]),
        profit=np.array([5.0, 1.0, 5.0, 1.0]),
        rows=-np.array([[0.0, 3.0, 0.0, 2.0]]),
        limits=np.array([-3.0]),
    )
    chosen = solve_knapsack(problem).chosen.tolist()
    assert chosen == [1, 2]


def test_many_groups_are_proven_within_the_gap():
    problem = build([8] * 3000, 7, tightness=0.2)

    choice = solve_knapsack(problem, gap=1.0e-3)

    assert problem.is_within(choice.chosen)
    assert choice.bound <= choice.objective * 1.001

    _, relaxed = priced_choice(problem, best_prices(problem))

    assert choice.objective <= choice.bound <= relaxed + 1e-6
