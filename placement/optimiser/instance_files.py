"""Optimisation instances from and to disk: this program's own, OR-Library's, GECCO 2020's."""

import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import scipy.sparse as sp

from geometry.atomic_files import write_atomically
from geometry.errors import InputError, Unquoted

from .covering_instance import CoveringInstance
from .covering_text import TEXT_FORMATS, parse_covering_text

NPZ = "npz"
FORMATS = (NPZ, *TEXT_FORMATS)
"""Names of the formats that :func:`load_instance` reads; of its own, npz."""

KIND = "place-rsus/covering-instance/1"
"""What our own files say they hold; raise the number whenever the fields change."""

_ZIP_MAGIC = b"PK"
_MAX_BYTES = 1 << 30
_MAX_UNPACKED_BYTES = 1 << 32


def load_instance(path: Path, *, format_name: str | None = None) -> CoveringInstance:
    """Read an instance.

    Parameters
    ----------
    path : Path
        The file.
    format_name : str, optional
        One of :data:`FORMATS`; by default the one that the content is in, whatever the name of
        the file.

    Returns
    -------
    instance : CoveringInstance
        What it holds.

    Raises
    ------
    InputError
        The file cannot be read, or holds no instance: the message says where, and what is
        expected there.
    """
    if format_name is not None and format_name not in FORMATS:
        raise InputError("--format", format_name, "one of " + ", ".join(FORMATS))
    where = str(path)
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise InputError(where, Unquoted("no regular file"), "a file")
        if status.st_size > _MAX_BYTES:
            raise InputError(
                where,
                Unquoted(f"{status.st_size:,} bytes"),
                f"an instance of at most {_MAX_BYTES:,} bytes",
            )
        with path.open("rb") as file:
            magic = file.read(len(_ZIP_MAGIC))
            file.seek(0)
            if format_name == NPZ or (format_name is None and magic == _ZIP_MAGIC):
                return _load_npz(file, where)
            data = file.read()
    except OSError as error:
        raise InputError(where, Unquoted(error.strerror or error), "a readable file") from None
    if not data.strip():
        raise InputError(where, Unquoted("an empty file"), "an instance")
    return parse_covering_text(data, where, format_name)


def save_instance(path: Path, instance: CoveringInstance) -> None:
    """Write an instance in this program's own format, whole or not at all.

    Parameters
    ----------
    path : Path
        The file; its folder must exist.
    instance : CoveringInstance
        What to write.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    covers = instance.covers
    write_atomically(
        path,
        lambda file: np.savez_compressed(
            file,
            kind=KIND,
            n_rows=instance.n_rows,
            covered_rows_start=covers.indptr,
            covered_rows=covers.indices,
            cost=instance.cost,
            weight=instance.weight,
            names=np.array(instance.names, dtype=np.str_),
            numbered_from=instance.numbered_from,
        ),
    )


def instance_kind(path: Path) -> str | None:
    """What a file of this program says it holds, so that other kinds can be read elsewhere.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    kind : str or None
        Such as :data:`KIND`; None: it cannot be read, or is none of this program's files.
    """
    try:
        # Opened here: numpy does not close a file that turns out to be no archive.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return str(stored["kind"])
    except Exception:  # what is wrong with it is told by what reads it
        return None


def _load_npz(file: BinaryIO, where: str) -> CoveringInstance:
    try:
        with np.load(file, allow_pickle=False) as stored:
            n_bytes = sum(member.file_size for member in stored.zip.infolist())
            if n_bytes > _MAX_UNPACKED_BYTES:
                raise InputError(
                    where,
                    Unquoted(f"{n_bytes:,} bytes when unpacked"),
                    f"an instance of at most {_MAX_UNPACKED_BYTES:,}",
                )
            fields = {name: stored[name] for name in stored.files}
    except (InputError, OSError):
        raise
    except Exception as error:  # what damaged archives raise has no end: zipfile's, zlib's
        words = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            where, Unquoted(f"a damaged file ({words})"), "an .npz file of this program"
        ) from None
    kind = str(fields["kind"]) if "kind" in fields else Unquoted("nothing")
    if kind != KIND:
        raise InputError(f"{where}: kind", kind, repr(KIND))
    try:
        return _covering_from(fields)
    except InputError as error:
        raise InputError(f"{where}: {error.where}", error.got, error.expected) from None


def _covering_from(fields: Mapping[str, Any]) -> CoveringInstance:
    for name in ("n_rows", "covered_rows_start", "covered_rows", "cost", "weight"):
        if name not in fields:
            raise InputError(name, Unquoted("nothing"), "an array")
        if fields[name].dtype.kind not in "iuf":
            raise InputError(name, Unquoted(f"an array of {fields[name].dtype}"), "numbers")
    start, rows = fields["covered_rows_start"], fields["covered_rows"]
    for name in ("n_rows", "covered_rows_start", "covered_rows"):
        if fields[name].dtype.kind == "f":
            raise InputError(name, Unquoted(f"an array of {fields[name].dtype}"), "whole numbers")
    if fields["n_rows"].shape != () or not 0 <= fields["n_rows"] < 1 << 31:
        raise InputError("n_rows", fields["n_rows"].tolist(), "a number of rows")
    if start.ndim != 1 or len(start) == 0 or rows.ndim != 1:
        raise InputError(
            "covered_rows_start", Unquoted(f"shape {start.shape}"), "one number more than columns"
        )
    try:
        covers = sp.csr_array(
            (np.ones(len(rows), dtype=np.bool_), rows, start),
            shape=(len(start) - 1, int(fields["n_rows"])),
        )
        covers.check_format(full_check=True)
    except ValueError as error:
        raise InputError("covered_rows", Unquoted(error), "rows of every column") from None
    return CoveringInstance(
        covers=covers,
        cost=fields["cost"],
        weight=fields["weight"],
        names=tuple(map(str, np.atleast_1d(fields.get("names", ())))),
        numbered_from=int(fields.get("numbered_from", 0)),
    )
