"""Reading TOML: every problem names the file, the field and what is expected."""

import sys
import tomllib
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from .errors import InputError, Unquoted

Table = Mapping[str, Any]


def load_toml(source: Path | Traversable) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    source : Path or Traversable
        A file, or a data file of a package.

    Returns
    -------
    table : dict
        The whole document.

    Raises
    ------
    InputError
        The file cannot be read, or is not TOML.
    """
    try:
        return tomllib.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            str(source), Unquoted(error.strerror or error), "a readable file"
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(str(source), Unquoted(error), "valid TOML in UTF-8") from None


def take(table: Table, key: str, where: str) -> Any:
    """Value of a key that must be there.

    Raises
    ------
    InputError
        The key is missing.
    """
    if key not in table:
        raise InputError(f"{where}.{key}", Unquoted("nothing"), "a value")
    return table[key]


def take_number(table: Table, key: str, where: str) -> float:
    """Finite number of a key that must be there."""
    value = take(table, key, where)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and abs(value) <= sys.float_info.max):
        raise InputError(f"{where}.{key}", value, "a finite number")
    return float(value)


def take_text(table: Table, key: str, where: str) -> str:
    """Text of a key that must be there."""
    value = take(table, key, where)
    if not isinstance(value, str) or not value:
        raise InputError(f"{where}.{key}", value, "text")
    return value


def take_list(table: Table, key: str, where: str) -> list[Any]:
    """List of a key that must be there."""
    value = take(table, key, where)
    if not isinstance(value, list):
        raise InputError(f"{where}.{key}", value, "a list")
    return value


def pick(known: Mapping[str, Any], name: str, where: str) -> Any:
    """Look a name up; an unknown one lists the known ones.

    Raises
    ------
    InputError
        The name is unknown.
    """
    if name not in known:
        raise InputError(where, name, "one of " + ", ".join(sorted(known)))
    return known[name]
