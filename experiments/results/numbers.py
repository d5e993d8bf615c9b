"""Numbers and counts as results print them.

On a terminal and in the report alike.
"""

import math
from collections.abc import Hashable, Iterable, Sequence
from typing import TypeVar

from placement.question import BASELINE_NAME

from ..language import localized, tr, trn

_K = TypeVar("_K", bound=Hashable)
_V = TypeVar("_V")
NOTHING = "\N{EN DASH}"
"""Stands where there is no number."""


def percent(share: float | None) -> str:
    """A share of 1 in print, with one digit.

    What is not quite all or none is never shown as it.

    None and NaN (no run counts) are shown as a dash.

    Examples
    --------
    >>> percent(0.5), percent(0.99999), percent(0.00001)
    ('50.0 %', '>99.9 %', '<0.1 %')
    """
    if share is None or math.isnan(share):
        return NOTHING
    if 0.9995 <= share < 1.0 - 1.0e-9:
        return localized(">99.9 %")
    if 1.0e-9 < share < 0.0005:
        return localized("<0.1 %")
    return localized(f"{100.0 * share:.1f} %")


def cars_words(cars: float) -> str:
    """How many of the cars see, behind a comma; nothing where none does.

    Examples
    --------
    >>> cars_words(1.0), cars_words(0.3), cars_words(0.0)
    (', cars with own sensors', ', 30.0 % of the cars with own sensors', '')
    """
    if not cars:
        return ""
    if cars == 1.0:
        return tr(", cars with own sensors")
    return tr(", {share} of the cars with own sensors", share=percent(cars))


def points(share: float) -> str:
    """A difference of shares of 1 in points of percent.

    Examples
    --------
    >>> points(0.022), points(0.01)
    ('2.2 points', '1 point')
    """
    shown = round(100.0 * share, 1) + 0.0
    if shown == 1.0:
        return tr("1 point")
    return tr("{n} points", n=number(shown, 1))


def in_points(share: float | None) -> str:
    """A difference of shares of 1 as a number of points, for tables.

    A dash where there is none.
    """
    return number(100.0 * or_nan(share), 1)


def number(value: float | None, digits: int = 2) -> str:
    """A number with a typographic minus; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return NOTHING
    # Adding zero turns -0.0 into 0.0.
    text = f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}")
    return localized(text)


def euros(amount: float | None) -> str:
    """An amount of money to the euro; None: nobody knows it.

    Examples
    --------
    >>> euros(4500.0), euros(None)
    ('4,500 EUR', 'unknown')
    """
    if amount is None:
        return tr("unknown")
    return tr("{amount:,.0f} EUR", amount=amount)


def finite_or_none(value: float) -> float | None:
    """A number as records have it: None in place of an infinity."""
    if math.isfinite(value):
        return value
    return None


def or_nan(value: float | None) -> float:
    """A number as records have it: NaN where there is none."""
    if value is None:
        return math.nan
    return value


def milliseconds(time_s: float) -> str:
    """A time in seconds as whole milliseconds, with the unit."""
    return f"{number(1000.0 * time_s, 0)}\N{NO-BREAK SPACE}ms"


def several(count: int, one: str, many: str) -> str:
    """A count with its noun: several(2, "unit", "units") is "2 units"."""
    return f"{count} {one if count == 1 else many}"


def count_runs(n_runs: int) -> str:
    """'1 run', '2 runs' and so on."""
    return trn("{n} run", "{n} runs", n_runs)


def sensor_words(n_cameras: int, n_lidars: int) -> str:
    """'1 camera', '2 cameras and 1 LiDAR' and so on; empty for none."""
    cameras = trn("{n} camera", "{n} cameras", n_cameras)
    lidars = trn("{n} LiDAR", "{n} LiDARs", n_lidars)
    found = [words for n, words in ((n_cameras, cameras), (n_lidars, lidars)) if n]
    if found:
        return joined(found)
    return ""


def grouped(pairs: Iterable[tuple[_K, _V]]) -> dict[_K, list[_V]]:
    """Values by their keys, both in the order in which they come.

    Examples
    --------
    >>> grouped([("b", 1), ("a", 2), ("b", 3)])
    {'b': [1, 3], 'a': [2]}
    """
    found: dict[_K, list[_V]] = {}
    for key, value in pairs:
        found.setdefault(key, []).append(value)
    return found


def joined(words: Iterable[str]) -> str:
    """Words as a list in a sentence: "a", "a and b", "a, b and c"."""
    *first, last = words
    if first:
        return tr("{first} and {last}", first=", ".join(first), last=last)
    return last


def capital(text: str) -> str:
    """A text as a sentence begins."""
    return f"{text[:1].upper()}{text[1:]}"


def first_of(words: Sequence[str], most: int) -> str:
    """The first words of a list with commas, and how many more there are."""
    listed = ", ".join(words[:most])
    n_left = len(words) - most
    if n_left > 0:
        return tr("{listed} and {n} more", listed=listed, n=n_left)
    return listed


def layout_words(name: str) -> str:
    """A layout's name for people.

    The name of its file stands behind it where that is a code.

    Examples
    --------
    >>> layout_words("best-3"), layout_words("mine")
    ('the 3 found (best-3)', 'mine')
    """
    if name == BASELINE_NAME:
        return tr("the study's 12 cameras ({name})", name=name)
    count = name.removeprefix("best-")
    if count != name and count.isdecimal():
        return trn(
            "the one found ({name})", "the {n} found ({name})", int(count), name=name
        )
    return tr(name)


def shortened(text: str, width: int) -> str:
    """A text of at most so many letters; a longer one ends in an ellipsis."""
    if len(text) <= width:
        return text
    return text[: width - 1] + "\N{HORIZONTAL ELLIPSIS}"
