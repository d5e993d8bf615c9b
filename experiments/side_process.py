"""A second process for tasks that do not depend on one another: matplotlib knows no threads.

This is the one place that decides which process makes what. The second process makes
tasks in the order in which they were begun; the first one makes, when it needs them,
those that nobody has begun to make. Tasks are functions with their arguments; nothing
here knows what they compute.
"""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Generic, ParamSpec, TypeVar

from .language import language, set_language
from .progress import follow_parent, no_tracker_warnings

_P = ParamSpec("_P")
_T = TypeVar("_T")
_CONTEXT = multiprocessing.get_context("spawn")
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
    """Load modules while there is time, and call a function: its module and name, with a colon."""
    for name in modules:
        import_module(name)
    module, _, function = prepare.partition(":")
    if function:
        getattr(import_module(module), function)()


@contextmanager
def side_process(
    is_wanted: bool, *, modules: Sequence[str] = (), prepare: str = ""
) -> Iterator[SideProcess]:
    """A second process for the block, if wanted; idle, it loads modules and calls "module:f"."""
    if not is_wanted:
        yield SideProcess()
        return
    with no_tracker_warnings():
        executor = ProcessPoolExecutor(
            1, mp_context=_CONTEXT, initializer=follow_parent
        )
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
