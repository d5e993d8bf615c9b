import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from covering_oracle import EverySet, instances
from hypothesis import assume, given
from hypothesis import strategies as st

from geometry.errors import InputError
from placement.covering import (
    CoveringSolution,
    build_covering_instance,
    load_instance,
    solve_covering,
)

GOLDEN = Path(__file__).parents[1] / "golden" / "cover"
OPTIMA = tomllib.loads((GOLDEN / "optima.toml").read_text())
# No share is nearer to another than solver and oracle can tell apart.
SHARES = st.integers(0, 1000).map(lambda thousandths: thousandths / 1000)


def check(solution: CoveringSolution, optimum: float) -> None:
    """The optimum is found, and proven."""
    assert solution.objective == pytest.approx(optimum, abs=1e-6)
    assert solution.is_proven
    assert solution.bound == pytest.approx(solution.objective)


@given(instance=instances(), share=st.none() | SHARES)
def test_least_cost_matches_brute_force(instance, share):
    n_rows, every = instance.n_rows, EverySet(instance)
    target = None if share is None else share * instance.n_covered() / max(n_rows, 1)
    solution = solve_covering(instance, target=target)
    needed = every.covered[-1] if target is None else target * n_rows  # by all columns together
    assert instance.n_covered(solution.chosen) >= needed - 1e-7
    assert solution.objective == instance.cost[solution.chosen].sum()
    check(solution, every.least_cost(needed))


@given(
    instance=instances(),
    share=st.none() | SHARES,
    units=st.none() | st.integers(1, 8),
)
def test_most_rows_for_a_budget_match_brute_force(instance, share, units):
    assume(share is not None or units is not None)
    money = math.inf if share is None else share * float(instance.cost.sum())
    useful = instance.cost[instance.covers.sum(axis=1) > 0.0]
    assume(len(useful) == 0 or money >= useful.min())
    solution = solve_covering(
        instance, budget_units=units, budget_cost=None if share is None else money
    )
    assert instance.cost[solution.chosen].sum() <= money + 1e-5
    assert units is None or len(solution.chosen) <= units
    assert solution.objective == instance.n_covered(solution.chosen)
    check(solution, EverySet(instance).most_covered(np.inf if units is None else units, money))


@pytest.mark.parametrize("name", OPTIMA)
def test_or_library_optima_are_found_and_proven(name):
    instance = load_instance(GOLDEN / f"{name}.txt")
    facts = OPTIMA[name]
    assert (instance.n_rows, instance.n_columns) == (facts["n_rows"], facts["n_columns"])
    solution = solve_covering(instance)
    assert (solution.objective, solution.bound) == (facts["optimum"], facts["optimum"])
    assert solution.is_proven
    assert instance.n_covered(solution.chosen) == instance.n_rows


@pytest.fixture(scope="module")
def hard():
    """Far too large to be solved in a second."""
    rng = np.random.default_rng(5)
    return build_covering_instance(rng.random((400, 600)) < 0.04)


@pytest.mark.parametrize("time_limit_s", [1e-6, 1.0])
def test_when_the_time_is_up_there_is_an_answer_and_a_bound(hard, time_limit_s):
    cover = solve_covering(hard, time_limit_s=time_limit_s)
    assert hard.n_covered(cover.chosen) == hard.n_covered()
    assert 0.0 <= cover.bound < cover.objective
    assert not cover.is_proven
    most = solve_covering(hard, budget_units=9, time_limit_s=time_limit_s)
    assert len(most.chosen) <= 9
    assert most.objective < most.bound <= hard.n_covered()
    assert not most.is_proven


def test_a_model_that_memory_has_no_room_for_is_not_built(hard, monkeypatch):
    monkeypatch.setattr("placement.memory.available_bytes", lambda: 1000)
    with pytest.raises(InputError, match=r"the model: got .* free: fewer rows or columns"):
        solve_covering(hard)


def test_a_gap_is_enough_where_one_is_given(hard):
    solution = solve_covering(hard, budget_units=3, gap=0.2)
    assert 0.0 <= solution.gap <= 0.2


def test_optima_scale_with_costs():
    rng = np.random.default_rng(7)
    covers, cost = rng.random((12, 15)) < 0.25, rng.uniform(1.0, 2.0, 12)
    found = [
        (solve_covering(instance, target=0.6), solve_covering(instance, budget_cost=4.0 * scale))
        for scale in (1.0, 1e-9, 1e9)
        for instance in [build_covering_instance(covers, cost=cost * scale)]
    ]
    for least, most in found:
        np.testing.assert_array_equal(least.chosen, found[0][0].chosen)
        assert most.objective == found[0][1].objective
        assert least.is_proven
        assert most.is_proven


def test_rows_that_nothing_covers_are_told():
    instance = build_covering_instance([[1, 0, 0], [1, 1, 0]])
    solution = solve_covering(instance)
    assert list(solution.chosen) == [1]
    assert instance.n_covered(solution.chosen) == instance.n_covered() == 2


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            {"target": 0.8},
            "target: got 0.8; expected at most 0.75, the share that all columns together cover",
        ),
        ({"target": 1.5}, "target: got 1.5; expected max, or a share of the rows, 0 to 1"),
        (
            {"budget_units": 0},
            "budget_units: got 0; expected a whole number of columns, at least 1",
        ),
        (
            {"budget_cost": 2.5},
            "budget_cost: got 2.5; expected at least 3, the least cost of a column that covers "
            "anything",
        ),
        ({"budget_cost": -1.0}, "budget_cost: got -1.0; expected an amount of money, at least 0"),
        ({"time_limit_s": 0.0}, "time_limit_s: got 0.0; expected seconds, more than 0"),
        ({"gap": 1.0}, "gap: got 1.0; expected a share, 0 <= gap < 1"),
    ],
)
def test_wishes_that_cannot_be_met_say_what_can(asked, message):
    instance = build_covering_instance(
        [[1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0]], cost=[3.0, 4.0, 1.0]
    )
    with pytest.raises(InputError) as caught:
        solve_covering(instance, **asked)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("cost", "message"),
    [
        ([1.0, -2.0], "cost: got -2.0; expected no negative number"),
        ([1.0], "cost: got shape (1,); expected shape (2,)"),
        ([1.0, math.nan], "cost: got [1.0, nan]; expected finite numbers"),
    ],
)
def test_instances_are_checked(cost, message):
    with pytest.raises(InputError) as caught:
        build_covering_instance([[1, 0, 1], [0, 1, 1]], cost=cost)
    assert str(caught.value) == message
