"""The accident prevention ratio of sampled worlds, requirements, and the order of
values.
"""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused_with

from placement.optimiser import Floor, PlacementValue, is_better
from placement.optimiser.problem import (
    VALUE_OBJECTIVES,
    Objective,
    Requirement,
    build_measure,
    objectives_in_order,
)

SEEDS = st.integers(0, 2**32 - 1)
TAILS = st.sampled_from([1.0, 0.75, 0.5, 0.2, 0.01])


def drawn_measure(seed, tail):
    """Eight runs in up to four worlds; all together weigh 1."""
    rng = np.random.default_rng(seed)
    each_world = np.arange(4)
    drawn_world = rng.integers(0, 4, 4)
    world = np.concatenate([each_world, drawn_world])
    whole = rng.integers(1, 9, 8)
    weight = whole.astype(np.float64)
    total = weight.sum()
    measure = build_measure(weight / total, world, tail=tail)
    return measure, rng


def mean_of_worst(measure, is_avoided):
    """Plain loops: the worst worlds first, the last of them in part."""
    worlds = []
    for world, share in enumerate(measure.sample_weight.tolist()):
        mine = measure.sample_index == world
        counted = measure.weight[mine & is_avoided]
        avoided = float(counted.sum())
        worlds.append((avoided / share, share))

    total = 0.0
    left = measure.tail
    for ratio, share in sorted(worlds):
        total += min(share, left) * ratio
        left -= min(share, left)

    return total / measure.tail


@given(SEEDS, TAILS)
def test_the_measure_is_the_mean_over_the_worst_worlds(seed, tail):
    measure, rng = drawn_measure(seed, tail)
    drawn = rng.random((5, 8))
    is_avoided = drawn < 0.6
    expected = [mean_of_worst(measure, one) for one in is_avoided]
    found = measure.of(is_avoided)
    of_first = measure.of(is_avoided[0])

    assert found == pytest.approx(expected, abs=1e-12)
    assert of_first == pytest.approx(expected[0], abs=1e-12)

    by_world = measure.by_world(is_avoided)
    sums = pytest.approx(is_avoided @ measure.weight)
    of_worlds = measure.of_worlds(by_world)

    assert by_world.sum(axis=1) == sums
    assert of_worlds == pytest.approx(expected, abs=1e-12)


@given(SEEDS, TAILS)
def test_runs_out_of_reach_still_count_as_lost(seed, tail):
    measure, rng = drawn_measure(seed, tail)
    is_in_reach = rng.random(8) < 0.6
    runs = np.flatnonzero(is_in_reach)
    part = measure.of_runs(runs)
    is_avoided = rng.random(8) < 0.7
    is_within = np.isin(np.arange(8), runs)
    is_lost = ~is_within

    expected_of = measure.of(is_avoided & ~is_lost)
    expected = float(expected_of)
    found = part.of(is_avoided[runs])

    assert found == pytest.approx(expected)
    assert (part.sample_weight == measure.sample_weight).all()


@pytest.mark.parametrize(
    ("weights", "tail", "step"),
    [
        ([1, 1, 2], 1.0, 0.25),
        ([1, 1, 2], 0.5, 0.0),
        ([1, 1.5, 2], 1.0, 0.0),
        ([2, 2], 1.0, 0.5),
    ],
)
def test_ratios_have_a_step_where_all_weights_are_multiples(weights, tail, step):
    of_weights = np.array(weights)
    share = of_weights / sum(weights)
    assert build_measure(
        share, np.zeros(len(weights)), tail=tail
    ).step == pytest.approx(step)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"tail": 0.0},
            "tail: got 0.0; expected a share of the samples, 0 < share <= 1",
        ),
        (
            {"tail": 1.5},
            "tail: got 1.5; expected a share of the samples, 0 < share <= 1",
        ),
        (
            {"sample_index": [0]},
            "sample_index: got other samples; expected one, from 0, for each run",
        ),
        (
            {"sample_index": [0, -1]},
            "sample_index: got other samples; expected one, from 0, for each run",
        ),
        (
            {"sample_index": [0, 2]},
            "sample_index: got a sample without weight; expected runs in each sample",
        ),
    ],
)
def test_a_measure_says_what_is_wrong(change, message):
    halves = np.array([0.5, 0.5])
    with refused_with(message):
        build_measure(halves, **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"share": 1.2}, "--target: got 1.2; expected a share of the runs, 0 to 1"),
        ({"share": -0.1}, "--target: got -0.1; expected a share of the runs, 0 to 1"),
        (
            {"n_failures": -1},
            "survive: got -1; expected units that may fail, at least 0",
        ),
    ],
)
def test_a_floor_says_what_is_wrong(change, message):
    values = {"name": "--target", "share": 0.5, **change}
    with refused_with(message):
        Floor(**values)


# ---------- requirements


@given(SEEDS, st.sampled_from([-np.inf, 0.0, 0.25, 0.5]))
def test_a_requirement_counts_runs_that_leave_the_margin(seed, least_s):
    measure, rng = drawn_measure(seed, 1.0)
    margin_s = rng.choice([-np.inf, 0.0, 0.25, 0.5], (4, 8))
    requirement = Requirement(measure=measure, least=0.5, min_margin_s=least_s)
    rows = margin_s.tolist()
    counts = [[m > -np.inf and m >= least_s for m in row] for row in rows]
    is_counted = requirement.counts_run(margin_s)

    assert is_counted.tolist() == counts
    assert requirement.reached(margin_s) == pytest.approx(
        np.array(counts) @ measure.weight
    )

    sums = Requirement(
        measure=measure,
        least=0.5,
        min_margin_s=least_s,
        sums_margins=True,
    )
    expected = [
        sum(w * m for w, m, c in zip(measure.weight, row, count, strict=True) if c)
        for row, count in zip(margin_s, counts, strict=True)
    ]
    reached = sums.reached(margin_s)

    assert reached == pytest.approx(expected)


@given(SEEDS, st.floats(0.0, 1.0))
def test_all_runs_are_needed_where_no_other_set_of_them_is_enough(seed, least):
    measure, _ = drawn_measure(seed, 1.0)
    requirement = Requirement(measure=measure, least=least)
    needs_all = requirement.needs_all
    enough = [
        runs
        for size in range(8)
        for runs in combinations(range(8), size)
        if measure.weight[list(runs)].sum() >= least
    ]
    if needs_all:
        assert not enough

    if least > 1.0 - 1e-9:
        assert needs_all

    with_margins = Requirement(measure=measure, least=least, sums_margins=True)

    assert not with_margins.needs_all


# ---------- the order of values


def test_objectives_stand_in_order_and_the_cost_once():
    for goal in ("best", "fewest", "cheapest"):
        for survive in (0, 2):
            order = objectives_in_order(goal, survive=survive)
            distinct = len(set(order))
            counts_units = order[0] is Objective.UNITS
            costs_first = order[0] is Objective.COST

            assert distinct == len(order)
            assert set(VALUE_OBJECTIVES) <= set(order)
            assert (Objective.APR_SURVIVED in order) == (survive > 0)
            assert counts_units == (goal == "fewest")
            assert costs_first == (goal == "cheapest")


@given(st.sampled_from(Objective), st.integers(-3, 3), st.integers(-3, 3))
def test_less_is_better_of_what_is_minimised(objective, one, other):
    if objective.is_minimised:
        sign = -1
    else:
        sign = 1

    excess = objective.excess(one, other)

    assert excess == sign * (one - other)

    better = objective.better(one, other)
    worse = objective.worse(one, other)
    is_cost = objective == "cost_eur"

    assert sign * better >= sign * worse
    assert {better, worse} == {one, other}
    assert (objective.unit == "EUR") == is_cost
    assert (objective.tolerance == 1e-6) == is_cost


VALUES = st.tuples(*(st.sampled_from([0.0, 5e-10, 0.5, 1.0]) for _ in range(5)))


@given(VALUES, VALUES)
def test_layouts_are_compared_stage_by_stage_beyond_rounding(one, other):
    mine = PlacementValue(*one)
    theirs = PlacementValue(*other)
    signs = (1, 1, 1, 1, -1)
    tolerances = (1e-9, 1e-9, 1e-9, 1e-9, 1e-6)
    expected = False
    for a, b, sign, tolerance in zip(one, other, signs, tolerances, strict=True):
        if abs(a - b) > tolerance:
            expected = sign * (a - b) > 0.0
            break

    is_better_both_ways = is_better(mine, theirs) and is_better(theirs, mine)

    assert is_better(mine, theirs) == expected
    assert not is_better_both_ways
