"""Speed limits of roads from their tags."""

import re

from .elements import DEFAULTS, Tags

_KMH_PER_MPH = 1.609344
_SPEED = re.compile(r"(\d{1,3}(?:[.,]\d{1,3})?)\s*(mph|km/h|kmh|kph)?")
_ZONE = re.compile(r"[a-z]{2}:(?:zone:?)?(\d{1,3})")


def speed_limit_kmh(tags: Tags, *, is_forward: bool) -> float | None:
    """Speed limit of a direction of a road in km/h; None: the tags give none, or no number.

    Limits that hold at times, for some vehicles or lanes are not looked at.

    Examples
    --------
    >>> [speed_limit_kmh({"maxspeed": text}, is_forward=True) for text in ("50", "30 mph", "none")]
    [50.0, 48.3, None]
    >>> speed_limit_kmh({"maxspeed": "50", "maxspeed:backward": "FR:zone30"}, is_forward=False)
    30.0
    """
    side = "forward" if is_forward else "backward"
    for key in (f"maxspeed:{side}", "maxspeed", *DEFAULTS["speed_limits"]["type_keys"]):
        text = tags.get(key, "").strip().lower()
        speed_kmh = _speed_kmh(text)
        if speed_kmh is not None or text == "none":
            return speed_kmh
    return None


def _speed_kmh(text: str) -> float | None:
    words: dict[str, float] = DEFAULTS["speed_limits"]["words_kmh"]
    if text in words:
        return words[text]
    if match := _ZONE.fullmatch(text):
        speed_kmh = float(match[1])
    elif match := _SPEED.fullmatch(text):
        speed_kmh = float(match[1].replace(",", ".")) * (_KMH_PER_MPH if match[2] == "mph" else 1.0)
    else:
        return None
    return round(speed_kmh, 1) if speed_kmh > 0.0 else None
