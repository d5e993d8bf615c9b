import csv
import io

import pandas as pd
from hypothesis import given
from hypothesis import strategies as st

from experiments.results.tables import csv_text, plain_cell, safe_cell


def test_what_spreadsheets_would_run_is_text():
    names = [
        "=cmd|'/C calc'!A0",
        "+1+1",
        "@SUM(1)",
        "-2+3",
        "\tx",
        "north",
        "",
        "-",
        "'",
    ]
    table = pd.DataFrame({"unit": names, "z_m": [-1.5] * len(names)})
    rows = list(csv.DictReader(io.StringIO(csv_text(table), newline="")))
    assert [row["unit"] for row in rows] == [f"'{name}" for name in names[:5]] + names[
        5:
    ]
    assert {row["z_m"] for row in rows} == {"-1.5"}  # numbers stay numbers


@given(st.text(max_size=8) | st.sampled_from(["'=a", "''=a", "=-1", "-1", "'-1"]))
def test_names_are_read_back_as_they_were(name):
    assert plain_cell(safe_cell(name)) == name
    assert not safe_cell(name).startswith(("=", "@")) or len(name) == 1
