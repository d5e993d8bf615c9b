import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import problems

from placement.explain.contributions import find_contributions
from placement.optimiser import apr, placement_value, run_margins_s

PROBLEMS = problems()


def some_poses(problem, data):
    return data.draw(st.permutations(range(problem.table.n_poses)))[
        : data.draw(st.integers(1, 4))
    ]


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
        assert part.marginal_apr == pytest.approx(
            apr(problem, poses) - apr(problem, others)
        )
        assert part.marginal_apr == pytest.approx(weight[part.only_runs].sum())
        assert part.without == placement_value(problem, others)

        delays = [
            (whole[run] - left[run], weight[run])
            for run in range(len(left))
            if left[run] > -np.inf and weight[run] > 0.0
        ]
        if delays:
            seconds, weights = np.array(delays).T
            assert part.mean_delay_s == pytest.approx(
                np.average(seconds, weights=weights)
            )
            assert part.max_delay_s == pytest.approx(seconds.max())
        else:
            assert part.mean_delay_s == part.max_delay_s == 0.0

        assert 0.0 <= part.mean_delay_s <= part.max_delay_s + 1e-12
