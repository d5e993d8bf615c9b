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
    limited = replace(problem, limits=limits, survive=survive)
    reduced = presolve(limited)
    if reduced.n_poses == 0:
        return

    most = min(3, reduced.n_poses - 1)
    numbers = st.integers(0, most)
    n_units = data.draw(numbers)
    poses = st.lists(
        st.integers(0, reduced.n_poses - 1),
        min_size=n_units,
        max_size=n_units,
        unique=True,
    )
    drawn = data.draw(poses)
    units = np.array(drawn, dtype=np.int64)
    every_pose = np.arange(reduced.n_poses)
    others = np.setdiff1d(every_pose, units)
    repeated = np.tile(units, (len(others), 1))
    sets = np.column_stack([repeated, others])

    assert values_with_each(reduced, units)[others].gains == pytest.approx(
        set_values(reduced, sets).gains, abs=1e-12
    )

    unions = unions_of(reduced, sets)
    margins_s = union_margins_s(reduced, unions)
    is_avoided = margins_s > -np.inf
    avoided = avoided_with_each(reduced, units)

    assert_array_equal(avoided[others], is_avoided)


@given(problems(), st.data())
def test_quick_shares_with_each_pose_are_those_of_the_sets_one_by_one(problem, data):
    reduced = presolve(problem)
    if reduced.n_poses == 0:
        return

    most = min(3, reduced.n_poses - 1)
    numbers = st.integers(0, most)
    n_units = data.draw(numbers)
    units = np.arange(n_units)
    others = np.arange(n_units, reduced.n_poses)
    repeated = np.tile(units, (len(others), 1))
    sets = np.column_stack([repeated, others])

    unions = unions_of(reduced, sets)
    shares = union_apr(reduced, unions)
    with_each = shares_with_each(reduced, units)

    assert with_each[others] == pytest.approx(shares, abs=1e-12)

    for n_failures in (1, 2):
        left = left_after_failures(
            reduced,
            reduced.measure,
            n_failures,
            sets,
        )
        left_of_all = left_with_each(
            reduced,
            units,
            reduced.measure,
            n_failures,
        )
        quick = left_of_all[others]

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
    zeros = np.zeros(len(others), dtype=np.int64)
    sets = np.column_stack([zeros, others])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.bitsets.FEW_PARTNERS", 0 if is_quick else 32)
        found = best_with_each(reduced, units, others)

    all_sets = np.vstack([sets, found])
    values = set_values(reduced, all_sets)
    best = values[values.best_row()]
    is_exceeded = best.exceeds(values[len(sets)])

    assert not is_exceeded
