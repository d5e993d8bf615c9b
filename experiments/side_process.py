"""Processes that share many tasks of one kind.

Such as junctions of a city or pictures.
"""

import logging
import math
import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field
from itertools import islice
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for_pipes
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from .progress import follow_parent

_P = ParamSpec("_P")
_T = TypeVar("_T")
_In = TypeVar("_In")
TRIES = 3
"""Of a task that raises, or whose process dies."""
_WATCH_S = 0.2  # the memory of processes is looked at as often
_CONTEXT = multiprocessing.get_context("spawn")
_NO_WARNING = "ignore:resource_tracker:UserWarning"
_received: dict[int, object] = {}  # in the second process


class WorkerDiedError(Exception):
    """A process ended without an answer."""


@dataclass(slots=True, eq=False)
class _Worker:
    """A process, and the answer it works at."""

    pipe: Connection
    process: Any
    future: Future[Any] | None = None
    death: str = field(default="", init=False)  # why it was ended, if it was


class LocalWorkers:
    """Up to `n` processes on this machine.

    Each is ended if it takes more memory than `max_bytes`.

    They are reached through pipes that nobody else can open. Memory is watched where
    the system has ``/proc``.
    """

    def __init__(self, n: int, *, max_bytes: float = math.inf) -> None:
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
        worker = (
            next((one for one in self._workers if one.future is None), None)
            or self._start()
        )
        future: Future[Any] = Future()
        worker.future = future
        try:
            worker.pipe.send((function, task))
        except OSError:  # it has died since
            self._lose(worker)
        return future

    def wait(self, timeout_s: float) -> None:
        """Wait for answers, no longer than a time.

        End processes with too much memory.
        """
        busy = {one.pipe: one for one in self._workers if one.future is not None}
        for pipe in wait_for_pipes([*busy], timeout_s):
            self._take(busy[pipe])  # type: ignore[index]
        for worker in self._workers:
            if (
                worker.future is not None
                and _memory_bytes(worker.process.pid) > self._max_bytes
            ):
                worker.death = f"more than {self._max_bytes / 2**30:.3g} GiB of memory"
                worker.process.kill()

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
        future = worker.future
        worker.future = None
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
    """Main function of a process: tasks and answers, as long as the parent lives."""
    follow_parent()
    logging.disable(logging.WARNING)  # the parent warns
    while True:
        try:
            function, task = pipe.recv()
        except EOFError:
            return
        try:
            answer = (True, function(task))
        except Exception as error:  # whatever it is, the parent decides
            text = f"{type(error).__name__}: {error}"
            answer = (
                False,
                error if isinstance(error, OSError) else RuntimeError(text),
            )
        pipe.send(answer)


def run_tasks(
    workers: LocalWorkers,
    function: Callable[[_In], _T],
    tasks: Iterable[_In],
    *,
    failed: Callable[[_In, BaseException], _T] | None = None,
) -> Iterator[tuple[_In, _T]]:
    """Run a function for tasks on workers.

    Each with its answer, in the order in which they end.

    A task that raises, or whose worker dies, is tried three times in all; then `failed`
    answers, by default by raising the error, WorkerDiedError if it died.
    """
    waiting = iter(tasks)
    running: dict[Future[_T], tuple[_In, int]] = {}
    while True:
        for task in islice(waiting, max(workers.capacity - len(running), 0)):
            running[workers.submit(function, task)] = (task, 1)
        if not running:
            return
        workers.wait(_WATCH_S)
        for future in [one for one in running if one.done()]:
            task, attempt = running.pop(future)
            error = future.exception()
            if error is None:
                yield task, future.result()
            elif attempt < TRIES:
                running[workers.submit(function, task)] = (task, attempt + 1)
            elif failed is None:
                raise error
            else:
                yield task, failed(task, error)


def in_processes(
    function: Callable[[_In], _T], tasks: Iterable[_In], *, n: int
) -> Iterator[tuple[_In, _T]]:
    """Tasks with the answers of a function as they come.

    By processes, or here if `n` is 1.
    """
    if n <= 1:
        for task in tasks:
            yield task, function(task)
        return
    with LocalWorkers(n) as workers:
        yield from run_tasks(workers, function, tasks)
