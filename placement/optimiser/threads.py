"""Work on all processors: machine code lets other threads run."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

WORKERS = os.cpu_count() or 1


def share_out(work: Callable[[int, int], None], count: int) -> None:
    """Call ``work(begin, end)`` for parts of 0 .. `count`, one on each processor."""
    bounds = [count * number // WORKERS for number in range(WORKERS + 1)]
    with ThreadPoolExecutor(WORKERS) as threads:
        list(threads.map(work, bounds[:-1], bounds[1:]))
