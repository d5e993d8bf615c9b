"""Processes that work for the page: they answer, are stopped, and none is left."""

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import contextmanager
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import pytest
from command_results import refusal
from plan_sessions import small_work

from experiments.export.json import to_json
from experiments.planner.worker import Cancelled, DiedError, TaskError, Worker
from placement.compute import silent
from placement.layout import load_carlancap_layout

ROOT = Path(__file__).parents[3]
MAP = str(ROOT / "docs/maps/crossing.osm")


# Quickly: the command below, whose tasks are done elsewhere, too
@pytest.mark.long
def test_tasks_are_done_elsewhere_by_a_process_that_may_be_stopped_or_die(tmp_path):
    """One story, for each process takes a second to begin."""
    worker = Worker(small_work(tmp_path))

    async def begin_what_takes_long():
        begun = asyncio.Event()
        task = asyncio.create_task(
            worker.call("open_setting", on_progress=lambda *stage: begun.set())
        )
        await begun.wait()
        return task, worker._process

    async def work():
        # What it does is told, and what it refuses.
        told = []
        found = await worker.call(
            "survey", MAP, on_progress=lambda stage, done, total: told.append(stage)
        )
        assert found["junctions"]
        assert "read" in told
        with pytest.raises(TaskError, match=r"nowhere\.osm: got .*; expected"):
            await worker.call("survey", "nowhere.osm", on_progress=silent)
        with pytest.raises(TaskError, match="AttributeError"):
            await worker.call("fly", on_progress=silent)
        # Work that is stopped is cancelled.
        task, process = await begin_what_takes_long()
        worker.stop()
        with pytest.raises(Cancelled):
            await task
        assert not process.is_alive()
        assert not worker.is_busy
        # The next task is done, by another process; that one is killed.
        task, another = await begin_what_takes_long()
        assert another.pid != process.pid
        os.kill(another.pid, signal.SIGKILL)
        with pytest.raises(
            DiedError, match=r"\(open_setting\) was stopped from outside"
        ):
            await task
        # So the next is done by a third, which ends when it is told to.
        assert (await worker.call("survey", MAP, on_progress=silent))["junctions"]
        last = worker._process
        worker.stop()
        assert not last.is_alive()

    try:
        asyncio.run(work())
    finally:
        worker.stop()


WORDS = [
    "plan",
    "--no-open",
    "--cases",
    "CPNC-50",
    "--along-arms",
    "0",
    "--speeds",
    "50",
    "--layout",
]


@contextmanager
def serving(layout, folder):
    """The command in a process of its own, and the address that it says."""
    pytest.importorskip("starlette", reason="place-rsus[plan] is not installed")
    with subprocess.Popen(
        [sys.executable, "-m", "experiments.main", *WORDS, layout],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=ROOT,
        env=os.environ | {"TMPDIR": str(folder), "PYTHONPATH": str(ROOT)},
        start_new_session=True,
    ) as process:
        line = process.stdout.readline()
        yield process, line.removeprefix("The page is at ").strip()


@contextmanager
def joined(address, who, stages):
    """A line as that of a page, once the session says that `who` does something."""
    from websockets.sync.client import connect

    origin = "/".join(address.split("/")[:3])
    live = address.replace("http:", "ws:") + "live"
    with connect(live, origin=origin, max_size=None) as line:
        for text in line:
            told = json.loads(text)
            is_doing = told["type"] == "doing" and told["who"] == who
            if is_doing and stages(told["stage"]):
                break
        yield line


# Quickly, without a process: test_server.py
@pytest.mark.long
@pytest.mark.parametrize("is_closed", [False, True], ids=["ctrl-c", "closed"])
def test_the_command_serves_until_it_ends_and_leaves_nothing_behind(
    tmp_path, is_closed
):
    with serving("carlancap-12", tmp_path) as (process, address):
        assert address.startswith("http://127.0.0.1:")

        with urllib.request.urlopen(address) as answer:
            assert b"<title>Plan" in answer.read()
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(address.rsplit("/", 2)[0] + "/")

        if is_closed:
            # A tab is closed while its layout is being evaluated.
            with joined(address, "evaluator", lambda stage: True) as line:
                line.close(1001)
            said = "The page was closed: ended."
        else:
            process.send_signal(signal.SIGINT)
            said = "\nEnded."
        assert said in process.stdout.read()
        assert process.wait(timeout=60) == 0

    for _ in range(100):  # whatever it had started ends with it
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        raise AssertionError("a process is left")
    assert not list(tmp_path.glob("place-rsus-plan-*"))


@pytest.mark.long
def test_ctrl_c_ends_it_at_once_while_a_thousand_units_are_counted(tmp_path):
    study = load_carlancap_layout()
    units = []
    for index, unit in zip(range(1000), cycle(study.units), strict=False):
        position_m = unit.pose.position_m + [0.0, 0.0, 0.001 * index]
        pose = replace(unit.pose, position_m=position_m)
        units.append(replace(unit, id=f"U{index}", pose=pose))
    layout = tmp_path / "many.json"
    layout.write_text(to_json(replace(study, units=tuple(units))))

    with serving(str(layout), tmp_path) as (process, address):
        # Without a stage, it is ready to count.
        with joined(address, "rays", lambda stage: stage == ""):
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=15) == 0
        assert "Ended." in process.stdout.read()

    assert not list(tmp_path.glob("place-rsus-plan-*"))


def test_others_are_let_in_only_by_who_says_so(run):
    assert refusal(run("plan --host 0.0.0.0")) == (
        "--host: got 0.0.0.0; expected --i-know beside it: others could change the plan"
    )
