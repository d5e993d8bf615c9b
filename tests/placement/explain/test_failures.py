"""What is lost when units fail, against brute force."""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from changes import changed
from hypothesis import given
from hypothesis import strategies as st
from seen_frames import seen_evaluation
from strategies import frame_axes

from placement.evaluation import apr_one_failed, apr_one_site_failed
from placement.explain.contributions import MAX_PAIR_UNITS, find_failures
from scenarios.aeb import load_aeb_rule


def brute_force(axis, detected, latencies_s, rule, failed):
    """Run by run and window by window: APR, smallest margin and avoided runs of the
    rest.
    """
    n = rule.n_confirmations
    avoided = []
    weight = 0.0
    margins = []
    for run in range(axis.n_runs):
        first = int(axis.run_start[run])
        after_last = int(axis.run_start[run + 1])
        frames = range(first, after_last)
        onset = math.inf
        for last in list(frames)[n - 1 :]:
            known = []
            for frame in range(last - n + 1, last + 1):
                known.append(
                    min(
                        (
                            axis.time_s[frame] + latency_s
                            for unit, latency_s in enumerate(latencies_s)
                            if unit not in failed and detected[unit][frame]
                        ),
                        default=math.inf,
                    )
                )
            onset = min(onset, max(known))

        if onset <= axis.last_brake_time_s[run] + 1.0e-9:
            avoided.append(axis.run_ids[run])
            weight += axis.weight[run]
            margin_s = axis.last_brake_time_s[run] - onset
            margins.append(margin_s)

    smallest_s = min(margins, default=math.nan)
    return weight, smallest_s, avoided


@given(frame_axes(max_runs=3), st.integers(1, 4), st.data())
def test_every_failure_is_as_brute_force_says(axis, n_units, data):
    confirmations = st.integers(1, 3)
    n_confirmations = data.draw(confirmations)
    rule = replace(load_aeb_rule(), n_confirmations=n_confirmations)
    # Mostly seen: else hardly any run is avoided, and none can be lost.
    is_seen = st.sampled_from([True, True, False])
    rows = st.lists(is_seen, min_size=axis.n_frames, max_size=axis.n_frames)
    detected = [data.draw(rows) for _ in range(n_units)]
    latency_s = st.sampled_from([0.0, 0.05, 0.31])
    latencies_s = [data.draw(latency_s) for _ in range(n_units)]
    evaluation = seen_evaluation(axis, detected, latencies_s)

    failures = find_failures(evaluation, rule)

    expected_units = [(f"U{index}",) for index in range(n_units)]
    pairs = combinations(range(n_units), 2)
    expected_pairs = [(f"U{a}", f"U{b}") for a, b in pairs]
    found_units = sorted(item.unit_ids for item in failures.one_failed)
    found_pairs = sorted(item.unit_ids for item in failures.two_failed)

    assert found_units == expected_units
    assert found_pairs == expected_pairs

    _, _, avoided_by_all = brute_force(
        axis,
        detected,
        latencies_s,
        rule,
        (),
    )

    for item in (failures.none_failed, *failures.one_failed, *failures.two_failed):
        failed = [int(name[1:]) for name in item.unit_ids]
        share, margin_s, avoided = brute_force(
            axis,
            detected,
            latencies_s,
            rule,
            failed,
        )
        lost = set(avoided_by_all) - set(avoided)

        assert item.apr == pytest.approx(share)
        assert item.smallest_margin_s == pytest.approx(margin_s, nan_ok=True)
        assert sorted(item.lost_run_ids) == sorted(lost)

    expected_apr = apr_one_failed(evaluation, rule)

    assert failures.one_failed[0].apr == expected_apr

    for items in (failures.one_failed, failures.two_failed):
        aprs = [item.apr for item in items]
        in_order = sorted(item.apr for item in items)
        assert aprs == in_order


@pytest.mark.parametrize(
    "sites",
    [
        ("a", "a", "b"),
        ("a", "b", "c"),
        ("a", "a", "a"),
        ("", "", "b"),
    ],
)
def test_a_pole_takes_all_its_units_with_it(frame_axis, rule, sites):
    rng = np.random.default_rng(4)
    drawn = rng.random((3, 10))
    detected = drawn < 0.8
    evaluation = seen_evaluation(frame_axis, detected)
    units = evaluation.layout.units
    hung = [replace(unit, site_id=sites[n]) for n, unit in enumerate(units)]
    evaluation = changed(evaluation, "layout.units", tuple(hung))
    together = {}
    for index, site in enumerate(sites):
        of_site = together.setdefault(site or f"unit U{index}", [])
        of_site.append(index)

    found = find_failures(evaluation, rule).site_failed
    site_ids = {item.site_id for item in found}

    assert site_ids == set(together)

    latencies_s = [rule.latency_s] * 3

    for item in found:
        failed = together[item.site_id]
        share, _, _ = brute_force(
            frame_axis,
            detected,
            latencies_s,
            rule,
            failed,
        )
        expected_ids = tuple(f"U{index}" for index in failed)

        assert item.unit_ids == expected_ids
        assert item.apr == pytest.approx(share)

    worst_found = apr_one_site_failed(evaluation, rule)
    worst_of_sites = min(item.apr for item in found)

    assert worst_found == worst_of_sites


def test_runs_without_weight_are_neither_lost_nor_a_margin(frame_axis, rule):
    axis = replace(
        frame_axis,
        last_brake_time_s=[0.05, 0.1, -np.inf],
        weight=[0.0, 1.0, 0.0],
    )
    # U0 sees all; U1 sees run 1 only, one frame later.
    rows = np.array(
        [
            [1, 1, 1, 1, 1, 1, 1, 1, 1, 1],
            [0, 0, 0, 0, 1, 1, 1, 0, 0, 0],
        ]
    )

    evaluation = seen_evaluation(axis, rows)
    failures = find_failures(evaluation, rule)

    none_failed_s = failures.none_failed.smallest_margin_s
    worst = failures.one_failed[0]

    assert none_failed_s == pytest.approx(0.1 + 0.2 - rule.latency_s)
    assert worst.unit_ids == ("U0",)
    assert worst.lost_run_ids == ()  # run 0 is lost, but does not count
    assert worst.apr == 1.0
    assert worst.smallest_margin_s == pytest.approx(0.1 + 0.1 - rule.latency_s)


def test_the_fastest_of_the_lost_runs_comes_first(frame_axis, rule):
    axis = replace(frame_axis, last_brake_time_s=[0.05, 0.1, -np.inf])
    always_seen = np.ones((1, 10))
    evaluation = seen_evaluation(axis, always_seen)

    failures = find_failures(evaluation, rule)
    (only,) = failures.one_failed

    assert only.lost_run_ids == ("A/north/30", "A/north/20")
    assert only.apr == 0.0
    assert math.isnan(only.smallest_margin_s)


@pytest.mark.parametrize(
    ("n_units", "n_pairs"),
    [
        (MAX_PAIR_UNITS, MAX_PAIR_UNITS * (MAX_PAIR_UNITS - 1) // 2),
        (MAX_PAIR_UNITS + 1, 0),
    ],
)
def test_pairs_are_looked_at_up_to_a_number_of_units(
    frame_axis, rule, n_units, n_pairs
):
    always_seen = np.ones((n_units, 10))
    evaluation = seen_evaluation(frame_axis, always_seen)

    failures = find_failures(evaluation, rule)

    assert len(failures.one_failed) == n_units
    assert len(failures.two_failed) == n_pairs
