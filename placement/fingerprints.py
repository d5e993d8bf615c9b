"""Hashes of values by what they hold, and of the code that computes with them."""

import hashlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import msgspec
import numpy as np

# All whose code may decide an answer.
ALL_PACKAGES = (
    "geometry",
    "scenarios",
    "placement",
)
_PLAIN = frozenset((str, bytes, bool, int, float, type(None)))
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
        return self._digest(values).hex()

    def _digest(self, value: object) -> bytes:
        """Digest of one value and of everything inside it, 16 bytes."""
        is_data = is_dataclass(value) and not isinstance(value, type)
        if is_data and id(value) in self._known:
            return self._known[id(value)][1]
        # The type is part of the hash: 1 and True differ.
        digest = hashlib.blake2b(type(value).__name__.encode() + b"\0", digest_size=16)
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        elif is_data:
            for field in fields(value):  # type: ignore[arg-type]
                digest.update(
                    field.name.encode() + self._digest(getattr(value, field.name))
                )
            self._known[id(value)] = (value, digest.digest())
        elif isinstance(value, msgspec.Struct):
            digest.update(self._digest(msgspec.structs.asdict(value)))
        elif isinstance(value, Mapping):
            for key, item in value.items():
                digest.update(self._digest(key) + self._digest(item))
        elif isinstance(value, tuple | list) and _are_plain(value):
            # In one go: thousands of names and numbers, each hashed, take long.
            digest.update(repr(value).encode())
        elif isinstance(value, tuple | list):
            for item in value:
                digest.update(self._digest(item))
        elif value is None or isinstance(value, str | bytes | int | float | np.generic):
            digest.update(repr(value).encode())
        else:
            raise TypeError(f"a value of a kind that has no hash: {value!r}")
        return digest.digest()


def _are_plain(values: Sequence[object]) -> bool:
    """True if there are texts and numbers of Python alone, whose text tells all."""
    return all(type(value) in _PLAIN for value in values)


def hash_of_code(packages: Sequence[str] = ALL_PACKAGES) -> str:
    """Hash of packages and of the libraries that decide their results.

    It has 32 hexadecimal digits.
    """
    code = (sys.version, *map(version, _LIBRARIES), *map(hash_of_files, packages))
    return Fingerprints().of(code)


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
