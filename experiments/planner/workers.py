"""The processes of a session, and the coroutines that wait for them."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from .tasks import Work
from .worker import Worker

MakeWorker = Callable[[Work], Worker]
"""Makes a process that works for a question; tests make one that runs in a thread."""


class Workers:
    """The processes that work for what is shown.

    The evaluator and the optimiser know one question and scene: :meth:`begin` replaces
    them. The reader reads maps, which it remembers, whatever is shown.
    """

    def __init__(self, make: MakeWorker, work: Work) -> None:
        self.make = make
        self.evaluator = make(work)
        self.optimiser = make(work)
        self.reader = make(work)

    def begin(self, work: Work, evaluator: Worker | None) -> None:
        """Work for another question or scene; an `evaluator` may have read it already."""
        self.evaluator.stop()
        self.optimiser.stop()
        if evaluator is None:
            evaluator = self.make(work)
        self.evaluator = evaluator
        self.optimiser = self.make(work)

    def stop(self) -> None:
        """End them all; from any thread."""
        for worker in (self.evaluator, self.optimiser, self.reader):
            worker.stop()


class Coroutines:
    """Coroutines that run beside the answers to browsers, for the event loop's thread."""

    def __init__(self) -> None:
        self._running: set[asyncio.Task[None]] = set()

    def start(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a coroutine; it is kept until it has ended."""
        task = asyncio.get_running_loop().create_task(work)
        self._running.add(task)
        task.add_done_callback(self._running.discard)
