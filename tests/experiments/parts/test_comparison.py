"""Layouts side by side: runs, numbers, and what is significant."""

from dataclasses import replace

import numpy as np
import pytest
from json_files import as_json
from made_verdicts import made_evaluation, made_verdict
from partial_pages import render_section, tables_of

from experiments.parts.comparison import (
    difference_rows,
    find_differences,
    section,
    side_by_side_table,
    significance_table,
)
from experiments.parts.sampled_worlds import build_sampled_record
from placement.sampling.out_of_sample import SampledApr
from placement.sampling.uncertainty import load_uncertainty

NAMES = ("a $1_", "<b>", "c")


@pytest.fixture
def evaluation_of(frame_axis):
    """Builds an evaluation that avoids some of three runs."""
    axis = replace(frame_axis, last_brake_time_s=np.array([-0.1, -0.2, -0.1]))

    def build(name, avoided, margin_s=0.05, n_units=1):
        onset_s = np.where(avoided, axis.last_brake_time_s - margin_s, np.inf)
        ids = [f"U{index}" for index in range(n_units)]
        return made_evaluation(axis, made_verdict(axis, onset_s), name=name, ids=ids)

    return build


@pytest.fixture
def evaluations(evaluation_of):
    """Three layouts of one to three units; the last avoids nothing."""
    avoided = (
        [1, 1, 0],
        [1, 0, 1],
        [0, 0, 0],
    )
    return {
        name: evaluation_of(name, runs, n_units=number)
        for number, (name, runs) in enumerate(zip(NAMES, avoided, strict=True), start=1)
    }


def sampled_of(evaluations, *aprs):
    """Record of layouts with these APR in sampled worlds."""
    judged = [
        SampledApr(
            layout=item.layout,
            axis=item.axis,
            apr_by_sample=apr,
            avoided_share=np.ones(3) * 0.5,
        )
        for item, apr in zip(evaluations.values(), aprs, strict=True)
    ]
    return build_sampled_record(judged, load_uncertainty(), tail=1.0, seed=0)


@pytest.fixture
def sampled(evaluations):
    """The second is surely best; nothing is sure between the first and the third."""
    return sampled_of(
        evaluations, [0.5, 0.6, 0.5, 0.4], [0.9, 0.8, 0.9, 0.4], [0.5, 0.5, 0.5, 0.5]
    )


def test_of_any_two_layouts_the_runs_that_only_one_avoids_are_named(evaluations):
    found = find_differences(evaluations)
    found = as_json(found)

    assert [(one["first"], one["second"]) for one in found] == [
        ("a $1_", "<b>"),
        ("a $1_", "c"),
        ("<b>", "c"),
    ]
    assert found[0]["only_first"] == ["A/north/30"]
    assert found[0]["only_second"] == ["B/north/20"]
    assert found[1]["only_first"] == ["A/north/20", "A/north/30"]
    assert found[1]["only_second"] == []


def test_runs_that_differ_are_counted_and_named_by_who_avoids_them(evaluations):
    avoided = {name: item.rsu_all.is_avoided for name, item in evaluations.items()}
    rows = difference_rows(find_differences(evaluations))
    assert len(rows) == 4

    for one, other, counted, runs in rows:
        n_only = int((avoided[one] & ~avoided[other]).sum())
        assert counted.split()[0] == str(n_only) == str(len(runs.split(", ")))


def test_side_by_side_every_layout_has_its_own_numbers(evaluations, rule):
    rows = tables_of(section(evaluations, rule))[0].rows
    assert [row[0] for row in rows] == [*NAMES, "VUT alone"]

    *rows, vut = rows
    assert vut[3:5] == ["75.0 %", "2 of 3"]  # that of the first layout
    assert [row[1] for row in rows] == ["1", "2", "3"]

    price = next(iter(evaluations.values())).layout.units[0].sensor.price_eur
    assert [row[2] for row in rows] == [f"{n * price:,.0f}" for n in (1, 2, 3)]

    paid = next(iter(evaluations.values())).layout.units[0].id
    kept = side_by_side_table(evaluations, rule, existing=[paid]).rows

    assert kept[0][2] == "0"
    assert [row[3] for row in rows] == ["75.0 %", "75.0 %", "0.0 %"]
    assert [row[4] for row in rows] == ["2 of 3", "2 of 3", "0 of 3"]
    assert [row[6] for row in rows] == ["0.05", "0.05", "\N{EN DASH}"]


def test_side_by_side_speeds_at_contact_have_a_column(evaluations, rule):
    (name, one), *_ = evaluations.items()
    assert (
        side_by_side_table({name: one}, rule).columns[-1]
        == "mean speed at contact (km/h)"
    )

    left_kmh = np.array([0.0, 0.0, 8.0])
    verdict = replace(one.rsu_all, impact_speed_kmh=left_kmh)
    found = side_by_side_table({name: replace(one, rsu_all=verdict)}, rule)

    # The last run weighs a quarter.
    assert found.rows[0][-1] == "2.0"


def test_the_better_one_comes_first_in_the_table(sampled):
    rows = significance_table(sampled).rows
    pairs = {(row[0], row[1]): row for row in rows}
    assert ("<b>", "a $1_") in pairs

    row = pairs["<b>", "a $1_"]
    assert row[2:5] == ["75.0 %", "25.0 %", "0.0 %"]

    gain = np.array([0.4, 0.2, 0.4, 0.0])
    assert row[5] == f"{100.0 * gain.mean():.1f}"

    half = 3.182446 * gain.std(ddof=1) / 2.0  # Student's t, 3 degrees of freedom
    low, high = (100.0 * (gain.mean() + side * half) for side in (-1.0, 1.0))
    assert row[6] == f"{low:.1f} to {high:.1f}".replace("-", "\N{MINUS SIGN}")


def test_what_is_sure_is_said(evaluations):
    sampled = sampled_of(
        evaluations, [0.5, 0.6, 0.5, 0.4], [0.9, 0.9, 0.8, 0.8], [0.5, 0.5, 0.5, 0.5]
    )
    rows = {(row[0], row[1]): row[7] for row in significance_table(sampled).rows}

    assert rows["<b>", "a $1_"] == "yes"
    assert rows["a $1_", "c"] == "no significant difference"


def test_the_section_shows_all_and_escapes_names(evaluations, sampled, rule):
    part = section(evaluations, rule, sampled=sampled)
    page = render_section(part)

    assert "&lt;b&gt;" in page
    assert "<b>" not in page
    assert "Is the difference significant?" in page

    plain = render_section(section(evaluations, rule))
    assert "Runs that only one of two layouts avoids" in plain
    assert "Is the difference significant?" not in plain


def test_layouts_that_agree_and_a_layout_alone(evaluation_of, rule):
    twins = {name: evaluation_of(name, [1, 0, 0]) for name in ("x", "y")}
    page = render_section(section(twins, rule))

    assert "All layouts avoid the same runs." in page
    assert section({"x": twins["x"]}, rule) is None


def test_of_many_layouts_every_pair_is_in_the_table(evaluation_of, rule):
    many = {f"l{index}": evaluation_of(f"l{index}", [1, 0, 0]) for index in range(9)}
    generator = np.random.default_rng(0)
    sampled = sampled_of(many, *generator.uniform(0.2, 0.9, size=(9, 5)))
    part = section(many, rule, sampled=sampled)

    assert len(tables_of(part)[-1].rows) == 36
