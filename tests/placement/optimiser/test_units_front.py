"""The front of APR by number of units, against brute force."""

import re
from dataclasses import replace
from itertools import pairwise

import pytest
from all_layouts import best_value, feasible_layouts, sign_of, solved_by_models
from changes import changed
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import problems, questions
from small_tables import avoiding_problem

from geometry.errors import InputError
from placement.optimiser import (
    Effort,
    Floor,
    PlacementValue,
    apr,
    apr_one_failed,
    is_better,
    is_feasible,
    placement_value,
    solve_placement,
)
from placement.optimiser.front import front_below, one_failed_limit, pareto_front
from placement.optimiser.presolve import presolve

N_HELD = {"first": 2, "all": 5}
"""How many stages are those of the best layout, by what is asked for."""
ANY_STAGES = st.sampled_from(sorted(N_HELD))


def with_units(problem, units):
    """The problem with another number of units."""
    return changed(problem, "limits.budget_units", units)


@given(problem=questions(), stages=ANY_STAGES)
def test_every_point_is_that_of_brute_force_or_refused_where_wishes_cannot_be_met(
    problem, stages
):
    check_points(problem, stages)


@pytest.mark.long
@given(problem=questions(), stages=ANY_STAGES)
def test_models_find_the_same_points_without_enumeration(problem, stages):
    with solved_by_models():
        check_points(problem, stages)


def check_points(problem, stages):
    """The front has the points of brute force."""
    problem = replace(problem, goal="best", survive=0)
    bests = {units: best_value(with_units(problem, units)) for units in range(1, 4)}
    forced = problem.limits.is_forced.sum()
    n_forced = int(forced)
    possible = [units for units, best in bests.items() if best and units >= n_forced]
    if not possible:
        with pytest.raises(InputError):
            pareto_front(problem, max_units=3, stages=stages)
        return

    told = []
    front = pareto_front(
        problem,
        max_units=3,
        stages=stages,
        on_point=told.append,
    )
    found_units = [point.units for point in front.points]

    assert found_units == possible
    assert told[0].units == possible[0]

    n_held = N_HELD[stages]

    for point in front.points:
        best = bests[point.units]
        names = [stage.name for stage in point.certificate.stages]
        objectives = [stage.objective for stage in point.certificate.stages]
        asked = with_units(problem, point.units)
        expected_value = placement_value(problem, point.pose_index)
        held_names = list(PlacementValue._fields[:n_held])
        held_values = list(point.value[:n_held])

        assert is_feasible(asked, point.pose_index)
        assert point.value == expected_value
        assert point.value[:n_held] == pytest.approx(best[:n_held], abs=1e-8)
        assert names == held_names
        assert objectives == held_values
        assert point.is_proven

    refused = [units for units, _ in front.refused]

    expected = [u for u in range(max(1, n_forced), 4) if u not in possible]

    assert refused == expected


@given(problem=questions(), seconds=st.sampled_from([1e-9, 60.0]), stages=ANY_STAGES)
def test_values_never_fall_and_bounds_hold_even_when_time_is_up(
    problem, seconds, stages
):
    problem = replace(problem, goal="best", survive=0)
    try:
        front = pareto_front(
            problem,
            max_units=4,
            stages=stages,
            effort=Effort(time_limit_s=seconds),
        )
    except InputError:
        return

    for fewer, point in pairwise(front.points):
        assert not is_better(fewer.value, point.value)

        bound = fewer.certificate.stages[0].bound
        next_stage = point.certificate.stages[0]

        assert bound <= next_stage.bound + 1e-12

    for point in front.points:
        asked = with_units(problem, point.units)
        best = best_value(asked)
        for stage, value in zip(point.certificate.stages, best, strict=False):
            sign = sign_of(stage.name)
            assert sign * stage.bound >= sign * value - 1e-6
            if sign * stage.objective < sign * value - 1e-9:
                break  # bounds of later stages hold for layouts that are as good so far


@given(problem=questions(), stages=ANY_STAGES)
def test_where_nothing_grows_nothing_grows(problem, stages):
    problem = replace(problem, goal="best", survive=0)
    try:
        front = pareto_front(problem, max_units=4, stages=stages)
    except InputError:
        return

    if front.settled is None:
        return

    best = best_value(with_units(problem, 8))
    n_held = N_HELD[stages]
    for point in front.points:
        if point.units >= front.settled:
            assert point.value[:n_held] == pytest.approx(best[:n_held], abs=1e-8)


@given(problem=problems())
def test_no_set_keeps_more_than_all_poses_but_one_reach(problem):
    n_poses = problem.table.n_poses
    unlimited = with_units(problem, n_poses)

    limit = one_failed_limit(presolve(unlimited))

    for units in feasible_layouts(unlimited):
        assert apr_one_failed(problem, units) <= limit + 1e-9

    highest = apr(problem, range(n_poses))

    assert limit <= highest + 1e-9


@pytest.mark.long
@given(problem=problems(), stages=ANY_STAGES)
def test_points_of_large_tables_are_solved_by_themselves_and_never_fall(
    problem, stages
):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.constants.MAX_BITS", 0)
        front = pareto_front(problem, max_units=3, stages=stages)

    assert front.presolve is None

    for fewer, point in pairwise(front.points):
        assert not is_better(fewer.value, point.value)

    for point in front.points:
        here = with_units(problem, point.units)

        assert is_feasible(here, point.pose_index)

        best = best_value(here)
        stage = point.certificate.stages[0]

        assert stage.bound >= best.apr - 1e-6


@pytest.mark.parametrize(
    ("changes", "max_units", "message"),
    [
        (
            {"goal": "fewest", "floors": (Floor(name="--target", share=1.0),)},
            3,
            "target: got it with a front",
        ),
        ({"survive": 1}, 3, "survive: got it with a front"),
        ({}, 0, "max_units: got 0; expected a number of units, at least 1"),
    ],
)
def test_a_front_asks_for_nothing_but_the_best(changes, max_units, message):
    plain = avoiding_problem(["10", "01"])
    problem = replace(plain, **changes)
    with pytest.raises(InputError, match=re.escape(message)):
        pareto_front(problem, max_units=max_units)


@pytest.mark.long
@given(problem=questions())
def test_a_front_below_a_solution_is_the_front_up_to_it(problem):
    best_alone = replace(problem, goal="best", survive=0)
    problem = with_units(best_alone, 3)
    try:
        solution = solve_placement(problem)
    except InputError:
        return

    below = front_below(problem, solution.pose_index, solution.certificate)

    assert below.points[-1].pose_index == solution.pose_index

    whole = pareto_front(problem, max_units=3, stages="all")

    expected = [point.units for point in whole.points]
    found_units = [point.units for point in below.points]

    assert found_units == expected

    for ours, theirs in zip(below.points, whole.points, strict=True):
        assert ours.value == pytest.approx(theirs.value, abs=1e-8)


@given(problem=problems())
@settings(max_examples=10)
def test_nothing_is_below_one_unit_or_all_that_is_kept(problem):
    problem = with_units(problem, 2)
    solution = solve_placement(problem)

    front = front_below(
        problem,
        solution.pose_index,
        solution.certificate,
        min_units=2,
    )
    found_poses = [point.pose_index for point in front.points]

    assert found_poses == [solution.pose_index]

    fewest = replace(problem, goal="fewest")

    with pytest.raises(InputError, match="target"):
        front_below(fewest, (0,), solution.certificate)
