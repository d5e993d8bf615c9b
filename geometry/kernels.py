"""Numba kernels: loops over numbers, compiled when they are first called.

``numba.njit(cache=True)`` compiles a kernel that is called from Python. One that
another kernel calls becomes part of that one's machine code, by
``numba.extending.overload``. Numba writes its cache into a folder of this process
alone; from there all files of a kernel go into a single one in the user's cache, under
a hash. What is damaged, stale or somebody else's is never run, and a full disk costs
the time to compile, and no more.

Loading numba takes half a second: the function that calls a kernel imports its module.
"""

import atexit
import hashlib
import logging
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import cache, wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import msgspec
import numba
from numba.core import event
from numba.extending import overload

from .cache_folders import (
    open_own,
    private_temporary_folder,
    trouble_with,
    user_cache_folder,
)
from .clock import stand_still_s
from .locks import is_abandoned, lock_while_alive
from .writing import write_atomically

F = TypeVar("F", bound=Callable[..., Any])
# What numba cached of a kernel: content by path below its folder.
Files = dict[str, bytes]
_log = logging.getLogger(__name__)
_OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_HASH_SIZE = 32
_SUFFIX = ".kernel"
# Begins the names of folders of single processes.
_RUNNING = "running-"


def kernel(function: F) -> F:
    """Compile a function of numbers and arrays on its first call.

    It runs in any thread. Kernels may call kernels of the same file, and of files
    ``*_kernels.py`` next to it. Division by zero gives infinity or NaN, as in numpy.
    The machine code is cached for the next process.
    """
    on_disk = _OnDisk(function)

    @wraps(function)
    def call(*args: Any) -> Any:
        compiled = on_disk.compiled or on_disk.load()
        try:
            result = compiled(*args)
        except OSError as error:
            # Numba compiled it, but could not write what it cached.
            on_disk.tell_not_cached(error)
            on_disk.compiled = numba.njit(**_OPTIONS)(function)
            return on_disk.compiled(*args)
        # The call has compiled something: the next process shall have it.
        if _compiling.is_anything_new:
            _compiling.is_anything_new = False
            on_disk.save()
        return result

    @overload(call, jit_options=_OPTIONS, strict=False)  # type: ignore[untyped-decorator]
    def implement(*args: Any) -> Callable[..., Any]:
        """Function that other kernels compile into their own code."""
        return function

    call.on_disk = on_disk  # type: ignore[attr-defined]
    return cast(F, call)


@cache
def compiled_folder() -> Path:
    """Folder in which machine code is cached.

    It is NUMBA_CACHE_DIR, a folder in the user's cache or a temporary folder.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        folder = Path(chosen)
    else:
        folder = user_cache_folder() / "compiled"
    trouble = trouble_with(folder)
    if trouble:
        unusable = folder
        folder = private_temporary_folder()
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        _tell_once(f"compiled code is cached in {folder}: {unusable} {trouble}")
    return folder


# ---------- one file a kernel
class _OnDisk:
    """A kernel's machine code, and the file that holds it for the next process.

    The file begins with a hash of the source code and one of the content, which are the
    files that numba made, by name.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.compiled: Callable[..., Any] | None = None
        self._function = function
        self._source = Path(function.__code__.co_filename)
        # Numba's files; None where there was no folder for them.
        self._folder: Path | None = None
        self._lock = threading.Lock()

    @property
    def path(self) -> Path:
        """The file, whose name tells apart kernels of the same name in other places."""
        place = hashlib.blake2b(str(self._source).encode(), digest_size=8).hexdigest()
        name = f"{self._source.stem}.{self._function.__qualname__}-{place}{_SUFFIX}"
        return compiled_folder() / name

    def load(self) -> Callable[..., Any]:
        """The function for numba to compile, or to load from what was cached before."""
        with self._lock:
            if self.compiled is None:
                self.compiled = self._build()
            return self.compiled

    def _build(self) -> Callable[..., Any]:
        """The function for numba, with a folder for its cache if there is one."""
        try:
            self._folder = Path(tempfile.mkdtemp(dir=_running_folder(os.getpid())))
            self._unpack(self._folder)
        except OSError as error:
            self.tell_not_cached(error)
            compiled = numba.njit(**_OPTIONS)(self._function)
        else:
            # Numba looks where to cache when it makes the function.
            with _settings:
                usual = numba.config.CACHE_DIR
                numba.config.CACHE_DIR = str(self._folder)
                compiled = numba.njit(cache=True, **_OPTIONS)(self._function)
                numba.config.CACHE_DIR = usual
        return cast(Callable[..., Any], compiled)

    def _unpack(self, folder: Path) -> None:
        """Write an earlier process's files for numba, unless they are damaged."""
        try:
            found = self.read()
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            _tell_once(f"cached machine code not used, made anew: {reason}")
            return
        for name, content in (found or {}).items():
            path = folder / name
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)

    def read(self) -> Files | None:
        """What numba cached; None if nothing, or of other source code.

        Raises
        ------
        ValueError
            The file is damaged.
        OSError
            It cannot be read, or others may have written it.
        """
        try:
            with open_own(self.path) as file:
                stored = file.read()
        except FileNotFoundError:
            return None
        sources = _hash_of_sources(self._source)
        if stored[:_HASH_SIZE] != sources:
            if len(stored) < 2 * _HASH_SIZE:
                raise ValueError("not what was written")
            return None
        content = stored[2 * _HASH_SIZE :]
        if _hash_of(content) != stored[_HASH_SIZE : 2 * _HASH_SIZE]:
            raise ValueError("not what was written")
        return msgspec.msgpack.decode(content, type=Files)

    def save(self) -> None:
        """Write what numba has cached by now, whole or not at all; or say why not."""
        if self._folder is None:
            return
        try:
            found = {
                str(path.relative_to(self._folder)): path.read_bytes()
                for path in self._folder.rglob("*.nb[ic]")
            }
            content = msgspec.msgpack.encode(found)
            # The file begins with both hashes, so that reading can check them.
            stored = _hash_of_sources(self._source) + _hash_of(content) + content
            write_atomically(
                self.path, lambda file: file.write(stored), is_private=True
            )
        except OSError as error:
            self.tell_not_cached(error)

    def tell_not_cached(self, error: OSError) -> None:
        """Log that there is nothing for the next process, and why."""
        _tell_once(
            f"machine code not cached: {compiled_folder()}: {error.strerror or error}"
        )


_settings = threading.Lock()


def _hash_of(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_HASH_SIZE).digest()


@cache
def _hash_of_sources(path: Path) -> bytes:
    """Hash of a file and of the kernels next to it: they may call one another."""
    digest = hashlib.blake2b(digest_size=_HASH_SIZE)
    for source in (path, *sorted(path.parent.glob("*_kernels.py"))):
        content = source.read_bytes()
        digest.update(f"{source.name}\0{len(content)}\0".encode() + content)
    return digest.digest()


@cache
def _running_folder(process_id: int) -> Path:
    """Folder of this process alone.

    The process removes it at its end; a later process removes it if this one
    was killed.
    """
    for left in compiled_folder().glob(f"{_RUNNING}*"):
        if is_abandoned(left):
            shutil.rmtree(left, ignore_errors=True)
    folder = Path(tempfile.mkdtemp(prefix=_RUNNING, dir=compiled_folder()))
    held = ExitStack()
    held.enter_context(lock_while_alive(folder))

    def remove() -> None:
        held.close()
        # Else a copy of that process ends.
        if os.getpid() == process_id:
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


# ---------- what numba tells while it compiles
class _Compiling(threading.local):
    """What the calling thread has compiled."""

    # Since a kernel was last saved.
    is_anything_new = False
    # Compiling one function may begin with others that it calls.
    depth = 0
    begun_s = 0.0


_compiling = _Compiling()


class _Listener(event.Listener):  # type: ignore[misc]
    """Says that kernels are compiled, and stops the clock of time limits meanwhile."""

    def on_start(self, found: event.Event) -> None:
        """A function begins to be compiled."""
        if _compiling.depth == 0:
            _tell_once("compiling for this machine, once: some seconds")
            _compiling.begun_s = time.monotonic()
        _compiling.depth += 1

    def on_end(self, found: event.Event) -> None:
        """It was compiled; numba caches it next."""
        _compiling.depth -= 1
        _compiling.is_anything_new = True
        if _compiling.depth == 0:
            stand_still_s(time.monotonic() - _compiling.begun_s)


event.register("numba:compile", _Listener())


@cache
def _tell_once(message: str) -> None:
    _log.warning("%s", message)
