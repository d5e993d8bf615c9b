"""Accidents around a place, from published files.

Germany and Great Britain publish them.

Each becomes a road user, an event and a light, in words of ``data/accidents.toml``,
which says what the files' codes mean and which cases stand for which event. What cannot
be used has a reason.
"""

import logging
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct

from geometry.arrays import FloatArray, freeze
from geometry.csv_files import csv_rows
from geometry.errors import InputError, Unquoted, refuse
from geometry.opening import read_bytes
from geometry.tables import Text, read_data
from geometry.text_formats import float_of

from .runs import Run
from .weights import UNFALLATLAS, shares_of, weight_per_case

_log = logging.getLogger(__name__)

DAY = "day"
NIGHT = "night"
# Mean radius, IUGG.
_EARTH_M = 6_371_008.8
_MAX_REASONS = 8

_Codes = dict[str, Text]
_Columns = Mapping[str, tuple[str, ...]]


class _Unfallatlas(Struct, frozen=True, kw_only=True):
    columns: dict[str, tuple[str, ...]]
    events: _Codes
    unused: _Codes
    head_on: tuple[str, ...]
    light: _Codes


class _Stats19(Struct, frozen=True, kw_only=True):
    columns: dict[
        Literal["vehicles", "casualties", "collisions"], dict[str, tuple[str, ...]]
    ]
    cars: tuple[str, ...]
    bicycles: tuple[str, ...]
    motorcycles: tuple[str, ...]
    ahead: tuple[str, ...]
    turns_left: tuple[str, ...]
    turns_right: tuple[str, ...]
    on_foot: _Codes
    light: _Codes


class AccidentType(Struct, frozen=True, kw_only=True):
    """A road user that cars hit, and the cases that stand for each event."""

    road_user: Text
    cases: dict[str, tuple[Text, ...]]


class AccidentRules(Struct, frozen=True, kw_only=True):
    """``data/accidents.toml``."""

    default_within_m: Annotated[float, Meta(gt=0.0)]
    unfallatlas: _Unfallatlas
    stats19: _Stats19
    types: tuple[AccidentType, ...]

    def cases_of(self, road_user: str, event: str) -> tuple[str, ...]:
        """How names of cases that stand for an event begin.

        Empty: nothing stands for it.
        """
        return next(
            one.cases.get(event, ()) for one in self.types if one.road_user == road_user
        )


@cache
def load_accident_rules() -> AccidentRules:
    """Codes and types of accidents, from ``data/accidents.toml``."""
    return read_data(__package__, "accidents.toml", AccidentRules)


@dataclass(frozen=True, slots=True, kw_only=True)
class Accident:
    """What an accident was.

    `unused` says why it cannot stand for a case, otherwise it is empty.

    Attributes
    ----------
    road_user : str
        One of the types of ``data/accidents.toml``.
    event : str
        What happened, in the words of that file.
    light : str
        "day", "night", or else: neither, or unknown.
    unused : str
        Why it cannot stand for a case; empty: it can.
    """

    road_user: str
    event: str
    light: str
    unused: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Accidents:
    """Accidents of a file.

    Attributes
    ----------
    source : str
        The file's name.
    place_deg : (n, 2) float
        Latitude and longitude, WGS 84; not a number where the file has none.
        [deg]
    what : tuple of Accident
        What each accident was.
    """

    source: str
    place_deg: FloatArray
    what: tuple[Accident, ...]

    def near(self, place_deg: tuple[float, float], within_m: float) -> list[Accident]:
        """Accidents within so many metres of a place; InputError: there is none."""
        distance_m = _distances_m(self.place_deg, place_deg)
        rows = np.flatnonzero(distance_m <= within_m)
        if not len(rows):
            nearest = np.nanmin(distance_m, initial=np.inf)
            latitude, longitude = place_deg
            expected = (
                f"a place with accidents within {within_m:g} m (the nearest one of"
                f" {self.source} is {nearest / 1000.0:,.1f} km away)"
            )
            raise InputError("near", Unquoted(f"{latitude:g},{longitude:g}"), expected)
        return [self.what[row] for row in rows.tolist()]


def _distances_m(places_deg: FloatArray, place_deg: tuple[float, float]) -> FloatArray:
    """Great circles from places to one place (haversine), (n,)."""
    latitude, longitude = np.radians(places_deg).T
    here_latitude, here_longitude = np.radians(place_deg)
    up = 0.5 * (latitude - here_latitude)
    across = 0.5 * (longitude - here_longitude)
    # Haversine of the angle between the places.
    chord = (
        np.sin(up) ** 2 + np.cos(latitude) * np.cos(here_latitude) * np.sin(across) ** 2
    )
    return np.asarray(2.0 * _EARTH_M * np.arcsin(np.sqrt(np.minimum(chord, 1.0))))


def reasons(unused: Mapping[str, int]) -> str:
    """Reasons why accidents are not used, the most frequent one first.

    There are commas between them.
    """
    known = sorted(unused.items(), key=lambda item: (-item[1], item[0]))
    more = [f"{sum(n for _, n in known[_MAX_REASONS:])} for other reasons"]
    told = [f"{count} {reason}" for reason, count in known[:_MAX_REASONS]]
    return ", ".join(told + more * (len(known) > _MAX_REASONS))


def read_accidents(form: str, path: Path) -> Accidents:
    """Accidents of a file of one of ``FORMATS``; read once while it stays the same.

    "unfallatlas": the German accident atlas, CSV with semicolons and decimal
    commas; "stats19": the collisions of Great Britain, CSV; the files of vehicles
    and casualties lie beside it, with "vehicle" and "casualty" in place of
    "collision" (or "accident") in their names. UTF-8, with or without a byte order
    mark, or Windows-1252.

    Raises
    ------
    InputError
        A file cannot be read, is no such CSV, lacks a column, or has no
        accident with a place.
    """
    paths = accident_files(form, path)
    stamps = []
    for one in paths:
        # Reading says why.
        with suppress(OSError):
            found = one.stat()
            stamps.append((found.st_size, found.st_mtime_ns))
    return _read(form, paths, tuple(stamps))


def accident_files(form: str, path: Path) -> tuple[Path, ...]:
    """All files that :func:`read_accidents` reads."""
    if form == UNFALLATLAS:
        return (path,)
    return (path, *_beside(path))


# Of a city every junction asks again.
@lru_cache(maxsize=2)
def _read(
    form: str, paths: tuple[Path, ...], _stamps: tuple[tuple[int, int], ...]
) -> Accidents:
    """Accidents of files, by a format's name.

    The stamps say that the files are the same as before.
    """
    read = _read_unfallatlas if form == UNFALLATLAS else _read_stats19
    places, what = read(*paths)
    place_deg = np.array(places, dtype=np.float64).reshape(-1, 2)
    latitude, longitude = place_deg.T
    # Latitude and longitude 0, 0 stand for an unknown place in some files.
    on_earth = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 180.0)
    place_deg[~on_earth | (place_deg == 0.0).all(axis=1)] = np.nan
    if np.isnan(place_deg).all():
        got = Unquoted(f"{len(what)} accidents, none with a place")
        raise InputError(str(paths[0]), got, "latitudes and longitudes in degrees")
    return Accidents(
        source=paths[0].name, place_deg=freeze(place_deg), what=tuple(what)
    )


# ---------- the German accident atlas
_UNFALLATLAS_USERS = {
    "istfuss": "on foot",
    "istrad": "bicycle",
    "istkrad": "motorcycle",
}


def _read_unfallatlas(path: Path) -> tuple[list[list[float]], list[Accident]]:
    """Places in degrees and accidents of a file of the German atlas."""
    rules = load_accident_rules().unfallatlas
    places = []
    what = []
    for row in _rows(path, rules.columns, optional={"uart": ("uart",)}):
        places.append([float_of(row[axis].replace(",", ".")) for axis in "yx"])
        users = [
            user for column, user in _UNFALLATLAS_USERS.items() if row[column] == "1"
        ]
        code = row["utyp1"]
        event = rules.events.get(code, "")
        unused = ""
        if event == "along" and row["uart"] in rules.head_on:
            event = "oncoming"
        if row["istpkw"] != "1":
            unused = "without a car"
        elif len(users) > 1:
            unused = "with several kinds of road users"
        elif not event:
            unused = rules.unused.get(code, f"of an unknown type (UTYP1 {code[:8]})")
        if users:
            user = users[0]
        else:
            user = "car"
        light = rules.light.get(row["light"], "")
        what.append(Accident(road_user=user, event=event, light=light, unused=unused))
    return places, what


# ---------- STATS19 of Great Britain
def _beside(path: Path) -> tuple[Path, Path]:
    """The files of vehicles and casualties that belong to one of collisions."""
    for word in ("collision", "accident"):
        head, found, tail = path.name.rpartition(word)
        if found:
            return path.with_name(f"{head}vehicle{tail}"), path.with_name(
                f"{head}casualty{tail}"
            )
    raise InputError(
        str(path), Unquoted(f"the name {path.name}"), 'one with "collision" in it'
    )


def _read_stats19(
    collisions: Path, vehicles: Path, casualties: Path
) -> tuple[list[list[float]], list[Accident]]:
    """Places in degrees and accidents of the three files of STATS19."""
    rules = load_accident_rules().stats19
    drivers: dict[str, dict[str, dict[str, str]]] = {}
    for row in _rows(vehicles, rules.columns["vehicles"]):
        drivers.setdefault(row["index"], {})[row["reference"]] = row
    walkers: dict[str, list[dict[str, str]]] = {}
    for row in _rows(casualties, rules.columns["casualties"]):
        if row["class"] == "3":
            walkers.setdefault(row["index"], []).append(row)
    places = []
    what = []
    for row in _rows(collisions, rules.columns["collisions"]):
        places.append([float_of(row[axis].replace(",", ".")) for axis in "yx"])
        index = row["index"]
        light = rules.light.get(row["light"], "")
        road_user, event, unused = _collision(
            drivers.get(index, {}), walkers.get(index, []), rules
        )
        what.append(
            Accident(road_user=road_user, event=event, light=light, unused=unused)
        )
    return places, what


def _collision(
    drivers: Mapping[str, Mapping[str, str]],
    walkers: Sequence[Mapping[str, str]],
    rules: _Stats19,
) -> tuple[str, str, str]:
    """Road user, event, and why neither can be used."""
    unknown = "of an unknown or unusual manoeuvre"
    if walkers:
        car = drivers.get(walkers[0]["reference"], {})
        if car.get("type") not in rules.cars:
            return "on foot", "", "without a car"
        event = _turn(car, rules)
        if not event and car["manoeuvre"] in rules.ahead:
            event = rules.on_foot.get(walkers[0]["movement"], "")
        return "on foot", event, "" if event else unknown
    # With nobody on foot: a car and one other vehicle.
    types = {
        "bicycle": rules.bicycles,
        "motorcycle": rules.motorcycles,
        "car": rules.cars,
    }
    every = list(drivers.values())
    kinds = {
        user: [one for one in every if one["type"] in types[user]] for user in types
    }
    if not kinds["car"]:
        return "car", "", "without a car"
    if len(drivers) != 2:
        return "car", "", "with one vehicle alone, or more than two"
    if sum(map(len, kinds.values())) != 2:
        return "car", "", "with another kind of vehicle"
    user = next((user for user in ("bicycle", "motorcycle") if kinds[user]), "car")
    if user == "car":
        first, second = kinds["car"]
    else:
        first, second = (kinds["car"][0], kinds[user][0])
    if user == "car" and _turn(second, rules) and not _turn(first, rules):
        # The one that turns is the VUT.
        first, second = second, first
    event = _meeting(first, second, rules)
    return user, event, "" if event else unknown


def _turn(car: Mapping[str, str], rules: _Stats19) -> str:
    """How a car turns where traffic keeps left; empty: it does not."""
    if car["manoeuvre"] in rules.turns_left:
        return "VUT turns near"
    if car["manoeuvre"] in rules.turns_right:
        return "VUT turns far"
    return ""


_SAME = 0
_ONCOMING = 4
_WAYS = 8


def _meeting(car: Mapping[str, str], other: Mapping[str, str], rules: _Stats19) -> str:
    """Event of a car and another vehicle; empty: unknown, or nothing of what is driven.

    Directions are those of the compass, clockwise from 1, north; the near side is the
    left.
    """
    if turn := _turn(car, rules):
        return turn
    if car["manoeuvre"] not in rules.ahead or other["manoeuvre"] not in rules.ahead:
        return ""
    ways = [one["to"] for one in (car, other)]
    if not all(way in "12345678" and len(way) == 1 for way in ways):
        return ""
    turned = (int(ways[1]) - int(ways[0])) % _WAYS
    if turned == _SAME:
        return "along"
    if turned == _ONCOMING:
        return "oncoming"
    # to the right: from the left
    if turned < _ONCOMING:
        return "crosses near"
    return "crosses far"


# ---------- CSV as it is published
def _rows(
    path: Path, columns: _Columns, *, optional: _Columns | None = None
) -> Iterator[dict[str, str]]:
    """Cells of the rows, by our names of columns.

    Each column has one of several names in the file.

    Raises
    ------
    InputError
        A column is missing, or there are no rows.
    """
    data = read_bytes(path)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    rows = csv_rows(text, str(path), separators=";,\t")
    # Columns are found by their names, in any order and any case.
    header = [name.lower() for name in next(rows, ("", []))[1]]
    at: dict[str, int] = {}
    # Names of columns have changed over the years.
    for name, known in {**columns, **(optional or {})}.items():
        found = [header.index(one) for one in known if one in header]
        if found:
            at[name] = found[0]
        elif name in columns:
            expected = "columns " + ", ".join(one[0] for one in columns.values())
            refuse(str(path), f"no column {known[0]}", expected)
    missing = dict.fromkeys((name for name in optional or {} if name not in at), "")
    n_rows = 0
    for _, cells in rows:
        n_rows += 1
        yield missing | {name: cells[index] for name, index in at.items()}
    if not n_rows:
        refuse(str(path), "no rows", "a row for each accident")


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
    return shares_of(weight)


class AccidentWeights:
    """Weights by the accidents of a file; see :func:`weight_by_accidents`."""

    def __init__(self, how: str) -> None:
        form, _, name = how.partition(":")
        self._form = form
        self._path = Path(name)

    def check(self) -> None:
        """Read the accidents. Raises InputError if a file cannot be used."""
        read_accidents(self._form, self._path)

    def files(self) -> tuple[Path, ...]:
        """All files that the accidents are read from."""
        return accident_files(self._form, self._path)

    def weigh(
        self,
        runs: Sequence[Run],
        *,
        near: tuple[float, float] | None,
        within_m: float | None,
    ) -> FloatArray:
        """Weights of runs (n_runs,) by the accidents near a place.

        Raises InputError if nobody knows the place.
        """
        if near is None:
            expected = (
                "LATITUDE,LONGITUDE: the scene does not say where on earth it lies"
            )
            raise InputError("near", Unquoted("nothing"), expected)
        if within_m is None:
            radius_m = load_accident_rules().default_within_m
        else:
            radius_m = within_m
        found = read_accidents(self._form, self._path)
        return weight_by_accidents(runs, found, near=near, within_m=radius_m)
