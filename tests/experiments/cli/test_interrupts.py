"""Ctrl-C in the real program, in one stage after the other: it ends soon, and nothing
is left.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

# In one process, quickly: tests/experiments/cli/test_cli.py.
pytestmark = pytest.mark.long
STAGES = ("detection table", "optimise", "evaluate", "write results")
OUT = "found"
COMMAND = [
    "--budget",
    "2",
    "--cases",
    "CPNC-50",
    "--approaches",
    "north",
    "--along-arms",
    "0",
    "--out",
    OUT,
]
ENOUGH_S = 5.0
"""Of the processors, in all threads; a second is what users are promised."""
# Loads the program once; each stage has a process of its own, forked from it.
SCRIPT = """
import json, os, signal, sys, time
from pathlib import Path
from experiments.jobs import placement
from experiments.main import main

# As at any other junction: it takes long.
placement.on_study_cases = lambda *given, **options: None

def processor_s(process):
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")

stages, command = json.loads(sys.argv[1]), json.loads(sys.argv[2])
for stage in stages:
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.dup2(writer, 2)
        os.close(reader), os.close(writer)
        main(command)
    os.close(writer)
    with os.fdopen(reader) as told:
        lines = [next(line for line in told if line == f"{stage} ...\\n")]
        time.sleep(0.1)
        began_s = processor_s(child)
        os.kill(child, signal.SIGINT)
        lines += told.readlines()
    _, status, used = os.wait4(child, 0)
    kept = [path for path in Path("../cache").rglob("*") if path.is_file()]
    print(json.dumps({
        "stage": stage,
        "code": os.waitstatus_to_exitcode(status),
        "seconds": used.ru_utime + used.ru_stime - began_s,
        "last": lines[-1],
        "left": sorted(path.name for path in Path().iterdir()),
        "kept": sorted(path.suffix for path in kept),
    }))
"""


@pytest.fixture(scope="module")
def ends(tmp_path_factory):
    """How the program ended in each stage."""
    folder = tmp_path_factory.mktemp("interrupts")
    (folder / "work").mkdir()
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, json.dumps(STAGES), json.dumps(COMMAND)],
        cwd=folder / "work",
        env=os.environ
        | {"PLACE_RSUS_CACHE": str(folder / "cache"), "PYTHONPATH": str(Path.cwd())},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return {end["stage"]: end for end in map(json.loads, done.stdout.splitlines())}


@pytest.mark.parametrize("stage", STAGES)
def test_ctrl_c_ends_the_program_in_every_stage_and_leaves_nothing(ends, stage):
    end = ends[stage]
    assert end["code"] == 130
    assert end["seconds"] < ENOUGH_S
    # The next stage may have begun meanwhile.
    assert end["last"].startswith("place-rsus: interrupted in stage '")
    assert f": nothing was written to {OUT}" in end["last"]
    assert end["left"] == []
    # Whole tables and runs: no temporary file.
    assert set(end["kept"]) <= {
        ".npz",
        ".msgpack",
    }


def test_a_table_that_is_done_is_kept_for_the_next_call(ends):
    assert ends["detection table"]["kept"] == [".msgpack"]  # the runs
    # The table, the runs, and the proven answers: the best layout, the front below,
    # what is lost.
    assert ends["evaluate"]["kept"].count(".npz") == 1
    assert ".msgpack" in ends["evaluate"]["kept"]
    assert ends["evaluate"]["last"].endswith(
        "; the detection table is cached for the next call\n"
    )
