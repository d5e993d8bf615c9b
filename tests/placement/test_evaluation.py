"""APR, speeds at contact and failures, from verdicts made by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seen_frames import seen_evaluation
from strategies import frame_axes

from placement.evaluation import (
    Verdict,
    apr,
    apr_by_case,
    apr_one_failed,
    detected_share,
    mean_impact_speed_kmh,
)


def _verdict(is_avoided, detected=()):
    """A verdict on runs."""
    confirmation_time_s = np.full(len(is_avoided), np.inf)
    onset_time_s = np.full(len(is_avoided), np.inf)
    return Verdict(
        detected=np.array(detected, dtype=bool),
        confirmation_time_s=confirmation_time_s,
        onset_time_s=onset_time_s,
        is_avoided=np.array(is_avoided, dtype=bool),
    )


def test_apr_is_the_weight_of_the_avoided_runs(frame_axis):
    two_avoided = _verdict([True, False, True])
    one_avoided = _verdict([False, True, False])

    # Weights 1/2, 1/4 (case A) and 1/4 (case B).
    assert apr(two_avoided, frame_axis) == 0.75
    assert apr(one_avoided, frame_axis) == 0.25

    expected = {
        "A": pytest.approx(2.0 / 3.0),
        "B": 1.0,
    }
    found = apr_by_case(_verdict([True, False, True]), frame_axis)

    assert found == expected


def test_apr_of_some_runs_counts_only_those(frame_axis):
    verdict = _verdict([True, False, True])
    mask = np.array([False, True, True])
    nothing = np.zeros(3, dtype=bool)

    assert apr(verdict, frame_axis, mask) == 0.5
    assert math.isnan(apr(verdict, frame_axis, nothing))


def test_the_mean_speed_at_contact_counts_avoided_runs_as_zero(frame_axis):
    # Weights 1/2, 1/4 (case A) and 1/4 (case B).
    impact_speed_kmh = np.array([0.0, 8.0, 20.0])
    one_avoided = _verdict([True, False, False])
    verdict = replace(one_avoided, impact_speed_kmh=impact_speed_kmh)
    all_avoided = _verdict([True] * 3)

    assert mean_impact_speed_kmh(verdict, frame_axis) == 7.0
    assert mean_impact_speed_kmh(
        verdict, frame_axis, np.array([True, True, False])
    ) == (pytest.approx(2.0 / 0.75))
    assert math.isnan(mean_impact_speed_kmh(all_avoided, frame_axis))


@given(frame_axes(), st.data())
def test_apr_of_all_is_the_weighted_mean_over_cases_and_never_above_one(axis, data):
    boolean = st.booleans()
    booleans = st.lists(boolean, min_size=axis.n_runs, max_size=axis.n_runs)
    verdict = _verdict(data.draw(booleans))

    total = apr(verdict, axis)
    by_case = apr_by_case(verdict, axis)
    cases = np.array(axis.cases)
    share = {case: axis.weight[cases == case].sum() for case in axis.cases}
    mean = sum(share[case] * value for case, value in by_case.items())
    distinct = dict.fromkeys(axis.cases)
    expected = list(distinct)
    every_run = _verdict([True] * axis.n_runs)
    no_run = _verdict([False] * axis.n_runs)

    assert 0.0 <= total <= 1.0
    assert list(by_case) == expected
    assert mean == pytest.approx(total)
    assert apr(every_run, axis) == pytest.approx(1.0)
    assert apr(no_run, axis) == 0.0


def test_detected_share_counts_frames_of_the_chosen_runs(frame_axis):
    detected = [True, False, True] + [True] * 4 + [False] + [False, False]
    verdict = _verdict([False] * 3, detected)
    of_all = detected_share(verdict, frame_axis)

    assert of_all == pytest.approx(0.6)

    for index, expected in enumerate([2.0 / 3.0, 0.8, 0.0]):
        mask = np.arange(3) == index
        of_run = detected_share(verdict, frame_axis, mask)
        assert of_run == pytest.approx(expected)

    assert detected_share(
        verdict, frame_axis, np.array([True, False, True])
    ) == pytest.approx(0.4)


def test_a_verdict_cannot_be_changed(frame_axis):
    verdict = _verdict([True, False, True], [True] * 10)
    for field in ("detected", "confirmation_time_s", "is_avoided"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(verdict, field)[0] = 0


@pytest.mark.parametrize(
    ("frames_of_units", "expected"),
    [
        (["1111111100"], 0.0),  # nothing is left of one unit
        (["1111111100", "0000000000"], 0.0),
        (["1111111100", "1111111100"], 0.75),
        (["1011010100", "0100101000"], 0.0),  # they confirm only together
        (["1110000000", "1110011100", "0001111100"], 0.75),
        (["1111110000", "1110000000", "0000000000"], 0.5),
    ],
)
def test_one_unit_fails_and_the_rest_still_has_to_confirm(
    frame_axis, rule, frames_of_units, expected
):
    # Any three frames in a row avoid run 0 (weight 1/2) and run 1 (1/4); nothing avoids
    # run 2.
    assert _one_failed_of(frame_axis, rule, frames_of_units) == expected


@pytest.mark.parametrize(
    ("latencies_s", "expected"),
    [
        ((None, None), 0.75),
        ((0.0, 0.2), 0.25),
        ((0.2, 0.0), 0.25),
        ((None, 0.5), 0.0),
    ],
)
def test_the_unit_that_is_left_may_be_slow(frame_axis, rule, latencies_s, expected):
    """Both see all. Run 0 is confirmed at 0 s, to brake by 0.05 s; run 1 at -0.2 s, by
    0.1 s.
    """
    rows = ["1111111100", "1111111100"]
    found = _one_failed_of(frame_axis, rule, rows, latencies_s)
    assert found == expected


def _one_failed_of(frame_axis, rule, frames_of_units, latencies_s=()):
    """APR when one of the units fails."""
    axis = replace(frame_axis, last_brake_time_s=[0.05, 0.1, -np.inf])
    rows = [[frame == "1" for frame in frames] for frames in frames_of_units]
    evaluation = seen_evaluation(axis, rows, latencies_s)
    return apr_one_failed(evaluation, rule)
