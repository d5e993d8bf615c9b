"""Check glTF files of users before trimesh reads them.

A header may claim more than the file holds, and trimesh would give memory to it.
"""

import struct
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct

from .errors import InputError, refuse
from .opening import MAX_FILE_BYTES, open_file, read_bytes
from .tables import read_table
from .text_formats import parse_object

# Elements of one accessor: five million triangles have 15 million indices
_MAX_COUNT = 20_000_000
_MAX_NODES = 200_000
_MAX_JSON_BYTES = 100_000_000
_Size = Annotated[int, Meta(ge=0)]


class _Accessor(Struct, frozen=True):
    count: Annotated[int, Meta(ge=0, le=_MAX_COUNT)]


class _BufferView(Struct, frozen=True):
    byteOffset: _Size = 0
    byteLength: _Size = 0
    byteStride: _Size = 0


class _Data(Struct, frozen=True):
    uri: str | None = None


class _Node(Struct, frozen=True):
    children: tuple[_Size, ...] = ()


class _Gltf(Struct, frozen=True):
    accessors: tuple[_Accessor, ...] = ()
    buffers: tuple[_Data, ...] = ()
    bufferViews: tuple[_BufferView, ...] = ()
    images: tuple[_Data, ...] = ()
    nodes: Annotated[tuple[_Node, ...], Meta(max_length=_MAX_NODES)] = ()
    extensionsRequired: tuple[str, ...] = ()


def mesh_resolver(path: Path, *, where: str = "", is_beside: bool = False) -> Any:
    """A resolver for trimesh that opens nothing outside of a mesh's own file.

    `is_beside`: the format keeps its geometry in files beside it; those are opened, if
    they are regular files in the mesh's folder, or below it, and all of them together
    have a mesh's size. `where` names the mesh in messages; empty: its path. The
    resolver's ``get`` raises InputError.
    """
    from trimesh.resolvers import Resolver

    shown, folder = where or str(path), path.resolve().parent

    class OwnResolver(Resolver):  # type: ignore[misc]
        def __init__(self) -> None:
            self._n_left = MAX_FILE_BYTES

        def get(self, name: str) -> bytes:
            got = f"a reference to {name[:100]!r}"
            if not is_beside:
                refuse(shown, got, "all of its data in the file itself")
            target = (folder / name.strip()).resolve()
            if "://" in name or not target.is_relative_to(folder):
                refuse(shown, got, "files in its own folder")
            data = read_bytes(target, max_bytes=self._n_left)
            self._n_left -= len(data)
            return data

        def keys(self) -> list[str]:
            return []

        def namespaced(self, namespace: str) -> Any:
            refuse(
                shown, f"a reference to {namespace[:100]!r}", "files in its own folder"
            )

        def write(self, name: str, data: object) -> None:
            raise NotImplementedError(name)

    return OwnResolver()


def check_gltf(path: Path) -> None:
    """Check the claims of a glTF 2 file before memory is given to it.

    A binary one has all of its data in itself: neither a buffer nor an image is another
    file.

    Raises
    ------
    InputError
        It is no glTF 2; claims more elements than five million triangles have;
        or has nodes with several parents, or that are their own ancestors.
    """
    where = str(path)
    is_binary = path.suffix.lower() == ".glb"
    if is_binary:
        text = _binary_header(path)
    else:
        text = read_bytes(path)
    if len(text) > _MAX_JSON_BYTES:
        refuse(where, f"{len(text):,} bytes of JSON", f"{_MAX_JSON_BYTES:,}")
    document = parse_object(text.decode("utf-8", "replace"), where, "glTF")
    known = {key: document[key] for key in _Gltf.__struct_fields__ if key in document}
    header = read_table(known, _Gltf, where)
    for name in ("buffers", "images"):
        for index, data in enumerate(getattr(header, name)):
            if is_binary and data.uri is not None and not data.uri.startswith("data:"):
                got = data.uri[:100]
                expected = "all data in the file itself"
                raise InputError(f"{where}: {name}[{index}].uri", got, expected)
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
