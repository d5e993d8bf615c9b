"""``place-rsus`` as the shell starts it.

Ctrl-C ends it quietly while modules are still loaded.
"""

import os
import signal
from typing import NoReturn


def main() -> NoReturn:
    """Load the command line, and run it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)
    from .main import main as run

    run()


def _end(signum: int, _frame: object) -> NoReturn:
    os.write(2, b"place-rsus: interrupted\n")
    os._exit(128 + signum)


if __name__ == "__main__":
    main()
