import os

import numpy as np
import pytest
from covering_oracle import instances
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from geometry.errors import InputError
from placement.covering import (
    FORMATS,
    build_covering_instance,
    load_instance,
    save_instance,
)

ORLIB = """\
 3 4
 1 2.5 3
 4
 2
 1 2
 3
 2 3 4
 1
 4
"""
GECCO = """\
3 4
1 3 1 2 3
0 2 0 1
2 1 3
"""
RAIL = """\
 3 4
 1 1 1
 2 2 2 1
 3 1 2
 4 2 2 3
"""
# The Steiner triple system of 9 points as in data.9 of "Steiner triple covering problem test
# instances" (M. G. C. Resende; system by Fulkerson, Nemhauser, Trotter 1974).
STS = """\
9 12
2 3 4
1 3 5
1 2 6
5 6 7
4 6 8
4 5 9
1 8 9
2 7 9
3 7 8
1 4 7
2 5 8
3 6 9
"""
COVERS = np.array([[1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 1]])


def refusal(path, **options):
    with pytest.raises(InputError) as caught:
        load_instance(path, **options)
    text = str(caught.value)
    assert "\n" not in text
    return text.replace(str(path), "FILE")


@pytest.fixture
def write(tmp_path):
    def write_file(content, name="instance"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_file


def test_or_library_files_name_columns_from_one(write):
    instance = load_instance(write(ORLIB))
    np.testing.assert_array_equal(instance.covers.toarray(), COVERS)
    assert list(instance.cost) == [1.0, 2.5, 3.0, 4.0]
    assert instance.numbered_from == 1


def test_gecco_files_name_columns_from_zero_and_samples_by_id(write):
    instance = load_instance(write(GECCO))
    np.testing.assert_array_equal(instance.covers.toarray(), COVERS)
    assert list(instance.cost) == [1.0] * 4
    assert instance.numbered_from == 0


def test_rail_files_of_or_library_list_the_rows_of_each_column(write):
    instance = load_instance(write(RAIL))
    np.testing.assert_array_equal(instance.covers.toarray(), COVERS)
    assert list(instance.cost) == [1.0, 2.0, 3.0, 4.0]
    assert instance.numbered_from == 1


def test_steiner_files_list_triples_of_variables_to_cover(write):
    instance = load_instance(write(STS))
    assert (instance.n_columns, instance.n_rows, instance.numbered_from) == (9, 12, 1)
    covers = instance.covers.toarray().astype(int)
    assert list(np.flatnonzero(covers[:, 0]) + 1) == [2, 3, 4]
    assert (covers.sum(axis=0) == 3).all()
    together = covers @ covers.T
    assert (together[~np.eye(9, dtype=bool)] == 1).all()  # each pair is in exactly one triple
    assert list(instance.cost) == [1.0] * 9


def test_ends_of_lines_do_not_matter(write):
    for text in (ORLIB.replace("\n", "\r\n"), " ".join(ORLIB.split()), ORLIB.replace(" ", "\t\n")):
        np.testing.assert_array_equal(load_instance(write(text)).covers.toarray(), COVERS)


def to_orlib(instance):
    columns = [np.flatnonzero(row) + 1 for row in instance.covers.toarray().T]
    numbers = [instance.n_rows, instance.n_columns, *map(float, instance.cost)]
    for row in columns:
        numbers += [len(row), *row]
    return " ".join(map(str, numbers))


def to_gecco(instance):
    lines = [f"{instance.n_rows} {instance.n_columns}"]
    for sample, row in enumerate(instance.covers.toarray().T):
        columns = np.flatnonzero(row)
        lines.append(" ".join(map(str, (sample, len(columns), *columns))))
    return "\n".join(lines)


def to_rail(instance):
    lines = [f"{instance.n_rows} {instance.n_columns}"]
    for cost, row in zip(instance.cost, instance.covers.toarray(), strict=True):
        rows = np.flatnonzero(row) + 1
        lines.append(" ".join(map(str, (float(cost), len(rows), *rows))))
    return "\n".join(lines)


def random_instance(rng, n_columns, n_rows):
    return build_covering_instance(
        rng.random((n_columns, n_rows)) < 0.3, cost=rng.integers(1, 3, n_columns)
    )


@pytest.mark.parametrize("to_text", [to_orlib, to_gecco, to_rail])
def test_formats_are_told_from_the_content(write, to_text):
    rng = np.random.default_rng(3)
    for n_columns, n_rows in [(5, 6), (6, 5), (6, 6), (12, 40), (40, 12)]:
        instance = random_instance(rng, n_columns, n_rows)
        again = load_instance(write(to_text(instance)))
        np.testing.assert_array_equal(again.covers.toarray(), instance.covers.toarray())
        if to_text is not to_gecco:
            np.testing.assert_array_equal(again.cost, instance.cost)


@given(instance=instances())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_every_format_keeps_the_instance(instance, write, tmp_path):
    assume(instance.n_rows and instance.n_columns)
    written = tmp_path / "written"
    save_instance(written, instance)
    again = [
        load_instance(written, format_name="orlib"),
        load_instance(write(to_orlib(instance)), format_name="orlib"),
        load_instance(write(to_rail(instance)), format_name="rail"),
    ]
    gecco = load_instance(write(to_gecco(instance)), format_name="gecco")
    np.testing.assert_array_equal(gecco.covers.toarray(), instance.covers.toarray())
    for each in again:
        np.testing.assert_array_equal(each.covers.toarray(), instance.covers.toarray())
        np.testing.assert_array_equal(each.cost, instance.cost)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "FILE: got an empty file; expected an instance"),
        (" \n\n", "FILE: got an empty file; expected an instance"),
        (
            "id,cost\n1,2\n",
            "FILE: line 1, number 1: got 'id,cost'; expected a number (format orlib, gecco, rail "
            "or sts)",
        ),
        (
            ORLIB.replace(" 2 3 4", " 2 x 4"),
            "FILE: line 7, number 2: got 'x'; expected a number (format orlib, gecco, rail or sts)",
        ),
        (
            ORLIB.replace("2.5", "2-5"),
            "FILE: line 2, number 2: got '2-5'; expected a number (format orlib, gecco, rail or "
            "sts)",
        ),
        (
            ORLIB.replace("2.5", "1e999"),
            "FILE: line 2, number 2: got '1e999'; expected a number (format orlib, gecco, rail or "
            "sts)",
        ),
        (
            b"\x7fELF\x02\x01\x01\x00 \x00" + bytes(range(256)),
            "FILE: line 1, number 1: got '\\x7fELF\\x02\\x01\\x01\\x00'; expected a number (format "
            "orlib, gecco, rail or sts)",
        ),
        (
            ORLIB.replace("2.5", "-2"),
            "FILE: line 2, number 2: got '-2'; expected the cost of a column, at least 0 (format "
            "orlib)",
        ),
        (
            ORLIB.replace(" 2 3 4", " 2 3 5"),
            "FILE: line 7, number 3: got '5'; expected a column, 1 to 4 (format orlib)",
        ),
        (
            ORLIB.replace(" 2 3 4", " 2 0 4"),
            "FILE: line 7, number 2: got '0'; expected a column, 1 to 4 (format orlib)",
        ),
        (
            ORLIB.replace(" 2 3 4", " 2 3 3"),
            "FILE: line 7, number 3: got '3'; expected columns that the row names once "
            "(format orlib)",
        ),
        (
            ORLIB.replace(" 3\n 2 3 4", " 5\n 2 3 4"),
            "FILE: line 6, number 1: got '5'; expected how many columns row 2 of 3 has, 0 to 4 "
            "(format orlib)",
        ),
        (
            ORLIB.removesuffix(" 1\n 4\n"),
            "FILE: line 7, number 3: got the end of the file after it; expected how many columns "
            "row 3 of 3 has (format orlib)",
        ),
        (
            ORLIB.removesuffix(" 4\n"),
            "FILE: line 8, number 1: got the end of the file after it; expected a column (format "
            "orlib)",
        ),
        (
            ORLIB + "7\n",
            "FILE: line 10, number 1: got '7'; expected the end of the file (format orlib)",
        ),
        (
            "3",
            "FILE: line 1, number 1: got the end of the file after it; expected the number of "
            "columns (format orlib)",
        ),
        (
            "3 99999999999",
            "FILE: line 1, number 2: got '99999999999'; expected the number of columns, 1 to "
            "10000000 (format orlib)",
        ),
        (
            "3 1000000 1",
            "FILE: line 1, number 3: got the end of the file after it; expected 999999 numbers "
            "more: the cost of a column (format orlib)",
        ),
        (
            GECCO.replace("0 2 0 1", "0 2 0 4"),
            "FILE: line 3, number 4: got '4'; expected a column, 0 to 3 (format gecco)",
        ),
        (
            GECCO.replace("0 2 0 1", "1 2 0 1"),
            "FILE: line 3, number 1: got '1'; expected the id of a sample that has not been there "
            "yet (format gecco)",
        ),
        (
            GECCO.replace("2 1 3\n", ""),
            "FILE: line 3, number 4: got the end of the file after it; expected the id of a sample "
            "(format gecco)",
        ),
        (
            RAIL.replace(" 3 1 2", " 3 1 4"),
            "FILE: line 4, number 3: got '4'; expected a row, 1 to 3 (format rail)",
        ),
        (
            RAIL.replace(" 2 2 2 1", " 2 2 2 2"),
            "FILE: line 3, number 4: got '2'; expected rows that the column names once "
            "(format rail)",
        ),
        (
            RAIL.replace(" 3 1 2", " -3 1 2"),
            "FILE: line 4, number 1: got '-3'; expected the cost of a column, at least 0 (format "
            "rail)",
        ),
        (
            "2 4\n 1 1 1\n 2 1 2\n 3 1 2\n",
            "FILE: line 4, number 3: got the end of the file after it; expected the cost of a "
            "column (format rail)",
        ),
        (
            RAIL + "7\n",
            "FILE: line 6, number 1: got '7'; expected the end of the file (format rail)",
        ),
        (
            STS.replace("5 6 7", "5 6 0"),
            "FILE: line 5, number 3: got '0'; expected a variable, 1 to 9 (format sts)",
        ),
        (
            STS.replace("5 6 7", "5 6 5"),
            "FILE: line 5, number 3: got '5'; expected variables that the triple names once "
            "(format sts)",
        ),
        (
            STS.removesuffix("3 6 9\n"),
            "FILE: line 12, number 3: got the end of the file after it; expected 3 numbers more: a "
            "variable (format sts)",
        ),
        (
            GECCO + "0",
            "FILE: line 5, number 1: got '0'; expected the end of the file (format gecco)",
        ),
    ],
)
def test_a_file_that_is_wrong_says_where_and_what_is_expected_there(write, content, message):
    meant = message.partition("(format ")[2].removesuffix(")")
    assert refusal(write(content), format_name=meant if meant in FORMATS else None) == message


def test_a_format_can_be_forced(write):
    text = "1 1\n0 1 0\n"
    assert load_instance(write(text), format_name="gecco").numbered_from == 0
    assert refusal(write(text), format_name="orlib") == (
        "FILE: line 2, number 3: got '0'; expected a column, 1 to 1 (format orlib)"
    )
    assert refusal(write(text), format_name="xml") == (
        "format_name: got 'xml'; expected one of " + ", ".join(FORMATS)
    )


BOTH = """\
3 4
0 2 0 1
1 3 1 2 3
2 1 3
"""


def test_numbers_that_fit_two_formats_are_told_apart_by_their_lines(write):
    assert load_instance(write(BOTH), format_name="orlib").numbered_from == 1
    assert load_instance(write(BOTH)).numbered_from == 0
    for text in (" ".join(BOTH.split()) + "\n\n", BOTH.replace("4\n0 2 ", "4 0 2\n")):
        path = write(text)
        assert load_instance(path, format_name="gecco").numbered_from == 0
        assert refusal(path) == (
            "FILE: got numbers that fit more than one format; expected `format_name` orlib or gecco"
        )


def test_what_even_lines_do_not_tell_apart_is_asked_for(write):
    path = write("2 2\n0 1 1\n1 1 1\n")  # samples 0, 1 by candidate 1; columns at 0, 1 for row 1
    assert refusal(path) == (
        "FILE: got numbers that fit more than one format; expected `format_name` gecco or rail"
    )
    assert load_instance(path, format_name="rail").numbered_from == 1
    assert load_instance(path, format_name="gecco").numbered_from == 0


def test_a_file_that_cannot_be_read_says_why(tmp_path):
    path = tmp_path / "none.txt"
    assert refusal(path) == "FILE: got No such file or directory; expected a readable file"
    assert refusal(tmp_path).endswith(": got Is a directory; expected a readable file")
    os.mkfifo(tmp_path / "pipe")
    assert refusal(tmp_path / "pipe") == "FILE: got a pipe; expected a regular file"


def test_a_huge_file_is_not_read(write, monkeypatch):
    monkeypatch.setattr("placement.covering._MAX_BYTES", 20)
    assert refusal(write(ORLIB)) == (
        f"FILE: got {len(ORLIB)} bytes; expected at most 20; cut it out first"
    )


def test_a_file_that_memory_has_no_room_for_is_not_read(write, monkeypatch):
    path = write(ORLIB)
    monkeypatch.setattr("placement.memory.available_bytes", lambda: 100)
    assert refusal(path) == (
        f"FILE: got {len(ORLIB)} bytes of text, which takes about 0.0 GiB of memory; expected what "
        "fits into the 0.0 GiB that are free: fewer rows"
    )


@given(data=st.binary(max_size=200) | st.text("0123456789 .-\n", max_size=80).map(str.encode))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_are_an_instance_or_refused_in_one_line(write, data):
    path = write(data)
    try:
        text = f"{path}: {load_instance(path)}"
    except InputError as error:
        text = str(error)
    assert text.startswith(str(path))
    assert "\n" not in text
