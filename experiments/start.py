"""``place-rsus`` as the shell starts it.

Ctrl-C ends it quietly while modules are still loaded.
"""

import ctypes
import gc
import os
import signal
from typing import NoReturn

# A command makes few cycles, and ends soon: Python's 700 would have it look through
# its objects every moment, which takes a twentieth of the main job.
_OBJECTS_BETWEEN_COLLECTIONS = 100_000
# glibc's number of the parameter, see mallopt(3).
_M_ARENA_MAX = -8


def main() -> NoReturn:
    """Load the command line, and run it."""
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS)
    _share_one_heap()
    # Before numpy is loaded: work is shared out by runs and poses, and further threads
    # of BLAS would only wait for it, spinning.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)
    from .main import main as run

    try:
        run()
    finally:
        # The process ends: nothing has to be looked through once more.
        gc.freeze()


def _share_one_heap() -> None:
    """Have all threads allocate from one heap, where the C library is glibc.

    It gives each thread a heap of its own, which keeps what was freed there: the main
    job would take a third more memory.
    """
    try:
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)
    except (AttributeError, OSError, TypeError):
        # Another C library, or another system.
        return


def _end(signum: int, _frame: object) -> NoReturn:
    os.write(2, b"place-rsus: interrupted\n")
    os._exit(128 + signum)


if __name__ == "__main__":
    main()
