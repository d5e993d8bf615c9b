"""How a computation tells how far it is."""

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

_T = TypeVar("_T")


class Progress(Protocol):
    """A function that is called as a computation progresses."""

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        """Take note of the stage that runs, and of its steps done and all.

        0 of 0: their number is not known.
        """


def silent(stage: str, done: int, total: int, /) -> None:
    """Progress that is shown nowhere."""


def counted(
    items: Iterable[_T], stage: str, total: int, progress: Progress
) -> Iterator[_T]:
    """Items of a stage, told one by one; `total` may be an estimate of their number."""
    for done, item in enumerate(items, start=1):
        progress(stage, min(done, total), total)
        yield item
