"""Results cached on disk, under a hash of everything they depend on.

What is read is data, never a pickle, and only from a folder into which nobody else may
write. A file is written whole or not at all; one that is damaged, or of other inputs,
is made anew.
"""

import hashlib
import logging
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from geometry.cache_folders import open_own, trouble_with
from geometry.writing import write_atomically

from .fingerprints import ALL_PACKAGES, Fingerprints, hash_of_code
from .packing import from_bytes, to_bytes

_log = logging.getLogger(__name__)

Arrays = dict[str, NDArray[Any]]
_T = TypeVar("_T")
# Of a file of arrays, besides these.
_OWN = ("format", "fingerprint", "content")
_HASH_SIZE = 32
# Arrays in a file; a question has some thirty units, each of a few kilobytes.
MAX_ARRAYS = 500
# Files of a name; the oldest are removed.
MAX_FILES = 100
# Files of a name of values of any kind, which may have some 20 MB each.
MAX_VALUES = 20


# ---------- files
def _write(path: Path, write: Callable[[BinaryIO], object], *, what: str) -> bool:
    """Write a file, whole or not at all; a failure is only logged."""
    if not _is_usable(path.parent):
        return False
    try:
        write_atomically(path, write, is_private=True)
    except OSError as error:
        _log.warning("%s not cached: %s: %s", what, path, error.strerror or error)
        return False
    return True


def _read(path: Path, read: Callable[[BinaryIO], _T], *, what: str) -> _T | None:
    """Content of a file; None, and logged, if it is damaged or foreign."""
    if not path.parent.is_dir() or not _is_usable(path.parent):
        return None
    try:
        with open_own(path) as file:
            return read(file)
    except FileNotFoundError:
        return None
    except Exception as error:
        # Damaged archives raise many kinds: zipfile's, zlib's, tokenize's.
        tell_unused(path, error, what=what)
        return None


def tell_unused(path: Path, error: Exception, *, what: str) -> None:
    """Log that a file is not used, and why."""
    _log.warning("cached %s not used, made anew: %s: %s", what, path, error)


@cache
def _is_usable(folder: Path) -> bool:
    """True if a folder can hold a cache; it is made if it is missing.

    A folder that cannot is logged once.
    """
    trouble = trouble_with(folder)
    if trouble:
        _log.warning("nothing is cached: %s %s", folder, trouble)
    return not trouble


def _prune(path: Path, *, most: int) -> None:
    """Remove the oldest files of the same name and kind as a path."""
    pattern = f"{path.name.split('-')[0]}-*{path.suffix}"
    try:
        # Files are sorted by the time of their last change, the oldest first.
        files_by_age = sorted(
            path.parent.glob(pattern), key=lambda file: file.stat().st_mtime
        )
        for file in files_by_age[:-most]:
            file.unlink(missing_ok=True)
    except OSError as error:
        # Somebody else tidies up, or nothing may be removed.
        _log.info("%s: %s", path.parent, error)


# ---------- arrays
def save_arrays(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    *,
    what: str,
    kind: str,
    fingerprint: str,
    is_compressed: bool = False,
) -> None:
    """Write arrays, whole or not at all.

    A folder that cannot be written to is only logged. `what` is their name in
    messages, `kind` that of the format.
    """
    if is_compressed:
        save = np.savez_compressed
    else:
        save = np.savez
    # The file says of what kind and of which inputs it is.
    content: dict[str, Any] = {
        "format": kind,
        "fingerprint": fingerprint,
        "content": content_hash(arrays, fingerprint),
        **arrays,
    }
    _write(path, lambda file: save(file, **content), what=what)


def load_arrays(path: Path, *, what: str, kind: str, fingerprint: str) -> Arrays | None:
    """Read arrays of a fingerprint; None if the file does not fit.

    That the file is damaged or was made from other inputs is logged.
    """

    def read(file: BinaryIO) -> Arrays:
        """Arrays of an open file; ValueError if it is of other inputs."""
        # Opened before: numpy does not close a file that turns out to be no archive.
        with np.load(file, allow_pickle=False) as stored:
            if (
                str(stored["format"]) != kind
                or str(stored["fingerprint"]) != fingerprint
            ):
                raise ValueError("made from other inputs")
            arrays = {name: stored[name] for name in stored.files if name not in _OWN}
            if str(stored["content"]) != content_hash(arrays, fingerprint):
                raise ValueError("its content is not what was written")
        return arrays

    return _read(path, read, what=what)


def content_hash(arrays: Mapping[str, NDArray[Any]], fingerprint: str) -> str:
    """Hash of what arrays hold, 64 hexadecimal digits.

    It is keyed with the fingerprint, so that it fits no other one.
    """
    digest = hashlib.blake2b(key=fingerprint.encode(), digest_size=32)
    # Name, type and shape belong to the content.
    for name, array in arrays.items():
        digest.update(f"{name} {array.dtype} {array.shape}\0".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


# ---------- many small results of one question
class CachedArrays:
    """Small cached arrays by key, all of one fingerprint.

    An example are the frames that each unit detects. They are in `arrays`; without
    a folder nothing is cached. Where two processes write at once, what one of them
    found may be lost.
    """

    def __init__(
        self, folder: Path | None, name: str, *, kind: str, fingerprint: str
    ) -> None:
        self._what = name
        self._kind = kind
        self._fingerprint = fingerprint
        if folder is None:
            self._path = None
        else:
            self._path = folder / f"{name}-{fingerprint}.npz"
        self.arrays = self._load()

    def add(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Cache what is new, too; the oldest is given up where there are many."""
        if arrays.keys() <= self.arrays.keys():
            return
        self.arrays |= arrays
        if self._path is None:
            return
        # Another process may have added some.
        known = self._load() | self.arrays
        newest = dict([*known.items()][-MAX_ARRAYS:])
        save_arrays(
            self._path,
            newest,
            what=self._what,
            kind=self._kind,
            fingerprint=self._fingerprint,
            is_compressed=True,
        )
        _prune(self._path, most=MAX_FILES)

    def _load(self) -> Arrays:
        """Arrays in the file; none where there is no usable file."""
        if self._path is None:
            return {}
        found = load_arrays(
            self._path, what=self._what, kind=self._kind, fingerprint=self._fingerprint
        )
        return found or {}


# ---------- values of any kind
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
    """Value of `make`, or the cached one of an earlier call.

    Without a folder, and for other inputs than before, it is made. `make` uses
    nothing but `made_from` (see :class:`Fingerprints`) and the files of `packages`.
    `kind` is the value's type hint; `classes` are dataclasses that stand where it
    names a protocol. Only a value that `is_worth_it` is cached. Arrays that are
    read-only stay so.
    """
    if folder is None:
        return make()
    # The fingerprint covers the code and everything that the value is made from.
    fingerprint = Fingerprints().of(hash_of_code(packages), *made_from)
    path = folder / f"{name}-{fingerprint}.msgpack"

    def read(file: BinaryIO) -> _T:
        stored = file.read()
        if _key(stored[_HASH_SIZE:], fingerprint) != stored[:_HASH_SIZE]:
            raise ValueError("its content is not what was written")
        return cast(_T, from_bytes(stored[_HASH_SIZE:], kind, classes=classes))

    found = _read(path, read, what=name)
    if found is not None:
        _log.info("%s (cached): read from %s", name, path)
        return found
    # Nothing was cached: compute the value, and cache it if that is worth it.
    value = make()
    if is_worth_it(value):
        content = to_bytes(value)
        key = _key(content, fingerprint)
        if _write(path, lambda file: file.write(key + content), what=name):
            _prune(path, most=MAX_VALUES)
    return value


def _key(content: bytes, fingerprint: str) -> bytes:
    """Hash of a file's content, which fits one fingerprint only."""
    return hashlib.blake2b(
        content, key=fingerprint.encode(), digest_size=_HASH_SIZE
    ).digest()
