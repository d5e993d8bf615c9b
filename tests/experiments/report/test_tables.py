"""Tables of the report by unit, case and run."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_verdicts import avoiding, made_evaluation

from experiments.parts.accidents import (
    apr_group_tables,
    apr_table,
    run_table,
    speed_groups,
    unit_apr_table,
)

NIGHT = ("day", "day", "night")


def verdict(axis, is_avoided):
    """Avoids some runs, and detects in the first five frames."""
    return avoiding(axis, is_avoided, detected=np.arange(axis.n_frames) < 5)


@pytest.fixture
def build(frame_axis):
    """Weights of the three runs are 1/2, 1/4 and 1/4."""

    def build_evaluation(
        name, all_sources=(), vam=(0, 1, 0), weathers=NIGHT, **changes
    ):
        axis = replace(frame_axis, weathers=weathers, **changes)
        if all_sources:
            others = {
                "vam": verdict(axis, vam),
                "all_sources": verdict(axis, all_sources),
            }
        else:
            others = {}
        return made_evaluation(
            axis,
            verdict(axis, [1, 0, 0]),
            name=name,
            vut=verdict(axis, [0, 0, 1]),
            vut_and_rsus=verdict(axis, [1, 0, 1]),
            others=others,
        )

    return build_evaluation


def test_weathers_have_rows_beside_the_cases_for_every_party(build):
    evaluation = build("mine")
    table = apr_table({"mine": evaluation})

    assert table.caption == "Accident prevention ratio by case and weather"
    assert table.columns == [
        "case or weather",
        "mine: 1 camera",
        "car (VUT) alone",
        "car (VUT) and mine",
    ]
    assert table.rows == [
        ["all runs", "50.0 %", "25.0 %", "75.0 %"],
        ["A", "66.7 %", "0.0 %", "66.7 %"],
        ["B", "0.0 %", "100.0 %", "100.0 %"],
        ["weather: day", "66.7 %", "0.0 %", "66.7 %"],
        ["weather: night", "0.0 %", "100.0 %", "100.0 %"],
    ]

    alone = unit_apr_table("mine", evaluation)
    assert alone.columns == ["case or weather", "RSU0"]
    assert [row[0] for row in alone.rows] == [
        *(row[0] for row in table.rows),
        "frames in which it detects",
    ]
    assert [row[1] for row in alone.rows] == [*(row[1] for row in table.rows), "50.0 %"]


@pytest.mark.parametrize("weather", ["day", "night"])
def test_one_weather_has_no_row_of_its_own(build, weather):
    evaluation = build("mine", weathers=(weather,) * 3)
    table = apr_table({"mine": evaluation})

    assert table.caption == "Accident prevention ratio by case"
    assert [row[0] for row in table.rows] == ["all runs", "A", "B"]
    for head in (table.columns, unit_apr_table("mine", evaluation).columns):
        assert head[0] == "case"
    assert "weather" not in run_table({"mine": evaluation}).columns


def test_a_weather_without_weight_has_no_ratio(build):
    table = apr_table({"mine": build("mine", weight=np.array([0.5, 0.5, 0.0]))})
    assert table.rows[-1] == ["weather: night", *["\N{EN DASH}"] * 3]


def test_road_users_who_announce_themselves_have_columns_of_their_own(build):
    table = apr_table(
        {
            "mine": build("mine", all_sources=(1, 1, 1)),
            "old": build("old", all_sources=(1, 1, 0)),
        }
    )
    assert table.columns[4:] == [
        "car (VUT) and mine",
        "car (VUT) and old",
        "road users' messages (VAM) alone",
        "car (VUT), mine and VAM",
        "car (VUT), old and VAM",
    ]
    assert {row[0]: row[6:] for row in table.rows} == {
        "all runs": ["25.0 %", "100.0 %", "75.0 %"],
        "A": ["33.3 %", "100.0 %", "100.0 %"],
        "B": ["0.0 %", "100.0 %", "0.0 %"],
        "weather: day": ["33.3 %", "100.0 %", "100.0 %"],
        "weather: night": ["0.0 %", "100.0 %", "0.0 %"],
    }


def test_apr_by_speed_and_direction_has_the_columns_of_the_apr_by_case(build):
    (by_speed,) = apr_group_tables({name: build(name) for name in ("mine", "theirs")})
    approaches = ("west", "<east>", "west")
    both = {name: build(name, approaches=approaches) for name in ("mine", "theirs")}
    (by_direction,) = apr_group_tables(both)

    assert by_speed.columns == ["speed (km/h)", *apr_table(both).columns[1:]]
    assert by_direction.columns[1:] == by_speed.columns[1:]
    # Runs at 20, 30 and 20 km/h with weights 1/2, 1/4, 1/4; the units avoid the first,
    # the VUT the last.
    assert by_speed.rows == [
        ["20", "66.7 %", "66.7 %", "33.3 %", "100.0 %", "100.0 %"],
        ["30", "0.0 %", "0.0 %", "0.0 %", "0.0 %", "0.0 %"],
    ]
    assert by_direction.rows == [
        ["west", "66.7 %", "66.7 %", "33.3 %", "100.0 %", "100.0 %"],
        ["<east>", "0.0 %", "0.0 %", "0.0 %", "0.0 %", "0.0 %"],
    ]


def test_speeds_that_no_place_drives_all_of_are_taken_together():
    # Of two places along an arm each drives every third speed, from another one on.
    speeds = np.array([10.0, 15.0, 25.0, 30.0, 40.0, 45.0])
    thinned = SimpleNamespace(
        cases=["A"] * 6,
        approaches=["west"] * 6,
        positions=["-15", "+15"] * 3,
        weathers=["day"] * 6,
        vut_speed_kmh=speeds,
    )
    groups = {name: mask.tolist() for name, mask in speed_groups(thinned)}

    assert groups == {
        "10 to 25": [True] * 3 + [False] * 3,
        "30 to 45": [False] * 3 + [True] * 3,
    }

    whole = SimpleNamespace(**(vars(thinned) | {"positions": ["0"] * 6}))
    assert [name for name, _ in speed_groups(whole)] == [f"{v:g}" for v in speeds]


def test_one_speed_or_one_direction_has_no_table(build):
    assert [
        table.columns[0] for table in apr_group_tables({"mine": build("mine")})
    ] == ["speed (km/h)"]
    assert (
        apr_group_tables({"mine": build("mine", vut_speed_kmh=np.full(3, 20.0))}) == []
    )
