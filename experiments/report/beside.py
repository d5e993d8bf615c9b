"""A second process that draws while the first goes on: matplotlib knows no threads."""

import multiprocessing
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
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
        self._sent: dict[int, object] = {}  # held, so that no other one gets its id

    @property
    def has_process(self) -> bool:
        """Whether there is a second process."""
        return self._executor is not None

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
                    sent = [self._send_once(self._executor, value) for value in args]
                    future = self._executor.submit(_make, make, sent, kwargs)
                except BrokenProcessPool:
                    self._executor = None
            self._begun[name] = Part(lambda: make(*args, **kwargs), future)
        part: Part[_T] = self._begun[name]
        return part

    def _send_once(self, executor: ProcessPoolExecutor, value: object) -> object:
        """What stands for a value in the second process: a setting, which takes long to send."""
        from placement.setting import Setting  # not where the process is begun: that is to be soon

        if not isinstance(value, Setting):
            return value
        if id(value) not in self._sent:
            executor.submit(_keep, id(value), value)
            self._sent[id(value)] = value
        return _Sent(id(value))


@dataclass(frozen=True, slots=True)
class _Sent:
    """Stands for a value that the second process has."""

    key: int


_kept: dict[int, object] = {}  # in the second process


def _keep(key: int, value: object) -> None:
    _kept[key] = value


def _make(make: Callable[..., _T], args: Sequence[object], kwargs: dict[str, Any]) -> _T:
    """Call a function in the second process."""
    values = (_kept[value.key] if isinstance(value, _Sent) else value for value in args)
    return make(*values, **kwargs)


_SLOW_TO_LOAD = (
    "experiments.report.page",
    "placement.explain.other_sensors",
    "placement.explain.sensitivity",
    "placement.visibility.point_kernels",  # the compiler
    "scipy.integrate",
    "scipy.optimize",
    "trimesh",
)


def _get_ready() -> None:
    """Load while there is time what takes time to load and the parts will need.

    And compile what the first process will need, where nothing was compiled yet.
    """
    for name in _SLOW_TO_LOAD:
        import_module(name)
    from placement.compile_ahead import compile_ahead

    compile_ahead()


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
