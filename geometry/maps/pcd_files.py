"""Points from PCD files, a piece at a time."""

import struct
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np

from ..arrays import FloatArray
from ..errors import InputError, Unquoted
from .las_files import CHUNK_POINTS, MAX_POINTS, Points

_MAX_HEADER_BYTES = 65_536

_PCD_TYPES = {("F", 4): "<f4", ("F", 8): "<f8"}
_PCD_TYPES |= {("I", n): f"<i{n}" for n in (1, 2, 4, 8)}
_PCD_TYPES |= {("U", n): f"<u{n}" for n in (1, 2, 4, 8)}


def pcd_points(file: BinaryIO, where: str) -> Iterator[Points]:
    """Points of an open PCD file, version 0.7: ascii, binary or binary_compressed.

    Those without coordinates, which it has as NaN, are left out; all are of class 0.

    Raises
    ------
    InputError
        While points are taken: the file claims more than 50 million or more than it has, or is
        damaged.
    """
    header = _pcd_header(file, where)
    names = header.get("FIELDS", [])
    if not {"x", "y", "z"} <= set(names):
        raise InputError(f"{where}: FIELDS", " ".join(names)[:80], "x, y and z among them")
    sizes = _integers(header, "SIZE", len(names), where)
    counts = (
        _integers(header, "COUNT", len(names), where) if "COUNT" in header else [1] * len(sizes)
    )
    n_points = _integers(header, "POINTS", 1, where)[0]
    if not 0 < n_points <= MAX_POINTS:
        raise InputError(f"{where}: POINTS", n_points, f"1 to {MAX_POINTS:,}")
    kinds = header.get("TYPE", [])
    formats = []
    for index, name in enumerate(names):
        kind = (kinds[index] if index < len(kinds) else "", sizes[index])
        if kind not in _PCD_TYPES or not 0 < counts[index] <= 4096:
            raise InputError(f"{where}: field {name}", kind, "a TYPE, SIZE and COUNT of PCD")
        formats.append((f"{index}", _PCD_TYPES[kind], (counts[index],)))
    columns = [names.index(axis) for axis in "xyz"]
    encoding = " ".join(header.get("DATA", []))
    if encoding == "binary":
        chunks = _pcd_binary(file, np.dtype(formats), columns, n_points, where)
    elif encoding == "ascii":
        first = np.cumsum([0, *counts])
        chunks = _pcd_ascii(file, [int(first[column]) for column in columns], n_points, where)
    elif encoding == "binary_compressed":
        chunks = _pcd_compressed(file, np.dtype(formats), columns, n_points, where)
    else:
        raise InputError(f"{where}: DATA", encoding, "ascii, binary or binary_compressed")
    n_found = 0
    for xyz in chunks:
        xyz = xyz[~np.isnan(xyz).any(axis=1)]
        n_found += len(xyz)
        yield xyz, np.zeros(len(xyz), dtype=np.uint8)
    if not n_found:
        raise InputError(where, Unquoted("only points without coordinates"), "points")


def _pcd_header(file: BinaryIO, where: str) -> dict[str, list[str]]:
    """Lines of the header up to DATA."""
    header: dict[str, list[str]] = {}
    while file.tell() < _MAX_HEADER_BYTES:
        line = file.readline(_MAX_HEADER_BYTES)
        words = line.decode("ascii", "replace").split()
        if not line or (not header and words and words[0] not in ("#", "VERSION", "FIELDS")):
            if not line or not words[0].startswith("#"):
                break
            continue
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
        if words and words[0] == "DATA":
            return header
    raise InputError(where, Unquoted("no header with FIELDS to DATA"), "a PCD file")


def _integers(header: dict[str, list[str]], key: str, n: int, where: str) -> list[int]:
    words = header.get(key, [])
    if len(words) != n or not all(word.isascii() and word.isdigit() for word in words):
        raise InputError(f"{where}: {key}", " ".join(words)[:80], f"{n} whole numbers")
    if any(len(word) > 18 for word in words):
        raise InputError(f"{where}: {key}", words[0][:40], "a smaller number")
    return [int(word) for word in words]


def _pcd_binary(
    file: BinaryIO, record: np.dtype[Any], columns: list[int], n_points: int, where: str
) -> Iterator[FloatArray]:
    here = file.tell()
    n_bytes = file.seek(0, 2) - here
    file.seek(here)
    if n_points * record.itemsize > n_bytes:
        raise InputError(
            where,
            Unquoted(f"a header with {n_points:,} points over {n_bytes:,} bytes: cut off"),
            f"{n_points * record.itemsize:,} bytes",
        )
    chunk = max(1, min(CHUNK_POINTS, 64_000_000 // record.itemsize))
    for first in range(0, n_points, chunk):
        n = min(chunk, n_points - first)
        table = np.frombuffer(file.read(n * record.itemsize), dtype=record)
        with np.errstate(invalid="ignore"):  # NaNs of the signalling kind
            xyz = [table[str(column)][:, 0].astype(np.float64) for column in columns]
        yield np.stack(xyz, axis=1)


def _pcd_ascii(
    file: BinaryIO, columns: list[int], n_points: int, where: str
) -> Iterator[FloatArray]:
    n_found = 0
    while lines := file.readlines(32_000_000):
        lines = [line for line in lines if line.strip()][: n_points - n_found]
        try:
            rows = [line.split() for line in lines]
            numbers = np.array([[row[column] for column in columns] for row in rows], dtype=float)
        except (ValueError, IndexError):
            raise InputError(where, Unquoted("a line without x, y and z"), "numbers") from None
        n_found += len(lines)
        if len(lines):
            yield numbers.reshape(-1, 3)
    if n_found < n_points:
        raise InputError(
            where, Unquoted(f"{n_found:,} of {n_points:,} points: cut off"), "all of them"
        )


def _pcd_compressed(
    file: BinaryIO, record: np.dtype[Any], columns: list[int], n_points: int, where: str
) -> Iterator[FloatArray]:
    """All x, then all y, and so on, packed by LZF after two lengths."""
    head = file.read(8)
    n_packed, n_bytes = struct.unpack("<2I", head) if len(head) == 8 else (0, 0)
    if n_bytes != n_points * record.itemsize or n_bytes > _MAX_LZF_BYTES:
        raise InputError(
            where,
            Unquoted(f"{n_bytes:,} bytes of unpacked points"),
            f"{n_points * record.itemsize:,}, and at most {_MAX_LZF_BYTES:,}",
        )
    data = unpack_lzf(file.read(n_packed), n_bytes)
    if data is None:
        raise InputError(where, Unquoted("damaged compressed points"), f"{n_bytes:,} bytes")
    xyz = []
    for column in columns:
        offset = sum(record[before].itemsize for before in range(column)) * n_points
        kind, shape = record[column].subdtype or (record[column], (1,))
        values = np.frombuffer(data, dtype=kind, count=n_points * shape[0], offset=offset)
        with np.errstate(invalid="ignore"):  # NaNs of the signalling kind
            xyz.append(values[:: shape[0]].astype(np.float64))
    yield np.stack(xyz, axis=1)


def unpack_lzf(packed: bytes, n_bytes: int) -> bytes | None:
    """Unpack LZF: runs of literal bytes, and copies of what came before.

    Parameters
    ----------
    packed : bytes
        A control byte below 32 is followed by one more literal byte than it says. Otherwise its
        upper three bits are the length of a copy (7: the next byte adds to it), two too small, and
        its lower five bits and the next byte its distance, one too small.
    n_bytes : int
        Length unpacked.

    Returns
    -------
    data : bytes or None
        None if `packed` is damaged.
    """
    data = bytearray()
    place = 0
    try:
        while place < len(packed) and len(data) <= n_bytes:
            control = packed[place]
            place += 1
            if control < 32:
                data += packed[place : place + control + 1]
                place += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[place]
                place += 1
            start = len(data) - ((control & 31) << 8) - packed[place] - 1
            place += 1
            length += 2
            if start < 0:
                return None
            piece = bytes(data[start : start + length])
            data += (piece * (length // len(piece) + 1))[:length]
    except IndexError:
        return None
    return bytes(data) if len(data) == n_bytes else None


_MAX_LZF_BYTES = 200_000_000  # unpacked a byte at a time: half a minute
