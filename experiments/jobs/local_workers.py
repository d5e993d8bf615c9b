"""Processes of this machine that take one task at a time, each with a limit of memory.

They are reached through pipes that nobody else can open; there is no port.
"""

import logging
import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from ..progress import follow_parent

_CONTEXT = multiprocessing.get_context("spawn")


class WorkerDiedError(Exception):
    """A process ended without an answer."""


@dataclass(slots=True, eq=False)
class _Worker:
    """A process, and what it works at."""

    pipe: Connection
    process: Any
    future: Future[Any] | None = None
    death: str = field(default="", init=False)  # why it was ended, if it was


class LocalWorkers:
    """Up to `n` processes; `max_bytes` is the memory of each, beyond which it is ended.

    The memory is watched where the system tells it in ``/proc``.
    """

    def __init__(self, n: int, *, max_bytes: int) -> None:
        self.capacity = n
        self._max_bytes = max_bytes
        self._workers: list[_Worker] = []

    def __enter__(self) -> "LocalWorkers":
        return self

    def __exit__(self, *error: object) -> None:
        for worker in self._workers:
            worker.process.kill()
        for worker in self._workers:
            worker.process.join()
            worker.pipe.close()
        self._workers.clear()

    def submit(self, function: Callable[[Any], Any], task: Any) -> Future[Any]:
        """Hand a task to a process that has none; no more than `capacity` at a time."""
        worker = next((one for one in self._workers if one.future is None), None) or self._start()
        future: Future[Any] = Future()
        worker.future = future
        try:
            worker.pipe.send((function, task))
        except OSError:  # it has died since
            self._lose(worker)
        return future

    def wait(self, timeout_s: float) -> None:
        """Wait for answers, no longer than a time; end processes with too much memory."""
        busy = {one.pipe: one for one in self._workers if one.future is not None}
        for pipe in wait([*busy], timeout_s):
            self._take(busy[pipe])  # type: ignore[index]
        for worker in self._workers:
            if worker.future is not None and _memory_bytes(worker.process.pid) > self._max_bytes:
                worker.death = f"more than {self._max_bytes / 2**30:.3g} GiB of memory"
                worker.process.kill()

    def pids(self) -> list[int]:
        """Numbers of the processes."""
        return [one.process.pid for one in self._workers]

    def _start(self) -> _Worker:
        ours, theirs = _CONTEXT.Pipe()
        process = _CONTEXT.Process(target=_serve, args=(theirs,), daemon=True)
        process.start()
        theirs.close()
        worker = _Worker(pipe=ours, process=process)
        self._workers.append(worker)
        return worker

    def _take(self, worker: _Worker) -> None:
        try:
            is_answer, value = worker.pipe.recv()
        except (EOFError, OSError):
            self._lose(worker)
            return
        future, worker.future = worker.future, None
        assert future is not None
        if is_answer:
            future.set_result(value)
        else:
            future.set_exception(value)

    def _lose(self, worker: _Worker) -> None:
        """Forget a process that has died."""
        self._workers.remove(worker)
        worker.process.join()
        worker.pipe.close()
        if worker.future is not None:
            worker.future.set_exception(WorkerDiedError(worker.death))


def _memory_bytes(pid: int) -> int:
    """Memory of a process; 0 where the system does not say, or the process has died."""
    try:
        pages = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]
    except OSError:
        return 0
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def _serve(pipe: Connection) -> None:
    """What a process does: take a task, answer, and again, as long as the parent lives."""
    follow_parent()
    logging.disable(logging.WARNING)  # the first process tells what there is to tell
    while True:
        try:
            function, task = pipe.recv()
        except EOFError:
            return
        try:
            answer = (True, function(task))
        except Exception as error:  # whatever it is, the parent decides
            answer = (False, RuntimeError(f"{type(error).__name__}: {error}"))
        pipe.send(answer)
