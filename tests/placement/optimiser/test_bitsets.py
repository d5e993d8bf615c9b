import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser import PlacementProblem
from placement.optimiser.bitsets import (
    avoided_with_each,
    set_values,
    union_margins_s,
    unions_of,
    values_with_each,
)
from placement.optimiser.presolve import presolve


@given(st.from_type(PlacementProblem), st.data())
def test_values_with_each_pose_are_those_of_the_sets_one_by_one(problem, data):
    reduced = presolve(problem)
    if reduced.n_poses == 0:
        return
    n_units = data.draw(st.integers(0, min(3, reduced.n_poses - 1)))
    poses = st.lists(
        st.integers(0, reduced.n_poses - 1), min_size=n_units, max_size=n_units, unique=True
    )
    units = np.array(data.draw(poses), dtype=np.int64)
    others = np.setdiff1d(np.arange(reduced.n_poses), units)
    sets = np.column_stack([np.tile(units, (len(others), 1)), others])
    assert values_with_each(reduced, units)[others].gains == pytest.approx(
        set_values(reduced, sets).gains, abs=1e-12
    )
    is_avoided = union_margins_s(reduced, unions_of(reduced, sets)) > -np.inf
    np.testing.assert_array_equal(avoided_with_each(reduced, units)[others], is_avoided)
