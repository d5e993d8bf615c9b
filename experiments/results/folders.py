"""Folders of results: named files, replaced as a whole or left as they were; files added whole."""

import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from geometry.errors import InputError, Unquoted
from geometry.files import write_atomically

from ..progress import signals_held

MARKER = "summary.json"
LAYOUT_FILE = "layout.json"
RUNS_FILE = "runs.parquet"
APR_FILE = "apr.csv"

# ---------- a folder that is replaced as a whole, or left as it was


# MARKER marks a folder as one of ours: only such folders are ever replaced.
_OURS = (
    MARKER,
    "report.html",
    "layout.*",
    "latency.csv",
    "certificate.json",
    "instance.npz",
    "apr.csv",
    "bill_of_materials.csv",
    "runs.parquet",
    "*.png",
    ".DS_Store",
)
_PREFIX = ".place-rsus."


def check_result_folder(folder: Path) -> None:
    """Check, before anything is computed, that a result folder can be written; changes nothing.

    Parameters
    ----------
    folder : Path
        New, empty, or an earlier result: ``summary.json`` and nothing that others wrote.

    Raises
    ------
    InputError
        It is a file, holds other things, or cannot be replaced or written to.
    """
    try:
        real = folder.resolve()
        real.stat()
    except FileNotFoundError:
        pass
    except (OSError, RuntimeError) as error:  # a circle of links is a RuntimeError
        raise _unwritable(folder, error) from None
    else:
        _check_existing(folder, real)
    parent = real.parent
    while not parent.exists():
        parent = parent.parent
    try:
        # Root may write anywhere that is mounted writeable: trying is the only honest test.
        with signals_held():
            Path(tempfile.mkdtemp(prefix=_PREFIX, dir=parent)).rmdir()
    except OSError as error:
        raise _unwritable(folder, error) from None


@contextmanager
def new_result_folder(folder: Path) -> Iterator[Path]:
    """Fill a temporary folder, then put it in the place of `folder`.

    Parameters
    ----------
    folder : Path
        Where the results shall be, see :func:`check_result_folder`; a link is followed.

    Yields
    ------
    temporary : Path
        Write here. If the block raises, `folder` stays as it was and nothing else is left.

    Raises
    ------
    InputError
        As :func:`check_result_folder`: much may have changed since the results were asked for.
    """
    check_result_folder(folder)
    real = folder.resolve()
    made = [parent for parent in real.parents if not parent.exists()]
    temporary = real.with_name(f"{_PREFIX}{uuid4().hex}.tmp")
    try:
        temporary.mkdir(parents=True)
        yield temporary
        _put_in_place(temporary, real)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        with suppress(OSError):
            for parent in made:
                parent.rmdir()
        raise


def _check_existing(folder: Path, real: Path) -> None:
    if not real.is_dir():
        raise InputError("--out", str(folder), "a folder, not a file")
    try:
        names = sorted(entry.name for entry in real.iterdir())
    except OSError as error:
        raise _unwritable(folder, error) from None
    foreign = [name for name in names if not any(fnmatch(name, ours) for ours in _OURS)]
    if foreign or (names and MARKER not in names):
        what = foreign[0] if foreign else f"{names[0]} but no {MARKER}"
        raise InputError(
            "--out",
            Unquoted(f"{folder}, which holds {what}"),
            "a new or empty folder, or one with earlier results and nothing else",
        )
    if real.is_mount() or Path.cwd().is_relative_to(real):
        # Such a folder cannot be replaced, or not without pulling the rug from under a shell.
        raise InputError(
            "--out",
            Unquoted(f"{folder}, the current folder or a mounted one"),
            "a folder inside it",
        )


def _put_in_place(temporary: Path, folder: Path) -> None:
    """Exchange a folder for a new one; nothing comes between the steps."""
    replaced = temporary.with_suffix(".old")
    with signals_held() as held:
        is_replaced = folder.exists()
        if is_replaced:
            folder.rename(replaced)
        try:
            temporary.rename(folder)
        except OSError:
            if is_replaced:
                replaced.rename(folder)
            raise
        shutil.rmtree(replaced, ignore_errors=True)
        held.clear()  # too late: all is there


def _unwritable(folder: Path, error: Exception) -> InputError:
    reason = getattr(error, "strerror", None) or "a circle of links"
    return InputError("--out", Unquoted(f"{folder}: {reason}"), "a folder that can be written to")


def left_as_it_was(folder: Path) -> str:
    """What is on disk as long as nothing has been written, in words."""
    if (folder / MARKER).exists():
        return f"the earlier results in {folder} are unchanged"
    return f"nothing was written to {folder}"


# ---------- files that a command adds to a folder; what else the folder holds stays


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
        raise _unwritable_folder_files(folder, error) from None


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
        raise _unwritable_folder_files(folder, error) from None


def _writer(content: bytes) -> Callable[[BinaryIO], object]:
    return lambda file: file.write(content)


def _unwritable_folder_files(folder: Path, error: OSError) -> InputError:
    what = Unquoted(f"{folder}: {error.strerror or error}")
    return InputError("--out", what, "a folder that can be written to")
