"""First sets: greedy choice, swaps, and searches from many starts, against all sets."""

from dataclasses import replace
from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from problems import questions
from small_tables import avoiding_problem

from placement.optimiser import Floor, presolve, solve_greedy, solve_placement
from placement.optimiser.allowed_sets import is_allowed
from placement.optimiser.bitsets import set_values
from placement.optimiser.constants import Deadline
from placement.optimiser.greedy import (
    extend_greedily,
    forced_units,
    improve,
    search_from_many_starts,
)
from placement.optimiser.proof import Search

OVER = Deadline(-np.inf)


@given(problem=questions())
def test_greedy_choice_adds_the_pose_that_makes_the_best_set(problem):
    for_the_best = replace(problem, floors=(), goal="best")
    reduced = presolve(for_the_best)
    units = forced_units(reduced)
    if reduced.n_poses <= len(units) or reduced.limits.max_units <= len(units):
        return

    one_more = replace(reduced.limits, budget_units=len(units) + 1)
    larger = replace(reduced, limits=one_more)
    extended = extend_greedily(larger, units)
    if len(extended) == len(units):
        return

    values = set_values(reduced, extended[None, :])
    value = values[0]
    every_pose = np.arange(reduced.n_poses)
    for pose in np.setdiff1d(every_pose, units):
        trial = np.append(units, pose)
        if is_allowed(reduced.limits, trial) and is_allowed(reduced.limits, extended):
            trial_value = set_values(reduced, trial[None, :])[0]
            assert not trial_value.exceeds(value)


@given(problem=questions(), seed=st.integers(0, 99))
def test_no_exchange_and_no_removal_improves_an_improved_set(problem, seed):
    reduced = presolve(problem)
    units = extend_greedily(reduced, forced_units(reduced))
    if not is_allowed(reduced.limits, units):
        return

    values_before = set_values(reduced, units[None, :])
    before = values_before[0]
    better = improve(reduced, units, Search(reduced).limit)

    values_after = set_values(reduced, better[None, :])
    value = values_after[0]

    assert not before.exceeds(value)
    assert is_allowed(reduced.limits, better)

    late = improve(
        reduced,
        units,
        Search(reduced).limit,
        deadline=OVER,
    )

    assert late is units

    if not Search(reduced).limit.exceeds(value):
        return

    is_forced = reduced.limits.is_forced[better]
    free = better[~is_forced]

    for unit in free:
        rest = better[better != unit]
        others = [rest, *(np.append(rest, pose) for pose in range(reduced.n_poses))]
        for trial in others:
            if is_allowed(reduced.limits, trial):
                trial_value = set_values(reduced, trial[None, :])[0]
                assert not trial_value.exceeds(value)


@given(problem=questions())
def test_a_search_is_never_worse_than_its_starts_and_greedy_choice(problem):
    reduced = presolve(problem)
    limit = Search(reduced).limit
    starts = [
        np.array(poses)
        for poses in combinations(range(reduced.n_poses), 1)
        if is_allowed(reduced.limits, np.array(poses))
    ]
    found = search_from_many_starts(reduced, limit, starts=starts[:1])
    greedy = extend_greedily(reduced, forced_units(reduced))
    if found is None:
        assert not is_allowed(reduced.limits, greedy)
        return

    assert is_allowed(reduced.limits, found)

    values = set_values(reduced, found[None, :])
    value = values[0]
    for units in [*starts[:1], greedy]:
        if is_allowed(reduced.limits, units):
            start_value = set_values(reduced, units[None, :])[0]
            assert not start_value.exceeds(value)


@given(problem=questions())
def test_the_first_start_is_completed_when_the_time_is_up(problem):
    reduced = presolve(problem)
    greedy = extend_greedily(reduced, forced_units(reduced))
    late = search_from_many_starts(reduced, Search(reduced).limit, deadline=OVER)
    if is_allowed(reduced.limits, greedy):
        assert late is not None
        assert sorted(late) == sorted(greedy)
    else:
        assert late is None


def test_greedy_choice_has_a_unit_where_a_target_needs_none():
    none_asked = Floor(name="target", share=0.0)
    problem = avoiding_problem(["100", "011"], budget_units=2)
    few = replace(problem, goal="fewest", floors=(none_asked,))

    assert solve_greedy(few) == (1,)
    assert solve_placement(few).pose_index == (1,)


def test_greedy_search_gives_rows_of_the_table_in_order():
    problem = avoiding_problem(["110", "011", "100"], budget_units=2)

    assert solve_greedy(problem) == (0, 1)
    assert solve_greedy(problem, presolve(problem)) == (0, 1)
