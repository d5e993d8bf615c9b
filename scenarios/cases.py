"""Test cases, from ``data/cases.toml`` and files of one's own: tables, no new code."""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct, structs

from geometry.actors import Actor, pick_actor
from geometry.errors import InputError, Unquoted
from geometry.phrases import Phrase
from geometry.tables import Table, Text, pick, read_table, read_tables
from geometry.text_formats import float_of, load_data, load_toml

from .encounters import RecordedEncounter, RecordedWay

ALL_CASES = "all"
ALL_SPEEDS = "all"

Range = Literal["standard", "extended"]
"""Euro NCAP's ranges of a case, 2026: its basic grid, and what is driven beyond it."""

ROAD_USERS = {
    "pedestrian": "on foot",
    "cyclist": "bicycle",
    "motorcyclist": "motorcycle",
    "car": "car",
    "vehicle": "car",
}
"""Road-user groups, by the class of the body."""
# Each once.
ROAD_USER_GROUPS = tuple(dict.fromkeys(ROAD_USERS.values()))
PROTECTED = {"vru": ("on foot", "bicycle", "motorcycle"), "all": ROAD_USER_GROUPS}
"""Whose runs count, by the word of a user."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VruLine:
    """On which line of the junction the VRU moves.

    Attributes
    ----------
    along : {"crosswalk", "lane", "kerb", "through"}
        "lane": of the arm it comes from; "kerb": of the VUT's approach road;
        "through": the lanes by which vehicles drive straight on through the
        junction.
    lane : {"", "inner", "outer"}
        "outer": at the kerb; empty unless along a lane.
    left_of_lane_centre_m : float or None
        Along a lane. [m]
    outside_kerb_m : float or None
        Along a kerb; negative on the road. [m]
    """

    along: Literal["crosswalk", "lane", "kerb", "through"]
    lane: Literal["", "inner", "outer"] = ""
    left_of_lane_centre_m: float | None = None
    outside_kerb_m: float | None = None

    def __post_init__(self) -> None:
        if self.along == "lane" and (
            not self.lane or self.left_of_lane_centre_m is None
        ):
            expected = "lane and left_of_lane_centre_m, along a lane"
            raise InputError("", asdict(self), expected)
        if self.along == "kerb" and self.outside_kerb_m is None:
            raise InputError("", asdict(self), "outside_kerb_m, along a kerb")

    @property
    def left_m(self) -> float:
        """To the left of the lane's middle, or outside of the kerb."""
        if self.along == "lane":
            beside_m = self.left_of_lane_centre_m
        else:
            beside_m = self.outside_kerb_m
        return beside_m or 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Obstruction:
    """Parked bodies, or a wall, that belong to a case.

    Attributes
    ----------
    kind : str
        "beside-vut", "beside-road", "beside-vru" or "wall".
    bodies : tuple of Actor
        From the one nearest to the meeting point; none for a wall.
    first_gap_m : float
        From the first body to the VRU's flank (beside-vut) or the middle of its
        way (beside-road), or from the VUT's centreline to the first body or the
        wall. [m]
    between_gap_m : float
        From bumper to bumper. [m]
    side_gap_m : float
        To the side of the VUT, to the middle of the nearest lane (beside-road),
        or to the side of the VRU's box. [m]
    wall_size_m : tuple of float
        Length, thickness, height of the wall; empty without one. [m]
    max_speed_kmh : float
        It is taken away where VUT or VRU is faster. [km/h]
    """

    kind: str
    bodies: tuple[Actor, ...] = ()
    first_gap_m: float
    between_gap_m: float = 0.0
    side_gap_m: float
    wall_size_m: tuple[float, ...] = ()
    max_speed_kmh: float = math.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class Braking:
    """How a vehicle ahead of the VUT brakes, with the VUT so far behind it.

    Attributes
    ----------
    deceleration_mps2 : float
        Constant deceleration. [m/s^2]
    headway_s : float
        Free gap when it begins / the VUT's speed. [s]
    final_speed_kmh : float
        Speed to which it slows down. [km/h]
    """

    deceleration_mps2: Annotated[float, Meta(gt=0.0)]
    headway_s: Annotated[float, Meta(gt=0.0)]
    final_speed_kmh: Annotated[float, Meta(ge=0.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A Euro NCAP AEB case: who meets the VUT, and how.

    Whoever meets it has the field names of a VRU, also where it drives a car.

    Attributes
    ----------
    name : str
        Name of the case.
    title : str
        What happens, in words.
    source : str
        "protocol-4.5.1", "protocol-2026" or "CarlaNCAP".
    kind : str
        "crossing", "longitudinal", "turning" or "recorded"; "not laid" where
        `not_laid` says why.
    vru : Actor
        Body of the road user that is met.
    vru_speed_kmh : float
        Steady; 0: it stands. The first of several that go with the VUT's
        speeds, see `pairs_kmh`; of a run, its own. [km/h]
    vut_speeds_kmh : tuple of float
        Speeds to be driven, ascending. [km/h]
    speed_limits_kmh : (float, float)
        Lowest and highest speed of the protocol. [km/h]
    impact_percent, impact_face : float, str
        Where the VRU meets the VUT: "front" -
        of its width, 0 = right edge, 100 = left edge; "side" - of its length, 0
        = rear, on the side towards which it turns or from which the VRU comes.
        [%]
    vru_reference_m : float
        The VRU's point that meets the impact position, ahead of the middle of
        its box. [m]
    acceleration_distance_m : float
        From rest to the steady speed; 0: it comes at its speed. [m]
    start_distance_m, steady_distance_m, steady_time_s : float or None
        One of the three: the reference point's way from rest to the nominal
        meeting line (the VUT's centreline, or that of its exit lane), or the
        way or time at steady speed before the impact. [m], [s]
    vru_side : str
        Crossing: "near" or "far", from where the VRU comes.
    turn, vru_direction : str
        Turning: "near" or "far", where the VUT turns
        to; "same" or "opposite", as the VUT before its turn. Longitudinal: the
        latter alone.
    vru_line : VruLine or None
        Line on which the VRU moves. None in longitudinal cases: the VUT's lane.
    obstruction : Obstruction or None
        What hides the VRU.
    pairs_kmh, extended_pairs_kmh : tuple of (float, float)
        Speeds of the VUT and the VRU that go
        together, empty where the VRU has one speed; those that the extended
        range adds. [km/h]
    range : Range
        The range to which it belongs: "standard", or "extended" only.
    meets_corner : bool
        Turning: a front corner of the VRU meets the VUT, as the protocol
        reckons it at 45 degrees, and not the middle of its front.
    braking : Braking or None
        How the VRU ahead brakes.
    impact_turn : (int, int)
        Number of its impact point, and how many take turns along the arms; (0,
        1), but in "all".
    not_laid : str
        Why it cannot be laid anywhere; empty: it can.
    recorded : RecordedEncounter or None
        Of kind "recorded": the ways that were taken; such a case is laid there
        alone.
    """

    name: str
    # : What happens, in words.
    title: Phrase
    # : "protocol-4.5.1", "protocol-2026" or "CarlaNCAP".
    source: str
    # : "crossing", "longitudinal", "turning" or "recorded"; "not laid" where `not_laid`
    # says why.
    kind: str
    vru: Actor
    vru_speed_kmh: float = 0.0
    vut_speeds_kmh: tuple[float, ...] = ()
    speed_limits_kmh: tuple[float, float] = (0.0, 0.0)
    impact_percent: float = 50.0
    impact_face: str = "front"
    vru_reference_m: float = 0.0
    acceleration_distance_m: float = 0.0
    start_distance_m: float | None = None
    steady_distance_m: float | None = None
    vru_side: str = ""
    turn: str = ""
    vru_direction: str = ""
    vru_line: VruLine | None = None
    obstruction: Obstruction | None = None
    steady_time_s: float | None = None
    pairs_kmh: tuple[tuple[float, float], ...] = ()
    extended_pairs_kmh: tuple[tuple[float, float], ...] = ()
    range: Range = "standard"
    meets_corner: bool = False
    braking: Braking | None = None
    impact_turn: tuple[int, int] = (0, 1)
    not_laid: str = ""
    recorded: RecordedEncounter | None = None

    def __repr__(self) -> str:
        speeds = ", ".join(f"{speed:g}" for speed in self.vut_speeds_kmh)
        return f"Case({self.name!r}, {speeds} km/h)"

    @property
    def road_user(self) -> str:
        """Group of the road user that is met: on foot, bicycle, motorcycle or car."""
        return ROAD_USERS[self.vru.class_name]

    @property
    def family(self) -> str:
        """Euro NCAP's own name of it, without impact point, side and year: "CPNA"."""
        return self.name.partition("-")[0]

    def vru_speeds_kmh(self, vut_speed_kmh: float | None = None) -> tuple[float, ...]:
        """Speeds of the VRU, ascending, in km/h.

        They are those that go with the driven speed nearest to one of the VUT, or all
        of them without one.
        """
        if not self.pairs_kmh:
            return (self.vru_speed_kmh,)
        if vut_speed_kmh is None:
            return tuple(sorted({vru for _, vru in self.pairs_kmh}))
        nearest = min(
            (vut for vut, _ in self.pairs_kmh), key=lambda vut: abs(vut - vut_speed_kmh)
        )
        return tuple(vru for vut, vru in self.pairs_kmh if vut == nearest)


# Runs of one case and speed have one case between them.
@lru_cache(maxsize=256)
def at_vru_speed(case: Case, vru_speed_kmh: float) -> Case:
    """The case with one of the speeds of its VRU."""
    if vru_speed_kmh == case.vru_speed_kmh:
        return case
    return replace(case, vru_speed_kmh=vru_speed_kmh)


def in_range(case: Case, which: Range) -> Case | None:
    """The case with the speeds of a range; None: the range does not have it."""
    if which == "standard":
        if case.range == "standard":
            return case
        return None
    if not case.extended_pairs_kmh:
        return case
    # The basic grid as pairs, so that pairs of the extended range can join it.
    first = case.pairs_kmh or tuple(
        (vut, case.vru_speed_kmh) for vut in case.vut_speeds_kmh
    )
    pairs = tuple(sorted({*first, *case.extended_pairs_kmh}))
    speeds = tuple(sorted({vut for vut, _ in pairs}))
    return replace(
        case,
        vut_speeds_kmh=speeds,
        speed_limits_kmh=(speeds[0], speeds[-1]),
        pairs_kmh=pairs if len({vru for _, vru in pairs}) > 1 else (),
        extended_pairs_kmh=(),
    )


_OTHER_SIDE = {"left": "right", "right": "left"}


def worded_for(case: Case, *, keeps_left: bool) -> Case:
    """The case with its title in the words of a junction's traffic.

    Titles are those of traffic that keeps right; where it keeps left, left and right
    are exchanged.

    >>> worded_for(pick_cases("CCFtap", "cases")[0], keeps_left=True).title
    'VUT turns right across the way of an oncoming car'
    """
    if not keeps_left:
        return case
    return replace(case, title=case.title.map(_mirrored))


def _mirrored(text: str) -> str:
    """A text with left and right exchanged."""
    words = (_OTHER_SIDE.get(word, word) for word in re.split(r"\b", text))
    return "".join(words)


# ---------- tables of data/cases.toml
_Positive = Annotated[float, Meta(gt=0.0)]
_Pair = tuple[_Positive, _Positive]
_Side = Literal["near", "far"]
_MAX_STEPS = 1000


class _Speeds(Struct, frozen=True, kw_only=True):
    """Speeds of the VUT in km/h, evenly spaced."""

    min: float
    max: float
    step: float

    def __post_init__(self) -> None:
        if not (0.0 < self.min <= self.max and self.step > 0.0):
            raise InputError("", structs.asdict(self), "0 < min <= max, step > 0")
        if self.max - self.min > _MAX_STEPS * self.step:
            raise InputError("", structs.asdict(self), f"at most {_MAX_STEPS} steps")


class _BesideVut(Struct, frozen=True, kw_only=True, tag="beside-vut", tag_field="kind"):
    bodies: tuple[str, ...]
    first_gap_m: float
    between_gap_m: float
    side_gap_m: float


class _BesideRoad(
    _BesideVut, frozen=True, kw_only=True, tag="beside-road", tag_field="kind"
):
    max_speed_kmh: _Positive = math.inf


class _BesideVru(
    _BesideVut, frozen=True, kw_only=True, tag="beside-vru", tag_field="kind"
):
    pass


class _Wall(Struct, frozen=True, kw_only=True, tag="wall", tag_field="kind"):
    first_gap_m: float
    side_gap_m: float
    length_m: _Positive
    thickness_m: _Positive
    height_m: _Positive


class _CaseEntry(Struct, frozen=True, kw_only=True):
    """What entries of all kinds of cases have in common, but recorded ones."""

    title: Text
    source: Text
    vru: Text
    vru_reference: Literal["reference", "middle", "front", "corner"]
    vut_speed_kmh: (
        Annotated[_Speeds, Meta(description="a table with min, max and step")] | None
    ) = None
    vru_speed_kmh: Annotated[float, Meta(ge=0.0)] | None = None
    vru_speeds_kmh: _Speeds | None = None
    pairs_kmh: tuple[_Pair, ...] = ()
    extended_pairs_kmh: tuple[_Pair, ...] = ()
    impact_percent: Annotated[float, Meta(ge=-25.0, le=125.0, description="-25 to 125")]
    impact_face: Literal["front", "side"] = "front"
    acceleration_distance_m: _Positive | None = None
    start_distance_m: _Positive | None = None
    steady_distance_m: _Positive | None = None
    steady_time_s: _Positive | None = None
    obstruction: _BesideVut | _BesideRoad | _BesideVru | _Wall | None = None
    range: Range = "standard"

    def __post_init__(self) -> None:
        _check_one_of(self, "start_distance_m", "steady_distance_m", "steady_time_s")
        _check_one_of(self, "vut_speed_kmh", "pairs_kmh")
        _check_one_of(self, "vru_speed_kmh", "vru_speeds_kmh", "pairs_kmh")
        if self.start_distance_m is not None and self.acceleration_distance_m is None:
            got = Unquoted("nothing")
            raise InputError(
                "acceleration_distance_m", got, "metres, with start_distance_m"
            )


def _check_one_of(entry: _CaseEntry, *keys: str) -> None:
    """Raise InputError unless exactly one of some keys is given."""
    given = [key for key in keys if getattr(entry, key) not in (None, ())]
    if len(given) != 1:
        raise InputError("", given, "one of " + ", ".join(keys))


class _Crossing(
    _CaseEntry, frozen=True, kw_only=True, tag="crossing", tag_field="kind"
):
    vru_from: _Side
    vru_line: VruLine


class _Longitudinal(
    _CaseEntry, frozen=True, kw_only=True, tag="longitudinal", tag_field="kind"
):
    vru_direction: Literal["same", "opposite"] = "same"
    braking: Braking | None = None


class _Turning(_CaseEntry, frozen=True, kw_only=True, tag="turning", tag_field="kind"):
    turn: _Side
    vru_direction: Literal["same", "opposite"]
    vru_line: VruLine


class _Recorded(Struct, frozen=True, kw_only=True, tag="recorded", tag_field="kind"):
    """A case of kind "recorded", as :mod:`scenarios.conflicts` writes it."""

    title: Text
    source: Text
    vru: Text
    vut_speed_kmh: Annotated[float, Meta(gt=0.0, le=250.0)]
    vru_speed_kmh: Annotated[float, Meta(ge=0.0, le=250.0)]
    # Runs begin so long before the impact.
    known_s: Annotated[float, Meta(gt=0.0, le=60.0)]
    vut_way: RecordedWay
    vru_way: RecordedWay


@cache
def load_cases() -> dict[str, Case]:
    """All cases that come with this package and can be laid, by name."""
    table = _load_tables()
    return _read_cases(table, table, "cases.toml")


class _UnlaidEntry(Struct, frozen=True, kw_only=True):
    """A case in ``data/unlaid_cases.toml``."""

    title: Text
    source: Text
    vru: Text
    reason: Text
    vut_speeds_kmh: tuple[_Positive, ...] = ()


@cache
def load_unlaid_cases() -> dict[str, Case]:
    """Cases of the protocols that cannot be laid, by name.

    They are read from ``data/unlaid_cases.toml``.
    """
    where = "unlaid_cases.toml"
    entries = read_tables(load_data(__package__, where), _UnlaidEntry, where)
    return {
        name: Case(
            name=name,
            title=Phrase(entry.title),
            source=entry.source,
            kind="not laid",
            vru=pick_actor(entry.vru, f"{where}: {name}.vru"),
            vut_speeds_kmh=entry.vut_speeds_kmh,
            not_laid=entry.reason,
        )
        for name, entry in entries.items()
    }


def load_own_cases(path: str | Path) -> dict[str, Case]:
    """A user's own cases, by name.

    TOML as ``data/cases.toml``: a table for each case. With ``as = "CPNA-25"`` it is
    like that case, of this file or of the package's, but for what it says itself.
    Raises InputError: the file cannot be read or has no case, a case has the name of
    one of the package's, or a field is missing or not of its kind.

    A child that runs, met by cars at 30 and 40 km/h::

        [SCHOOL]
        as = "CPNA-25"
        title = "a child runs across"
        vru = "child"
        vru_speed_kmh = 10.0
        vut_speed_kmh = { min = 30, max = 40, step = 10 }
    """
    table = load_toml(Path(path))
    known = _load_tables()
    if not table:
        raise InputError(str(path), Unquoted("no case"), "a table for each case")
    for name, entry in table.items():
        if not isinstance(entry, dict):
            raise InputError(f"{path}: {name}", entry, "a table, which is a case")
        if (
            name in known
            or name in load_case_sets()
            or "," in name
            or not name.isprintable()
        ):
            raise InputError(
                f"{path}: {name}", name, "a name that no case or set of ours has"
            )
    return _read_cases({**known, **table}, table, str(path))


def _load_tables() -> Table:
    return load_data(__package__, "cases.toml")


def _read_cases(table: Table, names: Iterable[str], where: str) -> dict[str, Case]:
    """Cases by name, from tables that may be like one another, or stand for several."""
    cases = {}
    for table_name in names:
        here = f"{where}: {table_name}"
        for name, one in _each_impact(
            table_name, _whole_entry(table, table_name, where)
        ):
            # A union is no class to mypy, but the reader takes it.
            entry = read_table(one, _ANY_CASE, here)
            build = _build_recorded if isinstance(entry, _Recorded) else _build_case
            cases[name] = build(name, entry, here)
    return cases


def _each_impact(
    name: str, entry: dict[str, Any]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Cases of a table that differ in where the VRU meets the VUT.

    A table with a list of places stands for a case for each place.
    """
    percents = entry.get("impact_percent")
    beyond = entry.pop("extended_impact_percent", [])
    if not isinstance(percents, list):
        yield name, entry
        return
    for percent in [*percents, *beyond]:
        if percent in percents:
            which = {}
        else:
            which = {"range": "extended"}
        title = Phrase(
            "{title}, impact at {share} % of the VUT's width",
            title=Phrase(str(entry.get("title"))),
            share=percent,
        )
        # No two signs in a row: 25 % outside of the right edge is "m25".
        called = f"{name}-{percent}".replace("--", "-m")
        yield called, {**entry, "impact_percent": percent, "title": title, **which}


_ANY_CASE: Any = _Crossing | _Longitudinal | _Turning | _Recorded


@cache
def load_case_sets() -> dict[str, tuple[Case, ...]]:
    """Sets of cases, by name; "all" is every case.

    Cases have the speeds of the set, if it has any.
    """
    table = load_data(__package__, "case_sets.toml")
    sets: dict[str, tuple[Case, ...]] = {}
    alike = {
        name: entries for name, entries in table.items() if isinstance(entries, str)
    }
    for set_name in [name for name in table if name not in alike]:
        entries = table[set_name]
        driven = list[Case]()
        for name, entry in entries.items():
            where = f"case_sets.toml: {set_name}.{name}"
            if entry:
                speeds = read_table(entry, _Speeds, where)
            else:
                speeds = None
            found = _named(name)
            if not found:
                raise InputError(
                    where,
                    name,
                    Phrase("a case name, or the beginning of several"),
                )
            if speeds:
                found = tuple(
                    replace(one, vut_speeds_kmh=_speeds_kmh(speeds)) for one in found
                )
            driven += found
        sets[set_name] = tuple(driven)
    for set_name, other in alike.items():
        sets[set_name] = pick(sets, other, f"case_sets.toml: {set_name}")
    every = (*load_cases().values(), *load_unlaid_cases().values())
    return {name: sets[name] for name in table} | {ALL_CASES: every}


def _named(word: str) -> tuple[Case, ...]:
    """Cases that a word names.

    It is a name, what stands before the last "-" of names, or how names begin.
    """
    cases = {**load_cases(), **load_unlaid_cases()}
    if word in cases:
        return (cases[word],)
    whole = [case for name, case in cases.items() if _stem(name) == word]
    return tuple(
        whole or [case for name, case in cases.items() if name.startswith(f"{word}-")]
    )


def _stem(name: str) -> str:
    """A case's name without its impact point or side."""
    return name.rpartition("-")[0] or name


def _speeds_kmh(speeds: _Speeds) -> tuple[float, ...]:
    """Speeds from the lowest to the highest, ascending."""
    return tuple(
        np.arange(speeds.min, speeds.max + 0.5 * speeds.step, speeds.step).tolist()
    )


def _whole_entry(
    table: Table, name: str, where: str, *, seen: tuple[str, ...] = ()
) -> dict[str, Any]:
    """A case's table, on top of the one that it is like."""
    entry = dict(table[name])
    if "as" not in entry:
        return entry
    other = entry.pop("as")
    if not isinstance(other, str) or other not in table or other in (*seen, name):
        raise InputError(f"{where}: {name}.as", other, "another case, not in a circle")
    return {**_whole_entry(table, other, where, seen=(*seen, name)), **entry}


def _as_phrase(title: str) -> Phrase:
    """A title as it is if it has been put together here, else by itself."""
    if isinstance(title, Phrase):
        return title
    return Phrase(title)


def _build_recorded(name: str, entry: _Recorded, where: str) -> Case:
    """Case of an entry of kind "recorded"."""
    speed_kmh = entry.vut_speed_kmh
    return Case(
        name=name,
        title=_as_phrase(entry.title),
        source=entry.source,
        kind="recorded",
        vru=pick_actor(entry.vru, f"{where}.vru"),
        vru_speed_kmh=entry.vru_speed_kmh,
        vut_speeds_kmh=(speed_kmh,),
        speed_limits_kmh=(speed_kmh, speed_kmh),
        recorded=RecordedEncounter(
            vut=entry.vut_way, vru=entry.vru_way, known_s=entry.known_s
        ),
    )


_SAME = (
    *(
        "source",
        "impact_percent",
        "impact_face",
        "start_distance_m",
        "steady_distance_m",
    ),
    *("steady_time_s", "range", "turn", "vru_direction", "vru_line", "braking"),
)
"""Fields that cases take from entries unchanged, if the entry's kind has them."""


def _build_case(
    name: str, entry: _Crossing | _Longitudinal | _Turning, where: str
) -> Case:
    """Case of an entry of the protocol's kinds; `where` names the entry."""
    vru = pick_actor(entry.vru, f"{where}.vru")
    pairs = tuple(sorted(entry.pairs_kmh))
    steps = entry.vut_speed_kmh
    if steps is None:
        speeds = tuple(sorted({vut for vut, _ in pairs}))
    else:
        speeds = _speeds_kmh(steps)
    if steps is not None and entry.vru_speeds_kmh is not None:
        pairs = tuple(
            (vut, vru) for vut in speeds for vru in _speeds_kmh(entry.vru_speeds_kmh)
        )
    same: dict[str, Any] = {
        key: getattr(entry, key) for key in _SAME if hasattr(entry, key)
    }
    reference_m = {"reference": vru.reference_ahead_m, "middle": 0.0}
    return Case(
        name=name,
        title=_as_phrase(entry.title),
        kind=str(type(entry).__struct_config__.tag),
        vru=vru,
        vru_speed_kmh=(
            pairs[0][1] if entry.vru_speed_kmh is None else entry.vru_speed_kmh
        ),
        vut_speeds_kmh=speeds,
        # Lowest and highest of the protocol, whatever the step between them.
        speed_limits_kmh=(
            (speeds[0], speeds[-1]) if steps is None else (steps.min, steps.max)
        ),
        vru_reference_m=reference_m.get(entry.vru_reference, 0.5 * vru.length_m),
        meets_corner=entry.vru_reference == "corner",
        acceleration_distance_m=entry.acceleration_distance_m or 0.0,
        vru_side=getattr(entry, "vru_from", ""),
        obstruction=_build_obstruction(entry.obstruction, f"{where}.obstruction"),
        pairs_kmh=pairs,
        extended_pairs_kmh=tuple(sorted(entry.extended_pairs_kmh)),
        **same,
    )


def _build_obstruction(
    entry: _BesideVut | _BesideRoad | _BesideVru | _Wall | None, where: str
) -> Obstruction | None:
    """Obstruction of an entry; None: the case has none."""
    if entry is None:
        return None
    fields: dict[str, Any] = structs.asdict(entry)
    if isinstance(entry, _Wall):
        sides = ("length_m", "thickness_m", "height_m")
        fields["wall_size_m"] = tuple(fields.pop(name) for name in sides)
    else:
        names = enumerate(entry.bodies)
        fields["bodies"] = tuple(
            pick_actor(one, f"{where}.bodies[{at}]") for at, one in names
        )
    return Obstruction(kind=str(type(entry).__struct_config__.tag), **fields)


# ---------- cases and speeds in the words of a user
_HIGHEST_KMH = 250.0


def pick_cases(
    text: str, where: str, *, case_range: Range = "standard"
) -> tuple[Case, ...]:
    """Cases by the words of a user, each once, in the order named.

    `text`: a set ("default", "study", "protocol-4.5.1", "protocol-2026", "junction",
    "all"), names, or files of one's own cases (.toml), with commas between. The part of
    a name before its last "-" stands for all cases that share it: "CPNA" for CPNA-25
    and CPNA-75, "CPNA-2026" for all impact points of 2026. `where` is for the error
    message about an unknown name. `case_range` "extended" adds cases and speeds of Euro
    NCAP's extended range, 2026; one that belongs to that range alone, and is named in
    full, is picked anyway.

    >>> [case.name for case in pick_cases("CBLA-50, CPNA", "cases")]
    ['CBLA-50', 'CPNA-25', 'CPNA-75']
    """
    picked: dict[str, Case] = {}
    for word in (part.strip() for part in text.split(",")):
        if word.lower().endswith(".toml"):
            found = tuple(load_own_cases(word).values())
        else:
            found = load_case_sets().get(word) or _named(word)
        if not found:
            families = dict.fromkeys(_stem(name) for name in load_cases())
            known = ", ".join([*load_case_sets(), *families])
            expected = f"one of {known}, a .toml file, or several with commas between"
            raise InputError(where, word, expected)
        within = []
        for case in found:
            is_named = case.name == word and case.range == "extended"
            if (
                one := in_range(case, "extended" if is_named else case_range)
            ) is not None:
                within.append(one)
        for case in _each_once(within) if word == ALL_CASES else within:
            picked.setdefault(case.name, case)
    return tuple(picked.values())


def twins(cases: Iterable[Case]) -> dict[str, Case]:
    """By the name of a case of 2026 the one of 2023 that differs in speeds alone."""
    cases = tuple(cases)
    # Cases are alike that differ in names and speeds alone.
    before = {_alike(case): case for case in cases if case.source == "protocol-4.5.1"}
    after = [
        case for case in cases if case.source == "protocol-2026" and not case.pairs_kmh
    ]
    return {case.name: before[_alike(case)] for case in after if _alike(case) in before}


def _each_once(cases: Sequence[Case]) -> list[Case]:
    """Cases without what 2026 drives as 2023 did.

    Impact points of the same case take turns.
    """
    twin_of = twins(cases)
    kept = []
    for case in cases:
        # Only speeds that 2023 did not drive are left.
        twin = twin_of.get(case.name)
        if twin is not None:
            new = tuple(sorted({*case.vut_speeds_kmh} - {*twin.vut_speeds_kmh}))
            if not new:
                continue
            case = replace(case, vut_speeds_kmh=new, speed_limits_kmh=(new[0], new[-1]))
        kept.append(case)
    points: dict[object, list[str]] = {}
    for case in kept:
        points.setdefault(_but_for_the_point(case), []).append(case.name)
    names_of = [points[_but_for_the_point(case)] for case in kept]
    turns = [
        (names.index(case.name), len(names))
        for case, names in zip(kept, names_of, strict=True)
    ]
    return [
        replace(case, impact_turn=turn) for case, turn in zip(kept, turns, strict=True)
    ]


def _alike(case: Case) -> Case:
    """The case but for its names and speeds."""
    return replace(
        case,
        name=case.family,
        title=Phrase(""),
        source="",
        vut_speeds_kmh=(),
        speed_limits_kmh=(0.0, 0.0),
        extended_pairs_kmh=(),
        range="standard",
    )


def _but_for_the_point(case: Case) -> tuple[Case, str, tuple[float, ...]]:
    """What cases share that differ in the impact point alone."""
    return replace(_alike(case), impact_percent=0.0), case.source, case.vut_speeds_kmh


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Cases to drive.

    Attributes
    ----------
    cases : tuple of Case
        Cases, each with the speeds to be driven.
    left_out : tuple of Case
        Cases none of whose speeds were asked for; with the speeds that they
        have.
    unprotected : tuple of Case
        Cases that meet somebody who is not to be protected.
    """

    cases: tuple[Case, ...]
    left_out: tuple[Case, ...]
    unprotected: tuple[Case, ...] = ()


def select_cases(
    cases: str,
    *,
    speeds: str | None = None,
    case_range: Range = "standard",
    protect: str = "all",
) -> Selection:
    """Cases and speeds by the words of a user.

    `cases` and `case_range` are as for :func:`pick_cases`; `speeds` are km/h with
    commas between, or ranges: "20-40" is every speed of the case in it; "30x50" are
    those of the VUT and of whoever it meets; "all" or None: every one. `protect` is
    "vru" or "all", see ``PROTECTED``.

    Raises
    ------
    InputError
        A name or a speed cannot be read, a speed lies outside of every case, or
        nobody is left to be protected.

    Examples
    --------
    >>> select_cases("CPNA-25", speeds="20,30-40").cases
    (Case('CPNA-25', 20, 30, 35, 40 km/h),)
    """
    asked = pick_cases(cases, "cases", case_range=case_range)
    counted = pick(PROTECTED, protect, "protect")
    picked = tuple(case for case in asked if case.road_user in counted)
    unprotected = tuple(case for case in asked if case.road_user not in counted)
    if unprotected and all(case.not_laid for case in picked):
        met = " or ".join(dict.fromkeys(case.road_user for case in unprotected))
        raise InputError(
            "protect", protect, f"all, where every case asked for meets a {met}"
        )
    laid = [case for case in picked if not case.not_laid]
    if speeds is None or speeds.strip() == ALL_SPEEDS or not laid:
        return Selection(cases=picked, left_out=(), unprotected=unprotected)
    singles, ranges, pair_words = _read_speeds(speeds)
    for speed in singles:
        if not any(_is_within(speed, case) for case in laid):
            raise InputError("speeds", Unquoted(f"{speed:g}"), _limits(laid))
    for vut, vru in pair_words:
        if not any(
            vru in case.vru_speeds_kmh(vut) for case in laid if _is_within(vut, case)
        ):
            expected = f"speeds that go together in a case; the VUT's: {_limits(laid)}"
            raise InputError("speeds", Unquoted(f"{vut:g}x{vru:g}"), expected)
    # Each case with the speeds asked for that it has.
    kept = []
    left_out = []
    for case in laid:
        driven = {speed for speed in singles if _is_within(speed, case)}
        usual = case.vut_speeds_kmh
        driven |= {
            speed for speed in usual for low, high in ranges if low <= speed <= high
        }
        pairs = [
            (vut, vru)
            for vut, vru in pair_words
            if vru in case.vru_speeds_kmh(vut)
            if _is_within(vut, case)
        ]
        if pairs and case.pairs_kmh:
            pairs += [(vut, vru) for vut in driven for vru in case.vru_speeds_kmh(vut)]
            case = replace(case, pairs_kmh=tuple(sorted(set(pairs))))
        driven |= {vut for vut, _ in pairs}
        if driven:
            kept.append(replace(case, vut_speeds_kmh=tuple(sorted(driven))))
        else:
            left_out.append(case)
    if not kept:
        raise InputError("speeds", speeds, _limits(laid))
    return Selection(
        cases=(*kept, *(case for case in picked if case.not_laid)),
        left_out=tuple(left_out),
        unprotected=unprotected,
    )


_Pairs = list[tuple[float, float]]


def _read_speeds(text: str) -> tuple[list[float], _Pairs, _Pairs]:
    """Speeds in the words of a user, in km/h.

    They are single ones, ranges, and pairs of both bodies.

    Raises
    ------
    InputError
        A word is no speed, or out of range.
    """
    singles: list[float] = []
    ranges: _Pairs = []
    pairs: _Pairs = []
    for word in (part.strip() for part in text.split(",")):
        if "x" in word:
            separator = "x"
        else:
            separator = "-"
        found = [float_of(part) for part in word.split(separator, 1)]
        if not all(0.0 < speed <= _HIGHEST_KMH for speed in found):
            known = (
                "km/h with commas between, such as 20,30 or 20-40, or 30x50 for those"
                " of both"
            )
            raise InputError("speeds", word, f"{known}, up to {_HIGHEST_KMH:g}")
        if len(found) == 1:
            singles.append(found[0])
        elif separator == "x":
            pairs.append((found[0], found[1]))
        elif found[0] > found[1]:
            raise InputError("speeds", word, "the lower speed first")
        else:
            ranges.append((found[0], found[1]))
    return singles, ranges, pairs


def _is_within(speed_kmh: float, case: Case) -> bool:
    """True if the protocol drives a case at a speed."""
    low, high = case.speed_limits_kmh
    return low <= speed_kmh <= high


def _limits(cases: Sequence[Case]) -> str:
    """Range of speeds of some cases, in words."""
    low = min(case.speed_limits_kmh[0] for case in cases)
    high = max(case.speed_limits_kmh[1] for case in cases)
    return f"{low:g} to {high:g} km/h as the protocol drives these cases"
