import math
import threading
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
    solve_lscp,
    solve_mclp,
)

GOLDEN = Path(__file__).parents[1] / "golden" / "cover"
OPTIMA = tomllib.loads((GOLDEN / "optima.toml").read_text())
EXACT = st.sampled_from(["auto", "HIGHS"])
# No share is nearer to another than solver and oracle can tell apart.
SHARES = st.integers(0, 1000).map(lambda thousandths: thousandths / 1000)


def check(solution: CoveringSolution, optimum: float, *, is_exact: bool, sign: float) -> None:
    """The objective is feasible, the bound valid, and with proof both are the optimum."""
    assert sign * (solution.objective - optimum) >= -1e-9
    assert sign * (optimum - solution.bound) >= -1e-9
    if is_exact:
        assert solution.objective == pytest.approx(optimum, abs=1e-9)
        assert solution.is_proven
        assert solution.bound == pytest.approx(solution.objective)


@given(instance=instances(), solver=st.sampled_from(["auto", "HIGHS", "greedy"]))
def test_covering_everything_matches_brute_force(instance, solver):
    solution = solve_lscp(instance, solver=solver)
    every = EverySet(instance)
    needed = every.covered[-1]  # by all columns together
    assert solution.covered_weight == pytest.approx(needed)
    assert solution.objective == solution.cost == instance.cost[solution.chosen].sum()
    check(solution, every.least_cost(needed), is_exact=solver != "greedy", sign=1.0)


@given(instance=instances(), share=SHARES, solver=EXACT)
def test_covering_a_share_matches_brute_force(instance, share, solver):
    target = share * instance.coverable_weight / max(instance.weight.sum(), 1.0)
    solution = solve_lscp(instance, target=target, solver=solver)
    needed = target * instance.weight.sum()
    assert solution.covered_weight >= needed - 1e-7
    check(solution, EverySet(instance).least_cost(needed), is_exact=True, sign=1.0)


@given(
    instance=instances(),
    units=st.integers(1, 8),
    solver=st.sampled_from(["auto", "HIGHS", "greedy"]),
)
def test_most_coverage_by_a_number_of_columns_matches_brute_force(instance, units, solver):
    solution = solve_mclp(instance, budget_units=units, solver=solver)
    assert len(solution.chosen) <= units
    assert solution.objective == solution.covered_weight
    assert solution.objective == instance.covered_weight(solution.chosen)
    optimum = EverySet(instance).most_weight(units)
    check(solution, optimum, is_exact=solver != "greedy", sign=-1.0)
    # Greedy choice of columns: Nemhauser, Wolsey and Fisher (1978).
    assert solution.objective >= (1.0 - 1.0 / math.e) * optimum - 1e-9


@given(
    instance=instances(),
    share=SHARES,
    units=st.none() | st.integers(1, 4),
    solver=EXACT,
)
def test_most_coverage_for_money_matches_brute_force(instance, share, units, solver):
    money = share * float(instance.cost.sum())
    useful = instance.cost[instance.covers @ instance.weight > 0.0]
    assume(len(useful) == 0 or money >= useful.min())
    solution = solve_mclp(instance, budget_units=units, budget_cost=money, solver=solver)
    assert solution.cost <= money + 1e-9
    assert units is None or len(solution.chosen) <= units
    optimum = EverySet(instance).most_weight(np.inf if units is None else units, money)
    check(solution, optimum, is_exact=True, sign=-1.0)


@pytest.mark.parametrize("name", OPTIMA)
def test_or_library_optima_are_found_and_proven(name):
    instance = load_instance(GOLDEN / f"{name}.txt")
    facts = OPTIMA[name]
    assert (instance.n_rows, instance.n_columns) == (facts["n_rows"], facts["n_columns"])
    solution = solve_lscp(instance)
    assert (solution.objective, solution.bound) == (facts["optimum"], facts["optimum"])
    assert solution.is_proven
    assert solution.covered_weight == instance.n_rows


@pytest.fixture(scope="module")
def hard():
    """Far too large to be solved in a fraction of a second."""
    rng = np.random.default_rng(5)
    return build_covering_instance(rng.random((400, 600)) < 0.04)


def test_when_the_time_is_up_there_is_an_answer_and_a_bound(hard):
    cover = solve_lscp(hard, time_limit_s=0.05)
    assert cover.covered_weight == hard.coverable_weight
    assert 0.0 < cover.bound < cover.objective
    assert not cover.is_proven
    most = solve_mclp(hard, budget_units=9, time_limit_s=0.05)
    assert len(most.chosen) == 9
    assert 0.0 < most.objective < most.bound <= hard.coverable_weight
    assert most.gap == pytest.approx(most.bound / most.objective - 1.0)


def test_a_model_that_memory_has_no_room_for_is_not_built(hard, monkeypatch):
    monkeypatch.setattr("placement.memory.available_bytes", lambda: 1000)
    with pytest.raises(InputError) as caught:
        solve_lscp(hard)
    assert str(caught.value).startswith("solver: got auto with ")
    assert str(caught.value).endswith("free: `solver` greedy, or fewer rows or columns")
    with pytest.raises(InputError, match="solver: got HIGHS with "):
        solve_mclp(hard, budget_units=9, solver="HIGHS")
    assert len(solve_mclp(hard, budget_units=9, solver="greedy").chosen) == 9


def test_an_interruption_ends_the_solver(hard, monkeypatch):
    import highspy

    waited = highspy.Highs.wait
    calls = []

    def wait(solver, timeout):
        calls.append(timeout)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return waited(solver, timeout)

    monkeypatch.setattr(highspy.Highs, "wait", wait)
    before = set(threading.enumerate())
    with pytest.raises(KeyboardInterrupt):
        solve_lscp(hard)
    for thread in set(threading.enumerate()) - before:
        thread.join(30.0)
        assert not thread.is_alive()


def test_a_gap_is_enough_where_one_is_given(hard):
    solution = solve_mclp(hard, budget_units=3, gap=0.2)
    assert 0.0 <= solution.gap <= 0.2


def test_optima_scale_with_costs_and_weights():
    rng = np.random.default_rng(7)
    covers = rng.random((12, 15)) < 0.25
    cost, weight = rng.uniform(1.0, 2.0, 12), rng.uniform(1.0, 2.0, 15)
    units = [
        (
            solve_lscp(instance, target=0.6),
            solve_mclp(instance, budget_cost=4.0 * scale, solver="HIGHS"),
        )
        for scale in (1.0, 1e-9, 1e9)
        for instance in [build_covering_instance(covers, cost=cost * scale, weight=weight * scale)]
    ]
    for least, most in units:
        np.testing.assert_array_equal(least.chosen, units[0][0].chosen)
        np.testing.assert_array_equal(most.chosen, units[0][1].chosen)
        assert least.is_proven
        assert most.is_proven


def test_rows_that_nothing_covers_are_told():
    instance = build_covering_instance([[1, 0, 0], [1, 1, 0]], weight=[1.0, 2.0, 4.0])
    solution = solve_lscp(instance)
    assert list(solution.chosen) == [1]
    assert solution.covered_weight == instance.coverable_weight == 3.0


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (
            lambda each: solve_lscp(each, target=0.8),
            "target: got 0.8; expected at most 0.75, the share that all columns together cover",
        ),
        (
            lambda each: solve_lscp(each, target=1.5),
            "target: got 1.5; expected max, or a share of the weight, 0 to 1",
        ),
        (
            lambda each: solve_mclp(each),
            "budget_units: got nothing; expected a number of columns, or money",
        ),
        (
            lambda each: solve_mclp(each, budget_units=0),
            "budget_units: got 0; expected a whole number of columns, at least 1",
        ),
        (
            lambda each: solve_mclp(each, budget_cost=2.5),
            "budget_cost: got 2.5; expected at least 3, the least cost of a column that covers "
            "anything",
        ),
        (
            lambda each: solve_mclp(each, budget_cost=-1.0),
            "budget_cost: got -1.0; expected an amount of money, at least 0",
        ),
        (
            lambda each: solve_lscp(each, time_limit_s=0.0),
            "time_limit_s: got 0.0; expected seconds, more than 0",
        ),
        (
            lambda each: solve_lscp(each, gap=1.0),
            "gap: got 1.0; expected a share, 0 <= gap < 1",
        ),
    ],
)
def test_wishes_that_cannot_be_met_say_what_can(ask, message):
    instance = build_covering_instance(
        [[1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0]], cost=[3.0, 4.0, 1.0]
    )
    with pytest.raises(InputError) as caught:
        ask(instance)
    assert str(caught.value) == message


def test_a_solver_that_is_not_there_is_told_with_those_that_are():
    instance = build_covering_instance([[1]])
    with pytest.raises(InputError, match="got 'NONESUCH'; expected a solver that is installed: "):
        solve_lscp(instance, solver="NONESUCH")
    with pytest.raises(InputError, match=r"installed: .*HIGHS"):
        solve_mclp(instance, budget_units=1, solver="NONESUCH")
    assert solve_lscp(instance, solver="highs").objective == 1.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"cost": [1.0, -2.0]}, "cost: got -2.0; expected no negative number"),
        ({"weight": [1.0]}, "weight: got shape (1,); expected shape (3,)"),
        ({"cost": [1.0, math.nan]}, "cost: got [1.0, nan]; expected finite numbers"),
        ({"names": ("a",)}, "names: got 1 names; expected 2, or none"),
    ],
)
def test_instances_are_checked(given, message):
    with pytest.raises(InputError) as caught:
        build_covering_instance([[1, 0, 1], [0, 1, 1]], **given)
    assert str(caught.value) == message
