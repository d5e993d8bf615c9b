import os
import subprocess
import sys

import pytest

from experiments.bench.main_job import time_command


def test_the_first_lines_of_a_command_are_timed():
    program = """
import sys, time
print("Found and proven on the table", file=sys.stderr, flush=True)
time.sleep(0.2)
"""
    timing = time_command([sys.executable, "-c", program], dict(os.environ))

    assert timing.first_line_s is not None
    assert timing.first_line_s < timing.wall_s - 0.1
    assert timing.processor_s > 0.0
    with pytest.raises(subprocess.CalledProcessError):
        time_command([sys.executable, "-c", "raise SystemExit(3)"], dict(os.environ))
