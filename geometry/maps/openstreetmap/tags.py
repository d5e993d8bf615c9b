"""Numbers and sides out of tags, as people write them."""

import re

from .elements import Tags

_FOOT_M = 0.3048
_INCH_M = 0.0254
_UNITS_M = {
    "": 1.0,
    "m": 1.0,
    "metre": 1.0,
    "metres": 1.0,
    "meter": 1.0,
    "meters": 1.0,
    "cm": 0.01,
    "km": 1000.0,
    "ft": _FOOT_M,
    "foot": _FOOT_M,
    "feet": _FOOT_M,
    "'": _FOOT_M,
    "in": _INCH_M,
    "inch": _INCH_M,
    "inches": _INCH_M,
    '"': _INCH_M,
}
_NUMBER = r"([0-9]{1,7}(?:[.,][0-9]{1,9})?)"
_LENGTH = re.compile(rf"{_NUMBER}\s*([a-z]*|'|\")\.?")
_FEET_AND_INCHES = re.compile(rf"([0-9]{{1,6}})\s*(?:'|ft|feet)\s*{_NUMBER}\s*(?:\"|''|in|inches)?")
_RANGE = re.compile(rf"{_NUMBER}\s*(?:-|\.\.|;|to)\s*{_NUMBER}\s*([a-z]*)")
_OPPOSITE = {"left": "right", "right": "left", "forward": "backward", "backward": "forward"}


def parse_length_m(text: str) -> float | None:
    r"""A length as people write it, with decimal commas, units or ranges (their middle), or None.

    Examples
    --------
    >>> [parse_length_m(text) for text in ("3,5", "12 ft", "3-4 m", "wide")]
    [3.5, 3.6576000000000004, 3.5, None]
    >>> round(parse_length_m("6'7\""), 4)
    2.0066
    """
    text = text.strip().lower().removeprefix("~").strip()
    if match := _LENGTH.fullmatch(text):
        number, unit = match.groups()
        if unit not in _UNITS_M:
            return None
        return _number(number) * _UNITS_M[unit]
    if match := _FEET_AND_INCHES.fullmatch(text):
        feet, inches = match.groups()
        return _number(feet) * _FOOT_M + _number(inches) * _INCH_M
    if match := _RANGE.fullmatch(text):
        low, high, unit = match.groups()
        if unit not in _UNITS_M:
            return None
        return 0.5 * (_number(low) + _number(high)) * _UNITS_M[unit]
    return None


def _number(text: str) -> float:
    return float(text.replace(",", "."))


def parse_count(text: str, *, highest: int) -> int | None:
    """A whole number from 1 to `highest`, or None."""
    text = text.strip()
    if not re.fullmatch(r"[0-9]{1,6}(\.0+)?", text):
        return None
    number = int(float(text))
    return number if 1 <= number <= highest else None


def parse_number(text: str, *, highest: float) -> float | None:
    """A number from 0 to `highest`, or None."""
    text = text.strip().replace(",", ".")
    if not re.fullmatch(r"[0-9]{1,6}(\.[0-9]{1,9})?", text):
        return None
    number = float(text)
    return number if number <= highest else None


def is_yes(text: str | None) -> bool:
    """A tag that is there and does not say no."""
    return text is not None and text.strip().lower() not in ("", "no", "0", "false", "none")


def side_value(tags: Tags, key: str, side: str) -> str | None:
    """Value of a tag for one side: ``key:side``, or else ``key:both``."""
    return tags.get(f"{key}:{side}", tags.get(f"{key}:both"))


def turned_round(tags: Tags) -> Tags:
    """Tags of the same line with its nodes in the opposite order.

    Examples
    --------
    >>> turned_round({"sidewalk": "left", "lanes:forward": "2"})
    {'sidewalk': 'right', 'lanes:backward': '2'}
    """
    return {
        ":".join(_OPPOSITE.get(word, word) for word in key.split(":")): (
            _OPPOSITE.get(value, value) if key == "sidewalk" else value
        )
        for key, value in tags.items()
    }
