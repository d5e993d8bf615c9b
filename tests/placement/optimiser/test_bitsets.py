import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser import PlacementProblem
from placement.optimiser.bitsets import (
    avoided_with_each,
    keep_apr,
    left_after_failures,
    may_keep_margins,
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


@st.composite
def reduced_problems_and_sets(draw):
    """A reduced problem, and some sets of its poses."""
    reduced = presolve(draw(st.from_type(PlacementProblem)))
    n_units = draw(st.integers(1, 3))
    some = st.lists(st.integers(0, max(0, reduced.n_poses - 1)), min_size=3, max_size=12)
    firsts = np.array(draw(some), dtype=np.int64)
    sets = np.stack([np.roll(firsts, shift) for shift in range(n_units)], axis=1)
    return reduced, sets if reduced.n_poses else np.empty((0, n_units), dtype=np.int64)


@given(reduced_problems_and_sets())
def test_margins_are_those_of_the_first_window_that_is_whole_and_has_all_its_tails(drawn):
    reduced, sets = drawn
    margin = union_margins_s(reduced, unions_of(reduced, sets))
    detected = reduced.detected()
    for units, margins in zip(sets, margin, strict=True):
        seen = detected[units].any(axis=0)
        for run, chain in enumerate(reduced.run_chain):
            frames, n_links = reduced.tails(chain)
            live = [
                all(seen[reduced.window_frames[w]]) and all(seen[frames[n_links > link]])
                for link, w in enumerate(reduced.chain(chain))
            ]
            first = live.index(True) if True in live else len(live)
            assert margins[run] == reduced.margin_s[run, first]


@given(reduced_problems_and_sets(), st.floats(0.0, 1.0), st.floats(-0.5, 3.0))
def test_sets_are_left_out_early_only_if_they_lose_too_much(drawn, least, smallest_s):
    reduced, sets = drawn
    if not reduced.measure.is_mean or not len(sets):
        return
    left = left_after_failures(reduced, reduced.measure, 1, sets)
    kept = keep_apr(reduced, sets, least, with_failures=True)
    is_clear = np.abs(left - least) > 1e-9
    np.testing.assert_array_equal(kept[is_clear], (left >= least)[is_clear])

    margin = union_margins_s(reduced, unions_of(reduced, sets))
    is_avoided = (margin > -np.inf) & (reduced.weight > 0.0)
    total = np.where(margin > -np.inf, margin, 0.0) @ reduced.weight
    smallest = np.where(is_avoided, margin, np.inf).min(axis=1, initial=np.inf)
    need = float(np.median(total)) - 1e-9
    reaches = (total >= need) & (smallest >= smallest_s)
    may = may_keep_margins(reduced, sets, smallest_s=smallest_s, total_s=need)
    assert may[reaches].all()
    is_clear = (np.abs(total - need) > 1e-6) & (np.abs(smallest - smallest_s) > 1e-6)
    np.testing.assert_array_equal(may[is_clear], reaches[is_clear])
