"""Results cached on disk for the next call, under a hash of all that they were made from.

What is read is data: arrays without pickles, and values along their type hints. It is neither read
nor written in a folder into which other users may write.
"""

import hashlib
import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from geometry.files import write_atomically
from geometry.private_folders import open_own, trouble_with

from .cache_values import from_bytes, to_bytes

_log = logging.getLogger(__name__)

Arrays = dict[str, NDArray[Any]]
_T = TypeVar("_T")

# ---------- hashes


class Fingerprints:
    """Hashes of values by what they hold; what occurs in several of them is read once."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[object, bytes]] = {}  # the object is held: its id stays its

    def of(self, *values: object) -> str:
        """Hash of values, 32 hexadecimal digits: dataclasses by their fields, arrays by content."""
        return self._digest(values).hex()

    def _digest(self, value: object) -> bytes:
        is_data = is_dataclass(value) and not isinstance(value, type)
        if is_data and id(value) in self._known:
            return self._known[id(value)][1]
        digest = hashlib.blake2b(type(value).__name__.encode() + b"\0", digest_size=16)
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        elif is_data:
            for field in fields(value):  # type: ignore[arg-type]
                digest.update(field.name.encode() + self._digest(getattr(value, field.name)))
            self._known[id(value)] = (value, digest.digest())
        elif isinstance(value, Mapping):
            for key, item in value.items():
                digest.update(self._digest(key) + self._digest(item))
        elif isinstance(value, tuple | list):
            for item in value:
                digest.update(self._digest(item))
        elif value is None or isinstance(value, str | bytes | int | float | np.generic):
            digest.update(repr(value).encode())
        else:
            raise TypeError(f"a value of a kind that has no hash: {value!r}")
        return digest.digest()


# ---------- files


def save_arrays(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    *,
    what: str,
    kind: str,
    fingerprint: str,
    is_compressed: bool = False,
) -> None:
    """Write arrays, whole or not at all; a folder that cannot be written to is only logged.

    `what` is their name in messages, `kind` that of the file's format.
    """
    save = np.savez_compressed if is_compressed else np.savez
    content: dict[str, Any] = {
        "format": kind,
        "fingerprint": fingerprint,
        "content": content_hash(arrays, fingerprint),
        **arrays,
    }
    _write(path, lambda file: save(file, **content), what=what)


def _write(path: Path, write: Callable[[BinaryIO], object], *, what: str) -> bool:
    """Write a file, whole or not at all; what cannot be written is only logged."""
    if not _is_usable(path.parent):
        return False
    try:
        write_atomically(path, write, is_private=True)
    except OSError as error:
        _log.warning("%s not cached: %s: %s", what, path, error.strerror or error)
        return False
    return True


@cache
def _is_usable(folder: Path) -> bool:
    """Whether a folder can hold a cache, made if it is missing; says once if it cannot."""
    trouble = trouble_with(folder)
    if trouble:
        _log.warning("nothing is cached: %s %s", folder, trouble)
    return not trouble


def load_arrays(path: Path, *, what: str, kind: str, fingerprint: str) -> Arrays | None:
    """Read arrays of a fingerprint; None, and logged, if the file is damaged or foreign."""
    if not path.parent.is_dir() or not _is_usable(path.parent):
        return None
    try:
        # Opened here: numpy does not close a file that turns out to be no archive.
        with open_own(path) as file, np.load(file, allow_pickle=False) as stored:
            if str(stored["format"]) != kind or str(stored["fingerprint"]) != fingerprint:
                raise ValueError("made from other inputs")
            content = str(stored["content"])
            names = [name for name in stored.files if name not in _OWN]
            arrays = {name: stored[name] for name in names}
            if content != content_hash(arrays, fingerprint):
                raise ValueError("its content is not what was written")
    except FileNotFoundError:
        return None
    except Exception as error:  # damaged archives raise many kinds: zipfile's, zlib's, tokenize's
        tell_unused(path, error, what=what)
        return None
    else:
        return arrays


_OWN = ("format", "fingerprint", "content")


def tell_unused(path: Path, error: Exception, *, what: str) -> None:
    """Log that a file is not used, and why."""
    _log.warning("cached %s not used, made anew: %s: %s", what, path, error)


def content_hash(arrays: Mapping[str, NDArray[Any]], fingerprint: str) -> str:
    """Hash of what arrays hold, which fits one fingerprint only: 64 hexadecimal digits."""
    digest = hashlib.blake2b(key=fingerprint.encode(), digest_size=32)
    for name, array in arrays.items():
        digest.update(f"{name} {array.dtype} {array.shape}\0".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


# ---------- many small results of one question


class CachedArrays:
    """Small arrays by key that belong to one fingerprint, such as the frames that units detect.

    Without a folder nothing is cached. Where two processes write at once, what one of them found
    may be lost and made anew later.

    Attributes
    ----------
    arrays : dict of str to array
        What is known, by key.
    """

    def __init__(self, folder: Path | None, name: str, *, kind: str, fingerprint: str) -> None:
        self._what, self._kind, self._fingerprint = name, kind, fingerprint
        self._path = None if folder is None else folder / f"{name}-{fingerprint}.npz"
        self.arrays = self._load()

    def add(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Cache what is new, too; the oldest is given up where there are many."""
        if arrays.keys() <= self.arrays.keys():
            return
        self.arrays |= arrays
        if self._path is None:
            return
        known = self._load() | self.arrays  # another process may have added some
        newest = dict([*known.items()][-MAX_ARRAYS:])
        save_arrays(
            *(self._path, newest),
            what=self._what,
            kind=self._kind,
            fingerprint=self._fingerprint,
            is_compressed=True,
        )
        _prune(self._path, most=MAX_FILES)

    def _load(self) -> Arrays:
        if self._path is None:
            return {}
        found = load_arrays(
            self._path, what=self._what, kind=self._kind, fingerprint=self._fingerprint
        )
        return found or {}


MAX_ARRAYS = 500
"""Arrays in a file; a question has some thirty units, each of a few kilobytes."""

MAX_FILES = 100
"""Files of a name; the oldest are removed."""


MAX_VALUES = 20
"""Files of a name of values of any kind, which may have some 20 MB each."""


def _prune(path: Path, *, most: int) -> None:
    pattern = f"{path.name.split('-')[0]}-*{path.suffix}"
    try:
        files_by_age = sorted(path.parent.glob(pattern), key=lambda file: file.stat().st_mtime)
        for file in files_by_age[:-most]:
            file.unlink(missing_ok=True)
    except OSError as error:  # somebody else tidies up, or nothing may be removed
        _log.info("%s: %s", path.parent, error)


# ---------- values of any kind


ALL_PACKAGES = ("geometry", "scenarios", "placement")
"""All whose code may decide an answer."""


def cached_value(
    folder: Path | None,
    name: str,
    make: Callable[[], _T],
    *,
    kind: Any,
    made_from: Sequence[object],
    packages: Sequence[str] = ALL_PACKAGES,
    classes: Sequence[type] = (),
    is_worth_it: Callable[[_T], bool] = lambda value: True,
) -> _T:
    """What `make` gives, from the last call that asked for the same.

    Parameters
    ----------
    folder : Path, optional
        Where it is cached; None: nowhere.
    name : str
        Of the value, in messages and in the file's name.
    make : function
        Makes it, from nothing but `made_from` and what the packages hold.
    kind : type hint
        Of the value; see :mod:`placement.cache_values`.
    made_from : sequence of object
        See :class:`Fingerprints`.
    packages : sequence of str
        Whose code and data make it: any change of their files makes it anew.
    classes : sequence of type
        Dataclasses that stand where the hints of `kind` name a protocol.
    is_worth_it : function
        Whether a value is cached, such as one that needed no more time than it was given.

    Returns
    -------
    value : object
        Equal to what `make` gives, and arrays that are read-only there are so here.
    """
    if folder is None:
        return make()
    fingerprint = Fingerprints().of(hash_of_code(packages), *made_from)
    path = folder / f"{name}-{fingerprint}.msgpack"
    found = _load_value(path, name, kind, fingerprint, classes)
    if found is not None:
        return cast(_T, found)
    value = make()
    if is_worth_it(value):
        content = to_bytes(value)
        key = _key(content, fingerprint)
        if _write(path, lambda file: file.write(key + content), what=name):
            _prune(path, most=MAX_VALUES)
    return value


def _load_value(
    path: Path, name: str, kind: Any, fingerprint: str, classes: Sequence[type]
) -> object:
    """A value from a file; None, and logged, if that is damaged or foreign."""
    if not path.parent.is_dir() or not _is_usable(path.parent):
        return None
    try:
        with open_own(path) as file:
            stored = file.read()
        if _key(stored[_HASH_SIZE:], fingerprint) != stored[:_HASH_SIZE]:
            raise ValueError("its content is not what was written")
        found: object = from_bytes(stored[_HASH_SIZE:], kind, classes=classes)
    except FileNotFoundError:
        return None
    except Exception as error:  # what is damaged raises anything
        tell_unused(path, error, what=name)
        return None
    _log.info("%s (cached): read from %s", name, path)
    return found


def _key(content: bytes, fingerprint: str) -> bytes:
    """Hash of a file's content, which fits one fingerprint only."""
    return hashlib.blake2b(content, key=fingerprint.encode(), digest_size=_HASH_SIZE).digest()


_HASH_SIZE = 32
_LIBRARIES = ("numpy", "scipy", "numba", "cvxpy", "highspy", "osqp")


def hash_of_code(packages: Sequence[str] = ALL_PACKAGES) -> str:
    """Hash of code and data of packages, and of the libraries that decide their results."""
    code = (sys.version, *map(version, _LIBRARIES), *map(hash_of_files, packages))
    return Fingerprints().of(code)


@cache
def hash_of_files(package: str) -> bytes:
    """Hash of a package's code and data."""
    digest = hashlib.blake2b(digest_size=16)
    folder = Path(str(files(package)))
    for path in sorted(folder.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            digest.update(f"{path.relative_to(folder)}\0{path.stat().st_size}\0".encode())
            digest.update(path.read_bytes())
    return digest.digest()
