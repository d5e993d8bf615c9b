"""Machine code for loops over numbers: numba's compiler, and what it compiled before.

The code is kept in the user's cache. Loading numba takes half a second: modules that hold kernels
are imported by the function that calls them, when it is called.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from platformdirs import user_cache_path

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile a function of numbers and arrays when it is first called; it then runs in any thread.

    Kernels may call kernels. Division by zero gives infinity or NaN, as in numpy. The machine code
    is kept for the next process; where no folder can be written, it is compiled by each process.
    """
    is_kept = _is_writable(compiled_folder())
    return cast(F, numba.njit(nogil=True, error_model="numpy", cache=is_kept)(function))


def compiled_folder() -> Path:
    """Where machine code is kept: NUMBA_CACHE_DIR, or a folder in the user's cache."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    return Path(chosen) if chosen else user_cache_path("place-rsus") / "compiled"


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


numba.config.CACHE_DIR = str(compiled_folder())
