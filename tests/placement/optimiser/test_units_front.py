from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import combinations, pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import questions
from small_tables import avoiding_problem

from geometry.errors import InputError
from placement.optimiser import (
    Effort,
    Floor,
    PlacementProblem,
    PlacementValue,
    apr,
    apr_one_failed,
    is_better,
    is_feasible,
    placement_value,
    solve_placement,
)
from placement.optimiser.front import (
    FIRST_STAGES,
    front_below,
    one_failed_limit,
    pareto_front,
)
from placement.optimiser.presolve import presolve

ANY_PROBLEM = st.from_type(PlacementProblem)
ANY_STAGES = st.sampled_from(["first", "all"])
BestValue = Callable[[PlacementProblem, Iterable[int]], PlacementValue]


def with_units(problem: PlacementProblem, units: int) -> PlacementProblem:
    return replace(problem, limits=replace(problem.limits, budget_units=units))


def best_rank(problem: PlacementProblem) -> PlacementValue | None:
    best = None
    for n_units in range(1, problem.table.n_poses + 1):
        for poses in combinations(range(problem.table.n_poses), n_units):
            if is_feasible(problem, poses):
                value = placement_value(problem, poses)
                if best is None or is_better(value, best):
                    best = value
                else:
                    best = best
    return best


@given(problem=ANY_PROBLEM, stages=ANY_STAGES)
def test_every_point_is_the_best_that_brute_force_finds(
    problem: PlacementProblem, best_value: BestValue, stages: str
) -> None:
    n_poses = problem.table.n_poses
    front = pareto_front(problem, max_units=4, stages=stages)
    assert [point.units for point in front.points] == [1, 2, 3, 4]
    for point in front.points:
        here = with_units(problem, point.units)
        best = best_value(here, range(n_poses))
        if stages == "first":
            n_held = 2
        else:
            n_held = 5
        assert is_feasible(here, point.pose_index)
        assert point.value == placement_value(problem, point.pose_index)
        assert point.value[:n_held] == pytest.approx(best[:n_held], abs=1e-9)
        assert point.is_proven
        names = [stage.name for stage in point.certificate.stages]
        assert names == list(
            FIRST_STAGES if stages == "first" else PlacementValue._fields
        )
        assert [stage.objective for stage in point.certificate.stages] == list(
            point.value[: len(names)]
        )


@given(problem=questions(), stages=ANY_STAGES)
def test_wishes_hold_at_every_point_and_refuse_those_that_cannot_meet_them(
    problem: PlacementProblem, stages: str
) -> None:
    problem = replace(problem, goal="best", survive=0)
    bests = {units: best_rank(with_units(problem, units)) for units in range(1, 4)}
    n_forced = int(problem.limits.is_forced.sum())
    possible = [units for units, best in bests.items() if best and units >= n_forced]
    if not possible:
        with pytest.raises(InputError):
            pareto_front(problem, max_units=3, stages=stages)
        return
    front = pareto_front(problem, max_units=3, stages=stages)
    assert [point.units for point in front.points] == possible
    if stages == "first":
        n_held = 2
    else:
        n_held = 5
    for point in front.points:
        assert is_feasible(with_units(problem, point.units), point.pose_index)
        assert point.value[:n_held] == pytest.approx(
            bests[point.units][:n_held], abs=1e-8
        )
    refused = [units for units, _ in front.refused]
    assert refused == [u for u in range(max(1, n_forced), 4) if u not in possible]


@given(problem=ANY_PROBLEM, stages=ANY_STAGES)
def test_models_find_the_same_points_without_enumeration(
    problem: PlacementProblem, best_value: BestValue, stages: str
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.proof.can_walk", lambda _: False)
        patch.setattr(
            "placement.optimiser.proof.best_of_few", lambda *_, **__: (None, False)
        )
        front = pareto_front(problem, max_units=3, stages=stages)
    if stages == "first":
        n_held = 2
    else:
        n_held = 5
    for point in front.points:
        best = best_value(
            with_units(problem, point.units), range(problem.table.n_poses)
        )
        assert point.value[:n_held] == pytest.approx(best[:n_held], abs=1e-9)
        assert point.is_proven


@given(problem=ANY_PROBLEM)
def test_points_agree_with_separate_solves(problem: PlacementProblem) -> None:
    for point in pareto_front(problem, max_units=3, stages="all").points:
        solution = solve_placement(with_units(problem, point.units))
        assert [stage.objective for stage in point.certificate.stages] == pytest.approx(
            [stage.objective for stage in solution.certificate.stages], abs=1e-9
        )


@given(problem=questions(), seconds=st.sampled_from([1e-9, 60.0]), stages=ANY_STAGES)
def test_values_never_fall_and_bounds_hold_even_when_time_is_up(
    problem: PlacementProblem, seconds: float, stages: str
) -> None:
    problem = replace(problem, goal="best", survive=0)
    try:
        front = pareto_front(
            problem, max_units=4, stages=stages, effort=Effort(time_limit_s=seconds)
        )
    except InputError:
        return
    for fewer, point in pairwise(front.points):
        assert not is_better(fewer.value, point.value)
        assert (
            fewer.certificate.stages[0].bound
            <= point.certificate.stages[0].bound + 1e-12
        )
    for point in front.points:
        best = best_rank(with_units(problem, point.units))
        assert best is not None
        for stage, value in zip(point.certificate.stages, best, strict=False):
            if stage.name == "cost_eur":
                sign = -1.0
            else:
                sign = 1.0
            assert sign * stage.bound >= sign * value - 1e-6
            if sign * stage.objective < sign * value - 1e-9:
                break  # bounds of later stages hold for layouts that are as good so far


@given(problem=questions(), stages=ANY_STAGES)
def test_where_nothing_grows_nothing_grows(
    problem: PlacementProblem, stages: str
) -> None:
    problem = replace(problem, goal="best", survive=0)
    try:
        front = pareto_front(problem, max_units=4, stages=stages)
    except InputError:
        return
    best = best_rank(with_units(problem, 8))
    if front.settled is None:
        settled = front.points[-1]
    else:
        settled = None
    if settled is not None:
        return
    assert best is not None
    if stages == "first":
        n_held = 2
    else:
        n_held = 5
    for point in front.points:
        if point.units >= front.settled:
            assert point.value[:n_held] == pytest.approx(best[:n_held], abs=1e-8)


@given(problem=ANY_PROBLEM)
def test_no_set_keeps_more_than_all_poses_but_one_reach(
    problem: PlacementProblem,
) -> None:
    n_poses = problem.table.n_poses
    limit = one_failed_limit(presolve(with_units(problem, n_poses)))
    sets = [
        units
        for size in range(1, n_poses + 1)
        for units in combinations(range(n_poses), size)
        if is_feasible(with_units(problem, n_poses), units)
    ]
    assert all(apr_one_failed(problem, units) <= limit + 1e-9 for units in sets)
    assert limit <= apr(problem, range(n_poses)) + 1e-9


@given(problem=ANY_PROBLEM, stages=ANY_STAGES)
def test_points_of_large_tables_are_solved_by_themselves_and_never_fall(
    problem: PlacementProblem, stages: str
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.constants.MAX_BITS", 0)
        front = pareto_front(problem, max_units=3, stages=stages)
    assert front.presolve is None
    for fewer, point in pairwise(front.points):
        assert not is_better(fewer.value, point.value)
    for point in front.points:
        here = with_units(problem, point.units)
        assert is_feasible(here, point.pose_index)
        best = best_rank(here)
        assert best is not None
        assert point.certificate.stages[0].bound >= best.apr - 1e-6


@given(problem=ANY_PROBLEM)
@settings(max_examples=10)
def test_points_are_told_as_they_come(problem: PlacementProblem) -> None:
    told: list[int] = []
    front = pareto_front(
        problem, max_units=3, on_point=lambda point: told.append(point.units)
    )
    assert told == [point.units for point in front.points][: len(told)]
    assert told


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
def test_a_front_asks_for_nothing_but_the_best(
    changes: dict[str, object], max_units: int, message: str
) -> None:
    problem = replace(avoiding_problem(["10", "01"]), **changes)
    with pytest.raises(InputError, match=message):
        pareto_front(problem, max_units=max_units)


@given(problem=questions())
def test_a_front_below_a_solution_is_the_front_up_to_it(
    problem: PlacementProblem,
) -> None:
    problem = with_units(replace(problem, goal="best", survive=0), 3)
    try:
        solution = solve_placement(problem)
    except InputError:
        return
    below = front_below(problem, solution.pose_index, solution.certificate)
    assert below.points[-1].pose_index == solution.pose_index
    whole = pareto_front(problem, max_units=3, stages="all")
    assert [point.units for point in below.points] == [
        point.units for point in whole.points
    ]
    for ours, theirs in zip(below.points, whole.points, strict=True):
        assert ours.value == pytest.approx(theirs.value, abs=1e-8)


@given(problem=ANY_PROBLEM)
@settings(max_examples=10)
def test_nothing_is_below_one_unit_or_all_that_is_kept(
    problem: PlacementProblem,
) -> None:
    problem = with_units(problem, 2)
    solution = solve_placement(problem)
    front = front_below(problem, solution.pose_index, solution.certificate, min_units=2)
    assert [point.pose_index for point in front.points] == [solution.pose_index]
    with pytest.raises(InputError, match="target"):
        front_below(replace(problem, goal="fewest"), (0,), solution.certificate)
