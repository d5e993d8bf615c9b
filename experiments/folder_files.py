"""Files that a command adds to a folder; what else the folder holds stays."""

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

from geometry.atomic_files import write_atomically
from geometry.errors import InputError, Unquoted


def check_folder(folder: Path) -> None:
    """Find out before anything is computed whether a folder is there, or can be made.

    Raises
    ------
    InputError
        It cannot be written to.
    """
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    try:
        with tempfile.TemporaryDirectory(prefix=".place-rsus.", dir=existing):
            pass
    except OSError as error:
        raise _unwritable(folder, error) from None


def write_files(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files by name, each whole or not at all.

    Raises
    ------
    InputError
        The folder cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            write_atomically(folder / name, _writer(content))
    except OSError as error:
        raise _unwritable(folder, error) from None


def _writer(content: bytes) -> Callable[[BinaryIO], object]:
    return lambda file: file.write(content)


def _unwritable(folder: Path, error: OSError) -> InputError:
    what = Unquoted(f"{folder}: {error.strerror or error}")
    return InputError("--out", what, "a folder that can be written to")
