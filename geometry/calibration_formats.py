"""Calibration files that are not read: what they are, and what of them would do."""

import re
from functools import cache
from pathlib import Path

from msgspec import Struct

from .errors import refuse
from .tables import read_data

# Of a text in which a format is looked for.
_MAX_CHARACTERS = 20_000


class _UnreadFormat(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    name: str
    instead: str
    pattern: str = ""
    suffixes: tuple[str, ...] = ()


class _UnreadFormats(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    formats: tuple[_UnreadFormat, ...]


@cache
def _formats() -> tuple[_UnreadFormat, ...]:
    """Formats of ``data/calibration_formats.toml``."""
    return read_data(__package__, "calibration_formats.toml", _UnreadFormats).formats


def refuse_unread_calibration(text: str, path: Path | str) -> None:
    """Raise InputError if a text is a calibration of a known format that is not read.

    The message says which one it is, and what of it would do.
    """
    shown = text[:_MAX_CHARACTERS]
    for one in _formats():
        if one.pattern and re.search(one.pattern, shown):
            refuse(str(path), one.name, _instead(one))


def refuse_unread_suffix(path: Path) -> None:
    """Raise InputError if the suffix is that of binary files with calibrations."""
    for one in _formats():
        if path.suffix.lower() in one.suffixes:
            refuse(str(path), one.name, _instead(one))


def _instead(one: _UnreadFormat) -> str:
    """What would do in the place of a format."""
    return f"a calibration in YAML of OpenCV or ROS; of this one {one.instead.strip()}"
