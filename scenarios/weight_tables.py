"""Weights by tables: a user's CSV file, Euro NCAP's points, and accident statistics.

The statistics (``data/crash_types.toml``) know types of accidents and how near to a
junction they happen; a table of one's own, by case, approach, position and weather, may
know better.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct

from geometry.arrays import FloatArray
from geometry.csv_files import csv_rows, read_csv_text
from geometry.errors import InputError, MissingExtraError, Unquoted, refuse
from geometry.tables import Text, read_data, read_table
from geometry.text_formats import float_of, load_data

from .positions import read_position
from .runs import Run
from .weights import (
    CRASH_TYPES,
    FORMATS,
    RATING,
    WEIGHT_WORDS,
    shares_of,
    weight_per_case,
)

# ---------- weights from a CSV file
_COLUMNS = ("case", "approach", "weight")
_OPTIONAL = ("position", "weather")
_ANY = ("", "*")


def weight_from_csv(path: Path, runs: Sequence[Run]) -> FloatArray:
    """Weights by a user's own table.

    The file is UTF-8, separated by commas or semicolons, with columns case,
    approach, weight, and if wanted position and weather; "*" or nothing in
    approach, position or weather stands for all, and a position without sign, but
    for 0, lies behind the junction. The weight of a row is shared equally by the
    runs that it names; what no row names weighs nothing. The weights sum to 1.

    Raises
    ------
    InputError
        The file cannot be read, a column is missing, a row names no run, or a
        run again, or its weight is not a number >= 0; all weights are 0.
    """
    # What no row names keeps weight 0.
    weight = np.zeros(len(runs))
    # By which line.
    named: dict[int, str] = {}
    for where, row in _read_rows(path):
        amount = _read_weight(row["weight"], where)
        row["position"] = _read_position(row["position"], where)
        members = [
            index
            for index, run in enumerate(runs)
            if run.case.name == row["case"]
            and row["approach"] in (*_ANY, run.approach)
            and row["position"] in (*_ANY, run.position)
            and row["weather"] in (*_ANY, run.weather)
        ]
        if not members:
            raise InputError(where, Unquoted(_words(row)), _what_is_driven(runs, row))
        if again := [named[index] for index in members if index in named]:
            line = again[0].rpartition(": ")[2]
            refuse(where, _words(row), f"runs that {line} does not name already")
        named |= dict.fromkeys(members, where)
        weight[members] = amount / len(members)
    if not weight.any():
        raise InputError(
            f"{path}: weight", Unquoted("0 in all rows"), "one weight more than 0"
        )
    return shares_of(weight)


def _read_rows(path: Path) -> list[tuple[str, dict[str, str]]]:
    """Rows of a user's table: file and line, and cells by column."""
    text = read_csv_text(path)
    rows = [*csv_rows(text, str(path), separators=",;\t", noun="columns")]
    expected = ", ".join(_COLUMNS) + f", and {' and '.join(_OPTIONAL)} if wanted"
    if not rows:
        refuse(str(path), "an empty file", f"columns {expected}")
    header = [name.lower() for name in rows[0][1]]
    unknown = [name for name in header if name not in (*_COLUMNS, *_OPTIONAL)]
    if unknown or len(set(header)) < len(header) or not set(_COLUMNS) <= set(header):
        refuse(rows[0][0], ", ".join(header), expected)
    if len(rows) == 1:
        refuse(str(path), "no rows", "one row per case and approach")
    none = dict.fromkeys(_OPTIONAL, "")
    return [
        (here, {**none, **dict(zip(header, row, strict=True))})
        for here, row in rows[1:]
    ]


def _read_weight(text: str, where: str) -> float:
    """Weight of a row, or InputError."""
    amount = float_of(text)
    if not 0.0 <= amount < math.inf:
        raise InputError(f"{where}: weight", text, "a number, at least 0")
    return amount


def _read_position(text: str, where: str) -> str:
    """The name of a position, or a word for all of them.

    Spreadsheets take a + away, or need a ' before it.
    """
    text = text.removeprefix("'")
    if text in _ANY:
        return text
    if text[:1] in ("+", "-", "0"):
        signed = text
    else:
        signed = f"+{text}"
    return read_position(signed, f"{where}: position").name


def _words(row: Mapping[str, str]) -> str:
    """What a row names, in words."""
    return ", ".join(
        repr(row[key]) for key in ("case", "approach", *_OPTIONAL) if row[key]
    )


def _what_is_driven(runs: Sequence[Run], row: Mapping[str, str]) -> str:
    """What a row could name instead, in words."""
    of_case = [run for run in runs if run.case.name == row["case"]]
    if not of_case:
        return "a case that is driven: " + ", ".join(
            dict.fromkeys(run.case.name for run in runs)
        )
    ways = [f"{run.approach} at {run.position} by {run.weather}" for run in of_case]
    known = ", ".join(dict.fromkeys(ways))
    return (
        f"an approach, position and weather in which {row['case']} is driven: {known}"
    )


class TableWeights:
    """Weights by a user's own table; see :func:`weight_from_csv`."""

    def __init__(self, how: str) -> None:
        self._how = how

    def check(self) -> None:
        """Read the table. Raises InputError if it cannot be used."""
        for where, row in _read_rows(self._existing_file()):
            _read_weight(row["weight"], where)
            _read_position(row["position"], where)

    def files(self) -> tuple[Path, ...]:
        """The table."""
        return (Path(self._how),)

    def weigh(
        self,
        runs: Sequence[Run],
        *,
        near: tuple[float, float] | None,
        within_m: float | None,
    ) -> FloatArray:
        """Weights of runs (n_runs,); a place on earth does not matter."""
        return weight_from_csv(self._existing_file(), runs)

    def _existing_file(self) -> Path:
        """The file that the word names, or InputError."""
        path = Path(self._how)
        if not self._how or not path.exists():
            words = ", ".join([*WEIGHT_WORDS, *(f"{form}:FILE" for form in FORMATS)])
            expected = f"{words}, or a CSV file that exists"
            raise InputError("weights", self._how, expected)
        return path


# ---------- weights by Euro NCAP's points of 2026; needs the extra `rating`


class _Score(Struct, frozen=True, kw_only=True):
    """A score of the rating, and the cases that it counts for.

    The cases are what our names begin with.
    """

    name: str
    cases: tuple[str, ...]
    weather: str


def weight_by_rating(runs: Sequence[Run]) -> FloatArray:
    """Weights by the points that Euro NCAP gives the cases in 2026.

    The points that a score can earn at most (standard and extended range,
    robustness) are shared equally by the runs that belong to it; those of scores
    without runs do not count. Runs without a score, such as all in the rain, weigh
    nothing. The weights sum to 1.

    Raises
    ------
    MissingExtraError
        The package is not installed.
    InputError
        No run has points.
    """
    weight = np.zeros(len(runs))
    for (cases, weather), score in load_points().items():
        counts = [run.weather == weather and run.case.family in cases for run in runs]
        members = np.flatnonzero(counts)
        weight[members] = score / max(len(members), 1)
    if not weight.any():
        driven = ", ".join(
            dict.fromkeys(f"{run.case.name} ({run.weather})" for run in runs)
        )
        raise InputError(
            "weights", RATING, f"a run that has points in 2026; driven: {driven}"
        )
    return shares_of(weight)


@cache
def load_points() -> dict[tuple[tuple[str, ...], str], float]:
    """Points by cases and weather, from the installed package.

    The cases are what our names begin with.

    Raises
    ------
    MissingExtraError
        It is not installed.
    InputError
        It does not know a score any more.
    """
    try:
        from euroncap_rating_2026.crash_avoidance.data_model import TOTAL_SCORES
    except ModuleNotFoundError:
        raise MissingExtraError(
            f"`weights` {RATING} needs that package: pip install place-rsus[rating]"
        ) from None
    where = "rating_2026.toml"
    tables = load_data(__package__, where)["scores"]
    points = {}
    for index, score in enumerate(read_table(tables, tuple[_Score, ...], where)):
        if score.name not in TOTAL_SCORES:
            got = Unquoted(f"{score.name!r}, unknown to the installed {RATING}")
            raise InputError(f"{where}: scores[{index}]", got, "a score of it")
        parts = TOTAL_SCORES[score.name].values()
        points[score.cases, score.weather] = float(sum(part or 0.0 for part in parts))
    return points


class RatingWeights:
    """Weights by Euro NCAP's points; see :func:`weight_by_rating`."""

    def __init__(self, how: str) -> None:
        self._how = how

    def check(self) -> None:
        """Load the points. Raises MissingExtraError without their package."""
        load_points()

    def files(self) -> tuple[Path, ...]:
        """None: the points are those of a package."""
        return ()

    def weigh(
        self,
        runs: Sequence[Run],
        *,
        near: tuple[float, float] | None,
        within_m: float | None,
    ) -> FloatArray:
        """Weights of runs (n_runs,); a place on earth does not matter."""
        return weight_by_rating(runs)


# ---------- weights by types of accidents, from statistics


class CrashType(Struct, frozen=True, kw_only=True):
    """A type of accident, and the cases that stand for it.

    The cases are what our names begin with.

    Attributes
    ----------
    name : str
        Name in the statistics.
    vru : {"pedestrian", "cyclist"}
        The road user.
    share : float
        Share of all accidents of such road users.
    place : {"near", "far", "any"}
        Where it happens, as seen from the junction.
    cases : tuple of str
        What our names of the cases begin with.
    """

    name: Text
    vru: Literal["pedestrian", "cyclist"]
    share: Annotated[float, Meta(gt=0.0, le=1.0)]
    place: Literal["near", "far", "any"]
    cases: tuple[Text, ...]


class CrashTypes(Struct, frozen=True, kw_only=True):
    """``data/crash_types.toml``."""

    near_m: float
    injured: dict[Literal["pedestrian", "cyclist"], float]
    types: tuple[CrashType, ...]


@cache
def load_crash_types() -> CrashTypes:
    """Types of accidents and what is known of them."""
    return read_data(__package__, "crash_types.toml", CrashTypes)


def weight_by_crash_types(runs: Sequence[Run]) -> FloatArray:
    """Weights by how often accidents of each type happen (FHWA-RD-95-163).

    A type's share is that of its road users' accidents, times how many of them are
    injured. It is shared by the cases that stand for it, near the junction or away
    from it, as :func:`weight_per_case` does. Types without runs do not count, nor
    do runs without a type. The weights sum to 1.

    Raises
    ------
    InputError
        No run is of any of the types.
    """
    table = load_crash_types()
    weight = np.zeros(len(runs))
    away_m = [read_position(run.position, run.id).distance_m for run in runs]
    for kind in table.types:
        members = [
            index
            for index, run in enumerate(runs)
            if run.case.family in kind.cases
            and kind.place
            in ("any", "near" if away_m[index] <= table.near_m else "far")
        ]
        if members:
            of_type = weight_per_case([runs[index] for index in members])
            weight[members] += kind.share * table.injured[kind.vru] * of_type
    if not weight.any():
        driven = ", ".join(dict.fromkeys(run.case.name for run in runs))
        raise InputError(
            "weights", CRASH_TYPES, f"a run of a type it has; driven: {driven}"
        )
    return shares_of(weight)


class CrashTypeWeights:
    """Weights by accident statistics; see :func:`weight_by_crash_types`."""

    def __init__(self, how: str) -> None:
        self._how = how

    def check(self) -> None:
        """Nothing can be wrong without runs."""

    def files(self) -> tuple[Path, ...]:
        """None: the statistics come with this package."""
        return ()

    def weigh(
        self,
        runs: Sequence[Run],
        *,
        near: tuple[float, float] | None,
        within_m: float | None,
    ) -> FloatArray:
        """Weights of runs (n_runs,); a place on earth does not matter."""
        return weight_by_crash_types(runs)
