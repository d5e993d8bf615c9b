"""What a PBF file must not have before the library reads it: bytes that it trips over, or bombs.

References
----------
.. [1] https://wiki.openstreetmap.org/wiki/PBF_Format: blobs, their limits, string tables.
"""

import zlib
from collections.abc import Iterator
from pathlib import Path

from ...errors import InputError, Unquoted

_MAX_HEADER_BYTES = 64 * 1024  # [1]
_MAX_BLOB_BYTES = 32 * 1024 * 1024  # [1], packed or not
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5  # protobuf's wire types


def check_pbf(path: Path, *, max_unpacked_bytes: int, expected: str) -> None:
    """Refuse a PBF file that osmium cannot be trusted with.

    Parameters
    ----------
    path : Path
        A file that begins as PBF does.
    max_unpacked_bytes : int
        How much it may hold in all.
    expected : str
        What it should be, for messages.

    Raises
    ------
    InputError
        It is damaged, holds more, is packed in another way than with zlib, or has a text with a
        zero byte in it: osmium ends texts there and reads on behind its memory.
    """
    n_left = max_unpacked_bytes
    try:
        for kind, data in _blobs(path):
            n_left -= len(data)
            if n_left < 0:
                raise InputError(
                    str(path),
                    Unquoted(f"more than {max_unpacked_bytes:,} bytes when unpacked"),
                    "fewer; cut it out first",
                )
            if kind == b"OSMData" and any(b"\0" in text for text in _texts(data)):
                raise InputError(str(path), Unquoted("a zero byte in a text"), expected)
    except (IndexError, _DamagedError, zlib.error) as error:
        reason = Unquoted(str(error) if isinstance(error, _DamagedError) else "damaged data")
        raise InputError(str(path), reason, expected) from None


class _DamagedError(Exception):
    """Bytes are not what the format says."""


def _blobs(path: Path) -> Iterator[tuple[bytes, bytes]]:
    """Kind and unpacked content of each blob."""
    with path.open("rb") as file:
        while prefix := file.read(4):
            n_bytes = int.from_bytes(prefix, "big")
            if len(prefix) < 4 or n_bytes > _MAX_HEADER_BYTES:
                raise _DamagedError("a header that is none")
            header = _fields(_exactly(file.read(n_bytes), n_bytes))
            kind, n_bytes = b"", -1
            for number, value in header:
                if number == 1 and isinstance(value, bytes):
                    kind = value
                elif number == 3 and isinstance(value, int):
                    n_bytes = value
            if not 0 <= n_bytes <= _MAX_BLOB_BYTES:
                raise _DamagedError("a blob without a size, or too large")
            yield kind, _unpacked(_exactly(file.read(n_bytes), n_bytes))


def _exactly(data: bytes, n_bytes: int) -> bytes:
    if len(data) < n_bytes:
        raise _DamagedError("unexpected end of file")
    return data


def _unpacked(blob: bytes) -> bytes:
    for number, value in _fields(blob):
        if number == 1 and isinstance(value, bytes):
            return value
        if number == 3 and isinstance(value, bytes):
            unpacked = zlib.decompressobj().decompress(value, _MAX_BLOB_BYTES + 1)
            if len(unpacked) > _MAX_BLOB_BYTES:
                raise _DamagedError("a blob that grows too large")
            return unpacked
    raise _DamagedError("a blob packed in another way than with zlib")


def _texts(block: bytes) -> Iterator[bytes]:
    """The strings of a block."""
    for number, value in _fields(block):
        if number == 1 and isinstance(value, bytes):
            for _, text in _fields(value):
                if isinstance(text, bytes):
                    yield text


def _fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Numbers and values of a message's fields."""
    at, end = 0, len(data)
    while at < end:
        key, at = _varint(data, at)
        number, wire = key >> 3, key & 7
        if wire == _VARINT:
            value, at = _varint(data, at)
            yield number, value
            continue
        if wire == _BYTES:
            length, at = _varint(data, at)
        elif wire in (_FIXED32, _FIXED64):
            length = 4 if wire == _FIXED32 else 8
        else:
            raise _DamagedError("a field of unknown type")
        if length > end - at:
            raise _DamagedError("a field that is longer than what it is in")
        yield number, data[at : at + length]
        at += length


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of variable length and where the next field begins."""
    value, shift = 0, 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
        if shift > 63:
            raise _DamagedError("a number of too many bytes")
