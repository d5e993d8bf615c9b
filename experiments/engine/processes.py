"""Tasks in processes of this machine, by the standard library: no port, no credentials.

Each process is an executor of its own. One that dies, or takes too much memory, takes
nothing else with it, and it is known whose task it was.
"""

import logging
import math
import multiprocessing
import os
import pickle
import signal
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from ..progress import follow_parent
from .tasks import Engine, WorkerDiedError

_CONTEXT = multiprocessing.get_context("spawn")
# In a process of workers.
_shared: tuple[Any, ...] = ()


class Processes(Engine):
    """Up to `n` processes, each ended if it takes more memory than `max_bytes`."""

    def __init__(self, n: int, *, max_bytes: float = math.inf) -> None:
        super().__init__()
        self.capacity = n
        self._max_bytes = max_bytes
        self._all: set[_Process] = set()
        self._idle: list[_Process] = []

    def submit(
        self, function: Callable[..., Any], shared: tuple[Any, ...], task: Any
    ) -> "Future[Any]":
        """Hand a task to a process that has none, and the same shared values."""
        sent = self.payload(function, task)
        outer: Future[Any] = Future()
        while True:
            process = self._idle.pop() if self._idle else self._start(shared)
            # It died while it had nothing to do.
            with suppress(BrokenProcessPool):
                if [*map(id, shared)] == [*map(id, process.shared)]:
                    inner = process.executor.submit(_call, sent)
                    inner.add_done_callback(partial(self._end, process, outer))
                    return outer
            self._stop(process)

    def watch(self) -> None:
        """End processes that take too much memory, where the system has ``/proc``."""
        for process in [*self._all]:
            if process.memory_bytes() > self._max_bytes:
                limit_gib = self._max_bytes / 2**30
                process.death = f"more than {limit_gib:.3g} GiB of memory"
                process.kill()

    def close(self) -> None:
        """End all processes."""
        for process in [*self._all]:
            self._stop(process)

    def _start(self, shared: tuple[Any, ...]) -> "_Process":
        process = _Process(shared, self.shared_payload(shared))
        self._all.add(process)
        return process

    def _stop(self, process: "_Process") -> None:
        self._all.discard(process)
        process.kill()
        process.executor.shutdown(cancel_futures=True)

    def _end(
        self, process: "_Process", outer: "Future[Any]", inner: "Future[Any]"
    ) -> None:
        """Pass an answer on; called by a thread of the executor."""
        error = inner.exception()
        if isinstance(error, BrokenProcessPool):
            self._all.discard(process)
            outer.set_exception(WorkerDiedError(process.death))
            return
        self._idle.append(process)
        if error is None:
            outer.set_result(inner.result())
        else:
            outer.set_exception(error)


class _Process:
    """A process that takes one call after the other."""

    def __init__(self, shared: tuple[Any, ...], sent: bytes) -> None:
        self.shared = shared
        # Of what it was ended, if it was.
        self.death = ""
        self.executor = ProcessPoolExecutor(1, _CONTEXT, _get_ready, (sent,))
        self._pid = self.executor.submit(os.getpid)

    def memory_bytes(self) -> int:
        """Its memory; 0 where the system does not say, or it begins, or has died."""
        if not self._pid.done() or self._pid.exception() is not None:
            return 0
        try:
            statm = Path(f"/proc/{self._pid.result()}/statm").read_text("ascii")
        except OSError:
            return 0
        return int(statm.split()[1]) * os.sysconf("SC_PAGE_SIZE")

    def kill(self) -> None:
        """End it, whatever it does."""
        with suppress(BrokenProcessPool, ProcessLookupError):
            os.kill(self._pid.result(), signal.SIGKILL)


def _get_ready(sent: bytes) -> None:
    global _shared
    follow_parent()
    # The parent warns.
    logging.disable(logging.WARNING)
    _shared = pickle.loads(sent)


def _call(sent: bytes) -> Any:
    function, task = pickle.loads(sent)
    return function(*_shared, task)
