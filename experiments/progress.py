"""Progress on stderr, an orderly end on signals, and what a call knows of its surroundings."""

import logging
import os
import shlex
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

import click

if TYPE_CHECKING:
    from placement.layout import Layout


# ---------- progress on stderr, and an orderly end when the user or the system asks for one


WRITING = "write results"
"""The stage in which files are written."""

_OWN_PACKAGES = ("geometry", "scenarios", "placement", "experiments")
_log = logging.getLogger(__name__)
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_GRACE_S = 1.5  # what does not end by itself within it is ended


class Interrupted(BaseException):
    """Ctrl-C, or another wish that the program end; no error, so that nothing catches it."""

    def __init__(self, signum: int) -> None:
        self.signum = signum
        super().__init__(signal.Signals(signum).name)


class StageProgress:
    """Shows which stage runs and how far it is, and keeps the time of each.

    A bar on a terminal, one line per stage elsewhere, nothing before :meth:`start` or with
    ``quiet``.

    Attributes
    ----------
    stage : str
        The stage that runs, or ran last.
    seconds : dict of str to float
        Time per finished stage. [s]
    kept : str
        What is on disk if the program ends now, in words.
    is_verbose : bool
        Whether the seconds of each stage are told when it ends.
    """

    def __init__(self) -> None:
        self.stage = "start"
        self.seconds: dict[str, float] = {}
        self.kept = "nothing was written"
        self._began_s = time.perf_counter()
        self._prints_lines = False
        self._bar: Any = None
        self.is_verbose = False

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show a stage; a new name ends the one before."""
        if stage != self.stage:
            self._end_stage()
            self.stage = stage
            if self._prints_lines:
                click.echo(f"{stage} ...", err=True)
            if self._bar is not None:  # time left is of this stage, not of those before
                self._bar.reset(self._task)
        if self._bar is not None:
            self._bar.update(self._task, description=stage, completed=done, total=total or None)

    def tell_more(self) -> None:
        """Also tell sizes, bounds, files that are read, and the seconds of each stage."""
        self.is_verbose = True
        for name in _OWN_PACKAGES:
            logging.getLogger(name).setLevel(logging.INFO)

    def start(self, *, quiet: bool) -> None:
        """Begin to show the stages, unless `quiet`."""
        if quiet and self.is_verbose:
            raise click.UsageError("--quiet, --verbose: got both; expected one of them")
        if quiet or sys.stderr is None:
            return
        if not sys.stderr.isatty():
            self._prints_lines = True
            return
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            SpinnerColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("[dim]left"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            # What others print must stay where it belongs: stdout is not rich's to move.
            redirect_stdout=False,
        )
        self._task = self._bar.add_task(self.stage, total=None)
        self._bar.start()

    def stop(self) -> None:
        """Take the bar away; tell no more than by default from here on."""
        for name in _OWN_PACKAGES:
            logging.getLogger(name).setLevel(logging.WARNING)
        bar, self._bar = self._bar, None
        if bar is not None:
            bar.stop()

    def finish(self) -> dict[str, float]:
        """End the last stage; seconds of every stage and of all together."""
        self._end_stage()
        total_s = sum(self.seconds.values())
        return {
            name: round(value, 3) for name, value in (*self.seconds.items(), ("total", total_s))
        }

    def interruption(self) -> str:
        """What to say when the program ends before its time."""
        return f"place-rsus: interrupted in stage '{self.stage}': {self.kept}"

    def _end_stage(self) -> None:
        now_s = time.perf_counter()
        if self.is_verbose:
            _log.info("%s: %.1f s", self.stage, now_s - self._began_s)
        stage = self.stage.split(":")[0]
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now_s - self._began_s
        self._began_s = now_s


class StderrLog(logging.StreamHandler[Any]):
    """Writes to what is stderr at the moment: a bar moves aside for it."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record."""
        if sys.stderr is not None:
            self.setStream(sys.stderr)
            super().emit(record)


@contextmanager
def ending_on_signals(progress: StageProgress) -> Iterator[None]:
    """Raise :class:`Interrupted` on Ctrl-C and SIGTERM, and end what does not listen.

    A solver or a worker thread can go on for long before Python raises anything. Unless files are
    being written, the process is then ended from a thread of its own.

    Parameters
    ----------
    progress : StageProgress
        Says what to tell the user.
    """
    read_end, write_end = os.pipe()
    os.set_blocking(write_end, False)
    is_over = threading.Event()

    def interrupt(signum: int, frame: FrameType | None) -> NoReturn:
        for each in _SIGNALS:  # one is enough: tidying up is not to be interrupted
            signal.signal(each, lambda signum, frame: None)
        raise Interrupted(signum)

    before = {each: signal.signal(each, interrupt) for each in _SIGNALS}
    wakeup_before = signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    watch = threading.Thread(target=_watch, args=(read_end, is_over, progress), daemon=True)
    watch.start()
    try:
        yield
    finally:
        is_over.set()
        signal.set_wakeup_fd(wakeup_before)
        for each, handler in before.items():
            signal.signal(each, handler)
        os.close(write_end)  # the watch reads the end
        watch.join()
        os.close(read_end)


@contextmanager
def signals_held() -> Iterator[list[int]]:
    """Hold Ctrl-C and SIGTERM back while a few quick steps are done that belong together.

    Yields
    ------
    held : list of int
        Signals that came meanwhile; the first of those left in it is delivered in the end.
    """
    held: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield held
        return
    before = {
        each: signal.signal(each, lambda signum, frame: held.append(signum)) for each in _SIGNALS
    }
    try:
        yield held
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
        if held:
            signal.raise_signal(held[0])


def _watch(read_end: int, is_over: threading.Event, progress: StageProgress) -> None:
    """Wait for a signal, leave the program time to end by itself, then end it."""
    received = os.read(read_end, 1)
    if not received or is_over.wait(_GRACE_S) or progress.stage == WRITING:
        return
    progress.stop()
    click.echo(progress.interruption(), err=True)
    os._exit(128 + received[0])


# ---------- what a call of the program knows of its surroundings. Imports nothing heavy


def cache_folder() -> Path:
    """Where detection tables are kept: PLACE_RSUS_CACHE, or the user's cache folder."""
    folder = os.environ.get("PLACE_RSUS_CACHE")
    if folder:
        return Path(folder)
    from platformdirs import user_cache_path

    return user_cache_path("place-rsus")


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
    from .study.layout import find_layout

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
    from .export.json import to_json_text

    progress.stop()
    click.echo(to_json_text(result).rstrip() if as_json else text())


def warn_of_slow_rays() -> None:
    """Say so where rays are cast by the slower library."""
    from geometry.raycast import open3d_problem

    problem = open3d_problem()
    if problem is not None:
        _log.warning("%s", problem)
