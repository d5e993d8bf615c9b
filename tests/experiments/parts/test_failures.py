"""What is left after failures of units, pairs and poles: words, tables, section."""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from made_verdicts import made_evaluation, made_verdict
from partial_pages import render_section, tables_of

from experiments.parts.alternatives import (
    MAX_ROWS,
    failure_sentences,
    failure_table,
    failures_section,
)
from experiments.results.numbers import NOTHING
from placement.explain.contributions import Failure, Failures, find_failures

LABELS = {"A": "#1", "B": "#2", "C": "#3"}


def left(unit_ids, apr, lost=(), margin_s=0.25):
    """What is left after some units have failed."""
    return Failure(
        unit_ids=tuple(unit_ids),
        apr=apr,
        smallest_margin_s=margin_s,
        lost_run_ids=tuple(lost),
    )


def build_failures(one, two=(), apr=1.0):
    """Failures of one unit and of two."""
    return Failures(
        none_failed=left("", apr), one_failed=tuple(one), two_failed=tuple(two)
    )


def test_one_unit_leaves_nothing():
    (sentence,) = failure_sentences(
        build_failures([left("A", 0.0, ["r"], math.nan)]), LABELS
    )
    assert sentence.startswith(
        "There is only one unit; it prevents 100.0 %. If it fails, only what"
    )


def test_units_that_can_fail_without_a_loss_are_told_so():
    failures = build_failures(
        [left("A", 1.0), left("B", 1.0)], [left("AB", 0.0, ["r"])]
    )
    space = "\N{NO-BREAK SPACE}"
    assert failure_sentences(failures, LABELS) == [
        "All 2 units together prevent 100.0 %.",
        (
            "If any one unit fails, the others still avoid every run that all units"
            f" avoid together. The smallest time to spare is then 250{space}ms."
        ),
        "If both fail, only the car itself is left.",
    ]


def test_the_smallest_margin_told_is_that_of_all_failures_whatever_comes_first():
    failures = build_failures(
        [left("A", 0.9, margin_s=0.5), left("B", 0.9, margin_s=0.1)], apr=0.9
    )
    assert "then 100" in failure_sentences(failures, LABELS)[1]


def test_where_nothing_is_avoided_there_is_no_time_to_spare():
    failures = build_failures(
        [left(name, 0.0, margin_s=math.nan) for name in "AB"], apr=0.0
    )
    assert failure_sentences(failures, LABELS)[1].endswith("units avoid together.")


def test_the_worst_unit_and_pair_are_named_by_their_labels():
    failures = build_failures(
        [left("B", 0.75, ["r", "s"]), left("A", 1.0), left("C", 1.0)],
        [left("BC", 0.5, ["r", "s", "t"]), left("AB", 0.75, ["r"]), left("AC", 1.0)],
    )
    _, one, two = failure_sentences(failures, LABELS)

    assert (
        one == "If #2 fails, the others still prevent 75.0 %; 2 runs are lost. No other"
        " single failure is worse. 2 of the 3 units can fail alone without losing a"
        " run."
    )
    assert (
        two
        == "If two units fail at once, #2 and #3 matter most: 50.0 % remain. 1 of the 3"
        " pairs of units can fail without losing a run."
    )

    losing = [left(pair, 0.5, ["r"]) for pair in ("AB", "AC", "BC")]
    failures = build_failures([left(unit, 1.0) for unit in "ABC"], losing)
    two = failure_sentences(failures, LABELS)[2]

    assert two.endswith(" 50.0 % remain. Any two failures together lose runs.")


def test_a_table_lists_the_first_runs_and_says_how_many_are_left_out():
    table = failure_table(
        [
            left("A", 0.5, [f"run{index}" for index in range(6)]),
            left("B", 0.0, (), math.nan),
        ],
        LABELS,
        of="unit",
    )
    assert table.caption == "If one unit fails"
    assert table.rows == [
        ["#1", "50.0 %", "250", "6", "run0, run1, run2, run3 and 2 more"],
        ["#2", "0.0 %", NOTHING, "0", NOTHING],
    ]


def test_of_many_failures_the_worst_are_shown_and_it_is_told():
    units = [left([f"U{index}"], index / 200.0) for index in range(200)]
    table = failure_table(units, {}, of="unit")

    assert table.caption == f"If one unit fails: the {MAX_ROWS} worst of 200 units"
    assert [row[0] for row in table.rows] == [f"U{index}" for index in range(MAX_ROWS)]

    pairs = [left(["a", "b"], 0.5)] * 13
    assert failure_table(pairs, {}, of="pair").caption.endswith("12 worst of 13 pairs")
    assert any(
        "up to 12 units; this layout has 200" in sentence
        for sentence in failure_sentences(build_failures(units), {})
    )


@pytest.fixture
def build(frame_axis):
    """Cameras that detect in every frame and avoid nothing."""

    def build_evaluation(ids):
        verdict = made_verdict(
            frame_axis,
            np.zeros(frame_axis.n_runs),
            is_avoided=np.zeros(frame_axis.n_runs),
            detected=np.ones(frame_axis.n_frames, dtype=bool),
        )
        return made_evaluation(frame_axis, verdict, ids=ids)

    return build_evaluation


@pytest.mark.parametrize(
    ("n_units", "n_tables"),
    [
        (1, 1),
        (2, 1),
        (3, 2),
        (13, 1),
    ],
)
def test_the_part_has_a_table_of_pairs_where_it_says_something(
    build, rule, n_units, n_tables
):
    ids = [f"<b>{index}" for index in range(n_units)]
    evaluation = build(ids)
    part = failures_section(evaluation, rule, {})
    tables = tables_of(part)

    assert len(tables) == n_tables

    if n_units == 3:
        expected = {" and ".join(pair) for pair in combinations(ids, 2)}
        assert {row[0] for row in tables[1].rows} == expected
    assert part.blocks[0] == " ".join(
        failure_sentences(find_failures(evaluation, rule), {})
    )

    page = render_section(part)
    assert "<b>" not in page
    assert page.count("<table>") == n_tables
    assert "&lt;b&gt;0" in page


def test_a_pole_with_two_units_is_told_beside_the_units():
    pole = replace(left("AB", 0.25, ["r1"]), site_id="lamp 7")
    alone = replace(left("C", 1.0), site_id="lamp 8")
    units = build_failures([left(name, 1.0) for name in "ABC"])
    failures = replace(units, site_failed=(pole, alone))

    assert (
        failure_sentences(failures, LABELS)[-1]
        == "A pole fails with all its units (power cut, crash). If the pole of #1 and "
        "#2 fails, 25.0 % remain and 1 run is lost. No other pole failure is worse."
    )
    assert [
        row[:3] for row in failure_table(failures.site_failed, LABELS, of="pole").rows
    ] == [
        ["lamp 7", "#1 and #2", "25.0 %"],
        ["lamp 8", "#3", "100.0 %"],
    ]

    unshared = replace(units, site_failed=(alone,))
    assert "No two units share a pole" in failure_sentences(unshared, LABELS)[-1]
