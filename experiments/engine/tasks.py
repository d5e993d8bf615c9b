"""The one seam through which tasks run elsewhere, and an engine that runs them here.

A task is a value, and a function answers it. Junctions of a city, pictures, blocks of
worlds: none of them knows where it runs, and nothing here knows what is computed.
"""

import logging
import pickle
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from itertools import islice
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from geometry.errors import InputError

_log = logging.getLogger(__name__)
_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")

TRIES = 3
"""Of a task that raises, or whose worker dies."""

LEAST_BYTES = 300 * 2**20
"""Memory that every worker needs: with less, each dies at its first task.

The smallest junction (one case at one speed, coarse poses) takes 344 MiB in a process
that also read its map, of which 90 MiB.
"""

# Engines look after their workers at least as often.
_WATCH_S = 0.2


class WorkerDiedError(Exception):
    """A worker ended without an answer; the text, if there is one, says of what."""


class Engine(ABC):
    """Runs tasks somewhere.

    Attributes
    ----------
    capacity : int
        Tasks that run at the same time.
    tries : int
        How often :func:`map_tasks` hands over a task that fails. 1 where the engine
        itself tries again.
    is_here : bool
        Tasks run in this process, one after the other.
    n_tasks, n_bytes : int
        Tasks that were sent away, and their size.
    n_shared_bytes : int
        Size of the shared values, each counted once.
    """

    capacity = 1
    tries = TRIES
    is_here = False

    def __init__(self) -> None:
        self.n_tasks = 0
        self.n_bytes = 0
        self.n_shared_bytes = 0

    @abstractmethod
    def submit(
        self, function: Callable[..., Any], shared: tuple[Any, ...], task: Any
    ) -> "Future[Any]":
        """Begin `function(*shared, task)`; no more than `capacity` at a time."""

    def watch(self) -> None:
        """Look after the workers. Raises InputError if there is none any more."""
        return

    def payload(self, function: Callable[..., Any], task: Any) -> bytes:
        """A function and its task as bytes, which are counted."""
        sent = pickle.dumps((function, task), protocol=pickle.HIGHEST_PROTOCOL)
        self.n_tasks += 1
        self.n_bytes += len(sent)
        return sent

    def shared_payload(self, value: object) -> bytes:
        """A shared value as bytes, which are counted."""
        sent = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
        self.n_shared_bytes += len(sent)
        return sent

    def tell_sizes(self) -> None:
        """Log how much was sent."""
        if self.n_tasks:
            _log.info(
                "tasks: %d of %.1f kB on average, with %.1f kB that all of them share",
                self.n_tasks,
                self.n_bytes / self.n_tasks / 1e3,
                self.n_shared_bytes / 1e3,
            )


class Here(Engine):
    """Runs each task in this process as soon as it is handed over."""

    is_here = True

    def submit(
        self, function: Callable[..., Any], shared: tuple[Any, ...], task: Any
    ) -> "Future[Any]":
        """Run a task; the future is done."""
        future: Future[Any] = Future()
        try:
            answer = function(*shared, task)
        except Exception as error:  # whatever it is, `map_tasks` decides
            future.set_exception(error)
        else:
            future.set_result(answer)
        return future


def map_tasks(
    function: Callable[..., _Answer],
    tasks: Iterable[_Task],
    *,
    engine: Engine,
    shared: tuple[Any, ...] = (),
    failed: Callable[[_Task, BaseException], _Answer] | None = None,
) -> Iterator[tuple[_Task, _Answer]]:
    """Run a function for many tasks.

    Each with its answer, in the order in which they end.

    Progress, and what to do again after an interruption, are the caller's. Tasks are
    made when a worker is free.

    Parameters
    ----------
    function : callable
        Of a module, so that workers find it by its name.
    tasks : iterable
        What it is called with, one at a time.
    engine : Engine
        Where it runs.
    shared : tuple
        What it is called with before each task: large values, sent once.
    failed : callable, optional
        Answers for a task that raised, or whose worker died, as often as the engine
        tries; by default the error is raised.

    Yields
    ------
    task, answer : tuple
        Answers come in any order.

    Raises
    ------
    InputError
        A task cannot be answered whoever tries, or there is no worker any more.
    WorkerDiedError
        The worker of a task died each time.
    """
    waiting = iter(tasks)
    running: dict[Future[_Answer], tuple[_Task, int]] = {}
    ended: SimpleQueue[Future[_Answer]] = SimpleQueue()

    def hand_over(task: _Task, attempt: int) -> None:
        future = engine.submit(function, shared, task)
        running[future] = (task, attempt)
        future.add_done_callback(ended.put)

    while True:
        n_free = max(engine.capacity - len(running), 0)
        for task in islice(waiting, n_free):
            hand_over(task, 1)
        if not running:
            engine.tell_sizes()
            return
        engine.watch()
        try:
            future = ended.get(timeout=_WATCH_S)
        except Empty:
            continue
        task, attempt = running.pop(future)
        error = future.exception()
        if error is None:
            yield task, future.result()
        elif isinstance(error, InputError):
            raise error
        elif attempt < engine.tries:
            hand_over(task, attempt + 1)
        elif failed is None:
            raise error
        else:
            yield task, failed(task, error)
