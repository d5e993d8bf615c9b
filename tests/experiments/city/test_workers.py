"""Processes that take tasks: answers, errors, deaths, memory, and who can reach
them.
"""

import os
import time
from pathlib import Path

import pytest

from experiments.city.workers import LocalWorkers, WorkerDiedError


@pytest.fixture(scope="module")
def workers():
    with LocalWorkers(1, max_bytes=2**29) as started:
        yield started


def end_of(workers, function, task):
    future = workers.submit(function, task)
    while not future.done():
        workers.wait(0.05)
    return future


def test_a_process_takes_one_task_after_the_other_and_survives_errors(workers):
    assert end_of(workers, abs, -3).result() == 3
    pids = [one.process.pid for one in workers._workers]
    assert len(pids) == 1
    with pytest.raises(RuntimeError, match=r"^TypeError: bad operand"):
        end_of(workers, abs, "x").result()
    assert end_of(workers, abs, -4).result() == 4
    assert [one.process.pid for one in workers._workers] == pids


def test_a_process_that_dies_is_replaced(workers):
    with pytest.raises(WorkerDiedError, match=r"^$"):
        end_of(workers, os._exit, 3).result()
    assert end_of(workers, abs, -5).result() == 5


@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="the system does not tell"
)
def test_a_process_with_too_much_memory_is_ended_and_this_is_said():
    said = r"^more than 0.000977 GiB of memory$"
    with (
        LocalWorkers(1, max_bytes=2**20) as workers,
        pytest.raises(WorkerDiedError, match=said),
    ):
        end_of(workers, time.sleep, 60.0).result()  # Python alone takes more


@pytest.mark.skipif(
    not Path("/proc/net/tcp").exists(), reason="the system does not tell"
)
def test_no_process_listens_at_a_port(workers):
    import psutil

    end_of(workers, abs, -1)
    for pid in [one.process.pid for one in workers._workers]:
        assert not psutil.Process(pid).net_connections()


def test_processes_end_with_their_workers():
    with LocalWorkers(2, max_bytes=2**30) as workers:
        futures = [workers.submit(time.sleep, 60.0) for _ in range(2)]
        pids = [one.process.pid for one in workers._workers]
        assert len(pids) == 2
    assert not any(future.done() for future in futures)
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
