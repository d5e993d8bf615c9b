"""The study's cases beside another question: the same as if they were asked about."""

import math
from dataclasses import replace

import numpy as np
import pytest

from experiments.parts import study_cases
from experiments.parts.study_cases import (
    build_study_cases,
    is_same_question,
    judge_again,
    on_study_cases,
    score_on,
    study_question,
    study_rows,
)
from placement.compute import Compute
from placement.evaluator import evaluate_layouts
from placement.evaluator.evaluate import Judge
from placement.layout import Layout, load_carlancap_layout
from placement.question import Question
from placement.setting import build_setting
from scenarios.runs import build_frame_axis
from scenarios.weights import weight_per_case

ASKED = Question(
    cases="CPNC-50,CBNA",
    along_arms="0,15",
    speeds="50-60",
    approaches="east,south",
    weights="case",
    track_memory_s=0.3,
)
PART = replace(
    ASKED, cases="CBNA", along_arms="0", speeds="60", weights="run", track_memory_s=math.inf
)
COMPUTE = Compute(workers=2)


@pytest.fixture(scope="module")
def asked():
    return build_setting(ASKED)


@pytest.fixture(scope="module")
def part():
    return build_setting(PART)


@pytest.fixture(scope="module")
def layouts():
    units = load_carlancap_layout().units
    return [Layout(name="two", units=units[2:4]), Layout(name="one", units=units[8:9])]


@pytest.fixture(scope="module")
def evaluations(asked, layouts):
    return dict(zip("ab", evaluate_layouts(layouts, asked, compute=COMPUTE), strict=True))


@pytest.fixture(scope="module")
def expected(part, layouts):
    """What an evaluation says that is asked about these cases alone."""
    return dict(zip("ab", evaluate_layouts(layouts, part, compute=COMPUTE), strict=True))


def test_frames_that_were_looked_at_are_judged_again(
    asked, part, evaluations, expected, monkeypatch
):
    monkeypatch.setattr(study_cases, "evaluate_layouts", pytest.fail)
    rows = np.array([asked.axis.run_ids.index(name) for name in part.axis.run_ids])
    record = score_on(part, asked, rows, evaluations, compute=COMPUTE)
    assert record == build_study_cases(expected)
    assert [party.name for party in record.parties] == ["a", "b", "VUT alone"]
    assert record.runs == part.axis.n_runs == 2
    # They are judged by another rule: the same frames do not make the same verdicts.
    for item, again in zip(evaluations.values(), expected.values(), strict=True):
        frames = [asked.axis.frames_of(row) for row in rows]
        for (name, verdict), kept in zip(again.units.items(), item.units.values(), strict=True):
            seen = np.concatenate([kept.detected[where] for where in frames])
            assert np.array_equal(seen, verdict.detected), name


def test_runs_that_were_not_driven_are_looked_at(asked, layouts, evaluations):
    more = build_setting(replace(PART, speeds="55,60", approaches="north"))
    record = score_on(more, asked, None, evaluations, compute=COMPUTE)
    fresh = dict(zip("ab", evaluate_layouts(layouts, more, compute=COMPUTE), strict=True))
    assert record == build_study_cases(fresh)


def test_what_is_left_to_chance_is_drawn_as_if_it_were_asked_about(layouts):
    given = {"detector": "response"}
    asked, part = (build_setting(replace(one, **given)) for one in (ASKED, PART))
    known = dict(zip("ab", evaluate_layouts(layouts, asked, compute=COMPUTE), strict=True))
    fresh = dict(zip("ab", evaluate_layouts(layouts, part, compute=COMPUTE), strict=True))
    rows = np.array([asked.axis.run_ids.index(name) for name in part.axis.run_ids])
    record = score_on(part, asked, rows, known, compute=COMPUTE)
    assert record == build_study_cases(fresh)


def test_nothing_is_said_twice(asked, part, expected):
    same = on_study_cases(PART, part, expected, build=lambda question: part, compute=COMPUTE)
    assert same is None
    assert not is_same_question(asked, part)
    assert not is_same_question(part, replace(part, rule=replace(part.rule, latency_s=0.2)))
    heavy = replace(part.axis, weight=np.array([0.9, 0.1]))
    assert not is_same_question(part, replace(part, axis=heavy))


def test_the_block_is_shown_of_the_studys_cases_at_its_junction_alone(asked, monkeypatch):
    monkeypatch.setattr(study_cases, "study_rows", lambda *given: None)
    monkeypatch.setattr(study_cases, "score_on", lambda *given, **options: "told")

    def told(setting, **changes):
        return on_study_cases(
            Question(**changes), setting, {}, build=lambda question: asked, compute=COMPUTE
        )

    other_rule = replace(asked, rule=replace(asked.rule, latency_s=0.2))
    elsewhere = replace(other_rule, scene=replace(asked.scene, name="elsewhere"))
    assert told(other_rule) == told(other_rule, cases="all", speeds="20-40") == "told"
    assert told(other_rule, cases="CPLA-50") is None
    assert told(other_rule, cases="protocol-4.5.1") is None
    assert told(elsewhere) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"cases": "CPNC-50,CBNA"},
        {"speeds": "20-60"},
        {"approaches": "east,north,west"},
        {"weather": "night"},
        {"along_arms": "15"},
    ],
)
def test_where_runs_of_the_study_are_left_out_they_are_laid_anew(asked, changes):
    assert study_rows(Question(**changes), asked) is None


def test_the_study_is_asked_about_as_it_drives_and_reads():
    question = Question(
        cases="CPNC-50",
        along_arms="0,30",
        speeds="20",
        approaches="east",
        weather="night,fog",
        weights="case",
        force=True,
        strict=True,
        track_memory_s=1.0,
        detector="response",
        latency_s=0.2,
        scene="scene",
        budget=3,
    )
    assert study_question(question) == Question(
        cases="study",
        track_memory_s=math.inf,
        detector="response",
        latency_s=0.2,
        scene="scene",
        budget=3,
    )


@pytest.fixture(scope="module")
def default():
    """A question along the arms, and in fog, too."""
    question = Question(weather="fog, day", along_arms="45,0")
    setting = build_setting(question)
    return question, setting, study_rows(question, setting)


@pytest.fixture(scope="module")
def study(default):
    return build_setting(study_question(default[0]))


@pytest.mark.long
def test_a_question_along_the_arms_has_all_runs_of_the_study(default, study):
    """So that nobody has to look again."""
    _, asked, rows = default
    assert study.axis.n_runs == 240
    part = study_cases._part(asked, rows)
    assert is_same_question(part, study)
    assert not is_same_question(asked, study)
    for one, other in zip(part.runs, study.runs, strict=True):
        assert np.array_equal(one.vut_position_m, other.vut_position_m)
        assert np.array_equal(one.vru_position_m, other.vru_position_m)
    assert np.array_equal(part.axis.last_brake_time_s, study.axis.last_brake_time_s)


@pytest.mark.long
def test_the_block_is_an_evaluation_of_the_studys_cases_run_by_run(default, study):
    """All 240 runs, among others; by three of the cameras, which see far less than all twelve."""
    _, asked, rows = default
    others = [row for row in range(0, asked.axis.n_runs, 20) if row not in rows]
    kept = np.array(sorted({*rows.tolist(), *others}))
    runs = tuple(asked.runs[row] for row in kept)
    asked = replace(asked, runs=runs, axis=build_frame_axis(runs, weight_per_case(runs)))
    units = load_carlancap_layout().units
    layout = Layout(name="three", units=(units[2], units[5], units[9]))
    judge = Judge(study.runs, study.axis, study.rule)
    (looked,) = evaluate_layouts([layout], asked, compute=COMPUTE)
    (block,) = judge_again([looked], np.searchsorted(kept, rows), study, judge)
    (alone,) = evaluate_layouts([layout], study, compute=COMPUTE)
    assert 0 < alone.rsu_all.is_avoided.sum() < 240
    names = ("vut", "rsu_all", "vut_and_rsus")
    pairs = [(getattr(block, name), getattr(alone, name)) for name in names]
    pairs += [(block.units[name], alone.units[name]) for name in alone.units]
    for one, other in pairs:
        assert np.array_equal(one.is_avoided, other.is_avoided)
        assert np.array_equal(one.detected, other.detected)
        assert np.array_equal(one.confirmation_time_s, other.confirmation_time_s)
    assert build_study_cases({"three": block}) == build_study_cases({"three": alone})
