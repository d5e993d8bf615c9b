"""Lagrangian bounds against all sets, on small tables."""

from dataclasses import replace

import numpy as np
import pytest
from all_layouts import allowed_sets
from hypothesis import given
from hypothesis import strategies as st
from problems import problems, questions
from small_tables import avoiding_problem

from placement.optimiser import presolve
from placement.optimiser.allowed_sets import build_choice
from placement.optimiser.bitsets import (
    left_after_failures,
    union_apr,
    union_margins_s,
    unions_of,
)
from placement.optimiser.bounds import (
    coverers_of,
    failure_limit,
    find_root,
    is_covered_by,
    polished,
    relax,
    reward_of,
    rounded_down,
    run_rows,
    tightened,
)
from placement.optimiser.presolve import unpack_words
from placement.optimiser.problem import Objective


def sets_by_size(reduced):
    """Allowed sets of each size that has any."""
    sizes = range(1, reduced.limits.max_units + 1)
    sets = [allowed_sets(reduced, size) for size in sizes]
    return [of_size for of_size in sets if len(of_size)]


def margin_sums(reduced, sets):
    """Weights times margins of avoided runs, (n_sets,)."""
    unions = unions_of(reduced, sets)
    margin = union_margins_s(reduced, unions)
    counted_s = np.where(margin > -np.inf, margin, 0.0)
    total = counted_s @ reduced.weight
    return total


@given(problem=questions(), is_polished=st.booleans())
def test_no_allowed_set_exceeds_the_bound_of_the_apr(problem, is_polished):
    best_alone = replace(problem, floors=(), goal="best", tail=1.0)
    reduced = presolve(best_alone)
    sizes = sets_by_size(reduced)
    if not len(reduced.weight) or not sizes:
        return

    root = find_root(reduced, run_rows(reduced), n_units=reduced.limits.max_units)
    if is_polished:
        root = polished(root)

    for sets in sizes:
        unions = unions_of(reduced, sets)
        reached = union_apr(reduced, unions)
        assert reached.max() <= root.limit + 1e-9


@given(problem=questions())
def test_no_allowed_set_exceeds_what_is_relaxed(problem):
    best_alone = replace(problem, floors=(), goal="best")
    reduced = presolve(best_alone)
    sizes = sets_by_size(reduced)
    apr, _ = relax(reduced, Objective.APR)
    total_s, _ = relax(reduced, Objective.MEAN_MARGIN)
    for sets in sizes:
        if len(reduced.weight):
            unions = unions_of(reduced, sets)
            reached = union_apr(reduced, unions)
            sums_s = margin_sums(reduced, sets)
            assert reached.max() <= apr + 1e-9
            assert sums_s.max() <= total_s + 1e-9


@given(problem=problems())
def test_polishing_never_raises_a_bound(problem):
    reduced = presolve(problem)
    if not len(reduced.weight):
        return

    root = find_root(reduced, run_rows(reduced), n_units=reduced.limits.max_units)

    better = polished(root)

    assert better.limit <= root.limit

    reward = reward_of(better.choice.n_units, 0)
    again = tightened(better, reward, n_steps=0)

    assert again.limit == pytest.approx(better.limit, rel=1e-8)  # the prices prove it


@given(problem=problems(), n_failures=st.integers(1, 2))
def test_no_set_keeps_more_than_the_bound_when_units_fail(problem, n_failures):
    reduced = presolve(problem)
    sizes = sets_by_size(reduced)
    n_units = reduced.limits.max_units
    if not len(reduced.weight) or not sizes or sizes[-1].shape[1] < n_units:
        return

    root = find_root(reduced, run_rows(reduced), n_units=n_units)
    unions = unions_of(reduced, sizes[-1])
    share = union_apr(reduced, unions)

    left = left_after_failures(
        reduced,
        reduced.measure,
        n_failures,
        sizes[-1],
    )

    for least in np.unique(share):
        left_of_good = left[share >= least - 1e-9]
        most_left = left_of_good.max()
        most_possible = failure_limit(root, n_failures, least)

        assert most_left <= most_possible + 1e-9


@given(problem=problems(), seed=st.integers(0, 99))
def test_who_avoids_a_run_beside_a_set_covers_it_whatever_is_asked_for(problem, seed):
    reduced = presolve(problem)
    if not len(reduced.weight):
        return

    rng = np.random.default_rng(seed)
    rows = run_rows(reduced)
    drawn = rng.integers(reduced.n_poses)
    first = int(drawn)
    union = reduced.words[first]
    seen = rng.random(reduced.n_frames)

    words = coverers_of(reduced, rows, union, seen)
    covers = unpack_words(words, reduced.n_poses)

    for pose in range(reduced.n_poses):
        joined = union | reduced.words[pose]
        is_avoided = is_covered_by(reduced, joined, rows)
        is_not_covered = is_avoided & ~covers[:, pose]

        assert not is_not_covered.any()

    is_alone = is_covered_by(reduced, union, rows)

    assert covers[is_alone].all()  # nothing is asked for


def test_what_forced_units_take_is_not_there_for_others():
    problem = avoiding_problem(
        ["100", "010", "001"], price_eur=[2.0, 3.0, 5.0], budget_units=2
    )
    limits = replace(
        problem.limits,
        site_capacity=[1, 2, 1],
        site_cost_eur=[1.0, 1.0, 1.0],
        budget_eur=10.0,
        is_forced=[True, False, False],
    )

    choice = build_choice(limits, 2)
    left_eur = 10.0 - 2.0 - 1.0
    own_share_eur = 1.0 / 2.0  # of a site that carries two

    assert choice.cost[1] == pytest.approx((3.0 + own_share_eur) / left_eur)


@pytest.mark.parametrize(
    ("n_units", "n_failures", "expected"),
    [
        (3, 0, [0.0, 1.0, 1.0, 1.0, 1.0]),
        (3, 1, [0.0, 2 / 3, 1.0, 1.0, 1.0]),
    ],
)
def test_a_row_is_worth_the_share_of_failures_that_leave_a_unit(
    n_units, n_failures, expected
):
    reward = reward_of(n_units, n_failures)
    assert reward == pytest.approx(expected)


@given(problem=problems(), place=st.floats(0.0, 1.0))
def test_a_bound_is_rounded_down_to_whole_runs_only_where_all_weigh_the_same(
    problem, place
):
    reduced = presolve(problem)
    if not len(reduced.weight):
        return

    step = reduced.measure.step
    limit = place * reduced.measure.limit

    rounded = rounded_down(reduced, limit)

    assert rounded <= limit + 1e-5

    if step:
        expected = round(rounded / step)
        assert rounded / step == pytest.approx(expected, abs=1e-6)
    else:
        assert rounded == limit
