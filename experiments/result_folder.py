"""A folder of results that is replaced as a whole, or left as it was."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from geometry.errors import InputError, Unquoted

# Marks a folder as one of ours, so that only such folders are ever replaced.
MARKER = "summary.json"


def check_result_folder(folder: Path) -> None:
    """Check, before anything is computed, that a result folder can be written.

    Parameters
    ----------
    folder : Path
        New, empty, or an earlier result (it holds ``summary.json``).

    Raises
    ------
    InputError
        It is a file, holds other things, or cannot be written to.
    """
    if folder.exists():
        if not folder.is_dir():
            raise InputError("--out", str(folder), "a folder, not a file")
        try:
            names = {entry.name for entry in folder.iterdir()}
        except OSError as error:
            raise InputError("--out", Unquoted(f"{folder}: {error.strerror}"), "a readable folder") from None
        if names and MARKER not in names:
            raise InputError(
                "--out",
                Unquoted(f"{folder}, which holds {sorted(names)[0]} but no {MARKER}"),
                "a new or empty folder, or one with earlier results",
            )
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # Root may write anywhere that is mounted writeable: trying is the only honest test.
        Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent)).rmdir()
    except OSError as error:
        raise InputError(
            "--out", Unquoted(f"{folder}: {error.strerror}"), "a folder that can be written to"
        ) from None


@contextmanager
def new_result_folder(folder: Path) -> Iterator[Path]:
    """Fill a temporary folder, then put it in the place of `folder`.

    Parameters
    ----------
    folder : Path
        Where the results shall be; checked by :func:`check_result_folder`.

    Yields
    ------
    temporary : Path
        Write here. If the block raises, `folder` stays as it was and nothing else is left.
    """
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".tmp", dir=folder.parent))
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o777 & ~mask)
        replaced = temporary.with_suffix(".old")
        if folder.exists():
            folder.rename(replaced)
        try:
            temporary.rename(folder)
        except BaseException:
            if replaced.exists():
                replaced.rename(folder)
            raise
        shutil.rmtree(replaced, ignore_errors=True)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
