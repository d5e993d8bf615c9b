"""The process as the shell starts it."""

import ctypes
import subprocess
import sys

import pytest

from experiments import start

_COUNT_HEAPS = """
import threading
from pathlib import Path
from experiments.start import _share_one_heap
if {shares}:
    _share_one_heap()
gate = threading.Barrier(5)
def hold():
    kept = [bytearray(1000) for _ in range(2000)]
    gate.wait()
    gate.wait()
threads = [threading.Thread(target=hold) for _ in range(4)]
for thread in threads:
    thread.start()
gate.wait()
# glibc sets 64 MiB of addresses aside for each further heap.
sizes = [line.split()[0].split("-") for line in Path("/proc/self/maps").open()]
print(sum(int(end, 16) % 2**26 == 0 for begin, end in sizes))
gate.wait()
"""


def count_heaps(shares):
    """Heaps of a new process with four threads that allocate."""
    code = _COUNT_HEAPS.format(shares=shares)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return int(done.stdout)


@pytest.mark.skipif(
    not hasattr(ctypes.CDLL(None), "mallopt"), reason="the C library is not glibc"
)
def test_threads_share_one_heap():
    assert count_heaps(True) < count_heaps(False)


@pytest.mark.parametrize("error", [AttributeError, OSError, TypeError])
def test_another_c_library_changes_nothing(monkeypatch, error):
    def refuse(_name):
        raise error

    monkeypatch.setattr(ctypes, "CDLL", refuse)
    start._share_one_heap()
