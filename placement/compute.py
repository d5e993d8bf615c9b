"""Options of a computation: seed, threads, cache and progress."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

from geometry.errors import InputError, check_one_of
from geometry.progress import Progress as Progress
from geometry.progress import silent as silent


@contextmanager
def threads(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Threads; after an error or an interruption, what has not begun never will."""
    executor = ThreadPoolExecutor(workers)
    try:
        yield executor
    finally:
        executor.shutdown(cancel_futures=True)


def one_blas_thread() -> AbstractContextManager[Any]:
    """Context in which BLAS uses one thread.

    Small matrices are multiplied by the calling thread: further threads of BLAS
    would only spin.
    """
    limited: AbstractContextManager[Any] = _blas().limit(limits=1)
    return limited


@cache
def _blas() -> Any:
    from threadpoolctl import ThreadpoolController

    # Finding the libraries takes 15 ms.
    return ThreadpoolController()


def check_whole(where: str, value: Any, *, least: int) -> None:
    """Raise InputError unless `value` is a whole number of at least `least`."""
    is_whole = isinstance(value, int) and not isinstance(value, bool)
    if not (is_whole and value >= least):
        raise InputError(where, value, f"a whole number, at least {least}")


def check_distinct(where: str, names: Sequence[str], expected: str) -> None:
    """Raise InputError for the first name that is there twice."""
    for name, number in Counter(names).items():
        if number > 1:
            raise InputError(where, name, expected)


# As geometry.raycast has them, which loads numpy.
RAYS = ("auto", "embree", "open3d")


@dataclass(frozen=True, slots=True, kw_only=True)
class Compute:
    """How a result is computed.

    Only `seed` changes results; they do not depend on the number of workers, the cache,
    or the library that casts rays.

    Attributes
    ----------
    seed : int
        Of all that is left to chance: points on the road users, misses, lost messages.
        At least 0.
    workers : int
        Threads, at least 1; by default one per processor.
    cache_folder : Path, optional
        Where detection tables, and what units detect, are kept for the next call; by
        default nowhere.
    progress : Progress
        Is told the stages; by default nobody is.
    rays : str
        Library that casts rays: "embree", "open3d", or by default "auto", the fastest
        that loads.

    Raises
    ------
    InputError
        The seed or the number of workers is not a whole number, or too small; `rays`
        names no library.
    """

    seed: int = 0
    workers: int = os.cpu_count() or 1
    cache_folder: Path | None = None
    progress: Progress = silent
    rays: str = "auto"

    def __post_init__(self) -> None:
        check_whole("seed", self.seed, least=0)
        check_whole("workers", self.workers, least=1)
        check_one_of("rays", self.rays, RAYS)

    def __reduce__(self) -> tuple[Any, ...]:
        """Other processes report nothing: whoever waits for them does."""
        known = {one.name: getattr(self, one.name) for one in fields(self)} | {
            "progress": silent
        }
        return partial(Compute, **known), ()

    def within(self, stage: str) -> "Compute":
        """These options for a part of a larger stage.

        Progress is reported under the name of that stage.
        """

        def report(part: str, done: int, total: int, /) -> None:
            self.progress(stage, done, total)

        return replace(self, progress=report)


_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")


class RunTasks(Protocol):
    """Runs independent tasks of one kind, wherever their caller wants."""

    def __call__(
        self,
        function: Callable[..., _Answer],
        tasks: Iterable[_Task],
        *,
        shared: tuple[Any, ...],
    ) -> Iterable[tuple[_Task, _Answer]]:
        """Each task with `function(*shared, task)`, in any order."""
        ...


def run_here(
    function: Callable[..., _Answer],
    tasks: Iterable[_Task],
    *,
    shared: tuple[Any, ...],
) -> Iterator[tuple[_Task, _Answer]]:
    """Run tasks in this process, one after the other."""
    for task in tasks:
        yield task, function(*shared, task)


DEFAULT_COMPUTE = Compute()
