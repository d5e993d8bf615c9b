"""A process that reads files on demand, within limits of memory and time: for the fuzz
tests.

A line of JSON comes in for each file, ``{"reader": .., "path": .., "is_sound": ..}``,
and one goes out, ``{"outcome": "read" | "refused" | "failed", "text": ..}``. Who asks
sees to the wall clock.
"""

import json
import os
import resource
import signal
import sys
import traceback
import warnings
from pathlib import Path

MAX_BYTES = 1 << 30  # more than before the file is read
MAX_CPU_S = 10.0  # then the process ends by SIGPROF


def main() -> None:
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    warnings.simplefilter("ignore")
    import logging

    logging.disable(logging.CRITICAL)
    from readers import READERS

    from geometry.errors import InputError

    for line in sys.stdin:
        asked = json.loads(line)
        read = READERS[asked["reader"]].read
        outcome = "read"
        text = ""
        if not asked["is_sound"]:  # else it loads and compiles what it needs
            _limit(MAX_BYTES, MAX_CPU_S)
        try:
            read(Path(asked["path"]))
        except InputError as error:
            outcome = "refused"
            text = str(error)
        except BaseException as error:
            _limit(None, 0.0)
            outcome = "failed"
            text = "".join(traceback.format_exception(error))
        _limit(None, 0.0)
        answers.write(json.dumps({"outcome": outcome, "text": text[-6000:]}) + "\n")
        answers.flush()


def _limit(max_bytes: int | None, max_cpu_s: float) -> None:
    """Limit memory and processor time; None and 0: not at all."""
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    soft = most
    if max_bytes is not None:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        soft = pages * os.sysconf("SC_PAGE_SIZE") + max_bytes
    resource.setrlimit(resource.RLIMIT_AS, (soft, most))
    signal.setitimer(signal.ITIMER_PROF, max_cpu_s)


if __name__ == "__main__":
    main()
