"""What the VUT sees by itself is in every set of poses: brute force over small
problems.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracle import Oracle
from problems import problems, random_sight
from small_tables import avoiding_problem

from geometry.errors import InputError
from placement.detection_table import (
    is_mixed,
    mixed_table,
    pack_table,
    plain_axis,
    plain_run,
    seeing_share,
)
from placement.optimiser import apr, apr_one_failed, run_margins_s, solve_placement
from placement.optimiser.problem import objective_values


@st.composite
def seeing_problems(draw):
    """Problems whose VUT sees."""
    problem = draw(problems())
    seeds = st.integers(0, 2**32 - 1)
    seed = draw(seeds)
    rng = np.random.default_rng(seed)
    seen_by_vut = random_sight(rng, problem.table.axis)
    return replace(problem, seen_by_vut=seen_by_vut)


def mixed(problem, share):
    """The same where a share of the cars sees."""
    seen = problem.seen_by_vut
    return replace(
        problem,
        table=mixed_table(problem.table, share),
        seen_by_vut=np.concatenate([seen, np.zeros_like(seen)]),
    )


@given(seeing_problems(), st.sampled_from([None, 0.3, 0.75]))
def test_with_cars_that_see_or_a_share_of_them_every_stage_is_that_of_brute_force(
    problem, share
):
    if share is not None:
        problem = mixed(problem, share)
    solution = solve_placement(problem)
    Oracle(problem).check(
        solution.pose_index, solution.certificate.stages, largest_gap=0.0
    )


@given(seeing_problems(), st.sampled_from([0.0, 0.3, 1.0]))
def test_a_share_is_the_weighted_sum_of_both(problem, share):
    blind = replace(problem, seen_by_vut=None)
    both = mixed(problem, share)
    poses = range(problem.table.n_poses)

    for chosen in [[], *([pose] for pose in poses), [*poses]]:
        seeing = apr(problem, chosen)
        without = apr(blind, chosen)
        expected = share * seeing + (1.0 - share) * without
        found = apr(both, chosen)

        assert found == pytest.approx(expected, abs=1e-12)

    found_share = seeing_share(both.table.axis)

    assert found_share == pytest.approx(share)


@given(seeing_problems())
def test_no_pose_at_all_is_the_vut_alone(problem):
    seen = problem.seen_by_vut
    ids = problem.table.pose_ids

    rows = np.tile(seen, (len(ids), 1))
    table = pack_table(ids, problem.table.axis, rows)
    alone = replace(problem, table=table, seen_by_vut=None)
    expected = run_margins_s(alone, [0])
    margins_s = run_margins_s(problem, [])

    assert np.array_equal(margins_s, expected)

    for pose in range(problem.table.n_poses):
        one_failed = apr_one_failed(problem, [pose])
        without = apr(problem, [])
        alone_apr = apr(alone, [0])

        assert one_failed == without == alone_apr


@given(seeing_problems(), st.integers(1, 4))
def test_a_vut_never_fails(problem, n_failures):
    problem = replace(problem, survive=n_failures)
    nobody = apr(problem, [])

    for size in (1, 2, 3):
        poses = range(problem.table.n_poses)
        for chosen in combinations(poses, size):
            left = objective_values(problem, chosen)["apr_survived"]
            assert left >= nobody - 1e-12
            assert n_failures < size or left == pytest.approx(nobody)


def test_runs_that_are_there_twice_are_told_once(frame_axis):
    table = pack_table(
        ("a",), frame_axis, np.ones((1, frame_axis.n_frames), dtype=bool)
    )

    axis = mixed_table(table, 0.25).axis
    expected = [*frame_axis.run_ids] * 2
    plain = [plain_run(name) for name in axis.run_ids]

    assert is_mixed(axis)
    assert not is_mixed(frame_axis)
    assert plain == expected

    once = plain_axis(axis)

    assert once.run_ids == frame_axis.run_ids
    assert once.weight == pytest.approx(frame_axis.weight)
    assert seeing_share(axis) == 0.25


def test_frames_of_other_runs_are_refused():
    problem = avoiding_problem(["1"])
    seen_by_vut = np.ones(1, dtype=bool)
    with pytest.raises(
        InputError, match=r"seen_by_vut: got shape \(1,\); expected a flag"
    ):
        replace(problem, seen_by_vut=seen_by_vut)
