"""Locks that tell whether the process of a temporary file still lives."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

# A process may have made it and not locked it yet.
_YOUNG_S = 60.0


@contextmanager
def lock_while_alive(path: Path) -> Iterator[None]:
    """Lock a file or folder until the block or the process ends.

    The system lifts the lock when the process ends, however it ends.

    Where the system has no such locks, :func:`is_abandoned` never holds.
    """
    try:
        import fcntl
    except ImportError:
        # Windows.
        yield
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        # Some network file systems have no locks.
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def is_abandoned(path: Path, *, min_age_s: float = _YOUNG_S) -> bool:
    """True if no living process holds a temporary file or folder.

    False where that is not known, and for `min_age_s` after the last change:
    its process may not have locked it yet.
    """
    try:
        import fcntl

        if time.time() - path.stat().st_mtime < min_age_s:
            return False
        handle = os.open(path, os.O_RDONLY)
    except (ImportError, OSError):
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    else:
        return True
    finally:
        os.close(handle)
