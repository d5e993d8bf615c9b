"""What is lost when units fail, against brute force."""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import frame_axes
from tiny_worlds import unit_at

from placement.evaluation import (
    Evaluation,
    Verdict,
    apr_one_failed,
    apr_one_site_failed,
)
from placement.explain.contributions import MAX_PAIR_UNITS, find_failures
from placement.layout import Layout
from scenarios.aeb import load_aeb_rule


def evaluate(axis, detected, latencies_s):
    """An evaluation of units of which nothing but the detected frames and latencies
    counts.
    """
    units = tuple(
        unit_at(f"U{index}", latency_s=latency_s)
        for index, latency_s in enumerate(latencies_s)
    )
    nothing = np.zeros(axis.n_runs)

    def verdict(frames):
        return Verdict(
            detected=np.array(frames, dtype=bool),
            confirmation_time_s=nothing,
            onset_time_s=nothing,
            is_avoided=nothing > 0.0,
        )

    any_unit = np.any(detected, axis=0)
    return Evaluation(
        layout=Layout(name="mine", units=units),
        axis=axis,
        vut=verdict(any_unit),
        units={
            unit.id: verdict(row) for unit, row in zip(units, detected, strict=True)
        },
        rsu_all=verdict(any_unit),
        vut_and_rsus=verdict(any_unit),
    )


def brute_force(axis, detected, latencies_s, rule, failed):
    """Run by run and window by window: APR, smallest margin and avoided runs of the
    rest.
    """
    n = rule.n_confirmations
    avoided = []
    weight = 0.0
    margins = []
    for run in range(axis.n_runs):
        frames = range(int(axis.run_start[run]), int(axis.run_start[run + 1]))
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
            margins.append(axis.last_brake_time_s[run] - onset)

    return weight, min(margins, default=math.nan), avoided


@given(frame_axes(max_runs=3), st.integers(1, 4), st.data())
def test_every_failure_is_as_brute_force_says(axis, n_units, data):
    rule = replace(load_aeb_rule(), n_confirmations=data.draw(st.integers(1, 3)))
    # Mostly seen: else hardly any run is avoided, and none can be lost.
    is_seen = st.sampled_from([True, True, False])
    detected = [
        data.draw(st.lists(is_seen, min_size=axis.n_frames, max_size=axis.n_frames))
        for _ in range(n_units)
    ]
    latencies_s = data.draw(
        st.lists(st.sampled_from([0.0, 0.05, 0.31]), min_size=n_units, max_size=n_units)
    )
    evaluation = evaluate(axis, detected, latencies_s)
    failures = find_failures(evaluation, rule)

    expected_units = [(f"U{index}",) for index in range(n_units)]
    expected_pairs = [(f"U{a}", f"U{b}") for a, b in combinations(range(n_units), 2)]

    assert sorted(item.unit_ids for item in failures.one_failed) == expected_units
    assert sorted(item.unit_ids for item in failures.two_failed) == expected_pairs

    _, _, avoided_by_all = brute_force(axis, detected, latencies_s, rule, ())

    for item in (failures.none_failed, *failures.one_failed, *failures.two_failed):
        failed = [int(name[1:]) for name in item.unit_ids]
        share, margin_s, avoided = brute_force(
            axis, detected, latencies_s, rule, failed
        )

        assert item.apr == pytest.approx(share)
        assert item.smallest_margin_s == pytest.approx(margin_s, nan_ok=True)
        assert sorted(item.lost_run_ids) == sorted(set(avoided_by_all) - set(avoided))

    assert failures.one_failed[0].apr == apr_one_failed(evaluation, rule)

    for items in (failures.one_failed, failures.two_failed):
        assert [item.apr for item in items] == sorted(item.apr for item in items)


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
    detected = rng.random((3, 10)) < 0.8
    evaluation = evaluate(frame_axis, detected, [None] * 3)
    units = tuple(
        replace(unit, site_id=site)
        for unit, site in zip(evaluation.layout.units, sites, strict=True)
    )
    evaluation = replace(evaluation, layout=Layout(name="mine", units=units))
    found = find_failures(evaluation, rule).site_failed
    together = {}
    for index, site in enumerate(sites):
        together.setdefault(site or f"unit U{index}", []).append(index)

    assert {item.site_id: item.unit_ids for item in found} == {
        site: tuple(f"U{index}" for index in failed)
        for site, failed in together.items()
    }

    latencies_s = [rule.latency_s] * 3

    for item in found:
        failed = together[item.site_id]
        share, _, _ = brute_force(frame_axis, detected, latencies_s, rule, failed)
        assert item.apr == pytest.approx(share)

    assert apr_one_site_failed(evaluation, rule) == min(item.apr for item in found)


def test_runs_without_weight_are_neither_lost_nor_a_margin(frame_axis, rule):
    axis = replace(
        frame_axis,
        last_brake_time_s=np.array([0.05, 0.1, -np.inf]),
        weight=np.array([0.0, 1.0, 0.0]),
    )
    # U0 sees all; U1 sees run 1 only, one frame later.
    rows = np.array([[1] * 10, [0] * 3 + [0, 1, 1, 1, 0] + [0, 0]], dtype=bool)

    failures = find_failures(evaluate(axis, rows, [None, None]), rule)

    assert failures.none_failed.smallest_margin_s == pytest.approx(
        0.1 + 0.2 - rule.latency_s
    )

    worst = failures.one_failed[0]

    assert worst.unit_ids == ("U0",)
    assert worst.lost_run_ids == ()  # run 0 is lost, but does not count
    assert worst.apr == 1.0
    assert worst.smallest_margin_s == pytest.approx(0.1 + 0.1 - rule.latency_s)


def test_the_fastest_of_the_lost_runs_comes_first(frame_axis, rule):
    axis = replace(frame_axis, last_brake_time_s=np.array([0.05, 0.1, -np.inf]))
    failures = find_failures(evaluate(axis, np.ones((1, 10), bool), [None]), rule)
    (only,) = failures.one_failed

    assert only.lost_run_ids == ("A/north/30", "A/north/20")
    assert only.apr == 0.0
    assert math.isnan(only.smallest_margin_s)


@pytest.mark.parametrize("n_units", [MAX_PAIR_UNITS, MAX_PAIR_UNITS + 1])
def test_pairs_are_looked_at_up_to_a_number_of_units(frame_axis, rule, n_units):
    rows = np.ones((n_units, 10), dtype=bool)
    failures = find_failures(evaluate(frame_axis, rows, [None] * n_units), rule)

    assert len(failures.one_failed) == n_units

    if n_units <= MAX_PAIR_UNITS:
        n_pairs = n_units * (n_units - 1) // 2
    else:
        n_pairs = 0

    assert len(failures.two_failed) == n_pairs
