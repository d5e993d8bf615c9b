"""Dangers by position: table and figures."""

from dataclasses import replace

import numpy as np
from made_verdicts import avoiding, made_evaluation
from partial_pages import render_section, tables_of

from experiments.parts.dangers import position_table, section
from experiments.parts.section import Box


def test_shares_by_position_and_approach(frame_axis):
    # Weights 1/2, 1/4, 1/4.
    axis = replace(
        frame_axis, positions=("-15", "0", "0"), approaches=("north", "south", "north")
    )
    table = position_table("best", np.array([False, True, False]), axis)

    assert table.columns == [
        "where",
        "APR",
        "runs avoided",
        "from the north",
        "from the south",
    ]
    assert table.rows == [
        ["15 m before the junction", "0.0 %", "0 of 1", "0.0 %", "\N{EN DASH}"],
        ["at the junction", "50.0 %", "1 of 2", "0.0 %", "100.0 %"],
    ]


def test_the_first_and_the_last_layout_are_drawn_side_by_side(
    small_setting, with_blank_pictures
):
    axis = small_setting.axis
    avoided = np.arange(axis.n_runs) > 0
    shown = {
        name: made_evaluation(axis, avoiding(axis, avoided), name=name)
        for name in ("<a>", "b", "c")
    }
    found = section(small_setting, shown, fusion="any")
    (box,) = [block for block in found.blocks if isinstance(block, Box)]

    assert [picture.title for picture in box.blocks] == [
        "Where it is still dangerous with <a>",
        "Where it is still dangerous with c",
    ]
    assert box.blocks[0].caption.startswith(
        "Places with runs that are not avoided: 1 of "
    )
    assert tables_of(found) == []  # there is one position
    assert "&lt;a&gt;" in render_section(found)

    names = tuple("0" if row else "-15" for row in range(axis.n_runs))
    along = replace(small_setting, axis=replace(axis, positions=names))
    alone = section(along, {"<a>": shown["<a>"]}, fusion="any")
    (box,) = [block for block in alone.blocks if isinstance(block, Box)]

    assert len(box.blocks) == 1
    assert len(tables_of(alone)) == 1
