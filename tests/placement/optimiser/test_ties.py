"""What ties: bounds hold for all layouts within the tie tolerance, however small
weights are.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose
from oracle import TIE, Oracle
from oracle_checks import EVERY_WAY, check
from problems import random_problem
from tiny_worlds import axis_of_runs

from placement.detection_table import pack_table
from placement.optimiser import (
    Effort,
    Limits,
    PlacementProblem,
    presolve,
    solve_placement,
)
from placement.optimiser.bitsets import Contenders, SetValues, set_values
from placement.optimiser.constants import are_sums_apart
from placement.optimiser.problem import Objective, build_measure
from placement.optimiser.proof import Search
from scenarios.aeb import AebRule


def singles(weight, seen_from):
    """One pose is chosen, which sees run r from frame ``seen_from[pose][r]`` of 9 on.

    The first run, which nothing avoids, has the rest of the weight.
    """
    n_runs = 1 + len(weight)
    detected = np.zeros((len(seen_from), n_runs, 9), dtype=bool)
    for pose, frames in enumerate(seen_from):
        for run, frame in enumerate(frames, start=1):
            if frame is not None:
                detected[pose, run, frame:] = True

    axis = axis_of_runs(
        9 * np.arange(n_runs + 1),
        np.tile(np.arange(-8, 1) / 10.0, n_runs),
        0.0,
        weight=[1.0 - sum(weight), *weight],
    )
    n_poses = len(seen_from)
    return PlacementProblem(
        table=pack_table(
            tuple(map(str, range(n_poses))), axis, detected.reshape(n_poses, -1)
        ),
        limits=Limits(
            site_index=np.arange(n_poses),
            site_capacity=np.ones(n_poses, dtype=int),
            budget_units=1,
        ),
        fusion="any",
        rule=AebRule(
            deceleration_mps2=7.72,
            latency_s=0.025,
            n_confirmations=1,
            frame_rate_hz=10.0,
            track_memory_s=np.inf,
        ),
    )


A_TIE_APART = singles([1.6e-8, 5.0e-10], [[2, 7], [2, None]])


@pytest.mark.parametrize("way", EVERY_WAY)
@pytest.mark.parametrize(
    "problem",
    [
        A_TIE_APART,
        # The mean margin is bounded for layouts that avoid a tie less.
        singles([1.6e-8, 9.0e-10, 1.0e-12], [[2, 6, 7], [2, None, 7]]),
        # Each is 0.7 of a tie worse than the one before, with a larger margin: ties do
        # not add up.
        singles(
            [1.6e-8, 7.0e-10, 7.0e-10, 7.0e-10],
            [[5, 5, 5, 5], [4, 4, 4, None], [3, 3, None, None], [2, None, None, None]],
        ),
    ],
    ids=["a tie apart", "margins at a tie", "a chain of ties"],
)
def test_ties_are_answered_as_the_enumeration_says(problem, way):
    check(problem, way)


@pytest.mark.parametrize("solver", ["auto", "exact"])
def test_a_pose_is_not_dropped_for_one_that_avoids_a_run_more_at_a_tie(solver):
    effort = Effort(solver=solver)
    solution = solve_placement(A_TIE_APART, effort=effort)

    assert solution.pose_index == (1,)


@given(st.integers(0, 2**32 - 1))
def test_no_layout_that_ties_exceeds_the_limit_of_the_mean_margin(seed):
    problem = random_problem(default_rng(seed))
    problem = replace(problem, floors=(), goal="best")
    reduced = presolve(problem)
    sets = np.array(list(combinations(range(reduced.n_poses), 1)), dtype=np.int64)
    if not len(sets):
        return

    search = Search(reduced)

    values = set_values(reduced, sets)
    aprs = values.of(Objective.APR)
    means_s = values.of(Objective.MEAN_MARGIN)

    for apr in aprs:
        tied = aprs >= apr - TIE
        assert means_s[tied].max() <= search.mean_margin_limit_s(float(apr)) + TIE


@given(st.lists(st.integers(0, 6), min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_contenders_limit_every_set_that_ties_in_all_stages_before(steps, seed):
    rng = default_rng(seed)
    objectives = (Objective.APR, Objective.MEAN_MARGIN, Objective.COST)
    n_sets = len(steps)
    gains = np.column_stack(
        [
            np.zeros(n_sets),
            0.5 + 0.4e-9 * np.array(steps),
            0.1 * rng.integers(0, 4, n_sets),
            -1.0 * rng.integers(0, 3, n_sets),
        ]
    )
    contenders = Contenders(objectives)
    for row in range(n_sets):
        contenders.add(np.array([[row]]), SetValues(objectives, gains[row : row + 1]))

    best = contenders.best()

    assert best is not None

    row = int(best[0])

    assert gains[row, 1] >= gains[:, 1].max() - TIE

    limits = contenders.limits(SetValues(objectives, gains[row]))
    tied = np.ones(n_sets, dtype=bool)

    for column, objective in enumerate(objectives, start=1):
        most = gains[tied, column].max()
        limit = limits[objective]

        assert (-limit if objective is Objective.COST else limit) == most

        if objective is Objective.COST:
            tolerance = 1.0e-6
        else:
            tolerance = TIE

        tied &= gains[:, column] >= gains[row, column] - tolerance


def test_ties_are_equal_where_weights_are_fractions_or_all_is_avoided():
    fractions = np.array([1 / 3, 1 / 6, 1 / 12, 5 / 12])

    assert build_measure(fractions).least_tied(0.5) == 0.5

    rng = default_rng(1)
    odd = rng.random(20)
    odd /= odd.sum()
    far_apart = np.array([1.0, 1e-300])
    least = build_measure(odd).least_tied(0.5)

    assert not are_sums_apart(odd)
    assert not are_sums_apart(far_apart)  # no zero: sums of such tie
    assert least == pytest.approx(0.5 - 2.0e-9, abs=1e-15)
    assert build_measure(odd).least_tied(1.0) == 1.0

    sampled = build_measure(fractions, [0, 0, 1, 1], tail=0.5)

    assert sampled.least_tied(0.5) < 0.5


@given(st.lists(st.integers(1, 200), min_size=1, max_size=12))
def test_sums_of_fractions_are_apart_unless_their_denominator_is_large(denominators):
    weight = 1.0 / np.array(denominators)
    if are_sums_apart(weight):
        multiple = np.lcm.reduce(denominators)
        common = float(multiple)
        counts = weight * common
        whole = counts.round()

        assert common <= 2.5e8
        assert_allclose(counts, whole, rtol=0.0, atol=1e-6)
    else:
        exact = np.array(denominators, dtype=object)
        multiple = np.lcm.reduce(exact)
        assert float(multiple) > 2.5e8


def test_a_layout_of_the_oracle_is_ambiguous_only_near_a_tie():
    problem_near = singles([1.6e-8, 9.0e-10], [[2, 6], [2, None]])
    near = Oracle(problem_near)
    problem_far = singles([0.2, 0.1], [[2, 6], [2, None]])
    far = Oracle(problem_far)

    assert near.is_ambiguous((0,))
    assert not far.is_ambiguous((0,))
