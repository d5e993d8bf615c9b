"""A folder of results.

Written as a whole or not at all, and replaced only if nobody changed it.

``SHA256SUMS`` in the folder lists its files with their hashes, so that ``sha256sum -c
SHA256SUMS`` checks it anywhere. A folder is replaced only if it holds the listed files,
unchanged, and nothing else: what users put there, or changed there, is theirs.
"""

import ctypes
import errno
import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar
from uuid import uuid4

import msgspec

from geometry.errors import InputError, Unquoted
from geometry.locks import is_abandoned, lock_while_alive
from geometry.opening import open_file, read_text
from geometry.writing import is_about, write_atomically

from ..progress import WRITING, StageProgress, signals_held
from .signatures import SIGNATURE, check_signing_key, write_signature

_R = TypeVar("_R", bound=msgspec.Struct)

MARKER = "summary.json"
LAYOUT_FILE = "layout.json"
# Where the evaluator prefers another layout.
RECOMMENDED_FILE = "recommended.json"
RUNS_FILE = "runs.parquet"
APR_FILE = "apr.csv"
MANIFEST = "SHA256SUMS"

_PREFIX = ".place-rsus."
# They come by themselves.
_OF_FILE_MANAGERS = {".DS_Store", "Thumbs.db", "desktop.ini"}


def write_manifest(folder: Path) -> None:
    """List all files of a folder with their hashes in its ``SHA256SUMS``."""
    lines = [f"{sha256(path)}  {name}\n" for name, path in listed_files(folder).items()]
    write_atomically(folder / MANIFEST, "".join(lines))


def _manifest_of(contents: Mapping[str, str | bytes]) -> str:
    """List of files that are not written yet, as a manifest has it.

    See :func:`write_manifest`.
    """
    lines = []
    for name, content in sorted(contents.items()):
        data = content.encode() if isinstance(content, str) else content
        lines.append(f"{hashlib.sha256(data).hexdigest()}  {name}\n")
    return "".join(lines)


def read_manifest(folder: Path) -> dict[str, str]:
    """Hashes by file name, as ``SHA256SUMS`` lists them.

    Nothing where there is no such file.

    Raises
    ------
    InputError
        The file cannot be read, or is not a list of hashes and names.
    """
    path = folder / MANIFEST
    if not path.exists():
        return {}
    lines = read_text(path, "a list of SHA-256 hashes and names").splitlines()
    hashes: dict[str, str] = {}
    for number, line in enumerate(lines, start=1):
        digest, gap, name = line.partition("  ")
        where = f"{path}: line {number}"
        if (
            not gap
            or not name
            or len(digest) != 64
            or set(digest) - set("0123456789abcdef")
        ):
            raise InputError(where, line, "a SHA-256 hash, two spaces, a name")
        if name in hashes:
            raise InputError(where, name, "every file once")
        hashes[name] = digest
    return hashes


def changed_files(folder: Path) -> dict[str, str]:
    """What is not as ``SHA256SUMS`` lists it.

    "missing", "changed" or "not listed", by file name.

    Raises
    ------
    InputError
        As :func:`read_manifest`; or a file cannot be read.
    """
    listed = read_manifest(folder)
    found = listed_files(folder)
    changes = {name: "missing" for name in listed if name not in found}
    for name, path in found.items():
        if name not in listed:
            changes[name] = "not listed"
        elif sha256(path) != listed[name]:
            changes[name] = "changed"
    return changes


def sha256(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal digits."""
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]


def listed_files(folder: Path) -> dict[str, Path]:
    """Files in a folder and those below it, by relative name.

    Empty folders count as well.
    """
    not_listed = {MANIFEST, SIGNATURE, *_OF_FILE_MANAGERS}
    return {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*"))
        if path.name not in not_listed and not _is_filled_folder(path)
    }


def _is_filled_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink() and any(path.iterdir())


def check_result_folder(folder: Path) -> None:
    """Check, before anything is computed, that a result folder can be written.

    Changes nothing.

    Parameters
    ----------
    folder : Path
        New, empty, or an earlier result as it was written.

    Raises
    ------
    InputError
        It is a file, holds other things, or cannot be replaced or written to.
    """
    _check_name(folder)
    try:
        real = folder.resolve()
        real.stat()
    except FileNotFoundError:
        pass
    except (OSError, RuntimeError) as error:
        # A circle of links is a RuntimeError.
        raise unwritable(folder, error) from None
    else:
        _check_existing(folder, real)
    _try_to_write(folder, real.parent)


def _try_to_write(folder: Path, existing: Path) -> None:
    """Make a folder, and remove it.

    Root may write anywhere, so nothing else is an honest test.
    """
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    try:
        with signals_held():
            Path(tempfile.mkdtemp(prefix=_PREFIX, dir=existing)).rmdir()
    except OSError as error:
        raise unwritable(folder, error) from None


@contextmanager
def new_result_folder(folder: Path, *, sign: Path | None = None) -> Iterator[Path]:
    """Fill a temporary folder, then put it in the place of `folder`.

    `folder` may be a link.

    `sign` is the key that signs the list of its files, see :mod:`.signatures`. If the
    block raises, `folder` stays as it was; what was written is kept next to it if
    ``summary.json`` is among it, unless the user ends the program. Raises InputError as
    :func:`check_result_folder`, or if writing failed: it names the folder that is kept.
    """
    check_result_folder(folder)
    real = folder.resolve()
    remove_abandoned(real.parent)
    made = [parent for parent in real.parents if not parent.exists()]
    temporary = real.with_name(f"{_PREFIX}{uuid4().hex}.tmp")
    try:
        temporary.mkdir(parents=True)
        with lock_while_alive(temporary):
            yield temporary
            write_manifest(temporary)
            if sign is not None:
                write_signature(temporary, temporary / MANIFEST, sign)
            _put_in_place(temporary, folder, real)
    except BaseException as error:
        if isinstance(error, Exception) and (temporary / MARKER).exists():
            kept = _free_name(real, "unfinished")
            temporary.rename(kept)
            more = f"; what was computed is kept in {kept}"
            if isinstance(error, InputError):
                raise InputError(
                    error.where, error.got, f"{error.expected}{more}"
                ) from error
            if isinstance(error, OSError) and is_about(error, real, temporary):
                raise unwritable(folder, error, more) from error
            error.add_note(more.removeprefix("; "))
        shutil.rmtree(temporary, ignore_errors=True)
        with suppress(OSError):
            for parent in made:
                parent.rmdir()
        raise


def _check_name(folder: Path) -> None:
    """Raise InputError for a name that reports and JSON cannot repeat."""
    try:
        str(folder).encode("utf-8")
    except UnicodeEncodeError:
        shown = os.fsencode(folder).decode("utf-8", "backslashreplace")
        raise InputError("--out", shown, "a name in UTF-8") from None


def _check_existing(folder: Path, real: Path) -> None:
    if not real.is_dir():
        raise InputError("--out", str(folder), "a folder, not a file")
    try:
        is_empty = not any(real.iterdir())
        changes = {} if is_empty else changed_files(real)
        has_manifest = (real / MANIFEST).exists()
    except OSError as error:
        raise unwritable(folder, error) from None
    theirs = {name: change for name, change in changes.items() if change != "missing"}
    if theirs:
        name, change = next(iter(theirs.items()))
        what = f"holds {name}"
        if not has_manifest:
            what += f" but no {MANIFEST}"
        elif change == "changed":
            what += ", changed since it was written"
        expected = "a new or empty folder, or one with earlier results and nothing else"
        raise InputError("--out", Unquoted(f"{folder}, which {what}"), expected)
    if real.is_mount() or Path.cwd().is_relative_to(real):
        # Such a folder cannot be replaced, or not without pulling the rug from under a
        # shell.
        got = Unquoted(f"{folder}, the current folder or a mounted one")
        raise InputError("--out", got, "a folder inside it")


def _put_in_place(temporary: Path, folder: Path, real: Path) -> None:
    """Put a filled folder in its place in one step.

    What stood there is removed.
    """
    with signals_held() as held:
        if not real.exists():
            temporary.rename(real)
        else:
            # Files may have come, or changed, meanwhile.
            _check_existing(folder, real)
            for path in [
                path for path in real.rglob("*") if path.name in _OF_FILE_MANAGERS
            ]:
                path.unlink()
            replaced = temporary
            if not _exchange(temporary, real):
                replaced = _free_name(real, "earlier")
                # In sight: the program may be killed before the next line.
                real.rename(replaced)
                try:
                    temporary.rename(real)
                except OSError:
                    replaced.rename(real)
                    raise
            shutil.rmtree(replaced, ignore_errors=True)
        # Too late: all is there.
        held.clear()


def _exchange(first: Path, second: Path) -> bool:
    """Exchange the names of two folders in one step.

    False where the system cannot.
    """
    if sys.platform == "win32":
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(first), os.fsencode(second)
    # Linux.
    if hasattr(libc, "renameat2"):
        at_cwd = -100
        # AT_FDCWD and RENAME_EXCHANGE of <fcntl.h> and <linux/fs.h>.
        swap = 2
        failed = libc.renameat2(at_cwd, names[0], at_cwd, names[1], swap)
    elif hasattr(libc, "renamex_np"):
        # RENAME_SWAP of <sys/stdio.h>.
        # macOS.
        swap = 2
        failed = libc.renamex_np(names[0], names[1], swap)
    else:
        return False
    code = ctypes.get_errno()
    if failed and code not in (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP):
        raise OSError(code, os.strerror(code), str(second))
    return not failed


def _free_name(folder: Path, word: str) -> Path:
    """A free name next to a folder: ``latest.unfinished``."""
    # Names have 255 bytes at most.
    stem = folder.name[:200]
    names = [
        f"{stem}.{word}",
        *(f"{stem}.{word}-{number}" for number in range(2, 1000)),
    ]
    return next(path for name in names if not (path := folder.with_name(name)).exists())


def remove_abandoned(parent: Path) -> None:
    """Remove the temporary folders that a killed run left.

    Never those of one that is alive.
    """
    if not parent.is_dir():
        return
    for path in parent.glob(f"{_PREFIX}*"):
        if path.is_dir() and not path.is_symlink() and is_abandoned(path):
            shutil.rmtree(path, ignore_errors=True)


def expect_results(
    out: Path | None, progress: StageProgress, *, sign: Path | None = None
) -> None:
    """Check a folder before a job that replaces it, if asked to.

    The job uses :func:`new_result_folder`.

    Raises InputError: it cannot be written, or the key `sign` cannot sign it.
    """
    _check_key(sign, out)
    if out is not None:
        check_result_folder(out)
        progress.kept = f"nothing was written to {out}"
        if (out / MARKER).exists():
            progress.kept = f"the earlier results in {out} are unchanged"


def _check_key(sign: Path | None, out: Path | None) -> None:
    """Raise InputError if a key is given that cannot sign, or nothing to sign."""
    if sign is not None and out is None:
        raise InputError("--sign", str(sign), "--out as well, a folder to sign")
    if sign is not None:
        check_signing_key(sign)


def unwritable(folder: Path, error: Exception, more: str = "") -> InputError:
    """The error of an ``--out`` that cannot be written."""
    got = Unquoted(f"{folder}: {_reason(error)}")
    return InputError("--out", got, f"a folder that can be written to{more}")


def _reason(error: Exception) -> str:
    if isinstance(error, RuntimeError) and "loop" in str(error).lower():
        return "a circle of links"
    reason = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
    return " ".join(str(reason).split())


def check_folder(folder: Path) -> None:
    """Find out before anything is computed whether a folder can be written.

    Else InputError.
    """
    _check_name(folder)
    _try_to_write(folder, folder)


def write_files(folder: Path, contents: Mapping[str, str | bytes]) -> None:
    """Write files by name, each whole or not at all.

    InputError if the folder is not writable.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            write_atomically(folder / name, content)
    except OSError as error:
        raise unwritable(folder, error) from None


def expect_files(
    out: Path | None, progress: StageProgress, *, sign: Path | None = None
) -> None:
    """Check a folder before a job that writes files there, if asked to.

    The job uses :func:`save_files`.

    Raises InputError: it cannot be written, or the key `sign` cannot sign its files.
    """
    _check_key(sign, out)
    if out is not None:
        check_folder(out)
        progress.kept = f"nothing was written to {out}"


def save_files(
    result: _R,
    out: Path | None,
    progress: StageProgress,
    files: Callable[[_R], Mapping[str, str | bytes]],
    *,
    has_manifest: bool = False,
    sign: Path | None = None,
) -> _R:
    """The result with its "seconds".

    `files` of it are added to `out`, if asked to.

    With a manifest they are listed in ``SHA256SUMS``, which the key `sign` signs.
    """
    if out is not None:
        progress(WRITING, 0, 0)
    result = msgspec.structs.replace(result, seconds=progress.finish())
    if out is not None:
        contents = dict(files(result))
        if has_manifest:
            contents[MANIFEST] = _manifest_of(contents)
        write_files(out, contents)
        if has_manifest:
            # It was of earlier files.
            (out / SIGNATURE).unlink(missing_ok=True)
        if sign is not None:
            write_signature(out, out / MANIFEST, sign)
        progress.kept = f"the results are in {out}"
    return result
