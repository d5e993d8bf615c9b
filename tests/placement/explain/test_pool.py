"""Pools against all sets of small problems, whatever is asked."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from problems import problems, questions

from geometry.errors import InputError
from placement.explain import find_pool
from placement.explain.feasible_sets import presolve_undominated
from placement.optimiser import (
    PlacementProblem,
    apr_failed,
    is_feasible,
    placement_value,
    run_margins_s,
    solve_placement,
)

PROBLEMS = problems()


def rank(problem: PlacementProblem, poses: tuple[int, ...]) -> tuple[float, ...]:
    """What sets are compared by, the larger the better."""
    value = placement_value(problem, poses)
    first: list[float] = []
    if problem.goal != "best":
        first.append(-len(poses) if problem.goal == "fewest" else -value.cost_eur)
    if problem.survive:
        first.append(apr_failed(problem, poses, problem.survive))
    return tuple(round(number, 8) for number in (*first, *value[:-1], -value.cost_eur))


def all_sets(problem: PlacementProblem) -> dict[tuple[int, ...], tuple[float, ...]]:
    """Every feasible set and its rank; a set with units that save nothing is left out."""
    useful = useful_poses(problem)
    return {
        poses: rank(problem, poses)
        for n_units in range(1, problem.limits.max_units + 1)
        for poses in combinations(useful, n_units)
        if is_feasible(problem, poses)
    }


def useful_poses(problem: PlacementProblem) -> list[int]:
    """Poses that are left where no limit makes any pose dominated."""
    return presolve_undominated(problem).pose_index.tolist()


def within(sets):
    best = max(values[0] for values in sets.values())
    return {poses for poses, values in sets.items() if values[0] >= best - 1e-9 * abs(best) - 1e-9}


def check_complete(problem, n_sets):
    try:
        solution = solve_placement(problem)
    except InputError:
        assume(False)
    pool = find_pool(problem, solution.pose_index, n_sets=n_sets)
    assert pool.scope == "all"
    assert pool.stage == solution.certificate.stages[0].name
    sets = all_sets(problem)
    assume(len(sets) > 0)  # nothing saves anything: the one cheapest unit stands for all
    expected = within(sets)
    assert pool.n_within == len(expected)
    listed = [entry.pose_index for entry in pool.sets]
    assert len(set(listed)) == len(listed) == min(n_sets, len(expected))
    assert set(listed) <= expected
    ranks = np.array([sets[poses] for poses in listed])
    best = np.array(sorted((sets[poses] for poses in expected), reverse=True)[: len(listed)])
    np.testing.assert_allclose(ranks, best, atol=1e-7)
    signs = 1.0 if problem.goal == "best" else -1.0
    np.testing.assert_allclose([e.objective for e in pool.sets], signs * ranks[:, 0], atol=1e-9)
    for pose in range(problem.table.n_poses):
        share = sum(pose in poses for poses in expected) / len(expected)
        assert pool.pose_share[pose] == pytest.approx(share)
    for site in range(problem.limits.n_sites):
        at_site = set(np.flatnonzero(problem.limits.site_index == site).tolist())
        share = sum(not at_site.isdisjoint(poses) for poses in expected) / len(expected)
        assert pool.site_share[site] == pytest.approx(share)


@given(problem=questions(), data=st.data())
def test_poses_that_are_left_out_change_no_run(problem, data):
    assume(not (problem.limits.is_forced & problem.limits.is_forbidden).any())
    limits = problem.limits
    usable = ~limits.is_forbidden & (limits.site_capacity[limits.site_index] > 0)
    counts = problem.table.axis.weight > 0.0
    poses = np.flatnonzero(usable).tolist()
    others = [pose for pose in poses if data.draw(st.booleans())]
    before = run_margins_s(problem, others)[counts]
    for pose in set(poses) - set(useful_poses(problem)):
        assert (run_margins_s(problem, [*others, pose])[counts] == before).all()


@given(problem=PROBLEMS, n_sets=st.sampled_from([1, 5, 1000]))
def test_the_pool_is_complete_where_all_sets_are_gone_through(problem, n_sets):
    check_complete(problem, n_sets)


@given(problem=questions())
def test_the_pool_answers_every_question(problem):
    check_complete(problem, 6)


@given(problem=questions())
def test_what_exchanges_find_is_as_good_and_in_order(problem):
    try:
        solution = solve_placement(problem)
    except InputError:
        assume(False)
    pool = find_pool(problem, solution.pose_index, n_sets=6, max_prefixes=0, max_looks=50)
    assert pool.scope == "found"
    sets = all_sets(problem)
    assume(len(sets) > 0)
    listed = [entry.pose_index for entry in pool.sets]
    assert set(listed) <= within(sets)
    assert len(set(listed)) == len(listed) == pool.n_within
    ranks = [sets[poses] for poses in listed]
    assert ranks[0] == pytest.approx(max(sets.values()), abs=1e-7)
    assert ranks == sorted(ranks, reverse=True)
    for pose in range(problem.table.n_poses):
        share = sum(pose in poses for poses in listed) / len(listed)
        assert pool.pose_share[pose] == pytest.approx(share)


@given(problem=PROBLEMS, data=st.data())
def test_a_poor_start_is_left_behind(problem, data):
    sets = all_sets(problem)
    assume(len(sets) > 0)
    start = data.draw(st.sampled_from(sorted(sets)))
    pool = find_pool(problem, start, n_sets=3)
    assert sets[pool.sets[0].pose_index] == pytest.approx(max(sets.values()), abs=1e-7)


@given(problem=PROBLEMS)
@settings(max_examples=5)
def test_what_cannot_be_asked_is_said(problem):
    poses = solve_placement(problem).pose_index
    with pytest.raises(InputError, match=r"pool: got 0; expected a number of layouts"):
        find_pool(problem, poses, n_sets=0)
    with pytest.raises(InputError, match=r"pose_index: got \[0, 0\]; expected a set that meets"):
        find_pool(problem, [0, 0])
