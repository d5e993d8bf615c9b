"""Test cases, from ``data/cases.toml`` and files of one's own: a table each, no new code."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct, structs

from geometry.actors import Actor, pick_actor
from geometry.errors import InputError, Unquoted
from geometry.files import Table, Text, load_toml, pick, read_table

ALL_CASES = "all"
ALL_SPEEDS = "all"


@dataclass(frozen=True, slots=True, kw_only=True)
class VruLine:
    """On which line of the junction the VRU moves."""

    # "crosswalk", "lane" (of the arm it comes from) or "kerb" (of the VUT's approach road)
    along: str
    lane: str = ""  # "outer" (at the kerb) or "inner"; empty unless along a lane
    # to the left of the lane's middle; along a kerb: outside it, negative on the road
    left_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Obstruction:
    """Parked bodies, or a wall, that belong to a case."""

    kind: str  # "beside-vut", "beside-vru" or "wall"
    bodies: tuple[Actor, ...]  # from the one nearest to the meeting point; none for a wall
    # from the first body to the VRU's flank (beside-vut), or from the VUT's centreline to the first
    # body or the wall
    first_gap_m: float
    between_gap_m: float  # from bumper to bumper
    side_gap_m: float  # to the side of the VUT, or to that of the VRU's box
    wall_size_m: tuple[float, ...]  # length, thickness, height of the wall; empty without one


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A Euro NCAP AEB VRU case.

    Attributes
    ----------
    name : str
        Name.
    title : str
        What happens, in words.
    source : str
        "protocol-4.5.1", "protocol-2026" or "CarlaNCAP".
    kind : str
        "crossing", "longitudinal" or "turning".
    vru : Actor
        The vulnerable road user's body.
    vru_speed_kmh : float
        Steady. [km/h]
    vut_speeds_kmh : tuple of float
        Speeds to be driven, ascending. [km/h]
    speed_limits_kmh : tuple of float
        Lowest and highest speed of the protocol. [km/h]
    impact_percent, impact_face : float, str
        Where the VRU meets the VUT: "front" - of its width, 0 = right edge, 100 = left edge;
        "side" - of its length, 0 = rear, on the side towards which it turns. [%]
    vru_reference_m : float
        The VRU's point that meets the impact position, ahead of the middle of its box. [m]
    acceleration_distance_m : float
        From rest to the steady speed. [m]
    start_distance_m, steady_distance_m : float or None
        One of the two: the reference point's way from rest to the nominal meeting line (the VUT's
        centreline, or that of its exit lane), or the way at steady speed before the impact. [m]
    vru_side : str
        Crossing: "near" or "far", from where the VRU comes.
    turn, vru_direction : str
        Turning: "near" or "far", where the VUT turns to; "same" or "opposite", as the VUT before
        its turn.
    vru_line : VruLine or None
        None in longitudinal cases: the VUT's lane.
    obstruction : Obstruction or None
        What hides the VRU.
    """

    name: str
    title: str
    source: str
    kind: str
    vru: Actor
    vru_speed_kmh: float
    vut_speeds_kmh: tuple[float, ...]
    speed_limits_kmh: tuple[float, float]
    impact_percent: float
    impact_face: str
    vru_reference_m: float
    acceleration_distance_m: float
    start_distance_m: float | None
    steady_distance_m: float | None
    vru_side: str
    turn: str
    vru_direction: str
    vru_line: VruLine | None
    obstruction: Obstruction | None

    def __repr__(self) -> str:
        speeds = ", ".join(f"{speed:g}" for speed in self.vut_speeds_kmh)
        return f"Case({self.name!r}, {speeds} km/h)"


_OTHER_SIDE = {"left": "right", "right": "left"}


def worded_for(case: Case, *, keeps_left: bool) -> Case:
    """The case with its title in the words of a junction's traffic.

    Titles are those of traffic that keeps right; where it keeps left, left and right are exchanged.

    Examples
    --------
    >>> worded_for(pick_cases("CPTAfs-50", "cases")[0], keeps_left=True).title
    'VUT turns right, adult crosses from the far side, walking as the VUT drove'
    """
    if not keeps_left:
        return case
    words = (_OTHER_SIDE.get(word, word) for word in re.split(r"\b", case.title))
    return replace(case, title="".join(words))


# ---------- tables of data/cases.toml
_Positive = Annotated[float, Meta(gt=0.0)]
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


class _Crosswalk(Struct, frozen=True, kw_only=True, tag="crosswalk", tag_field="along"):
    pass


class _Lane(Struct, frozen=True, kw_only=True, tag="lane", tag_field="along"):
    lane: Literal["inner", "outer"]
    left_of_lane_centre_m: float


class _Kerb(Struct, frozen=True, kw_only=True, tag="kerb", tag_field="along"):
    outside_kerb_m: float


class _BesideVut(Struct, frozen=True, kw_only=True, tag="beside-vut", tag_field="kind"):
    bodies: tuple[str, ...]
    first_gap_m: float
    between_gap_m: float
    side_gap_m: float


class _BesideVru(_BesideVut, frozen=True, kw_only=True, tag="beside-vru", tag_field="kind"):
    pass


class _Wall(Struct, frozen=True, kw_only=True, tag="wall", tag_field="kind"):
    first_gap_m: float
    side_gap_m: float
    length_m: _Positive
    thickness_m: _Positive
    height_m: _Positive


class _CaseEntry(Struct, frozen=True, kw_only=True):
    title: Text
    source: Text
    vru: Text
    vru_speed_kmh: _Positive
    vru_reference: Literal["reference", "middle", "front"]
    vut_speed_kmh: Annotated[_Speeds, Meta(description="a table with min, max and step")]
    impact_percent: Annotated[float, Meta(ge=0.0, le=100.0, description="0 to 100")]
    impact_face: Literal["front", "side"] = "front"
    acceleration_distance_m: _Positive
    start_distance_m: _Positive | None = None
    steady_distance_m: _Positive | None = None
    obstruction: _BesideVut | _BesideVru | _Wall | None = None

    def __post_init__(self) -> None:
        starts = [
            key
            for key in ("start_distance_m", "steady_distance_m")
            if getattr(self, key) is not None
        ]
        if len(starts) != 1:
            raise InputError("", starts, "either start_distance_m or steady_distance_m")


class _Crossing(_CaseEntry, frozen=True, kw_only=True, tag="crossing", tag_field="kind"):
    vru_from: _Side
    vru_line: _Crosswalk | _Lane | _Kerb


class _Longitudinal(_CaseEntry, frozen=True, kw_only=True, tag="longitudinal", tag_field="kind"):
    pass


class _Turning(_CaseEntry, frozen=True, kw_only=True, tag="turning", tag_field="kind"):
    turn: _Side
    vru_direction: Literal["same", "opposite"]
    vru_line: _Crosswalk | _Lane | _Kerb


@cache
def load_cases() -> dict[str, Case]:
    """All cases that come with this package, by name."""
    table = _load_tables()
    return _read_cases(table, table, "cases.toml")


def load_own_cases(path: str | Path) -> dict[str, Case]:
    """A user's own cases, by name.

    Parameters
    ----------
    path : str or Path
        TOML as ``data/cases.toml``: a table for each case. With ``as = "CPNA-25"`` it is like that
        case, of this file or of the package's, but for what it says itself.

    Raises
    ------
    InputError
        The file cannot be read or has no case, a case has the name of one of the package's, or a
        field is missing or not of its kind.

    Examples
    --------
    A child that runs, met by cars at 30 and 40 km/h::

        [SCHOOL]
        as = "CPNA-25"
        title = "a child runs across"
        vru = "child"
        vru_speed_kmh = 10.0
        vut_speed_kmh = { min = 30, max = 40, step = 10 }
    """
    table, known = load_toml(Path(path)), _load_tables()
    if not table:
        raise InputError(str(path), Unquoted("no case"), "a table for each case")
    for name, entry in table.items():
        if not isinstance(entry, dict):
            raise InputError(f"{path}: {name}", entry, "a table, which is a case")
        if name in known or name in load_case_sets() or "," in name or not name.isprintable():
            raise InputError(f"{path}: {name}", name, "a name that no case or set of ours has")
    return _read_cases({**known, **table}, table, str(path))


def _load_tables() -> Table:
    return load_toml(files(__package__) / "data" / "cases.toml")


def _read_cases(table: Table, names: Iterable[str], where: str) -> dict[str, Case]:
    """Cases by name, from tables that may be like one another."""
    cases = {}
    for name in names:
        here = f"{where}: {name}"
        # A union is no class to mypy, but the reader takes it.
        entry = read_table(_whole_entry(table, name, where), _ANY_CASE, here)
        cases[name] = _build_case(name, entry, here)
    return cases


_ANY_CASE: Any = _Crossing | _Longitudinal | _Turning


@cache
def load_case_sets() -> dict[str, tuple[Case, ...]]:
    """Sets of cases, by name, with the speeds of the set if it has any; "all" is every case."""
    table = load_toml(files(__package__) / "data" / "case_sets.toml")
    cases = load_cases()
    sets: dict[str, tuple[Case, ...]] = {}
    alike = {name: entries for name, entries in table.items() if isinstance(entries, str)}
    for set_name, entries in table.items():
        if set_name in alike:
            continue
        driven = []
        for name, entry in entries.items():
            speeds = (
                read_table(entry, _Speeds, f"case_sets.toml: {set_name}.{name}") if entry else None
            )
            driven.append(
                replace(cases[name], vut_speeds_kmh=_speeds_kmh(speeds)) if speeds else cases[name]
            )
        sets[set_name] = tuple(driven)
    for set_name, other in alike.items():
        sets[set_name] = pick(sets, other, f"case_sets.toml: {set_name}")
    return {**{name: sets[name] for name in table}, ALL_CASES: tuple(cases.values())}


def _speeds_kmh(speeds: _Speeds) -> tuple[float, ...]:
    return tuple(np.arange(speeds.min, speeds.max + 0.5 * speeds.step, speeds.step).tolist())


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


def _build_case(name: str, entry: _Crossing | _Longitudinal | _Turning, where: str) -> Case:
    vru = pick_actor(entry.vru, f"{where}.vru")
    return Case(
        name=name,
        title=entry.title,
        source=entry.source,
        kind=str(type(entry).__struct_config__.tag),
        vru=vru,
        vru_speed_kmh=entry.vru_speed_kmh,
        vut_speeds_kmh=_speeds_kmh(entry.vut_speed_kmh),
        speed_limits_kmh=(entry.vut_speed_kmh.min, entry.vut_speed_kmh.max),
        impact_percent=entry.impact_percent,
        impact_face=entry.impact_face,
        vru_reference_m={
            "reference": vru.reference_ahead_m,
            "middle": 0.0,
            "front": 0.5 * vru.length_m,
        }[entry.vru_reference],
        acceleration_distance_m=entry.acceleration_distance_m,
        start_distance_m=entry.start_distance_m,
        steady_distance_m=entry.steady_distance_m,
        vru_side=entry.vru_from if isinstance(entry, _Crossing) else "",
        turn=entry.turn if isinstance(entry, _Turning) else "",
        vru_direction=entry.vru_direction if isinstance(entry, _Turning) else "",
        vru_line=None if isinstance(entry, _Longitudinal) else _build_line(entry.vru_line),
        obstruction=_build_obstruction(entry.obstruction, f"{where}.obstruction"),
    )


def _build_line(line: _Crosswalk | _Lane | _Kerb) -> VruLine:
    match line:
        case _Lane(lane=lane, left_of_lane_centre_m=left_m):
            return VruLine(along="lane", lane=lane, left_m=left_m)
        case _Kerb(outside_kerb_m=outside_m):
            return VruLine(along="kerb", left_m=outside_m)
        case _:
            return VruLine(along="crosswalk")


def _build_obstruction(
    entry: _BesideVut | _BesideVru | _Wall | None, where: str
) -> Obstruction | None:
    if entry is None:
        return None
    if isinstance(entry, _Wall):
        return Obstruction(
            kind="wall",
            bodies=(),
            first_gap_m=entry.first_gap_m,
            between_gap_m=0.0,
            side_gap_m=entry.side_gap_m,
            wall_size_m=(entry.length_m, entry.thickness_m, entry.height_m),
        )
    return Obstruction(
        kind="beside-vru" if isinstance(entry, _BesideVru) else "beside-vut",
        bodies=tuple(
            pick_actor(name, f"{where}.bodies[{index}]") for index, name in enumerate(entry.bodies)
        ),
        first_gap_m=entry.first_gap_m,
        between_gap_m=entry.between_gap_m,
        side_gap_m=entry.side_gap_m,
        wall_size_m=(),
    )


# ---------- cases and speeds in the words of a user
_HIGHEST_KMH = 250.0


def pick_cases(text: str, where: str) -> tuple[Case, ...]:
    """Cases by the words of a user.

    Parameters
    ----------
    text : str
        A set ("default", "study", "protocol-4.5.1", "all"), names, or files of one's own cases
        (.toml), with commas between. The part of a name before its "-" stands for all cases that
        share it: "CPNA" for CPNA-25 and CPNA-75.
    where : str
        For the error message about an unknown name.

    Returns
    -------
    cases : tuple of Case
        Each once, in the order named.

    Examples
    --------
    >>> [case.name for case in pick_cases("CBLA-50, CPNA", "cases")]
    ['CBLA-50', 'CPNA-25', 'CPNA-75']
    """
    picked: dict[str, Case] = {}
    for word in (part.strip() for part in text.split(",")):
        if word.lower().endswith(".toml"):
            found = tuple(load_own_cases(word).values())
        elif word in load_case_sets():
            found = load_case_sets()[word]
        elif word in load_cases():
            found = (load_cases()[word],)
        else:
            found = tuple(
                case for case in load_cases().values() if case.name.startswith(f"{word}-")
            )
        if not found:
            known = ", ".join([*load_case_sets(), *load_cases()])
            expected = f"one of {known}, a .toml file, or several with commas between"
            raise InputError(where, word, expected)
        for case in found:
            picked.setdefault(case.name, case)
    return tuple(picked.values())


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Cases to drive."""

    cases: tuple[Case, ...]  # each with the speeds to be driven
    # cases none of whose speeds were asked for; with the speeds that they have
    left_out: tuple[Case, ...]
    beyond: tuple[str, ...]  # "case: speeds" outside of what the protocol drives, which were forced


def select_cases(cases: str, *, speeds: str | None = None, force: bool = False) -> Selection:
    """Cases and speeds by the words of a user.

    `cases` is as for :func:`pick_cases`; `speeds` are km/h with commas between, or ranges: "20-40"
    is every speed of the case in it; "all" or None: every one. `force` drives speeds that the
    protocol does not. Raises InputError: a name or a speed cannot be read, or a speed lies outside
    of every case.

    Examples
    --------
    >>> select_cases("CPNA-25", speeds="20,30-40").cases
    (Case('CPNA-25', 20, 30, 35, 40 km/h),)
    """
    picked = pick_cases(cases, "cases")
    if speeds is None or speeds.strip() == ALL_SPEEDS:
        return Selection(cases=picked, left_out=(), beyond=())
    singles, ranges = _read_speeds(speeds)
    if not force:
        for speed in singles:
            if not any(_is_within(speed, case) for case in picked):
                raise InputError("speeds", Unquoted(f"{speed:g}"), _limits(picked))
    kept, left_out, beyond = [], [], []
    for case in picked:
        driven = {speed for speed in singles if force or _is_within(speed, case)}
        driven |= {s for s in case.vut_speeds_kmh if any(low <= s <= high for low, high in ranges)}
        outside = sorted(speed for speed in driven if not _is_within(speed, case))
        if outside:
            beyond.append(f"{case.name}: " + ", ".join(f"{speed:g}" for speed in outside))
        if driven:
            kept.append(replace(case, vut_speeds_kmh=tuple(sorted(driven))))
        else:
            left_out.append(case)
    if not kept:
        raise InputError("speeds", speeds, _limits(picked))
    return Selection(cases=tuple(kept), left_out=tuple(left_out), beyond=tuple(beyond))


def _read_speeds(text: str) -> tuple[list[float], list[tuple[float, float]]]:
    singles, ranges = [], []
    for word in (part.strip() for part in text.split(",")):
        low, dash, high = word.partition("-")
        numbers = [_read_speed(part) for part in ([low, high] if dash else [low])]
        if any(number is None for number in numbers):
            expected = f"km/h with commas between, such as 20,30 or 20-40, up to {_HIGHEST_KMH:g}"
            raise InputError("speeds", word, expected)
        found = [number for number in numbers if number is not None]
        if len(found) == 1:
            singles.append(found[0])
        elif found[0] > found[1]:
            raise InputError("speeds", word, "the lower speed first")
        else:
            ranges.append((found[0], found[1]))
    return singles, ranges


def _read_speed(text: str) -> float | None:
    try:
        speed = float(text)
    except ValueError:
        return None
    return speed if math.isfinite(speed) and 0.0 < speed <= _HIGHEST_KMH else None


def _is_within(speed_kmh: float, case: Case) -> bool:
    low, high = case.speed_limits_kmh
    return low <= speed_kmh <= high


def _limits(cases: Sequence[Case]) -> str:
    low = min(case.speed_limits_kmh[0] for case in cases)
    high = max(case.speed_limits_kmh[1] for case in cases)
    return f"{low:g} to {high:g} km/h as the protocol drives these cases, or `force`"
