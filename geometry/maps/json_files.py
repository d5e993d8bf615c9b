"""JSON from anywhere, read without its traps: endless files, nesting without end."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError, Unquoted
from .xml_files import check_size

_MAX_BYTES = 300_000_000

_Table = Mapping[str, Any]


def read_text(path: Path, expected: str) -> str:
    """Text of a file in UTF-8.

    Raises
    ------
    InputError
        It cannot be read, is too large, or is no UTF-8.
    """
    try:
        check_size(path, _MAX_BYTES)
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(str(path), Unquoted(error.strerror or error), "a readable file") from None
    except UnicodeDecodeError as error:
        raise InputError(str(path), Unquoted(error), f"{expected} in UTF-8") from None


def parse_json(text: str, where: str, expected: str) -> _Table:
    """A JSON object.

    Raises
    ------
    InputError
        It is none, or is nested too deeply.
    """
    try:
        document = json.loads(text)
    except RecursionError:
        raise InputError(where, Unquoted("JSON nested too deeply"), expected) from None
    except ValueError as error:
        raise InputError(where, Unquoted(error), f"{expected}: valid JSON") from None
    if not isinstance(document, dict):
        raise InputError(where, Unquoted(type(document).__name__), f"{expected}: an object")
    return document
