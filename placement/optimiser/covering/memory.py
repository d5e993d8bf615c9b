"""Memory that a covering problem needs, as far as it can be told before, and what there is."""

import os
import resource
from pathlib import Path

from geometry.errors import InputError, Unquoted

TEXT_BYTES = 25
"""Of memory for each byte of a file of numbers while it is read; measured: 19 to 24."""

UNPACKED_BYTES = 6
"""Of memory for each byte of our own files, unpacked, while they are read."""

MODEL_BYTES = 300
"""Of the solver's memory for each entry of the matrix, at the root; measured: 200 to 240."""


def available_bytes() -> int:
    """Memory that can still be had, as the system says; without its word, all there is."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    free = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        free = next(1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvail"))
    except (OSError, StopIteration, ValueError):  # not this system's way
        pass
    return free if limit == resource.RLIM_INFINITY else min(free, limit)


def check_fits(where: str, what: str, needed_bytes: int, remedy: str) -> None:
    """Raise InputError if so much memory is more than there is; `remedy` says what helps."""
    free = available_bytes()
    if needed_bytes > free:
        raise InputError(
            where,
            Unquoted(f"{what}, which takes about {gib(needed_bytes)} of memory"),
            f"what fits into the {gib(free)} that are free: {remedy}",
        )


def gib(n_bytes: int) -> str:
    """An amount of memory, in words."""
    return f"{n_bytes / 2**30:.1f} GiB"
