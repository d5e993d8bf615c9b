"""Points from LAS, LAZ and PCD files, a chunk at a time."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import InputError, Unquoted, check_one_of
from ..files import open_file
from ..untrusted_files import check_unpacked

if TYPE_CHECKING:
    from pyproj import CRS


SUFFIXES = (".las", ".laz", ".pcd")
MAX_POINTS = 50_000_000
CHUNK_POINTS = 1_000_000
# LASzip's types of items in a point: their bytes; 0: as many as there are.
_ITEM_BYTES = {0: 0, 6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29, 14: 0}
# Of the types that are packed in layers: how many; 0: one for every byte.
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1, 14: 0}

Points = tuple[FloatArray, NDArray[np.uint8]]  # coordinates (n, 3) and LAS classes (n,), 0: none


@contextmanager
def open_points(path: Path) -> Iterator[tuple["CRS | None", Iterator[Points]]]:
    """Open a ``.las``, ``.laz`` or ``.pcd`` file: yields its CRS, if any, and chunks of points.

    Raises InputError if it cannot be read, claims more than 50 million points or more than it has
    bytes for, or is damaged (also while its points are read).
    """
    where = str(path)
    suffix = path.suffix.lower()
    check_one_of(where, suffix, SUFFIXES)
    try:
        if suffix == ".pcd":
            with open_file(path) as file:
                yield None, _pcd_points(file, where)
        else:
            with _open_las(path) as (crs, chunks):
                yield crs, chunks
    except OSError as error:
        raise InputError(where, Unquoted(error.strerror or error), "a readable file") from None


# ---------- LAS and LAZ files, through laspy
@contextmanager
def _open_las(path: Path) -> Iterator[tuple["CRS | None", Iterator[Points]]]:
    import laspy

    where = str(path)
    _check_header(path)
    try:
        # One thread: the parallel one of lazrs aborts the process where a chunk table is damaged.
        reader = laspy.open(open_file(path), laz_backend=laspy.LazBackend.Lazrs)
    except OSError:
        raise
    except Exception as error:  # laspy raises whatever a damaged header makes it
        raise InputError(where, Unquoted(_one_line(error)), "a LAS file") from None
    with reader:
        header = reader.header
        scales = np.array([header.scales, header.offsets], dtype=np.float64)
        if not np.isfinite(scales).all() or (scales[0] == 0.0).any():
            raise InputError(f"{where}: header", scales.tolist(), "finite scales and offsets")
        yield _crs(header), _chunks(reader, where)


def _check_header(path: Path) -> None:
    """Raise InputError if a header claims more than the file can contain."""
    where = str(path)
    n_bytes = path.stat().st_size
    with open_file(path) as file:
        head = file.read(375)
    if len(head) < 227 or head[:4] != b"LASF":
        raise InputError(where, Unquoted("something else"), "a LAS file")
    minor = head[25]
    header_bytes, first_point, n_records = struct.unpack_from("<HII", head, 94)
    point_format, point_bytes, n_points = struct.unpack_from("<BHI", head, 104)
    if minor >= 4 and len(head) >= 375:
        first_extended, n_extended, n_points_14 = struct.unpack_from("<QIQ", head, 235)
        n_points = n_points_14 or n_points
        if n_extended and first_extended + 60 * n_extended > n_bytes:
            raise InputError(where, Unquoted(f"{n_extended:,} extended records"), "as many as fit")
    if n_points > MAX_POINTS:
        got = Unquoted(f"{n_points:,} points")
        raise InputError(where, got, f"at most {MAX_POINTS:,}; thin it out first")
    if not n_points:
        raise InputError(where, Unquoted("no points"), "points")
    if not header_bytes <= first_point <= n_bytes or header_bytes + 54 * n_records > first_point:
        raise InputError(where, Unquoted(f"{n_records:,} records in its header"), "as many as fit")
    is_packed = bool(point_format & 0xC0)
    if is_packed:
        n_layers = _n_layers(path, header_bytes, n_records, point_bytes)
        _check_chunks(path, first_point, point_bytes, n_layers)
    if not is_packed and first_point + n_points * point_bytes > n_bytes:
        got = Unquoted(f"a header with {n_points:,} points in {n_bytes:,} bytes: cut off")
        raise InputError(where, got, f"{first_point + n_points * point_bytes:,} bytes")
    check_unpacked(n_points * max(point_bytes, 20), where)


def _n_layers(path: Path, header_bytes: int, n_records: int, point_bytes: int) -> int:
    """Number of layers in which chunks of points are packed; 0: they are not layered.

    Raises InputError if the parts of a packed point do not make up a point.
    """
    where = str(path)
    with open_file(path) as file:
        file.seek(header_bytes)
        for _ in range(n_records):
            head = file.read(54)
            if len(head) < 54:
                break
            owner, number, n_bytes = struct.unpack_from("<16sHH", head, 2)
            data = file.read(n_bytes)
            if owner.rstrip(b"\0") != b"laszip encoded" or number != 22204 or len(data) < 34:
                continue
            n_items = struct.unpack_from("<H", data, 32)[0]
            items = [struct.unpack_from("<3H", data, at) for at in range(34, len(data) - 5, 6)]
            sizes = [size for kind, size, _ in items if _ITEM_BYTES.get(kind, -1) in (0, size)]
            if not 0 < n_items == len(items) == len(sizes) or sum(sizes) != point_bytes:
                raise InputError(where, Unquoted("packed points of no known kind"), "LASzip")
            if items[0][0] not in _LAYERS:
                return 0
            return sum(_LAYERS.get(kind, 0) or size for kind, size, _ in items)
    raise InputError(where, Unquoted("packed points without a LASzip record"), "a LAZ file")


def _check_chunks(path: Path, first_point: int, point_bytes: int, n_layers: int) -> None:
    """Refuse chunks of packed points that claim more bytes than there are before their table."""
    n_bytes = path.stat().st_size
    with open_file(path) as file:
        file.seek(first_point)
        head = file.read(8)
        at = struct.unpack("<q", head)[0] if len(head) == 8 else 0
        if at == -1:  # of a file that was written as a stream: in its last eight bytes
            file.seek(-8, 2)
            at = struct.unpack("<q", file.read(8))[0]
        if not first_point < at <= n_bytes - 8:
            raise InputError(str(path), Unquoted("a table of chunks outside the file"), "all of it")
        file.seek(at)
        _, n_chunks = struct.unpack("<2I", file.read(8))
        claimed = n_chunks * point_bytes  # the first point of a chunk is not packed
        begin = first_point + 8
        while n_layers and begin < at:
            begin += point_bytes + 4
            file.seek(begin)
            sizes = file.read(4 * n_layers)
            begin += len(sizes) + sum(
                struct.unpack(f"<{len(sizes) // 4}I", sizes[: len(sizes) & ~3])
            )
    if claimed > n_bytes or begin > at:
        got = Unquoted(f"{n_chunks:,} chunks of points that claim more bytes")
        raise InputError(str(path), got, f"{at:,}")


def _crs(header: Any) -> "CRS | None":
    try:
        crs: CRS | None = header.parse_crs()
    except Exception:  # whatever a damaged record makes laspy and pyproj raise
        return None
    return crs


def _chunks(reader: Any, where: str) -> Iterator[Points]:
    n_points = 0
    try:
        for points in reader.chunk_iterator(CHUNK_POINTS):
            n_points += len(points)
            if n_points > MAX_POINTS:
                raise InputError(where, Unquoted(f"more than {MAX_POINTS:,} points"), "fewer")
            xyz = np.stack([np.asarray(points[axis], dtype=np.float64) for axis in "xyz"], axis=1)
            yield xyz, np.asarray(points.classification, dtype=np.uint8)
    except (InputError, MemoryError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:  # laspy raises anything, lazrs even others than Exception
        raise InputError(where, Unquoted(_one_line(error)), "undamaged points") from None


def _one_line(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:150]}"


# ---------- PCD files
_MAX_HEADER_BYTES = 65_536
_MAX_LZF_BYTES = 200_000_000  # unpacked a byte at a time: half a minute

_PCD_TYPES = {("F", 4): "<f4", ("F", 8): "<f8"}
_PCD_TYPES |= {("I", n): f"<i{n}" for n in (1, 2, 4, 8)}
_PCD_TYPES |= {("U", n): f"<u{n}" for n in (1, 2, 4, 8)}


def _pcd_points(file: BinaryIO, where: str) -> Iterator[Points]:
    """Points of an open PCD file, version 0.7: ascii, binary or binary_compressed; all of class 0.

    Points without coordinates (NaN) are left out. Raises InputError, while points are read, if the
    file claims more than 50 million or more than it contains, or is damaged.
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
        got = Unquoted(f"a header with {n_points:,} points over {n_bytes:,} bytes: cut off")
        raise InputError(where, got, f"{n_points * record.itemsize:,} bytes")
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
        got = Unquoted(f"{n_found:,} of {n_points:,} points: cut off")
        raise InputError(where, got, "all of them")


def _pcd_compressed(
    file: BinaryIO, record: np.dtype[Any], columns: list[int], n_points: int, where: str
) -> Iterator[FloatArray]:
    """All x, then all y, and so on, packed by LZF after two lengths."""
    head = file.read(8)
    n_packed, n_bytes = struct.unpack("<2I", head) if len(head) == 8 else (0, 0)
    if n_bytes != n_points * record.itemsize or n_bytes > _MAX_LZF_BYTES:
        expected = f"{n_points * record.itemsize:,}, and at most {_MAX_LZF_BYTES:,}"
        raise InputError(where, Unquoted(f"{n_bytes:,} bytes of unpacked points"), expected)
    data = _unpack_lzf(file.read(n_packed), n_bytes)
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


def _unpack_lzf(packed: bytes, n_bytes: int) -> bytes | None:
    """Unpack LZF: runs of literal bytes, and copies of earlier ones; None if the data is damaged.

    A control byte below 32 is followed by one more literal byte than it says. Otherwise its upper
    three bits are the length of a copy (7: the next byte adds to it), less two, and its lower five
    bits and the next byte its distance, less one.
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
