"""Test cases, from ``data/cases.toml``: a new case is a new table there, not new code."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from geometry.actors import Actor, pick_actor
from geometry.errors import InputError, Unquoted
from geometry.files import (
    Table,
    load_toml,
    take,
    take_list,
    take_number,
    take_text,
)

KINDS = ("crossing", "longitudinal", "turning")
SIDES = ("near", "far")
_LINES = ("crosswalk", "lane", "kerb")
_OBSTRUCTIONS = ("beside-vut", "beside-vru", "wall")
ALL_CASES = "all"


@dataclass(frozen=True, slots=True, kw_only=True)
class VruLine:
    """On which line of the junction the VRU moves.

    Attributes
    ----------
    along : str
        "crosswalk", "lane" (of the arm it comes from) or "kerb" (of the VUT's approach road).
    lane : str
        "outer" (at the kerb) or "inner"; empty unless along a lane.
    left_m : float
        To the left of the lane's middle; along a kerb: outside it, negative on the road. [m]
    """

    along: str
    lane: str = ""
    left_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Obstruction:
    """Parked bodies, or a wall, that belong to a case.

    Attributes
    ----------
    kind : str
        "beside-vut", "beside-vru" or "wall".
    bodies : tuple of Actor
        From the one nearest to the meeting point; none for a wall.
    first_gap_m : float
        From the first body to the VRU's flank (beside-vut), or from the VUT's centreline to the
        first body or the wall. [m]
    between_gap_m : float
        From bumper to bumper. [m]
    side_gap_m : float
        To the side of the VUT, or to that of the VRU's box. [m]
    wall_size_m : tuple of float
        Length, thickness, height of the wall; empty without one. [m]
    """

    kind: str
    bodies: tuple[Actor, ...]
    first_gap_m: float
    between_gap_m: float
    side_gap_m: float
    wall_size_m: tuple[float, ...]


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


@cache
def load_cases() -> dict[str, Case]:
    """All cases, by name."""
    table = load_toml(files(__package__) / "data" / "cases.toml")
    return {
        name: _build_case(name, _whole_entry(table, name), f"cases.toml: {name}") for name in table
    }


@cache
def load_case_sets() -> dict[str, tuple[Case, ...]]:
    """Sets of cases, by name, with the speeds of the set; "all" is every case."""
    table = load_toml(files(__package__) / "data" / "case_sets.toml")
    cases = load_cases()
    sets = {
        set_name: tuple(
            _with_speeds(cases[name], entry, f"case_sets.toml: {set_name}.{name}")
            for name, entry in entries.items()
        )
        for set_name, entries in table.items()
    }
    return {**sets, ALL_CASES: tuple(cases.values())}


def pick_cases(text: str, where: str) -> tuple[Case, ...]:
    """Cases by the words of a user.

    Parameters
    ----------
    text : str
        A set ("study", "protocol-4.5.1", "all"), or names with commas between. The part of a name
        before its "-" stands for all cases that share it: "CPNA" for CPNA-25 and CPNA-75.
    where : str
        For the error message about an unknown name.

    Returns
    -------
    cases : tuple of Case
        Each once, in the order named.

    Examples
    --------
    >>> [case.name for case in pick_cases("CBLA-50, CPNA", "--cases")]
    ['CBLA-50', 'CPNA-25', 'CPNA-75']
    """
    picked: dict[str, Case] = {}
    for word in (part.strip() for part in text.split(",")):
        if word in load_case_sets():
            found = load_case_sets()[word]
        elif word in load_cases():
            found = (load_cases()[word],)
        else:
            found = tuple(
                case for case in load_cases().values() if case.name.startswith(f"{word}-")
            )
        if not found:
            known = ", ".join([*load_case_sets(), *load_cases()])
            raise InputError(where, word, f"one of {known}, or several with commas between")
        for case in found:
            picked.setdefault(case.name, case)
    return tuple(picked.values())


def _whole_entry(table: Table, name: str, *, seen: tuple[str, ...] = ()) -> dict[str, Any]:
    """A case's table, on top of the one that it is like."""
    entry = dict(table[name])
    if "as" not in entry:
        return entry
    other = entry.pop("as")
    if other not in table or other in seen:
        raise InputError(f"cases.toml: {name}.as", other, "another case, not in a circle")
    return {**_whole_entry(table, other, seen=(*seen, name)), **entry}


def _build_case(name: str, entry: Table, where: str) -> Case:
    kind = _take_word(entry, "kind", where, KINDS)
    vru = pick_actor(take_text(entry, "vru", where), f"{where}.vru")
    starts = [key for key in ("start_distance_m", "steady_distance_m") if key in entry]
    if len(starts) != 1:
        raise InputError(where, starts, "either start_distance_m or steady_distance_m")
    low, high, _ = _take_speeds(entry, where)
    is_turning = kind == "turning"
    reference = _take_word(entry, "vru_reference", where, ("reference", "middle", "front"))
    case = Case(
        name=name,
        title=take_text(entry, "title", where),
        source=take_text(entry, "source", where),
        kind=kind,
        vru=vru,
        vru_speed_kmh=_take_positive(entry, "vru_speed_kmh", where),
        vut_speeds_kmh=(),
        speed_limits_kmh=(low, high),
        impact_percent=take_number(entry, "impact_percent", where),
        impact_face=_take_word({"impact_face": "front", **entry}, "impact_face", where, _FACES),
        vru_reference_m={
            "reference": vru.reference_ahead_m,
            "middle": 0.0,
            "front": 0.5 * vru.length_m,
        }[reference],
        acceleration_distance_m=_take_positive(entry, "acceleration_distance_m", where),
        start_distance_m=_take_optional(entry, "start_distance_m", where),
        steady_distance_m=_take_optional(entry, "steady_distance_m", where),
        vru_side=_take_word(entry, "vru_from", where, SIDES) if kind == "crossing" else "",
        turn=_take_word(entry, "turn", where, SIDES) if is_turning else "",
        vru_direction=(
            _take_word(entry, "vru_direction", where, ("same", "opposite")) if is_turning else ""
        ),
        vru_line=None if kind == "longitudinal" else _build_line(entry, where),
        obstruction=_build_obstruction(entry, where) if "obstruction" in entry else None,
    )
    if not 0.0 <= case.impact_percent <= 100.0:
        raise InputError(f"{where}.impact_percent", case.impact_percent, "0 to 100")
    return _with_speeds(case, entry["vut_speed_kmh"], where)


_FACES = ("front", "side")


def _with_speeds(case: Case, entry: Table, where: str) -> Case:
    """The case at the speeds of a table with min, max and step; an empty one changes nothing."""
    if not entry:
        return case
    low, high, step = _take_speeds({"vut_speed_kmh": entry}, where)
    return replace(case, vut_speeds_kmh=tuple(np.arange(low, high + 0.5 * step, step).tolist()))


def _take_speeds(entry: Table, where: str) -> tuple[float, float, float]:
    speeds = take(entry, "vut_speed_kmh", where)
    here = f"{where}.vut_speed_kmh"
    if not isinstance(speeds, Mapping):
        raise InputError(here, speeds, "a table with min, max and step")
    low, high, step = (take_number(speeds, key, here) for key in ("min", "max", "step"))
    if not (0.0 < low <= high and step > 0.0):
        raise InputError(here, dict(speeds), "0 < min <= max, step > 0")
    return low, high, step


def _build_line(entry: Table, where: str) -> VruLine:
    line, here = take(entry, "vru_line", where), f"{where}.vru_line"
    along = _take_word(line, "along", here, _LINES)
    if along == "lane":
        return VruLine(
            along=along,
            lane=_take_word(line, "lane", here, ("inner", "outer")),
            left_m=take_number(line, "left_of_lane_centre_m", here),
        )
    return VruLine(
        along=along, left_m=take_number(line, "outside_kerb_m", here) if along == "kerb" else 0.0
    )


def _build_obstruction(entry: Table, where: str) -> Obstruction:
    table, here = entry["obstruction"], f"{where}.obstruction"
    kind = _take_word(table, "kind", here, _OBSTRUCTIONS)
    is_wall = kind == "wall"
    names = [] if is_wall else take_list(table, "bodies", here)
    return Obstruction(
        kind=kind,
        bodies=tuple(pick_actor(name, f"{here}.bodies[{i}]") for i, name in enumerate(names)),
        first_gap_m=take_number(table, "first_gap_m", here),
        between_gap_m=0.0 if is_wall else take_number(table, "between_gap_m", here),
        side_gap_m=take_number(table, "side_gap_m", here),
        wall_size_m=tuple(
            _take_positive(table, f"{size}_m", here)
            for size in (("length", "thickness", "height") if is_wall else ())
        ),
    )


def _take_word(entry: Table, key: str, where: str, known: tuple[str, ...]) -> str:
    word = take_text(entry, key, where)
    if word not in known:
        raise InputError(f"{where}.{key}", word, "one of " + ", ".join(known))
    return word


def _take_positive(entry: Table, key: str, where: str) -> float:
    value = take_number(entry, key, where)
    if value <= 0.0:
        raise InputError(f"{where}.{key}", value, "a number, more than 0")
    return value


def _take_optional(entry: Table, key: str, where: str) -> float | None:
    return _take_positive(entry, key, where) if key in entry else None


# ---------- cases and speeds in the words of a user


_HIGHEST_KMH = 250.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Cases to drive.

    Attributes
    ----------
    cases : tuple of Case
        Each with the speeds to be driven.
    left_out : tuple of Case
        Cases none of whose speeds were asked for; with the speeds that they have.
    beyond : tuple of str
        "case: speeds" outside of what the protocol drives, which were forced.
    """

    cases: tuple[Case, ...]
    left_out: tuple[Case, ...]
    beyond: tuple[str, ...]


def select_cases(cases: str, *, speeds: str | None = None, force: bool = False) -> Selection:
    """Cases and speeds by the words of a user.

    `cases` is as for :func:`pick_cases`; `speeds` are km/h with commas between, or ranges: "20-40"
    is every speed of the case in it. `force` drives speeds that the protocol does not.

    Raises
    ------
    InputError
        A name or a speed cannot be read, or a speed lies outside of every case.

    Examples
    --------
    >>> select_cases("CPNA-25", speeds="20,30-40").cases
    (Case('CPNA-25', 20, 30, 35, 40 km/h),)
    """
    picked = pick_cases(cases, "--cases")
    if speeds is None:
        return Selection(cases=picked, left_out=(), beyond=())
    singles, ranges = _read_speeds(speeds)
    if not force:
        for speed in singles:
            if not any(_is_within(speed, case) for case in picked):
                raise InputError("--speeds", Unquoted(f"{speed:g}"), _limits(picked))
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
        raise InputError("--speeds", speeds, _limits(picked))
    return Selection(cases=tuple(kept), left_out=tuple(left_out), beyond=tuple(beyond))


def _read_speeds(text: str) -> tuple[list[float], list[tuple[float, float]]]:
    singles, ranges = [], []
    for word in (part.strip() for part in text.split(",")):
        low, dash, high = word.partition("-")
        numbers = [_read_speed(part) for part in ([low, high] if dash else [low])]
        if any(number is None for number in numbers):
            raise InputError(
                "--speeds",
                word,
                f"km/h with commas between, such as 20,30 or 20-40, up to {_HIGHEST_KMH:g}",
            )
        found = [number for number in numbers if number is not None]
        if len(found) == 1:
            singles.append(found[0])
        elif found[0] > found[1]:
            raise InputError("--speeds", word, "the lower speed first")
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
    return f"{low:g} to {high:g} km/h as the protocol drives these cases, or --force"
