"""The front of APR by cost, against brute force."""

import re
from dataclasses import replace
from itertools import pairwise

import pytest
from all_layouts import feasible_layouts, solved_by_models
from hypothesis import given
from hypothesis import strategies as st
from problems import questions
from small_tables import avoiding_problem

from geometry.errors import InputError
from placement.optimiser import Effort, is_feasible, placement_value
from placement.optimiser.cost_front import cost_front

ANY_STAGES = st.sampled_from(["first", "all"])


def all_values(problem):
    """Values of all layouts that the limits allow."""
    return [placement_value(problem, poses) for poses in feasible_layouts(problem)]


def steps_of(values, step):
    """Brute force: cost, APR and APR when one fails, from the cheapest that avoids
    anything.
    """
    steps = []
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


def cheapest(values):
    """The least cost, and the best that it buys."""
    cost = min(value.cost_eur for value in values)
    best = max(
        (round(value.apr, 9), round(value.apr_one_failed, 9))
        for value in values
        if value.cost_eur <= cost + 1e-6
    )
    return (cost, *best)


def values_of(front):
    """Cost, APR and APR when one fails of each point."""
    values = [point.value for point in front.points]
    return [(value.cost_eur, value.apr, value.apr_one_failed) for value in values]


def asked_for_nothing_but_the_best(problem):
    """The problem without a target and without failures."""
    return replace(problem, goal="best", survive=0)


@given(problem=questions().map(asked_for_nothing_but_the_best), stages=ANY_STAGES)
def test_steps_are_those_of_brute_force(problem, stages):
    check_steps(problem, stages)


@pytest.mark.long
@given(problem=questions().map(asked_for_nothing_but_the_best))
def test_models_find_the_same_steps_without_enumeration(problem):
    with solved_by_models():
        check_steps(problem, "first")


def check_steps(problem, stages):
    """The front has the steps of brute force."""
    weight = problem.table.axis.weight
    step = float(weight[weight > 0.0].min())
    expected = steps_of(all_values(problem), step)
    if not expected:
        with pytest.raises(InputError):
            cost_front(problem, step_apr=step, stages=stages)
        return

    front = cost_front(problem, step_apr=step, stages=stages)
    found = values_of(front)

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
def test_more_money_never_buys_less_and_no_bound_is_beaten(problem, seconds):
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


def test_the_next_point_costs_least_for_one_more_run_or_one_more_that_survives():
    problem = avoiding_problem(["1100", "0011", "1111"], price_eur=[1.0, 2.0, 7.0])

    front = cost_front(problem)

    assert values_of(front) == [
        (1.0, 0.5, 0.0),
        (3.0, 1.0, 0.5),
        (10.0, 1.0, 1.0),
    ]
    assert [point.pose_index for point in front.points] == [(0,), (0, 1), (0, 1, 2)]
    assert front.settled == 10.0
    assert front.is_proven
    assert front.by == "cost"
    assert front.stages == "first"


def test_points_closer_than_the_step_are_left_out_and_points_are_told():
    rows = ["10000", "11000", "11100", "11110", "11111"]
    problem = avoiding_problem(
        rows,
        price_eur=[1.0, 2.0, 3.0, 4.0, 5.0],
        budget_units=1,
    )
    told = []

    all_points = cost_front(
        problem, on_point=lambda point: told.append(point.value.cost_eur)
    )

    assert told == [1, 2, 3, 4, 5]
    assert [point.value.cost_eur for point in all_points.points] == told

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
def test_what_cannot_be_is_told(rows, options, message):
    with pytest.raises(InputError, match=re.escape(message)):
        cost_front(avoiding_problem(rows), **options)


def test_a_forced_unit_that_leaves_no_room_for_what_avoids_is_told():
    problem = avoiding_problem(["00", "11"])
    full = replace(
        problem.limits,
        site_index=[0, 0],
        site_capacity=[1, 0],
        is_forced=[True, False],
    )
    expected = (
        "candidates: got no layout that avoids anything; expected one within the limits"
    )

    with pytest.raises(InputError, match=re.escape(expected)):
        cost_front(replace(problem, limits=full))
