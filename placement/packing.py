"""Frozen values to and from MessagePack.

Arrays and shared parts are kept as they were. An array, dataclass, Struct or
named tuple is written once, wherever it occurs: after its parts, in a list. In
its place stands its number in that list, as an extension type of MessagePack.
"""

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from geometry.phrases import Phrase, pack_phrase, unpack_phrase

# Code of an extension type: number of a part in the list, big-endian.
_PLACE = 1
# Code of another: template and fields of a phrase.
_PHRASE = 2
# Stands in place of a class's name.
_ARRAY = ""
_PLAIN = (bool, int, float, str, bytes, NoneType)


def to_bytes(value: object) -> bytes:
    """Bytes of a value.

    Raises TypeError unless it is made of what this module's docstring names.
    Besides those these are tuples, numbers, text, bytes and None; arrays are of
    numbers.
    """
    # The last one is the value itself.
    parts: list[Any] = []
    # Holds what it knows by identity.
    places: dict[int, tuple[object, msgspec.msgpack.Ext]] = {}

    def plain(value: Any) -> Any:
        """A value as MessagePack has it; parts are replaced by their place."""
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, Phrase):
            packed = msgspec.msgpack.encode(pack_phrase(value))
            return msgspec.msgpack.Ext(_PHRASE, packed)
        if isinstance(value, _PLAIN):
            return value
        if type(value) is tuple:
            return [plain(item) for item in value]
        if id(value) not in places:
            parts.append(_take_apart(value, plain))
            place = (len(parts) - 1).to_bytes(4, "big")
            places[id(value)] = (value, msgspec.msgpack.Ext(_PLACE, place))
        return places[id(value)][1]

    parts.append(plain(value))
    return msgspec.msgpack.encode([msgspec.msgpack.encode(part) for part in parts])


def _take_apart(value: Any, plain: Any) -> list[Any]:
    """An array, or a class and its fields, as a list of plain values."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biuf":
            raise TypeError(f"an array that is not of numbers: {value.dtype}")
        is_writeable = bool(value.flags.writeable)
        return [
            _ARRAY,
            value.dtype.str,
            list(value.shape),
            is_writeable,
            value.tobytes(),
        ]
    kind: Any = type(value)
    if not _has_fields(kind):
        raise TypeError(f"a value that cannot be cached: {value!r}")
    names = _field_names(kind)
    return [_name_of(kind), *(plain(getattr(value, name)) for name in names)]


def from_bytes(content: bytes, hint: Any, *, classes: Sequence[type] = ()) -> Any:
    """Value of a type hint from :func:`to_bytes`.

    Only classes that the hint names, directly or within others, and `classes` are made.
    Raises an exception of any kind if the bytes are of something else.
    """
    known = {
        _name_of(one): one for kind in (hint, *classes) for one in _classes_in(kind)
    }
    # Parts are made in order: each refers only to those before it.
    made: list[Any] = []

    def find(code: int, data: memoryview) -> Any:
        if code == _PHRASE:
            return unpack_phrase(msgspec.msgpack.decode(data))
        if code != _PLACE:
            raise ValueError(f"its content is of another kind: {code}")
        return made[int.from_bytes(data, "big")]

    decoder = msgspec.msgpack.Decoder(ext_hook=find)
    *parts, root = msgspec.msgpack.decode(content, type=list[bytes])
    for part in parts:
        name, *values = decoder.decode(part)
        if name == _ARRAY:
            made.append(_array(*values))
        elif name in known:
            named = zip(_field_names(known[name]), map(_tuples, values), strict=True)
            made.append(known[name](**dict(named)))
        else:
            raise ValueError(f"its content is of another kind: {name}")
    value = _tuples(decoder.decode(root))
    if not _is_of(value, hint):
        raise ValueError(f"its content is of another kind: {type(value).__name__}")
    return value


def _array(dtype: str, shape: list[int], is_writeable: bool, content: bytes) -> Any:
    """Array from its bytes; ValueError unless it is of numbers."""
    if np.dtype(dtype).kind not in "biuf":
        raise ValueError(f"an array that is not of numbers: {dtype}")
    array = np.frombuffer(content, dtype).reshape(shape)
    if is_writeable:
        return array.copy()
    return array


def _tuples(value: Any) -> Any:
    """The same with tuples in place of lists: no list is ever written."""
    if isinstance(value, list):
        return tuple(map(_tuples, value))
    return value


def _is_of(value: Any, hint: Any) -> bool:
    """True if a value is of the classes that a hint names.

    Of a tuple, every item is checked.
    """
    # Items of a tuple are checked one by one.
    named = get_args(hint)
    if get_origin(hint) is tuple:
        if type(value) is not tuple:
            return False
        if named[1:] == (...,):
            return all(_is_of(item, named[0]) for item in value)
        return len(named) == len(value) and all(map(_is_of, value, named))
    return any(
        isinstance(one, type) and isinstance(value, one) for one in named or (hint,)
    )


def _has_fields(kind: Any) -> bool:
    if not isinstance(kind, type):
        return False
    is_named_tuple = issubclass(kind, tuple) and hasattr(kind, "_fields")
    return is_named_tuple or is_dataclass(kind) or issubclass(kind, msgspec.Struct)


def _name_of(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


@cache
def _field_names(kind: Any) -> tuple[str, ...]:
    """Names with which a dataclass, Struct or named tuple is made."""
    if issubclass(kind, msgspec.Struct):
        return tuple(kind.__struct_fields__)
    if issubclass(kind, tuple):
        return tuple(kind._fields)
    return tuple(field.name for field in fields(kind) if field.init)


@cache
def _classes_in(hint: Any) -> frozenset[type]:
    """Classes with fields that a type hint names, directly or within others."""
    # Walk through the hint and the hints of the fields that it names.
    found: set[type] = set()
    pending = [hint]
    while pending:
        one = pending.pop()
        if _has_fields(one) and one not in found:
            found.add(one)
            pending.extend(get_type_hints(one).values())
        pending.extend(part for part in get_args(one) if not isinstance(part, str))
    return frozenset(found)
