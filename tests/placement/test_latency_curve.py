"""The curve against what one verdict after the other would say."""

import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from seen_frames import seen_evaluation
from strategies import frame_axes
from tiny_worlds import axis_of_runs

from geometry.errors import InputError
from placement.evaluation import earliest_arrival_s
from placement.latency_curves import apr_by_latency
from scenarios.aeb import load_aeb_rule
from scenarios.runs import find_onsets
from scenarios.weights import weight_share

RULE = load_aeb_rule()
TOLERANCE_S = 1.0e-9


def _apr_by_hand(axis, parties, n_confirmations, memory_s=math.inf, latency_s=0.0):
    """Every window of every run, one by one: is it known, and alive, at the last
    moment?
    """
    avoided = 0.0
    for run in range(axis.n_runs):
        end = axis.run_start[run + 1]
        frames = range(axis.run_start[run], end)
        last_brake_s = axis.last_brake_time_s[run]
        known = [
            min(
                (axis.time_s[f] + late for seen, late in parties if seen[f]),
                default=math.inf,
            )
            <= last_brake_s + TOLERANCE_S
            for f in frames
        ]
        times = axis.time_s[frames.start : frames.stop]

        for last in range(n_confirmations - 1, len(known)):
            if not all(known[last - n_confirmations + 1 : last + 1]):
                continue
            later = range(last, len(known))
            stops = [times[f] for f in later if known[f]]
            ends = [*stops, last_brake_s - latency_s]
            gaps = [b - a for a, b in pairwise(ends)]
            if max(gaps) <= memory_s + TOLERANCE_S:
                avoided += axis.weight[run]
                break

    return avoided


@st.composite
def cases(draw):
    """Runs, who sees what, and which units have a latency of their own."""
    axis = draw(frame_axes())
    flag = st.booleans()
    frames = st.lists(flag, min_size=axis.n_frames, max_size=axis.n_frames)
    rows = st.lists(frames, min_size=1, max_size=3)
    units = draw(rows)
    own = [draw(st.one_of(st.none(), st.integers(0, 40))) for _ in units]
    own_s = [None if value is None else value / 100.0 for value in own]
    return axis, draw(frames), units, own_s


def _is_near_a_tie(slack_s):
    """Is a time nearer to another than the tolerance allows, but not equal to it?"""
    is_near = (slack_s > 0.1 * TOLERANCE_S) & (slack_s < 10.0 * TOLERANCE_S)
    return is_near.any()


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
    n_frames = np.diff(axis.run_start)
    last = axis.last_brake_time_s.repeat(n_frames)
    for each_s in (latency_s, vut_latency_s, *own_s):  # no ties but exact ones
        if each_s is not None:
            slack_s = np.abs(last - axis.time_s - each_s)
            is_tied = _is_near_a_tie(slack_s)
            assume(not is_tied)

    slack_after_s = np.abs(last - axis.time_s - latency_s - memory_s)
    is_tied_after = _is_near_a_tie(slack_after_s)
    assume(not is_tied_after)
    rule = replace(RULE, n_confirmations=n_confirmations, track_memory_s=memory_s)
    vam = vut[::-1]
    unseen = np.zeros(axis.n_frames)
    others = {"vam": vam, "all_sources": unseen}
    evaluation = seen_evaluation(
        axis,
        units,
        own_s,
        vut=vut,
        others=others,
    )

    curves = apr_by_latency(
        evaluation,
        rule,
        [latency_s],
        vut_latency_s=vut_latency_s,
    )

    delays = [latency_s if value is None else value for value in own_s]
    vut_delay = (vut, latency_s if vut_latency_s is None else vut_latency_s)
    on_board = [vut_delay]
    pairs = zip(units, delays, strict=True)
    fused = list(pairs)
    by_radio = [(vam, latency_s)]
    parties = {
        "vut": on_board,
        **{f"U{index}": [unit] for index, unit in enumerate(fused)},
        "rsu_all": fused,
        "vut_and_rsus": fused + on_board,
        "vam": by_radio,
        "all_sources": fused + on_board + by_radio,
    }

    assert list(curves) == list(parties)

    rule = replace(rule, latency_s=latency_s)

    for name, party in parties.items():
        expected = _apr_by_hand(
            axis,
            party,
            n_confirmations,
            memory_s,
            latency_s,
        )
        seen = [(np.array(frames), late) for frames, late in party]
        arrival_s = earliest_arrival_s(seen, axis)
        onsets = find_onsets(arrival_s, axis, rule=rule)

        avoided_share = weight_share(onsets.is_in_time, axis.weight)
        share = float(avoided_share)
        found = curves[name].tolist()

        assert share == pytest.approx(expected), name
        assert found == [pytest.approx(expected)], name


def test_a_run_may_be_avoided_with_a_longer_latency_alone():
    """Seen from -2 to -1.6 s: with 0.5 s the track is asked for at -1 s, with none at
    -0.5 s.
    """
    tenths = np.arange(-20, 1)
    time_s = tenths / 10.0
    axis = axis_of_runs(
        [0, 21, 42],
        np.tile(time_s, 2),
        -0.5,
        weight=[0.75, 0.25],
    )
    by_unit = [time_s < -1.55, time_s > -1.55]
    seen = np.concatenate(by_unit)
    rule = replace(RULE, track_memory_s=1.0)
    evaluation = seen_evaluation(axis, [seen])
    latencies_s = [0.09, 0.1, 0.8, 0.81, 1.3, 1.31]

    curves = apr_by_latency(evaluation, rule, latencies_s)
    found = curves["rsu_all"]

    assert found.tolist() == [0.25, 1, 1, 0.75, 0.75, 0]


@pytest.mark.parametrize("latency_s", [-0.1, math.nan, math.inf])
def test_a_latency_of_the_vut_that_cannot_be_is_told(frame_axis, latency_s):
    nothing = np.zeros((1, 10))
    evaluation = seen_evaluation(frame_axis, nothing)

    with pytest.raises(
        InputError,
        match=re.escape(
            f"vut_latency_s: got {latency_s}; expected seconds, at least 0"
        ),
    ):
        apr_by_latency(
            evaluation,
            RULE,
            [0.0],
            vut_latency_s=latency_s,
        )
