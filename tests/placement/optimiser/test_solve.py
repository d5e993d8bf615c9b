from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle_checks import check
from small_tables import avoiding_problem

from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError
from placement.optimiser import (
    Effort,
    PlacementProblem,
    PlacementValue,
    is_better,
    is_feasible,
    placement_value,
    solve_greedy,
    solve_placement,
)
from placement.optimiser.constants import settle
from placement.optimiser.presolve import ReducedProblem

ANY_PROBLEM = st.from_type(PlacementProblem)
BestValue = Callable[[PlacementProblem, Iterable[int]], PlacementValue]


@given(problem=ANY_PROBLEM)
def test_solve_matches_brute_force_on_small_tables(
    problem: PlacementProblem, best_value: BestValue
) -> None:
    solution = solve_placement(problem)
    value = placement_value(problem, solution.pose_index)
    assert is_feasible(problem, solution.pose_index)
    assert value == pytest.approx(
        best_value(problem, range(problem.table.n_poses)), abs=1e-9
    )
    assert tuple(stage.objective for stage in solution.certificate.stages) == value
    assert solution.certificate.is_proven


def first_units(reduced: ReducedProblem, limit: FloatArray, **_: object) -> IntArray:
    return np.arange(min(reduced.n_poses, 1))


def keep_units(
    reduced: ReducedProblem, units: IntArray, limit: FloatArray, **_: object
) -> IntArray:
    return units


@given(problem=ANY_PROBLEM)
def test_bounds_from_a_poor_start_still_match_brute_force(
    problem: PlacementProblem, best_value: BestValue
) -> None:
    # Heuristic and enumeration solve small tables outright; without them the MILPs have
    # to.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.proof.search_from_many_starts", first_units)
        patch.setattr("placement.optimiser.proof.improve", keep_units)
        patch.setattr("placement.optimiser.proof.can_walk", lambda _: False)
        patch.setattr(
            "placement.optimiser.proof.best_of_few", lambda *_, **__: (None, False)
        )
        solution = solve_placement(problem)
    best = best_value(problem, range(problem.table.n_poses))
    assert placement_value(problem, solution.pose_index) == pytest.approx(
        best, abs=1e-9
    )
    assert solution.certificate.is_proven


@given(problem=ANY_PROBLEM)
def test_bound_is_never_below_the_best_when_time_is_up(
    problem: PlacementProblem, best_value: BestValue
) -> None:
    certificate = solve_placement(problem, effort=Effort(time_limit_s=1e-9)).certificate
    best = best_value(problem, range(problem.table.n_poses))
    for stage, value in zip(certificate.stages, best, strict=True):
        if stage.name == "cost_eur":
            sign = -1.0
        else:
            sign = 1.0
        assert sign * stage.bound >= sign * stage.objective
        assert sign * stage.bound >= sign * value - 1e-9
        assert (stage.gap == 0.0) == (stage.bound == stage.objective)
        if sign * stage.objective < sign * value - 1e-9:
            break  # the later bounds hold for layouts that are as good so far


@given(problem=ANY_PROBLEM)
def test_greedy_is_feasible_and_never_better_than_the_proven_best(
    problem: PlacementProblem,
) -> None:
    greedy = solve_greedy(problem)
    assert is_feasible(problem, greedy)
    best = solve_placement(problem).pose_index
    assert not is_better(
        placement_value(problem, greedy), placement_value(problem, best)
    )


@given(problem=ANY_PROBLEM)
def test_one_more_unit_never_makes_the_best_worse(problem: PlacementProblem) -> None:
    values = [
        placement_value(problem, solve_placement(with_budget(problem, k)).pose_index)
        for k in range(1, problem.limits.max_units + 1)
    ]
    assert not any(is_better(fewer, more) for fewer, more in pairwise(values))


@given(problem=ANY_PROBLEM)
@settings(max_examples=10)
def test_stages_are_named_in_order_as_they_begin(problem: PlacementProblem) -> None:
    begun: list[str] = []
    solution = solve_placement(problem, on_stage=begun.append)
    names = [stage.name for stage in solution.certificate.stages]
    assert begun == names == list(PlacementValue._fields)


@pytest.mark.parametrize("solver", ["auto", "relax", "greedy"])
def test_an_apr_of_0_in_the_worst_worlds_proves_no_margin(solver: str) -> None:
    # No pose avoids the run of the first world; of the second world's, one leaves more
    # time.
    problem = avoiding_problem(["010", "001"], budget_units=1)
    axis = replace(problem.table.axis, last_brake_time_s=np.array([-0.01, -0.01, 0.1]))
    table = replace(problem.table, axis=axis)
    worlds = replace(problem, table=table, sample_index=np.array([0, 1, 1]), tail=0.5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.proof.search_from_many_starts", first_units)
        solution = solve_placement(worlds, effort=Effort(solver=solver))
    for stage in solution.certificate.stages[2:4]:
        assert stage.bound == pytest.approx(0.175)
        assert stage.objective == pytest.approx(0.175 if solver == "auto" else 0.065)
        assert (stage.gap == 0.0) == (solver == "auto")


@pytest.mark.parametrize("solver", ["relax", "models"])
def test_weights_of_any_magnitude_are_solved_without_overflow(solver: str) -> None:
    weights = [1.0, 3.0, 2.0, 1.0e-302]
    check(
        avoiding_problem(["1001", "0110", "1100"], weights=weights, budget_units=2),
        solver,
    )


def test_nothing_is_proven_that_a_solvers_error_may_hide() -> None:
    assert settle(0.5, 0.5 + 3e-7, 1.0) > 0.5
    assert settle(0.5, 0.5 + 3e-7, 1.0, step=0.25) == 0.5
    assert settle(0.5, 0.75, 1.0, step=0.25) == 0.75
    assert settle(0.5, 0.4, 1.0) == 1.0  # the solver errs


def test_effort_says_what_a_time_limit_is() -> None:
    with pytest.raises(
        InputError, match=r"time_limit: got 0\.0; expected seconds, more than 0"
    ):
        Effort(time_limit_s=0.0)


def with_budget(problem: PlacementProblem, budget_units: int) -> PlacementProblem:
    return replace(problem, limits=replace(problem.limits, budget_units=budget_units))
