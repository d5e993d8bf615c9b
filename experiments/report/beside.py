"""A second process that draws while the first goes on: matplotlib knows no threads."""

import multiprocessing
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Generic, ParamSpec, TypeVar

from ..progress import follow_parent

_P = ParamSpec("_P")
_T = TypeVar("_T")
_NO_WARNING = "ignore:resource_tracker:UserWarning"


class Part(Generic[_T]):
    """Something that is made beside the main process, or when it is asked for."""

    def __init__(self, make: Callable[[], _T], future: "Future[_T] | None") -> None:
        self._make, self._future = make, future

    def take(self) -> None:
        """Make it here unless it is being made already."""
        if self._future is None or self._future.cancel():
            self._future = Future()
            self._future.set_result(self._make())

    def result(self, tell: Callable[[], None] = lambda: None) -> _T:
        """What it is: waited for, or made here if nobody has begun to; `tell` before a wait."""
        self.take()
        assert self._future is not None
        if not self._future.done():
            tell()
        try:
            return self._future.result()
        except BrokenProcessPool:  # the other process was killed
            return self._make()


class Beside:
    """Makes parts of a report in a second process; in this one, where there is none."""

    def __init__(self, executor: ProcessPoolExecutor | None = None) -> None:
        self._executor = executor
        self._begun: dict[str, Part[Any]] = {}

    def begin(
        self, name: str, make: Callable[_P, _T], *args: _P.args, **kwargs: _P.kwargs
    ) -> Part[_T]:
        """Begin a part; one that was begun under the same name is that one.

        Take parts in the opposite order: then both processes work until all is done.
        """
        if name not in self._begun:
            future = None
            if self._executor is not None:
                try:
                    future = self._executor.submit(make, *args, **kwargs)
                except BrokenProcessPool:
                    self._executor = None
            self._begun[name] = Part(lambda: make(*args, **kwargs), future)
        part: Part[_T] = self._begun[name]
        return part


def _get_ready() -> None:
    """Load while there is time what takes time to load."""
    import_module("experiments.report.page")


@contextmanager
def drawing_beside(is_wanted: bool) -> Iterator[Beside]:
    """A second process, which ends with the block, or none where none is wanted."""
    if not is_wanted:
        yield Beside()
        return
    # Where this process is ended at once (see `ending_on_signals`), its helper would warn of what
    # is left for it to clean up.
    sys.warnoptions.append(_NO_WARNING)
    executor = ProcessPoolExecutor(
        1, mp_context=multiprocessing.get_context("spawn"), initializer=follow_parent
    )
    before = multiprocessing.active_children()
    executor.submit(_get_ready)
    children = [child for child in multiprocessing.active_children() if child not in before]
    try:
        yield Beside(executor)
    except BaseException:
        for child in children:  # nobody is to wait for it
            child.terminate()
        raise
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        sys.warnoptions.remove(_NO_WARNING)
