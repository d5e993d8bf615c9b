"""The question: its file is read and written, and every field stands in it once."""

import inspect
import math
import tomllib
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometry.errors import InputError
from placement.question import (
    Question,
    load_question,
    load_question_values,
    question_fields,
    save_question,
)


@pytest.fixture
def path(tmp_path):
    """Where the question is written."""
    return tmp_path / "question.toml"


OTHERS = Question(
    budget=3,
    budget_cost=9000.5,
    target="0.99",
    least="cost",
    min_case_apr=0.5,
    survive="2 sites",
    site_cost_eur=500.0,
    time_limit_s=5.0,
    refine=True,
    weather='rain "and" fog',
    latency_s=0.1,
    n_confirmations=2,
    track_memory_s=0.5,
)


@pytest.mark.parametrize(
    "question", [Question(), OTHERS, replace(OTHERS, track_memory_s=math.inf)]
)
def test_a_question_that_is_saved_is_the_one_that_is_loaded(path, question):
    save_question(path, question)
    assert load_question(path) == question


@given(st.text(st.characters(codec="utf-8", exclude_categories=["Cs"])))
def test_any_text_is_read_as_it_was_written(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("question") / "question.toml"
    question = replace(Question(), keep=text)

    save_question(path, question)

    assert load_question(path) == question


def test_a_file_has_what_differs_from_the_default_below_its_description(path):
    save_question(path, replace(Question(), site_cost_eur=500.0, cases="CBNA"))
    text = path.read_text(encoding="utf-8")

    assert tomllib.loads(text) == {"site_cost": 500.0, "cases": "CBNA"}

    lines = text.splitlines()
    above = lines[lines.index("site_cost = 500.0") - 1]

    assert above == "# Of each site that is used, once; default: the scene's."


def test_every_field_is_described_and_has_a_key_of_its_own_name_but_for_the_unit():
    found = question_fields()
    expected = [field.name for field in fields(Question)]

    assert list(found) == expected

    keys = [field.key for field in found.values()]

    assert len(set(keys)) == len(keys)

    for name, field in found.items():
        assert field.description
        assert "--" not in field.description
        assert field.key in name or name == "build_up_s"


def test_a_number_is_taken_where_a_word_may_stand(path):
    path.write_text("target = 0.99\nspeeds = 30\n")
    assert load_question_values(path) == {"target": "0.99", "speeds": "30"}


def test_the_number_of_worlds_may_be_a_word(path):
    save_question(path, replace(Question(), samples="auto"))

    assert path.read_text(encoding="utf-8").endswith('samples = "auto"\n')
    assert load_question(path).samples == "auto"

    with pytest.raises(InputError, match="samples: got 'auto'; expected a number"):
        _ = load_question(path).n_samples


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("budget = 0", "budget: got 0; expected a whole number of units, at least 1"),
        ("fusion = 'all'", "fusion: got 'all'; expected one of any, single"),
        ("latency = nan", "latency: got nan; expected a finite number"),
        (
            "track_memory = 0",
            "track_memory: got 0; expected seconds, more than 0, or inf",
        ),
        (
            "vam_rate = 2",
            "vam_rate: got 2; expected a share of equipped road users, 0 to 1",
        ),
        (
            "samples = 'often'",
            "samples: got 'often'; expected auto, or a number of sampled worlds",
        ),
        ("time_limit = 0", "time_limit: got 0; expected seconds, more than 0"),
        ("refine = 1", "refine: got 1; expected true or false"),
        ("cases = ['CBNA']", "cases: got ['CBNA']; expected text"),
        (
            "latency_s = 1.0",
            "got 'latency_s'; expected one of budget, budget_cost, target, ",
        ),
        ("budget", "got Expected '='"),
    ],
)
def test_what_cannot_be_is_told_with_file_and_key(path, text, message):
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_question(path)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_a_file_that_is_not_there_or_cannot_be_written_is_told(path):
    with pytest.raises(
        InputError, match="No such file or directory; expected a readable file"
    ):
        load_question(path)

    with pytest.raises(InputError, match="expected a file that can be written"):
        save_question(path / "deep", Question())


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"budget": 0},
            "question: budget: got 0; expected a whole number of units, at least 1",
        ),
        (
            {"budget": "3"},
            "question: budget: got '3'; expected a whole number of units",
        ),
        ({"fusion": "all"}, "question: fusion: got 'all'; expected one of any, single"),
        (
            {"latency_s": math.nan},
            "question: latency_s: got nan; expected a finite number",
        ),
        ({"cases": ["CBNA"]}, "question: cases: got ['CBNA']; expected text"),
    ],
)
def test_a_question_checks_its_values_when_it_is_made(values, message):
    with pytest.raises(InputError) as caught:
        Question(**values)
    assert str(caught.value).startswith(message)
    assert Question(track_memory_s=math.inf).track_memory_s == math.inf


def test_a_question_has_help_that_can_be_read():
    words = inspect.getdoc(Question)

    assert "budget : int, optional\n    Most units to mount." in words
    assert "budget=None" in str(inspect.signature(Question))
    assert "Annotated" not in str(inspect.signature(Question))
