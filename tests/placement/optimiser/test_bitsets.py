"""Values of many sets at once, against those of one set after the other."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from problems import problems, questions

from placement.optimiser.bitsets import (
    avoided_with_each,
    best_with_each,
    left_after_failures,
    left_with_each,
    set_values,
    shares_with_each,
    union_apr,
    union_margins_s,
    unions_of,
    values_with_each,
)
from placement.optimiser.presolve import presolve


@given(
    problems(),
    st.sampled_from(["unit", "site"]),
    st.integers(0, 2),
    st.data(),
)
def test_values_with_each_pose_are_those_of_the_sets_one_by_one(
    problem, failing, survive, data
):
    limits = replace(problem.limits, failing=failing)
    reduced = presolve(replace(problem, limits=limits, survive=survive))
    if reduced.n_poses == 0:
        return

    n_units = data.draw(st.integers(0, min(3, reduced.n_poses - 1)))
    poses = st.lists(
        st.integers(0, reduced.n_poses - 1),
        min_size=n_units,
        max_size=n_units,
        unique=True,
    )
    units = np.array(data.draw(poses), dtype=np.int64)
    others = np.setdiff1d(np.arange(reduced.n_poses), units)
    sets = np.column_stack([np.tile(units, (len(others), 1)), others])

    assert values_with_each(reduced, units)[others].gains == pytest.approx(
        set_values(reduced, sets).gains, abs=1e-12
    )

    is_avoided = union_margins_s(reduced, unions_of(reduced, sets)) > -np.inf

    assert_array_equal(avoided_with_each(reduced, units)[others], is_avoided)


@given(problems(), st.data())
def test_quick_shares_with_each_pose_are_those_of_the_sets_one_by_one(problem, data):
    reduced = presolve(problem)
    if reduced.n_poses == 0:
        return

    n_units = data.draw(st.integers(0, min(3, reduced.n_poses - 1)))
    units = np.arange(n_units)
    others = np.arange(n_units, reduced.n_poses)
    sets = np.column_stack([np.tile(units, (len(others), 1)), others])

    shares = union_apr(reduced, unions_of(reduced, sets))

    assert shares_with_each(reduced, units)[others] == pytest.approx(shares, abs=1e-12)

    for n_failures in (1, 2):
        left = left_after_failures(
            reduced,
            reduced.measure,
            n_failures,
            sets,
        )
        quick = left_with_each(reduced, units, reduced.measure, n_failures)[others]
        assert quick == pytest.approx(left, abs=1e-12)


@given(questions(), st.booleans())
def test_the_best_set_with_one_more_pose_is_the_best_of_all_such_sets(
    problem, is_quick
):
    reduced = presolve(problem)
    if reduced.n_poses < 2:
        return

    units = np.arange(1)
    others = np.arange(1, reduced.n_poses)
    sets = np.column_stack([np.zeros(len(others), dtype=np.int64), others])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.bitsets.FEW_PARTNERS", 0 if is_quick else 32)
        found = best_with_each(reduced, units, others)

    values = set_values(reduced, np.vstack([sets, found]))

    assert not values[values.best_row()].exceeds(values[len(sets)])
