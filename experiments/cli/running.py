"""How a command begins and ends: what it needs to know, what it prints. Imports nothing heavy."""

import shlex
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import click

from ..progress import StageProgress, tell

_LEAST_BYTES = 2_000_000_000

if TYPE_CHECKING:
    from placement.layout import Layout


def begin(progress: StageProgress, *, quiet: bool) -> None:
    """Show what happens from here on."""
    progress.start(quiet=quiet)


def load_one_layout(names: Sequence[str]) -> "Layout":
    """The layout of a command that takes ``--layout`` once.

    Raises
    ------
    click.UsageError
        It is given several times, or not at all.
    InputError
        There is no such layout.
    """
    if len(names) != 1:
        given = f"{len(names)} layouts" if names else "nothing"
        raise click.UsageError(f"--layout: got {given}; expected it once")
    from ..study.layout import find_layout

    return find_layout(names[0], "--layout")


def command_line() -> str:
    """The command line of this call, as a shell would take it again."""
    # What the system hands over need not be text.
    arguments = [argument.encode(errors="replace").decode() for argument in sys.argv[1:]]
    return shlex.join(["place-rsus", *arguments])


def print_result(
    result: Any, progress: StageProgress, as_json: bool, text: Callable[[], str]
) -> None:
    """End a command: take the bar away, print its result as JSON or as text for people."""
    from ..export.json import to_json_text

    progress.stop()
    tell(to_json_text(result).rstrip() if as_json else text())


def check_address_space() -> None:
    """Refuse a limit of address space in which libraries end by a segmentation fault.

    Raises
    ------
    click.UsageError
        It is below 2 GB: a small question reserves 2.3 where it may.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _LEAST_BYTES:
        raise click.UsageError(
            f"ulimit -v: got {limit // 1000:,} kB; expected {_LEAST_BYTES // 1000:,} or no limit"
        )


def unwritable(path: object, error: OSError) -> click.UsageError:
    """The error of an ``--out`` that cannot be written."""
    return click.UsageError(
        f"--out: got {path}: {error.strerror or error}; expected a file that can be written"
    )
