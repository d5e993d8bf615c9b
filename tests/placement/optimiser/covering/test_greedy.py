import numpy as np
import pytest
from covering_oracle import EverySet, instances
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser.covering.instance import CoveringBudget, build_covering_instance
from placement.optimiser.covering.search import (
    cover_cheaply,
    cover_much,
    drop_redundant,
    least_cost_bound,
    most_weight_bound,
)


@given(instance=instances(), share=st.floats(0.0, 1.0), n_rounds=st.integers(0, 5))
def test_a_cheap_cover_covers_enough_and_needs_all_its_columns(instance, share, n_rounds):
    needed = share * instance.coverable_weight
    chosen = cover_cheaply(
        instance.covers,
        instance.cost,
        instance.weight,
        needed_weight=needed,
        n_rounds=n_rounds,
        time_limit_s=60.0,
    )
    slack = 1e-7 * (1.0 + instance.weight.sum())
    assert instance.covered_weight(chosen) >= needed - slack
    for position in range(len(chosen)):
        assert instance.covered_weight(np.delete(chosen, position)) < needed
    bound = least_cost_bound(instance.covers, instance.cost, instance.weight, needed_weight=needed)
    assert bound <= EverySet(instance).least_cost(needed) + 1e-9


@given(
    instance=instances(),
    units=st.none() | st.integers(1, 5),
    share=st.none() | st.floats(0.0, 1.0),
)
def test_much_is_covered_within_the_budget_and_no_exchange_covers_more(instance, units, share):
    if units is None and share is None:
        units = 3
    money = None if share is None else share * float(instance.cost.sum())
    budget = CoveringBudget(units=units, cost=money)
    chosen = cover_much(instance.covers, instance.cost, instance.weight, budget)
    assert budget.allows(instance.cost[chosen])
    covered = instance.covered_weight(chosen)
    for position in range(len(chosen)):
        for column in range(instance.n_columns):
            other = np.delete(chosen, position)
            other = np.append(other, column)
            if column not in chosen and budget.allows(instance.cost[other]):
                assert instance.covered_weight(other) <= covered + 1e-7
    bound = most_weight_bound(instance.covers, instance.cost, instance.weight, budget)
    optimum = EverySet(instance).most_weight(
        np.inf if units is None else units, np.inf if money is None else money
    )
    assert bound >= optimum - 1e-9


def test_the_bound_is_that_of_the_linear_program_where_columns_share_no_row():
    instance = build_covering_instance(
        [[1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], cost=[4.0, 1.0, 3.0]
    )
    needed = 2.5  # rows at 1, 2, 2 (and 3) each, the last one in part
    bound = least_cost_bound(instance.covers, instance.cost, instance.weight, needed_weight=needed)
    assert bound == pytest.approx(1.0 + 2.0 + 0.5 * 2.0)


def test_local_search_mends_what_greedy_choice_gets_wrong():
    # The widest column is chosen first and is of no use then.
    instance = build_covering_instance(
        [[1, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1], [0, 1, 1, 1, 1, 0]], cost=[3.0, 3.0, 3.5]
    )

    def cost(n_rounds):
        chosen = cover_cheaply(
            instance.covers,
            instance.cost,
            instance.weight,
            needed_weight=6.0,
            n_rounds=n_rounds,
            time_limit_s=60.0,
        )
        return instance.cost[chosen].sum()

    assert cost(20) == 6.0 <= cost(0)
    most = cover_much(instance.covers, instance.cost, instance.weight, CoveringBudget(units=2))
    assert list(most) == [0, 1]


def test_the_dearest_columns_that_are_not_needed_are_left_out():
    instance = build_covering_instance([[1, 1, 0], [0, 1, 1], [1, 0, 1]], cost=[1.0, 3.0, 2.0])
    chosen = drop_redundant(
        instance.covers, instance.cost, instance.weight, np.array([0, 1, 2]), needed_weight=3.0
    )
    assert list(chosen) == [0, 2]
