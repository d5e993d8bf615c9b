from dataclasses import fields, replace

import numpy as np
import pytest
from tiny_worlds import axis_of_runs

from geometry.errors import InputError
from placement.detection_table import pack_table
from placement.optimiser import (
    Limits,
    PlacementProblem,
    apr,
    apr_one_failed,
    placement_value,
    run_margins_s,
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


def test_margin_is_what_is_left_after_the_third_frame_in_a_row_and_the_latency():
    problem = two_runs(["011100 111000"])
    margin = run_margins_s(problem, [0])

    assert margin == pytest.approx([-0.05 - (-0.2 + 0.025), -0.275 - (-0.3 + 0.025)])

    value = placement_value(problem, [0])

    assert value == pytest.approx((1.0, 0.0, 0.0, 0.75 * 0.125, 5.0), abs=1e-12)


def test_windows_do_not_reach_from_one_run_into_the_next():
    assert apr(two_runs(["000011 100000"]), [0]) == 0.0


def test_too_late_is_not_avoided():
    problem = two_runs(["000111 011100"])
    assert (run_margins_s(problem, [0]) == -np.inf).all()
    assert placement_value(problem, [0]) == (0.0, 0.0, 0.0, 0.0, 5.0)


def test_only_fusion_any_puts_a_window_together_from_several_poses():
    rows = ["110000 000000", "001000 111000"]
    assert apr(two_runs(rows, fusion="any"), [0, 1]) == 1.0
    assert apr(two_runs(rows, fusion="single"), [0, 1]) == 0.25


def test_apr_one_failed_is_the_worst_loss():
    problem = two_runs(["111000 000000", "000000 111000", "111000 000000"])
    assert apr_one_failed(problem, [0, 1]) == 0.25
    assert apr_one_failed(problem, [0, 1, 2]) == 0.75
    assert apr_one_failed(problem, [0]) == 0.0


def test_runs_without_weight_do_not_count():
    problem = two_runs(["111000 111000"], weight=np.array([1.0, 0.0]))
    assert placement_value(problem, [0]).smallest_margin_s == pytest.approx(0.225)


def change_problem(problem, change):
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
    with pytest.raises(InputError) as error:
        change_problem(problem, change)
    assert str(error.value) == message
