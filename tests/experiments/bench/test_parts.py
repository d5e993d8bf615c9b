import json
import os
import subprocess
import sys

import pytest
from click.testing import CliRunner

from experiments.bench.__main__ import PARTS, main, run_part
from experiments.bench.main_job import time_command


def test_a_part_whose_time_is_up_is_ended_and_says_so():
    figures = run_part("single", budget=1, limit_s=0.01)
    assert figures == {"single: ended after so many seconds, not finished": 0.01}


def test_figures_of_other_parts_stay_in_the_file(tmp_path):
    path = tmp_path / "bench.json"
    path.write_text(json.dumps({"rays": {"rays cast": 7}, "of another time": 1.0}))
    words = ["single", "--limit", "0.01", "--out", str(path)]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    figures = json.loads(path.read_text())
    assert list(figures) == ["machine", "rays", "single"]
    assert figures["rays"] == {"rays cast": 7}


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


def test_an_unknown_part_is_told_with_those_there_are():
    result = CliRunner().invoke(main, ["single", "speed"])
    assert result.exit_code == 2
    assert f"speed: expected some of {', '.join(PARTS)}" in " ".join(
        result.output.split()
    )
