"""Processes that take tasks: answers, errors, deaths, memory, and who can reach
them.
"""

import os
import time
from pathlib import Path

import pytest

from experiments.engine.processes import Processes
from experiments.engine.tasks import WorkerDiedError, map_tasks


@pytest.fixture(scope="module")
def workers():
    """A process with 512 MiB."""
    started = Processes(1, max_bytes=2**29)
    yield started
    started.close()


def answers_of(workers, function, tasks, **more):
    """Answers in the order of tasks."""
    return [answer for _, answer in map_tasks(function, tasks, engine=workers, **more)]


def pids(workers):
    """Process ids of all workers."""
    return [one._pid.result() for one in workers._all]


def test_a_process_takes_one_task_after_the_other_and_survives_errors(workers):
    assert answers_of(workers, abs, [-3, -4]) == [3, 4]

    before = pids(workers)
    assert len(before) == 1
    with pytest.raises(TypeError, match=r"^bad operand"):
        answers_of(workers, abs, ["x"])
    assert answers_of(workers, abs, [-4]) == [4]
    assert pids(workers) == before


@pytest.mark.long
def test_a_process_that_dies_is_replaced(workers):
    with pytest.raises(WorkerDiedError, match=r"^$"):
        answers_of(workers, os._exit, [3])
    assert answers_of(workers, abs, [-5]) == [5]


def test_shared_values_are_sent_once_for_many_tasks():
    shared = (b"x" * 100_000,)
    workers = Processes(1)
    try:
        found = answers_of(workers, bytes.count, [b"x"] * 5, shared=shared)
    finally:
        workers.close()

    assert found == [100_000] * 5
    assert 100_000 < workers.n_shared_bytes < 101_000
    assert workers.n_tasks == 5
    assert workers.n_bytes < 1_000


@pytest.mark.long
@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="the system does not tell"
)
def test_a_process_with_too_much_memory_is_ended_and_this_is_said():
    said = r"^more than 0.000977 GiB of memory$"
    workers = Processes(1, max_bytes=2**20)
    try:
        with pytest.raises(WorkerDiedError, match=said):
            answers_of(workers, time.sleep, [60.0])  # Python alone takes more
    finally:
        workers.close()


@pytest.mark.skipif(
    not Path("/proc/net/tcp").exists(), reason="the system does not tell"
)
def test_no_process_listens_at_a_port(workers):
    import psutil

    answers_of(workers, abs, [-1])
    for pid in pids(workers):
        assert not psutil.Process(pid).net_connections()


def test_processes_end_with_their_workers():
    workers = Processes(2, max_bytes=2**30)
    futures = [workers.submit(time.sleep, (), 60.0) for _ in range(2)]
    started = pids(workers)

    assert len(started) == 2

    workers.close()
    assert not any(future.cancelled() for future in futures)
    for pid in started:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
