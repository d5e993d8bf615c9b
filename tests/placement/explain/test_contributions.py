from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import problems

from placement.detection_table import pack_table
from placement.explain.contributions import find_contributions, first_shares
from placement.optimiser import (
    PlacementProblem,
    apr,
    placement_value,
    run_margins_s,
)
from scenarios.aeb import load_aeb_rule

PROBLEMS = problems()


def some_poses(problem: PlacementProblem, data: st.DataObject) -> list[int]:
    return data.draw(st.permutations(range(problem.table.n_poses)))[: data.draw(st.integers(1, 4))]


@given(problem=PROBLEMS, data=st.data())
def test_each_part_is_the_difference_that_the_unit_makes(problem, data):
    poses = some_poses(problem, data)
    whole = run_margins_s(problem, poses)
    weight = problem.table.axis.weight
    found = find_contributions(problem, poses)
    assert [part.pose_index for part in found] == poses
    for part in found:
        others = [pose for pose in poses if pose != part.pose_index]
        left = run_margins_s(problem, others)
        assert part.only_runs.tolist() == [
            run
            for run in range(len(left))
            if whole[run] > -np.inf and left[run] == -np.inf and weight[run] > 0.0
        ]
        assert part.marginal_apr == pytest.approx(apr(problem, poses) - apr(problem, others))
        assert part.marginal_apr == pytest.approx(weight[part.only_runs].sum())
        assert part.without == placement_value(problem, others)
        delays = [
            (whole[run] - left[run], weight[run])
            for run in range(len(left))
            if left[run] > -np.inf and weight[run] > 0.0
        ]
        if delays:
            seconds, weights = np.array(delays).T
            assert part.mean_delay_s == pytest.approx(np.average(seconds, weights=weights))
            assert part.max_delay_s == pytest.approx(seconds.max())
        else:
            assert part.mean_delay_s == part.max_delay_s == 0.0
        assert 0.0 <= part.mean_delay_s <= part.max_delay_s + 1e-12


@given(problem=PROBLEMS, data=st.data())
def test_first_confirmations_are_shared_out_in_full(problem, data):
    poses = some_poses(problem, data)
    shares = first_shares(problem, poses)
    counts = (run_margins_s(problem, poses) > -np.inf) & (problem.table.axis.weight > 0.0)
    if problem.seen_by_vut is None:
        assert shares.sum() == pytest.approx(1.0 if counts.any() else 0.0)
    assert shares.sum() <= 1.0 + 1.0e-9  # the VUT has the rest
    assert (shares >= 0.0).all()


@given(problem=PROBLEMS, data=st.data())
def test_a_unit_that_detects_nothing_contributes_nothing(problem, data):
    first, *others = some_poses(problem, data)
    detected = problem.table.detected(slice(None))
    detected[first] = False
    table = problem.table
    blinded = replace(problem, table=pack_table(table.pose_ids, table.axis, detected))
    blind, *parts = find_contributions(blinded, [first, *others])
    assert len(blind.only_runs) == 0
    assert blind.marginal_apr == blind.mean_delay_s == blind.max_delay_s == blind.first_share == 0.0
    alone = find_contributions(blinded, others)
    assert [part.first_share for part in parts] == [part.first_share for part in alone]


def test_frames_of_the_first_window_are_shared_by_who_detects_in_them():
    from placement.explain.contributions import _parts_of_firsts, _parts_of_window

    detected = np.array([[0, 1, 1, 1, 1], [0, 0, 1, 1, 1], [1, 0, 0, 0, 1]], dtype=bool)
    time_s, rule = np.arange(-4, 1) / 10.0, load_aeb_rule()
    parts = _parts_of_window(detected, time_s, 0.0, rule)  # frames 0, 1, 2
    np.testing.assert_allclose(parts, np.array([1.0 + 0.5, 0.5, 1.0]) / 3.0)
    firsts = _parts_of_firsts(detected, time_s, 0.0, rule)
    np.testing.assert_allclose(firsts, [1.0, 0.0, 0.0])


def test_frames_of_a_track_that_was_lost_are_nobodys():
    from placement.explain.contributions import _parts_of_firsts, _parts_of_window

    detected = np.zeros((2, 12), dtype=bool)
    detected[0, :3] = True  # lost before the second unit sees the road user
    detected[1, 8:11] = True
    time_s = np.arange(-11, 1) / 10.0
    for memory_s, parts in ((0.5, [0.0, 1.0]), (0.6, [1.0, 0.0]), (np.inf, [1.0, 0.0])):
        rule = replace(load_aeb_rule(), track_memory_s=memory_s)
        assert _parts_of_window(detected, time_s, 0.0, rule).tolist() == parts
        alone = _parts_of_firsts(detected, time_s, 0.0, rule).tolist()
        assert alone == ([1.0, 0.0] if memory_s == np.inf else [0.0, 1.0])
