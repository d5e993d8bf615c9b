import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import questions

from placement.optimiser import PlacementProblem
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


@given(st.from_type(PlacementProblem), st.data())
def test_values_with_each_pose_are_those_of_the_sets_one_by_one(problem, data):
    reduced = presolve(problem)
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
    np.testing.assert_array_equal(avoided_with_each(reduced, units)[others], is_avoided)


@st.composite
def reduced_problems_and_sets(draw):
    """A reduced problem, and some sets of its poses."""
    reduced = presolve(draw(st.from_type(PlacementProblem)))
    n_units = draw(st.integers(1, 3))
    some = st.lists(
        st.integers(0, max(0, reduced.n_poses - 1)), min_size=3, max_size=12
    )
    firsts = np.array(draw(some), dtype=np.int64)
    sets = np.stack([np.roll(firsts, shift) for shift in range(n_units)], axis=1)
    return reduced, sets if reduced.n_poses else np.empty((0, n_units), dtype=np.int64)


@given(reduced_problems_and_sets())
def test_margins_are_those_of_the_first_window_that_is_whole_and_has_all_its_tails(
    drawn,
):
    reduced, sets = drawn
    margin = union_margins_s(reduced, unions_of(reduced, sets))
    detected = reduced.detected()
    for units, margins in zip(sets, margin, strict=True):
        seen = detected[units].any(axis=0)
        for run, chain in enumerate(reduced.run_chain):
            frames, n_links = reduced.tails(chain)
            live = [
                all(seen[reduced.window_frames[w]])
                and all(seen[frames[n_links > link]])
                for link, w in enumerate(reduced.chain(chain))
            ]
            if True in live:
                first = live.index(True)
            else:
                first = len(live)
            assert margins[run] == reduced.margin_s[run, first]


@given(st.from_type(PlacementProblem), st.data())
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
        left = left_after_failures(reduced, reduced.measure, n_failures, sets)
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
