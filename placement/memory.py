"""Memory that something needs and that this machine has, checked before anything long starts."""

import os
import sys
from pathlib import Path

from geometry.errors import refuse

_PROGRAM_BYTES = 400 * 2**20  # of the program itself: libraries, scene, runs, report
_BYTES_PER_ENTRY = 0.125 + 1.0
"""Of the table: a bit in it; the optimiser's presolve has up to seven copies, measured."""
_LIMIT_FILES = (
    "/sys/fs/cgroup/memory.max",
    "/sys/fs/cgroup/memory/memory.limit_in_bytes",
)


def needed_bytes(n_poses: int, n_frames: int, *, n_worlds: int = 1) -> int:
    """Memory of a placement at its peak, when presolve has the whole detection table, in bytes.

    >>> round(needed_bytes(5772, 18311) / 2**30, 1)
    0.5
    >>> round(needed_bytes(5772, 18311, n_worlds=64) / 2**30, 1)
    7.5
    """
    return _PROGRAM_BYTES + int(_BYTES_PER_ENTRY * n_poses * n_frames * n_worlds)


def machine_bytes() -> int | None:
    """Memory that this process may use: the machine's, or less by a container's or a shell's limit.

    None where the system does not say.
    """
    sizes = []
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        sizes.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    for file in _LIMIT_FILES:
        try:
            text = Path(file).read_text(encoding="ascii").strip()
        except (OSError, UnicodeDecodeError):
            continue
        if text.isdecimal():  # else "max"
            sizes.append(int(text))
    if sys.platform != "win32":
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limit != resource.RLIM_INFINITY:
            sizes.append(limit)
    return min((size for size in sizes if size > 0), default=None)


def available_bytes() -> int:
    """Memory that can still be had: what is free, within :func:`machine_bytes`; else huge."""
    sizes = [machine_bytes() or sys.maxsize]
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        sizes += [
            1024 * int(line.split()[1])
            for line in lines
            if line.startswith("MemAvailable:")
        ]
    except (OSError, ValueError):  # not this system's way
        pass
    return min(sizes)


def check_memory(n_poses: int, n_frames: int, *, n_worlds: int = 1) -> None:
    """Raise InputError for a question that cannot fit into the memory of this machine."""
    needed = needed_bytes(n_poses, n_frames, n_worlds=n_worlds)
    there = machine_bytes()
    if there is None or needed <= there:
        return
    if n_worlds > 1:
        worlds = f" in {n_worlds:,} sampled worlds"
    else:
        worlds = ""
    if n_worlds > 1:
        fewer = "fewer `samples`, "
    else:
        fewer = ""
    refuse(
        "memory",
        f"{n_poses:,} poses x {n_frames:,} frames{worlds}, which need {gib(needed)},"
        f" where there are {gib(there)}",
        f"a smaller question: {fewer}fewer `cases`, `speeds`, `approaches` or"
        " `weather`, fewer `sensors`, or only the poles of `within`",
    )


def check_fits(where: str, what: str, needed_bytes: int, remedy: str) -> None:
    """Raise InputError if something takes more memory than there is.

    `where` and `what` say what is read or solved and how large it is, `remedy` what
    helps.
    """
    free = available_bytes()
    if needed_bytes > free:
        got = f"{what}, which takes about {gib(needed_bytes)} of memory"
        refuse(where, got, f"what fits into the {gib(free)} that are free: {remedy}")


def gib(size: int) -> str:
    """An amount of memory in bytes, in words.

    >>> gib(3 * 2**29)
    '1.5 GiB'
    """
    return f"{size / 2**30:,.1f} GiB"
