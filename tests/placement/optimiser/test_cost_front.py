from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import questions
from small_tables import avoiding_problem

from geometry.errors import InputError
from placement.optimiser import (
    Effort,
    PlacementProblem,
    PlacementValue,
    is_feasible,
    placement_value,
)
from placement.optimiser.cost_front import cost_front

ANY_STAGES = st.sampled_from(["first", "all"])
Steps = list[tuple[float, float, float]]


def all_values(problem: PlacementProblem) -> list[PlacementValue]:
    n_poses = problem.table.n_poses
    return [
        placement_value(problem, poses)
        for n_units in range(1, n_poses + 1)
        for poses in combinations(range(n_poses), n_units)
        if is_feasible(problem, poses)
    ]


def steps_of(values: list[PlacementValue], step: float) -> Steps:
    """Brute force: cost, APR and APR when one fails, from the cheapest that avoids
    anything.
    """
    steps: Steps = []
    while True:
        if steps:
            _, apr, kept = steps[-1]
        else:
            _, apr, kept = (0.0, 0.0, 0.0)
        higher = [value for value in values if value.apr >= apr + step - 1e-9]
        safer = [
            value
            for value in values
            if value.apr >= apr - 1e-9 and value.apr_one_failed >= kept + step - 1e-9
        ]
        found = [
            cheapest(better)
            for better in ([higher, safer] if steps else [higher])
            if better
        ]
        if not found:
            return steps
        steps.append(min(found, key=lambda point: round(point[0], 6)))


def cheapest(values: list[PlacementValue]) -> tuple[float, float, float]:
    cost = min(value.cost_eur for value in values)
    best = max(
        (round(value.apr, 9), round(value.apr_one_failed, 9))
        for value in values
        if value.cost_eur <= cost + 1e-6
    )
    return (cost, *best)


def asked_for_nothing_but_the_best(problem: PlacementProblem) -> PlacementProblem:
    return replace(problem, goal="best", survive=0)


@given(problem=questions().map(asked_for_nothing_but_the_best), stages=ANY_STAGES)
def test_steps_are_those_of_brute_force(problem: PlacementProblem, stages: str) -> None:
    check_steps(problem, stages)


@given(problem=questions().map(asked_for_nothing_but_the_best))
def test_models_find_the_same_steps_without_enumeration(
    problem: PlacementProblem,
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.proof.can_walk", lambda _: False)
        patch.setattr(
            "placement.optimiser.proof.best_of_few", lambda *_, **__: (None, False)
        )
        check_steps(problem, "first")


def check_steps(problem: PlacementProblem, stages: str) -> None:
    weight = problem.table.axis.weight
    step = float(weight[weight > 0.0].min())
    expected = steps_of(all_values(problem), step)
    if not expected:
        with pytest.raises(InputError):
            cost_front(problem, step_apr=step, stages=stages)
        return
    front = cost_front(problem, step_apr=step, stages=stages)
    found = [
        (p.value.cost_eur, p.value.apr, p.value.apr_one_failed) for p in front.points
    ]
    assert len(found) == len(expected)
    for mine, theirs in zip(found, expected, strict=True):
        assert mine == pytest.approx(theirs, abs=1e-8)
    assert front.is_proven
    for point in front.points:
        assert is_feasible(problem, point.pose_index)
        assert point.certificate.stages[0].name == "cost_eur"
        assert point.units == len(point.pose_index)
    if stages == "first":
        assert front.settled == pytest.approx(expected[-1][0])


@given(
    problem=questions().map(asked_for_nothing_but_the_best),
    seconds=st.sampled_from([1e-9, 60.0]),
)
def test_more_money_never_buys_less_and_no_bound_is_beaten(
    problem: PlacementProblem, seconds: float
) -> None:
    values = all_values(problem)
    try:
        front = cost_front(problem, effort=Effort(time_limit_s=seconds))
    except InputError:
        return
    for cheaper, point in pairwise(front.points):
        assert cheaper.value.cost_eur < point.value.cost_eur
        assert tuple(round(v, 9) for v in cheaper.value[:2]) < tuple(
            round(v, 9) for v in point.value[:2]
        )
        # What is better than the point before costs no less than the next one's bound.
        weight = problem.table.axis.weight
        better = [
            value.cost_eur
            for value in values
            if value.apr >= cheaper.value.apr + float(weight[weight > 0.0].max())
        ]
        assert not better or min(better) >= point.certificate.stages[0].bound - 1e-6


def test_the_next_point_costs_least_for_one_more_run_or_one_more_that_survives() -> (
    None
):
    problem = avoiding_problem(["1100", "0011", "1111"], price_eur=[1.0, 2.0, 7.0])
    front = cost_front(problem)
    assert [
        (p.value.cost_eur, p.value.apr, p.value.apr_one_failed) for p in front.points
    ] == [
        (1.0, 0.5, 0.0),
        (3.0, 1.0, 0.5),
        (10.0, 1.0, 1.0),
    ]
    assert [point.pose_index for point in front.points] == [(0,), (0, 1), (0, 1, 2)]
    assert front.settled == 10.0
    assert front.is_proven
    assert (front.by, front.stages) == ("cost", "first")


def test_money_goes_on_buying_what_survives_a_failure() -> None:
    problem = avoiding_problem(["11", "10", "11"], price_eur=[1.0, 2.0, 4.0])
    front = cost_front(problem)
    assert [
        (p.value.cost_eur, p.value.apr, p.value.apr_one_failed) for p in front.points
    ] == [
        (1.0, 1.0, 0.0),
        (3.0, 1.0, 0.5),
        (5.0, 1.0, 1.0),
    ]


def test_points_closer_than_the_step_are_left_out_and_points_are_told() -> None:
    rows = ["10000", "11000", "11100", "11110", "11111"]
    problem = avoiding_problem(
        rows, price_eur=[1.0, 2.0, 3.0, 4.0, 5.0], budget_units=1
    )
    told: list[float] = []
    all_points = cost_front(
        problem, on_point=lambda point: told.append(point.value.cost_eur)
    )
    assert (
        told == [point.value.cost_eur for point in all_points.points] == [1, 2, 3, 4, 5]
    )
    few = cost_front(problem, step_apr=0.4)
    assert [point.value.apr for point in few.points] == [0.4, 0.8]
    short = cost_front(problem, max_points=2)
    assert len(short.points) == 2
    assert short.settled is None


@pytest.mark.parametrize(
    ("rows", "options", "message"),
    [
        (
            ["00"],
            {},
            "candidates: got poses that avoid nothing; expected one that does",
        ),
        (["10"], {"max_points": 0}, "max_points: got 0; expected at least 1"),
    ],
)
def test_what_cannot_be_is_told(
    rows: list[str], options: dict[str, int], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        cost_front(avoiding_problem(rows), **options)


def test_a_forced_unit_that_leaves_no_room_for_what_avoids_is_told() -> None:
    problem = avoiding_problem(["00", "11"])
    full = replace(
        problem.limits,
        site_index=np.array([0, 0]),
        site_capacity=np.array([1, 0]),
        is_forced=np.array([True, False]),
    )
    expected = (
        "candidates: got no layout that avoids anything; expected one within the limits"
    )
    with pytest.raises(InputError, match=expected):
        cost_front(replace(problem, limits=full))
