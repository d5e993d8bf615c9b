"""Files: TOML read with the place of every problem, results written whole or not at all."""

import os
import sys
import tempfile
import tomllib
from collections.abc import Callable, Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, BinaryIO

from .errors import InputError, Unquoted

# ---------- reading TOML: every problem names the file, the field and what is expected


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


# ---------- files that are there whole or not at all


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file under a temporary name beside it and move it into place.

    Parameters
    ----------
    path : Path
        The file; its folder must exist.
    write : callable
        Gets the open temporary file. Whatever it raises leaves `path` as it was.

    Raises
    ------
    OSError
        The folder is missing or cannot be written to.
    """
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            write(file)
        # mkstemp makes files private; a result is as readable as any other new file.
        mask = os.umask(0)
        os.umask(mask)
        Path(temporary).chmod(0o666 & ~mask)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
