"""Every question on small tables against brute force: floors, wishes, money, failures,
samples.
"""

from dataclasses import replace

import pytest
from all_layouts import feasible_layouts, sign_of, solved_by_models
from hypothesis import given
from hypothesis import strategies as st
from problems import questions

from geometry.errors import InputError
from placement.optimiser import (
    Effort,
    apr,
    apr_failed,
    is_feasible,
    placement_value,
    solve_placement,
    solve_sturdily,
    sturdy_problem,
)


def rank(problem, poses):
    """What layouts are compared by, the larger the better."""
    value = placement_value(problem, poses)
    first = []
    if problem.goal != "best":
        first.append(-len(poses) if problem.goal == "fewest" else -value.cost_eur)

    if problem.survive:
        first.append(apr_failed(problem, poses, problem.survive))

    return (*first, *value[:-1], -value.cost_eur)


def brute_force(problem):
    """Rank of the best layout; None where no layout meets all wishes."""
    ranks = [
        tuple(round(number, 9) for number in rank(problem, poses))
        for poses in feasible_layouts(problem)
    ]
    return max(ranks, default=None)


def check(problem):
    """The solver finds the best of brute force, or refuses as it does."""
    best = brute_force(problem)
    if best is None:
        with pytest.raises(InputError):
            solve_placement(problem)
        return

    solution = solve_placement(problem)

    assert is_feasible(problem, solution.pose_index)
    assert rank(problem, solution.pose_index) == pytest.approx(best, abs=2e-9)

    for stage in solution.certificate.stages:
        assert (stage.gap == 0.0) == (stage.bound == stage.objective)
        sign = sign_of(stage.name)
        assert sign * stage.bound >= sign * stage.objective


@given(problem=questions())
def test_every_question_matches_brute_force(problem):
    check(problem)


@pytest.mark.long
@given(problem=questions(), is_poorly_begun=st.booleans())
def test_models_answer_every_question_without_enumeration(problem, is_poorly_begun):
    with solved_by_models(is_poorly_begun=is_poorly_begun):
        check(problem)


@given(
    problem=questions(), solver=st.sampled_from(["greedy", "relax", "exact", "auto"])
)
def test_no_bound_of_the_first_stage_is_beaten(problem, solver):
    best = brute_force(problem)
    if best is None:
        return

    effort = Effort(solver=solver, time_limit_s=1e-9 if solver == "auto" else 60.0)
    try:
        solution = solve_placement(problem, effort=effort)
    except InputError:
        return  # nothing was found in time, and that is said

    first = solution.certificate.stages[0]
    sign = sign_of(first.name)

    assert is_feasible(problem, solution.pose_index)
    assert sign * first.bound >= best[0] - 1e-6


@given(problem=questions(), give_up=st.sampled_from([0.0, 0.05, 0.3, 1.0]))
def test_what_is_given_up_buys_the_most_that_is_left_when_a_unit_fails(
    problem, give_up
):
    problem = replace(
        problem,
        goal="best",
        survive=0,
        floors=(),
        tail=1.0,
    )
    try:
        highest, sturdy = solve_sturdily(problem, give_up=give_up, effort=Effort())
    except InputError:
        assert brute_force(problem) is None
        return

    best = brute_force(problem)

    assert rank(problem, highest.pose_index) == pytest.approx(best, abs=1e-8)
    assert highest.certificate.is_proven

    if give_up == 0.0 or len(highest.pose_index) < 2:
        assert sturdy is None
        return

    asked = sturdy_problem(problem, highest, give_up)

    assert rank(asked, sturdy.pose_index) == pytest.approx(brute_force(asked), abs=1e-8)
    assert apr(problem, sturdy.pose_index) >= best[0] - give_up - 1e-8
    assert sturdy.certificate.is_proven
