import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused_with
from strategies import KMH, build_encounter, encounters, numbers

from geometry.actors import load_actors
from scenarios.aeb import find_contacts, last_brake_time_s, last_onsets_s, load_aeb_rule
from scenarios.cases import load_cases
from scenarios.scores import (
    AVOIDED,
    RATING_2026,
    bands_kmh,
    build_levels,
    load_criteria,
)

RULE = load_aeb_rule()
A_MPS2 = RULE.deceleration_mps2


@pytest.mark.parametrize("vut_kmh", [10, 20, 40, 60, 80])
@pytest.mark.parametrize(
    "case", ["CPNA", "CBFA", "CPTAfs & CPTAns", "CMCscp", "CCRs", "CBNAO"]
)
def test_bands_are_those_of_euro_ncaps_own_package(case, vut_kmh):
    rating = pytest.importorskip(
        "euroncap_rating_2026.crash_avoidance.matrix_processing"
    )
    names = rating.data_model.TOTAL_SCORES
    if case in names:
        own = case
    else:
        own = f"{case} day"
    ours = bands_kmh(RATING_2026, re.split(" ", case)[0] + "-50", vut_kmh)
    for speed_kmh in [0.0, 0.5, 9.99, 10.0, 15.0, 19.9, 20.0, 29.9, 30.0, 45.0]:
        point = rating.TestPoint(
            row=0,
            col=0,
            color=rating.common.PredictionColor.RED,
            test_range=rating.TestRange.STANDARD,
            attributes={"VUT speed": f"{vut_kmh} km/h", "Function": "AEB"},
        )
        computed = rating.ComputedTestPoint(point, test_name=own, value=speed_kmh)
        colour = rating.TestPoint(
            row=0,
            col=0,
            color=computed.measured_color,
            test_range=rating.TestRange.STANDARD,
        )
        counted = max(
            (share for below, share in ours if speed_kmh < below), default=0.0
        )
        if speed_kmh == 0.0:
            counted = ours[0][1]  # the package's word for avoided
        assert counted == colour.predicted_score


def test_all_our_protocol_cases_are_judged_by_one_criterion():
    criteria = load_criteria(RATING_2026)
    named = [name for criterion in criteria for name in criterion.cases]
    assert len(set(named)) == len(named)
    for name in load_cases():
        assert {name, name.partition("-")[0]} & set(named), name


@pytest.mark.parametrize(
    ("case", "n_bands"),
    [
        ("CPLA-50", 4),
        ("CPLA-2026-25", 4),
        ("CPLA-25", 1),
        ("CPLA-FCW-2026-25", 1),
        ("CMCscp-far", 1),
        ("CMRs-FCW-25", 4),
        ("CCRb-2026-m25", 4),
    ],
)
def test_the_longest_beginning_of_a_cases_name_decides(case, n_bands):
    assert len(bands_kmh(RATING_2026, case, 60.0)) == n_bands


def test_avoided_has_no_levels_and_other_words_are_refused(crossing_runs):
    assert load_criteria(AVOIDED) == ()
    assert build_levels(crossing_runs, AVOIDED, RULE) is None
    with refused_with("score: got 'good'; expected one of avoided, rating-2026"):
        load_criteria("good")


def test_head_on_counts_by_what_braking_has_taken():
    assert bands_kmh(RATING_2026, "CCFhos", 50.0) == (
        (0.0, 1.0),
        (30.0, 1.0),
        (40.0, 0.5),
    )
    oncoming = bands_kmh(RATING_2026, "CCFhos", 50.0, unbraked_kmh=120.0)
    assert oncoming == ((0.0, 1.0), (100.0, 1.0), (110.0, 0.5))
    assert bands_kmh(RATING_2026, "my own", 50.0) == ((0.0, 1.0),)


# ---------- last onsets of levels


@given(numbers(31.0, 60.0))
def test_deadlines_on_a_crossing_are_those_of_constant_deceleration(vut_kmh):
    v = vut_kmh * KMH
    # Slow enough to be in the way all the time.
    encounter = build_encounter(
        vru=load_actors()["adult"],
        vut_speed_mps=v,
        vru_speed_mps=0.5,
        angle_deg=90.0,
        touch=0.0,
    )
    limits = np.array([10.0, 20.0, 30.0]) * KMH
    found = last_onsets_s(
        encounter,
        RULE,
        below_mps=limits,
        avoids_until_s=last_brake_time_s(encounter, RULE),
    )
    assert found == pytest.approx(-(v**2 - limits**2) / (2.0 * A_MPS2 * v), abs=2e-5)


@settings(max_examples=20)
@given(encounters(), st.lists(numbers(0.0, 1.0), min_size=1, max_size=4))
def test_every_onset_up_to_a_deadline_leaves_less_and_the_next_one_does_not(
    encounter, shares
):
    last_s = last_brake_time_s(encounter, RULE)
    limits = np.array([10.0, 20.0, 30.0]) * KMH
    found = last_onsets_s(encounter, RULE, below_mps=limits, avoids_until_s=last_s)
    assert (found >= last_s).all()
    assert (np.diff(found) >= 0.0).all()
    for limit, deadline_s in zip(limits, found.tolist(), strict=True):
        onsets_s = [last_s + share * (deadline_s - last_s) for share in (*shares, 1.0)]
        unbraked = find_contacts(encounter, 0.0, RULE).closing_mps
        if deadline_s < 0.0:
            assert (find_contacts(encounter, onsets_s, RULE).closing_mps < limit).all()
            after = find_contacts(encounter, deadline_s + 2e-5, RULE).closing_mps
            assert after >= limit
        else:
            assert unbraked < limit or last_s == 0.0


def test_an_impact_as_fast_as_a_limit_without_braking_is_not_below_it():
    # Behind a cyclist of 20 km/h with 30 km/h: the band below 10 km/h asks for braking.
    encounter = build_encounter(
        vru=load_actors()["cyclist"],
        vut_speed_mps=30.0 * KMH,
        vru_speed_mps=20.0 * KMH,
        angle_deg=0.0,
        touch=0.0,
    )
    case = SimpleNamespace(name="CBLA-50")
    run = SimpleNamespace(
        case=case,
        encounter=encounter,
        vut_speed_kmh=30.0,
        last_brake_time_s=last_brake_time_s(encounter, RULE),
    )
    levels = build_levels([run], RATING_2026, RULE)
    assert levels.below_kmh.tolist() == [0.0, 10.0]
    assert levels.deadline_s[1] == pytest.approx(0.0, abs=2e-5)
    unbraked = find_contacts(encounter, [np.inf], RULE)
    nothing = levels.of_speeds(unbraked.closing_mps / KMH, np.array([False]))
    assert nothing.tolist() == [0.0]


def test_a_start_too_close_for_a_level_is_minus_infinity():
    encounter = build_encounter(
        vru=load_actors()["adult"],
        vut_speed_mps=60.0 * KMH,
        vru_speed_mps=0.5,
        angle_deg=90.0,
        touch=0.0,
        vut_drive_s=0.85,
    )
    assert last_brake_time_s(encounter, RULE) == -np.inf
    found = last_onsets_s(
        encounter, RULE, below_mps=[10 * KMH, 30 * KMH], avoids_until_s=-np.inf
    )
    assert found[0] == -np.inf
    assert found[1] == pytest.approx(-0.8096, abs=1e-3)


def test_levels_say_what_speeds_and_onsets_count(crossing_runs):
    levels = build_levels(crossing_runs, RATING_2026, RULE)
    assert levels is not None
    n_runs = len(crossing_runs)
    assert np.array_equal(np.unique(levels.run_index), np.arange(n_runs))
    assert np.bincount(levels.run_index, weights=levels.gain) == pytest.approx(
        np.ones(n_runs)
    )
    onsets_s = np.linspace(-1.5, 0.2, 40)[:, None] * np.ones(n_runs)
    contacts = [
        find_contacts(run.encounter, column, RULE)
        for run, column in zip(crossing_runs, onsets_s.T, strict=True)
    ]
    closing_kmh = np.stack([found.closing_mps for found in contacts], axis=1) / KMH
    is_avoided = np.stack([np.isinf(found.time_s) for found in contacts], axis=1)
    by_speed = levels.of_speeds(closing_kmh, is_avoided)
    by_bands = [
        [
            (
                1.0
                if is_avoided[row, column]
                else max(
                    (
                        share
                        for below, share in bands_kmh(
                            RATING_2026, run.case.name, run.vut_speed_kmh
                        )
                        if closing_kmh[row, column] < below
                    ),
                    default=0.0,
                )
            )
            for column, run in enumerate(crossing_runs)
        ]
        for row in range(len(onsets_s))
    ]
    assert by_speed == pytest.approx(np.array(by_bands))
    assert len(np.unique(by_speed)) == 5  # all colours
    # Later onsets may leave less; none before the deadline leaves more.
    assert (levels.of_onsets(onsets_s, 0.0) <= by_speed + 1e-12).all()
    assert (levels.of_onsets(onsets_s, 0.0) == by_speed).mean() > 0.9
