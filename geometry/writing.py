"""Write results whole or not at all, and only in place of regular files."""

import errno
import glob
import os
import stat
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from .errors import refuse
from .locks import is_abandoned, lock_while_alive
from .opening import kind_of

# What the system says of connections and processes, not of files.
_OF_NO_FILE = (ConnectionError, TimeoutError, ChildProcessError, BlockingIOError)


def open_new(path: Path) -> BinaryIO:
    """Create a file for writing in a folder of this program's own.

    Raises
    ------
    OSError
        The file is there already.
    """
    return path.open("xb")


def write_new(path: Path, text: str) -> None:
    """Write the text of a file that is not there yet, see :func:`open_new`."""
    with open_new(path) as file:
        file.write(text.encode())


def check_target(path: Path) -> None:
    """Raise InputError if a name belongs to anything but a regular file.

    A regular file is replaced.
    """
    if what := _obstacle(path):
        refuse(str(path), what, "a regular file's name, or one that is free")


def _obstacle(path: Path) -> str:
    """Kind of what has a name already, if it is in the way.

    Empty for a regular file, for a folder and for a free name.
    """
    try:
        mode = path.lstat().st_mode
    except (OSError, ValueError):
        return ""
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):
        return ""
    if stat.S_ISLNK(mode):
        with suppress(OSError):
            return f"a link to {path.readlink()}"
    return kind_of(mode)


def write_atomically(
    path: Path,
    content: bytes | str | Callable[[BinaryIO], object],
    *,
    is_private: bool = False,
) -> None:
    """Write a file whole or not at all, under its name in a folder.

    The content goes to a temporary file in the same folder, which must exist;
    that file is then moved into place.

    Temporary files that a killed process left are removed. A callable writes the
    content to an open file; whatever it raises leaves `path` as it was. A private
    file is for this user alone.

    Raises
    ------
    OSError
        Something is in the way, see :func:`check_target`, or the system says
        no.
    """
    if what := _obstacle(path):
        raise FileExistsError(errno.EEXIST, f"{what}, no regular file", str(path))
    # Of processes that were killed.
    for left in path.parent.glob(f".{glob.escape(path.name)}.*.tmp"):
        if is_abandoned(left):
            left.unlink(missing_ok=True)
    handle, temporary = tempfile.mkstemp(
        prefix=f".{path.name}.", suffix=".tmp", dir=path.parent
    )
    try:
        with os.fdopen(handle, "wb") as file, lock_while_alive(Path(temporary)):
            if callable(content):
                content(file)
            else:
                file.write(content.encode() if isinstance(content, str) else content)
        if not is_private:
            # As mkstemp makes files; a result is as readable as any other new file.
            mask = os.umask(0)
            os.umask(mask)
            Path(temporary).chmod(0o666 & ~mask)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def is_about(error: OSError, *paths: Path) -> bool:
    """True if an error of the system is about some paths.

    Counted are the paths, what lies in them, folders above them, and the temporary
    files of :func:`write_atomically` next to them. An error that names no file counts,
    too, for writing to an open file names none; but not one of a connection, pipe or
    process.
    """
    if error.filename is None:
        return not isinstance(error, _OF_NO_FILE)
    # An open file's number.
    if isinstance(error.filename, int):
        return False
    named = Path(os.fsdecode(error.filename)).absolute()
    whole = [path.absolute() for path in paths]
    if any(named.is_relative_to(path) or path.is_relative_to(named) for path in whole):
        return True
    return any(
        named.parent == path.parent and named.name.startswith(f".{path.name}.")
        for path in whole
    )
