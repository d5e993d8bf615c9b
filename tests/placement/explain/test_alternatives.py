"""The layout that avoids most runs, beside that of most weight."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from small_tables import avoiding_problem

from placement.explain.alternatives import find_by_runs
from placement.optimiser import Effort, run_margins_s, solve_placement

EFFORT = Effort()
RUNS = ["1000000", "0100000", "0011111", "1000001"]
WEIGHTS = [0.45, 0.35, 0.04, 0.04, 0.04, 0.04, 0.04]


@pytest.fixture(scope="module")
def problem():
    """Two units for runs of unequal weight."""
    return avoiding_problem(RUNS, weights=WEIGHTS, budget_units=2)


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
    alike = avoiding_problem(RUNS, budget_units=2)

    for asked in (
        alike,
        replace(problem, survive=1),
        replace(problem, goal="cheapest"),
    ):
        assert find_by_runs(asked, chosen, effort=EFFORT) is None
