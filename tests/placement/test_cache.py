"""Hashes, cached arrays and cached values: made once, refused when damaged."""

import gc
import logging
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from geometry.arrays import FloatArray
from geometry.phrases import Phrase
from placement import cache, fingerprints
from placement.cache import MAX_ARRAYS, MAX_FILES, CachedArrays, cached_value
from placement.fingerprints import Fingerprints
from placement.packing import from_bytes, to_bytes

FINGERPRINT = "0123456789abcdef" * 2
ROWS = {"a": np.array([True, False, True]), "b": np.arange(3.0)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Thing:
    """A value with one part."""

    name: str
    part: Any


def opened(folder, *, kind="test/1", fingerprint=FINGERPRINT):
    """Cached arrays in a folder."""
    return CachedArrays(
        folder,
        "rows",
        kind=kind,
        fingerprint=fingerprint,
    )


def file_in(folder):
    """The one file of arrays in a folder."""
    (path,) = folder.glob("*.npz")
    return path


# Hashes


VALUES = {
    "a thing": Thing(name="a", part=np.arange(3)),
    "another name": Thing(name="b", part=np.arange(3)),
    "another array": Thing(name="a", part=np.array([0, 1, 3])),
    "another type": Thing(name="a", part=np.arange(3.0)),
    "another shape": Thing(name="a", part=np.arange(3)[:, None]),
    "nothing": Thing(name="a", part=None),
    "a word": Thing(name="a", part="1"),
    "a number": Thing(name="a", part=1),
    "a list": Thing(name="a", part=(1, 2, 3)),
    "in other parts": Thing(name="a", part=((1, 2), 3)),
    "a mapping": Thing(name="a", part={"x": 1}),
    "another key": Thing(name="a", part={"y": 1}),
}


def test_a_hash_tells_apart_whatever_differs():
    hashes = Fingerprints()
    found = [hashes.of(value) for value in VALUES.values()]

    assert len(set(found)) == len(VALUES)
    for text in found:
        assert len(text) == 32


@pytest.mark.parametrize("name", VALUES)
def test_a_hash_is_that_of_the_content_wherever_it_lies(name):
    value = VALUES[name]
    if name == "a thing":
        part = value.part.copy()
        again = replace(value, part=part)
    else:
        again = replace(value)

    both = Fingerprints()
    expected = Fingerprints().of(replace(again), again)

    assert both.of(value, value) == expected
    assert both.of(value) == both.of(again)


@dataclass(
    frozen=True,
    slots=True,
    weakref_slot=True,
    kw_only=True,
    eq=False,
)
class Lasting:
    """A value that lasts."""

    part: Any


def test_a_value_that_lasts_is_hashed_once_and_another_one_by_its_own_content():
    lasting = Lasting(part=np.arange(3))
    first = Fingerprints().of(lasting)

    assert fingerprints._lasting[lasting]
    assert Fingerprints().of(lasting) == first
    assert Fingerprints().of(Lasting(part=np.arange(3))) == first
    assert Fingerprints().of(replace(lasting, part=np.arange(4))) != first

    n_known = len(fingerprints._lasting)
    del lasting
    gc.collect()

    assert len(fingerprints._lasting) < n_known


def test_parts_are_told_apart_wherever_one_ends_and_the_next_begins():
    values = [("ab", "c"), ("a", "bc"), ("abc",), (("ab",), "c"), ("ab", ("c",))]
    values += [(b"ab", "c"), ({"a": 1}, 2), ({"a": (1, 2)},), ([1], 2), ((1,), 2)]
    assert len({Fingerprints().of(value) for value in values}) == len(values)


def test_bytes_come_back(tmp_path):
    value = ("text", b"\x00\xff")
    assert from_bytes(to_bytes(value), tuple[str, bytes]) == value


def test_what_has_no_hash_is_an_error_of_the_program():
    with pytest.raises(TypeError, match="has no hash"):
        Fingerprints().of(Thing(name="a", part=object()))


# There and back


@dataclass(frozen=True, kw_only=True)
class Reason:
    """A value with a phrase."""

    title: str
    why: Phrase


def test_phrases_come_back_with_what_a_translation_needs(tmp_path):
    why = Phrase("{thing} stands {far:.1f} m away", thing=Phrase("lamp post"), far=2.5)
    title = Phrase("{n} runs", n=3)
    reason = Reason(title=title, why=why)

    for _ in range(2):
        found = cached_value(
            tmp_path,
            "reason",
            lambda: reason,
            kind=Reason,
            made_from=(),
        )

        assert found == reason
        assert found.title.template == "{n} runs"
        assert found.title.fields == {"n": 3}
        assert found.why.template == why.template
        assert found.why.fields == why.fields
        assert found.why.fields["thing"].template == "lamp post"


def test_what_is_kept_is_there_for_the_next_call(tmp_path, caplog):
    opened(tmp_path / "new").add(ROWS)
    found = opened(tmp_path / "new").arrays

    assert list(found) == list(ROWS)

    for name, array in ROWS.items():
        assert found[name].dtype == array.dtype
        assert np.array_equal(found[name], array)

    assert not caplog.records


@pytest.mark.parametrize(
    "other", [{"fingerprint": "f" * 32}, {"kind": "test/2"}], ids=["inputs", "version"]
)
def test_what_was_made_from_something_else_is_not_found(tmp_path, other):
    opened(tmp_path).add(ROWS)
    assert opened(tmp_path, **other).arrays == {}


def test_without_a_folder_nothing_is_kept_but_known():
    notes = opened(None)
    notes.add(ROWS)

    assert notes.arrays.keys() == ROWS.keys()
    assert opened(None).arrays == {}


def test_two_processes_that_found_different_things_keep_both(tmp_path):
    first = opened(tmp_path)
    second = opened(tmp_path)
    first.add({"a": ROWS["a"]})
    second.add({"b": ROWS["b"]})

    assert opened(tmp_path).arrays.keys() == {"a", "b"}
    assert second.arrays.keys() == {"b"}


def test_what_is_known_already_is_not_written_again(tmp_path):
    notes = opened(tmp_path)
    notes.add(ROWS)
    file_in(tmp_path).unlink()
    notes.add({"a": ROWS["a"]})

    assert not list(tmp_path.iterdir())


# Damage, and folders that cannot be written to


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes()[:-40]),
        lambda path: np.savez(path, format="test/1", fingerprint=FINGERPRINT, **ROWS),
        lambda path: np.savez(
            path, format="test/1", fingerprint="f" * 32, content="", **ROWS
        ),
    ],
    ids=["empty", "cut off", "without a hash", "foreign"],
)
def test_a_damaged_file_is_told_not_used_and_made_anew(tmp_path, caplog, damage):
    opened(tmp_path).add(ROWS)
    path = file_in(tmp_path)
    damage(path)
    notes = opened(tmp_path)

    assert notes.arrays == {}

    (record,) = caplog.records

    assert record.levelno == logging.WARNING
    assert record.getMessage().startswith(f"cached rows not used, made anew: {path}: ")

    notes.add(ROWS)
    caplog.clear()

    assert opened(tmp_path).arrays.keys() == ROWS.keys()
    assert not caplog.records


def test_an_array_that_was_changed_or_renamed_is_not_used(tmp_path, caplog):
    opened(tmp_path).add(ROWS)
    path = file_in(tmp_path)
    with np.load(path) as stored:
        arrays = dict(stored)

    for changed in ({"a": ~ROWS["a"]}, {"b": ROWS["a"], "a": ROWS["b"]}):
        np.savez(path, **{**arrays, **changed})
        assert opened(tmp_path).arrays == {}
        assert caplog.messages[-1].endswith(": its content is not what was written")


def test_a_folder_that_cannot_be_made_costs_a_line(tmp_path, caplog):
    in_the_way = tmp_path / "file"
    in_the_way.write_text("not a folder", encoding="utf-8")
    notes = opened(in_the_way)
    notes.add(ROWS)

    assert notes.arrays.keys() == ROWS.keys()
    assert keep(in_the_way, a_thing).name == "made"
    assert caplog.messages == [
        f"nothing is cached: {in_the_way} cannot be made (File exists)"
    ]


# Bounds


@pytest.mark.long
def test_of_many_arrays_the_oldest_are_given_up(tmp_path):
    notes = opened(tmp_path)
    notes.add({f"{number}": np.zeros(1) for number in range(MAX_ARRAYS)})
    notes.add({"new": np.zeros(1)})
    names = list(opened(tmp_path).arrays)

    assert len(names) == MAX_ARRAYS
    assert names[0] == "1"
    assert names[-1] == "new"
    assert "0" in notes.arrays  # this call may still need it


def test_of_many_files_of_a_name_the_oldest_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "MAX_FILES", 3)

    assert MAX_FILES > 3

    other = tmp_path / "table-0.npz"
    other.write_bytes(b"")
    for number in range(5):
        opened(tmp_path, fingerprint=f"{number:032}").add(ROWS)

    assert other.exists()
    assert len(list(tmp_path.glob("rows-*.npz"))) == 3
    assert opened(tmp_path, fingerprint=f"{4:032}").arrays.keys() == ROWS.keys()


# Values of any kind


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """A value with two arrays."""

    name: str
    part: tuple[FloatArray, FloatArray]


def a_thing():
    """A pair, one of whose arrays is read-only."""
    part = np.arange(3.0)
    part.setflags(write=False)
    return Pair(name="made", part=(part, np.arange(2.0)))


class Made:
    """Makes a thing, and counts how often."""

    def __init__(self):
        self.times = 0

    def __call__(self):
        self.times += 1
        return a_thing()


def keep(folder, make, *, made_from=("a", 1), packages=("scenarios",)):
    """The pair from the cache, or made."""
    return cached_value(
        folder,
        "things",
        make,
        kind=Pair,
        made_from=made_from,
        packages=packages,
    )


def test_a_value_is_made_once_and_read_back_as_it_was(tmp_path):
    make = Made()
    values = [keep(tmp_path, make) for _ in range(3)]

    assert make.times == 1

    for value in values:
        expected = Fingerprints().of(a_thing())
        assert Fingerprints().of(value) == expected
        assert [part.flags.writeable for part in value.part] == [False, True]


def test_a_value_that_is_not_worth_it_is_made_again(tmp_path):
    make = Made()
    for _ in range(2):
        cached_value(
            tmp_path,
            "things",
            make,
            kind=Pair,
            made_from=(),
            is_worth_it=lambda value: False,
        )

    assert make.times == 2
    assert not any(tmp_path.iterdir())


def test_a_value_from_something_else_or_other_code_is_made_anew(tmp_path, monkeypatch):
    make = Made()
    keep(tmp_path, make)
    keep(tmp_path, make, made_from=("a", 2))
    keep(tmp_path, make, packages=("scenarios", "geometry"))

    assert make.times == 3

    monkeypatch.setattr(fingerprints, "hash_of_files", lambda package: b"edited")
    keep(tmp_path, make)

    assert make.times == 4


def test_the_hash_of_a_package_is_that_of_its_code_and_data(tmp_path, monkeypatch):
    monkeypatch.setattr(fingerprints, "files", lambda package: tmp_path / package)
    for name in ("code.py", "data/facts.toml", "__pycache__/code.pyc"):
        (tmp_path / "pack" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "pack" / name).write_text("1", encoding="utf-8")

    hash_now = fingerprints.hash_of_files.__wrapped__
    hashes = [hash_now("pack")]
    for name in ("code.py", "data/facts.toml"):
        (tmp_path / "pack" / name).write_text("2", encoding="utf-8")
        hashes.append(hash_now("pack"))

    (tmp_path / "pack" / "__pycache__" / "code.pyc").write_text("2", encoding="utf-8")

    assert len(set(hashes)) == 3
    assert hash_now("pack") == hashes[-1]


def test_nothing_is_kept_without_a_folder_or_where_others_may_write(tmp_path):
    make = Made()
    tmp_path.chmod(0o777)
    for folder in (None, tmp_path):
        keep(folder, make)
        keep(folder, make)

    assert make.times == 4
    assert not list(tmp_path.iterdir())


def test_a_value_of_another_kind_under_the_right_hash_is_made_anew(tmp_path, caplog):
    make = Made()
    keep(tmp_path, make)
    (path,) = tmp_path.iterdir()

    for content in (
        to_bytes(7),
        to_bytes((1, 2)),
        to_bytes(Thing(name="a", part=1)),
        b"\xc1",
    ):
        key = cache._key(content, path.stem.removeprefix("things-"))
        path.write_bytes(key + content)

        assert keep(tmp_path, make).name == "made"
        assert caplog.messages.pop().startswith(
            f"cached things not used, made anew: {path}: "
        )

        caplog.clear()

    assert make.times == 5


@pytest.mark.parametrize(
    "content", [b"", b"short", b"x" * 400], ids=["empty", "cut off", "other"]
)
def test_a_damaged_value_is_told_and_made_anew(tmp_path, caplog, content):
    make = Made()
    keep(tmp_path, make)
    (path,) = tmp_path.iterdir()
    path.write_bytes(content)

    keep(tmp_path, make)

    assert caplog.messages == [
        f"cached things not used, made anew: {path}: its content is not what was"
        " written"
    ]

    keep(tmp_path, make)

    assert make.times == 2


def test_of_many_values_the_oldest_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "MAX_VALUES", 3)
    for number in range(5):
        keep(tmp_path, a_thing, made_from=(number,))

    assert len(list(tmp_path.iterdir())) == 3


# Values as bytes and back


@dataclass(frozen=True, kw_only=True, eq=False)
class Whole:
    """A value whose parts share arrays."""

    left: Pair
    right: Pair | Thing | None
    rest: tuple[Any, ...] = ()


class Point(NamedTuple):
    """A named tuple."""

    x: float
    y: int


def test_parts_that_were_shared_are_shared_again():
    pair = a_thing()
    whole = Whole(left=pair, right=pair, rest=(pair.part[0], (1, None, "a", 2.5, True)))

    found = from_bytes(to_bytes(whole), Whole)

    assert found.left is found.right
    assert found.rest[0] is found.left.part[0]
    assert found.rest[1] == (1, None, "a", 2.5, True)


def test_named_tuples_and_plain_ones_come_back_as_they_were():
    value = (
        Point(x=1.0, y=2),
        (3, (4.0,)),
    )

    found = from_bytes(to_bytes(value), tuple[Point, tuple[int, tuple[float]]])

    assert found == value
    assert type(found[0]) is Point


def test_only_classes_that_are_expected_are_made():
    whole = Whole(left=a_thing(), right=None, rest=(Point(x=1.0, y=2),))

    with pytest.raises(ValueError, match=r"of another kind: .*Point"):
        from_bytes(to_bytes(whole), Whole)

    expected = (Point(x=1.0, y=2),)

    assert from_bytes(to_bytes(whole), Whole, classes=(Point,)).rest == expected


@pytest.mark.parametrize(
    "hint",
    [Thing, tuple[Pair, ...], tuple[Pair, Pair], int, None],
    ids=["class", "tuple", "pair", "number", "nothing"],
)
def test_a_value_of_another_hint_is_an_error(hint):
    with pytest.raises(ValueError, match="of another kind"):
        from_bytes(to_bytes(a_thing()), hint)


@pytest.mark.parametrize(
    "value",
    [object(), [1], {"a": 1}, np.array(["a"])],
    ids=["object", "list", "mapping", "words"],
)
def test_a_value_that_cannot_be_cached_is_an_error_of_the_program(value):
    with pytest.raises(TypeError, match=r"cannot be cached|not of numbers"):
        to_bytes(Thing(name="a", part=value))


def test_nothing_is_unpickled(monkeypatch):
    def refuse(*args, **options):
        raise AssertionError("a pickle")

    monkeypatch.setattr("pickle.loads", refuse)
    monkeypatch.setattr("pickle.load", refuse)

    assert from_bytes(to_bytes(a_thing()), Pair).name == "made"
