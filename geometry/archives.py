"""Unpack archives of users, within limits.

An archive may be a bomb, which unpacks to far more than it holds; its files may have
names that lead out of the folder, or be links.
"""

import os
import stat
import zipfile
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from .errors import InputError, refuse
from .opening import open_file, reading
from .writing import open_new

MAX_MEMBERS = 10_000
# Out of one file, whatever it is packed with.
MAX_UNPACKED_BYTES = 2_000_000_000
# Text of coordinates comes to 10; a bomb begins at 1000.
MAX_RATIO = 200
# Of which a bomb is none.
_SMALL_BYTES = 1_000_000
_CHUNK_BYTES = 1 << 20


@contextmanager
def unpacked(path: Path, suffixes: Collection[str]) -> Iterator[Path]:
    """Unpack a .zip and yield the path of its one readable file.

    Everything else in the archive lies next to that file.

    `suffixes` are the endings of readable files in lower case; files that belong to
    them (``.dbf``, ``.bin``, textures) have others. The temporary folder is removed
    at the end. An :class:`InputError` about it that is raised within names the
    archive instead.

    Raises
    ------
    InputError
        The archive is damaged or encrypted, is too large unpacked (2 GB, 10,000
        files, 200 times its size), has names that lead out of the folder,
        links, or names twice; or if none, or several, of its files are
        readable.
    """
    where = str(path)
    with TemporaryDirectory(prefix="place-rsus-") as folder:
        damage = (
            zipfile.BadZipFile,
            zipfile.LargeZipFile,
            zlib.error,
            EOFError,
            RuntimeError,
        )
        with (
            reading(path, "a readable .zip", *damage, ValueError, OSError),
            open_file(path) as file,
            zipfile.ZipFile(file) as archive,
        ):
            members = _checked_members(archive, where)
            found = _recognised(members, suffixes, where)
            _extract(archive, members, Path(folder), where)
        try:
            yield Path(folder) / found.filename
        except InputError as error:
            inside = error.where.replace(f"{folder}{os.sep}", f"{where}/")
            raise InputError(inside, error.got, error.expected) from None


def _checked_members(archive: zipfile.ZipFile, where: str) -> list[zipfile.ZipInfo]:
    """Files of an archive; raises InputError if one of them is dangerous."""
    entries = archive.infolist()
    if len(entries) > MAX_MEMBERS:
        refuse(where, f"{len(entries):,} members", f"at most {MAX_MEMBERS:,}")
    seen: set[str] = set()
    for entry in entries:
        name = entry.filename
        parts = PurePosixPath(name).parts
        leads_out = name.startswith("/") or ".." in parts or set(name) & set("\\:\0")
        for is_wrong, what, expected in (
            (
                not parts or leads_out,
                "a name that leads out of it",
                "plain relative names",
            ),
            (stat.S_ISLNK(entry.external_attr >> 16), "a link", "plain files"),
            (entry.flag_bits & 0x1, "an encrypted file", "one without a password"),
            (name.casefold() in seen, "a name that occurs twice", "every name once"),
        ):
            if is_wrong:
                refuse(f"{where}: {name!r:.100}", what, expected)
        seen.add(name.casefold())
    members = [entry for entry in entries if not entry.is_dir()]
    refuse_bomb(sum(entry.file_size for entry in members), where)
    return members


def _recognised(
    members: list[zipfile.ZipInfo], suffixes: Collection[str], where: str
) -> zipfile.ZipInfo:
    """The one readable file of an archive.

    A description of another file (roofs.shp.xml) does not count.
    """
    names = {entry.filename for entry in members}
    found = [
        entry
        for entry in members
        if entry.filename.lower().endswith(tuple(suffixes))
        and entry.filename.rpartition(".")[0] not in names
        and not any(
            part.startswith((".", "__MACOSX")) for part in Path(entry.filename).parts
        )
    ]
    if len(found) == 1:
        return found[0]
    shown = ", ".join(entry.filename[:60] for entry in (found or members)[:5])
    got = f"{len(found)} files that can be read" + (
        f" (it has {shown})" if shown else ""
    )
    refuse(where, got, "exactly one, with an ending of " + ", ".join(sorted(suffixes)))


def _extract(
    archive: zipfile.ZipFile, members: list[zipfile.ZipInfo], folder: Path, where: str
) -> None:
    """Write files into a folder and count their bytes.

    The sizes that the archive states may be wrong.
    """
    n_bytes = 0
    for entry in members:
        target = folder / entry.filename
        target.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(entry) as source, open_new(target) as sink:
            while chunk := source.read(_CHUNK_BYTES):
                n_bytes += len(chunk)
                refuse_bomb(n_bytes, where)
                sink.write(chunk)


def unpacked_bytes(archive: zipfile.ZipFile, where: str) -> int:
    """Size of an archive's content, as the archive states it.

    Raises
    ------
    InputError
        The size is beyond the budget.
    """
    n_bytes = sum(member.file_size for member in archive.infolist())
    check_unpacked(n_bytes, where)
    return n_bytes


def check_unpacked(n_bytes: int, where: str) -> None:
    """Raise InputError if more bytes are unpacked than the budget allows.

    The budget is that of one packed file, whatever it is packed with.
    """
    if n_bytes > MAX_UNPACKED_BYTES:
        expected = (
            f"at most {MAX_UNPACKED_BYTES:,}, the budget of everything that is packed"
        )
        refuse(where, f"{n_bytes:,} bytes or more when unpacked", expected)


def refuse_bomb(n_bytes: int, where: str) -> None:
    """Raise InputError if a packed file unpacks to more than is honest.

    `where` is the packed file, `n_bytes` its size when unpacked.
    """
    check_unpacked(n_bytes, where)
    refuse_ratio(n_bytes, Path(where).stat().st_size, where)


def refuse_ratio(n_bytes: int, n_packed: int, where: str) -> None:
    """Raise InputError if unpacked bytes are too many for the packed ones.

    A packed file of text comes to a tenth of its content or so, a bomb to a
    thousandth and less. Small content is never refused.
    """
    if n_bytes > max(_SMALL_BYTES, MAX_RATIO * n_packed):
        got = f"{n_bytes:,} bytes or more out of {max(1, n_packed):,}"
        refuse(where, got, f"at most {MAX_RATIO} times as many")
