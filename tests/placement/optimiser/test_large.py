"""The way of large instances, taken on small ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from all_layouts import feasible_layouts
from changes import changed
from hypothesis import given
from oracle import Oracle
from problems import problems, questions, random_problem
from small_tables import avoiding_problem

from placement.optimiser import (
    Effort,
    Floor,
    UnmetError,
    is_feasible,
    placement_value,
    solve_placement,
)
from placement.verification.instances import load_problem

UNMET_LARGE = Path(__file__).parents[4] / "shared/inputs/placement/unmet_large.npz"


@given(problem=problems())
def test_all_poses_are_bounded_by_what_they_promise(problem):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.constants.MAX_BITS", 0)
        effort = Effort(solver="relax")
        solution = solve_placement(problem, effort=effort)

    values = [placement_value(problem, poses) for poses in feasible_layouts(problem)]

    assert is_feasible(problem, solution.pose_index)

    best = max(value.apr for value in values)
    stages = {stage.name: stage for stage in solution.certificate.stages}

    assert stages["apr"].bound >= best - 1e-6

    value = placement_value(problem, solution.pose_index)
    objectives = tuple(stage.objective for stage in stages.values())

    assert objectives == pytest.approx(value)

    as_good = [other for other in values if other.apr >= value.apr - 1e-9]

    for name in ("apr_one_failed", "mean_margin_s"):
        most = max(getattr(other, name) for other in as_good)
        assert stages[name].bound >= most - 1e-6

    assert "relaxation of all" in solution.certificate.solver


def solve_as_large(problem, *, pool, effort):
    """Rows of the layout found among the most promising poses, at first so many."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.constants.MAX_BITS", 0)
        patch.setattr("placement.optimiser.constants.POOL_POSES", pool)
        return solve_placement(problem, effort=effort).pose_index


def test_a_large_table_is_refused_only_where_no_layout_of_all_poses_will_do():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        problem = random_problem(rng)
        layouts = Oracle(problem).layouts
        try:
            effort = Effort(workers=1)
            found = solve_as_large(problem, pool=1, effort=effort)
        except UnmetError:
            assert not layouts, seed
        else:
            assert found in layouts, seed


@given(problem=questions())
def test_a_search_of_a_large_table_proves_nothing_that_is_not_so(problem):
    layouts = Oracle(problem).layouts
    try:
        effort = Effort(solver="greedy")
        found = solve_as_large(problem, pool=2, effort=effort)
    except UnmetError as error:
        is_open = "none was found" in str(error) or "time" in str(error)
        assert is_open or not layouts
        return

    assert found in layouts


def test_the_pool_has_poses_at_a_forced_site_that_gain_little():
    rows = ["11110", "11100", "00000", "00011"]
    problem = avoiding_problem(rows, budget_units=2)
    is_forced_site = [False, False, True, False]
    problem = changed(problem, "limits.is_forced_site", is_forced_site)
    effort = Effort(solver="greedy")
    found = solve_as_large(problem, pool=1, effort=effort)

    assert 2 in found


def test_the_pool_has_poses_that_avoid_what_a_floor_counts():
    rows = ["11110", "11100", "11000", "00001"]
    problem = avoiding_problem(rows, budget_units=2)
    runs = np.arange(5)
    is_last = runs == 4
    last = Floor(name="--min-case-apr", share=1.0, is_counted=is_last)
    problem = replace(problem, floors=(last,))
    effort = Effort(solver="greedy")
    found = solve_as_large(problem, pool=1, effort=effort)

    assert 3 in found


def test_a_demand_that_no_layout_of_the_pool_meets_in_time_is_not_called_unmet():
    """Only three poses together avoid all runs; at first, two at most are looked at."""
    problem = avoiding_problem(["1100", "0010", "0001", "1000"], budget_units=3)
    everything = Floor(name="--target", share=1.0)
    problem = replace(problem, floors=(everything,))
    found = solve_as_large(problem, pool=1, effort=Effort())

    assert found == (0, 1, 2)

    words = "more time than the limit"

    with pytest.raises(UnmetError, match=words):
        solve_as_large(
            problem,
            pool=1,
            effort=Effort(solver="greedy", time_limit_s=1e-9),
        )


@pytest.mark.skipif(not UNMET_LARGE.exists(), reason="the instance is not at hand")
@pytest.mark.parametrize("solver", ["auto", "greedy"])
def test_a_large_table_with_a_forced_site_of_little_gain_is_solved(solver):
    problem = load_problem(UNMET_LARGE)
    effort = Effort(solver=solver)
    found = solve_as_large(problem, pool=4, effort=effort)

    assert is_feasible(problem, found)
