"""The curve against what one verdict after the other would say."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from strategies import frame_axes, numbers

from geometry.catalogue import load_cameras
from geometry.errors import InputError
from geometry.poses import Pose
from placement.candidates import CandidatePose
from placement.evaluation import Evaluation, Verdict
from placement.latency import (
    LatencyBudget,
    LatencyCurve,
    LatencyPart,
    apr_by_latency,
    fixed_latency,
    load_latency_budget,
)
from placement.layout import Layout
from scenarios.aeb import load_aeb_rule

RULE = load_aeb_rule()
TOLERANCE_S = 1.0e-9


def _verdict(detected, n_runs) -> Verdict:
    """Only the frames count."""
    return Verdict(
        detected=np.array(detected, dtype=bool),
        confirmation_time_s=np.full(n_runs, np.inf),
        onset_time_s=np.full(n_runs, np.inf),
        is_avoided=np.zeros(n_runs, dtype=bool),
    )


def _evaluation(axis, vut, units, own_latencies_s=None, vam=None) -> Evaluation:
    own = own_latencies_s or [None] * len(units)
    pose = Pose(position_m=[0, 0, 7], yaw_deg=0.0)
    camera = load_cameras()["carla-ncap-rgb"]
    poses = tuple(
        CandidatePose(id=f"U{index}", site_id="", pose=pose, sensor=camera, latency_s=latency_s)
        for index, latency_s in enumerate(own)
    )
    nobody = _verdict(np.zeros(axis.n_frames), axis.n_runs)
    others = {} if vam is None else {"vam": _verdict(vam, axis.n_runs), "all_sources": nobody}
    return Evaluation(
        layout=Layout(name="any", units=poses),
        axis=axis,
        vut=_verdict(vut, axis.n_runs),
        units={
            pose.id: _verdict(frames, axis.n_runs)
            for pose, frames in zip(poses, units, strict=True)
        },
        rsu_all=nobody,
        vut_and_rsus=nobody,
        others=others,
    )


def _apr_by_hand(axis, parties, n_confirmations) -> float:
    """Every window of every run, one by one: is it known by the last moment?"""
    avoided = 0.0
    for run in range(axis.n_runs):
        frames = range(axis.run_start[run], axis.run_start[run + 1])
        known = [
            min((axis.time_s[f] + late for seen, late in parties if seen[f]), default=math.inf)
            for f in frames
        ]
        windows = [
            max(known[first : first + n_confirmations])
            for first in range(len(known) - n_confirmations + 1)
        ]
        if min(windows, default=math.inf) <= axis.last_brake_time_s[run] + TOLERANCE_S:
            avoided += axis.weight[run]
    return avoided


@st.composite
def cases(draw):
    """Runs, who sees what, and which units have a latency of their own."""
    axis = draw(frame_axes())
    frames = st.lists(st.booleans(), min_size=axis.n_frames, max_size=axis.n_frames)
    units = draw(st.lists(frames, min_size=1, max_size=3))
    own = [draw(st.one_of(st.none(), st.integers(0, 40))) for _ in units]
    own_s = [None if value is None else value / 100.0 for value in own]
    return axis, draw(frames), units, own_s


@settings(max_examples=60)
@given(
    cases(),
    st.integers(0, 1200).map(lambda ms: ms / 1000.0),
    st.integers(1, 4),
    st.one_of(st.none(), st.just(0.07)),
)
def test_every_party_is_judged_as_if_evaluated_with_that_latency(
    case, latency_s, n_confirmations, vut_latency_s
):
    axis, vut, units, own_s = case
    last = axis.last_brake_time_s.repeat(np.diff(axis.run_start))
    for each_s in (latency_s, vut_latency_s, *own_s):  # no ties but exact ones
        slack = np.abs(last - axis.time_s - each_s) if each_s is not None else np.ones(1)
        assume(not ((slack > 0.1 * TOLERANCE_S) & (slack < 10.0 * TOLERANCE_S)).any())
    rule = replace(RULE, n_confirmations=n_confirmations)
    evaluation = _evaluation(axis, vut, units, own_s, vam=vut[::-1])
    curves = apr_by_latency(evaluation, rule, vut_latency_s=vut_latency_s)

    delays = [latency_s if value is None else value for value in own_s]
    on_board = [(vut, latency_s if vut_latency_s is None else vut_latency_s)]
    fused = list(zip(units, delays, strict=True))
    vam = [(vut[::-1], latency_s)]
    parties = {
        "vut": on_board,
        **{f"U{index}": [unit] for index, unit in enumerate(fused)},
        "rsu_all": fused,
        "vut_and_rsus": fused + on_board,
        "vam": vam,
        "all_sources": fused + on_board + vam,
    }
    assert list(curves) == list(parties)
    for name, party in parties.items():
        expected = _apr_by_hand(axis, party, n_confirmations)
        assert float(curves[name].apr(latency_s)) == pytest.approx(expected), name


@pytest.mark.parametrize("last_s", [-1.0e-9, -0.4e-9, 0.0])
def test_what_is_just_in_time_with_no_latency_has_a_step_at_zero(last_s):
    curve = LatencyCurve(last_latency_s=np.array([last_s, -1.0]), weight=np.array([0.5, 0.5]))
    until, apr = curve.steps()
    assert (until.tolist(), apr.tolist()) == ([0.0, math.inf], [0.5, 0.0])


@settings(max_examples=60)
@given(cases(), st.lists(numbers(0.0, 1.5), min_size=1, max_size=5))
def test_steps_are_the_whole_curve(case, latencies_s):
    axis, vut, units, own_s = case
    for curve in apr_by_latency(_evaluation(axis, vut, units, own_s), RULE).values():
        until, apr = curve.steps()
        assert until[-1] == np.inf
        assert (np.diff(until) > 0.0).all()
        assert (np.diff(apr) < 0.0).all()
        assert curve.apr(until) == pytest.approx(apr)  # an edge belongs to its left
        just_above = until[:-1] + 1.0e-8
        assume(not (np.diff(until[:-1]) < 1.0e-7).any())
        assert curve.apr(just_above) == pytest.approx(apr[1:])
        for latency_s in latencies_s:
            assume(np.abs(until - latency_s).min() > 1.0e-8)
            step = int(np.searchsorted(until, latency_s))
            assert float(curve.apr(latency_s)) == pytest.approx(apr[step])


@settings(max_examples=60)
@given(cases(), st.sampled_from([1.0, 0.95, 0.9, 0.5, 0.1]))
def test_the_longest_latency_is_the_last_that_holds(case, level):
    axis, vut, units, own_s = case
    curve = apr_by_latency(_evaluation(axis, vut, units, own_s), RULE)["vut_and_rsus"]
    longest = curve.longest_latency_s(level)
    if longest == -math.inf:
        assert float(curve.apr(0.0)) < level
    else:
        assert float(curve.apr(longest)) >= level - 1e-9
        if math.isfinite(longest):
            assert float(curve.apr(longest + 3.0 * TOLERANCE_S)) < level


def test_a_curve_of_three_runs_by_hand(frame_axis):
    """Confirmed at 0, -0.2 and never; last moments at 0.05, 0.1 and never: 50 ms and 300 ms."""
    axis = replace(frame_axis, last_brake_time_s=np.array([0.05, 0.1, -np.inf]))
    evaluation = _evaluation(axis, np.zeros(10), [np.array([1] * 8 + [0, 0])])
    curve = apr_by_latency(evaluation, RULE)["rsu_all"]
    assert curve.last_latency_s == pytest.approx([0.05, 0.3, -np.inf])
    until, apr = curve.steps()
    assert until == pytest.approx([0.05, 0.3, np.inf])
    assert apr.tolist() == [0.75, 0.25, 0.0]
    assert curve.longest_latency_s(0.75) == pytest.approx(0.05)
    assert curve.longest_latency_s(0.2) == pytest.approx(0.3)
    assert curve.longest_latency_s(0.8) == -math.inf
    # Uniform over 0 to 100 ms: run 0 is avoided in half of it, run 1 always, run 2 never.
    part = LatencyPart(name="wait", low_s=0.0, high_s=0.1, source="test")
    budget = LatencyBudget(name="test", parts=(part,))
    assert curve.expected_apr(budget) == pytest.approx(0.5 * 0.5 + 0.25)


def test_a_unit_with_its_own_latency_keeps_it(frame_axis):
    axis = replace(frame_axis, last_brake_time_s=np.array([0.05, 0.1, -np.inf]))
    frames = np.array([1] * 8 + [0, 0])
    curves = apr_by_latency(_evaluation(axis, frames, [frames, frames], [0.04, 0.2]), RULE)
    assert curves["U0"].apr([0.0, 5.0]).tolist() == [0.75, 0.75]
    assert curves["U1"].apr([0.0, 5.0]).tolist() == [0.25, 0.25]
    assert curves["vut"].apr([0.0, 5.0]).tolist() == [0.75, 0.0]
    assert curves["U0"].longest_latency_s(0.75) == math.inf
    fixed = apr_by_latency(_evaluation(axis, frames, [frames]), RULE, vut_latency_s=0.0)
    assert fixed["vut"].apr([0.0, 5.0]).tolist() == [0.75, 0.75]
    assert fixed["U0"].apr([0.0, 5.0]).tolist() == [0.75, 0.0]


@settings(max_examples=60)
@given(cases(), st.integers(0, 1))
def test_the_expected_apr_is_the_mean_over_draws(case, which):
    axis, vut, units, own_s = case
    budget = load_latency_budget(("cpm-100ms", "cpm-50ms")[which])
    curve = apr_by_latency(_evaluation(axis, vut, units, own_s), RULE)["rsu_all"]
    drawn = curve.apr(budget.sample_s(np.random.default_rng(0), 1000))
    expected = curve.expected_apr(budget)
    error = max(drawn.std() / math.sqrt(len(drawn)), 0.002)
    assert expected == pytest.approx(drawn.mean(), abs=5.0 * error)
    assert float(curve.apr(budget.worst_s)) <= expected + 1e-12
    assert expected <= float(curve.apr(budget.best_s)) + 1e-12


@settings(max_examples=60)
@given(cases(), st.integers(0, 300).map(lambda ms: ms / 1000.0))
def test_of_a_fixed_budget_expected_and_worst_are_one(case, latency_s):
    axis, vut, units, own_s = case
    budget = fixed_latency(latency_s)
    for curve in apr_by_latency(_evaluation(axis, vut, units, own_s), RULE).values():
        assert curve.expected_apr(budget) == pytest.approx(float(curve.apr(latency_s)))


def test_without_weight_there_is_no_expectation_and_curves_cannot_be_changed():
    curve = LatencyCurve(last_latency_s=np.array([0.1]), weight=np.array([0.0]))
    assert math.isnan(curve.expected_apr(load_latency_budget()))
    with pytest.raises(ValueError, match="read-only"):
        curve.weight[0] = 1.0


@pytest.mark.parametrize("latency_s", [-0.1, math.nan, math.inf])
def test_a_latency_of_the_vut_that_cannot_be_is_told(frame_axis, latency_s):
    evaluation = _evaluation(frame_axis, np.zeros(10), [np.zeros(10)])
    with pytest.raises(InputError, match=r"vut_latency_s: got .*; expected seconds, at least 0"):
        apr_by_latency(evaluation, RULE, vut_latency_s=latency_s)
