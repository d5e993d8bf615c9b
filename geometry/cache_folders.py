"""Folders and files of caches whose content is believed.

A cache is believed where nobody but this user or root can have written it.
"""

import atexit
import errno
import os
import shutil
import stat
import tempfile
from functools import cache
from pathlib import Path
from typing import BinaryIO


def user_cache_folder() -> Path:
    """The program's folder in the user's cache.

    A relative XDG_CACHE_HOME does not count.
    """
    from platformdirs import user_cache_path

    folder = user_cache_path("place-rsus")
    # As the XDG base directory specification demands.
    if folder.is_absolute():
        return folder
    return Path.home() / ".cache" / "place-rsus"


def trouble_with(folder: Path) -> str:
    """Make a folder where it is missing; say why it is not to be trusted.

    Empty if the folder can hold what is believed.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        return f"cannot be made ({error.strerror or error})"
    if not os.access(folder, os.W_OK | os.X_OK):
        return "cannot be written to"
    if writable_by_others(folder):
        return "can be written to by other users"
    return ""


@cache
def private_temporary_folder() -> Path:
    """A temporary folder of this user alone.

    It is the same in every call if it can be, otherwise a new one.
    """
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"place-rsus-{user}"
    if not trouble_with(folder):
        return folder
    folder = Path(tempfile.mkdtemp(prefix="place-rsus-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def writable_by_others(path: Path) -> bool:
    """True if other users may change a file or folder, or put another one in its place.

    Every folder on the way, behind all links, is judged by owner and rights. A user's
    own group without other members is nobody else; root may do anything. False where
    there are no such rights, or no such file.
    """
    # Windows.
    if not hasattr(os, "getuid"):
        return False
    try:
        real = path.resolve(strict=True)
    except OSError:
        return False
    return any(
        _is_open(place.stat(), is_last=place == real) for place in (real, *real.parents)
    )


def _is_open(found: os.stat_result, *, is_last: bool) -> bool:
    """True if other users may change what a file's status belongs to.

    `is_last` is False for a folder on the way to the file.
    """
    import grp
    import pwd

    if found.st_uid not in (os.getuid(), 0):
        return True
    # What lies in a folder like /tmp can be moved by its owner alone.
    if found.st_mode & stat.S_ISVTX and not is_last:
        return False
    if (
        found.st_mode & stat.S_IWOTH
        or not found.st_mode & stat.S_IWGRP
        or found.st_gid == 0
    ):
        return bool(found.st_mode & stat.S_IWOTH)
    try:
        owner = pwd.getpwuid(found.st_uid).pw_name
        group = grp.getgrgid(found.st_gid)
    except KeyError:
        return True
    return group.gr_name != owner or bool(set(group.gr_mem) - {owner})


def open_own(path: Path) -> BinaryIO:
    """Open a file that this user or root alone can have written.

    Raises
    ------
    PermissionError
        Somebody else may have written it.
    OSError
        The file cannot be opened.
    """
    file = path.open("rb")
    # What is judged is what is read.
    found = os.fstat(file.fileno())
    if hasattr(os, "getuid") and _is_open(found, is_last=True):
        file.close()
        raise PermissionError(
            errno.EPERM, "another user may have written it", str(path)
        )
    return file
