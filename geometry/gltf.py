"""Check glTF files of users before trimesh reads them.

A header may claim more than the file holds, and trimesh would give memory to it.
"""

import struct
from collections import Counter
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from .errors import InputError, refuse
from .opening import open_file, read_bytes
from .tables import read_table
from .text_formats import parse_object

# Elements of one accessor: five million triangles have 15 million indices
_MAX_COUNT = 20_000_000
_MAX_NODES = 200_000
_MAX_JSON_BYTES = 100_000_000
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

    Raises
    ------
    InputError
        It is no glTF 2; claims more elements than five million triangles have;
        or has nodes with several parents, or that are their own ancestors.
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
    """JSON of a .glb file, cut off beyond the largest that is read.

    Raises
    ------
    InputError
        The file is no binary glTF 2 that begins with JSON.
    """
    with open_file(path) as file:
        head = file.read(20)
        if len(head) < 20 or head[:4] != b"glTF":
            refuse(str(path), "something else", "a binary glTF")
        version, _, length, kind = struct.unpack("<4I", head[4:])
        if version != 2 or kind != 0x4E4F534A:
            raise InputError(f"{path}: version", version, "2, with JSON first")
        return file.read(min(length, _MAX_JSON_BYTES + 1))
