import pytest

from geometry.errors import InputError
from geometry.files import (
    load_toml,
    pick,
    take,
    take_list,
    take_number,
    take_text,
)


def _message(function, *arguments) -> str:
    with pytest.raises(InputError) as caught:
        function(*arguments)
    return str(caught.value)


def test_load_toml_reads_what_was_written(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('[x]\nname = "Ü"\nvalues = [1, 2.5]\n', encoding="utf-8")
    assert load_toml(path) == {"x": {"name": "Ü", "values": [1, 2.5]}}


def test_load_toml_names_the_file_it_cannot_read(tmp_path):
    path = tmp_path / "missing.toml"
    assert _message(load_toml, path) == (
        f"{path}: got No such file or directory; expected a readable file"
    )
    assert _message(load_toml, tmp_path) == (
        f"{tmp_path}: got Is a directory; expected a readable file"
    )


def test_load_toml_names_the_line_that_is_not_toml(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("a = 1\nb = = 2\n", encoding="utf-8")
    assert _message(load_toml, path) == (
        f"{path}: got Invalid value (at line 2, column 5); expected valid TOML in UTF-8"
    )


def test_load_toml_says_that_bytes_are_not_utf8(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b'a = "\xff"\n')
    message = _message(load_toml, path)
    assert message.startswith(f"{path}: got 'utf-8' codec can't decode byte 0xff")
    assert message.endswith("; expected valid TOML in UTF-8")


TABLE = {
    "number": 3,
    "text": "hello",
    "list": [1],
    "yes": True,
    "nan": float("nan"),
    "empty": "",
    "huge": 10**400,
}


def test_take_returns_what_is_there():
    assert take(TABLE, "text", "f") == "hello"
    assert take_text(TABLE, "text", "f") == "hello"
    assert take_list(TABLE, "list", "f") == [1]
    number = take_number(TABLE, "number", "f")
    assert number == 3.0
    assert isinstance(number, float)


@pytest.mark.parametrize("function", [take, take_number, take_text, take_list])
def test_take_names_the_missing_field(function):
    assert _message(function, TABLE, "gone", "f.toml: x") == (
        "f.toml: x.gone: got nothing; expected a value"
    )


@pytest.mark.parametrize(
    ("function", "key", "message"),
    [
        (take_number, "text", "f.text: got 'hello'; expected a finite number"),
        (take_number, "yes", "f.yes: got True; expected a finite number"),
        (take_number, "nan", "f.nan: got nan; expected a finite number"),
        (take_number, "huge", f"f.huge: got 1{199 * '0'}..; expected a finite number"),
        (take_text, "number", "f.number: got 3; expected text"),
        (take_text, "empty", "f.empty: got ''; expected text"),
        (take_list, "text", "f.text: got 'hello'; expected a list"),
    ],
)
def test_take_says_what_kind_of_value_is_expected(function, key, message):
    assert _message(function, TABLE, key, "f") == message


def test_pick_lists_the_known_names_in_order():
    known = {"b": 2, "a": 1}
    assert pick(known, "b", "f") == 2
    assert _message(pick, known, "c", "f.x") == "f.x: got 'c'; expected one of a, b"
