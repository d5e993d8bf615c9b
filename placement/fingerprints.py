"""Hashes of values by what they hold, and of the code that computes with them."""

import hashlib
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import msgspec
import numpy as np

# All whose code may decide an answer.
ALL_PACKAGES = (
    "geometry",
    "scenarios",
    "placement",
)
_PLAIN = frozenset((str, bytes, bool, int, float, type(None)))
# Whose text tells all; of sequences, if all their items are plain.
_WRITTEN = (str, bytes, int, float, np.generic, tuple, list)
_LIBRARIES = ("numpy", "scipy", "numba", "cvxpy", "highspy", "osqp")


class Fingerprints:
    """Hashes of values by their content.

    A value that is part of several others is read once.
    """

    def __init__(self) -> None:
        # By identity; the object is held, so that no other one gets the same.
        self._known: dict[int, tuple[object, bytes]] = {}

    def of(self, *values: object) -> str:
        """Hash of values, 32 hexadecimal digits.

        Dataclasses are hashed by their fields, arrays by type, shape and content.
        Raises TypeError for anything but these, Structs, mappings, sequences, text,
        bytes and numbers.
        """
        digest = hashlib.blake2b(digest_size=16)
        self._feed(digest.update, values)
        return digest.hexdigest()

    def _digest(self, value: object) -> bytes:
        """Digest of a dataclass and of everything inside it, 16 bytes."""
        if id(value) in self._known:
            return self._known[id(value)][1]
        kind: Any = type(value)
        lasts = _can_last(kind)
        if lasts and value in _lasting:
            return _lasting[value]
        digest = hashlib.blake2b(digest_size=16)
        for name in _field_names(kind):
            digest.update(name.encode())
            self._feed(digest.update, getattr(value, name))
        found = digest.digest()
        self._known[id(value)] = (value, found)
        if lasts:
            _lasting[value] = found
        return found

    def _feed(self, update: Callable[[bytes], object], value: object) -> None:
        """Hash a value: its type, how long what follows is, and what it holds."""
        # The type is part of the hash: 1 and True differ.
        name = type(value).__name__
        if isinstance(value, np.ndarray):
            update(f"{name} {value.dtype.str}{value.shape}\0".encode())
            update(np.ascontiguousarray(value).tobytes())
        elif hasattr(type(value), "__dataclass_fields__"):
            update(f"{name}\0".encode() + self._digest(value))
        elif isinstance(value, msgspec.Struct):
            update(f"{name}\0".encode())
            self._feed(update, msgspec.structs.asdict(value))
        elif isinstance(value, Mapping):
            update(f"{name} {len(value)}\0".encode())
            for item in value.items():
                self._feed(update, item)
        elif isinstance(value, tuple | list) and not _are_plain(value):
            update(f"{name} {len(value)}\0".encode())
            for item in value:
                self._feed(update, item)
        elif value is None or isinstance(value, _WRITTEN):
            # Plain sequences in one go: thousands of names and numbers take long.
            text = repr(value)
            update(f"{name} {len(text)}\0{text}".encode(errors="surrogatepass"))
        else:
            raise TypeError(f"a value of a kind that has no hash: {value!r}")


# Digests of values that several hashes are made of, while they live.
_lasting: WeakKeyDictionary[object, bytes] = WeakKeyDictionary()


@cache
def _can_last(kind: Any) -> bool:
    """True for frozen classes that are compared by identity, and can be held weakly."""
    is_itself: bool = kind.__eq__ is object.__eq__
    return is_itself and kind.__weakrefoffset__ != 0


@cache
def _field_names(kind: Any) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


def _are_plain(values: Sequence[object]) -> bool:
    """True if there are texts and numbers of Python alone, whose text tells all."""
    return all(type(value) in _PLAIN for value in values)


def hash_of_code(packages: Sequence[str] = ALL_PACKAGES) -> str:
    """Hash of packages and of the libraries that decide their results.

    It has 32 hexadecimal digits.
    """
    code = (sys.version, *map(version_of, _LIBRARIES), *map(hash_of_files, packages))
    return Fingerprints().of(code)


@cache
def version_of(library: str) -> str:
    """Version of a library that is installed: asked of its files once."""
    return version(library)


@cache
def hash_of_files(package: str) -> bytes:
    """Hash of a package's code and data, 16 bytes."""
    digest = hashlib.blake2b(digest_size=16)
    folder = Path(str(files(package)))
    # Names and sizes are hashed as well as contents.
    for path in sorted(folder.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            digest.update(
                f"{path.relative_to(folder)}\0{path.stat().st_size}\0".encode()
            )
            digest.update(path.read_bytes())
    return digest.digest()
