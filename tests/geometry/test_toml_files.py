"""Tables of TOML files, read into values, and what is told of wrong ones."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
import pytest
from msgspec import Meta, Struct

from geometry.arrays import Point2, Points2
from geometry.errors import InputError
from geometry.tables import (
    pick,
    read_table,
    read_tables,
    take,
    take_list,
    take_number,
    take_text,
)
from geometry.text_formats import load_toml


def told(function, *arguments):
    """In which words something is refused."""
    with pytest.raises(InputError) as caught:
        function(*arguments)
    return str(caught.value)


def test_load_toml_reads_what_was_written(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('[x]\nname = "Ü"\nvalues = [1, 2.5]\n', encoding="utf-8")
    assert load_toml(path) == {"x": {"name": "Ü", "values": [1, 2.5]}}


def test_load_toml_names_the_file_it_cannot_read(tmp_path):
    path = tmp_path / "missing.toml"
    said = told(load_toml, path)

    assert said == f"{path}: got No such file or directory; expected a readable file"

    said = told(load_toml, tmp_path)
    assert said == f"{tmp_path}: got Is a directory; expected a readable file"


def test_load_toml_names_the_line_that_is_not_toml(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("a = 1\nb = = 2\n", encoding="utf-8")
    said = told(load_toml, path)

    assert said == (
        f"{path}: got Invalid value (at line 2, column 5); expected valid TOML in UTF-8"
    )


def test_load_toml_says_that_bytes_are_not_utf8(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b'a = "\xff"\n')
    message = told(load_toml, path)

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
    said = told(function, TABLE, "gone", "f.toml: x")
    assert said == "f.toml: x.gone: got nothing; expected a value"


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
    assert told(function, TABLE, key, "f") == message


def test_pick_lists_the_known_names_in_order():
    known = {"b": 2, "a": 1}
    assert pick(known, "b", "f") == 2
    assert told(pick, known, "c", "f.x") == "f.x: got 'c'; expected one of a, b"


# Tables read into values


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """A value with every kind of field that files have."""

    name: str
    position_m: Point2
    height_m: Annotated[float, Meta(gt=0.0)]
    share: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    limits_m: (
        Annotated[tuple[float, float], Meta(description="[low, high] in metres")] | None
    ) = None
    n_units: Annotated[int, Meta(ge=1)] = 1
    kind: Literal["pole", "wall"] = "pole"
    is_free: bool = True
    costs_eur: list[float] = field(default_factory=list)
    outline_m: Points2 = field(default_factory=lambda: np.empty((0, 2)))

    def __post_init__(self):
        if self.name == "nowhere":
            raise InputError("mount nowhere", self.height_m, "another name")


class Pole(Struct, frozen=True, kw_only=True, tag="pole", tag_field="kind"):
    """One of two tables that the field "kind" tells apart."""

    height_m: float


class Wall(Struct, frozen=True, kw_only=True, tag="wall", tag_field="kind"):
    """The other one."""

    length_m: float

    def __post_init__(self):
        if self.length_m > 100.0:
            raise InputError("", self.length_m, "a wall that somebody would build")


class Place(Struct, frozen=True, kw_only=True):
    """A table with one of them."""

    thing: Pole | Wall


class Mounts(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Several of them; nothing else is known."""

    mounts: tuple[Mount, ...]
    title: str = ""


MOUNT = {
    "name": "a",
    "position_m": [1, 2.5],
    "height_m": 4,
    "source": "a field nobody reads",
}


def test_a_table_becomes_a_value_with_arrays_of_the_stated_shape():
    table = MOUNT | {"limits_m": [1, 2], "outline_m": [[0, 1]]}
    mount = read_table(table, Mount, "f.toml")

    assert mount.name == "a"
    assert mount.height_m == 4.0
    assert mount.limits_m == (1.0, 2.0)
    assert isinstance(mount.height_m, float)
    assert mount.position_m.tolist() == [1.0, 2.5]
    assert mount.outline_m.shape == (1, 2)
    assert not mount.position_m.flags.writeable


def test_named_tables_know_their_names():
    assert read_tables({"b": MOUNT}, Mount, "f.toml")["b"].name == "b"

    said = told(read_tables, {"b": 3}, Mount, "f.toml")
    assert said == "f.toml: b: got 3; expected a table of fields"

    message = told(read_tables, {"b": MOUNT | {"share": 2}}, Mount, "f.toml: x")
    assert (
        message == "f.toml: x.b.share: got 2; expected a number, at least 0, at most 1"
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": 3}, "name: got 3; expected text"),
        ({"height_m": "high"}, "height_m: got 'high'; expected a finite number"),
        ({"height_m": True}, "height_m: got True; expected a finite number"),
        ({"height_m": 0}, "height_m: got 0; expected a number > 0"),
        ({"height_m": float("nan")}, "height_m: got nan; expected a finite number"),
        ({"height_m": float("inf")}, "height_m: got inf; expected a finite number"),
        (
            {"height_m": 10**400},
            f"height_m: got 1{199 * '0'}..; expected a finite number",
        ),
        ({"n_units": 2.5}, "n_units: got 2.5; expected a whole number"),
        ({"n_units": 0}, "n_units: got 0; expected a whole number, at least 1"),
        ({"limits_m": 3}, "limits_m: got 3; expected [low, high] in metres"),
        ({"limits_m": [3]}, "limits_m: got [3]; expected [low, high] in metres"),
        ({"limits_m": ["x", 1]}, "limits_m[0]: got 'x'; expected a finite number"),
        ({"kind": "tree"}, "kind: got 'tree'; expected one of pole, wall"),
        ({"kind": 3}, "kind: got 3; expected one of pole, wall"),
        ({"is_free": "yes"}, "is_free: got 'yes'; expected true or false"),
        ({"costs_eur": 3}, "costs_eur: got 3; expected a list"),
        ({"costs_eur": [1, "x"]}, "costs_eur[1]: got 'x'; expected a finite number"),
        ({"position_m": 3}, "position_m: got 3; expected a list"),
        ({"position_m": [1]}, "position_m: got shape (1,); expected shape (2,)"),
        (
            {"position_m": ["x", 1]},
            "position_m: got ['x', 1]; expected numbers of shape (2,)",
        ),
        (
            {"position_m": [1, float("nan")]},
            "position_m: got [1, nan]; expected finite numbers",
        ),
        (
            {"outline_m": [[1, 2, 3]]},
            "outline_m: got shape (1, 3); expected shape (-1, 2)",
        ),
    ],
)
def test_a_table_says_which_field_is_wrong_and_how(change, message):
    wrong = MOUNT | change
    assert told(read_table, wrong, Mount, "f.toml") == f"f.toml: {message}"

    table = {"mounts": [MOUNT, wrong]}
    for where, begin in (("f.toml", "f.toml: "), ("f.toml: x", "f.toml: x.")):
        said = told(read_table, table, Mounts, where)
        assert said == f"{begin}mounts[1].{message}"


def test_a_table_names_missing_and_unknown_fields():
    entry = {"name": "a", "height_m": 4}
    said = told(read_table, entry, Mount, "f.toml")

    assert said == "f.toml: position_m: got nothing; expected a value"

    said = told(read_table, {"mounts": [entry]}, Mounts, "f.toml")
    assert said == "f.toml: mounts[0].position_m: got nothing; expected a value"

    said = told(read_table, {"mounts": [], "titel": "x"}, Mounts, "f.toml")
    assert said == "f.toml: got 'titel'; expected one of mounts, title"

    said = told(read_table, {"mounts": [3]}, Mounts, "f.toml")
    assert said == "f.toml: mounts[0]: got 3; expected a table"
    assert told(read_table, 3, Mount, "f.toml") == "f.toml: got 3; expected a table"


def test_what_a_value_checks_itself_is_said_in_its_own_words():
    said = told(read_table, MOUNT | {"name": "nowhere"}, Mount, "f.toml")
    assert said == "mount nowhere: got 4.0; expected another name"


@pytest.mark.parametrize(
    ("thing", "message"),
    [
        ({"kind": "tree"}, "thing.kind: got 'tree'; expected one of pole, wall"),
        ({"height_m": 3}, "thing.kind: got nothing; expected a value"),
        (
            {"kind": "wall", "height_m": 3},
            "thing.length_m: got nothing; expected a value",
        ),
        (
            {"kind": "wall", "length_m": "x"},
            "thing.length_m: got 'x'; expected a finite number",
        ),
        (
            {"kind": "wall", "length_m": 101},
            "thing: got 101.0; expected a wall that somebody would build",
        ),
        (3, "thing: got 3; expected a table"),
    ],
)
def test_tables_that_one_field_tells_apart_say_what_is_wrong(thing, message):
    pole = {"thing": {"kind": "pole", "height_m": 1}}
    assert read_table(pole, Place, "f.toml").thing == Pole(height_m=1.0)
    assert told(read_table, {"thing": thing}, Place, "f.toml") == f"f.toml: {message}"
