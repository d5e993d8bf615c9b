"""A process that makes writers, to be killed: tests/faults/test_writing.py.

For each line that comes in, a writer begins to write a cached table and a folder of
results over and over, and its process id goes out.
"""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from experiments.results.folders import MARKER, new_result_folder
from geometry.writing import write_atomically
from placement.detection_table import DetectionTable
from placement.visibility import load_table, save_table
from scenarios.runs import FrameAxis

FINGERPRINT = "0123456789abcdef" * 2
N_FRAMES = 400_000
AXIS = FrameAxis(
    run_ids=("a",),
    cases=("A",),
    approaches=("north",),
    weathers=("day",),
    vut_speed_kmh=np.array([20.0]),
    weight=np.array([1.0]),
    last_brake_time_s=np.array([-1.0]),
    run_start=np.array([0, N_FRAMES]),
    time_s=0.1 * np.arange(-N_FRAMES + 1.0, 1.0),
)
POSES: list[Any] = [SimpleNamespace(id=name) for name in "abc"]
NAMES = (MARKER, "layout.json", "apr.csv", "report.html")


def write_table(folder: Path, number: int) -> None:
    """Write a table whose bytes are all one number."""
    packed = np.full((len(POSES), N_FRAMES // 8), number % 256, dtype=np.uint8)
    table = DetectionTable(pose_ids=("a", "b", "c"), axis=AXIS, packed=packed)
    save_table(folder / "cache/table.npz", table, fingerprint=FINGERPRINT)


def read_table(folder: Path) -> DetectionTable | None:
    """The table in a folder, if it is whole."""
    path = folder / "cache/table.npz"
    return load_table(path, fingerprint=FINGERPRINT, candidates=POSES, axis=AXIS)


def write_results(folder: Path, number: int) -> None:
    """Write results whose files all say one number."""
    with new_result_folder(folder / "latest") as new:
        for name in NAMES:
            text = (f"{number}\n" * 20_000).encode()
            write_atomically(new / name, lambda file, text=text: file.write(text))


def write_for_ever(folder: Path) -> None:
    """Write table and results over and over."""
    number = os.getpid()
    while True:
        number += 1
        write_table(folder, number)
        write_results(folder, number)


def in_a_child(work: Callable[[], object]) -> int:
    """Process id of a child that does some work; it leaves nothing of this process
    behind.
    """
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        work()
        code = 0
    finally:
        os._exit(code)


def main() -> None:
    folder = Path(sys.argv[1])
    for _ in sys.stdin:
        print(in_a_child(lambda: write_for_ever(folder)), flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
