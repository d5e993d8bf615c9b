"""Machine code for loops over numbers: numba's compiler, and what it compiled before.

The code is kept in the user's cache, where anything may happen to it: a file that is damaged, a
folder that cannot be written to, or a full disk costs the time to compile, and never more. Loading
numba takes half a second: modules that hold kernels are imported by the function that calls them,
when it is called.
"""

import gc
import hashlib
import logging
import os
import pickle
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from platformdirs import user_cache_path

from .clock import stand_still_s
from .files import writable_by_others

F = TypeVar("F", bound=Callable[..., Any])
_log = logging.getLogger(__name__)


def kernel(function: F) -> F:
    """Compile a function of numbers and arrays when it is first called; it then runs in any thread.

    Kernels may call kernels of the same file, and of files ``*_kernels.py`` beside it. Division by
    zero gives infinity or NaN, as in numpy. The machine code is kept for the next process; where
    that cannot be, each process compiles.
    """
    compiled = numba.njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True)(function)
    trouble = _trouble(compiled_folder())
    compiled._cache = _Unkept(trouble) if trouble else _Kept(function)
    of_types = compiled.get_call_template

    def of_any_number(args: Sequence[Any], kws: dict[str, Any]) -> Any:
        """The same code for numbers that are written out in a call as for any others."""
        return of_types([numba.types.unliteral(arg) for arg in args], kws)

    compiled.get_call_template = of_any_number
    return cast(F, compiled)


def is_compiled(function: Callable[..., Any]) -> bool:
    """Whether machine code of a kernel is kept, for whatever types, or cannot be kept at all."""
    kept = cast(Any, function)._cache
    return not isinstance(kept, _Kept) or kept.has_any


def compiled_folder() -> Path:
    """Where machine code is kept: NUMBA_CACHE_DIR, or a folder in the user's cache."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    return Path(chosen) if chosen else user_cache_path("place-rsus") / "compiled"


@cache
def _trouble(folder: Path) -> str:
    """Why code is not kept in a folder; empty: it is. Code of others would run as ours."""
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK):
        return "cannot be written to"
    return "can be written to by other users" if writable_by_others(folder) else ""


numba.config.CACHE_DIR = str(compiled_folder())


class _CheckedFile(IndexDataCacheFile):  # type: ignore[misc]
    """Files whose content is used only if it is what was written: damaged code would run."""

    def _dump(self, content: Any) -> bytes:
        data = cast(bytes, super()._dump(content))
        return hashlib.blake2b(data).digest() + data

    def _load_data(self, name: str) -> Any:
        return pickle.loads(_checked(Path(self._data_path(name)).read_bytes()))

    def _load_index(self) -> dict[Any, str]:
        try:
            with Path(self._index_path).open("rb") as file:
                version, data = pickle.load(file), file.read()
        except FileNotFoundError:
            return {}
        if version != self._version:
            return {}
        stamp, names = pickle.loads(_checked(data))
        return cast(dict[Any, str], names) if stamp == self._source_stamp else {}


def _checked(content: bytes) -> bytes:
    size = hashlib.blake2b().digest_size
    if hashlib.blake2b(content[size:]).digest() != content[:size]:
        raise ValueError("not what was written")
    return content[size:]


class _Kept(FunctionCache):  # type: ignore[misc]
    """A function's machine code on disk, or what it takes to do without."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file: IndexDataCacheFile = _CheckedFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=(self._impl.locator.get_source_stamp(), *_stamps_beside(function)),
        )

    @property
    def has_any(self) -> bool:
        """Whether there is code of any signature; a damaged index has none."""
        try:
            return bool(self._cache_file._load_index())
        except Exception:  # damaged pickles raise anything
            return False

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Code of a signature; None where there is none, or none that can be used."""
        try:
            found = super().load_overload(signature, target_context)
        except Exception as error:  # damaged pickles raise anything
            _tell_once(f"kept machine code not used, made anew: {error}")
            with suppress(OSError):
                self.flush()
            found = None
        if found is None:
            _tell_once("compiling for this machine, once: some seconds")
            _start_clock()
        return found

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep code, or say why not."""
        _stop_clock()
        try:
            super().save_overload(signature, data)
        except Exception as error:  # a disk that is full, a folder that went, a damaged index
            reason = getattr(error, "strerror", None) or error
            _tell_once(f"machine code not kept: {compiled_folder()}: {reason}")


def _stamps_beside(function: Callable[..., Any]) -> list[tuple[str, int, int]]:
    """What tells that kernels have changed which a function may call."""
    files = sorted(Path(function.__code__.co_filename).parent.glob("*_kernels.py"))
    status = [(file.name, file.stat()) for file in files]
    return [(name, of_file.st_mtime_ns, of_file.st_size) for name, of_file in status]


class _Unkept(NullCache):  # type: ignore[misc]
    """Where nothing can be kept, and why."""

    def __init__(self, trouble: str) -> None:
        super().__init__()
        self._trouble = trouble

    def load_overload(self, signature: Any, target_context: Any) -> None:
        """None; says that there is none."""
        _tell_once(f"compiling in every call, some seconds: {compiled_folder()} {self._trouble}")
        _start_clock()

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keeps nothing."""
        _stop_clock()


_begun_s: list[float] = []  # compiling one function may begin with others that it calls
_collects: list[bool] = []  # whether garbage was collected before


def _start_clock() -> None:
    """The compiler begins: it makes so many objects that collecting takes an eighth of its time."""
    if not _begun_s:
        _collects[:] = [gc.isenabled()]
        gc.disable()
    _begun_s.append(time.monotonic())


def _stop_clock() -> None:
    """Take the time of the compiler, which works for one thread at a time, from all time limits."""
    began_s = _begun_s.pop()
    if not _begun_s:
        stand_still_s(time.monotonic() - began_s)
        if _collects == [True]:
            gc.enable()


@cache
def _tell_once(message: str) -> None:
    _log.warning("%s", message)
