"""From detected frames to collisions avoided, against the bodies' own motion."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from dragged import has_contact
from hypothesis import given, settings
from hypothesis import strategies as st

from placement.candidates import CandidatePose
from placement.detection_table import pack_table
from placement.evaluation import apr as evaluated_apr
from placement.evaluation import run_outcomes
from placement.evaluator import evaluate as judge_module
from placement.evaluator.evaluate import Judge
from placement.optimiser import Limits, PlacementProblem, apr
from scenarios.aeb import find_contacts, load_aeb_rule
from scenarios.confirmation import is_in_time
from scenarios.runs import build_frame_axis, find_onsets, live_confirmation_times_s
from scenarios.weights import weight_per_run

RULE = load_aeb_rule()


@pytest.fixture(scope="module")
def axis(study_runs):
    """Frames of the study's runs."""
    return build_frame_axis(study_runs, weight_per_run(study_runs))


@pytest.fixture(scope="module")
def judge(study_runs, axis):
    """Judges the study's runs by the study's rule."""
    return Judge(study_runs, axis, RULE)


def _rows(axis, seed, n_rows):
    """Random detections, (n_rows, n_frames)."""
    rng = np.random.default_rng(seed)
    drawn = rng.random((n_rows, axis.n_frames))
    share = rng.uniform(0.05, 0.6)
    return drawn < share


@given(seed=st.integers(0, 2**32 - 1), latency_s=st.floats(0.0, 1.0))
def test_avoided_is_no_contact_and_agrees_with_the_last_brake_time(
    study_runs, axis, judge, seed, latency_s
):
    (row,) = _rows(axis, seed, 1)
    last_brake_time_s = np.full(axis.n_runs, np.inf)
    endless = replace(axis, last_brake_time_s=last_brake_time_s)

    verdict = judge.verdicts([[(row, latency_s)]])[0]
    confirmation_s = live_confirmation_times_s(row, endless, rule=RULE)
    touches = _touches(study_runs, verdict.onset_time_s, RULE)
    in_time = is_in_time(confirmation_s, axis.last_brake_time_s, latency_s=latency_s)
    expected_s = pytest.approx(confirmation_s + latency_s)

    assert np.array_equal(verdict.confirmation_time_s, confirmation_s)
    assert verdict.onset_time_s == expected_s
    assert (verdict.is_avoided == ~touches).all()
    assert (verdict.is_avoided == in_time).all()
    assert (verdict.detected == row).all()


@given(seed=st.integers(0, 2**32 - 1))
def test_equally_fast_parties_are_one_that_sees_what_any_of_them_sees(
    axis, judge, seed
):
    rows = _rows(axis, seed, 3)
    parties = [(row, RULE.latency_s) for row in rows]
    fused = judge.verdicts([parties])[0]
    by_any = rows.any(axis=0)
    party = (by_any, RULE.latency_s)
    one = judge.verdicts([[party]])[0]

    for field in ("detected", "confirmation_time_s", "onset_time_s", "is_avoided"):
        expected = getattr(one, field)
        found = getattr(fused, field)
        assert np.array_equal(found, expected)


@given(
    seed=st.integers(0, 2**32 - 1),
    latencies_s=st.lists(st.floats(0.0, 0.5), min_size=3, max_size=3),
)
def test_a_further_party_never_makes_it_later(axis, judge, seed, latencies_s):
    rows = _rows(axis, seed, 3)
    parties = list(zip(rows, latencies_s, strict=True))
    fewer = judge.verdicts([parties[:2]])[0]
    more = judge.verdicts([parties])[0]

    assert (more.onset_time_s <= fewer.onset_time_s).all()
    assert (more.is_avoided >= fewer.is_avoided).all()
    assert (more.detected >= fewer.detected).all()


def _touches(runs, onsets_s, rule):
    """Do the bodies of each run touch when braking sets in then? (n_runs,)"""
    return np.array(
        [
            has_contact(run.encounter, onset_s, rule)
            for run, onset_s in zip(runs, onsets_s.tolist(), strict=True)
        ]
    )


@pytest.mark.parametrize("memory_s", [0.1, 0.5, 1.0])
def test_what_is_lost_again_is_not_avoided_and_all_else_is_asked_of_the_bodies(
    study_runs, axis, memory_s
):
    rule = replace(RULE, track_memory_s=memory_s)
    judge = Judge(study_runs, axis, rule)
    outcomes = set()
    early_of_runs = [run.time_s < run.time_s[0] + 1.95 for run in study_runs]
    early = np.concatenate(early_of_runs)

    for row in [early, *_rows(axis, 7, 10)]:
        party = [(row, rule.latency_s)]
        verdict = judge.verdicts([party])[0]
        is_live = verdict.is_avoided
        live_s = live_confirmation_times_s(row, axis, rule=rule)
        touches = _touches(study_runs, verdict.onset_time_s, rule)
        arrival_s = np.where(row, axis.time_s + rule.latency_s, np.inf)
        first = find_onsets(arrival_s, axis, rule=RULE)  # never lost
        words = run_outcomes(verdict, axis)
        outcomes |= set(words)
        expected = np.isfinite(live_s)

        assert np.array_equal(is_live, expected)
        assert np.array_equal(verdict.confirmation_time_s[is_live], live_s[is_live])
        assert np.array_equal(is_live, ~touches)
        assert (verdict.onset_time_s >= first.onset_s).all()

        for run, word in enumerate(words):
            is_confirmed = np.isfinite(first.onset_s[run])
            is_dropped = np.isinf(verdict.onset_time_s[run])
            frames = axis.frames_of(run)
            is_seen = row[frames].any()

            assert (word == "avoided") == is_live[run]
            assert (word == "lost again") == (first.is_in_time[run] and is_dropped)
            assert (word in ("never seen", "never confirmed")) == (not is_confirmed)
            assert (word == "never seen") == (not is_seen)

    assert "avoided" in outcomes
    assert "lost again" in outcomes


def test_nobody_confirms_nothing(axis, judge):
    verdict = judge.verdicts([[]])[0]

    assert not verdict.detected.any()
    assert np.isinf(verdict.onset_time_s).all()
    assert not verdict.is_avoided.any()


def test_as_many_frames_confirm_as_the_rule_says(study_runs, axis):
    row = np.zeros(axis.n_frames, dtype=bool)
    row[5:9] = True

    for n_confirmations, frame in (
        (1, 5),
        (2, 6),
        (4, 8),
        (5, None),
    ):
        rule = replace(RULE, n_confirmations=n_confirmations)
        (onset_s, *others) = (
            Judge(study_runs, axis, rule).verdicts([[(row, 0.1)]])[0].onset_time_s
        )

        assert onset_s == (np.inf if frame is None else axis.time_s[frame] + 0.1)
        assert np.isinf(others).all()


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), memory_s=st.sampled_from([0.3, 1.0, np.inf]))
def test_bodies_avoid_what_the_table_says_at_least(study_runs, axis, seed, memory_s):
    rule = replace(RULE, track_memory_s=memory_s)
    judge = Judge(study_runs, axis, rule)
    rows = _rows(axis, seed, 2)
    parties = [(row, rule.latency_s) for row in rows]
    verdict = judge.verdicts([parties])[0]
    v = axis.vut_speed_kmh
    agrees = (verdict.impact_speed_kmh == 0.0) == verdict.is_avoided

    assert agrees.all()
    assert (verdict.impact_speed_kmh <= v + 1e-9).all()

    never = np.isinf(verdict.onset_time_s)

    assert verdict.impact_speed_kmh[never] == pytest.approx(v[never])

    table = pack_table(("a", "b"), axis, rows)
    problem = PlacementProblem(
        table=table,
        limits=Limits(site_index=[0, 1], site_capacity=[1, 1], budget_units=2),
        fusion="any",
        rule=rule,
    )

    by_bodies = evaluated_apr(verdict, axis)
    by_table = apr(problem, [0, 1])

    # Of a run whose contact ends with a later onset and begins again, the table knows
    # less.
    assert by_bodies >= by_table - 1e-12


def test_contact_is_looked_for_once_per_run_and_onset(study_runs, axis, monkeypatch):
    asked = []

    def count(encounter, onset_s, rule):
        asked.extend(onset_s)
        return find_contacts(encounter, onset_s, rule)

    monkeypatch.setattr(judge_module, "find_contacts", count)
    judge = Judge(study_runs, axis, RULE)
    row = np.ones(axis.n_frames, dtype=bool)
    first, again = (judge.verdicts([[(row, 0.025)]])[0] for _ in range(2))

    assert len(asked) == axis.n_runs
    assert np.array_equal(first.is_avoided, again.is_avoided)

    judge.verdicts([[(row, 0.05)]])[0]

    assert len(asked) == 2 * axis.n_runs


@pytest.mark.parametrize(
    ("own_s", "expected_s"),
    [
        (None, RULE.latency_s),
        (0.0, 0.0),
        (0.3, 0.3),
    ],
)
def test_a_unit_has_its_own_latency_or_that_of_the_rule(camera, own_s, expected_s):
    unit = CandidatePose(
        id="a",
        site_id="",
        pose=SimpleNamespace(),
        sensor=camera,
        latency_s=own_s,
    )
    assert unit.latency(RULE) == expected_s
