"""Every question on small tables against brute force: floors, wishes, money, failures,
samples.
"""

from dataclasses import replace
from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import questions

from geometry.errors import InputError
from placement.optimiser import (
    Effort,
    PlacementProblem,
    apr,
    apr_failed,
    is_feasible,
    placement_value,
    solve_placement,
    solve_sturdily,
    sturdy_problem,
)

Row = tuple[float, ...]


def rank(problem: PlacementProblem, poses: tuple[int, ...]) -> Row:
    """What layouts are compared by, the larger the better."""
    value = placement_value(problem, poses)
    first: list[float] = []
    if problem.goal != "best":
        first.append(-len(poses) if problem.goal == "fewest" else -value.cost_eur)
    if problem.survive:
        first.append(apr_failed(problem, poses, problem.survive))
    return (*first, *value[:-1], -value.cost_eur)


def brute_force(problem: PlacementProblem) -> Row | None:
    best = None
    for n_units in range(1, problem.table.n_poses + 1):
        for poses in combinations(range(problem.table.n_poses), n_units):
            if is_feasible(problem, poses):
                row = tuple(round(number, 9) for number in rank(problem, poses))
                if best is None:
                    best = row
                else:
                    best = max(best, row)
    return best


def check(problem: PlacementProblem) -> None:
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
        if stage.name in ("units", "cost_eur"):
            sign = -1.0
        else:
            sign = 1.0
        assert sign * stage.bound >= sign * stage.objective


@given(problem=questions())
def test_every_question_matches_brute_force(problem: PlacementProblem) -> None:
    check(problem)


@given(problem=questions())
def test_models_answer_every_question_without_enumeration(
    problem: PlacementProblem,
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.proof.can_walk", lambda _: False)
        patch.setattr(
            "placement.optimiser.proof.best_of_few", lambda *_, **__: (None, False)
        )
        check(problem)


@given(
    problem=questions(), solver=st.sampled_from(["greedy", "relax", "exact", "auto"])
)
def test_no_bound_of_the_first_stage_is_beaten(
    problem: PlacementProblem, solver: str
) -> None:
    best = brute_force(problem)
    if best is None:
        return
    effort = Effort(solver=solver, time_limit_s=1e-9 if solver == "auto" else 60.0)
    try:
        solution = solve_placement(problem, effort=effort)
    except InputError:
        return  # nothing was found in time, and that is said
    first = solution.certificate.stages[0]
    if first.name in ("units", "cost_eur"):
        sign = -1.0
    else:
        sign = 1.0
    assert is_feasible(problem, solution.pose_index)
    assert sign * first.bound >= best[0] - 1e-6


@given(problem=questions(), give_up=st.sampled_from([0.0, 0.05, 0.3, 1.0]))
def test_what_is_given_up_buys_the_most_that_is_left_when_a_unit_fails(
    problem, give_up
):
    problem = replace(problem, goal="best", survive=0, floors=(), tail=1.0)
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
