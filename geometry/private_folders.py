"""Folders whose content is believed: where they are, and who else may write there."""

import atexit
import errno
import os
import shutil
import stat
import struct
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import BinaryIO

_MAX_LINKS = 40  # as many as Linux follows
_ACLS = ("system.posix_acl_access", "system.posix_acl_default")
_ACL_HEADER, _ACL_ENTRY = struct.Struct("<I"), struct.Struct("<HHI")
_NAMED_USER, _NAMED_GROUP, _MASK = 0x02, 0x08, 0x10
_WRITE = 0o2


def user_cache_folder() -> Path:
    """The program's folder in the user's cache; a relative XDG_CACHE_HOME does not count."""
    from platformdirs import user_cache_path

    folder = user_cache_path("place-rsus")
    # As the XDG base directory specification demands.
    return folder if folder.is_absolute() else Path.home() / ".cache" / "place-rsus"


def trouble_with(folder: Path) -> str:
    """Make a folder where it is missing; why it cannot hold what is believed, empty if it can."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        return f"cannot be made ({error.strerror or error})"
    if not os.access(folder, os.W_OK | os.X_OK):
        return "cannot be written to"
    return "can be written to by other users" if writable_by_others(folder) else ""


@cache
def private_temporary_folder() -> Path:
    """A folder of this user alone among the temporary ones: the same in every call, if it can be.

    If somebody else holds that name, it is a new one, which goes when the process ends.
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

    Every folder and every link on the way is judged, by owner, rights and access control lists. A
    user's own group, which has the user's name and no other members, is nobody else; root may do
    anything. False where the system has no such rights, or there is no such file.
    """
    if not hasattr(os, "getuid"):  # Windows
        return False
    way = [*_way_to(path)]
    return any(_may_change(place, is_last=place == way[-1]) for place in way)


def _way_to(path: Path) -> Iterator[Path]:
    """Every folder and link through which a path leads, from the root on."""
    here = Path(path.absolute().anchor)
    names = [*reversed(path.absolute().parts[1:])]
    n_links = 0
    yield here
    while names:
        name = names.pop()
        if name == "..":
            here = here.parent
            continue
        here /= name
        yield here
        if here.is_symlink():
            n_links += 1
            if n_links > _MAX_LINKS:
                raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
            target = here.readlink()
            names += reversed(target.parts[1:] if target.is_absolute() else target.parts)
            here = Path(target.anchor) if target.is_absolute() else here.parent


def _may_change(place: Path, *, is_last: bool) -> bool:
    """True if others may change one file, folder or link."""
    try:
        found = place.lstat()
    except OSError:
        return False
    if stat.S_ISLNK(found.st_mode):
        return found.st_uid not in (os.getuid(), 0)
    return _is_open(place, found, is_last=is_last)


def _is_open(place: Path | int, found: os.stat_result, *, is_last: bool) -> bool:
    """True if others may change a file or folder, by its path or descriptor."""
    if found.st_uid not in (os.getuid(), 0):
        return True
    # What lies in a folder like /tmp can be moved by its owner alone.
    if found.st_mode & stat.S_ISVTX and not is_last:
        return False
    if found.st_mode & stat.S_IWOTH:
        return True
    if found.st_mode & stat.S_IWGRP and found.st_gid != 0 and not _is_own_group(found):
        return True
    return any(_acl_lets_others_write(place, name) for name in _ACLS[: 1 + is_last])


def _is_own_group(found: os.stat_result) -> bool:
    import grp
    import pwd

    try:
        owner, group = pwd.getpwuid(found.st_uid).pw_name, grp.getgrgid(found.st_gid)
    except KeyError:
        return False
    return group.gr_name == owner and not set(group.gr_mem) - {owner}


def _acl_lets_others_write(place: Path | int, name: str) -> bool:
    """True if an access control list names others who may write."""
    try:
        content = os.getxattr(place, name)
    except (OSError, AttributeError):  # there is none, or the system knows none
        return False
    try:
        entries = [*_ACL_ENTRY.iter_unpack(content[_ACL_HEADER.size :])]
    except struct.error:
        return True  # of a form that is not known
    mask = next((rights for tag, rights, _ in entries if tag == _MASK), _WRITE)
    mine = {(_NAMED_USER, os.getuid()), (_NAMED_USER, 0), (_NAMED_GROUP, 0)}
    return any(
        rights & mask & _WRITE and tag in (_NAMED_USER, _NAMED_GROUP) and (tag, who) not in mine
        for tag, rights, who in entries
    )


def open_own(path: Path) -> BinaryIO:
    """Open a file for reading that this user or root alone can have written.

    Raises PermissionError: somebody else owns it, or may write to it. OSError: it cannot be read.
    """
    file = path.open("rb")
    handle = file.fileno()  # what is judged is what is read
    if hasattr(os, "getuid") and _is_open(handle, os.fstat(handle), is_last=True):
        file.close()
        raise PermissionError(errno.EPERM, "another user may have written it", str(path))
    return file
