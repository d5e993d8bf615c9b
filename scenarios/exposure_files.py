"""Weights of runs from a CSV file: case, approach, weight, and weather if wanted."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted

from .runs import Run

_COLUMNS = ("case", "approach", "weight")
_OPTIONAL = "weather"
_ANY = ("", "*")


def weight_from_csv(path: Path, runs: Sequence[Run]) -> FloatArray:
    """Weights by a user's own exposure table.

    Parameters
    ----------
    path : Path
        UTF-8, separated by commas or semicolons. Columns case, approach, weight, and if wanted
        weather; "*" or nothing in approach or weather stands for all.
    runs : sequence of Run
        At least one.

    Returns
    -------
    weight : (n_runs,) float
        The weight of a row is shared equally by the runs that it names; what no row names weighs
        nothing. Sums to 1.

    Raises
    ------
    InputError
        The file cannot be read, a column is missing, a row names no run, or a run again, or its
        weight is not a number >= 0; all weights are 0.
    """
    weight = np.zeros(len(runs))
    named = np.zeros(len(runs), dtype=np.int64)  # by which line
    for line, row in _read_rows(path):
        where = f"{path}: line {line}"
        amount = _read_weight(row["weight"], where)
        members = [index for index, run in enumerate(runs) if _is_named(run, row)]
        if not members:
            raise InputError(where, Unquoted(_words(row)), _what_is_driven(runs, row))
        again = named[members][named[members] > 0]
        if len(again):
            raise InputError(
                where, Unquoted(_words(row)), f"runs that line {again[0]} does not name already"
            )
        named[members] = line
        weight[members] = amount / len(members)
    if not weight.any():
        raise InputError(f"{path}: weight", Unquoted("0 in all rows"), "one weight more than 0")
    shares: FloatArray = weight / weight.sum()
    return shares


def _read_rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(str(path), Unquoted(error.strerror or error), "a readable file") from None
    except UnicodeDecodeError as error:
        raise InputError(str(path), Unquoted(error), "a CSV file in UTF-8") from None
    lines = text.splitlines()
    separator = ";" if lines and ";" in lines[0] else ","
    try:
        reader = csv.reader(lines, delimiter=separator, strict=True)
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except csv.Error as error:
        raise InputError(str(path), Unquoted(error), "a CSV file") from None
    rows = [(line, row) for line, row in rows if any(row)]
    expected = ", ".join(_COLUMNS) + f", and {_OPTIONAL} if wanted"
    if not rows:
        raise InputError(str(path), Unquoted("an empty file"), f"columns {expected}")
    header = [name.lower() for name in rows[0][1]]
    unknown = [name for name in header if name not in (*_COLUMNS, _OPTIONAL)]
    if unknown or len(set(header)) < len(header) or not set(_COLUMNS) <= set(header):
        raise InputError(f"{path}: line {rows[0][0]}", Unquoted(", ".join(header)), expected)
    for line, row in rows[1:]:
        if len(row) != len(header):
            raise InputError(
                f"{path}: line {line}", Unquoted(f"{len(row)} columns"), f"{len(header)}"
            )
    if len(rows) == 1:
        raise InputError(str(path), Unquoted("no rows"), "one row per case and approach")
    return [
        (line, {_OPTIONAL: "", **dict(zip(header, row, strict=True))}) for line, row in rows[1:]
    ]


def _read_weight(text: str, where: str) -> float:
    try:
        amount = float(text)
    except ValueError:
        amount = math.nan
    if not 0.0 <= amount < math.inf:
        raise InputError(f"{where}: weight", text, "a number, at least 0")
    return amount


def _is_named(run: Run, row: Mapping[str, str]) -> bool:
    return (
        run.case.name == row["case"]
        and row["approach"] in (*_ANY, run.approach)
        and row[_OPTIONAL] in (*_ANY, run.weather)
    )


def _words(row: Mapping[str, str]) -> str:
    return ", ".join(repr(row[key]) for key in ("case", "approach", _OPTIONAL) if row[key])


def _what_is_driven(runs: Sequence[Run], row: Mapping[str, str]) -> str:
    of_case = [run for run in runs if run.case.name == row["case"]]
    if not of_case:
        return "a case that is driven: " + ", ".join(dict.fromkeys(run.case.name for run in runs))
    ways = ", ".join(dict.fromkeys(f"{run.approach} by {run.weather}" for run in of_case))
    return f"an approach and weather in which {row['case']} is driven: {ways}"
