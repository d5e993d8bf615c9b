"""Times of two pieces of work, measured in turn, and their ratio."""

import statistics
import time
from collections.abc import Callable

REPEATS = 5


def in_turn(ours: Callable[[], object], theirs: Callable[[], object]) -> tuple[list[float], ...]:
    """Seconds of both, A B A B .., after one run of each that does not count."""
    seconds: tuple[list[float], list[float]] = ([], [])
    for repeat in range(REPEATS + 1):
        for kept, work in zip(seconds, (ours, theirs), strict=True):
            began_s = time.perf_counter()
            work()
            if repeat > 0:
                kept.append(time.perf_counter() - began_s)
    return seconds


def ratio(ours_s: list[float], theirs_s: list[float]) -> float:
    """Median of the ratios pair by pair."""
    return statistics.median(a / b for a, b in zip(ours_s, theirs_s, strict=True))
