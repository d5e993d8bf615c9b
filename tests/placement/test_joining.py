import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import problems
from small_tables import avoiding_problem

from placement.optimiser import (
    PlacementProblem,
    is_better,
    placement_value,
    run_margins_s,
)
from placement.retrofit import best_joining, margins_joined_s


@given(problem=problems(), n_kept=st.integers(0, 3))
@settings(max_examples=60)
def test_a_pose_that_joins_is_as_good_as_the_set_it_makes(
    problem: PlacementProblem, n_kept: int
) -> None:
    poses = range(problem.table.n_poses)
    kept = list(poses)[:n_kept]
    each = np.array(poses)[n_kept:]
    if not len(each):
        return
    expected = [run_margins_s(problem, [*kept, int(pose)]) for pose in each]
    assert margins_joined_s(problem, kept, each) == pytest.approx(np.array(expected))

    values = [placement_value(problem, [*kept, int(pose)])._replace(cost_eur=0.0) for pose in each]
    best = values[best_joining(problem, kept, each)]
    assert not any(is_better(value, best) for value in values)


def test_equal_poses_are_told_apart_by_price_and_blocks_do_not_matter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = avoiding_problem(["1100", "0011", "0010", "0011", "0001"])
    each = np.array([1, 2, 3, 4])
    assert best_joining(problem, [0], each) == 0
    assert best_joining(problem, [0], each, price_eur=np.array([3.0, 1.0, 2.0, 1.0])) == 2
    whole = margins_joined_s(problem, [0], each)
    monkeypatch.setattr("placement.retrofit._BLOCK_POSES", 1)
    assert margins_joined_s(problem, [0], each).tolist() == whole.tolist()
