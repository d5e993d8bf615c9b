"""Positions along the arms of a junction where encounters are laid.

The module also says which speeds are driven there.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated

from msgspec import Meta, Struct

from geometry.errors import InputError, Unquoted
from geometry.tables import read_data
from geometry.text_formats import float_of

from .cases import Case


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """A place along the VUT's way.

    Attributes
    ----------
    is_behind : bool
        On the arm straight ahead, by which the VUT leaves the junction; else on the arm
        from which it comes.
    distance_m : float
        How far before the place of the protocol, or beyond the crosswalk of the arm
        ahead. [m]
    """

    is_behind: bool = False
    distance_m: float = 0.0

    @property
    def name(self) -> str:
        """Such as "0", "-15", "+0", "+15"."""
        if not self.is_behind and self.distance_m == 0.0:
            return "0"
        return f"{'+' if self.is_behind else '-'}{self.distance_m:g}"

    @property
    def ahead_m(self) -> float:
        """Distance of the place ahead of where that arm is crossed, in metres.

        It counts in driving direction.
        """
        if self.is_behind:
            return self.distance_m
        return -self.distance_m


AT_ZERO = Position()
"""The place of the protocol.

There the VUT's way meets the crosswalk of the arm it comes from.
"""


# ---------- rules
_Metres = Annotated[float, Meta(ge=0.0)]


class PositionRules(Struct, frozen=True, kw_only=True):
    """``data/positions.toml``; its comments say what each is."""

    default_m: tuple[_Metres, ...]
    max_distance_m: _Metres
    max_distances: int
    sets_at_zero: tuple[str, ...]
    every_nth_speed: Annotated[int, Meta(ge=1)]


@cache
def load_position_rules() -> PositionRules:
    """Rules of positions."""
    return read_data(__package__, "positions.toml", PositionRules)


def is_study_set(cases: str) -> bool:
    """True if a user's words name only sets driven at position 0 alone."""
    words = {word.strip() for word in cases.split(",")}
    return words <= set(load_position_rules().sets_at_zero)


# ---------- positions in the words of a user
def read_along_arms(text: str, where: str) -> tuple[float, ...]:
    """Distances along the arms, in metres, by the words of a user.

    Raises
    ------
    InputError
        A word is no distance, or one is given twice; there is none, or there
        are too many.

    Examples
    --------
    >>> read_along_arms("0, 15,30", "along_arms")
    (0.0, 15.0, 30.0)
    """
    rules = load_position_rules()
    expected = (
        f"metres along the arm, 0 to {rules.max_distance_m:g}, with commas between,"
        " such as 0,15,30"
    )
    words = [word.strip() for word in text.split(",")]
    if len(words) > (most := rules.max_distances):
        raise InputError(where, Unquoted(f"{len(words)} distances"), f"at most {most}")
    distances: list[float] = []
    for word in words:
        distance_m = float_of(word)
        if not 0.0 <= distance_m <= rules.max_distance_m or word.startswith("-"):
            raise InputError(where, word, expected)
        if f"{distance_m:g}" in {f"{other_m:g}" for other_m in distances}:
            raise InputError(
                where, text, f"every distance once, and {distance_m:g} is there twice"
            )
        distances.append(distance_m)
    return tuple(distances)


def build_positions(distances_m: Sequence[float]) -> tuple[Position, ...]:
    """Positions at distances along the arms.

    Each distance is a position before the place of the protocol and one behind the
    junction; 0 is that place, and where other distances are asked for, the crosswalk of
    the arm ahead, too.

    >>> [position.name for position in build_positions([0.0])]
    ['0']
    >>> [position.name for position in build_positions([0.0, 15.0])]
    ['0', '-15', '+0', '+15']
    """
    # Those before the junction come first, as the VUT passes them.
    before = [Position(distance_m=distance_m) for distance_m in distances_m]
    behind = [
        Position(is_behind=True, distance_m=distance_m) for distance_m in distances_m
    ]
    return tuple(before if tuple(distances_m) == (0.0,) else before + behind)


def pick_positions(along_arms: str, cases: str) -> tuple[Position, ...]:
    """Positions by the words of a user.

    They are those of `along_arms` if it says something, else those of the
    `cases`.
    """
    if along_arms.strip():
        return build_positions(read_along_arms(along_arms, "along_arms"))
    if is_study_set(cases):
        return (AT_ZERO,)
    return build_positions(load_position_rules().default_m)


def read_position(text: str, where: str) -> Position:
    """A single position by its name; raises InputError if it is none.

    >>> read_position("-15", "position")
    Position(is_behind=False, distance_m=15.0)
    """
    if text[:1] in ("-", "+"):
        sign = text[:1]
    else:
        sign = ""
    try:
        (distance_m,) = read_along_arms(text[len(sign) :], where)
    except (InputError, ValueError):
        distance_m = math.nan
    if not (sign or distance_m == 0.0) or not math.isfinite(distance_m):
        expected = (
            "0, or metres before it such as -15, or beyond the crosswalk of the arm"
            f" ahead such as +0 or +15, up to {load_position_rules().max_distance_m:g}"
        )
        raise InputError(where, text, expected)
    return Position(is_behind=sign == "+", distance_m=distance_m)


def sort_positions(names: Iterable[str]) -> list[str]:
    """Names of positions, each once, as the VUT passes them.

    >>> sort_positions(["0", "+15", "-15", "+0", "-30", "0"])
    ['-30', '-15', '0', '+0', '+15']
    """

    def order(name: str) -> tuple[bool, float]:
        position = read_position(name, "position")
        return position.is_behind, position.ahead_m

    return sorted(set(names), key=order)


# ---------- positions of cases
def is_bound(case: Case) -> bool:
    """True if a case can happen at the junction alone.

    The VUT turns, or the VRU's road is there.

    All others - people who cross the VUT's lane, those who move ahead in it - may
    happen anywhere along an arm.
    """
    if case.kind in ("turning", "recorded"):
        return True
    return case.vru_line is not None and case.vru_line.along != "crosswalk"


def positions_of(case: Case, positions: Sequence[Position]) -> tuple[Position, ...]:
    """Where a case is laid: cases that are bound to the junction have one place."""
    if is_bound(case):
        return (AT_ZERO,)
    return tuple(positions)


def spread_speeds(
    speeds_kmh: Sequence[float],
    position: Position,
    *,
    turn: int,
    impact_turn: tuple[int, int] = (0, 1),
) -> tuple[float, ...]:
    """The speeds that are driven at a position.

    All at position 0; elsewhere each n-th, beginning with another one from turn to
    turn. Where impact points take turns, each of these speeds is driven with one of
    them, another one from speed to speed and from round to round. `speeds_kmh`: of the
    case. `position`: where. `turn`: number of the approach plus number of the position.
    `impact_turn`: number of the case's impact point, and how many take turns.

    >>> spread_speeds((20.0, 25.0, 30.0, 35.0), Position(distance_m=15.0), turn=0)
    (20.0, 35.0)
    >>> spread_speeds((20.0, 25.0, 30.0, 35.0), AT_ZERO, turn=1, impact_turn=(0, 2))
    (25.0, 35.0)
    """
    if position == AT_ZERO:
        stride = 1
    else:
        stride = load_position_rules().every_nth_speed
    number, n_points = impact_turn
    return tuple(
        speed_kmh
        for index, speed_kmh in enumerate(speeds_kmh)
        if (index - turn) % stride == 0
        and (index + turn // stride) % n_points == number
    )
