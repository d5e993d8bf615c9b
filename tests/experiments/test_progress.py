import os
import pty
import re
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from experiments import progress as progress_module
from experiments.progress import (
    Interrupted,
    StageProgress,
    ending_on_signals,
    signals_held,
)

STUCK = """
from experiments.progress import StageProgress, ending_on_signals
{prepare}
progress = StageProgress()
progress.start(quiet=False)
with ending_on_signals(progress):
    progress("solve", 0, 0)
    {work}
"""
THREADS = (
    """
import time
from concurrent.futures import ThreadPoolExecutor
def work():
    pool = ThreadPoolExecutor(1)
    try:
        pool.submit(time.sleep, 60.0)
        time.sleep(60.0)
    finally:
        pool.shutdown()  # waits for the worker, deaf to signals
""",
    "work()",
)
# Market split (Cornuejols and Dawande 1998): few rows keep a solver busy for minutes.
SOLVER = (
    """
import highspy
import numpy as np
weights = np.random.default_rng(0).integers(0, 100, (5, 40))
highs = highspy.Highs()
highs.silent()
chosen = [highs.addBinary() for _ in range(40)]
for row in weights:
    half = int(row.sum()) // 2
    highs.addConstr(sum(int(weight) * x for weight, x in zip(row, chosen)) == half)
highs.setOptionValue("time_limit", 60.0)
""",
    "highs.run()",
)
KERNEL = (
    """
import numpy as np
from geometry.kernels import kernel
@kernel
def spin(n, seed):
    state = seed
    for _ in range(n):
        state = (state * 6364136223846793005 + 1442695040888963407) & 0x7FFFFFFFFFFFFFFF
    return state
spin(1, 1)
""",
    "spin(10**12, 1)",
)


def test_each_stage_is_one_line_where_there_is_no_terminal(capsys):
    progress = StageProgress()
    progress.start(quiet=False)
    for stage, done in (
        ("read", 0),
        ("solve", 0),
        ("solve", 1),
        ("solve", 2),
        ("write", 0),
    ):
        progress(stage, done, 2)

    assert capsys.readouterr() == ("", "read ...\nsolve ...\nwrite ...\n")


def test_quiet_shows_nothing_and_keeps_the_times(capsys):
    progress = StageProgress()
    progress.start(quiet=True)
    progress("read", 0, 0)

    assert list(progress.finish()) == ["start", "read", "total"]
    assert capsys.readouterr() == ("", "")


def test_progress_survives_a_closed_stderr(monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    progress = StageProgress()
    progress.start(quiet=False)
    progress("read", 0, 0)
    progress.stop()


def test_a_terminal_gets_a_bar_that_is_gone_in_the_end(monkeypatch):
    main_end, terminal_end = pty.openpty()
    monkeypatch.setenv("TERM", "xterm")
    with open(terminal_end, "w") as terminal:  # noqa: PTH123 - a descriptor, no path
        monkeypatch.setattr(sys, "stderr", terminal)
        progress = StageProgress()
        progress.start(quiet=False)
        progress("detection table", 3, 7)
        progress("detection table", 5, 7)
        time.sleep(0.3)  # the bar is drawn ten times a second
        progress.stop()
        progress.stop()
        shown = ""
        while select.select([main_end], [], [], 0.1)[0]:  # a read may give a part only
            shown += os.read(main_end, 100_000).decode()
    os.close(main_end)

    assert "detection table" in shown
    assert "5/7" in shown

    plain = re.sub(r"\x1b\[[\d;?]*\w", "", shown)
    assert re.search(r"5/7 +\d:\d\d:\d\d left \d:\d\d:\d\d", plain)
    assert shown.rindex("\x1b[2K") > shown.rindex("detection table")  # erased
    assert shown.rindex("\x1b[?25h") > shown.rindex("\x1b[?25l")  # the cursor is back


def test_parts_of_a_stage_count_as_one_and_the_total_is_their_sum():
    progress = StageProgress()
    for stage in ("solve", "solve: first", "solve: second", "write"):
        progress(stage, 0, 0)
    seconds = progress.finish()

    assert list(seconds) == ["start", "solve", "write", "total"]
    assert seconds["total"] == pytest.approx(sum(progress.seconds.values()), abs=0.002)


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_the_block_and_leave_the_handlers_as_they_were(signum):
    before = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)]
    with pytest.raises(Interrupted) as caught, ending_on_signals(StageProgress()):
        signal.raise_signal(signum)
    assert caught.value.signum == signum
    assert [
        signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)
    ] == before


def test_a_second_signal_does_not_disturb_the_tidying_up():
    tidied = []

    def work():
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGTERM)
            tidied.append(True)

    with pytest.raises(Interrupted), ending_on_signals(StageProgress()):
        work()
    assert tidied == [True]


def test_no_library_catches_an_interruption_as_an_error():
    assert not issubclass(Interrupted, (Exception, KeyboardInterrupt))


def test_held_signals_are_delivered_in_the_end():
    steps = []

    def work():
        with signals_held():
            signal.raise_signal(signal.SIGTERM)
            steps.append("done")
        steps.append("never")

    with pytest.raises(Interrupted), ending_on_signals(StageProgress()):
        work()
    assert steps == ["done"]


def test_held_signals_can_be_dropped():
    with ending_on_signals(StageProgress()), signals_held() as held:
        signal.raise_signal(signal.SIGINT)
        assert held == [signal.SIGINT]
        held.clear()


def test_signals_are_left_alone_outside_the_main_thread():
    held = []

    def work():
        with signals_held() as signals:
            held.append(signals)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()

    assert held == [[]]


@pytest.mark.long
@pytest.mark.parametrize(
    ("prepare", "work"),
    [
        pytest.param(*THREADS, id="threads"),
        pytest.param(*SOLVER, id="solver"),
        pytest.param(*KERNEL, id="kernel"),
    ],
)
def test_what_does_not_listen_is_ended(prepare, work, tmp_path):
    # A file: machine code is kept by the file that it comes from.
    script = tmp_path / "stuck.py"
    script.write_text(STUCK.format(prepare=prepare, work=work))
    process = subprocess.Popen(
        [sys.executable, str(script)],
        env=os.environ
        | {"PYTHONPATH": str(Path.cwd()), "XDG_CACHE_HOME": str(tmp_path)},
        stderr=subprocess.PIPE,
        text=True,
    )

    assert process.stderr is not None

    lines = iter(process.stderr.readline, "")  # a kernel says first that it is compiled
    assert next(line for line in lines if "compiling" not in line) == "solve ...\n"

    time.sleep(0.2)  # until it is at work
    began_s = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=30)

    assert process.returncode == 130
    assert message == "place-rsus: interrupted in stage 'solve': nothing was written\n"
    assert time.monotonic() - began_s < 5.0  # 0.7 s, and a busy machine


def test_without_a_terminal_a_long_stage_says_how_far_it_is(monkeypatch, capsys):
    monkeypatch.setattr(progress_module, "LINE_EVERY_S", 0.0)
    progress = StageProgress()
    progress.start(quiet=False)
    for done in range(3):
        progress("junctions", done, 3)
    progress.stop()
    lines = [
        "junctions ...",
        "junctions: 0 of 3",
        "junctions: 1 of 3",
        "junctions: 2 of 3",
    ]

    assert capsys.readouterr().err.splitlines() == lines

    monkeypatch.setattr(progress_module, "LINE_EVERY_S", 60.0)
    progress = StageProgress()
    progress.start(quiet=False)
    for done in range(3):
        progress("junctions", done, 3)
    progress.stop()

    assert capsys.readouterr().err.splitlines() == lines[:1]
