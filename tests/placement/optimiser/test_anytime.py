"""What is answered when the time is over, and what is computed once for several
answers.
"""

from dataclasses import replace

import numpy as np
import pytest
from all_layouts import allowed_sets, feasible_layouts
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from problems import problems, questions
from small_tables import avoiding_problem

from geometry.clock import now_s
from geometry.errors import InputError
from placement.optimiser import (
    Effort,
    Floor,
    apr_failed,
    presolve,
    solve,
    solve_placement,
    solve_sturdily,
    sturdy_problem,
)
from placement.optimiser.allowed_sets import is_allowed
from placement.optimiser.bitsets import (
    left_after_failures,
    union_apr,
    unions_of,
    values_with_each,
)
from placement.optimiser.bounds import failure_limit, find_root, relax, run_rows
from placement.optimiser.constants import Deadline, deadline_in
from placement.optimiser.cost_front import cost_front
from placement.optimiser.front import pareto_front
from placement.optimiser.greedy import extend_greedily, forced_units
from placement.optimiser.problem import Objective
from placement.optimiser.proof import Search
from placement.optimiser.walk import best_of_few

OVER = Deadline(-np.inf)


def full_sets(reduced):
    """Allowed sets of as many units as there may be."""
    return allowed_sets(reduced, min(reduced.limits.max_units, reduced.n_poses))


# ---------- the time is over


@given(problem=questions())
def test_a_search_whose_time_is_over_has_a_set_and_knows_no_bound(problem):
    reduced = presolve(problem)
    search = Search(reduced, deadline=OVER)
    search.start()

    greedy = extend_greedily(reduced, forced_units(reduced))
    expected = is_allowed(reduced.limits, greedy)

    assert (search.units is not None) == expected
    assert search.look_for(Objective.APR, ()) == np.inf
    assert search.look_for(Objective.COST, ()) == -np.inf
    assert not search.proofs  # no solver was asked
    assert not search.nothing_meets_all


@given(problem=questions(), max_sets=st.sampled_from([0, 3, 10_000]))
def test_few_sets_are_gone_through_only_while_there_is_time(problem, max_sets):
    reduced = presolve(problem)

    contenders, is_finished = best_of_few(reduced, max_sets=max_sets, deadline=OVER)
    sizes = range(1, reduced.n_poses + 1)
    n_sets = sum(len(allowed_sets(reduced, size)) for size in sizes)

    assert contenders is None or contenders.best() is None
    assert not is_finished or n_sets == 0

    contenders, is_finished = best_of_few(reduced, max_sets=max_sets)

    assert is_finished == (n_sets <= max_sets)

    has_best = contenders is not None and contenders.best() is not None

    assert has_best == (is_finished and n_sets > 0)


@given(problem=problems(), n_failures=st.integers(0, 2))
def test_bounds_of_a_first_round_hold(problem, n_failures):
    reduced = presolve(problem)
    sets = full_sets(reduced)
    if not len(reduced.weight) or not len(sets):
        return

    n_units = reduced.limits.max_units

    root = find_root(
        reduced,
        run_rows(reduced),
        n_units=n_units,
        deadline=OVER,
    )

    best = union_apr(reduced, unions_of(reduced, sets)).max()

    assert root.limit >= best - 1e-9
    assert failure_limit(root, n_failures, 0.0, deadline=OVER) == root.limit

    left = left_after_failures(reduced, reduced.measure, n_failures, sets).max()

    assert failure_limit(root, n_failures, 0.0) >= left - 1e-9
    assert relax(reduced, Objective.APR, deadline=OVER)[0] >= best - 1e-9


def test_an_effort_ends_with_its_deadline_but_never_before_it_begins():
    effort = Effort(solver="relax", time_limit_s=60.0, workers=1)

    late = effort.until(deadline_in(7.0))

    assert late.time_limit_s == pytest.approx(7.0, abs=1.0)
    assert replace(late, time_limit_s=60.0) == effort  # all else stays
    assert 0.0 < effort.until(OVER).time_limit_s < 0.1
    # The deadline decides.
    assert effort.until(Deadline(now_s() + 1e9)).time_limit_s > 60.0


# ---------- presolved once


def count_presolves(patch):
    """Appended to with every problem that is presolved."""
    calls = []
    before = solve.presolve

    def counted(problem, **options):
        calls.append(problem.survive)
        return before(problem, **options)

    for module in ("solve", "front", "cost_front"):
        patch.setattr(f"placement.optimiser.{module}.presolve", counted)

    return calls


@given(
    problem=problems(),
    give_up=st.sampled_from([0.05, 0.4]),
    has_reduced=st.booleans(),
)
def test_the_second_layout_is_found_on_what_the_first_was_presolved_to(
    problem, give_up, has_reduced
):
    if has_reduced:
        reduced = presolve(problem)
    else:
        reduced = None

    with pytest.MonkeyPatch.context() as patch:
        calls = count_presolves(patch)
        highest, sturdy = solve_sturdily(
            problem,
            reduced,
            give_up=give_up,
            effort=Effort(),
        )

    assert len(calls) == (0 if has_reduced else 1)

    if sturdy is None:
        assert len(highest.pose_index) < 2 or problem.limits.max_units < 2
        return

    asked = sturdy_problem(problem, highest, give_up)

    alone = solve_placement(asked, starts=[np.array(highest.pose_index)])

    expected = [stage.objective for stage in alone.certificate.stages]

    assert [stage.objective for stage in sturdy.certificate.stages] == pytest.approx(
        expected, abs=1e-9
    )
    assert sturdy.certificate.is_proven
    assert sturdy.presolve == alone.presolve == highest.presolve

    # And that is the most that any layout keeps.
    kept = [apr_failed(asked, layout, 1) for layout in feasible_layouts(asked)]

    assert apr_failed(asked, sturdy.pose_index, 1) == pytest.approx(max(kept))


def test_limits_that_cannot_be_met_are_told_before_anything_is_presolved():
    problem = avoiding_problem(["10", "01"], budget_units=2)
    none = replace(problem.limits, is_forbidden=[True, True])
    with pytest.MonkeyPatch.context() as patch:
        calls = count_presolves(patch)
        limits = replace(none, budget_units=2)
        with pytest.raises(InputError, match="candidates: got none that may be used"):
            solve_sturdily(
                replace(problem, limits=limits),
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
    problem, share, goal, n_failures
):
    floor = Floor(name="--target", share=share, n_failures=n_failures)
    counted = Floor(
        name="--case",
        share=share,
        is_counted=problem.table.axis.weight > 0.0,
    )
    other = replace(
        problem,
        floors=(floor, counted),
        goal=goal,
        survive=n_failures,
    )

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
        expected = getattr(anew, name)
        assert_array_equal(getattr(again, name), expected)

    for one, same in zip(again.chains, anew.chains, strict=True):
        assert_array_equal(one, same)

    assert again.objectives == anew.objectives
    assert again.survive == anew.survive
    assert again.statistics == anew.statistics

    for mine, theirs in zip(again.floors, anew.floors, strict=True):
        assert mine.least == theirs.least
        assert mine.n_failures == theirs.n_failures
        assert_array_equal(mine.measure.weight, theirs.measure.weight)

    if again.n_poses:
        units = np.arange(1)
        assert_array_equal(
            values_with_each(again, units).gains, values_with_each(anew, units).gains
        )


@pytest.mark.parametrize(
    "front",
    [lambda p: pareto_front(p, max_units=2), lambda p: cost_front(p, max_points=3)],
)
def test_a_front_is_presolved_once_and_none_of_its_points(front):
    problem = avoiding_problem(
        ["1100", "0011", "0110", "1000"], price_eur=[3.0, 2.0, 4.0, 1.0]
    )
    with pytest.MonkeyPatch.context() as patch:
        calls = count_presolves(patch)
        front(problem)

    assert len(calls) == 1
