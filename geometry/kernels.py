"""Numba kernels: the compiler for loops over numbers, and the cache of what it compiled before.

The code is cached in a folder of the user alone, where anything may happen to it: a file that is
damaged or somebody else's, or a full disk costs the time to compile, and never more. Where the
user's cache is no such folder, a private temporary one takes its place. Loading numba takes half a
second: modules that hold kernels are imported by the function that calls them, when it is called.
"""

import hashlib
import io
import logging
import os
import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile

from .clock import stand_still_s
from .files import (
    open_own,
    private_temporary_folder,
    trouble_with,
    user_cache_folder,
    writable_by_others,
    write_atomically,
)

F = TypeVar("F", bound=Callable[..., Any])
_log = logging.getLogger(__name__)
_begun_s: list[float] = []  # compiling one function may begin with others that it calls


def kernel(function: F) -> F:
    """Compile a function of numbers and arrays when it is first called; it then runs in any thread.

    Kernels may call kernels of the same file, and of files ``*_kernels.py`` next to it. Division by
    zero gives infinity or NaN, as in numpy. The machine code is cached for the next process.
    """
    numba.config.CACHE_DIR = str(compiled_folder())
    compiled = numba.njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True)(function)
    compiled._cache = _Cached(function)
    of_types = compiled.get_call_template

    def of_any_number(args: Sequence[Any], kws: dict[str, Any]) -> Any:
        """Template that treats literal numbers in a call as any others: one compiled version."""
        return of_types([numba.types.unliteral(arg) for arg in args], kws)

    compiled.get_call_template = of_any_number
    return cast(F, compiled)


def is_compiled(function: Callable[..., Any]) -> bool:
    """True if machine code of a kernel is cached, for whatever types."""
    return cast(bool, cast(Any, function)._cache.has_any)


@cache
def compiled_folder() -> Path:
    """Where machine code is cached: NUMBA_CACHE_DIR, the user's cache or a temporary folder."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(chosen) if chosen else user_cache_folder() / "compiled"
    trouble = trouble_with(folder)
    if not trouble and any(map(writable_by_others, folder.iterdir())):
        trouble = "holds folders of other users"
    if trouble:
        unusable, folder = folder, private_temporary_folder()
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        _tell_once(f"compiled code is cached in {folder}: {unusable} {trouble}")
    return folder


class _CheckedFile(IndexDataCacheFile):  # type: ignore[misc]
    """Files whose content is used only if it is what was written: damaged code would run."""

    def _dump(self, content: Any) -> bytes:
        data = cast(bytes, super()._dump(content))
        return hashlib.blake2b(data).digest() + data

    def _load_data(self, name: str) -> Any:
        with open_own(Path(self._data_path(name))) as file:
            return pickle.loads(_checked(file.read()))

    def _load_index(self) -> dict[Any, str]:
        try:
            with open_own(Path(self._index_path)) as file:
                version, data = pickle.load(file), file.read()
        except FileNotFoundError:
            return {}
        if version != self._version:
            return {}
        stamp, names = pickle.loads(_checked(data))
        return cast(dict[Any, str], names) if stamp == self._source_stamp else {}

    @contextmanager
    def _open_for_write(self, path: str) -> Iterator[io.BytesIO]:
        content = io.BytesIO()
        yield content
        write_atomically(Path(path), lambda file: file.write(content.getvalue()), is_private=True)


def _checked(content: bytes) -> bytes:
    size = hashlib.blake2b().digest_size
    if hashlib.blake2b(content[size:]).digest() != content[:size]:
        raise ValueError("not what was written")
    return content[size:]


class _Cached(FunctionCache):  # type: ignore[misc]
    """A function's machine code on disk, or what it takes to do without."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        beside = Path(function.__code__.co_filename).parent.glob("*_kernels.py")
        stats = [(file.name, file.stat()) for file in sorted(beside)]  # they may call one another
        stamps = [(name, found.st_mtime_ns, found.st_size) for name, found in stats]
        self._cache_file: IndexDataCacheFile = _CheckedFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=(self._impl.locator.get_source_stamp(), *stamps),
        )

    @property
    def has_any(self) -> bool:
        """True if there is code of any signature; a damaged index has none."""
        try:
            return bool(self._cache_file._load_index())
        except Exception:  # damaged pickles raise anything
            return False

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Code of a signature; None where there is none, or none that can be used."""
        try:
            found = super().load_overload(signature, target_context)
        except Exception as error:  # damaged pickles raise anything
            reason = getattr(error, "strerror", None) or error
            _tell_once(f"cached machine code not used, made anew: {reason}")
            with suppress(OSError):
                self.flush()
            found = None
        if found is None:
            _tell_once("compiling for this machine, once: some seconds")
            _begun_s.append(time.monotonic())
        return found

    def save_overload(self, signature: Any, data: Any) -> None:
        """Cache code, or say why not."""
        began_s = _begun_s.pop()
        if not _begun_s:  # the compiler, which works for one thread at a time, has no time limit
            stand_still_s(time.monotonic() - began_s)
        try:
            super().save_overload(signature, data)
        except Exception as error:  # a disk that is full, a folder that went, a damaged index
            reason = getattr(error, "strerror", None) or error
            _tell_once(f"machine code not cached: {compiled_folder()}: {reason}")


@cache
def _tell_once(message: str) -> None:
    _log.warning("%s", message)
