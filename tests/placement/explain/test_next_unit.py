"""The further unit that gains most."""

from dataclasses import replace

import pytest
from hypothesis import given
from problems import problems

from placement.explain.contributions import find_next_unit
from placement.optimiser import apr, presolve, solve_placement
from placement.optimiser.allowed_sets import is_allowed


@given(problem=problems())
def test_no_other_further_unit_gains_more(problem):
    reduced = presolve(problem)
    solution = solve_placement(problem, reduced)
    found = list(solution.pose_index)
    limits = replace(problem.limits, budget_units=None)
    others = [
        pose for pose in range(limits.n_poses) if is_allowed(limits, [*found, pose])
    ]
    best = find_next_unit(problem, reduced, found)
    ratios = [apr(problem, [*found, pose]) for pose in others if pose not in found]
    if best is None:
        for ratio in ratios:
            expected = apr(problem, found)
            assert ratio == pytest.approx(expected)
        return

    row = problem.table.pose_ids.index(best.pose)
    joined = apr(problem, [*found, row])
    before = apr(problem, found)

    assert row in others
    assert best.apr == joined
    assert best.gain == best.apr - before
    assert best.apr == pytest.approx(max(ratios))
