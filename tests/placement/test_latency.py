"""Budgets of latency: their sums, draws and files."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from refusals import refused_with
from strategies import numbers

from placement.latency import (
    DEFAULT_LATENCY_BUDGET,
    LatencyBudget,
    LatencyPart,
    fixed_latency,
    load_latency_budget,
    load_latency_budgets,
)
from scenarios.aeb import load_aeb_rule


def _budget(*ranges_s):
    """A budget of parts of these ranges. [s]"""
    parts = [
        LatencyPart(
            name=f"part {index}",
            low_s=low,
            high_s=high,
            source="test",
        )
        for index, (low, high) in enumerate(ranges_s)
    ]
    return LatencyBudget(name="test", parts=tuple(parts))


@st.composite
def budgets(draw, max_parts=4):
    """Fixed values, and ranges from wide to narrow."""
    lows = draw(st.lists(numbers(0.0, 0.2), min_size=1, max_size=max_parts))
    widths = st.one_of(st.just(0.0), numbers(0.001, 0.2))
    return _budget(*((low, low + draw(widths)) for low in lows))


# The budgets that come with us


def test_the_default_is_the_latency_of_the_study():
    budget = load_latency_budget()

    assert budget.name == DEFAULT_LATENCY_BUDGET == "study"
    assert budget.best_s == budget.mean_s == budget.worst_s == 0.025
    assert load_aeb_rule().latency_s == 0.025
    assert [part.is_assumption for part in budget.parts] == [False]


@pytest.mark.parametrize(
    ("name", "period_s"),
    [
        ("cpm-100ms", 0.1),
        ("cpm-50ms", 0.05),
    ],
)
def test_a_message_waits_for_up_to_one_period(name, period_s):
    parts = {part.name: part for part in load_latency_budget(name).parts}

    assert list(parts) == [
        "exposure",
        "detector",
        "CPM generation",
        "radio",
        "decision",
    ]

    wait = parts.pop("CPM generation")

    assert wait.low_s == 0.0
    assert wait.high_s == period_s
    assert wait.is_assumption is False
    assert "TS 103 324" in wait.source
    assert all(part.is_assumption for part in parts.values())


def test_budgets_differ_by_the_wait_alone():
    slow = load_latency_budget("cpm-100ms")
    quick = load_latency_budget("cpm-50ms")

    assert slow.best_s == quick.best_s
    assert slow.mean_s - quick.mean_s == pytest.approx(0.025)
    assert slow.worst_s - quick.worst_s == pytest.approx(0.05)
    assert list(load_latency_budgets()) == ["study", "cpm-100ms", "cpm-50ms"]


# Totals


@given(budgets())
def test_best_mean_and_worst_are_in_order_and_add_up(budget):
    assert budget.best_s <= budget.mean_s <= budget.worst_s
    assert budget.mean_s == pytest.approx(0.5 * (budget.best_s + budget.worst_s))

    expected = sum(part.high_s for part in budget.parts)

    assert budget.worst_s == pytest.approx(expected)


def test_draws_stay_within_and_have_mean_and_variance_of_the_sum():
    budget = load_latency_budget("cpm-100ms")
    drawn = budget.sample_s(default_rng(1), 200_000)

    assert drawn.shape == (200_000,)
    assert budget.best_s <= drawn.min() < drawn.max() <= budget.worst_s

    variance = sum((part.high_s - part.low_s) ** 2 / 12.0 for part in budget.parts)

    assert drawn.mean() == pytest.approx(
        budget.mean_s, abs=5.0 * math.sqrt(variance / 200_000)
    )
    assert drawn.var() == pytest.approx(variance, rel=0.02)


def test_draws_depend_on_the_generator_alone():
    budget = load_latency_budget("cpm-50ms")
    first = budget.sample_s(default_rng(1), (3, 4))
    second = budget.sample_s(default_rng(1), (3, 4))
    other = budget.sample_s(default_rng(2), (3, 4))

    assert first.shape == (3, 4)
    assert (first == second).all()
    assert (first != other).all()

    fixed = load_latency_budget().sample_s(default_rng(0), 5)

    assert fixed.tolist() == [0.025] * 5


# One number for commands that need one


def test_one_number_is_a_budget_of_one_part():
    assert fixed_latency(0.04).worst_s == 0.04


# Files


PART = {
    "name": "'radio'",
    "low_s": "0.001",
    "high_s": "0.01",
    "source": "'a sheet'",
}


@pytest.fixture
def write_budget(tmp_path):
    """Writes a budget of one part with some fields replaced, or removed (...)."""

    def write(text=None, **fields):
        part = {
            key: value for key, value in (PART | fields).items() if value is not ...
        }
        lines = [
            "[mine]",
            "[[mine.parts]]",
            *(f"{key} = {value}" for key, value in part.items()),
        ]
        path = tmp_path / "mine.toml"
        path.write_text("\n".join(lines) if text is None else text, encoding="utf-8")
        return path

    return write


def test_a_file_of_ones_own_is_read(write_budget):
    budget = load_latency_budget(str(write_budget()))

    assert budget.name == "mine"

    expected = (
        LatencyPart(
            name="radio",
            low_s=0.001,
            high_s=0.01,
            source="a sheet",
            is_assumption=False,
        ),
    )

    assert budget.parts == expected

    fixed = load_latency_budget(
        str(
            write_budget(
                low_s=...,
                high_s=...,
                fixed_s="0.02",
                source=...,
                assumption="'a guess'",
            )
        )
    )

    assert fixed.parts[0].low_s == 0.02
    assert fixed.parts[0].high_s == 0.02
    assert fixed.parts[0].is_assumption is True
    assert fixed.parts[0].source == "a guess"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"low_s": "-0.001"}, "mine.radio.low_s: got -0.001; expected 0 to 10 seconds"),
        (
            {"low_s": "0.02"},
            "mine.radio.high_s: got 0.01; expected at least low_s, 0.02",
        ),
        (
            {"low_s": ..., "high_s": ...},
            "mine.radio: got no time; expected fixed_s, or low_s and high_s",
        ),
        (
            {"fixed_s": "0.1"},
            "mine.radio.low_s: got it beside fixed_s; expected one of them",
        ),
        (
            {"source": ...},
            "mine.radio: got neither; expected either source or assumption",
        ),
        (
            {"assumption": "'x'"},
            (
                "mine.radio: got source and assumption; expected either source or"
                " assumption"
            ),
        ),
        ({"source": "3"}, "mine.radio.source: got 3; expected text"),
        (
            {"mean_s": "0.1"},
            (
                "mine.radio: got 'mean_s'; expected one of name, fixed_s, low_s,"
                " high_s, source, assumption"
            ),
        ),
        ({"name": ...}, "mine.parts[0].name: got nothing; expected a value"),
        ({"name": '"a\\u0007"'}, "mine.name: got 'a\\x07'; expected printable text"),
        ({"text": "[mine]\nparts = 3"}, "mine.parts: got 3; expected a list"),
        (
            {"text": "[mine]\nparts = []\nmode = 'worst'"},
            "mine: got 'mode'; expected one of parts",
        ),
    ],
)
def test_what_is_wrong_with_a_file_is_told_by_file_part_and_field(
    write_budget, fields, message
):
    path = write_budget(**fields)
    with refused_with(f"{path}: {message}"):
        load_latency_budget(str(path))


def test_parts_have_names_of_their_own(write_budget):
    part = "[[mine.parts]]\nname = 'a'\nlow_s = 0.0\nhigh_s = 0.1\nsource = 'x'\n"
    path = write_budget(part + part)

    with refused_with(f"{path}: mine.parts: got 'a'; expected every name once"):
        load_latency_budget(str(path))


def test_a_file_has_one_budget(write_budget):
    both = "".join(
        f"[[{name}.parts]]\nname = 'x'\nfixed_s = 0.1\nsource = 'x'\n"
        for name in ("one", "two")
    )
    for text, got in (
        ("", "no budget"),
        (both, "one, two"),
    ):
        path = write_budget(text)
        with refused_with(
            f"{path}: got {got}; expected one budget: a table such as [mine] with parts"
        ):
            load_latency_budget(str(path))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "wifi",
            (
                "--budget: got 'wifi'; expected study, cpm-100ms, cpm-50ms, or a .toml"
                " file with a latency budget"
            ),
        ),
        (
            "gone.toml",
            "gone.toml: got No such file or directory; expected a readable file",
        ),
    ],
)
def test_a_budget_that_is_not_there_is_told(name, message):
    with refused_with(message):
        load_latency_budget(name, where="--budget")
