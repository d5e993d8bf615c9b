"""Covering instances: which column covers which row, at what cost, for what weight; their files.

Instances are read from this program's own files, OR-Library's and GECCO 2020's.
"""

import contextlib
import math
import re
import stat
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray, IntArray, float_array, freeze
from geometry.errors import InputError, Unquoted
from geometry.files import write_atomically

# ---------- instances


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveringInstance:
    """A covering problem without its question: columns can be chosen, rows want to be covered.

    Attributes
    ----------
    covers : (n_columns, n_rows) sparse bool
        Whether a column (a pose) covers a row (a demand). Compressed by columns of the problem:
        ``covers.indices[covers.indptr[c] : covers.indptr[c + 1]]`` are the rows that column c
        covers, ascending. May be given as any array.
    cost : (n_columns,) float
        Price of each column, not negative.
    weight : (n_rows,) float
        What covering each row is worth, not negative.
    names : tuple of str
        Of the columns; empty if they have none.
    numbered_from : int
        The number of the first column where the instance comes from: 1 in OR-Library's files.
    """

    covers: sp.csr_array
    cost: FloatArray
    weight: FloatArray
    names: tuple[str, ...] = ()
    numbered_from: int = 0

    def __post_init__(self) -> None:
        matrix = _canonical(self.covers)
        n_columns, n_rows = matrix.shape
        object.__setattr__(self, "covers", matrix)
        object.__setattr__(self, "cost", _amounts(self.cost, n_columns, "cost"))
        object.__setattr__(self, "weight", _amounts(self.weight, n_rows, "weight"))
        if self.names and len(self.names) != n_columns:
            raise InputError("names", Unquoted(f"{len(self.names)} names"), f"{n_columns}, or none")

    @property
    def n_columns(self) -> int:
        """Number of columns."""
        return int(self.covers.shape[0])

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return int(self.covers.shape[1])

    @property
    def coverable_weight(self) -> float:
        """Weight of the rows that some column covers."""
        return float(self.weight[np.unique(self.covers.indices)].sum())

    def covered_weight(self, columns: ArrayLike) -> float:
        """Weight of the rows that some columns cover."""
        chosen = np.asarray(columns, dtype=np.int64)
        return float(self.weight[np.unique(self.covers[chosen].indices)].sum())

    def __repr__(self) -> str:
        return f"CoveringInstance({self.n_columns} columns, {self.n_rows} rows)"


def build_covering_instance(
    covers: "sp.sparray | ArrayLike",
    *,
    cost: ArrayLike | None = None,
    weight: ArrayLike | None = None,
    names: tuple[str, ...] = (),
    numbered_from: int = 0,
) -> CoveringInstance:
    """Covering instance from any matrix; cost and weight are 1 where they are not given.

    `covers`, (n_columns, n_rows), says whether a column covers a row. Raises InputError if shapes
    do not agree, or a number is negative or not finite.

    Examples
    --------
    >>> build_covering_instance([[1, 1, 0], [0, 1, 1]])
    CoveringInstance(2 columns, 3 rows)
    """
    matrix = _canonical(covers)
    return CoveringInstance(
        covers=matrix,
        cost=np.ones(matrix.shape[0]) if cost is None else np.asarray(cost),
        weight=np.ones(matrix.shape[1]) if weight is None else np.asarray(weight),
        names=names,
        numbered_from=numbered_from,
    )


def _canonical(covers: Any) -> sp.csr_array:
    """Sparse copy of what was given: no zeros, no row twice, rows ascending, read-only."""
    try:
        if not sp.issparse(covers):
            covers = np.asarray(covers)
        matrix = sp.csr_array(covers, copy=True)
    except (TypeError, ValueError):
        raise InputError("covers", Unquoted("no matrix"), "columns by rows, as 0 and 1") from None
    if matrix.ndim != 2:
        raise InputError(
            "covers", Unquoted(f"{matrix.ndim} dimensions"), "columns by rows, as 0 and 1"
        )
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    matrix.sort_indices()
    matrix.data = freeze(np.ones(matrix.nnz, dtype=np.bool_))
    matrix.indices = freeze(matrix.indices)
    matrix.indptr = freeze(matrix.indptr)
    return matrix


def _amounts(values: FloatArray, n: int, name: str) -> FloatArray:
    amounts = float_array(values, (n,), name)
    if (amounts < 0.0).any():
        raise InputError(name, float(amounts.min()), "no negative number")
    return amounts


# ---------- targets and budgets


TOLERANCE = 1.0e-9
"""Of sums of weights and of costs, relative to the largest sum there can be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoveringBudget:
    """What may be chosen."""

    units: int | None = None  # at most so many columns; by default any number
    cost: float | None = None  # at most so much money; by default any

    def __post_init__(self) -> None:
        if self.units is None and self.cost is None:
            raise InputError("--budget", Unquoted("nothing"), "a number of columns, or money")
        if self.units is not None and self.units < 1:
            raise InputError("--budget", self.units, "a whole number of columns, at least 1")
        if self.cost is not None and not 0.0 <= self.cost < math.inf:
            raise InputError("--budget-cost", self.cost, "an amount of money, at least 0")

    @property
    def money(self) -> float:
        """Most that may be spent, with what sums may be off by; infinite if there is no limit."""
        return math.inf if self.cost is None else self.cost * (1.0 + TOLERANCE)

    def allows(self, cost: ArrayLike) -> bool:
        """Whether columns at these costs may be chosen together."""
        costs = np.asarray(cost, dtype=np.float64)
        return (self.units is None or len(costs) <= self.units) and bool(costs.sum() <= self.money)


def simplify_budget(instance: CoveringInstance, budget: CoveringBudget) -> CoveringBudget:
    """Check that money buys anything; where all columns cost the same, it is a number of them.

    Raises InputError: there is less money than the cheapest useful column costs.
    """
    is_useful = np.asarray(instance.covers @ instance.weight) > 0.0
    if budget.cost is None or not is_useful.any():
        return budget
    prices = np.unique(instance.cost[is_useful])
    if prices[0] > budget.money:
        raise InputError(
            "--budget-cost",
            budget.cost,
            f"at least {prices[0]:g}, the least cost of a column that covers anything",
        )
    if len(prices) > 1 or prices[0] == 0.0:
        return budget
    units = int(min(budget.money / prices[0], instance.n_columns))
    return CoveringBudget(units=units if budget.units is None else min(units, budget.units))


def needed_weight(instance: CoveringInstance, target: float | None) -> float | None:
    """Weight that a target, a share of the weight of all rows, asks for.

    None where every row that can be covered is needed, as without a target. Raises InputError: the
    target is no share, or all columns together do not reach it.
    """
    if target is None:
        return None
    if not 0.0 <= target <= 1.0:
        raise InputError("--target", target, "max, or a share of the weight, 0 to 1")
    total, coverable = float(instance.weight.sum()), instance.coverable_weight
    needed = (target - TOLERANCE) * total
    if needed > coverable:
        most = math.floor(1.0e6 * coverable / total) / 1.0e6
        raise InputError(
            "--target", target, f"at most {most:g}, the share that all columns together cover"
        )
    least = float(instance.weight[instance.weight > 0.0].min(initial=math.inf))
    if needed > coverable - least:
        return None
    return float(np.ceil(needed)) if is_whole(instance.weight) else max(needed, 0.0)


def is_whole(amounts: FloatArray) -> bool:
    """Whether all are whole numbers, so that their sums are, too."""
    return bool((amounts == np.round(amounts)).all())


def check_effort(*, time_limit_s: float, gap: float) -> None:
    """Check how long to look and how near is near enough.

    Raises InputError: the time is not positive, or the gap is no share.
    """
    if not time_limit_s > 0.0:
        raise InputError("--time-limit", time_limit_s, "seconds, more than 0")
    if not 0.0 <= gap < 1.0:
        raise InputError("--gap", gap, "a share, 0 <= gap < 1")


# ---------- others' formats


_ORLIB, _GECCO = "orlib", "gecco"
_MAX_SIZE = 10_000_000  # rows, columns: what a file of a few bytes may make us allocate
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

    def whole(self, index: int, low: int, high: int, what: str) -> int:
        """A whole number from low to high."""
        if index >= len(self.value):
            raise _MisfitError(index, what)
        value = self.value[index]
        if not low <= value <= high or value != np.floor(value):
            raise _MisfitError(index, f"{what}, {low} to {high}")
        return int(value)

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
        """What stands there."""
        if index >= len(self.start):
            return Unquoted("the end of the file after it")
        return _token(self.data, int(self.start[index]))


def parse_covering_text(data: bytes, where: str, format_name: str | None) -> CoveringInstance:
    """Covering instance from the text of a file; its rows weigh 1.

    `where` is its name, for messages. Without `format_name`, the format is the one that it fits; a
    few numbers can fit both: it is GECCO's then if each line is a sample. Raises an InputError that
    names the line and the number from which on it fits no format.
    """
    numbers = _numbers(data, where)
    misfits: dict[str, _MisfitError] = {}
    fits: dict[str, CoveringInstance] = {}
    for name in TEXT_FORMATS if format_name is None else (format_name,):
        try:
            fits[name] = _READERS[name](numbers)
        except _MisfitError as misfit:
            misfits[name] = misfit
    if len(fits) == 1:
        return next(iter(fits.values()))
    if fits:
        lines = list(_are_samples(data))
        if lines and all(lines):
            return fits[_GECCO]
        raise InputError(
            where,
            Unquoted("numbers that fit more than one format"),
            "--format " + " or ".join(fits),
        )
    # The format that was meant: the one with such lines, else the one that it fits longest.
    has_samples = next(_are_samples(data), False)
    name = max(misfits, key=lambda each: (each == _GECCO and has_samples, misfits[each].index))
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
        with contextlib.suppress(ValueError):  # such as a sign without digits, told below
            value = np.fromstring(data.decode("ascii"), sep=" ")
    if len(value) != len(start) or not np.isfinite(value).all():
        for index, offset in enumerate(start):
            token = _token(data, int(offset), longest=None)
            if not _NUMBER.fullmatch(token.encode("latin-1")) or not np.isfinite(float(token)):
                numbers = _Numbers(data=data, start=start, value=value)
                raise InputError(
                    f"{where}: {numbers.place(index)}",
                    _token(data, int(offset)),
                    "a number (format orlib or gecco), or an .npz file of this program",
                )
    return _Numbers(data=data, start=start, value=value)


def _are_samples(data: bytes) -> Iterator[bool]:
    """Whether each line after the first is a sample of GECCO's: id, count, so many ids."""
    for line in data.splitlines()[1:]:
        numbers = line.split()
        if numbers:
            yield len(numbers) > 1 and numbers[1] == str(len(numbers) - 2).encode()


def _token(data: bytes, offset: int, *, longest: int | None = 40) -> str:
    """What stands from an offset to the next blank."""
    end = len(data) if longest is None else offset + longest
    token = data[offset : min(end, offset + 4096)].split(None, 1)[0]
    return token.decode("latin-1")


def _read_orlib(numbers: _Numbers) -> CoveringInstance:
    n_rows = numbers.whole(0, 1, _MAX_SIZE, "the number of rows")
    n_columns = numbers.whole(1, 1, _MAX_SIZE, "the number of columns")
    cost = numbers.value[2 : 2 + n_columns]
    if (cost < 0.0).any():
        raise _MisfitError(2 + int((cost < 0.0).argmax()), "the cost of a column, at least 0")
    if len(cost) < n_columns:
        raise _MisfitError(len(numbers.value), f"the costs of {n_columns} columns")
    rows, index = [], 2 + n_columns
    for row in range(1, n_rows + 1):
        what = f"how many columns cover row {row} of {n_rows}"
        count = numbers.whole(index, 0, n_columns, what)
        rows.append((index + 1, count))
        index += 1 + count
    return _instance(numbers, rows, index, cost, first=1)


def _read_gecco(numbers: _Numbers) -> CoveringInstance:
    n_samples = numbers.whole(0, 1, _MAX_SIZE, "the number of samples")
    n_candidates = numbers.whole(1, 1, _MAX_SIZE, "the number of candidates")
    rows: list[tuple[int, int]] = [(-1, 0)] * n_samples
    index = 2
    for nth in range(1, n_samples + 1):
        sample = numbers.whole(index, 0, n_samples - 1, f"the id of sample {nth} of {n_samples}")
        if rows[sample][0] >= 0:
            raise _MisfitError(index, "the id of a sample that has not been there yet")
        what = f"how many candidates see sample {sample}"
        count = numbers.whole(index + 1, 0, n_candidates, what)
        rows[sample] = (index + 2, count)
        index += 2 + count
    return _instance(numbers, rows, index, np.ones(n_candidates), first=0)


def _instance(
    numbers: _Numbers, rows: list[tuple[int, int]], end: int, cost: FloatArray, *, first: int
) -> CoveringInstance:
    """Instance from where the columns of each row stand, and how many they are."""
    start, count = np.array(rows, dtype=np.int64).T
    n_given = len(numbers.value)
    if end > n_given:
        raise _MisfitError(n_given, f"{end - n_given} more columns of the last row")
    before = np.cumsum(count) - count
    place = np.repeat(start - before, count) + np.arange(int(count.sum()))
    column = numbers.value[place]
    last = first + len(cost) - 1
    is_wrong = (column < first) | (column > last) | (column != np.floor(column))
    if is_wrong.any():
        raise _MisfitError(int(place[is_wrong].min()), f"a column, {first} to {last}")
    if end < n_given:
        raise _MisfitError(end, "the end of the file")
    row = np.repeat(np.arange(len(rows)), count)
    order = np.lexsort((place, column, row))
    is_again = np.zeros(len(order), dtype=np.bool_)
    is_again[1:] = (np.diff(row[order]) == 0) & (np.diff(column[order]) == 0)
    if is_again.any():
        raise _MisfitError(
            int(place[order][is_again].min()), "a column that the row has not named yet"
        )
    covers = sp.csr_array(
        (np.ones(len(column), dtype=np.bool_), (column.astype(np.int64) - first, row)),
        shape=(len(cost), len(rows)),
    )
    return CoveringInstance(
        covers=covers, cost=cost, weight=np.ones(len(rows)), numbered_from=first
    )


_READERS: Mapping[str, Callable[[_Numbers], CoveringInstance]] = {
    _ORLIB: _read_orlib,
    _GECCO: _read_gecco,
}

TEXT_FORMATS = tuple(_READERS)
"""Names of the formats."""


# ---------- reading and writing


NPZ = "npz"
FORMATS = (NPZ, *TEXT_FORMATS)
"""Names of the formats that :func:`load_instance` reads; of its own, npz."""

KIND = "place-rsus/covering-instance/1"
"""What our own files say they hold; raise the number whenever the fields change."""

_ZIP_MAGIC = b"PK"
_MAX_BYTES = 1 << 30
_MAX_UNPACKED_BYTES = 1 << 32


def load_instance(path: Path, *, format_name: str | None = None) -> CoveringInstance:
    """Read an instance in one of :data:`FORMATS`; by default the one that the content is in.

    Raises InputError if the file cannot be read, or holds no instance: the message says where, and
    what is expected there.
    """
    if format_name is not None and format_name not in FORMATS:
        raise InputError("--format", format_name, "one of " + ", ".join(FORMATS))
    where = str(path)
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise InputError(where, Unquoted("no regular file"), "a file")
        if status.st_size > _MAX_BYTES:
            raise InputError(
                where,
                Unquoted(f"{status.st_size:,} bytes"),
                f"an instance of at most {_MAX_BYTES:,} bytes",
            )
        with path.open("rb") as file:
            magic = file.read(len(_ZIP_MAGIC))
            file.seek(0)
            if format_name == NPZ or (format_name is None and magic == _ZIP_MAGIC):
                return _load_npz(file, where)
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
    """What kind of instance one of this program's files holds, such as :data:`KIND`.

    None if the file cannot be read, or is none of this program's.
    """
    try:
        # Opened here: numpy does not close a file that turns out to be no archive.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return str(stored["kind"])
    except Exception:  # what is wrong with it is told by what reads it
        return None


def _load_npz(file: BinaryIO, where: str) -> CoveringInstance:
    try:
        with np.load(file, allow_pickle=False) as stored:
            n_bytes = sum(member.file_size for member in stored.zip.infolist())
            if n_bytes > _MAX_UNPACKED_BYTES:
                raise InputError(
                    where,
                    Unquoted(f"{n_bytes:,} bytes when unpacked"),
                    f"an instance of at most {_MAX_UNPACKED_BYTES:,}",
                )
            fields = {name: stored[name] for name in stored.files}
    except (InputError, OSError):
        raise
    except Exception as error:  # what damaged archives raise has no end: zipfile's, zlib's
        words = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            where, Unquoted(f"a damaged file ({words})"), "an .npz file of this program"
        ) from None
    kind = str(fields["kind"]) if "kind" in fields else Unquoted("nothing")
    if kind != KIND:
        raise InputError(f"{where}: kind", kind, repr(KIND))
    try:
        return _covering_from(fields)
    except InputError as error:
        raise InputError(f"{where}: {error.where}", error.got, error.expected) from None


def _covering_from(fields: Mapping[str, Any]) -> CoveringInstance:
    for name in ("n_rows", "covered_rows_start", "covered_rows", "cost", "weight"):
        if name not in fields:
            raise InputError(name, Unquoted("nothing"), "an array")
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
        names=tuple(map(str, np.atleast_1d(fields.get("names", ())))),
        numbered_from=int(fields.get("numbered_from", 0)),
    )
