"""CSV that no spreadsheet runs, and that is read back as it was."""

import csv
import io

import pandas as pd
from hypothesis import given
from hypothesis import strategies as st

from experiments.results.tables import csv_text, plain_cell, records_csv, safe_cell


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


CELLS = {
    "id": st.text(max_size=8) | st.sampled_from(["=a", 'a "b"', "a,b", "a\nb", "-1"]),
    "x_m": st.floats(allow_nan=False, allow_infinity=False),
    "n": st.integers(-(10**12), 10**12),
}
RECORDS = st.lists(
    st.fixed_dictionaries(CELLS, optional={"fov_deg": st.floats(1.0, 180.0)}),
    min_size=1,
    max_size=5,
)


@given(RECORDS)
def test_records_are_the_csv_of_their_table(records):
    assert records_csv(records) == csv_text(pd.DataFrame(records))


def test_without_records_the_heads_of_columns_are_left():
    columns = ["part", "name"]
    expected = csv_text(pd.DataFrame([], columns=columns))
    assert records_csv([], columns) == expected == "part,name\n"
