"""What a placement problem refuses."""

from dataclasses import fields, replace

import numpy as np
import pytest
from refusals import refused_with
from tiny_worlds import axis_of_runs

from placement.detection_table import pack_table
from placement.optimiser import (
    Limits,
    PlacementProblem,
)
from scenarios.aeb import AebRule

RULE = AebRule(
    deceleration_mps2=7.72, latency_s=0.025, n_confirmations=3, frame_rate_hz=10.0
)


def two_runs(rows, *, fusion="any", weight=None):
    """Six frames per run, deadlines such that the third and the fifth frame confirm
    last.
    """
    axis = axis_of_runs(
        [0, 6, 12],
        np.tile(np.arange(-5, 1) / 10.0, 2),
        [-0.05, -0.275],
        weight=[0.75, 0.25] if weight is None else weight,
    )
    detected = np.array(
        [[mark == "1" for mark in row.replace(" ", "")] for row in rows]
    )
    return PlacementProblem(
        table=pack_table(tuple(map(str, range(len(rows)))), axis, detected),
        limits=Limits(
            site_index=np.arange(len(rows)),
            site_capacity=np.ones(len(rows), dtype=np.int64),
            budget_units=1,
            unit_cost_eur=np.full(len(rows), 5.0),
        ),
        fusion=fusion,
        rule=RULE,
    )


def change_problem(problem, change):
    """Build the problem with other fields of it or its limits."""
    if set(change) <= {field.name for field in fields(Limits)}:
        replace(problem, limits=replace(problem.limits, **change))
    else:
        replace(problem, **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"fusion": "all"}, "fusion: got 'all'; expected one of any, single")],
)
def test_problem_says_what_is_wrong(change, message):
    problem = two_runs(["111000 111000", "111000 111000"])
    with refused_with(message):
        change_problem(problem, change)
