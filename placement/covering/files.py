"""Files of covering instances: this program's own, OR-Library's, GECCO's, Steiner triples.

Four formats are nothing but numbers. A file is in the one that it fits from the first number to the
last; where it fits several, in the one whose records begin the lines of the file.

orlib
    OR-Library's sets 4 to 6, A to E, NRE to NRH, CYC and CLR [1]_: rows, columns; the cost of each
    column; for each row, how many columns cover it, and which, from 1.
rail
    OR-Library's railway instances [1]_: rows, columns; for each column, its cost, how many rows it
    covers, and which, from 1.
gecco
    Camera placement competition of GECCO 2020 [2]_: samples, candidates; for each sample, its id,
    how many candidates see it, and which, from 0.
sts
    Steiner triple systems [3]_: variables, triples; the three variables of each triple, from 1. The
    variables are columns, the triples rows.

References
----------
.. [1] J. E. Beasley, "OR-Library: distributing test problems by electronic mail", Journal of the
   Operational Research Society 41, 1990; its page scpinfo.
.. [2] J. Kritter, M. Brévilliers, J. Lepagnot, L. Idoumghar, "On the optimal placement of cameras
   for surveillance and the underlying set cover problem", Applied Soft Computing 74, 2019.
.. [3] D. R. Fulkerson, G. L. Nemhauser, L. E. Trotter, "Two computationally difficult set covering
   problems that arise in computing the 1-width of incidence matrices of Steiner triple systems",
   Mathematical Programming Study 2, 1974; files and README by M. G. C. Resende.
"""

import contextlib
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import scipy.sparse as sp

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.errors import InputError, Unquoted
from geometry.files import open_file, write_atomically
from geometry.untrusted_files import is_text, unpacked_bytes

from ..memory import check_fits
from .solve import CoveringInstance

# ---------- others' formats


_ORLIB, _GECCO, _RAIL, _STS = "orlib", "gecco", "rail", "sts"
_MAX_SIZE = 10_000_000  # rows, columns: what a file of a few bytes may make us allocate
_TRIPLE = 3
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_CHARACTERS = b"0123456789+-.eE \t\n\r\v\f"
_IS_BLANK = np.isin(np.arange(256), list(b" \t\n\r\v\f"))


class _MisfitError(Exception):
    """A file is not in a format, from a number on."""

    def __init__(self, index: int, expected: str) -> None:
        self.index = index
        self.expected = expected
        super().__init__(expected)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Numbers:
    """The numbers of a file and where they stand."""

    data: bytes  # the file
    start: IntArray  # (n,): where each number starts
    value: FloatArray  # (n,): what it is

    def __len__(self) -> int:
        return len(self.value)

    def whole(self, index: int, low: int, high: int, what: str) -> int:
        """A whole number from low to high."""
        if index >= len(self):
            raise _MisfitError(index, what)
        value = self.value[index]
        if not low <= value <= high or value != np.floor(value):
            raise _MisfitError(index, f"{what}, {low} to {high}")
        return int(value)

    def begin_lines(self, indices: IntArray) -> bool:
        """True if all of some numbers are the first of their lines."""
        text = np.frombuffer(self.data, dtype=np.uint8)
        ends = np.flatnonzero((text == ord("\n")) | (text == ord("\r")))
        line = np.searchsorted(ends, self.start)
        return bool((line[indices] > line[indices - 1]).all())

    def place(self, index: int) -> str:
        """Where a number stands, in words."""
        if len(self.start) == 0:
            return "line 1"
        offset = int(self.start[min(index, len(self.start) - 1)])
        line_start = self.data.rfind(b"\n", 0, offset) + 1
        line = self.data.count(b"\n", 0, offset) + 1
        nth = len(self.data[line_start:offset].split()) + 1
        return f"line {line}, number {nth}"

    def text(self, index: int) -> object:
        """Text at a number's place."""
        if index >= len(self.start):
            return Unquoted("the end of the file after it")
        return _token(self.data, int(self.start[index]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Reading:
    """An instance as a format reads it."""

    instance: CoveringInstance
    records: IntArray  # (n,): numbers that begin a line in such files


def parse_covering_text(data: bytes, where: str, format_name: str | None) -> CoveringInstance:
    """Covering instance from the text of a file; its rows weigh 1.

    `where` is its name, for messages. Without `format_name`, the format is the one that it fits; a
    few numbers can fit several: it is the one then of which each record begins a line. Raises an
    InputError that names the line and the number from which on it fits no format.
    """
    numbers = _numbers(data, where)
    misfits: dict[str, _MisfitError] = {}
    fits: dict[str, _Reading] = {}
    for name in TEXT_FORMATS if format_name is None else (format_name,):
        try:
            fits[name] = _READERS[name](numbers)
        except _MisfitError as misfit:
            misfits[name] = misfit
    if len(fits) > 1:
        lined = [name for name, each in fits.items() if numbers.begin_lines(each.records)]
        if len(lined) != 1:
            raise InputError(
                where,
                Unquoted("numbers that fit more than one format"),
                "`format_name` " + " or ".join(lined or fits),
            )
        fits = {name: fits[name] for name in lined}
    if fits:
        return next(iter(fits.values())).instance
    # The format that was meant: one that has most of its lines, else the one it fits longest.
    meant = _formats_of_lines(data)
    name = max(misfits, key=lambda each: (each in meant, misfits[each].index))
    index = misfits[name].index
    raise InputError(
        f"{where}: {numbers.place(index)}",
        numbers.text(index),
        f"{misfits[name].expected} (format {name})",
    )


def _numbers(data: bytes, where: str) -> _Numbers:
    is_blank = _IS_BLANK[np.frombuffer(data, dtype=np.uint8)]
    start = np.flatnonzero(~is_blank & np.append(True, is_blank[:-1])[: len(is_blank)])
    value = np.empty(0)
    if not data.translate(None, _CHARACTERS):
        with contextlib.suppress(ValueError):  # such as a sign without digits, refused below
            value = np.fromstring(data.decode("ascii"), sep=" ")
    if len(value) != len(start) or not np.isfinite(value).all():
        for index, offset in enumerate(start):
            token = _token(data, int(offset), longest=None)
            if not _NUMBER.fullmatch(token.encode("latin-1")) or not np.isfinite(float(token)):
                numbers = _Numbers(data=data, start=start, value=value)
                raise InputError(
                    f"{where}: {numbers.place(index)}",
                    _token(data, int(offset)),
                    f"a number (format {_one_of(TEXT_FORMATS)}), or an .npz file of this program",
                )
    return _Numbers(data=data, start=start, value=value)


def _formats_of_lines(data: bytes) -> set[str]:
    """Formats with a record to a line, if most of the lines after the first are such records."""
    sizes, *lines = [line.split() for line in data.splitlines() if line.strip()]
    n_lists = sum(len(line) > 1 and line[1] == str(len(line) - 2).encode() for line in lines)
    n_triples = sum(len(line) == _TRIPLE for line in lines)
    if 2 * n_lists > len(lines):
        formats = (_GECCO, _RAIL)  # as many records as the first, or the second number says
        exact = {name for name, size in zip(formats, sizes, strict=False) if float(size) == n_lists}
        return exact or set(formats)
    return {_STS} if 2 * n_triples > len(lines) else set()


def _one_of(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}"


def _token(data: bytes, offset: int, *, longest: int | None = 40) -> str:
    """Text from an offset to the next blank."""
    end = len(data) if longest is None else offset + longest
    token = data[offset : min(end, offset + 4096)].split(None, 1)[0]
    return token.decode("latin-1")


def _read_orlib(numbers: _Numbers) -> _Reading:
    n_rows = numbers.whole(0, 1, _MAX_SIZE, "the number of rows")
    n_columns = numbers.whole(1, 1, _MAX_SIZE, "the number of columns")
    cost = numbers.value[2 : 2 + n_columns]
    _raise_first(_wrong(numbers, np.arange(2, 2 + len(cost)), 0, None, _COST))
    if len(cost) < n_columns:
        raise _MisfitError(len(numbers), f"the costs of {n_columns} columns")
    lists, misfit = _find_lists(
        numbers, 2 + n_columns, n_rows, 0, n_columns, "", "how many columns cover row {}"
    )
    _check_lists(numbers, lists, misfit, 1, n_columns, "column", "row")
    return _Reading(
        instance=_by_rows(numbers, lists, cost, first=1),
        records=np.append(2, lists.record),
    )


def _read_gecco(numbers: _Numbers) -> _Reading:
    n_samples = numbers.whole(0, 1, _MAX_SIZE, "the number of samples")
    n_candidates = numbers.whole(1, 1, _MAX_SIZE, "the number of candidates")
    lists, misfit = _find_lists(
        numbers,
        2,
        n_samples,
        1,
        n_candidates,
        "the id of sample {}",
        "how many candidates see sample {}",
    )
    what = "the id of a sample"
    misfits = [misfit, _wrong(numbers, lists.record, 0, n_samples - 1, what)]
    samples = numbers.value[lists.record]
    misfits.append(_again(samples, lists.record, "the id of a sample that has not been there yet"))
    _check_lists(numbers, lists, _first(misfits), 0, n_candidates - 1, "column", "sample")
    order = np.argsort(samples)
    return _Reading(
        instance=_by_rows(numbers, lists.take(order), np.ones(n_candidates), first=0),
        records=lists.record,
    )


def _read_rail(numbers: _Numbers) -> _Reading:
    n_rows = numbers.whole(0, 1, _MAX_SIZE, "the number of rows")
    n_columns = numbers.whole(1, 1, _MAX_SIZE, "the number of columns")
    lists, misfit = _find_lists(
        numbers, 2, n_columns, 1, n_rows, "the cost of column {}", "how many rows column {} covers"
    )
    misfits = [misfit, _wrong(numbers, lists.record, 0, None, _COST)]
    _check_lists(numbers, lists, _first(misfits), 1, n_rows, "row", "column")
    rows = numbers.value[lists.members()].astype(np.int64) - 1
    start = np.append(0, np.cumsum(lists.count))
    covers = sp.csr_array((np.ones(len(rows), dtype=np.bool_), rows, start), (n_columns, n_rows))
    cost = numbers.value[lists.record]
    return _Reading(
        instance=CoveringInstance(
            covers=covers, cost=cost, weight=np.ones(n_rows), numbered_from=1
        ),
        records=lists.record,
    )


def _read_sts(numbers: _Numbers) -> _Reading:
    n_columns = numbers.whole(0, 1, _MAX_SIZE, "the number of variables")
    n_rows = numbers.whole(1, 1, _MAX_SIZE, "the number of triples")
    n_whole = min(n_rows, (len(numbers) - 2) // _TRIPLE)
    end = 2 + _TRIPLE * n_whole
    record = 2 + _TRIPLE * np.arange(n_whole)
    lists = _Lists(record=record, start=record, count=np.full(n_whole, _TRIPLE), end=end)
    misfit = None
    if n_whole < n_rows:
        misfit = _MisfitError(len(numbers), f"the variables of triple {n_whole + 1} of {n_rows}")
    _check_lists(numbers, lists, misfit, 1, n_columns, "variable", "triple")
    return _Reading(
        instance=_by_rows(numbers, lists, np.ones(n_columns), first=1), records=lists.record
    )


_READERS: Mapping[str, Callable[[_Numbers], _Reading]] = {
    _ORLIB: _read_orlib,
    _GECCO: _read_gecco,
    _RAIL: _read_rail,
    _STS: _read_sts,
}

TEXT_FORMATS = tuple(_READERS)
"""Names of the formats."""

_COST = "the cost of a column"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Lists:
    """Where lists of columns or rows stand."""

    record: IntArray  # (n,): the number with which a list begins, its head
    start: IntArray  # (n,): its first member
    count: IntArray  # (n,): its members
    end: int  # where the last one ends

    def take(self, order: IntArray) -> "_Lists":
        """Lists in another order."""
        return _Lists(
            record=self.record[order],
            start=self.start[order],
            count=self.count[order],
            end=self.end,
        )

    def members(self) -> IntArray:
        """Where the members of all lists stand."""
        before = np.cumsum(self.count) - self.count
        places: IntArray = np.repeat(self.start - before, self.count)
        return places + np.arange(len(places))

    def of_member(self) -> IntArray:
        """The list of each member."""
        return np.repeat(np.arange(len(self.count)), self.count)


def _find_lists(
    numbers: _Numbers, index: int, n_lists: int, n_heads: int, most: int, head: str, what: str
) -> tuple[_Lists, _MisfitError | None]:
    """Lists of at most so many members: heads, how many members, members; those before a misfit."""
    value, n_given = numbers.value, len(numbers)
    record: list[int] = []
    counts: list[int] = []
    misfit = None
    while len(record) < n_lists and misfit is None:
        place = index + n_heads
        count = value[place] if place < n_given else -1.0
        if 0.0 <= count <= most and count == int(count):
            record.append(index)
            counts.append(int(count))
            index = place + 1 + int(count)
            continue
        words = (head if index >= n_given and head else what).format(
            f"{len(record) + 1} of {n_lists}"
        )
        if place >= n_given:
            misfit = _MisfitError(n_given, words)
        else:
            misfit = _MisfitError(place, f"{words}, 0 to {most}")
    records, count_array = np.array(record, dtype=np.int64), np.array(counts, dtype=np.int64)
    start = records + n_heads + 1
    if index > n_given:  # the last list is cut off
        count_array[-1] = n_given - start[-1]
    return _Lists(record=records, start=start, count=count_array, end=index), misfit


def _check_lists(
    numbers: _Numbers,
    lists: _Lists,
    misfit: _MisfitError | None,
    low: int,
    high: int,
    member: str,
    owner: str,
) -> None:
    """Raise the first misfit: of the members, one known already, or numbers that are left over."""
    places = lists.members()
    wrong = _wrong(numbers, places, low, high, f"a {member}")
    misfits = [misfit, wrong]
    if misfit is None and lists.end < len(numbers):
        misfits.append(_MisfitError(lists.end, "the end of the file"))
    if lists.end > len(numbers):
        n_missing = lists.end - len(numbers)
        misfits.insert(
            0, _MisfitError(len(numbers), f"{n_missing} more {member}s of the last {owner}")
        )
    if wrong is None:
        keys = lists.of_member() * (high + 1) + numbers.value[places].astype(np.int64)
        misfits.append(_again(keys, places, f"a {member} that the {owner} has not named yet"))
    _raise_first(*misfits)


def _wrong(
    numbers: _Numbers, places: IntArray, low: int, high: int | None, what: str
) -> _MisfitError | None:
    """The first of some numbers that is none from low to high, whole where there is a high."""
    value = numbers.value[places]
    is_wrong: BoolArray = value < low
    if high is not None:
        is_wrong |= (value > high) | (value != np.floor(value))
    if not is_wrong.any():
        return None
    expected = f"{what}, at least {low}" if high is None else f"{what}, {low} to {high}"
    return _MisfitError(int(places[is_wrong].min()), expected)


def _again(values: IntArray | FloatArray, places: IntArray, what: str) -> _MisfitError | None:
    """The first of some numbers that has been there before."""
    if len(np.unique(values)) == len(values):
        return None
    order = np.lexsort((places, values))
    is_again = np.zeros(len(order), dtype=np.bool_)
    is_again[1:] = np.diff(values[order]) == 0
    return _MisfitError(int(places[order][is_again].min()), what)


def _first(misfits: Sequence[_MisfitError | None]) -> _MisfitError | None:
    found = [misfit for misfit in misfits if misfit is not None]
    return min(found, key=lambda misfit: misfit.index, default=None)


def _raise_first(*misfits: _MisfitError | None) -> None:
    misfit = _first(misfits)
    if misfit is not None:
        raise misfit


def _by_rows(numbers: _Numbers, lists: _Lists, cost: FloatArray, *, first: int) -> CoveringInstance:
    """Instance from the columns of each row, which are numbered from `first`."""
    column = numbers.value[lists.members()].astype(np.int64) - first
    covers = sp.csr_array(
        (np.ones(len(column), dtype=np.bool_), (column, lists.of_member())),
        shape=(len(cost), len(lists.count)),
    )
    return CoveringInstance(
        covers=covers, cost=cost, weight=np.ones(len(lists.count)), numbered_from=first
    )


# ---------- reading and writing


NPZ = "npz"
FORMATS = (NPZ, *TEXT_FORMATS)
"""Names of the formats that :func:`load_instance` reads; of its own, npz."""

KIND = "place-rsus/covering-instance/1"
"""Kind of our own files; raise the number whenever the fields change."""

_OPTIONAL = {"numbered_from": 0, "names": np.empty(0, dtype=np.str_)}
_ZIP_MAGIC = b"PK"
_MAX_BYTES = 1 << 30
_TEXT_BYTES = (
    25  # of memory for each byte of a file of numbers while it is read; measured: 19 to 24
)
_UNPACKED_BYTES = 6  # of memory for each byte of our own files, unpacked, while they are read


def load_instance(path: Path, *, format_name: str | None = None) -> CoveringInstance:
    """Read an instance in one of :data:`FORMATS`; by default the one that the content is in.

    Raises InputError if the file cannot be read, or holds no instance: the message says where, and
    what is expected there.
    """
    if format_name is not None and format_name not in FORMATS:
        raise InputError("format_name", format_name, "one of " + ", ".join(FORMATS))
    where = str(path)
    try:
        with open_file(path, max_bytes=_MAX_BYTES) as file:
            n_bytes = os.fstat(file.fileno()).st_size
            magic = file.read(len(_ZIP_MAGIC))
            file.seek(0)
            if format_name == NPZ or (format_name is None and magic == _ZIP_MAGIC):
                return _load_npz(file, where)
            check_fits(
                where,
                f"{n_bytes:,} bytes of text",
                _TEXT_BYTES * n_bytes,
                "fewer rows or columns, or a file of this program (`out`, .npz), a fifth of it",
            )
            data = file.read()
    except OSError as error:
        raise InputError(where, Unquoted(error.strerror or error), "a readable file") from None
    if not data.strip():
        raise InputError(where, Unquoted("an empty file"), "an instance")
    return parse_covering_text(data, where, format_name)


def save_instance(path: Path, instance: CoveringInstance) -> None:
    """Write an instance in this program's own format, whole or not at all.

    Raises OSError: the file cannot be written.
    """
    covers = instance.covers
    write_atomically(
        path,
        lambda file: np.savez_compressed(
            file,
            kind=KIND,
            n_rows=instance.n_rows,
            covered_rows_start=covers.indptr,
            covered_rows=covers.indices,
            cost=instance.cost,
            weight=instance.weight,
            names=np.array(instance.names, dtype=np.str_),
            numbered_from=instance.numbered_from,
        ),
    )


def instance_kind(path: Path) -> str | None:
    """Kind of instance that one of this program's files holds, such as :data:`KIND`.

    None if the file cannot be read, or is none of this program's.
    """
    try:
        # Opened here: numpy does not close a file that turns out to be no archive.
        with open_file(path) as file, np.load(file, allow_pickle=False) as stored:
            return str(stored["kind"])
    except Exception:  # what is wrong with it is said by what reads it
        return None


def _load_npz(file: BinaryIO, where: str) -> CoveringInstance:
    try:
        with np.load(file, allow_pickle=False) as stored:
            n_bytes = unpacked_bytes(stored.zip, where)
            check_fits(
                where,
                f"{n_bytes:,} bytes when unpacked",
                _UNPACKED_BYTES * n_bytes,
                "fewer rows or columns",
            )
            fields = {name: stored[name] for name in stored.files}
    except (InputError, OSError):
        raise
    except Exception as error:  # what damaged archives raise has no end: zipfile's, zlib's
        words = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            where, Unquoted(f"a damaged file ({words})"), "an .npz file of this program"
        ) from None
    told = np.asarray(fields.get("kind", 0))
    kind = str(told) if is_text(told) else Unquoted("no text" if "kind" in fields else "nothing")
    if kind != KIND:
        raise InputError(f"{where}: kind", kind, repr(KIND))
    try:
        return _covering_from(fields)
    except InputError as error:
        raise InputError(f"{where}: {error.where}", error.got, error.expected) from None


def _covering_from(fields: Mapping[str, Any]) -> CoveringInstance:
    for name in ("n_rows", "covered_rows_start", "covered_rows", "cost", "weight"):
        if not isinstance(fields.get(name), np.ndarray):  # what is no array is read as bytes
            got = "something else" if name in fields else "nothing"
            raise InputError(name, Unquoted(got), "an array")
        if fields[name].dtype.kind not in "iuf":
            raise InputError(name, Unquoted(f"an array of {fields[name].dtype}"), "numbers")
    start, rows = fields["covered_rows_start"], fields["covered_rows"]
    for name in ("n_rows", "covered_rows_start", "covered_rows"):
        if fields[name].dtype.kind == "f":
            raise InputError(name, Unquoted(f"an array of {fields[name].dtype}"), "whole numbers")
    if fields["n_rows"].shape != () or not 0 <= fields["n_rows"] < 1 << 31:
        raise InputError("n_rows", fields["n_rows"].tolist(), "a number of rows")
    if start.ndim != 1 or len(start) == 0 or rows.ndim != 1:
        raise InputError(
            "covered_rows_start", Unquoted(f"shape {start.shape}"), "one number more than columns"
        )
    first, names = (np.asarray(fields.get(name, empty)) for name, empty in _OPTIONAL.items())
    if first.shape != () or first.dtype.kind not in "iu":
        raise InputError("numbered_from", Unquoted(f"{first.dtype} of shape {first.shape}"), "0, 1")
    if names.ndim != 1 or not is_text(names):
        raise InputError("names", Unquoted(f"{names.dtype} of shape {names.shape}"), "texts")
    try:
        covers = sp.csr_array(
            (np.ones(len(rows), dtype=np.bool_), rows, start),
            shape=(len(start) - 1, int(fields["n_rows"])),
        )
        covers.check_format(full_check=True)
    except ValueError as error:
        raise InputError("covered_rows", Unquoted(error), "rows of every column") from None
    return CoveringInstance(
        covers=covers,
        cost=fields["cost"],
        weight=fields["weight"],
        names=tuple(names.tolist()),
        numbered_from=int(first),
    )
