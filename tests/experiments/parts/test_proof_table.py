"""The table of a proof: what is said after the first objective that is open."""

import math

import pytest

from experiments.language import speaking, tr
from experiments.parts.proof import stage_conditions, stage_table
from experiments.results.numbers import NOTHING
from experiments.results.record import StageRecord


def stage(name: str, value: float, bound: float, gap: float | None) -> StageRecord:
    """An objective with its bound."""
    return StageRecord(
        name=name,
        objective=value,
        bound=bound,
        gap=gap,
        seconds=1.0,
    )


OPEN = [
    stage("apr_survived", 0.8935, 0.8958, 0.0026),
    stage("apr", 0.9686, 0.9686, 0.0),
    stage("smallest_margin_s", 0.225, 2.5, 11.24),
    stage("cost_eur", 6000.0, 1000.0, 0.83),
]
PROVEN = [stage("apr", 0.9, 0.9, 0.0), stage("cost_eur", 6000.0, 6000.0, 0.0)]


def test_after_an_open_objective_no_gap_and_no_bound_is_shown():
    rows = {row[0]: row[1:] for row in stage_table(OPEN).rows}
    assert rows["APR if the most needed units fail"][:3] == [
        "89.3 %",
        "89.6 %",
        "0.3 %",
    ]
    assert rows["APR"][:3] == ["96.9 %", "96.9 %", "proven"]
    assert rows["smallest time to spare"][:3] == ["0.225 s", NOTHING, "open"]
    assert rows["cost"][:3] == ["6,000", NOTHING, "open"]


def test_one_sentence_says_what_the_rows_after_an_open_objective_depend_on():
    (sentence,) = stage_conditions(OPEN)
    assert sentence == (
        "APR if the most needed units fail is not proven: the rows below it"
        " compare only with choices that are equally good in it, so they show"
        " no gap."
    )
    assert stage_conditions(PROVEN) == []
    assert stage_conditions([*PROVEN[:1], OPEN[-1]]) == []  # nothing stands below


@pytest.mark.parametrize("gap", [1.0001, 11.24, 495.0, math.inf, None])
def test_a_gap_larger_than_the_value_is_called_open(gap):
    rows = stage_table([PROVEN[0], stage("smallest_margin_s", 0.2, 2.5, gap)]).rows
    assert rows[1][2:4] == ["2.500 s", "open"]


def test_the_sentence_is_german_in_german():
    with speaking("de"):
        (sentence,) = stage_conditions(OPEN)
        assert tr("open") in sentence
        assert "nennen deshalb keine Lücke" in sentence
