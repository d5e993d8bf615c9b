"""A process that carries out :class:`.tasks.Tasks` and can be ended, whatever it does."""

import asyncio
import multiprocessing
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from geometry.errors import InputError

from ..language import language, set_language, tr, tr_error
from ..progress import follow_parent
from ..scene import cause_of
from .tasks import Tasks, Work

OnProgress = Callable[[str, int, int], None]
"""Is told a stage, and how much of how much of it is done; 0 of 0: nobody knows."""


class TaskError(RuntimeError):
    """A task that could not be done, in a sentence for the page; with its cause, if it has one.

    The cause is one of ``experiments.scene.CAUSES``: why a junction cannot be planned.
    """

    def __init__(self, text: str, cause: str = "") -> None:
        super().__init__(text)
        self.cause = cause


class DiedError(TaskError):
    """The process ended while it worked, and nobody had asked for it."""


class Cancelled(RuntimeError):
    """The process was ended while it worked."""


class Worker:
    """Runs methods of :class:`.tasks.Tasks` in a process, which starts when it is needed."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._process: Any = None
        self._connection: Connection | None = None
        self._turn = asyncio.Lock()
        self.is_busy = False

    async def call(
        self, method: str, *args: Any, on_progress: OnProgress, **kwargs: Any
    ) -> Any:
        """Result of a method, after all that were called before.

        Parameters
        ----------
        method : str
            Name of a method of :class:`.tasks.Tasks`.
        *args, **kwargs
            Its arguments.
        on_progress : callable
            Is told its stages, in the thread of the event loop.

        Raises
        ------
        TaskError
            The method refused what it was given, or something went wrong that nobody
            foresaw.
        DiedError
            The process ended by itself or was killed, for example because memory ran
            out.
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
            # Whoever stops it takes the connection away.
            was_stopped = self._connection is not connection
            self.stop()
            if was_stopped:
                raise Cancelled
            text = tr(
                "the process that computed this ({name}) was stopped from outside",
                name=method,
            )
            raise DiedError(text)
        raise TaskError(*value)

    def stop(self) -> None:
        """End the process, whatever it does; the next call starts another one."""
        process = self._process
        connection = self._connection
        self._process = None
        self._connection = None
        if process is not None:
            process.terminate()
            process.join(timeout=2.0)
            if process.is_alive():
                process.kill()
                process.join()
        # Else its reader sees the end and closes
        if connection is not None and not self.is_busy:
            connection.close()

    def _start(self) -> Connection:
        """Our end of the pipe to the process, which is started if it does not run."""
        is_running = self._process is not None and self._process.is_alive()
        if self._connection is None or not is_running:
            context = multiprocessing.get_context("spawn")
            ours, theirs = context.Pipe()
            given = (theirs, self._work, language())
            self._process = context.Process(target=_serve, args=given, daemon=False)
            self._process.start()
            # The process has its end; with ours alone open here, its end is seen.
            theirs.close()
            self._connection = ours
        return self._connection


def _exchange(
    connection: Connection, request: Any, tell: OnProgress
) -> tuple[str, Any]:
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


def _serve(connection: Connection, work: Work, code: str) -> None:
    """Carry out tasks until the pipe is closed: the main function of the process.

    Parameters
    ----------
    connection : Connection
        Gets requests (method, args, kwargs). For each it sends ("progress", stage) any
        number of times, and then ("done", result), ("refused", (text, cause)) or
        ("failed", (text,)).
    work : Work
        Of the :class:`.tasks.Tasks`.
    code : str
        Language of what is told.
    """
    follow_parent()
    set_language(code)

    def tell(stage: str, done: int, total: int) -> None:
        connection.send(("progress", (stage, done, total)))

    tasks = Tasks(work, tell)
    while True:
        try:
            method, args, kwargs = connection.recv()
        except EOFError:
            return
        try:
            answer = ("done", getattr(tasks, method)(*args, **kwargs))
        except InputError as error:
            answer = ("refused", (tr_error(error), cause_of(error)))
        except Exception as error:
            text = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
            answer = ("failed", (text,))
        connection.send(answer)
