"""Which runs a question drives, by which rule, in which weathers."""

import logging
import math
from dataclasses import replace

import numpy as np
import pytest
from junctions import build_scene, lanes_of
from refusals import refused_with

import placement.setting
from experiments.cli.scenarios import list_rows, scenario_table
from geometry.errors import InputError
from geometry.study_scene import load_study_scene
from placement.compute import Compute
from placement.detectors import load_planning_detector
from placement.fingerprints import Fingerprints
from placement.question import Question
from placement.setting import Radio, build_rule, build_setting, drive, drive_one
from scenarios.aeb import load_aeb_rule, load_track_memory_s
from scenarios.cases import load_case_sets


def t_junction():
    """No northern arm."""
    lanes = [
        lane
        for arm, bearing in (
            ("east", 0.0),
            ("west", 180.0),
            ("south", 270.0),
        )
        for lane in lanes_of(arm, bearing)
    ]
    return build_scene(lanes)


@pytest.fixture(scope="module")
def study():
    """The study's runs."""
    return drive(Question(cases="study"), load_study_scene())


@pytest.mark.long
def test_all_cases_of_the_study_are_driven_from_all_approaches(study):
    assert not study.refused

    driven = {(run.case.name, run.approach) for run in study.runs}
    names = [case.name for case in load_case_sets()["study"]]

    expected = {(n, a) for n in names for a in ("north", "east", "south", "west")}

    assert driven == expected
    assert len(study.runs) == 240
    assert {run.position for run in study.runs} == {"0"}


@pytest.mark.long
def test_by_default_the_studys_cases_are_driven_along_the_arms_too(study):
    question = Question(approaches="west")

    setting = build_setting(question, load_study_scene())
    at_zero = [run.id for run in setting.runs if run.position == "0"]

    assert at_zero == [run.id for run in study.runs if run.approach == "west"]

    others = set(setting.axis.positions) - {"0"}

    assert others == {"-15", "-30", "+0", "+15", "+30", "+45"}
    assert {refusal.position for refusal in setting.refusals} == {
        "-15",
        "-30",
        "-45",
        "+0",
    }

    # Every case counts by what of it is driven, and in it every place; with the study's
    # set every run counts the same.
    cases = np.array(setting.axis.cases)
    weight = setting.axis.weight
    shares = {name: weight[cases == name].sum() for name in set(cases)}
    refused = {refusal.case.name for refusal in setting.refusals}
    whole = [share for name, share in shares.items() if name not in refused]

    assert sum(shares.values()) == pytest.approx(1.0)

    expected = [max(shares.values())] * len(whole)

    assert whole == pytest.approx(expected)
    assert min(shares[name] for name in refused) < whole[0]

    there = weight[(cases == "CPLA-50") & (np.array(setting.axis.positions) == "+15")]

    assert there == pytest.approx([there[0]] * 3)

    plain = build_setting(
        Question(cases="study", approaches="west"), load_study_scene()
    )

    assert plain.axis.weight == pytest.approx([1 / 60] * 60)


@pytest.mark.long
def test_a_map_bounds_the_speeds_unless_others_are_asked_for():
    free = t_junction()
    lanes = tuple(replace(lane, speed_limit_kmh=30.0) for lane in free.lanes)
    slow = replace(free, lanes=lanes)

    def speeds(scene, asked):
        drives = drive(
            Question(cases="CPNA-25,CPLA-25", speeds=asked, along_arms="0"), scene
        )
        return sorted({run.vut_speed_kmh for run in drives.runs}), drives

    bounded, drives = speeds(slow, "")

    assert bounded[-1] == 30.0
    assert {one.limit_kmh for one in drives.refused} == {30.0}

    table = scenario_table(list_rows(drives))

    assert "faster than the speed limit of 30 km/h" in " ".join(table.split())
    assert speeds(slow, "all")[0] == speeds(free, "all")[0] == speeds(free, "")[0]
    assert speeds(slow, "20,50")[0] == [20.0, 50.0]
    assert drive_one(Question(cases="CPNA-25", approaches="east", speeds="60"), slow)
    assert all(lane.speed_limit_kmh is None for lane in load_study_scene().lanes)


@pytest.mark.long
def test_runs_of_an_earlier_call_are_those_that_would_be_laid(tmp_path, monkeypatch):
    question = Question(cases="CPNC-50,CPLA-50,CBTAfs-100", approaches="west")
    scene = load_study_scene()
    compute = Compute(cache_folder=tmp_path)
    laid = build_setting(question, scene, compute=compute)
    monkeypatch.setattr(placement.setting, "build_runs", pytest.fail)

    kept = build_setting(question, scene, compute=compute)

    hash_of = Fingerprints().of

    assert len(laid.runs) == len(kept.runs) > 0
    assert hash_of(kept.runs, kept.axis) == hash_of(laid.runs, laid.axis)

    expected = [repr(one) for one in laid.refusals]

    assert [repr(one) for one in kept.refusals] == expected
    assert len(laid.refusals) > 0

    monkeypatch.undo()
    asked = (
        replace(question, deceleration_mps2=6.0),
        replace(question, speeds="20"),
    )

    for other in asked:
        found = build_setting(other, scene, compute=compute)
        assert hash_of(found.runs) == hash_of(build_setting(other, scene).runs)


@pytest.mark.long
def test_how_far_along_the_arms_is_chosen():
    question = Question(cases="CPNA-25", approaches="north", along_arms="0, 20")

    runs = drive(question, load_study_scene()).runs

    assert {run.position for run in runs} == {"0", "-20", "+0", "+20"}
    assert len({run.id for run in runs}) == len(runs)

    bound = drive(
        replace(question, cases="CBNA", along_arms="20"), load_study_scene()
    ).runs

    assert {run.position for run in bound} == {"0"}

    nowhere = replace(question, cases="CPNA-25,CPLA-50", along_arms="400")

    with refused_with(
        "cases: got CPNA-25, which no approach carries; expected a case that can be"
        " driven at town05 (from the north: the mapped lane does not reach that far)"
    ):
        build_setting(nowhere, load_study_scene())


def test_the_rule_is_the_studys_but_for_what_the_question_changes():
    assert build_rule(Question(cases="study")) == load_aeb_rule()

    rule = build_rule(
        Question(
            deceleration_mps2=5.0,
            build_up_s=0.3,
            latency_s=0.0,
            n_confirmations=1,
        )
    )

    assert rule.deceleration_mps2 == 5.0
    assert rule.build_up_s == 0.3
    assert rule.latency_s == 0.0
    assert rule.n_confirmations == 1
    assert rule.frame_rate_hz == load_aeb_rule().frame_rate_hz


def test_tracks_live_as_long_as_asked_and_those_of_the_studys_cases_for_ever():
    default_s = load_track_memory_s()
    for question, memory_s in (
        (Question(cases="study"), math.inf),
        (Question(cases="all"), default_s),
        (Question(cases="CPNC-50"), default_s),
        (Question(cases="study", track_memory_s=0.7), 0.7),
        (Question(cases="CPNC-50", track_memory_s=math.inf), math.inf),
    ):
        assert build_rule(question).track_memory_s == memory_s


def test_weaker_and_slower_brakes_must_begin_earlier():
    def last_s(**options):
        question = Question(
            cases="CPFA-50",
            approaches="east",
            speeds="40",
            **options,
        )
        return drive_one(question, load_study_scene()).last_brake_time_s

    assert last_s(deceleration_mps2=4.0) < last_s() < 0.0
    # Half the build-up time is lost.
    assert last_s(build_up_s=0.4) == pytest.approx(last_s() - 0.2, abs=0.02)


def test_weathers_multiply_the_runs(caplog):
    question = Question(cases="CPTAns-50", weather="day, night,rain,fog")
    with caplog.at_level(logging.WARNING):
        setting = build_setting(question, load_study_scene())

    assert len(setting.runs) == 16
    assert setting.axis.weathers[:4] == ("day", "night", "rain", "fog")
    assert caplog.text == ""


def test_perception_and_radio_are_those_of_the_question():
    def setting_of(**options):
        question = Question(cases="CPTAns-50", approaches="east", **options)
        return build_setting(question, load_study_scene())

    plain = setting_of()

    assert plain.detector == plain.table_detector == load_planning_detector("geometric")
    assert plain.vut_sensors == ("camera",)
    assert plain.radio == Radio()

    other = setting_of(
        detector="response",
        vut_sensors="lidar, camera",
        packet_loss=0.1,
        vam_rate=0.5,
    )
    expected = Radio(packet_loss=0.1, vam_rate=0.5)

    assert other.detector is other.table_detector is load_planning_detector("response")
    assert set(other.vut_sensors) == {"camera", "lidar"}
    assert other.radio == expected


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"approaches": "up"},
            "approaches: got 'up'; expected one or more of east, north",
        ),
        (
            {"weather": ","},
            "weather: got ','; expected names with commas between, each once",
        ),
        (
            {"cases": "CPXX"},
            "cases: got 'CPXX'; expected one of default, study, protocol-4.5.1, ",
        ),
        (
            {"along_arms": "-15"},
            "along_arms: got '-15'; expected metres along the arm, 0 to 500",
        ),
        (
            {"along_arms": "0,15,15"},
            "along_arms: got '0,15,15'; expected every distance once",
        ),
        (
            {"detector": "best"},
            (
                "detector: got 'best'; expected geometric, response, pole-2015,"
                " car-2019, cnn-table, "
            ),
        ),
        (
            {"vut_sensors": ""},
            "vut_sensors: got ''; expected one or more of camera, lidar",
        ),
        (
            {"speeds": "130"},
            "speeds: got 130; expected 10 to 60 km/h as the protocol drives",
        ),
        (
            {"weights": "none"},
            "weights: got 'none'; expected run, case, fhwa-crash-types, ",
        ),
        (
            {"deceleration_mps2": 0.5},
            "deceleration_mps2: got 0.5; expected a number, 1 to 15",
        ),
        (
            {"track_memory_s": 0.05},
            (
                "track_memory_s: got 0.05; expected seconds, at least 0.1 (from one"
                " frame to the next)"
            ),
        ),
    ],
)
def test_questions_that_cannot_be_answered_say_why(options, message):
    few = {
        "cases": "CPNA-25",
        "approaches": "east",
        "along_arms": "0",
    }
    question = Question(**(few | options))

    with pytest.raises(InputError) as caught:
        build_setting(question, load_study_scene())

    refusal = str(caught.value)

    assert refusal.startswith(message)


def test_a_case_that_no_approach_carries_is_told_with_a_reason():
    lanes = [*lanes_of("east", 0.0), *lanes_of("west", 180.0)]
    with refused_with(
        "cases: got CPTAns-50, which no approach carries; expected a case that can"
        " be driven at protocol (from the east, west: no lane leads out of the"
        " junction on the near side)"
    ):
        build_setting(Question(cases="CPTAns-50"), build_scene(lanes))


def test_what_some_approaches_do_not_carry_is_kept_with_its_reason():
    setting = build_setting(Question(cases="CPTAfs-50"), t_junction())

    assert {run.approach for run in setting.runs} == {"east", "south"}

    (refusal,) = setting.refusals

    assert refusal.approach == "west"
    assert refusal.speeds_kmh == (10.0, 15.0, 20.0)


@pytest.mark.long
def test_the_list_has_a_row_per_case_and_approach():
    rows = list_rows(
        drive(Question(cases="CPTAfs-50,CPNA-25", along_arms="0"), t_junction())
    )

    assert [(row.case, row.approach) for row in rows] == [
        ("CPTAfs-50", "east"),
        ("CPTAfs-50", "south"),
        ("CPTAfs-50", "west"),
        ("CPNA-25", "east"),
        ("CPNA-25", "west"),
        ("CPNA-25", "south"),
    ]

    west = rows[2]

    assert west.speeds_kmh == ()
    assert west.n_runs == 0
    assert west.last_brake_time_s == ()
    assert west.reason == "no lane leads out of the junction on the far side"

    crossing = rows[3]

    assert crossing.reason is None
    assert crossing.n_runs == len(crossing.speeds_kmh) == 11

    # Stopping short of the flank: v / (2 a).
    speeds = np.array(crossing.speeds_kmh) / 3.6

    expected = -speeds / (2.0 * 7.72)

    assert crossing.last_brake_time_s == pytest.approx(expected, abs=1e-3)


@pytest.mark.long
def test_the_list_says_where_along_the_arms():
    question = Question(
        cases="CPNA-25,CBNA",
        approaches="north",
        along_arms="0,15,60,100",
    )

    rows = list_rows(drive(question, load_study_scene()))

    assert [(row.case, row.position, row.n_runs) for row in rows] == [
        ("CPNA-25", "-100", 0),
        ("CPNA-25", "-60", 4),
        ("CPNA-25", "-15", 3),
        ("CPNA-25", "0", 11),
        ("CPNA-25", "+0", 3),
        ("CPNA-25", "+15", 4),
        ("CPNA-25", "+60", 4),
        ("CPNA-25", "+100", 0),
        ("CBNA", "0", 9),
    ]

    text = scenario_table(rows)

    assert max(map(len, text.splitlines())) <= 80
    assert "CPNA-25  north  10-60  6 of 8    29" in text

    refused = "CPNA-25 from north (at -100, +100) not driven: the mapped lane does not"

    assert refused in text
    assert text.endswith("38 runs of 2 cases")


def test_speeds_that_a_case_does_not_have_are_listed_as_not_driven():
    drives = drive(
        Question(cases="CPTAns-50,CPNA-25", speeds="40", along_arms="0"),
        load_study_scene(),
    )

    row = list_rows(drives)[-1]

    assert row.case == "CPTAns-50"
    assert row.reason == "this case has none of the requested speeds (40)"

    text = scenario_table(list_rows(drives))

    refused = "south not driven: this case has none of the requested speeds (40)"

    assert refused in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 80
    assert text.endswith("4 runs of 2 cases")


def test_one_run_must_be_named():
    with pytest.raises(
        InputError, match=r"CPNA: got 2 runs \(CPNA-25/east/40, CPNA-75/east/40\)"
    ):
        drive_one(
            Question(cases="CPNA", approaches="east", speeds="40"), load_study_scene()
        )

    with refused_with(
        "CPTAfs-50 from the west: got no lane leads out of the junction on the far"
        " side; expected a case that this approach carries"
    ):
        drive_one(
            Question(cases="CPTAfs-50", approaches="west", speeds="10"), t_junction()
        )


def test_one_run_at_a_position_drives_the_speed_asked_for():
    scene = load_study_scene()
    question = Question(cases="CPLA-50", approaches="east", speeds="35")

    run = drive_one(question, scene, position="-15")

    assert run.id == "CPLA-50/east-15/35"
    assert run.position == "-15"

    with pytest.raises(
        InputError, match="position: got '-15'; expected 0: CBNA is bound to"
    ):
        drive_one(replace(question, cases="CBNA"), scene, position="-15")

    with pytest.raises(
        InputError, match="position: got 'far'; expected 0, or metres before it"
    ):
        drive_one(question, scene, position="far")
