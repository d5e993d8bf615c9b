"""Results of layouts with so many units that not every one can be shown everywhere."""

import re
from pathlib import Path

import pytest
from interactive_pages import build_evaluation, build_layout
from json_files import UNIT
from matplotlib.text import Text
from partial_pages import build_result
from tiny_worlds import unit_at

from experiments.cli.answers import evaluation_parts
from experiments.cli.terminal import answer_text
from experiments.figures.labels import MAX_LABELLED_UNITS
from experiments.figures.plan import plot_plan
from experiments.parts.accidents import MAX_UNIT_COLUMNS, unit_apr_table
from experiments.results.numbers import percent
from placement.evaluation import apr
from placement.layout import Layout

N = 200


@pytest.fixture(scope="module")
def evaluation(small_setting):
    """An evaluation of 200 units."""
    return build_evaluation(small_setting, build_layout(N), share=0.3)


@pytest.fixture(scope="module")
def few(small_setting):
    """An evaluation of 24 units, which all have a column."""
    return build_evaluation(small_setting, build_layout(24), share=0.3)


def test_of_many_units_each_is_a_row_and_the_best_come_first(evaluation, few):
    table = unit_apr_table("many", evaluation)
    narrow = unit_apr_table("few", few)

    assert table.caption == "APR of each unit of many by itself, best first"
    assert len(narrow.columns) == MAX_UNIT_COLUMNS + 1
    assert table.columns == ["unit", *(row[0] for row in narrow.rows)]
    assert sorted(row[0] for row in table.rows) == sorted(evaluation.units)

    shares = [float(row[1].removesuffix(" %")) for row in table.rows]
    assert shares == sorted(shares, reverse=True)

    best = max(apr(unit, evaluation.axis) for unit in evaluation.units.values())
    assert shares[0] == pytest.approx(100.0 * best, abs=0.05)

    rows = {row[0]: row for row in table.rows}
    for unit_id, unit in evaluation.units.items():
        assert rows[unit_id][1] == percent(apr(unit, evaluation.axis))


def result_of(n_units):
    """APR of units that rises with their number, but is the same for pairs of them."""
    ratio = {"all": 0.9, "by_case": {"CBNA": 0.9}}
    ids = [f"unit/{index}" for index in range(n_units)]
    units = {}
    for index, unit_id in enumerate(ids):
        share = index // 2 / N
        units[unit_id] = {"all": share, "by_case": {"CBNA": share}}
    evaluation = dict.fromkeys(("rsu_all", "vut_and_rsus", "vut"), ratio)
    evaluation |= {"units": units, "apr_without_worst_unit": None}
    layout = [UNIT | {"id": unit_id} for unit_id in ids]
    return build_result("mine", layout, runs=6, cost_eur=1000.0, evaluation=evaluation)


@pytest.mark.parametrize(
    ("n_units", "n_left"),
    [
        (24, 0),
        (26, 2),
        (200, 176),
    ],
)
@pytest.mark.parametrize("out", [Path("out"), None])
def test_a_terminal_shows_the_units_of_the_highest_apr_and_counts_the_rest(
    n_units, n_left, out
):
    text = answer_text(evaluation_parts(result_of(n_units), out), is_verbose=True)
    units = set(re.findall(r"unit/\d+", text))

    assert units == {f"unit/{index}" for index in range(n_units - 24, n_units)}
    assert (f"and {n_left} more units" in text) == (n_left > 0)
    assert ("--out" in text) == (n_left > 0 and out is None)
    assert max(map(len, text.splitlines())) <= 80


def labels_of(axes):
    """Texts of a figure."""
    return {text.get_text() for text in axes.findobj(Text)} - {""}


@pytest.mark.long
def test_a_plan_counts_units_at_each_place_where_labels_would_hide_all(small_setting):
    layout = build_layout(MAX_LABELLED_UNITS + 1)
    pole = [
        unit_at(f"more {index}", [-127.0, 5.0, 6.0], yaw_deg=90.0 * index)
        for index in range(4)
    ]
    drawn = labels_of(
        plot_plan(small_setting, Layout(name="many", units=(*layout.units, *pole)))
    )

    assert {"1\N{MULTIPLICATION SIGN}", "4\N{MULTIPLICATION SIGN}"} <= drawn
    assert not any(text.startswith("#") for text in drawn)


@pytest.mark.parametrize(
    ("turn_deg", "expected"),
    [
        (0.0, {"a, b"}),
        (-350.0, {"a, b"}),
        (90.0, {"a", "b"}),
    ],
)
def test_units_that_look_the_same_way_from_one_pole_share_a_label(
    small_setting, turn_deg, expected
):
    place_m = build_layout(1).units[0].pose.position_m
    units = tuple(
        unit_at(unit_id, place_m, yaw_deg=yaw_deg, pitch_deg=-20.0)
        for unit_id, yaw_deg in (
            ("a", 10.0),
            ("b", 10.0 + turn_deg),
        )
    )
    drawn = labels_of(plot_plan(small_setting, Layout(name="pair", units=units)))

    assert drawn & {"a", "b", "a, b"} == expected
