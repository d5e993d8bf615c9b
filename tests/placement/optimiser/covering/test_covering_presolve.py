import numpy as np
import pytest
from covering_oracle import EverySet, instances
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser.covering.instance import build_covering_instance
from placement.optimiser.covering.presolve import (
    dear_columns,
    dominated_columns,
    dominated_rows,
    equal_columns,
    equal_rows,
    essential_columns,
    independent_components,
    presolve_full_cover,
    presolve_weighted_cover,
)


def covers(*rows):
    return build_covering_instance(np.array(rows)).covers


def least_cost(instance):
    return EverySet(instance).least_cost(instance.coverable_weight)


@given(instance=instances())
def test_reducing_a_full_cover_changes_no_optimum(instance):
    reduced = presolve_full_cover(instance)
    left = reduced.instance
    already = instance.cost[reduced.essential].sum()
    assert already + least_cost(left) == pytest.approx(least_cost(instance))
    assert not np.isin(reduced.essential, reduced.column_index).any()
    np.testing.assert_array_equal(left.cost, instance.cost[reduced.column_index])
    every = EverySet(left)
    cheapest = every.sets[
        int(np.where(every.covered >= left.coverable_weight, every.cost, np.inf).argmin())
    ]
    answer = np.concatenate([reduced.essential, reduced.column_index[cheapest]])
    assert instance.covered_weight(answer) == pytest.approx(instance.coverable_weight)


@given(
    instance=instances(),
    units=st.integers(1, 8),
    share=st.floats(0.0, 1.0),
    minds_cost=st.booleans(),
)
def test_reducing_a_weighted_cover_changes_no_optimum(instance, units, share, minds_cost):
    money = share * float(instance.cost.sum()) if minds_cost else np.inf
    reduced = presolve_weighted_cover(instance, minds_cost=minds_cost, money=money)
    left, before, after = reduced.instance, EverySet(instance), EverySet(reduced.instance)
    assert after.most_weight(units, money) == pytest.approx(before.most_weight(units, money))
    if minds_cost:
        whole = presolve_weighted_cover(instance, minds_cost=True).instance
        needed = share * instance.coverable_weight
        assert EverySet(whole).least_cost(needed) == pytest.approx(before.least_cost(needed))
    for columns in after.sets:
        assert left.covered_weight(columns) == pytest.approx(
            instance.covered_weight(reduced.column_index[columns])
        )


def test_the_only_column_of_a_row_is_essential():
    assert list(essential_columns(covers([1, 1, 0], [0, 1, 1], [0, 1, 0]))) == [0, 1]


def test_of_equal_columns_the_cheapest_stays_and_of_those_the_first():
    matrix = covers([1, 1], [1, 1], [0, 1], [1, 1])
    assert list(equal_columns(matrix, np.array([2.0, 1.0, 1.0, 1.0]))) == [True, False, False, True]


def test_a_column_is_dominated_by_one_that_covers_more_for_no_more_money():
    matrix = covers([1, 0, 0], [1, 1, 0], [0, 1, 1])
    assert list(dominated_columns(matrix, np.array([2.0, 2.0, 2.0]))) == [True, False, False]
    assert list(dominated_columns(matrix, np.array([1.0, 2.0, 2.0]))) == [False, False, False]


def test_a_column_is_dear_if_its_rows_are_cheaper_one_by_one():
    matrix = covers([1, 1, 0], [1, 0, 0], [0, 1, 1])
    assert list(dear_columns(matrix, np.array([3.1, 1.0, 2.0]))) == [True, False, False]
    assert list(dear_columns(matrix, np.array([3.0, 1.0, 2.0]))) == [False, False, False]


def test_a_row_is_dominated_by_one_that_fewer_columns_cover():
    matrix = covers([1, 1, 0], [0, 1, 0], [0, 0, 1])
    assert list(dominated_rows(matrix)) == [False, True, False]


def test_of_equal_rows_the_first_stays():
    assert list(equal_rows(covers([1, 0, 1], [0, 1, 0]))) == [False, False, True]


def test_parts_that_share_no_row_are_independent():
    n_parts, part = independent_components(covers([1, 1, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0]))
    assert n_parts == 2
    assert part[0] == part[2] != part[1]


def test_equal_rows_are_merged_with_their_weights():
    instance = build_covering_instance([[1, 0, 1], [0, 1, 0]], weight=[1.0, 2.0, 4.0])
    reduced = presolve_weighted_cover(instance, minds_cost=False)
    assert list(reduced.instance.weight) == [5.0, 2.0]


def test_the_effect_is_told():
    instance = build_covering_instance(
        [[1, 0, 0, 0], [1, 0, 0, 0], [1, 1, 0, 0], [0, 0, 1, 0], [0, 1, 1, 0]],
        weight=[1.0, 1.0, 1.0, 1.0],
        cost=[1.0, 1.0, 3.0, 3.0, 2.0],
    )
    weighted = presolve_weighted_cover(instance, minds_cost=True).statistics
    assert str(weighted) == (
        "5 -> 3 columns, 4 -> 3 rows, 1 idle rows, 1 equal columns, 1 dominated columns"
    )
    assert weighted.n_components == 1
    full = presolve_full_cover(instance)
    assert str(full.statistics) == (
        "5 -> 0 columns, 4 -> 0 rows, 1 idle rows, 2 essential columns, 1 equal columns, "
        "2 dear columns"
    )
    assert list(full.essential) == [0, 4]
