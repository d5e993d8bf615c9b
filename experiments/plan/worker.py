"""A process that does what takes long, one task at a time; it can be ended at any moment."""

import asyncio
import multiprocessing
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from geometry.errors import InputError

from ..progress import follow_parent
from .tasks import Tasks, Work

OnProgress = Callable[[str, int, int], None]


class TaskError(RuntimeError):
    """A task that could not be done, in a sentence for the page."""


class DiedError(TaskError):
    """The process ended while it worked, and nobody had asked for it."""


class Cancelled(RuntimeError):
    """The process was ended while it worked."""


class Worker:
    """Runs methods of :class:`.tasks.Tasks` in a second process, which starts when it is needed.

    Attributes
    ----------
    is_busy : bool
        Whether it works.
    """

    def __init__(self, work: Work) -> None:
        self._work = work
        self._process: Any = None
        self._connection: Connection | None = None
        self._turn = asyncio.Lock()
        self.is_busy = False

    async def call(self, method: str, *args: Any, on_progress: OnProgress, **kwargs: Any) -> Any:
        """What a method returns; waits for its turn.

        Raises
        ------
        TaskError
            The method refused what it was given, or something went wrong that nobody foresaw.
        DiedError
            Its process ended by itself or was killed, for example because memory ran out.
        Cancelled
            :meth:`stop` was called meanwhile.
        """
        loop = asyncio.get_running_loop()

        def tell(stage: str, done: int, total: int) -> None:
            loop.call_soon_threadsafe(on_progress, stage, done, total)

        async with self._turn:
            self.is_busy = True
            try:
                connection = self._start()
                kind, value = await asyncio.to_thread(
                    _exchange, connection, (method, args, kwargs), tell
                )
            finally:
                self.is_busy = False
        if kind == "done":
            return value
        if kind == "ended":
            was_stopped = self._connection is not connection
            self.stop()
            if was_stopped:
                raise Cancelled
            raise DiedError(f"the process that did it ({method}) was ended from outside")
        raise TaskError(value)

    def stop(self) -> None:
        """End the process, whatever it does; the next call starts another one."""
        process, self._process = self._process, None
        connection, self._connection = self._connection, None
        if process is not None:
            process.terminate()
            process.join(timeout=2.0)
            if process.is_alive():
                process.kill()
                process.join()
        if connection is not None and not self.is_busy:  # else its reader sees the end and closes
            connection.close()

    def _start(self) -> Connection:
        if self._process is None or self._connection is None or not self._process.is_alive():
            context = multiprocessing.get_context("spawn")
            ours, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(theirs, self._work), daemon=False)
            self._process.start()
            theirs.close()
            self._connection = ours
        return self._connection


def _exchange(connection: Connection, request: Any, tell: OnProgress) -> tuple[str, Any]:
    """Send a request and wait for its answer; ("ended", None) where the process ends."""
    try:
        connection.send(request)
        while True:
            kind, value = connection.recv()
            if kind != "progress":
                return kind, value
            tell(*value)
    except (EOFError, OSError):
        connection.close()
        return "ended", None


def _serve(connection: Connection, work: Work) -> None:
    """What the process does: tasks until the pipe is closed."""
    follow_parent()
    tasks = Tasks(work, lambda stage, done, total: _tell(connection, stage, done, total))
    while True:
        try:
            method, args, kwargs = connection.recv()
        except EOFError:
            return
        try:
            answer = ("done", getattr(tasks, method)(*args, **kwargs))
        except InputError as error:
            answer = ("refused", str(error))
        except Exception as error:
            answer = ("failed", f"{type(error).__name__}: {' '.join(str(error).split())[:300]}")
        connection.send(answer)


def _tell(connection: Connection, stage: str, done: int, total: int) -> None:
    connection.send(("progress", (stage, done, total)))
