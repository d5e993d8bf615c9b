"""Covering problems of the literature, LSCP and MCLP: read from files and solved by HiGHS.

LSCP, the location set covering problem [1]_: at least cost, cover every row, or enough. MCLP, the
maximal covering location problem [2]_: within a budget, cover as many rows as possible. The formats
of files, in ``data/covering.toml`` with their sources, are nothing but numbers; a file is in the
one that it fits from the first number to the last and, if several, in the one whose records begin
its lines.

References
----------
.. [1] C. Toregas, R. Swain, C. ReVelle, L. Bergman, "The location of emergency service facilities",
   Operations Research 19, 1971.
.. [2] R. L. Church, C. ReVelle, "The maximal covering location problem", Papers of the Regional
   Science Association 32, 1974.
"""

import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray, IntArray, float_array
from geometry.errors import InputError, check_one_of, refuse
from geometry.files import float_of, read_bytes, read_data, write_atomically

from .layout import relative_gap
from .memory import check_fits
from .optimiser.constants import COST_TOLERANCE_EUR, common_step, settle
from .optimiser.model import Answer, run_solver, solver_text


# ---------- instances and solutions
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveringInstance:
    """A covering problem without its question; made by :func:`build_covering_instance`."""

    covers: sp.csr_array  # (n_columns, n_rows): 1 where a column (a pose) covers a row (a demand)
    cost: FloatArray  # (n_columns,): price of each column, not negative
    numbered_from: int  # the number of the first column in the file

    @property
    def n_columns(self) -> int:
        """Number of columns."""
        return int(self.covers.shape[0])

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return int(self.covers.shape[1])

    def n_covered(self, columns: ArrayLike | None = None) -> int:
        """Number of rows that some columns cover; by default all columns together."""
        chosen = slice(None) if columns is None else np.asarray(columns, dtype=np.int64)
        return len(np.unique(self.covers[chosen].indices))

    def __repr__(self) -> str:
        return f"CoveringInstance({self.n_columns} columns, {self.n_rows} rows)"


def build_covering_instance(
    covers: "sp.sparray | ArrayLike", *, cost: ArrayLike | None = None, numbered_from: int = 0
) -> CoveringInstance:
    """Covering instance from a matrix of zeros and ones, (n_columns, n_rows); each cost is 1.

    Raises InputError: `cost` has another shape, or is negative or not finite.

    >>> build_covering_instance([[1, 1, 0], [0, 1, 1]])
    CoveringInstance(2 columns, 3 rows)
    """
    matrix = sp.csr_array(covers if sp.issparse(covers) else np.asarray(covers), dtype=np.float64)
    n_columns = matrix.shape[0]
    prices = float_array(np.ones(n_columns) if cost is None else cost, (n_columns,), "cost")
    if (prices < 0.0).any():
        raise InputError("cost", float(prices.min()), "no negative number")
    return CoveringInstance(covers=matrix, cost=prices, numbered_from=numbered_from)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveringSolution:
    """An answer to a covering problem, and how good it is."""

    chosen: IntArray  # (n,): indices of columns, ascending
    objective: float  # LSCP: their cost; MCLP: the number of rows that they cover
    bound: float  # LSCP: no answer costs less; MCLP: none covers more
    gap: float  # relative distance of the two, as HiGHS defines it
    solver: str  # what found and proved it
    seconds: float  # from instance to answer, model building included [s]

    @property
    def is_proven(self) -> bool:
        """True if the objective is proven to be the best there is."""
        return self.gap == 0.0


_MODEL_BYTES = 600  # of memory for each entry of the matrix: cvxpy's model and HiGHS' copy


def solve_covering(
    instance: CoveringInstance,
    *,
    budget_units: int | None = None,
    budget_cost: float | None = None,
    target: float | None = None,
    time_limit_s: float = math.inf,
    gap: float = 0.0,
) -> CoveringSolution:
    """Most rows within a budget (MCLP) or, without one, the least cost that covers enough (LSCP).

    x_c = 1: column c is chosen; y_r: row r is covered; y_r <= sum of the x that cover r. Only x has
    to be whole. `target`: share of all rows; by default every row that can be covered. The best
    answer found within the time is given with its bound, up to a relative `gap`. Raises InputError:
    target or budget is out of reach, or there is no memory for the model.
    """
    began_s = time.perf_counter()
    n_coverable = instance.n_covered()
    _check(instance, n_coverable, budget_units, budget_cost, target)
    if not time_limit_s > 0.0:
        raise InputError("time_limit_s", time_limit_s, "seconds, more than 0")
    if not 0.0 <= gap < 1.0:
        raise InputError("gap", gap, "a share, 0 <= gap < 1")
    import cvxpy as cp

    n_columns, cost = instance.n_columns, instance.cost
    unit = float(cost.max(initial=0.0)) or 1.0  # prices of the order of 1
    is_maximal = budget_units is not None or budget_cost is not None
    x, y = cp.Variable(n_columns, boolean=True), cp.Variable(instance.n_rows, bounds=[0.0, 1.0])
    constraints = [y <= sp.csr_array(instance.covers.T) @ x]
    if budget_units is not None:
        constraints.append(x.sum() <= min(budget_units, n_columns))
    if budget_cost is not None:
        constraints.append((cost / unit) @ x <= (budget_cost + COST_TOLERANCE_EUR * unit) / unit)
    if not is_maximal:
        needed = n_coverable if target is None else math.ceil(target * instance.n_rows - 1e-9)
        constraints.append(y.sum() >= needed)
    goal = cp.Maximize(y.sum() if is_maximal else -(cost / unit) @ x)
    answer = Answer(is_found=False, is_finished=True, bound=0.0)
    if n_coverable:
        answer = run_solver(cp.Problem(goal, constraints), time_limit_s=time_limit_s, gap=gap)
    if answer.is_found:
        chosen = np.flatnonzero(x.value > 0.5)
    else:  # not in time: nothing, or everything; both are within what is asked
        chosen = np.arange(0 if is_maximal or not n_coverable else n_columns)
    if is_maximal:
        objective = float(instance.n_covered(chosen))
        bound = settle(objective, answer.bound, n_coverable, step=1.0)
    else:
        objective = float(cost[chosen].sum())
        step = common_step(cost / unit)
        bound = -unit * settle(-objective / unit, answer.bound, 0.0, step=step)
    return CoveringSolution(
        chosen=chosen,
        objective=objective,
        bound=bound,
        gap=relative_gap(1.0, bound / objective) if objective > 0.0 else relative_gap(0.0, bound),
        solver=solver_text(),
        seconds=time.perf_counter() - began_s,
    )


def _check(
    instance: CoveringInstance,
    n_coverable: int,
    budget_units: int | None,
    budget_cost: float | None,
    target: float | None,
) -> None:
    """Raise InputError where a question has no answer, or its model no room."""
    if budget_units is not None and budget_units < 1:
        raise InputError("budget_units", budget_units, "a whole number of columns, at least 1")
    if budget_cost is not None:
        if not 0.0 <= budget_cost < math.inf:
            raise InputError("budget_cost", budget_cost, "an amount of money, at least 0")
        least = float(instance.cost[instance.covers.sum(axis=1) > 0].min(initial=math.inf))
        if budget_cost < least < math.inf:
            expected = f"at least {least:g}, the least cost of a column that covers anything"
            raise InputError("budget_cost", budget_cost, expected)
    if target is not None:
        if not 0.0 <= target <= 1.0:
            raise InputError("target", target, "max, or a share of the rows, 0 to 1")
        if target * instance.n_rows > n_coverable + 1.0e-9:
            most = math.floor(1.0e6 * n_coverable / instance.n_rows) / 1.0e6
            expected = f"at most {most:g}, the share that all columns together cover"
            raise InputError("target", target, expected)
    check_fits(
        "the model",
        f"{instance.covers.nnz:,} entries of a matrix",
        _MODEL_BYTES * instance.covers.nnz,
        "fewer rows or columns",
    )


# ---------- files of numbers
@dataclass(frozen=True, slots=True, kw_only=True)
class _Format:
    """The numbers of a file, see ``data/covering.toml``: two sizes, costs perhaps, then lists."""

    sizes: tuple[str, str]
    lists: int
    owner: str  # of a list: row, column, ..
    member: str
    has_costs: bool = False
    head: str = ""
    n_each: int | None = None
    first: int = 1


_COST, _ID = "the cost of a column", "the id of a sample"
_FORMATS = read_data(__package__, "covering.toml", dict[str, _Format])
FORMATS = tuple(_FORMATS)  # names of the formats that :func:`load_instance` reads

_MAX_SIZE = 10_000_000  # rows, columns: what a file of a few bytes may make us allocate
_MAX_BYTES = 1 << 30
_TEXT_BYTES = 25  # of memory for each byte of a file while it is read


class _MisfitError(Exception):
    """A file is not in a format, from a number on."""

    def __init__(self, index: int, expected: str) -> None:
        self.index, self.expected = index, expected
        super().__init__(expected)


class _Numbers:
    """The numbers of a file, taken one after another."""

    def __init__(self, values: FloatArray) -> None:
        self.values, self.at = values, 0

    def take(self, n: int, what: str, low: int, high: int | None = None) -> FloatArray:
        """The next numbers; they are whole if they have a highest value."""
        found = self.values[self.at : self.at + n]
        is_wrong, limits = found < low, f"at least {low}"
        if high is not None:
            is_wrong |= (found > high) | (found != np.floor(found))
            limits = f"{low} to {high}"
        if is_wrong.any():
            raise _MisfitError(self.at + int(is_wrong.argmax()), f"{what}, {limits}")
        self.at += len(found)
        if len(found) < n:
            n_more = n - len(found)
            raise _MisfitError(self.at, what if n_more == 1 else f"{n_more} numbers more: {what}")
        return found

    def size(self, what: str, high: int, *, low: int = 0) -> int:
        """The next number, which counts something."""
        return int(self.take(1, what, low, high)[0])


def load_instance(path: Path, *, format_name: str | None = None) -> CoveringInstance:
    """Read an instance in one of :data:`FORMATS`; by default the one that its numbers fit.

    Raises InputError if the file cannot be read, or holds no instance.
    """
    where = str(path)
    if format_name is not None:
        check_one_of("format_name", format_name, FORMATS)
    data = read_bytes(path, max_bytes=_MAX_BYTES)
    check_fits(where, f"{len(data):,} bytes of text", _TEXT_BYTES * len(data), "fewer rows")
    tokens = data.split()
    if not tokens:
        refuse(where, "an empty file", "an instance")
    values = _to_numbers(tokens, data, where)
    line_starts = np.cumsum([0, *(len(line.split()) for line in data.split(b"\n"))])
    fits = dict[str, tuple[CoveringInstance, bool]]()
    misfits = dict[str, _MisfitError]()
    for name in FORMATS if format_name is None else (format_name,):
        try:
            instance, records = _read(_Numbers(values), _FORMATS[name])
            fits[name] = instance, bool(np.isin(records, line_starts).all())
        except _MisfitError as misfit:
            misfits[name] = misfit
    if len(fits) > 1:
        lined = {name: fit for name, fit in fits.items() if fit[1]}
        if len(lined) != 1:
            got = "numbers that fit more than one format"
            refuse(where, got, "`format_name` " + " or ".join(lined or fits))
        fits = lined
    if fits:
        return next(iter(fits.values()))[0]
    name = max(misfits, key=lambda each: misfits[each].index)  # the one that it fits longest
    index, expected = misfits[name].index, f"{misfits[name].expected} (format {name})"
    place = _place(data, min(index, len(tokens) - 1))
    if index < len(tokens):
        raise InputError(f"{where}: {place}", _shown(tokens[index]), expected)
    refuse(f"{where}: {place}", "the end of the file after it", expected)


def save_instance(path: Path, instance: CoveringInstance) -> None:
    """Write an instance as OR-Library's sets are (orlib), whole or not at all; raises OSError."""
    lines = [f"{instance.n_rows} {instance.n_columns}", " ".join(map(repr, instance.cost.tolist()))]
    by_row = sp.csr_array(instance.covers.T)
    for columns in np.split(by_row.indices + 1, by_row.indptr[1:-1]):
        lines += [str(len(columns)), " ".join(map(str, columns.tolist()))]
    write_atomically(path, lambda file: file.write(("\n".join(lines) + "\n").encode()))


def _to_numbers(tokens: list[bytes], data: bytes, where: str) -> FloatArray:
    try:
        values = np.array(tokens).astype(np.float64)
    except ValueError:
        values = np.array([float_of(token) for token in tokens])
    if not np.isfinite(values).all():
        index = int((~np.isfinite(values)).argmax())
        expected = f"a number (format {', '.join(FORMATS[:-1])} or {FORMATS[-1]})"
        raise InputError(f"{where}: {_place(data, index)}", _shown(tokens[index]), expected)
    return values


def _shown(token: bytes) -> str:
    return token[:40].decode("latin-1")


def _place(data: bytes, index: int) -> str:
    """Where a number stands, in words."""
    for line, text in enumerate(data.split(b"\n"), start=1):
        n_tokens = len(text.split())
        if index < n_tokens:
            return f"line {line}, number {index + 1}"
        index -= n_tokens
    raise IndexError(index)


def _read(numbers: _Numbers, form: _Format) -> tuple[CoveringInstance, list[int]]:
    """The instance of a file, and which numbers begin a record; raises the first misfit."""
    counts = [numbers.size(f"the number of {what}", _MAX_SIZE, low=1) for what in form.sizes]
    n_lists, n_members = counts[form.lists], counts[1 - form.lists]
    heads, lists, records = [], [], list[int]()
    cost = np.ones(n_lists if form.owner == "column" else n_members)
    if form.has_costs:
        records.append(numbers.at)
        cost = numbers.take(n_members, _COST, 0)
    for index in range(n_lists):
        records.append(numbers.at)
        if form.head:
            heads.append(numbers.take(1, form.head, 0, n_lists - 1 if form.head == _ID else None))
        count = form.n_each or numbers.size(
            f"how many {form.member}s {form.owner} {index + 1} of {n_lists} has", n_members
        )
        last = n_members - 1 + form.first
        members = numbers.take(count, f"a {form.member}", form.first, last)
        if len(set(members.tolist())) < count:
            what = f"{form.member}s that the {form.owner} names once"
            raise _MisfitError(numbers.at - 1, what)
        lists.append(members)
    if numbers.at < len(numbers.values):
        raise _MisfitError(numbers.at, "the end of the file")
    owner = np.repeat(np.arange(n_lists), [len(members) for members in lists])
    member = np.concatenate(lists).astype(np.int64) - form.first
    if form.head == _ID:
        ids = np.concatenate(heads).astype(np.int64)
        again = np.delete(records, np.unique(ids, return_index=True)[1])
        if len(again):
            raise _MisfitError(int(again.min()), f"{_ID} that has not been there yet")
        owner = ids[owner]
    elif form.head == _COST:
        cost = np.concatenate(heads)
    column, row = (owner, member) if form.owner == "column" else (member, owner)
    n_rows = n_members if form.owner == "column" else n_lists
    matrix = sp.coo_array((np.ones(len(row)), (column, row)), shape=(len(cost), n_rows))
    return build_covering_instance(matrix, cost=cost, numbered_from=form.first), records
