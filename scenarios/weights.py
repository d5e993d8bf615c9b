"""How much each run counts.

It counts equally, per case, by accidents, statistics, points, or a CSV file.

The statistics (``data/crash_types.toml``) know types of accidents and how near to a
junction they happen; a table of one's own, by case, approach, position and weather, may
know better.
"""

import logging
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray
from geometry.errors import InputError, MissingExtraError, Unquoted, refuse
from geometry.opening import read_text
from geometry.tables import Text, read_data, read_table
from geometry.text_formats import csv_rows, float_of, load_data

from .accidents import (
    DAY,
    FORMATS,
    NIGHT,
    Accidents,
    accident_files,
    load_accident_rules,
    read_accidents,
    reasons,
    split_source,
)
from .positions import is_study_set, read_position
from .runs import Refusal, Run

_log = logging.getLogger(__name__)

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
    return _shares(weight)


def _shares(weight: FloatArray) -> FloatArray:
    """Weights that sum to 1."""
    return np.asarray(weight / weight.sum())


def _read_rows(path: Path) -> list[tuple[str, dict[str, str]]]:
    """Rows of a user's table: file and line, and cells by column."""
    text = read_text(path, "a CSV file")
    rows = [*csv_rows(text, str(path), separators=",;", noun="columns")]
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


# ---------- weights by Euro NCAP's points of 2026; needs the extra `rating`
RATING = "euroncap-rating-2026"


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
    return _shares(weight)


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


# ---------- weights by types of accidents, from statistics
CRASH_TYPES = "fhwa-crash-types"


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
    return _shares(weight)


# ---------- weights by accidents around a place
def weight_by_accidents(
    runs: Sequence[Run],
    accidents: Accidents,
    *,
    near: tuple[float, float],
    within_m: float,
) -> FloatArray:
    """Weights by the accidents that happened around a place.

    What is not used is logged.

    Each counts the same. It is shared by the cases that stand for it
    (``data/accidents.toml``), as :func:`weight_per_case` does: by day or by night,
    as it happened, where both are driven, half each in twilight or where nobody
    knows; else light does not matter, and rain and fog weigh nothing next to day or
    night. Runs without accidents weigh nothing. `near`: latitude and longitude. The
    weights sum to 1.

    Raises
    ------
    InputError
        No accident is so near, or none of them happened as anything that is
        driven.
    """
    found = accidents.near(near, within_m)
    rules = load_accident_rules()
    weathers = {run.weather for run in runs}
    lit = [weather for weather in (DAY, NIGHT) if weather in weathers] or sorted(
        weathers
    )
    counts: Counter[tuple[tuple[str, ...], str]] = Counter()
    unused: Counter[str] = Counter()
    members: dict[tuple[tuple[str, ...], str], list[int]] = {}
    for one in found:
        cases = () if one.unused else rules.cases_of(one.road_user, one.event)
        # Light counts only where both day and night are driven.
        key = (cases, one.light if one.light in lit and len(lit) > 1 else "")
        if key not in members:
            members[key] = [
                index
                for index, run in enumerate(runs)
                if any(f"{run.case.name}-".startswith(f"{one}-") for one in cases)
                and run.weather in ([key[1]] if key[1] else lit)
            ]
        if members[key]:
            counts[key] += 1
        else:
            what = f"{one.road_user}, {one.event}"
            unused[one.unused or f"of which no case is driven ({what})"] += 1
    n_used = sum(counts.values())
    told = (
        f"{n_used} of {len(found)} accidents of {accidents.source} within"
        f" {within_m:g} m count"
    )
    if unused:
        told += f"; not used: {reasons(unused)}"
    if not n_used:
        driven = ", ".join(dict.fromkeys(run.case.name for run in runs))
        raise InputError(
            "weights", Unquoted(told), f"accidents as these cases: {driven}"
        )
    _log.warning("weights: %s", told)
    weight = np.zeros(len(runs))
    for key, count in counts.items():
        weight[members[key]] += count * weight_per_case(
            [runs[index] for index in members[key]]
        )
    return _shares(weight)


# ---------- weights by a word
WEIGHT_WORDS = ("run", "case", CRASH_TYPES, RATING)
"""Of :func:`weigh`, but for files."""


def default_weights(cases: str) -> str:
    """The word for :func:`weigh` where the user gives none, by the words for the cases.

    The runs of the study's set count the same, as in the study; else all cases do.
    """
    if is_study_set(cases):
        return "run"
    return "case"


def weigh(
    runs: Sequence[Run],
    how: str,
    *,
    refused: Sequence[Refusal] = (),
    near: tuple[float, float] | None = None,
    within_m: float | None = None,
) -> FloatArray:
    """Weights of runs, at least one, by the word of a user, (n_runs,); they sum to 1.

    `how`: "run": every run the same, as in the study; "case": every case the same, see
    :func:`scenarios.weights.weight_per_case`; "fhwa-crash-types": by accident
    statistics, see :func:`scenarios.weights.weight_by_crash_types`;
    "euroncap-rating-2026": by its points, see
    :func:`scenarios.weights.weight_by_rating`; "unfallatlas:FILE", "stats19:FILE": by
    the accidents around a place, see :func:`scenarios.weights.weight_by_accidents`;
    else a CSV file, see :func:`scenarios.weights.weight_from_csv`. `refused`: what was
    asked for next to the runs, and could not be laid: "case" alone looks at it. `near`:
    latitude and longitude of the place [deg]. `within_m`: how far from there accidents
    count [m]; default: that of ``data/accidents.toml``.

    Raises
    ------
    InputError
        The word is unknown and no file, the weights do not fit the runs, or
        nobody knows the place.
    MissingExtraError
        What the word needs is not installed.
    """
    if how == "run":
        return weight_per_run(runs)
    if how == "case":
        return weight_per_case(runs, refused=refused)
    if how == CRASH_TYPES:
        return weight_by_crash_types(runs)
    if how == RATING:
        return weight_by_rating(runs)
    if source := split_source(how):
        if near is None:
            expected = (
                "LATITUDE,LONGITUDE: the scene does not say where on earth it lies"
            )
            raise InputError("near", Unquoted("nothing"), expected)
        if within_m is None:
            radius_m = load_accident_rules().default_within_m
        else:
            radius_m = within_m
        return weight_by_accidents(
            runs, read_accidents(*source), near=near, within_m=radius_m
        )
    return weight_from_csv(_weights_file(how), runs)


def check_weights(how: str) -> None:
    """Check the word of a user as far as it goes without runs.

    Raises
    ------
    InputError
        As :func:`weigh`.
    """
    if how == RATING:
        load_points()
    if how in WEIGHT_WORDS:
        return
    if source := split_source(how):
        read_accidents(*source)
        return
    for where, row in _read_rows(_weights_file(how)):
        _read_weight(row["weight"], where)
        _read_position(row["position"], where)


def weight_files(how: str) -> tuple[Path, ...]:
    """Files that the weights by a word of a user are read from, see :func:`weigh`."""
    if how in ("", *WEIGHT_WORDS):
        return ()
    source = split_source(how)
    if source is None:
        return (Path(how),)
    return accident_files(*source)


def _weights_file(how: str) -> Path:
    """The file that a word names, or InputError."""
    path = Path(how)
    if not how or not path.exists():
        words = ", ".join([*WEIGHT_WORDS, *(f"{form}:FILE" for form in FORMATS)])
        raise InputError("weights", how, f"{words}, or a CSV file that exists")
    return path


def weight_by_function(
    runs: Sequence[Run], function: Callable[[Run], float]
) -> FloatArray:
    """Weights by a user's own function of a run; they sum to 1.

    Raises
    ------
    InputError
        It gives anything but finite numbers >= 0, or 0 for all runs.
    """
    weight = np.array([function(run) for run in runs], dtype=np.float64)
    wrong = np.flatnonzero(~(np.isfinite(weight) & (weight >= 0.0)))
    if len(wrong):
        run = runs[int(wrong[0])]
        raise InputError(
            f"weights: {run.id}", float(weight[wrong[0]]), "a finite number >= 0"
        )
    if not weight.any():
        raise InputError(
            "weights", Unquoted("0 for all runs"), "one weight more than 0"
        )
    return _shares(weight)


def weight_per_run(runs: Sequence[Run]) -> FloatArray:
    """Equal weight for every run, as in the study."""
    return np.full(len(runs), 1.0 / len(runs))


def weight_per_case(
    runs: Sequence[Run], *, refused: Sequence[Refusal] = ()
) -> FloatArray:
    """Equal weight for every case, as far as the junction carries it.

    A case that is driven in full has as much weight as any other, shared equally by its
    approaches, in these by positions, in these by runs - speeds and weathers: position
    0, where every speed is driven, weighs no more than another one. Runs that have no
    room, and approaches that do not carry the case at all, take their shares away with
    them: the case weighs less, and the few runs that remain of it no more than they
    would among all others. Otherwise the only turn that a map allows would weigh as
    much as a hundred crossings. Positions that the mapped lanes do not reach have no
    share. `runs`: at least one. `refused`: what was asked for next to them, and could
    not be laid. Returns `weight` (n_runs,): sums to 1.
    """
    # Shares go from the case to its approaches, their positions, and the runs there.
    keys = [(run.case.name, run.approach, run.position) for run in runs]
    n_weathers = len({run.weather for run in runs})
    n_runs = Counter(keys)
    for one in refused:
        if one.is_possible:
            key = (one.case.name, one.approach, one.position)
            n_runs[key] += len(one.speeds_kmh) * n_weathers
    n_positions = Counter(key[:2] for key in n_runs)
    asked = {(one.case.name, one.approach) for one in refused} | set(n_positions)
    n_approaches = Counter(case for case, _ in asked)
    alike = [n_approaches[key[0]] * n_positions[key[:2]] * n_runs[key] for key in keys]
    return _shares(1.0 / np.array(alike))


def weight_share(mask: ArrayLike, weight: ArrayLike) -> float:
    """Weight of the runs in a mask / weight of all; NaN if there is no weight at all.

    It is exactly 1 where all runs with weight count.

    >>> weight_share([True] * 49, [1.0 / 49.0] * 49)
    1.0
    """
    weights = np.asarray(weight, dtype=np.float64)
    total = math.fsum(weights.tolist())
    counted = math.fsum(weights[np.asarray(mask, dtype=bool)].tolist())
    if total > 0.0:
        return counted / total
    return math.nan
