"""What a glTF file claims, looked at before memory is given to it."""

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError, Unquoted
from .json_files import parse_json

_MAX_COUNT = 20_000_000  # elements of one accessor: five million triangles have 15 million indices
_MAX_NODES = 200_000
_MAX_JSON_BYTES = 100_000_000


def check_gltf(path: Path) -> None:
    """Refuse claims that a file cannot keep.

    Raises
    ------
    InputError
        It is no glTF 2, or no JSON; it claims more elements than five million triangles have,
        several parents for a node, or nodes that are their own ancestors.
    OSError
        It cannot be read.
    """
    where = str(path)
    text = _binary_header(path) if path.suffix.lower() == ".glb" else path.read_bytes()
    if len(text) > _MAX_JSON_BYTES:
        raise InputError(where, Unquoted(f"{len(text):,} bytes of JSON"), f"{_MAX_JSON_BYTES:,}")
    header = parse_json(text.decode("utf-8", "replace"), where, "glTF")
    for accessor in _entries(header, "accessors", where):
        count = accessor.get("count")
        if not isinstance(count, int) or not 0 <= count <= _MAX_COUNT:
            raise InputError(f"{where}: accessors.count", count, f"0 to {_MAX_COUNT:,}")
    for view in _entries(header, "bufferViews", where):
        for key in ("byteOffset", "byteLength", "byteStride"):
            value = view.get(key, 0)
            if not isinstance(value, int) or value < 0:
                raise InputError(f"{where}: bufferViews.{key}", value, "a number of bytes")
    _check_tree(_entries(header, "nodes", where), where)
    required = header.get("extensionsRequired")
    if isinstance(required, list):
        compressed = [str(name) for name in required if "compression" in str(name).lower()]
        if compressed:
            raise InputError(where, Unquoted(f"compression {compressed[0]}"), "a plain glTF")


def _binary_header(path: Path) -> bytes:
    """JSON of a .glb file."""
    with path.open("rb") as file:
        head = file.read(20)
        if len(head) < 20 or head[:4] != b"glTF":
            raise InputError(str(path), Unquoted("something else"), "a binary glTF")
        version, _, length, kind = struct.unpack("<4I", head[4:])
        if version != 2 or kind != 0x4E4F534A:
            raise InputError(f"{path}: version", version, "2, with JSON first")
        return file.read(min(length, _MAX_JSON_BYTES + 1))


def _entries(header: Mapping[str, Any], key: str, where: str) -> list[Mapping[str, Any]]:
    entries = header.get(key, [])
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        raise InputError(f"{where}: {key}", json.dumps(entries)[:80], "a list of tables")
    return entries


def _check_tree(nodes: list[Mapping[str, Any]], where: str) -> None:
    """Every node has at most one parent, and none is its own ancestor."""
    if len(nodes) > _MAX_NODES:
        raise InputError(f"{where}: nodes", len(nodes), f"at most {_MAX_NODES:,}")
    parent: dict[int, int] = {}
    for index, node in enumerate(nodes):
        children = node.get("children", [])
        if not isinstance(children, list):
            raise InputError(f"{where}: nodes[{index}].children", children, "a list")
        for child in children:
            if not isinstance(child, int) or not 0 <= child < len(nodes):
                raise InputError(f"{where}: nodes[{index}].children", child, "indices of nodes")
            if child in parent:
                raise InputError(f"{where}: nodes[{child}]", Unquoted("two parents"), "one")
            parent[child] = index
    reached = [index for index in range(len(nodes)) if index not in parent]
    for index in reached:  # grows while it is walked through
        reached += nodes[index].get("children", [])
    if len(reached) < len(nodes):
        raise InputError(f"{where}: nodes", Unquoted("a node that is its own ancestor"), "a tree")
