"""A second process for tasks that do not depend on one another.

Matplotlib knows no threads.

And processes that share many tasks of one kind, such as junctions of a city or
pictures.

This is the one place that decides which process makes what. The second process makes
tasks in the order in which they were begun; the first one makes, when it needs them,
those that nobody has begun to make. Tasks are functions with their arguments; nothing
here knows what they compute.
"""

import logging
import math
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from itertools import islice
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for_pipes
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

from .language import language, set_language
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


class Task(Generic[_T]):
    """Something that a second process makes, or this one when it is needed."""

    def __init__(self, make: Callable[[], _T], future: "Future[_T] | None") -> None:
        self._make = make
        self._future = future

    def take(self) -> None:
        """Make it here unless it is being made already."""
        if self._future is None or self._future.cancel():
            self._future = Future()
            self._future.set_result(self._make())

    def result(self, on_wait: Callable[[], None] = lambda: None) -> _T:
        """Its result: waited for, or made here; `on_wait` is called before a wait."""
        self.take()
        assert self._future is not None
        if not self._future.done():
            on_wait()
        try:
            return self._future.result()
        except BrokenProcessPool:  # the other process was killed
            return self._make()


class SideProcess:
    """Makes tasks in a second process; in this one, where there is none."""

    def __init__(self, executor: ProcessPoolExecutor | None = None) -> None:
        self._executor = executor
        self._begun: dict[str, Task[Any]] = {}
        self._shared: dict[
            int, object
        ] = {}  # a reference each, so that no other gets its id

    @property
    def exists(self) -> bool:
        """There is a second process."""
        return self._executor is not None

    def share(self, value: object) -> None:
        """Send a large value once: tasks that get it as an argument find it there."""
        if self._executor is not None and id(value) not in self._shared:
            self._submit(_receive, id(value), value)
            self._shared[id(value)] = value

    def begin(
        self, name: str, make: Callable[_P, _T], *args: _P.args, **kwargs: _P.kwargs
    ) -> Task[_T]:
        """Begin a task; one that was begun under the same name is that one.

        Need results in the opposite order: then both processes work until all is done.
        """
        if name not in self._begun:
            sent = [
                _Shared(id(value)) if id(value) in self._shared else value
                for value in args
            ]
            future = self._submit(_make, language(), make, sent, kwargs)
            self._begun[name] = Task(lambda: make(*args, **kwargs), future)
        task: Task[_T] = self._begun[name]
        return task

    def _submit(
        self, function: Callable[..., _T], *args: object
    ) -> "Future[_T] | None":
        if self._executor is not None:
            try:
                return self._executor.submit(function, *args)
            except BrokenProcessPool:
                self._executor = None
        return None


@dataclass(frozen=True, slots=True)
class _Shared:
    """Stands for a value that the second process has."""

    key: int


def _receive(key: int, value: object) -> None:
    _received[key] = value


def _make(
    code: str, make: Callable[..., _T], args: Sequence[object], kwargs: dict[str, Any]
) -> _T:
    """Call a function in the second process, which speaks the language of the first."""
    set_language(code)
    values = (
        _received[value.key] if isinstance(value, _Shared) else value for value in args
    )
    return make(*values, **kwargs)


def _get_ready(modules: Sequence[str], prepare: str) -> None:
    """Load modules while there is time, and call a function.

    Its module and name, with a colon.
    """
    for name in modules:
        import_module(name)
    module, _, function = prepare.partition(":")
    if function:
        getattr(import_module(module), function)()


@contextmanager
def side_process(
    is_wanted: bool, *, modules: Sequence[str] = (), prepare: str = ""
) -> Iterator[SideProcess]:
    """A second process for the block, if wanted.

    Idle, it loads modules and calls "module:f".
    """
    if not is_wanted:
        yield SideProcess()
        return
    # Where this process is ended at once (see `ending_on_signals`), its resource
    # tracker would warn of what is left to clean up.
    sys.warnoptions.append(_NO_WARNING)
    executor = ProcessPoolExecutor(1, mp_context=_CONTEXT, initializer=follow_parent)
    before = multiprocessing.active_children()
    executor.submit(_get_ready, modules, prepare)
    children = [
        child for child in multiprocessing.active_children() if child not in before
    ]
    try:
        yield SideProcess(executor)
    except BaseException:
        for child in children:  # nobody is to wait for it
            child.terminate()
        raise
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        sys.warnoptions.remove(_NO_WARNING)


# ---------- processes that each take one task after the other


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
