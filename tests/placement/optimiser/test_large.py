"""The way of large instances, taken on small ones."""

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser import (
    Effort,
    PlacementProblem,
    is_feasible,
    placement_value,
    solve_placement,
)


@given(problem=st.from_type(PlacementProblem))
def test_all_poses_are_bounded_by_what_they_promise(problem: PlacementProblem) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.constants.MAX_BITS", 0)
        solution = solve_placement(problem, effort=Effort(solver="relax"))
    n_poses, most = problem.table.n_poses, problem.limits.max_units
    values = [
        placement_value(problem, poses)
        for n_units in range(1, most + 1)
        for poses in combinations(range(n_poses), n_units)
        if is_feasible(problem, poses)
    ]
    assert is_feasible(problem, solution.pose_index)
    best = max(value.apr for value in values)
    stages = {stage.name: stage for stage in solution.certificate.stages}
    assert stages["apr"].bound >= best - 1e-6
    value = placement_value(problem, solution.pose_index)
    assert tuple(stage.objective for stage in stages.values()) == pytest.approx(value)
    as_good = [other for other in values if other.apr >= value.apr - 1e-9]
    for name in ("apr_one_failed", "mean_margin_s"):
        assert stages[name].bound >= max(getattr(other, name) for other in as_good) - 1e-6
    assert "relaxation of all" in solution.certificate.solver
