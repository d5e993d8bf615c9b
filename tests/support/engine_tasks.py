"""Tasks for tests of engines: of a module, so that workers find them by name."""

import os
import time
from pathlib import Path

from experiments.engine.tasks import map_tasks
from geometry.errors import InputError


def square(number):
    """A number's square, after a while."""
    time.sleep(0.02)
    return number * number


def end_at_3(number):
    """A number's square; 3 ends the process."""
    if number == 3:
        os._exit(3)
    return square(number)


def count_calls(folder, text):
    """A text that is no number raises; how often is counted by files."""
    number = len(list(Path(folder).glob(f"{text}-*")))
    (Path(folder) / f"{text}-{number}").touch()
    if text == "refused":
        raise InputError("here", text, "a number")
    return int(text)


def take(size):
    """Take so many bytes of memory for a second."""
    taken = bytearray(size)
    taken[::4096] = b"x" * len(taken[::4096])
    time.sleep(1.0)
    return len(taken)


def answers_of(engine, function, those, **more):
    """Answers by task."""
    return dict(map_tasks(function, those, engine=engine, **more))
