"""Archives from anywhere, opened without the traps that archives have."""

import os
import stat
import zipfile
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from ..errors import InputError, Unquoted

MAX_MEMBERS = 10_000
MAX_UNPACKED_BYTES = 2_000_000_000
MAX_RATIO = 200  # text of coordinates comes to 10; a bomb begins at 1000
_SMALL_BYTES = 1_000_000  # of which a bomb is none
_CHUNK_BYTES = 1 << 20


@contextmanager
def unpacked(path: Path, suffixes: Collection[str]) -> Iterator[Path]:
    """The one file of a .zip that can be read, with what lies beside it, for as long as needed.

    Parameters
    ----------
    path : Path
        A .zip file.
    suffixes : collection of str
        Endings of the files that can be read, in lower case: ``{".geojson", ".shp"}``. What
        belongs to such a file - ``.dbf``, ``.bin``, textures - has none of them.

    Yields
    ------
    member : Path
        In a temporary folder, which is removed at the end. An :class:`InputError` about it that is
        raised within names the archive instead of the folder.

    Raises
    ------
    InputError
        It is no archive, is encrypted or damaged, is too large unpacked (2 GB, 10,000 files, 200
        times its size), has names that lead out of the folder, links, or names twice; or none, or
        several, of its files can be read.
    """
    where = str(path)
    with TemporaryDirectory(prefix="place-rsus-") as folder:
        try:
            with zipfile.ZipFile(path) as archive:
                members = _checked_members(archive, where)
                found = _recognised(members, suffixes, where)
                _extract(archive, members, Path(folder), where)
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError(where, Unquoted(reason), "a readable .zip") from None
        except (
            *(zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, EOFError, RuntimeError),
            *(NotImplementedError, ValueError),
        ) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(where, Unquoted(error), "a .zip that can be unpacked") from None
        try:
            yield Path(folder) / found.filename
        except InputError as error:
            inside = error.where.replace(f"{folder}{os.sep}", f"{where}/")
            raise InputError(inside, error.got, error.expected) from None


def _checked_members(archive: zipfile.ZipFile, where: str) -> list[zipfile.ZipInfo]:
    """Files of an archive, none of which leads astray."""
    entries = archive.infolist()
    if len(entries) > MAX_MEMBERS:
        raise InputError(where, Unquoted(f"{len(entries):,} members"), f"at most {MAX_MEMBERS:,}")
    seen: set[str] = set()
    members = []
    for entry in entries:
        name = entry.filename
        parts = PurePosixPath(name).parts
        shown = f"{where}: {name!r:.100}"
        if not parts or name.startswith("/") or ".." in parts or set(name) & set("\\:\0"):
            raise InputError(shown, Unquoted("a name that leads out of it"), "plain relative names")
        if stat.S_ISLNK(entry.external_attr >> 16):
            raise InputError(shown, Unquoted("a link"), "plain files")
        if entry.flag_bits & 0x1:
            raise InputError(shown, Unquoted("an encrypted file"), "one without a password")
        if name.casefold() in seen:
            raise InputError(shown, Unquoted("a name that it has twice"), "every name once")
        seen.add(name.casefold())
        if not entry.is_dir():
            members.append(entry)
    _refuse_bomb(sum(entry.file_size for entry in members), where)
    return members


def _recognised(
    members: list[zipfile.ZipInfo], suffixes: Collection[str], where: str
) -> zipfile.ZipInfo:
    """The one file that can be read; what describes another (roofs.shp.xml) does not count."""
    names = {entry.filename for entry in members}
    found = [
        entry
        for entry in members
        if entry.filename.lower().endswith(tuple(suffixes))
        and entry.filename.rpartition(".")[0] not in names
        and not any(part.startswith((".", "__MACOSX")) for part in Path(entry.filename).parts)
    ]
    if len(found) == 1:
        return found[0]
    shown = ", ".join(entry.filename[:60] for entry in (found or members)[:5])
    raise InputError(
        where,
        Unquoted(f"{len(found)} files that can be read" + (f" (it has {shown})" if shown else "")),
        "exactly one, with an ending of " + ", ".join(sorted(suffixes)),
    )


def _extract(
    archive: zipfile.ZipFile, members: list[zipfile.ZipInfo], folder: Path, where: str
) -> None:
    """Write files into a folder, counting bytes: what the archive says may be wrong."""
    n_bytes = 0
    for entry in members:
        target = folder / entry.filename
        target.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(entry) as source, target.open("xb") as sink:
            while chunk := source.read(_CHUNK_BYTES):
                n_bytes += len(chunk)
                _refuse_bomb(n_bytes, where)
                sink.write(chunk)


def _refuse_bomb(n_bytes: int, where: str) -> None:
    packed = max(1, Path(where).stat().st_size)
    if n_bytes > MAX_UNPACKED_BYTES:
        raise InputError(
            where,
            Unquoted(f"{n_bytes:,} bytes or more when unpacked"),
            f"at most {MAX_UNPACKED_BYTES:,}",
        )
    if n_bytes > max(_SMALL_BYTES, MAX_RATIO * packed):
        raise InputError(
            where,
            Unquoted(f"{n_bytes:,} bytes or more out of {packed:,}"),
            f"at most {MAX_RATIO} times as many",
        )
