"""The layout that avoids most runs, beside that of most weight."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from changes import changed
from small_tables import avoiding_problem

from placement.explain.alternatives import find_by_runs
from placement.optimiser import Effort, run_margins_s, solve_placement

EFFORT = Effort()
RUNS = ["1000000", "0100000", "0011111", "1000001"]
WEIGHT = np.array([0.45, 0.35, 0.04, 0.04, 0.04, 0.04, 0.04])


@pytest.fixture(scope="module")
def problem():
    """Two units for runs of unequal weight."""
    found = avoiding_problem(RUNS)
    axis = replace(found.table.axis, weight=WEIGHT)
    limits = replace(found.limits, budget_units=2)
    return replace(found, table=replace(found.table, axis=axis), limits=limits)


@pytest.fixture(scope="module")
def chosen(problem):
    """Rows of the layout of most weight."""
    return solve_placement(problem, effort=EFFORT).pose_index


def n_avoided(problem, rows):
    """How many runs some rows avoid."""
    return int(np.isfinite(run_margins_s(problem, rows)).sum())


def pairs(problem):
    """All pairs of rows."""
    return combinations(range(problem.table.n_poses), 2)


def test_the_layout_by_runs_avoids_as_many_as_any_pair(problem, chosen):
    found = find_by_runs(problem, chosen, effort=EFFORT)
    most = max(n_avoided(problem, rows) for rows in pairs(problem))

    assert found.is_proven

    rows = [problem.table.pose_ids.index(unit) for unit in found.units]

    assert found.runs_avoided == most == n_avoided(problem, rows)
    assert found.runs_avoided_here == n_avoided(problem, chosen) < most


def test_nobody_looks_where_there_is_nothing_to_compare(problem, chosen):
    alike = replace(problem.table.axis, weight=np.full(7, 1 / 7))
    by_runs = changed(problem, "table.axis", alike)

    assert find_by_runs(by_runs, chosen, effort=EFFORT) is None

    for asked in (
        replace(problem, survive=1),
        replace(problem, goal="cheapest"),
    ):
        assert find_by_runs(asked, chosen, effort=EFFORT) is None
