"""The study's cases beside another question: the same as if they were asked about."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.parts import study_cases
from experiments.parts.study_cases import (
    build_study_cases,
    is_same_question,
    on_study_cases,
    study_question,
)
from placement.compute import Compute
from placement.evaluator import evaluate_layouts
from placement.layout import Layout, load_carlancap_layout
from placement.question import Question
from placement.setting import build_setting

ASKED = Question(
    cases="CPNC-50,CBNA",
    along_arms="0,15",
    speeds="50-60",
    approaches="east,south",
    weights="case",
    track_memory_s=0.3,
)
PART = replace(
    ASKED,
    cases="CBNA",
    along_arms="0",
    speeds="60",
    weights="run",
    track_memory_s=math.inf,
)
COMPUTE = Compute(workers=2)
NOBODY = SimpleNamespace(cases=())


@pytest.fixture(scope="module")
def asked():
    return build_setting(ASKED)


@pytest.fixture(scope="module")
def part():
    return build_setting(PART)


@pytest.fixture(scope="module")
def layouts():
    """Two layouts, of two units and of one."""
    units = load_carlancap_layout().units
    return [Layout(name="two", units=units[2:4]), Layout(name="one", units=units[8:9])]


@pytest.fixture(scope="module")
def evaluations(asked, layouts):
    """Both layouts in the question that is asked."""
    return dict(
        zip("ab", evaluate_layouts(layouts, asked, compute=COMPUTE), strict=True)
    )


@pytest.fixture(scope="module")
def expected(part, layouts):
    """What an evaluation says that is asked about these cases alone."""
    return dict(
        zip("ab", evaluate_layouts(layouts, part, compute=COMPUTE), strict=True)
    )


@pytest.mark.long
def test_layouts_are_evaluated_as_if_the_studys_cases_were_asked_about(
    asked, part, evaluations, expected, monkeypatch
):
    monkeypatch.setattr(study_cases, "select_cases", lambda *words, **options: NOBODY)
    record = on_study_cases(
        ASKED, asked, evaluations, build=lambda _: part, compute=COMPUTE
    )

    assert record == build_study_cases(expected)
    assert [party.name for party in record.parties] == ["a", "b", "VUT alone"]
    assert record.runs == part.axis.n_runs == 2


@pytest.mark.long
def test_nothing_is_said_twice(asked, part, expected):
    same = on_study_cases(
        PART, part, expected, build=lambda question: part, compute=COMPUTE
    )
    assert same is None
    assert not is_same_question(asked, part)
    assert not is_same_question(
        part, replace(part, rule=replace(part.rule, latency_s=0.2))
    )

    heavy = replace(part.axis, weight=np.array([0.9, 0.1]))
    assert not is_same_question(part, replace(part, axis=heavy))


def test_the_block_is_shown_of_the_studys_cases_at_its_junction_alone(
    asked, monkeypatch
):
    monkeypatch.setattr(study_cases, "evaluate_again", lambda *given, **options: [])
    monkeypatch.setattr(study_cases, "build_study_cases", lambda found: "told")

    def told(setting, **changes):
        return on_study_cases(
            Question(**changes),
            setting,
            {},
            build=lambda question: asked,
            compute=COMPUTE,
        )

    other_rule = replace(asked, rule=replace(asked.rule, latency_s=0.2))
    elsewhere = replace(other_rule, scene=replace(asked.scene, name="elsewhere"))

    assert told(other_rule) == told(other_rule, cases="all", speeds="20-40") == "told"
    assert told(other_rule, cases="CPLA-50") is None
    assert told(other_rule, cases="protocol-4.5.1") is None
    assert told(elsewhere) is None


def test_the_study_is_asked_about_as_it_drives_and_reads():
    question = Question(
        cases="CPNC-50",
        along_arms="0,30",
        speeds="20",
        approaches="east",
        weather="night,fog",
        weights="stats19:FILE",
        near="51,0",
        accidents_within_m=100.0,
        case_range="extended",
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
