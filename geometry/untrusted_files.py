"""Open untrusted files safely: archives, XML, JSON, glTF, PBF."""

import os
import stat
import struct
import sys
import zipfile
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Annotated, Any, BinaryIO
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from .errors import InputError, Unquoted, refuse
from .files import open_file, open_new, parse_json, read_bytes, read_table, reading

MAX_MEMBERS = 10_000
# Out of one file, whatever it is packed with.
MAX_UNPACKED_BYTES = 2_000_000_000
# Text of coordinates comes to 10; a bomb begins at 1000.
MAX_RATIO = 200
# Of which a bomb is none.
_SMALL_BYTES = 1_000_000
_CHUNK_BYTES = 1 << 20
_VALUE_BYTES = 8
MAX_FILE_BYTES = 500_000_000
# elements of one accessor: five million triangles have 15 million indices
_MAX_COUNT = 20_000_000
_MAX_NODES = 200_000
_MAX_JSON_BYTES = 100_000_000
# [1].
_MAX_HEADER_BYTES = 64 * 1024
# [1], packed or not.
_MAX_BLOB_BYTES = 32 * 1024 * 1024
_VARINT = 0
_FIXED64 = 1
_BYTES = 2
# Protobuf's wire types.
_FIXED32 = 5


@contextmanager
def unpacked(path: Path, suffixes: Collection[str]) -> Iterator[Path]:
    """Unpack a .zip and yield the path of its one readable file.

    Everything else in the archive lies next to that file.

    `suffixes` are the endings of readable files in lower case; files that belong to
    them (``.dbf``, ``.bin``, textures) have others. The temporary folder is removed at
    the end. An :class:`InputError` about it that is raised within names the archive
    instead. Raises InputError if the archive is damaged or encrypted, is too large
    unpacked (2 GB, 10,000 files, 200 times its size), has names that lead out of the
    folder, links, or names twice; or if none, or several, of its files are readable.
    """
    where = str(path)
    with TemporaryDirectory(prefix="place-rsus-") as folder:
        damage = (
            zipfile.BadZipFile,
            zipfile.LargeZipFile,
            zlib.error,
            EOFError,
            RuntimeError,
        )
        with (
            reading(path, "a readable .zip", *damage, ValueError, OSError),
            open_file(path) as file,
            zipfile.ZipFile(file) as archive,
        ):
            members = _checked_members(archive, where)
            found = _recognised(members, suffixes, where)
            _extract(archive, members, Path(folder), where)
        try:
            yield Path(folder) / found.filename
        except InputError as error:
            inside = error.where.replace(f"{folder}{os.sep}", f"{where}/")
            raise InputError(inside, error.got, error.expected) from None


def _checked_members(archive: zipfile.ZipFile, where: str) -> list[zipfile.ZipInfo]:
    """Files of an archive; raises InputError if one of them is dangerous."""
    entries = archive.infolist()
    if len(entries) > MAX_MEMBERS:
        refuse(where, f"{len(entries):,} members", f"at most {MAX_MEMBERS:,}")
    seen: set[str] = set()
    for entry in entries:
        name = entry.filename
        parts = PurePosixPath(name).parts
        leads_out = name.startswith("/") or ".." in parts or set(name) & set("\\:\0")
        for is_wrong, what, expected in (
            (
                not parts or leads_out,
                "a name that leads out of it",
                "plain relative names",
            ),
            (stat.S_ISLNK(entry.external_attr >> 16), "a link", "plain files"),
            (entry.flag_bits & 0x1, "an encrypted file", "one without a password"),
            (name.casefold() in seen, "a name that occurs twice", "every name once"),
        ):
            if is_wrong:
                refuse(f"{where}: {name!r:.100}", what, expected)
        seen.add(name.casefold())
    members = [entry for entry in entries if not entry.is_dir()]
    refuse_bomb(sum(entry.file_size for entry in members), where)
    return members


def _recognised(
    members: list[zipfile.ZipInfo], suffixes: Collection[str], where: str
) -> zipfile.ZipInfo:
    """The one readable file of an archive.

    A description of another file (roofs.shp.xml) does not count.
    """
    names = {entry.filename for entry in members}
    found = [
        entry
        for entry in members
        if entry.filename.lower().endswith(tuple(suffixes))
        and entry.filename.rpartition(".")[0] not in names
        and not any(
            part.startswith((".", "__MACOSX")) for part in Path(entry.filename).parts
        )
    ]
    if len(found) == 1:
        return found[0]
    shown = ", ".join(entry.filename[:60] for entry in (found or members)[:5])
    got = f"{len(found)} files that can be read" + (
        f" (it has {shown})" if shown else ""
    )
    refuse(where, got, "exactly one, with an ending of " + ", ".join(sorted(suffixes)))


def _extract(
    archive: zipfile.ZipFile, members: list[zipfile.ZipInfo], folder: Path, where: str
) -> None:
    """Write files into a folder and count their bytes.

    The sizes that the archive states may be wrong.
    """
    n_bytes = 0
    for entry in members:
        target = folder / entry.filename
        target.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(entry) as source, open_new(target) as sink:
            while chunk := source.read(_CHUNK_BYTES):
                n_bytes += len(chunk)
                refuse_bomb(n_bytes, where)
                sink.write(chunk)


def unpacked_bytes(archive: zipfile.ZipFile, where: str) -> int:
    """Size of an archive's content, as the archive states it.

    Raises
    ------
    InputError
        The size is beyond the budget.
    """
    n_bytes = sum(member.file_size for member in archive.infolist())
    check_unpacked(n_bytes, where)
    return n_bytes


def check_unpacked(n_bytes: int, where: str) -> None:
    """Raise InputError if more bytes are unpacked than the budget allows.

    The budget is that of one packed file, whatever it is packed with.
    """
    if n_bytes > MAX_UNPACKED_BYTES:
        expected = (
            f"at most {MAX_UNPACKED_BYTES:,}, the budget of everything that is packed"
        )
        refuse(where, f"{n_bytes:,} bytes or more when unpacked", expected)


def is_text(array: NDArray[Any]) -> bool:
    """True if an array from a file has texts that Python can read.

    numpy looks at no character itself.
    """
    if array.dtype.kind != "U":
        return False
    if not array.dtype.itemsize or not array.size:
        return True
    native = np.ascontiguousarray(array.astype(array.dtype.newbyteorder("=")))
    return int(native.reshape(-1).view(np.uint32).max()) <= sys.maxunicode


def refuse_bomb(n_bytes: int, where: str) -> None:
    """Raise InputError if a packed file unpacks to more than is honest.

    `where` is the packed file, `n_bytes` its size when unpacked.
    """
    check_unpacked(n_bytes, where)
    _refuse_ratio(n_bytes, Path(where).stat().st_size, where)


def _refuse_ratio(n_bytes: int, n_packed: int, where: str) -> None:
    if n_bytes > max(_SMALL_BYTES, MAX_RATIO * n_packed):
        got = f"{n_bytes:,} bytes or more out of {max(1, n_packed):,}"
        refuse(where, got, f"at most {MAX_RATIO} times as many")


# ---------- Parquet
@contextmanager
def open_parquet(path: Path, *, max_bytes: int, expected: str) -> Iterator[Any]:
    """Open a Parquet file, with its texts as dictionaries.

    Raises
    ------
    InputError
        The file is damaged, or too few bytes hold too many values.
    """
    import pyarrow as pa
    from pyarrow import parquet

    damage = (OSError, ValueError, pa.ArrowException)
    with open_file(path, max_bytes=max_bytes) as file, reading(path, expected, *damage):
        found = parquet.read_metadata(file)
        groups = [found.row_group(index) for index in range(found.num_row_groups)]
        columns = [
            group.column(at) for group in groups for at in range(group.num_columns)
        ]
        n_values = sum(column.num_values for column in columns)
        n_bytes = max(
            _VALUE_BYTES * n_values, sum(group.total_byte_size for group in groups)
        )
        _refuse_ratio(n_bytes, os.fstat(file.fileno()).st_size, str(path))
        schema = [found.schema.column(index) for index in range(found.num_columns)]
        texts = [
            column.path for column in schema if column.physical_type == "BYTE_ARRAY"
        ]
        file.seek(0)
        with parquet.ParquetFile(file, metadata=found, read_dictionary=texts) as opened:
            yield opened


# ---------- XML
def read_xml(path: Path, *, expected: str) -> Element:
    """Read a whole XML document and return its root.

    `expected` names the format, such as "OpenDRIVE".

    Raises InputError if the file cannot be read, is larger than half a gigabyte, is not
    well-formed, or has entities or other dangerous parts.
    """
    from defusedxml.ElementTree import parse

    with _open_xml(path, expected, f"{expected}: well-formed XML") as file:
        root: Element = parse(file, forbid_dtd=False).getroot()
    return root


def read_xml_root(path: Path) -> Element:
    """The first element of an XML document, without its content.

    Raises
    ------
    InputError
        As :func:`read_xml`.
    """
    from defusedxml.ElementTree import iterparse

    with _open_xml(path, "XML", "well-formed XML") as file:
        for _, element in iterparse(file, events=("start",), forbid_dtd=False):
            first: Element = element
            return first
    refuse(str(path), "no element", "well-formed XML")


@contextmanager
def _open_xml(path: Path, expected: str, well_formed: str) -> Iterator[BinaryIO]:
    from defusedxml import DefusedXmlException

    with reading(path, well_formed, ParseError, ValueError, LookupError):
        # Of encodings.
        try:
            with open_file(path, max_bytes=MAX_FILE_BYTES) as file:
                yield file
        except DefusedXmlException as error:
            refuse(str(path), type(error).__name__, f"{expected} without entities")


def local_name(element: Element) -> str:
    """Name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


# ---------- JSON
def parse_object(text: str, where: str, expected: str) -> Mapping[str, Any]:
    """Parse a JSON object; raises InputError if it is none, or is nested too deeply."""
    try:
        document = parse_json(text, where, expected)
    except InputError as error:
        raise InputError(where, error.got, f"{expected}: valid JSON") from None
    if not isinstance(document, dict):
        refuse(where, type(document).__name__, f"{expected}: an object")
    return document


# ---------- glTF
_Size = Annotated[int, Meta(ge=0)]


class _Accessor(Struct, frozen=True):
    count: Annotated[int, Meta(ge=0, le=_MAX_COUNT)]


class _View(Struct, frozen=True):
    byteOffset: _Size = 0
    byteLength: _Size = 0
    byteStride: _Size = 0


class _Node(Struct, frozen=True):
    children: tuple[_Size, ...] = ()


class _Gltf(Struct, frozen=True):
    accessors: tuple[_Accessor, ...] = ()
    bufferViews: tuple[_View, ...] = ()
    nodes: Annotated[tuple[_Node, ...], Meta(max_length=_MAX_NODES)] = ()
    extensionsRequired: tuple[str, ...] = ()


class NoFiles:
    """Resolver for trimesh that opens no file: a mesh has all its data in itself."""

    def __init__(self, where: str) -> None:
        self._where = where

    def __getitem__(self, name: str) -> bytes:
        """Raise InputError: the mesh names a file."""
        got = f"a reference to {str(name)[:100]!r}"
        refuse(self._where, got, "all of its data in the file itself")

    get = __getitem__


def check_gltf(path: Path) -> None:
    """Check the claims of a glTF 2 file before memory is given to it.

    Raises InputError if it is no glTF 2; claims more elements than five million
    triangles have; or has nodes with several parents, or that are their own ancestors.
    """
    where = str(path)
    if path.suffix.lower() == ".glb":
        text = _binary_header(path)
    else:
        text = read_bytes(path)
    if len(text) > _MAX_JSON_BYTES:
        refuse(where, f"{len(text):,} bytes of JSON", f"{_MAX_JSON_BYTES:,}")
    document = parse_object(text.decode("utf-8", "replace"), where, "glTF")
    known = {key: document[key] for key in _Gltf.__struct_fields__ if key in document}
    header = read_table(known, _Gltf, where)
    children = [child for node in header.nodes for child in node.children]
    if max(children, default=-1) >= len(header.nodes):
        raise InputError(f"{where}: nodes.children", max(children), "indices of nodes")
    if again := [child for child, number in Counter(children).items() if number > 1]:
        refuse(f"{where}: nodes[{again[0]}]", "two parents", "one")
    reached = sorted({*range(len(header.nodes))} - {*children})
    # Grows while it is walked through.
    for index in reached:
        reached += header.nodes[index].children
    if len(reached) < len(header.nodes):
        refuse(f"{where}: nodes", "a node that is its own ancestor", "a tree")
    for name in header.extensionsRequired:
        if "compression" in name.lower():
            refuse(where, f"compression {name}", "a plain glTF")


def _binary_header(path: Path) -> bytes:
    with open_file(path) as file:
        head = file.read(20)
        if len(head) < 20 or head[:4] != b"glTF":
            refuse(str(path), "something else", "a binary glTF")
        version, _, length, kind = struct.unpack("<4I", head[4:])
        if version != 2 or kind != 0x4E4F534A:
            raise InputError(f"{path}: version", version, "2, with JSON first")
        return file.read(min(length, _MAX_JSON_BYTES + 1))


# ---------- PBF of OpenStreetMap
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
                raise _DamagedError("a blob that is too large when unpacked")
            return unpacked
    raise _DamagedError("a blob packed in another way than with zlib")


def _texts(block: bytes) -> Iterator[bytes]:
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
