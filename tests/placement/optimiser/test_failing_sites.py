"""Poles that fail with all their units, beside units that fail one by one: by brute
force.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import problems

from geometry.errors import InputError
from placement.detection_table import pack_table
from placement.optimiser import (
    Effort,
    Limits,
    PlacementProblem,
    apr,
    apr_failed,
    is_feasible,
    placement_value,
    presolve,
    solve_placement,
)
from placement.optimiser.bitsets import (
    left_after_failures,
    set_values,
    values_with_each,
)
from placement.verification.recomputation import stage_values

SIZES = (1, 2, 3)


def left(problem: PlacementProblem, poses: tuple[int, ...], n_failures: int) -> float:
    """What is left when the worst sites fail: the definition, written down."""
    site = problem.limits.site_index
    used = sorted({int(site[pose]) for pose in poses})
    n_failures = min(n_failures, len(used))  # then the VUT is left, if it sees
    return min(
        apr(problem, [pose for pose in poses if site[pose] not in failed])
        for failed in combinations(used, n_failures)
    )


def where_sites_fail(problem: PlacementProblem, survive: int = 0) -> PlacementProblem:
    limits = replace(problem.limits, failing="site")
    return replace(problem, limits=limits, survive=survive, floors=(), goal="best")


@given(problem=problems(), n_failures=st.integers(0, 3))
def test_what_is_left_is_what_stands_on_the_other_poles(problem, n_failures):
    problem = where_sites_fail(problem)
    reduced = presolve(problem)
    for size in SIZES:
        for poses in combinations(range(problem.table.n_poses), size):
            wanted = left(problem, poses, n_failures)
            assert apr_failed(problem, list(poses), n_failures) == pytest.approx(wanted)
        sets = np.array(
            list(combinations(range(reduced.n_poses), size)), dtype=np.int64
        )
        if len(sets):
            wanted = [
                left(problem, tuple(reduced.pose_index[one]), n_failures)
                for one in sets
            ]
            found = left_after_failures(reduced, reduced.measure, n_failures, sets)
            assert found == pytest.approx(np.array(wanted))


@given(problem=problems(), survive=st.integers(1, 2))
def test_values_with_each_pose_are_those_of_the_sets(problem, survive):
    reduced = presolve(where_sites_fail(problem, survive))
    for size in (0, 1, 2):
        for units in combinations(range(reduced.n_poses), size):
            each = values_with_each(reduced, np.array(units, dtype=np.int64))
            others = [pose for pose in range(reduced.n_poses) if pose not in units]
            sets = np.array([[*units, pose] for pose in others], dtype=np.int64)
            if len(others):
                one_by_one = set_values(reduced, sets)
                assert each.gains[others] == pytest.approx(one_by_one.gains)


@given(
    problem=problems(),
    survive=st.integers(1, 2),
    solver=st.sampled_from(["auto", "exact"]),
)
def test_the_best_layout_is_that_of_brute_force(problem, survive, solver):
    problem = where_sites_fail(problem, survive)
    n_poses = problem.table.n_poses
    sets = [poses for size in SIZES for poses in combinations(range(n_poses), size)]
    sets = [poses for poses in sets if is_feasible(problem, poses)]
    best = max(
        (left(problem, poses, survive), *placement_value(problem, poses)[:2])
        for poses in sets
    )
    solution = solve_placement(problem, effort=Effort(solver=solver, time_limit_s=60.0))
    stages = solution.certificate.stages
    assert [stage.objective for stage in stages[:3]] == pytest.approx(best)
    assert all(stage.gap == 0.0 for stage in stages)
    chosen = np.array([solution.pose_index])
    for (
        stage
    ) in stages:  # the checker, which shares no code with the solver, says the same
        value = stage_values(problem, problem.objectives[stages.index(stage)], chosen)[
            0
        ]
        assert value == pytest.approx(stage.objective)


def test_two_units_on_one_pole_do_not_survive_it(frame_axis, rule):
    """Two poses that see all stand on one pole, one that sees nothing on another."""
    detected = np.zeros((3, frame_axis.n_frames), dtype=bool)
    detected[:2] = True
    units_fail = PlacementProblem(
        table=pack_table(("a", "b", "c"), frame_axis, detected),
        limits=Limits(site_index=[0, 0, 1], site_capacity=[2, 1], budget_units=2),
        fusion="any",
        rule=replace(rule, n_confirmations=1, latency_s=0.0),
        survive=1,
    )
    sites_fail = where_sites_fail(units_fail, 1)
    assert apr_failed(units_fail, [0, 1], 1) == apr(units_fail, [0, 1]) == 0.75
    assert apr_failed(sites_fail, [0, 1], 1) == 0.0
    assert solve_placement(units_fail).certificate.stages[0].objective == 0.75
    assert solve_placement(sites_fail).certificate.stages[0].objective == 0.0


def test_what_fails_is_a_unit_or_a_site():
    with pytest.raises(InputError) as told:
        Limits(site_index=[0], site_capacity=[1], failing="lamp")
    assert str(told.value) == "failing: got 'lamp'; expected one of unit, site"
