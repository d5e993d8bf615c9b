"""Bounds and proofs that hold where time or precision run out."""

from dataclasses import replace

import numpy as np
import pytest
from all_layouts import best_value, first_units, sign_of
from hypothesis import given
from oracle_checks import check
from problems import problems
from small_tables import avoiding_problem

from placement.optimiser import Effort, solve_placement
from placement.optimiser.constants import settle


@given(problem=problems())
def test_bound_is_never_below_the_best_when_time_is_up(problem):
    effort = Effort(time_limit_s=1e-9)
    solution = solve_placement(problem, effort=effort)
    stages = solution.certificate.stages

    for stage, value in zip(stages, best_value(problem), strict=True):
        sign = sign_of(stage.name)

        assert sign * stage.bound >= sign * stage.objective
        assert sign * stage.bound >= sign * value - 1e-9
        assert (stage.gap == 0.0) == (stage.bound == stage.objective)

        if sign * stage.objective < sign * value - 1e-9:
            break  # the later bounds hold for layouts that are as good so far


@pytest.mark.parametrize("solver", ["auto", "relax", "greedy"])
def test_an_apr_of_0_in_the_worst_worlds_proves_no_margin(solver):
    # No pose avoids the run of the first world; of the second world's, one leaves more
    # time.
    problem = avoiding_problem(["010", "001"], budget_units=1)
    axis = replace(problem.table.axis, last_brake_time_s=[-0.01, -0.01, 0.1])
    table = replace(problem.table, axis=axis)
    worlds = replace(
        problem,
        table=table,
        sample_index=np.array([0, 1, 1]),
        tail=0.5,
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.proof.search_from_many_starts", first_units)
        effort = Effort(solver=solver)
        solution = solve_placement(worlds, effort=effort)

    for stage in solution.certificate.stages[2:4]:
        assert stage.bound == pytest.approx(0.175)
        assert stage.objective == pytest.approx(0.175 if solver == "auto" else 0.065)
        assert (stage.gap == 0.0) == (solver == "auto")


@pytest.mark.parametrize("solver", ["relax", "models"])
def test_weights_of_any_magnitude_are_solved_without_overflow(solver):
    weights = [1.0, 3.0, 2.0, 1.0e-302]
    check(
        avoiding_problem(["1001", "0110", "1100"], weights=weights, budget_units=2),
        solver,
    )


def test_nothing_is_proven_that_a_solvers_error_may_hide():
    open_bound = settle(0.5, 0.5 + 3e-7, 1.0)
    stepped = settle(0.5, 0.5 + 3e-7, 1.0, step=0.25)
    next_step = settle(0.5, 0.75, 1.0, step=0.25)

    assert open_bound > 0.5
    assert stepped == 0.5
    assert next_step == 0.75
    assert settle(0.5, 0.4, 1.0) == 1.0  # the solver errs
