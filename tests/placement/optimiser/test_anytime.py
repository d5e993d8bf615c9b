"""What is answered when the time is over, and what is computed once for several
answers.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import problems, questions
from small_tables import avoiding_problem

from geometry.arrays import IntArray
from geometry.clock import now_s
from geometry.errors import InputError
from placement.optimiser import (
    Effort,
    Floor,
    PlacementProblem,
    apr,
    apr_failed,
    is_feasible,
    placement_value,
    presolve,
    solve,
    solve_placement,
    solve_sturdily,
    sturdy_problem,
)
from placement.optimiser.allowed_sets import are_allowed, is_allowed
from placement.optimiser.bitsets import (
    left_after_failures,
    set_values,
    union_apr,
    unions_of,
    values_with_each,
)
from placement.optimiser.bounds import failure_limit, find_root, relax, run_rows
from placement.optimiser.constants import NEVER, Deadline, deadline_in
from placement.optimiser.cost_front import cost_front
from placement.optimiser.front import pareto_front
from placement.optimiser.greedy import extend_greedily, forced_units, improve
from placement.optimiser.pairs import PairWalk
from placement.optimiser.presolve import ReducedProblem
from placement.optimiser.problem import Objective
from placement.optimiser.proof import Search
from placement.optimiser.walk import SetWalk, best_of_few, can_walk

ANY_PROBLEM = st.from_type(PlacementProblem)
OVER = Deadline(-np.inf)


def full_sets(reduced: ReducedProblem) -> IntArray:
    """Allowed sets of as many units as there may be."""
    n_units = min(reduced.limits.max_units, reduced.n_poses)
    sets = np.array(list(combinations(range(reduced.n_poses), n_units)), dtype=np.int64)
    sets = sets.reshape(-1, n_units)
    return sets[are_allowed(reduced.limits, sets)]


# ---------- the time is over


@given(problem=questions())
def test_a_search_whose_time_is_over_has_a_set_and_knows_no_bound(
    problem: PlacementProblem,
) -> None:
    reduced = presolve(problem)
    search = Search(reduced, deadline=OVER)
    search.start()
    greedy = extend_greedily(reduced, forced_units(reduced))
    assert (search.units is not None) == is_allowed(reduced.limits, greedy)
    assert search.look_for(Objective.APR, ()) == np.inf
    assert search.look_for(Objective.COST, ()) == -np.inf
    assert not search.proofs  # no solver was asked
    assert not search.nothing_meets_all


@given(problem=ANY_PROBLEM)
def test_walks_whose_time_is_over_meet_nothing_and_do_not_finish(
    problem: PlacementProblem,
) -> None:
    reduced = presolve(problem)
    n_units = reduced.limits.max_units
    if not can_walk(reduced):
        return
    root = find_root(reduced, run_rows(reduced), n_units=n_units)
    walks = [SetWalk(reduced, root, need=0.0)]
    if n_units in (2, 3):
        walks += [PairWalk(reduced, need=0.0)]
    else:
        walks += []
    for walk in walks:
        assert sum(len(block) for block in walk.blocks(OVER)) == 0
        assert not walk.is_finished
    for walk in walks:
        assert sum(len(block) for block in walk.blocks(NEVER)) >= len(
            full_sets(reduced)
        )
        assert walk.is_finished


@given(problem=questions(), max_sets=st.sampled_from([0, 3, 10_000]))
def test_few_sets_are_gone_through_only_while_there_is_time(
    problem: PlacementProblem, max_sets: int
) -> None:
    reduced = presolve(problem)
    contenders, is_finished = best_of_few(reduced, max_sets=max_sets, deadline=OVER)
    n_sets = sum(
        is_allowed(reduced.limits, units)
        for size in range(1, reduced.n_poses + 1)
        for units in combinations(range(reduced.n_poses), size)
    )
    assert contenders is None or contenders.best() is None
    assert not is_finished or n_sets == 0
    contenders, is_finished = best_of_few(reduced, max_sets=max_sets)
    assert is_finished == (n_sets <= max_sets)
    has_best = contenders is not None and contenders.best() is not None
    assert has_best == (is_finished and n_sets > 0)


@given(problem=ANY_PROBLEM, n_failures=st.integers(0, 2))
def test_bounds_of_a_first_round_hold(
    problem: PlacementProblem, n_failures: int
) -> None:
    reduced = presolve(problem)
    sets = full_sets(reduced)
    if not len(reduced.weight) or not len(sets):
        return
    n_units = reduced.limits.max_units
    root = find_root(reduced, run_rows(reduced), n_units=n_units, deadline=OVER)
    best = union_apr(reduced, unions_of(reduced, sets)).max()
    assert root.limit >= best - 1e-9
    assert failure_limit(root, n_failures, 0.0, deadline=OVER) == root.limit
    left = left_after_failures(reduced, reduced.measure, n_failures, sets).max()
    assert failure_limit(root, n_failures, 0.0) >= left - 1e-9
    assert relax(reduced, Objective.APR, deadline=OVER)[0] >= best - 1e-9


@given(problem=questions())
def test_nothing_is_exchanged_when_the_time_is_over(problem: PlacementProblem) -> None:
    reduced = presolve(problem)
    units = extend_greedily(reduced, forced_units(reduced))
    if len(units):
        late = improve(reduced, units, Search(reduced).limit, deadline=OVER)
        assert late is units
        better = improve(reduced, units, Search(reduced).limit)
        before = set_values(reduced, units[None, :])
        after = set_values(reduced, better[None, :])
        assert not before[0].exceeds(after[0])


def test_an_effort_ends_with_its_deadline_but_never_before_it_begins() -> None:
    effort = Effort(solver="relax", time_limit_s=60.0, workers=1)
    late = effort.until(deadline_in(7.0))
    assert late.time_limit_s == pytest.approx(7.0, abs=1.0)
    assert replace(late, time_limit_s=60.0) == effort  # all else stays
    assert 0.0 < effort.until(OVER).time_limit_s < 0.1
    assert (
        effort.until(Deadline(now_s() + 1e9)).time_limit_s > 60.0
    )  # the deadline decides


@given(problem=questions(), seconds=st.sampled_from([1e-9, 1e-2]))
def test_an_answer_that_is_late_keeps_all_limits_and_bounds(
    problem: PlacementProblem, seconds: float
) -> None:
    problem = replace(problem, goal="best", survive=0, floors=())
    try:
        solution = solve_placement(problem, effort=Effort(time_limit_s=seconds))
    except InputError:
        return
    assert is_feasible(problem, solution.pose_index)
    value = placement_value(problem, solution.pose_index)
    stage = solution.certificate.stages[0]
    poses = range(problem.table.n_poses)
    sets = [one for size in (1, 2, 3) for one in combinations(poses, size)]
    best = max(apr(problem, one) for one in sets if is_feasible(problem, one))
    assert stage.objective == pytest.approx(value.apr)
    assert value.apr - 1e-9 <= best <= stage.bound + 1e-9


# ---------- presolved once


def count_presolves(patch: pytest.MonkeyPatch) -> list[int]:
    """Appended to with every problem that is presolved."""
    calls: list[int] = []
    before = solve.presolve

    def counted(problem: PlacementProblem, **options: object) -> ReducedProblem:
        calls.append(problem.survive)
        return before(problem, **options)  # type: ignore[arg-type]

    for module in ("solve", "front", "cost_front"):
        patch.setattr(f"placement.optimiser.{module}.presolve", counted)
    return calls


@given(
    problem=problems(), give_up=st.sampled_from([0.05, 0.4]), has_reduced=st.booleans()
)
def test_the_second_layout_is_found_on_what_the_first_was_presolved_to(
    problem: PlacementProblem, give_up: float, has_reduced: bool
) -> None:
    if has_reduced:
        reduced = presolve(problem)
    else:
        reduced = None
    with pytest.MonkeyPatch.context() as patch:
        calls = count_presolves(patch)
        highest, sturdy = solve_sturdily(
            problem, reduced, give_up=give_up, effort=Effort()
        )
    assert len(calls) == (0 if has_reduced else 1)
    if sturdy is None:
        assert len(highest.pose_index) < 2 or problem.limits.max_units < 2
        return
    asked = sturdy_problem(problem, highest, give_up)
    alone = solve_placement(asked, starts=[np.array(highest.pose_index)])
    assert [stage.objective for stage in sturdy.certificate.stages] == pytest.approx(
        [stage.objective for stage in alone.certificate.stages], abs=1e-9
    )
    assert sturdy.certificate.is_proven
    assert sturdy.presolve == alone.presolve == highest.presolve
    poses = range(problem.table.n_poses)  # and that is the most that any layout keeps
    kept = [
        apr_failed(asked, one, 1)
        for size in (1, 2, 3)
        for one in combinations(poses, size)
        if is_feasible(asked, one)
    ]
    assert apr_failed(asked, sturdy.pose_index, 1) == pytest.approx(max(kept))


def test_limits_that_cannot_be_met_are_told_before_anything_is_presolved() -> None:
    problem = avoiding_problem(["10", "01"], budget_units=2)
    none = replace(problem.limits, is_forbidden=[True, True])
    with pytest.MonkeyPatch.context() as patch:
        calls = count_presolves(patch)
        with pytest.raises(InputError, match="candidates: got none that may be used"):
            solve_sturdily(
                replace(problem, limits=replace(none, budget_units=2)),
                give_up=0.1,
                effort=Effort(),
            )
    assert not calls


@given(
    problem=problems(),
    share=st.sampled_from([0.0, 0.5, 1.0]),
    goal=st.sampled_from(["best", "fewest", "cheapest"]),
    n_failures=st.integers(0, 2),
)
def test_a_presolved_problem_for_other_floors_is_what_presolving_gives(
    problem: PlacementProblem, share: float, goal: str, n_failures: int
) -> None:
    floor = Floor(name="--target", share=share, n_failures=n_failures)
    counted = Floor(
        name="--case", share=share, is_counted=problem.table.axis.weight > 0.0
    )
    other = replace(problem, floors=(floor, counted), goal=goal, survive=n_failures)
    again = presolve(problem).for_problem(other)
    anew = presolve(other)
    for name in (
        "pose_index",
        "run_index",
        "words",
        "columns",
        "base",
        "run_chain",
        "margin_s",
    ):
        np.testing.assert_array_equal(getattr(again, name), getattr(anew, name))
    for one, same in zip(again.chains, anew.chains, strict=True):
        np.testing.assert_array_equal(one, same)
    assert (again.objectives, again.survive) == (anew.objectives, anew.survive)
    assert again.statistics == anew.statistics
    for mine, theirs in zip(again.floors, anew.floors, strict=True):
        assert (mine.least, mine.n_failures) == (theirs.least, theirs.n_failures)
        np.testing.assert_array_equal(mine.measure.weight, theirs.measure.weight)
    if again.n_poses:
        units = np.arange(1)
        np.testing.assert_array_equal(
            values_with_each(again, units).gains, values_with_each(anew, units).gains
        )


@given(problem=problems(), budget=st.integers(1, 3))
def test_fewer_units_on_a_presolved_problem_are_solved_as_well_as_alone(
    problem: PlacementProblem, budget: int
) -> None:
    fewer = replace(problem, limits=replace(problem.limits, budget_units=budget))
    if budget > problem.limits.max_units:
        return
    reduced = presolve(problem).for_problem(fewer)
    mine = solve_placement(fewer, reduced)
    alone = solve_placement(fewer)
    assert placement_value(fewer, mine.pose_index) == pytest.approx(
        placement_value(fewer, alone.pose_index), abs=1e-9
    )
    assert mine.certificate.is_proven


Solve = Callable[[PlacementProblem], object]


@pytest.mark.parametrize(
    "front",
    [lambda p: pareto_front(p, max_units=2), lambda p: cost_front(p, max_points=3)],
)
def test_a_front_is_presolved_once_and_none_of_its_points(front: Solve) -> None:
    problem = avoiding_problem(
        ["1100", "0011", "0110", "1000"], price_eur=[3.0, 2.0, 4.0, 1.0]
    )
    with pytest.MonkeyPatch.context() as patch:
        calls = count_presolves(patch)
        front(problem)
    assert len(calls) == 1
