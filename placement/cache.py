"""Results cached on disk for the next call, under a hash of all that they were made from.

What is read is data: arrays without pickles, values along their type hints; never in a folder
into which other users may write.
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
from types import NoneType, UnionType
from typing import (
    Any,
    BinaryIO,
    Literal,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec
import numpy as np
from numpy.typing import NDArray

from geometry.files import open_own, trouble_with, write_atomically
from geometry.phrases import Phrase, pack_phrase, unpack_phrase

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
        elif isinstance(value, msgspec.Struct):
            digest.update(self._digest(msgspec.structs.asdict(value)))
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

    `what` is their name in messages, `kind` that of the format.
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
    """True if a folder can hold a cache, made if it is missing; says once if it cannot."""
    trouble = trouble_with(folder)
    if trouble:
        _log.warning("nothing is cached: %s %s", folder, trouble)
    return not trouble


def load_arrays(path: Path, *, what: str, kind: str, fingerprint: str) -> Arrays | None:
    """Read arrays of a fingerprint; None, and logged, if the file is damaged or foreign."""

    def read(file: BinaryIO) -> Arrays:
        # Opened before: numpy does not close a file that turns out to be no archive.
        with np.load(file, allow_pickle=False) as stored:
            if str(stored["format"]) != kind or str(stored["fingerprint"]) != fingerprint:
                raise ValueError("made from other inputs")
            arrays = {name: stored[name] for name in stored.files if name not in _OWN}
            if str(stored["content"]) != content_hash(arrays, fingerprint):
                raise ValueError("its content is not what was written")
        return arrays

    return _read(path, read, what=what)


def _read(path: Path, read: Callable[[BinaryIO], _T], *, what: str) -> _T | None:
    """Content of a file; None, and logged, if it is damaged or foreign."""
    if not path.parent.is_dir() or not _is_usable(path.parent):
        return None
    try:
        with open_own(path) as file:
            return read(file)
    except FileNotFoundError:
        return None
    except Exception as error:  # damaged archives raise many kinds: zipfile's, zlib's, tokenize's
        tell_unused(path, error, what=what)
        return None


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

    They are in `arrays`; without a folder nothing is cached. Where two processes write at once,
    what one of them found may be lost.
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


MAX_ARRAYS = 500  # arrays in a file; a question has some thirty units, each of a few kilobytes

MAX_FILES = 100  # files of a name; the oldest are removed


MAX_VALUES = 20  # files of a name of values of any kind, which may have some 20 MB each


def _prune(path: Path, *, most: int) -> None:
    pattern = f"{path.name.split('-')[0]}-*{path.suffix}"
    try:
        files_by_age = sorted(path.parent.glob(pattern), key=lambda file: file.stat().st_mtime)
        for file in files_by_age[:-most]:
            file.unlink(missing_ok=True)
    except OSError as error:  # somebody else tidies up, or nothing may be removed
        _log.info("%s: %s", path.parent, error)


# ---------- values of any kind
ALL_PACKAGES = ("geometry", "scenarios", "placement")  # all whose code may decide an answer


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
    """Value of `make`, from the last call that asked for the same; without a folder always made.

    `make` uses nothing but `made_from` (see :class:`Fingerprints`) and the files of `packages`.
    `kind` is the value's type hint; `classes` are dataclasses that stand where it names a protocol.
    Only a value that `is_worth_it` is cached. Arrays that are read-only stay so.
    """
    if folder is None:
        return make()
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
    value = make()
    if is_worth_it(value):
        content = to_bytes(value)
        key = _key(content, fingerprint)
        if _write(path, lambda file: file.write(key + content), what=name):
            _prune(path, most=MAX_VALUES)
    return value


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


# ---------- values as MessagePack and back
_PLAIN = (bool, int, float, str, NoneType)


def to_bytes(value: object) -> bytes:
    """A value of dataclasses, Structs, tuples, arrays, numbers, text as bytes; else TypeError."""
    writer = _Writer()
    root = writer.plain(value)
    return msgspec.msgpack.encode((writer.objects, writer.arrays, root))


def from_bytes(content: bytes, hint: Any, *, classes: Sequence[type] = ()) -> Any:
    """A value of a type hint from bytes; dataclasses and arrays are shared as they were.

    Raises an exception of any kind if the bytes are of something else.
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
        if isinstance(value, Phrase):
            return pack_phrase(value)
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
        if not isinstance(value, msgspec.Struct) and not is_dataclass(value):
            raise TypeError(f"a value that cannot be cached: {value!r}")
        parts = [self.plain(getattr(value, name)) for name, _ in _fields(value.__class__)]
        self.objects.append((type(value).__name__, parts))
        return len(self.objects) - 1


class _Reader:
    """Values by type hints; an object is made when it is first asked for."""

    def __init__(self, objects: _Objects, arrays: _Arrays, classes: dict[str, type]) -> None:
        self._objects, self._classes = objects, classes
        self._arrays = [_array(*one) for one in arrays]
        self._made: dict[int, Any] = {}

    def value(self, plain: Any, hint: Any) -> Any:
        """Value of a type hint from plain data; ValueError if that is of another kind."""
        origin, hints = get_origin(hint), get_args(hint)
        if origin in (Union, UnionType):
            some = [one for one in hints if one is not NoneType]
            if plain is not None and len(some) > 1:  # dataclasses: the content names one of them
                some = [one for one in some if one.__name__ == self._objects[plain][0]]
            return None if plain is None else self.value(plain, some[0])
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
        elif hint is Phrase or (hint is str and isinstance(plain, list)):
            return unpack_phrase(plain)
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
            kind: Any = hint if _has_fields(hint) else self._classes[name]
            values = zip(parts, _fields(kind), strict=True)
            found = kind(**{field: self.value(part, of) for part, (field, of) in values})
            if kind.__name__ != name:
                raise ValueError(f"its content is of another kind: {name}")
            self._made[place] = found
        found = self._made[place]
        if _has_fields(hint) and type(found) is not hint:
            raise ValueError(f"its content is of another kind: {type(found).__name__}")
        return found


def _array(dtype: str, shape: list[int], is_writeable: bool, content: bytes) -> Any:
    if np.dtype(dtype).kind not in "biuf":
        raise ValueError(f"an array that is not of numbers: {dtype}")
    array = np.frombuffer(content, dtype).reshape(shape)
    return array.copy() if is_writeable else array


def _has_fields(kind: type) -> bool:
    return is_dataclass(kind) or issubclass(kind, msgspec.Struct)


@cache
def _fields(kind: type) -> tuple[tuple[str, Any], ...]:
    """Names and type hints of the fields with which a dataclass or Struct is made."""
    hints = get_type_hints(kind)
    if issubclass(kind, msgspec.Struct):
        return tuple((name, hints[name]) for name in kind.__struct_fields__)
    return tuple((one.name, hints[one.name]) for one in fields(kind) if one.init)  # type: ignore[arg-type]
