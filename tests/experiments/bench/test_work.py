"""The main job does no more than ``results/work.json`` allows."""

from pathlib import Path

import pytest
from json_files import read_json

from experiments.bench.work import (
    QUESTIONS,
    WorkCounter,
    count_in_new_process,
    exceeded,
)

LIMITS = Path(__file__).parents[3] / "results/work.json"


def limits(question):
    """Most work that a question may take."""
    return read_json(LIMITS)["most"][question]


@pytest.mark.long
@pytest.mark.parametrize("question", QUESTIONS)
def test_the_main_job_does_no_more_than_it_did(question):
    counts = count_in_new_process(question)
    assert counts.keys() == limits(question).keys()
    assert exceeded(counts, limits(question)) == []


def test_every_question_has_limits_of_every_count():
    names = {question: set(limits(question)) for question in QUESTIONS}
    assert names["small"] == names["whole"]
    assert "modules before the first lines" in names["small"]


@pytest.mark.parametrize(
    ("name", "share"),
    [
        ("rays", 1.3),
        ("figures", 2.0),
        ("modules before the first lines", 1.1),
    ],
    ids=["30 % more rays", "a second drawing", "a heavy import"],
)
def test_a_loss_is_named_with_both_numbers(name, share):
    most = limits("small")
    counts = most | {name: round(share * most[name])}
    assert exceeded(counts, most) == [
        f"{name}: {counts[name]:,}, allowed are {most[name]:,}"
    ]


def test_a_count_without_a_limit_is_named():
    assert exceeded({"new": 1}, {}) == ["new: 1, but there is no limit"]


def test_calls_and_results_are_counted_and_functions_work_as_before():
    class Caster:
        def cast(self, rays, bodies):
            return [0.0] * len(rays)

    counter = WorkCounter()
    before = counter.watch(
        Caster, "cast", lambda found, _, rays, bodies: {"rays": len(rays)}
    )
    with before:
        after = counter.watch(
            Caster, "cast", lambda found, *_, **__: {"hits": len(found)}
        )
        with after:
            assert Caster().cast([1, 2], None) == [0.0, 0.0]
            Caster().cast([1], bodies=None)
    Caster().cast([1], None)

    assert counter.counts == {"rays": 3, "hits": 3}
