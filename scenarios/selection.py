"""What is driven, in the words of a user: cases, speeds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from geometry.errors import InputError, Unquoted

from .cases import Case, pick_cases

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

    Parameters
    ----------
    cases : str
        See :func:`scenarios.cases.pick_cases`.
    speeds : str, optional
        Speeds with commas between, or ranges: "20-40" is every speed of the case in it. [km/h]
    force : bool
        Drive speeds that the protocol does not.

    Returns
    -------
    selection : Selection
        At least one case.

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
