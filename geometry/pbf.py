"""Check PBF files of OpenStreetMap before osmium reads them.

References
----------
.. [1] OpenStreetMap Wiki, "PBF Format": limits of headers and blobs.
"""

import zlib
from collections.abc import Iterator
from pathlib import Path

from .errors import InputError, Unquoted, refuse
from .opening import open_file

# By the format's own rules [1], packed or not.
_MAX_HEADER_BYTES = 64 * 1024
_MAX_BLOB_BYTES = 32 * 1024 * 1024
# Protobuf's wire types.
_VARINT = 0
_FIXED64 = 1
_BYTES = 2
_FIXED32 = 5


def check_pbf(path: Path, *, max_unpacked_bytes: int, expected: str) -> None:
    """Raise InputError if a PBF file is one that osmium cannot be trusted with.

    It is damaged, too large, packed in another way than with zlib, or has a zero byte
    in a text: osmium ends the text there and reads on beyond its memory.
    """
    n_left = max_unpacked_bytes
    try:
        for kind, data in _blobs(path):
            n_left -= len(data)
            if n_left < 0:
                got = f"more than {max_unpacked_bytes:,} bytes when unpacked"
                refuse(str(path), got, "fewer; cut it out first")
            if kind == b"OSMData" and any(b"\0" in text for text in _texts(data)):
                refuse(str(path), "a zero byte in a text", expected)
    except _DamagedError as error:
        raise InputError(str(path), Unquoted(error), expected) from None
    except (IndexError, zlib.error):
        raise InputError(str(path), Unquoted("damaged data"), expected) from None


class _DamagedError(Exception):
    """Bytes do not follow the format."""


def _blobs(path: Path) -> Iterator[tuple[bytes, bytes]]:
    """Kind and unpacked content of each blob of a file."""
    with open_file(path) as file:
        while prefix := file.read(4):
            n_bytes = int.from_bytes(prefix, "big")
            if len(prefix) < 4 or n_bytes > _MAX_HEADER_BYTES:
                raise _DamagedError("an invalid header")
            header = dict(_fields(_exactly(file.read(n_bytes), n_bytes)))
            kind = header.get(1, b"")
            size = header.get(3, -1)
            if not isinstance(kind, bytes) or not isinstance(size, int):
                raise _DamagedError("an invalid header")
            if not 0 <= size <= _MAX_BLOB_BYTES:
                raise _DamagedError("a blob without a size, or too large")
            yield kind, _unpacked(_exactly(file.read(size), size))


def _exactly(data: bytes, n_bytes: int) -> bytes:
    """The data, if there are as many bytes as there should be."""
    if len(data) < n_bytes:
        raise _DamagedError("unexpected end of file")
    return data


def _unpacked(blob: bytes) -> bytes:
    """Content of a blob, which is plain or packed with zlib."""
    for number, value in _fields(blob):
        if number == 1 and isinstance(value, bytes):
            return value
        if number == 3 and isinstance(value, bytes):
            unpacked = zlib.decompressobj().decompress(value, _MAX_BLOB_BYTES + 1)
            if len(unpacked) > _MAX_BLOB_BYTES:
                raise _DamagedError("a blob that is too large when unpacked")
            return unpacked
    raise _DamagedError("a blob packed in another way than with zlib")


def _texts(block: bytes) -> Iterator[bytes]:
    """Texts of a block of data, which are its first field."""
    for number, value in _fields(block):
        if number == 1 and isinstance(value, bytes):
            for _, text in _fields(value):
                if isinstance(text, bytes):
                    yield text


def _fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Numbers and values of a message's fields."""
    at = 0
    end = len(data)
    while at < end:
        key, at = _varint(data, at)
        number = key >> 3
        wire = key & 7
        if wire == _VARINT:
            value, at = _varint(data, at)
            yield number, value
            continue
        if wire == _BYTES:
            length, at = _varint(data, at)
        elif wire in (_FIXED32, _FIXED64):
            if wire == _FIXED32:
                length = 4
            else:
                length = 8
        else:
            raise _DamagedError("a field of unknown type")
        if length > end - at:
            raise _DamagedError("a field that is longer than its message")
        yield number, data[at : at + length]
        at += length


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of variable length, and the position of the next field."""
    value = 0
    shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
        if shift > 63:
            raise _DamagedError("a number with too many bytes")
