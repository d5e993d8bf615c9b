"""Tables of what cameras see of private ground."""

import msgspec
from msgspec import UNSET
from partial_pages import render_section, tables_of

from experiments.parts.units import (
    MAX_AREAS,
    MAX_UNITS,
    PrivateGroundRecord,
    private_ground_section,
)


def summary(shares):
    """Shares of areas by unit, as a record of the result."""
    names = list(next(iter(shares.values())))
    plain = {
        "areas": [
            {"name": name, "area_m2": 10.0 + number}
            for number, name in enumerate(names)
        ],
        "units": shares,
    }
    return msgspec.convert(plain, PrivateGroundRecord)


def test_without_private_ground_there_is_no_part():
    assert private_ground_section(UNSET, {}) is None


def test_areas_are_rows_and_units_columns_what_is_seen_most_first():
    part = private_ground_section(
        summary(
            {"A": {"lawn": 0.0, "<yard>": 0.25}, "B": {"lawn": 0.1, "<yard>": 0.5}}
        ),
        {"A": "#1", "B": "#2"},
    )
    (table,) = tables_of(part)

    assert table.columns == [
        "area",
        "size (m²)",
        "largest share seen by one unit",
        "#1",
        "#2",
    ]
    assert table.rows == [
        ["<yard>", "11", "50.0 %", "25.0 %", "50.0 %"],
        ["lawn", "10", "10.0 %", "0.0 %", "10.0 %"],
    ]

    page = render_section(part)
    assert "<yard>" not in page
    assert "&lt;yard&gt;" in page


def test_of_many_units_and_areas_those_that_matter_are_shown_and_it_is_told():
    shares = {
        f"U{unit}": {f"area{area}": (unit * area) / 40_000.0 for area in range(100)}
        for unit in range(200)
    }
    part = private_ground_section(summary(shares), {})
    (table,) = tables_of(part)

    assert table.columns[3:] == [f"U{unit}" for unit in range(200 - MAX_UNITS, 200)]
    assert [row[0] for row in table.rows] == [
        f"area{area}" for area in range(99, 99 - MAX_AREAS, -1)
    ]
    assert "the 12 most important of 200 units" in table.caption
    assert "the 60 most important of 100 areas" in table.caption
    assert part.blocks[0] == (
        "199 of 200 units see part of 99 of 100 private areas; the largest"
        " share seen is 49.3 % of area99."
    )


def test_nothing_seen_is_said_as_the_planner_says_it():
    part = private_ground_section(summary({"A": {"lawn": 0.0}}), {})
    assert part.blocks[0] == "No camera has the private area in its picture."
