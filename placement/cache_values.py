"""Frozen values as plain data and back, for the cache: what is read is data, never code.

A value is written as MessagePack: dataclasses and arrays stand in two lists, each once however
often it occurs, and are named by their numbers. It is read along type hints, which say what may
stand where; anything else is refused.
"""

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

_PLAIN = (bool, int, float, str, NoneType)


def to_bytes(value: object) -> bytes:
    """A value of dataclasses, named tuples, tuples, arrays, numbers and text as bytes.

    Raises
    ------
    TypeError
        It has a part of another kind.
    """
    writer = _Writer()
    root = writer.plain(value)
    return msgspec.msgpack.encode((writer.objects, writer.arrays, root))


def from_bytes(content: bytes, hint: Any, *, classes: Sequence[type] = ()) -> Any:
    """A value of a type hint from bytes; dataclasses and arrays are shared as they were.

    `classes` are dataclasses that stand where a hint names a protocol.

    Raises
    ------
    Exception
        Of any kind: the bytes are of something else.
    """
    objects, arrays, root = msgspec.msgpack.decode(content, type=_Content)
    return _Reader(objects, arrays, {one.__name__: one for one in classes}).value(root, hint)


_Objects = list[tuple[str, list[Any]]]  # name and fields; parts come before what they are part of
_Arrays = list[tuple[str, list[int], bool, bytes]]  # type, shape, whether writeable, content
_Content = tuple[_Objects, _Arrays, Any]


class _Writer:
    """Lists of what was met; it is held, so that its identity stays its own."""

    def __init__(self) -> None:
        self.objects: _Objects = []
        self.arrays: _Arrays = []
        self._known: dict[int, tuple[object, int]] = {}

    def plain(self, value: Any) -> Any:
        """A number, text, or a list; that of a dataclass or an array is its place."""
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, _PLAIN):
            return value
        if isinstance(value, tuple):
            return [self.plain(item) for item in value]
        if id(value) not in self._known:
            add = self._add_array if isinstance(value, np.ndarray) else self._add_object
            self._known[id(value)] = (value, add(value))
        return self._known[id(value)][1]

    def _add_array(self, array: np.ndarray[Any, Any]) -> int:
        if array.dtype.kind not in "biuf":
            raise TypeError(f"an array that is not of numbers: {array.dtype}")
        shape = list(array.shape)
        self.arrays.append((array.dtype.str, shape, array.flags.writeable, array.tobytes()))
        return len(self.arrays) - 1

    def _add_object(self, value: Any) -> int:
        if not is_dataclass(value):
            raise TypeError(f"a value that cannot be cached: {value!r}")
        parts = [self.plain(getattr(value, one.name)) for one in fields(value) if one.init]
        self.objects.append((type(value).__name__, parts))
        return len(self.objects) - 1


class _Reader:
    """Values by type hints; an object is made when it is first asked for."""

    def __init__(self, objects: _Objects, arrays: _Arrays, classes: dict[str, type]) -> None:
        self._objects, self._classes = objects, classes
        self._arrays = [_array(*one) for one in arrays]
        self._made: dict[int, Any] = {}

    def value(self, plain: Any, hint: Any) -> Any:
        """What a hint says of a plain value; ValueError if that is of another kind."""
        origin, hints = get_origin(hint), get_args(hint)
        if origin in (Union, UnionType):
            return None if plain is None else self.value(plain, *_without_none(hints))
        if origin is Literal:
            if plain in hints:
                return plain
        elif origin is tuple:
            items = hints[:1] * len(plain) if hints[1:] == (...,) else hints
            return tuple(self.value(one, of) for one, of in zip(plain, items, strict=True))
        elif origin is np.ndarray:
            array = self._arrays[plain]
            if array.dtype == get_args(hints[1])[0]:
                return array
        elif hint is float and type(plain) in (float, int):
            return float(plain)
        elif hint in _PLAIN:
            if type(plain) is hint:
                return plain
        elif issubclass(hint, tuple):  # a named one
            parts = zip(plain, get_type_hints(hint).values(), strict=True)
            return hint(*(self.value(part, of) for part, of in parts))
        else:
            return self._object(plain, hint)
        raise ValueError(f"its content is of another kind: {hint}")

    def _object(self, place: int, hint: type) -> Any:
        if place not in self._made:
            name, parts = self._objects[place]
            kind: Any = hint if is_dataclass(hint) else self._classes[name]
            values = zip(parts, _fields(kind), strict=True)
            found = kind(**{field: self.value(part, of) for part, (field, of) in values})
            if kind.__name__ != name:
                raise ValueError(f"its content is of another kind: {name}")
            self._made[place] = found
        found = self._made[place]
        if is_dataclass(hint) and type(found) is not hint:
            raise ValueError(f"its content is of another kind: {type(found).__name__}")
        return found


def _without_none(hints: Sequence[Any]) -> list[Any]:
    return [one for one in hints if one is not NoneType]


def _array(dtype: str, shape: list[int], is_writeable: bool, content: bytes) -> Any:
    if np.dtype(dtype).kind not in "biuf":
        raise ValueError(f"an array that is not of numbers: {dtype}")
    array = np.frombuffer(content, dtype).reshape(shape)
    return array.copy() if is_writeable else array


@cache
def _fields(kind: type) -> tuple[tuple[str, Any], ...]:
    """Names and type hints of the fields with which a dataclass is made."""
    hints = get_type_hints(kind)
    return tuple((one.name, hints[one.name]) for one in fields(kind) if one.init)
