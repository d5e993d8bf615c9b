"""Work on all processors: machine code lets other threads run."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

WORKERS = os.cpu_count() or 1


_FEW = 64


def share_out(work: Callable[[int, int], None], count: int, *, few: int = _FEW) -> None:
    """Call ``work(begin, end)`` for parts of 0 .. `count`, one on each processor.

    What is less than `few` is done at once.
    """
    if count < few:
        work(0, count)
        return
    bounds = [count * number // WORKERS for number in range(WORKERS + 1)]
    with ThreadPoolExecutor(WORKERS) as threads:
        list(threads.map(work, bounds[:-1], bounds[1:]))
