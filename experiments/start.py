"""``place-rsus`` as the shell starts it.

Ctrl-C ends it quietly while modules are still loaded.
"""

import gc
import os
import signal
from typing import NoReturn

# A command makes few cycles, and ends soon: Python's 700 would have it look through
# its objects every moment, which takes a twentieth of the main job.
_OBJECTS_BETWEEN_COLLECTIONS = 1_000_000


def main() -> NoReturn:
    """Load the command line, and run it."""
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS)
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


def _end(signum: int, _frame: object) -> NoReturn:
    os.write(2, b"place-rsus: interrupted\n")
    os._exit(128 + signum)


if __name__ == "__main__":
    main()
