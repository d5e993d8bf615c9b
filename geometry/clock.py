"""The clock of time limits.

It stands still while loops are compiled, which happens once on each machine.
"""

import time

_stood_s = [0.0]


def now_s() -> float:
    """Seconds from some moment on, without those in which it stood still."""
    return time.monotonic() - _stood_s[0]


def stand_still_s(seconds: float) -> None:
    """Let it have stood still for so long until now, in seconds."""
    _stood_s[0] += seconds
