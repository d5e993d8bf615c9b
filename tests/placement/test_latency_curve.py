"""The curve against what one verdict after the other would say."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import frame_axes, numbers

from geometry.catalogue import load_cameras
from geometry.errors import InputError
from geometry.poses import Pose
from placement.candidates import CandidatePose
from placement.evaluation import Evaluation, Verdict, earliest_arrival_s
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
from scenarios.runs import FrameAxis, find_onsets
from scenarios.scores import Levels
from scenarios.weights import weight_share

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


def curve_of(last_latency_s, weight) -> LatencyCurve:
    """Runs that are avoided with every latency up to some."""
    return LatencyCurve(
        first_latency_s=np.full(len(weight), -np.inf),
        last_latency_s=np.array(last_latency_s),
        run_index=np.arange(len(weight)),
        weight=np.array(weight),
    )


def _apr_by_hand(axis, parties, n_confirmations, memory_s=math.inf, latency_s=0.0) -> float:
    """Every window of every run, one by one: is it known, and alive, at the last moment?"""
    avoided = 0.0
    for run in range(axis.n_runs):
        frames = range(axis.run_start[run], axis.run_start[run + 1])
        last_brake_s = axis.last_brake_time_s[run]
        known = [
            min((axis.time_s[f] + late for seen, late in parties if seen[f]), default=math.inf)
            <= last_brake_s + TOLERANCE_S
            for f in frames
        ]
        times = axis.time_s[frames.start : frames.stop]
        for last in range(n_confirmations - 1, len(known)):
            if not all(known[last - n_confirmations + 1 : last + 1]):
                continue
            stops = [times[f] for f in range(last, len(known)) if known[f]]
            gaps = [b - a for a, b in pairwise([*stops, last_brake_s - latency_s])]
            if max(gaps) <= memory_s + TOLERANCE_S:
                avoided += axis.weight[run]
                break
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


@given(
    cases(),
    st.integers(0, 1200).map(lambda ms: ms / 1000.0),
    st.integers(1, 4),
    st.one_of(st.none(), st.just(0.07)),
    st.sampled_from([0.1, 0.2, 0.35, 0.5, math.inf]),
)
def test_every_party_is_judged_as_if_evaluated_with_that_latency(
    case, latency_s, n_confirmations, vut_latency_s, memory_s
):
    axis, vut, units, own_s = case
    last = axis.last_brake_time_s.repeat(np.diff(axis.run_start))
    for each_s in (latency_s, vut_latency_s, *own_s):  # no ties but exact ones
        slack = np.abs(last - axis.time_s - each_s) if each_s is not None else np.ones(1)
        assume(not ((slack > 0.1 * TOLERANCE_S) & (slack < 10.0 * TOLERANCE_S)).any())
    age = np.abs(last - axis.time_s - latency_s - memory_s)
    assume(not ((age > 0.1 * TOLERANCE_S) & (age < 10.0 * TOLERANCE_S)).any())
    rule = replace(RULE, n_confirmations=n_confirmations, track_memory_s=memory_s)
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
        expected = _apr_by_hand(axis, party, n_confirmations, memory_s, latency_s)
        onsets = find_onsets(
            earliest_arrival_s([(np.array(seen), late) for seen, late in party], axis),
            axis,
            rule=replace(rule, latency_s=latency_s),
        )
        assert float(weight_share(onsets.is_in_time, axis.weight)) == pytest.approx(expected), name
        assert float(curves[name].apr(latency_s)) == pytest.approx(expected), name


@pytest.mark.parametrize("last_s", [-1.0e-9, -0.4e-9, 0.0])
def test_what_is_just_in_time_with_no_latency_has_a_step_at_zero(last_s):
    curve = curve_of([last_s, -1.0], [0.5, 0.5])
    until, apr = curve.steps()
    assert (until.tolist(), apr.tolist()) == ([0.0, math.inf], [0.5, 0.0])


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
    assert curve.run_index.tolist() == [0, 1]
    assert curve.first_latency_s.tolist() == [-math.inf, -math.inf]
    assert curve.last_latency_s == pytest.approx([0.05, 0.3])
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


def test_a_run_may_be_avoided_with_a_longer_latency_alone():
    """Seen from -2 to -1.6 s: with 0.5 s the track is asked for at -1 s, with none at -0.5 s."""
    time_s = np.arange(-20, 1) / 10.0
    axis = FrameAxis(
        run_ids=("a", "b"),
        cases=("A",) * 2,
        approaches=("north",) * 2,
        weathers=("day",) * 2,
        vut_speed_kmh=np.full(2, 30.0),
        weight=np.array([0.75, 0.25]),
        last_brake_time_s=np.array([-0.5, -0.5]),
        run_start=np.array([0, 21, 42]),
        time_s=np.tile(time_s, 2),
    )
    seen = np.concatenate([time_s < -1.55, time_s > -1.55])
    rule = replace(RULE, track_memory_s=1.0)
    evaluation = _evaluation(axis, np.zeros(42), [seen])
    curve = apr_by_latency(evaluation, rule)["rsu_all"]
    assert curve.run_index.tolist() == [0, 1]
    assert curve.first_latency_s == pytest.approx([0.1, -1.5])
    assert curve.last_latency_s == pytest.approx([1.3, 0.8])
    until, apr = curve.steps()
    assert until == pytest.approx([0.1, 0.8, 1.3, math.inf])
    assert apr.tolist() == [0.25, 1.0, 0.75, 0.0]
    assert curve.apr([0.09, 0.1, 0.8, 0.81, 1.3, 1.31]).tolist() == [0.25, 1, 1, 0.75, 0.75, 0]
    assert curve.longest_latency_s(0.2) == pytest.approx(1.3)
    assert curve.longest_latency_s(0.9) == -math.inf  # not with none, although with 0.1 s
    # Uniform over 0 to 100 ms never reaches what the first run needs; over 0 to 200 ms in half.
    for high_s, expected in ((0.1, 0.25), (0.2, 0.625)):
        part = LatencyPart(name="wait", low_s=0.0, high_s=high_s, source="test")
        budget = LatencyBudget(name="test", parts=(part,))
        assert curve.expected_apr(budget) == pytest.approx(expected)
    assert curve.expected_apr(fixed_latency(0.1)) == pytest.approx(1.0)


MORTAL = replace(RULE, track_memory_s=0.2)


@given(cases(), st.lists(numbers(0.0, 1.5), min_size=1, max_size=5))
def test_steps_are_the_whole_curve_also_where_tracks_are_lost(case, latencies_s):
    axis, vut, units, own_s = case
    for curve in apr_by_latency(_evaluation(axis, vut, units, own_s), MORTAL).values():
        until, apr = curve.steps()
        assert until[-1] == np.inf
        assert (np.diff(until) > 0.0).all()
        assert (np.abs(np.diff(apr)) > 0.0).all()
        for first, last, run in zip(
            curve.first_latency_s, curve.last_latency_s, curve.run_index, strict=True
        ):
            own = (curve.run_index == run) & (curve.first_latency_s > first)
            assert first <= last
            assert (last < curve.first_latency_s[own]).all()
        for latency_s in latencies_s:
            assume(np.abs(until - latency_s).min() > 1.0e-8)
            step = int(np.searchsorted(until, latency_s))
            assert float(curve.apr(latency_s)) == pytest.approx(apr[step])
        for level in (0.3, 0.9):
            longest = curve.longest_latency_s(level)
            if longest == -math.inf:
                assert float(curve.apr(0.0)) < level
            else:
                below = [value for value in latencies_s if value <= longest]
                assert (curve.apr([0.0, *below]) >= level - 1e-9).all()


@given(cases(), st.integers(0, 300).map(lambda ms: ms / 1000.0), st.integers(0, 1))
def test_the_expectation_is_the_mean_over_draws_also_where_tracks_are_lost(case, fixed_s, which):
    axis, vut, units, own_s = case
    curve = apr_by_latency(_evaluation(axis, vut, units, own_s), MORTAL)["rsu_all"]
    budget = load_latency_budget(("cpm-100ms", "cpm-50ms")[which])
    drawn = curve.apr(budget.sample_s(np.random.default_rng(0), 1000))
    error = max(drawn.std() / math.sqrt(len(drawn)), 0.002)
    assert curve.expected_apr(budget) == pytest.approx(drawn.mean(), abs=5.0 * error)
    exact = curve.expected_apr(fixed_latency(fixed_s))
    assert exact == pytest.approx(float(curve.apr(fixed_s)))


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


@given(cases(), st.integers(0, 300).map(lambda ms: ms / 1000.0))
def test_of_a_fixed_budget_expected_and_worst_are_one(case, latency_s):
    axis, vut, units, own_s = case
    budget = fixed_latency(latency_s)
    for curve in apr_by_latency(_evaluation(axis, vut, units, own_s), RULE).values():
        assert curve.expected_apr(budget) == pytest.approx(float(curve.apr(latency_s)))


def test_without_weight_there_is_no_expectation_and_curves_cannot_be_changed():
    curve = curve_of([0.1], [0.0])
    assert math.isnan(curve.expected_apr(load_latency_budget()))
    with pytest.raises(ValueError, match="read-only"):
        curve.weight[0] = 1.0


@pytest.mark.parametrize("latency_s", [-0.1, math.nan, math.inf])
def test_a_latency_of_the_vut_that_cannot_be_is_told(frame_axis, latency_s):
    evaluation = _evaluation(frame_axis, np.zeros(10), [np.zeros(10)])
    with pytest.raises(InputError, match=r"vut_latency_s: got .*; expected seconds, at least 0"):
        apr_by_latency(evaluation, RULE, vut_latency_s=latency_s)


# ---------- with a score


@given(
    cases(),
    st.integers(0, 2**32 - 1),
    st.integers(0, 1200).map(lambda ms: ms / 1000.0 + 3.0e-5),
    st.integers(1, 4),
    st.sampled_from([0.1, 0.2, 0.35, math.inf]),
)
def test_a_score_by_latency_is_that_of_the_onsets_with_that_latency(
    case, seed, latency_s, n_confirmations, memory_s
):
    axis, vut, units, own_s = case
    rng = np.random.default_rng(seed)
    more = rng.integers(0, 3, axis.n_runs)
    last = axis.last_brake_time_s
    levels = Levels(
        score="made up",
        run_index=np.arange(axis.n_runs).repeat(more + 1),
        below_kmh=np.concatenate([10.0 * np.arange(n + 1) for n in more]),
        gain=np.concatenate([np.full(n + 1, 1.0 / (n + 1)) for n in more]),
        deadline_s=np.concatenate(
            [
                [at, *np.sort(rng.uniform(at, 0.1, n))]
                for at, n in zip(last.tolist(), more.tolist(), strict=True)
            ]
        ),
    )
    memory_rule = replace(RULE, n_confirmations=n_confirmations, track_memory_s=memory_s)
    evaluation = replace(_evaluation(axis, vut, units, own_s), levels=levels)
    delays = [latency_s if value is None else value for value in own_s]
    moments = np.concatenate([levels.deadline_s, last])
    for each_s in (latency_s, *delays):
        slack = np.abs(moments[:, None] - axis.time_s - each_s)
        assume((slack > 10.0 * TOLERANCE_S).all())
    age = np.abs(last[:, None] - axis.time_s - latency_s - memory_s)
    assume((age > 10.0 * TOLERANCE_S).all())
    fused = list(zip(units, delays, strict=True))
    parties = {
        "vut": [(vut, latency_s)],
        "rsu_all": fused,
        "vut_and_rsus": [*fused, (vut, latency_s)],
    }
    curves = apr_by_latency(evaluation, memory_rule)
    for name, party in parties.items():
        onsets = find_onsets(
            earliest_arrival_s([(np.array(seen, dtype=bool), late) for seen, late in party], axis),
            axis,
            rule=replace(memory_rule, latency_s=latency_s),
        )
        counts = levels.of_onsets(onsets.onset_s, TOLERANCE_S)
        assert float(curves[name].apr(latency_s)) == pytest.approx(counts @ axis.weight), name
