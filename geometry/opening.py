"""Open users' files for reading, within limits of size.

Every file of a user's is opened here: a pipe or a device is refused before its
reader waits for it, and so is a file that is too large to be read as a whole. What
the system says becomes an InputError of one line.
"""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from .errors import InputError, Unquoted, refuse

# Of JSON or CSV that is read as a whole.
MAX_TEXT_BYTES = 300_000_000
# Of XML, meshes and maps, which are read piece by piece.
MAX_FILE_BYTES = 500_000_000


def check_file(path: Path, *, max_bytes: int | None = None) -> None:
    """Raise InputError unless a path is a regular file of a fair size.

    `max_bytes` is the most that may be read as a whole.

    A pipe or a device could keep its reader waiting for ever. A file that does not
    exist, or may not be looked at, is left to whoever opens it.
    """
    try:
        found = path.stat()
    except (OSError, ValueError):
        # ValueError: a zero byte in the name.
        return
    if not stat.S_ISDIR(found.st_mode):
        _check_found(found, str(path), max_bytes)


def _check_found(found: os.stat_result, where: str, max_bytes: int | None) -> None:
    """Raise InputError unless a status is that of a regular file."""
    if not stat.S_ISREG(found.st_mode):
        refuse(where, kind_of(found.st_mode), "a regular file")
    if max_bytes is not None and found.st_size > max_bytes:
        refuse(
            where,
            f"{found.st_size:,} bytes",
            f"at most {max_bytes:,}; cut it out first",
        )


def kind_of(mode: int) -> str:
    """What a path leads to, in words, by the mode that :func:`os.stat` gives."""
    kinds = {stat.S_IFDIR: "folder", stat.S_IFLNK: "link", stat.S_IFIFO: "pipe"}
    return "a " + (kinds | {stat.S_IFSOCK: "socket"}).get(stat.S_IFMT(mode), "device")


def open_file(path: Path, *, max_bytes: int | None = None) -> BinaryIO:
    """Open a regular file for reading.

    Raises
    ------
    InputError
        It is no regular file, is too large, or cannot be opened.
    """
    # To open a device may already do something.
    check_file(path, max_bytes=max_bytes)

    # Without waiting for who would write into a pipe.
    def at_once(name: str, flags: int) -> int:
        return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))

    try:
        # What was looked at may have been replaced since: the open file is looked at
        # again.
        file = open(path, "rb", opener=at_once)  # noqa: SIM115 - Path has no opener
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(str(path), Unquoted(reason), "a readable file") from None
    try:
        _check_found(os.fstat(file.fileno()), str(path), max_bytes)
    except InputError:
        file.close()
        raise
    return file


def read_bytes(path: Path, *, max_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """Content of a file; raises InputError as :func:`open_file` does."""
    with open_file(path, max_bytes=max_bytes) as file, reading(path):
        return file.read() or b""


@contextmanager
def reading(
    path: Path | str, expected: str = "", *damage: type[BaseException]
) -> Iterator[None]:
    """Raise InputError in place of errors of the system and of readers.

    `damage` are the exceptions that readers raise about damaged content;
    `expected` is what the message says then.
    """
    try:
        yield
    except InputError:
        raise
    except damage as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())[:200]
        raise InputError(
            str(path), Unquoted(reason or type(error).__name__), expected
        ) from None
    except OSError as error:
        raise InputError(
            str(path), Unquoted(error.strerror or error), "a readable file"
        ) from None


def read_text(path: Path, kind: str, *, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """Text of a UTF-8 file.

    `kind` is the kind of text that it holds, such as "JSON".

    Raises
    ------
    InputError
        As :func:`read_bytes`, or the text is not UTF-8.
    """
    try:
        return read_bytes(path, max_bytes=max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(str(path), Unquoted(error), f"{kind} in UTF-8") from None
