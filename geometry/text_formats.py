"""Read TOML, JSON and CSV into plain values, and words of them into numbers."""

import json
import math
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from .errors import InputError, Unquoted, refuse
from .opening import read_text

# Python's reader takes half a second per million.
MAX_TOML_BYTES = 20_000_000


def load_toml(source: Path | Traversable) -> dict[str, Any]:
    """Read a TOML file, or a data file of a package, as a whole.

    Raises
    ------
    InputError
        The file cannot be read, is larger than 20 MB, or is not TOML.
    """
    if isinstance(source, Path):
        text = read_text(source, "valid TOML", max_bytes=MAX_TOML_BYTES)
    else:
        text = source.read_text(encoding="utf-8")
    return parse_toml(text, str(source))


def load_data(package: str, name: str) -> dict[str, Any]:
    """Tables of a file in the folder ``data`` of one of this program's packages."""
    return load_toml(files(package) / "data" / name)


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Read TOML from a text.

    Raises
    ------
    InputError
        The text is not valid TOML; the message names `where`.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(
            where, Unquoted("tables nested too deeply"), "valid TOML"
        ) from None
    except ValueError as error:
        # Also that of a number with thousands of digits.
        raise InputError(where, Unquoted(error), "valid TOML in UTF-8") from None


class _RepeatedKeyError(ValueError):
    """An object of a JSON text has a key twice."""


def parse_json(text: str | bytes, where: str, what: str) -> Any:
    """JSON as plain values; the only reader of JSON that others have written.

    An object with a key twice is refused: programs differ in which of the two values
    they take, so that such a file says one thing to the program that checks it and
    another to the next one.

    Parameters
    ----------
    text : str or bytes
        The whole document; bytes are UTF-8.
    where : str
        The file, for messages.
    what : str
        What is expected, for the message about JSON that is nested too deep.

    Raises
    ------
    InputError
        The text is no JSON in UTF-8, is nested too deep, or has a key twice.
    """
    try:
        if isinstance(text, bytes):
            text = text.decode("utf-8-sig")
        return json.loads(text, object_pairs_hook=_object_of)
    except RecursionError:
        raise InputError(where, Unquoted("JSON nested too deep"), what) from None
    except _RepeatedKeyError as error:
        raise InputError(
            where, Unquoted(error), "every key of an object once"
        ) from None
    except ValueError as error:
        # No JSON, no UTF-8, or a number of thousands of digits.
        raise InputError(where, Unquoted(error), "JSON in UTF-8") from None


def _object_of(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of its keys and values.

    Raises
    ------
    _RepeatedKeyError
        It has a key twice.
    """
    # A repeated key makes the dictionary smaller than the list of pairs.
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        for key, _ in pairs:
            if key in seen:
                raise _RepeatedKeyError(f"the key {json.dumps(key[:60])} twice")
            seen.add(key)
    return found


def parse_object(text: str, where: str, expected: str) -> Mapping[str, Any]:
    """Parse a JSON object; raises InputError if it is none, or is nested too deeply."""
    try:
        document = parse_json(text, where, expected)
    except InputError as error:
        raise InputError(where, error.got, f"{expected}: valid JSON") from None
    if not isinstance(document, dict):
        refuse(where, type(document).__name__, f"{expected}: an object")
    return document


def float_of(value: Any) -> float:
    """The number that a value or a word is; NaN if it is none."""
    try:
        if isinstance(value, bool):
            return math.nan
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def parse_number(
    word: str, where: str, *, least: float = -math.inf, most: float = math.inf
) -> float:
    """The finite number that a word of a file is.

    `where` is the word's file, line and field.

    Raises
    ------
    InputError
        The word is no finite number, or outside `least` .. `most`.
    """
    # float() would also take 1_0 and other scripts' digits.
    if word.isascii() and "_" not in word:
        value = float_of(word)
    else:
        value = math.nan
    if not (math.isfinite(value) and least <= value <= most):
        if least == -math.inf:
            limits = ""
        else:
            limits = f", at least {least:g}"
        if most != math.inf:
            limits = f", {least:g} .. {most:g}"
        raise InputError(where, word, f"a finite number{limits}")
    return value
