"""What sets of poses are worth, told twice: by the optimiser's code and by the
checker's.
"""

import ast
import inspect
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from problems import questions

from placement.detection_table import pack_table
from placement.layout import Stage
from placement.optimiser import (
    Limits,
    PlacementProblem,
    apr_failed,
    cost_eur,
    floor_value,
    is_allowed,
    is_feasible,
    placement_value,
    run_margins_s,
    solve_placement,
)
from placement.optimiser.problem import Objective
from placement.verification import recomputation, verify
from placement.verification.recomputation import (
    costs_eur,
    floor_values,
    limit_checks,
    margins_s,
    stage_names,
    stage_values,
)


def sets_of(problem, size, limit=25):
    """Some sets of a size."""
    poses = range(problem.table.n_poses)
    combined = list(combinations(poses, size))
    all_of_size = combined[:limit]
    rows = np.array(all_of_size, dtype=np.int64)
    return rows.reshape(len(all_of_size), size)


def test_the_checker_calls_nothing_of_the_optimiser():
    for module in (recomputation, verify):
        source = inspect.getsource(module)
        tree = ast.parse(source)
        for (
            node
        ) in tree.body:  # imports for types alone stand deeper, under TYPE_CHECKING
            if isinstance(node, ast.ImportFrom | ast.Import):
                if isinstance(node, ast.ImportFrom):
                    names = [node.module or ""]
                else:
                    names = []

                names += [alias.name for alias in node.names]
                # Names of the stages alone.
                if names == ["optimiser.problem", "Objective"]:
                    continue

                is_imported = any("optimiser" in name for name in names)
                assert not is_imported, module.__name__

        nodes = ast.walk(tree)
        inner = [node for node in nodes if isinstance(node, ast.ImportFrom)]
        from_optimiser = {
            alias.name
            for node in inner
            if node.module == "optimiser"
            for alias in node.names
        }

        assert from_optimiser <= {"PlacementProblem", "Floor"}


@given(problem=questions(), size=st.integers(0, 4))
def test_both_ways_agree_on_every_set(problem, size):
    sets = sets_of(problem, size)
    problem = replace(problem, survive=2)
    margin_s = margins_s(problem, sets)
    found = {
        name: stage_values(problem, Objective(name), sets)
        for name in (
            "units",
            "apr_survived",
            "apr",
            "apr_one_failed",
            "smallest_margin_s",
            "mean_margin_s",
            "cost_eur",
        )
    }
    checks = limit_checks(problem, sets)
    met = list(checks.values())
    allowed = np.logical_and.reduce(met)

    floors = [floor_values(problem, floor, sets) for floor in problem.floors]

    for index, poses in enumerate(sets.tolist()):
        expected_s = run_margins_s(problem, poses)

        assert_allclose(margin_s[index], expected_s, atol=1e-12)

        value = placement_value(problem, poses)

        for name in value._fields:
            expected = getattr(value, name)
            assert found[name][index] == pytest.approx(expected, abs=1e-12)

        expected_allowed = size > 0 and is_allowed(problem.limits, poses)

        assert found["units"][index] == len(poses)
        assert found["apr_survived"][index] == pytest.approx(
            apr_failed(problem, poses, 2)
        )
        assert allowed[index] == expected_allowed
        assert costs_eur(problem, sets)[index] == pytest.approx(
            cost_eur(problem.limits, poses)
        )

        for floor, reached in zip(problem.floors, floors, strict=True):
            assert reached[index] == pytest.approx(
                floor_value(problem, floor, poses), abs=1e-12
            )


@given(problem=questions())
def test_small_blocks_change_nothing(problem):
    size = min(2, problem.table.n_poses)
    sets = sets_of(problem, size)
    names = stage_names(problem)
    whole = [stage_values(problem, name, sets) for name in names]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recomputation, "_BLOCK_BYTES", 1)
        for name, values in zip(names, whole, strict=True):
            again = stage_values(problem, name, sets)
            assert_array_equal(again, values)


@given(problem=questions())
def test_no_set_is_better_than_the_simple_limits(problem):
    limits = recomputation.simple_limits(problem, ())
    usable = recomputation.usable_poses(problem)
    for size in range(1, problem.table.n_poses + 1):
        for poses in combinations(range(problem.table.n_poses), size):
            if not is_allowed(problem.limits, list(poses)):
                continue

            usable_poses = set(usable.tolist())

            assert size <= recomputation.most_units(problem)
            assert set(poses) <= usable_poses

            for name in stage_names(problem):
                one_set = np.array([poses])
                (value,) = stage_values(problem, name, one_set)
                if name.is_minimised:
                    sign = -1.0
                else:
                    sign = 1.0

                assert sign * value <= sign * limits[name] + 1e-9


@given(problem=questions())
def test_limits_behind_a_layout_that_avoids_all_hold_for_all_that_do(problem):
    problem = replace(problem, goal="best", floors=(), survive=0)
    best = recomputation.simple_limits(problem, ())["apr"]
    claim = Stage(
        name="apr",
        objective=best,
        bound=best,
        gap=0.0,
        seconds=0.0,
    )
    limits = recomputation.simple_limits(problem, [claim])

    most = min(problem.table.n_poses, 3)
    for size in range(1, most + 1):
        for poses in combinations(range(problem.table.n_poses), size):
            value = placement_value(problem, poses)
            if value.apr >= best - 1e-12 and is_allowed(problem.limits, list(poses)):
                assert value.smallest_margin_s <= limits["smallest_margin_s"] + 1e-9
                assert value.mean_margin_s <= limits["mean_margin_s"] + 1e-9


@given(problem=questions())
def test_neighbours_are_all_sets_that_differ_in_one_unit(problem):
    usable_rows = recomputation.usable_poses(problem)
    rows = list(usable_rows[:3])
    if not rows:
        return

    usable_poses = recomputation.usable_poses(problem)
    usable = set(usable_poses.tolist())
    found = [
        frozenset(poses)
        for sets in recomputation.neighbours(problem, rows)
        for poses in sets.tolist()
    ]
    layout = frozenset(int(row) for row in rows)
    expected = {
        poses
        for size in range(1, len(usable) + 1)
        for poses in map(frozenset, combinations(usable, size))
        if len(layout - poses) <= 1 and len(poses - layout) <= 1
    }
    distinct = len(set(found))
    n_expected = recomputation.n_neighbours(problem, rows)

    assert len(found) == distinct == n_expected
    assert set(found) == expected


@given(problem=questions())
def test_all_sets_are_all_that_may_be_allowed(problem):
    found = {
        frozenset(poses)
        for sets in recomputation.all_sets(problem)
        for poses in sets.tolist()
    }

    assert len(found) == recomputation.n_sets_of_all(problem)

    allowed = {
        frozenset(poses)
        for size in range(1, problem.table.n_poses + 1)
        for poses in combinations(range(problem.table.n_poses), size)
        if is_feasible(problem, poses)
    }

    assert allowed <= found


def test_the_best_others_of_a_solved_problem_are_the_solution_itself(frame_axis, rule):
    rng = np.random.default_rng(3)
    drawn = rng.random((6, frame_axis.n_frames))
    detected = drawn < 0.7
    problem = PlacementProblem(
        table=pack_table(tuple("abcdef"), frame_axis, detected),
        limits=Limits(site_index=range(6), site_capacity=[1] * 6, budget_units=2),
        fusion="any",
        rule=replace(rule, n_confirmations=2),
    )
    stages = solve_placement(problem).certificate.stages

    sets = recomputation.all_sets(problem)
    best = recomputation.best_others(problem, stages, sets)
    names = [other.name for other in best]

    assert names == [stage.name for stage in stages]

    expected = [stage.objective for stage in stages]
    found = [other.value for other in best]

    assert found == pytest.approx(expected)
