"""Points from LAS and LAZ files, a piece at a time, through laspy."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import InputError, Unquoted

if TYPE_CHECKING:
    from pyproj import CRS

MAX_POINTS = 50_000_000
CHUNK_POINTS = 1_000_000
_MAX_UNPACKED_BYTES = 4_000_000_000
# LASzip's types of items in a point: their bytes; 0: as many as there are.
_ITEM_BYTES = {0: 0, 6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29, 14: 0}
# Of the types that are packed in layers: how many; 0: one for every byte.
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1, 14: 0}

Points = tuple[FloatArray, NDArray[np.uint8]]  # (n, 3) coordinates and (n,) classes of LAS


@contextmanager
def open_las(path: Path) -> Iterator[tuple["CRS | None", Iterator[Points]]]:
    """Open a LAS or LAZ file.

    Yields
    ------
    crs : CRS or None
        That of its header; None: none, or none that can be read.
    chunks : iterator of ((n, 3) float, (n,) uint8)
        Coordinates as the file has them, and their classes.

    Raises
    ------
    InputError
        The file claims more than 50 million points or more than it has bytes for, or is damaged:
        also while its points are taken.
    OSError
        It cannot be read.
    """
    import laspy

    where = str(path)
    check_las(path)
    try:
        # One thread: the parallel one of lazrs aborts the process where a chunk table is damaged.
        reader = laspy.open(path, laz_backend=laspy.LazBackend.Lazrs)
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


def check_las(path: Path) -> None:
    """Refuse a header that claims more than the file can have.

    Raises
    ------
    InputError
        It does.
    OSError
        The file cannot be read.
    """
    where = str(path)
    n_bytes = path.stat().st_size
    with path.open("rb") as file:
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
        raise InputError(
            where, Unquoted(f"{n_points:,} points"), f"at most {MAX_POINTS:,}; thin it out first"
        )
    if not n_points:
        raise InputError(where, Unquoted("no points"), "points")
    if not header_bytes <= first_point <= n_bytes or header_bytes + 54 * n_records > first_point:
        raise InputError(where, Unquoted(f"{n_records:,} records in its header"), "as many as fit")
    is_packed = bool(point_format & 0xC0)
    if is_packed:
        n_layers = _n_layers(path, header_bytes, n_records, point_bytes)
        _check_chunks(path, first_point, point_bytes, n_layers)
    if not is_packed and first_point + n_points * point_bytes > n_bytes:
        raise InputError(
            where,
            Unquoted(f"a header with {n_points:,} points in {n_bytes:,} bytes: cut off"),
            f"{first_point + n_points * point_bytes:,} bytes",
        )
    if n_points * max(point_bytes, 20) > _MAX_UNPACKED_BYTES:
        raise InputError(where, Unquoted(f"{point_bytes} bytes for every point"), "fewer")


def _n_layers(path: Path, header_bytes: int, n_records: int, point_bytes: int) -> int:
    """In how many layers every chunk of points is packed; 0: in none.

    Raises
    ------
    InputError
        The parts of a packed point are not those of a point.
    """
    where = str(path)
    with path.open("rb") as file:
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
    with path.open("rb") as file:
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
        raise InputError(
            str(path), Unquoted(f"{n_chunks:,} chunks of points that claim more bytes"), f"{at:,}"
        )


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
    except BaseException as error:  # laspy raises anything, and lazrs what is no Exception
        raise InputError(where, Unquoted(_one_line(error)), "undamaged points") from None


def _one_line(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:150]}"
