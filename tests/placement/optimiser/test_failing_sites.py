"""Poles that fail with all their units, beside units that fail one by one: by brute
force.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from all_layouts import feasible_layouts, sets_of_size
from hypothesis import given
from hypothesis import strategies as st
from problems import problems

from placement.optimiser import (
    Effort,
    apr,
    apr_failed,
    placement_value,
    presolve,
    solve_placement,
)
from placement.optimiser.bitsets import left_after_failures
from placement.verification.recomputation import stage_values

SIZES = (1, 2, 3)


def left(problem, poses, n_failures):
    """What is left when the worst sites fail: the definition, written down."""
    site = problem.limits.site_index
    used = sorted({int(site[pose]) for pose in poses})
    n_failures = min(n_failures, len(used))  # then the VUT is left, if it sees
    return min(
        apr(problem, [pose for pose in poses if site[pose] not in failed])
        for failed in combinations(used, n_failures)
    )


def where_sites_fail(problem, survive=0):
    """The problem in which whole sites fail."""
    limits = replace(problem.limits, failing="site")
    return replace(
        problem,
        limits=limits,
        survive=survive,
        floors=(),
        goal="best",
    )


@given(problem=problems(), n_failures=st.integers(0, 3))
def test_what_is_left_is_what_stands_on_the_other_poles(problem, n_failures):
    problem = where_sites_fail(problem)
    reduced = presolve(problem)
    for size in SIZES:
        for poses in combinations(range(problem.table.n_poses), size):
            wanted = left(problem, poses, n_failures)
            assert apr_failed(problem, list(poses), n_failures) == pytest.approx(wanted)
        sets = sets_of_size(reduced.n_poses, size)
        if len(sets):
            wanted = [
                left(problem, tuple(reduced.pose_index[one]), n_failures)
                for one in sets
            ]
            found = left_after_failures(
                reduced,
                reduced.measure,
                n_failures,
                sets,
            )
            expected = np.array(wanted)
            assert found == pytest.approx(expected)


@given(
    problem=problems(),
    survive=st.integers(1, 2),
    solver=st.sampled_from(["auto", "exact"]),
)
def test_the_best_layout_is_that_of_brute_force(problem, survive, solver):
    problem = where_sites_fail(problem, survive)
    best = max(
        (left(problem, poses, survive), *placement_value(problem, poses)[:2])
        for poses in feasible_layouts(problem)
    )

    effort = Effort(solver=solver, time_limit_s=60.0)
    solution = solve_placement(problem, effort=effort)
    stages = solution.certificate.stages

    assert [stage.objective for stage in stages[:3]] == pytest.approx(best)
    assert all(stage.gap == 0.0 for stage in stages)

    chosen = np.array([solution.pose_index])

    # The checker, which shares no code with the solver, says the same.
    for stage, objective in zip(stages, problem.objectives, strict=True):
        (value,) = stage_values(problem, objective, chosen)
        assert value == pytest.approx(stage.objective)
