"""Levels of cost that layouts can have, against all layouts."""

from dataclasses import replace
from itertools import combinations
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import questions
from small_tables import avoiding_problem

from placement.optimiser import constants, cost_eur, is_allowed
from placement.optimiser.cost_front import next_level_eur, price_levels_eur
from placement.optimiser.walk import allowed_sets as all_sets_within


def allowed_sets(problem):
    """All sets of poses that the limits allow."""
    n_poses = problem.table.n_poses
    return [
        poses
        for n_units in range(1, n_poses + 1)
        for poses in combinations(range(n_poses), n_units)
        if is_allowed(problem.limits, poses)
    ]


@given(problem=questions())
def test_every_layout_costs_one_of_the_levels(problem):
    levels = price_levels_eur(problem.limits)
    steps = np.diff(levels)

    assert levels is not None
    assert (steps > 0.0).all()

    costs = [cost_eur(problem.limits, poses) for poses in allowed_sets(problem)]

    assert all(np.abs(levels - cost).min() <= 1e-6 for cost in costs)

    for cost in costs:
        dearer = [other for other in costs if other > cost + 1e-6]
        above = next_level_eur(levels, cost, is_more=True)
        level_below = next_level_eur(levels, cost, is_more=False)
        dearest = min(dearer, default=np.inf)

        assert level_below == pytest.approx(cost)
        assert above > cost
        assert dearest >= above - 1e-6


@given(
    problem=questions(),
    max_sets=st.sampled_from([10_000, 5]),
    n_together=st.sampled_from([1 << 19, 12, 1]),
)
def test_affordable_sets_are_all_that_the_limits_allow(problem, max_sets, n_together):
    expected = allowed_sets(problem)
    with mock.patch.object(constants, "GROWN_TOGETHER", n_together):
        sizes = all_sets_within(problem.limits, max_sets=max_sets)

    if sizes is None:
        assert len(expected) > max_sets
        return

    found = {tuple(row) for sets in sizes for row in sets.tolist()}
    set_counts = map(len, sizes)

    assert len(expected) <= max_sets
    assert found == set(expected)
    assert sum(set_counts) == len(expected)


def test_sites_that_carry_two_leave_fewer_levels():
    problem = avoiding_problem(["1"] * 4, price_eur=[1500.0] * 4, budget_units=3)
    limits = replace(
        problem.limits,
        site_index=[0, 0, 1, 1],
        site_capacity=[2, 2],
        site_cost_eur=[1000.0, 1000.0],
        is_forced_site=np.zeros(2, dtype=bool),
    )

    levels = price_levels_eur(limits)
    found = levels.tolist()
    dearer = next_level_eur(levels, 2500.0, is_more=True)
    cheaper = next_level_eur(levels, 4000.5, is_more=False)
    dearest = next_level_eur(levels, 6500.0, is_more=True)

    assert levels is not None
    # Three units need two sites.
    assert found == [2500.0, 4000.0, 5000.0, 6500.0]
    assert dearer == 4000.0
    assert cheaper == 5000.0
    assert dearest == np.inf


def test_prices_without_whole_cents_or_too_many_have_no_levels():
    problem = avoiding_problem(["1", "1"], price_eur=[1.0, np.pi])
    above = next_level_eur(None, 3.0, is_more=True)
    below = next_level_eur(None, 3.0, is_more=False)

    assert price_levels_eur(problem.limits) is None
    assert above == 3.0
    assert below == 3.0

    cubes = np.arange(300) ** 3
    prices = (cubes + 1.0) / 100.0
    price_eur = prices.tolist()
    many = avoiding_problem(["1"] * 300, price_eur=price_eur, budget_units=3)

    assert price_levels_eur(many.limits) is None
