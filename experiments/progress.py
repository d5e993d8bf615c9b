"""Progress on stderr, and an orderly end when one is asked for."""

import json
import logging
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn

import click

from .language import mark, tr

WRITING = mark("write results")
"""The stage in which files are written."""

LINE_EVERY_S = 30.0
"""Where there is no terminal, a long stage says so often how far it is."""

_OWN_PACKAGES = ("geometry", "scenarios", "placement", "experiments")
_log = logging.getLogger(__name__)
_NO_WARNING = "ignore:resource_tracker:UserWarning"
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# what does not end by itself within it is ended: a second is what users wait
_GRACE_S = 0.7


# The last two are invisible, but part of how some scripts are written.
_KEPT = "\n\u200c\u200d"


def printable(text: str) -> str:
    r"""Text for a terminal.

    What it would obey or hide is spelled, as JSON spells it.

    Names come from maps and scenes of anybody: escape sequences, C1 codes, marks that
    turn the direction of writing.

    Examples
    --------
    >>> print(printable("a \x1b[2J pole"))
    a \u001b[2J pole
    """
    if text.replace("\n", "").isprintable():
        return text
    return "".join(c if c.isprintable() or c in _KEPT else _spelled(c) for c in text)


def _spelled(character: str) -> str:
    # JSON leaves DEL as it is.
    is_ascii = character.isascii()
    if is_ascii:
        return f"\\u{ord(character):04x}"
    return json.dumps(character)[1:-1]


def tell(text: str, *, err: bool = False) -> None:
    """Print text for people on stdout or stderr."""
    click.echo(printable(text), err=err)


def write_out(content: str | bytes) -> None:
    """Write a file's content to stdout, as it is unless that is a terminal."""
    is_shown = isinstance(content, str) and sys.stdout.isatty()
    click.echo(printable(content) if is_shown else content, nl=False)  # type: ignore[arg-type]


class Interrupted(BaseException):
    """Ctrl-C, or another wish that the program end.

    No error, so that nothing catches it.
    """

    def __init__(self, signum: int) -> None:
        self.signum = signum
        super().__init__(signal.Signals(signum).name)


class StageProgress:
    """Shows which stage runs and how far it is, and keeps the time of each.

    A bar on a terminal, one line per stage elsewhere, nothing before :meth:`start` or
    with ``quiet``.

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
        # That runs, or ran last.
        self.stage = mark("start")
        # Of each finished stage.
        self.seconds: dict[str, float] = {}
        # What is on disk if the program ends now.
        self.kept = "nothing was written"
        self._began_s = self._line_s = time.perf_counter()
        self._prints_lines = False
        self._bar: Any = None
        self.is_verbose = False
        # The signal that came.
        self.signum = 0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show a stage; a new name ends the one before."""
        if stage != self.stage:
            self._end_stage()
            self.stage = stage
            if self._prints_lines:
                tell(f"{tr(stage)} ...", err=True)
                self._line_s = time.perf_counter()
            # Time left is of this stage, not of those before.
            if self._bar is not None:
                self._bar.reset(self._task)
        if (
            self._prints_lines
            and total
            and time.perf_counter() - self._line_s >= LINE_EVERY_S
        ):
            tell(
                tr("{step}: {n} of {all}", step=tr(stage), n=done, all=total), err=True
            )
            self._line_s = time.perf_counter()
        if self._bar is not None:
            self._bar.update(
                self._task,
                description=printable(tr(stage)),
                completed=done,
                total=total or None,
            )

    def tell_more(self) -> None:
        """Also tell sizes, bounds, files that are read, and seconds of stages."""
        self.is_verbose = True
        for name in _OWN_PACKAGES:
            logging.getLogger(name).setLevel(logging.INFO)

    def start(self, *, quiet: bool) -> None:
        """Begin to show the stages.

        With `quiet` nothing but errors is told, also no warning.
        """
        if quiet and self.is_verbose:
            raise click.UsageError("--quiet, --verbose: got both; expected one of them")
        if quiet:
            logging.disable(logging.WARNING)
        if quiet or sys.stderr is None:
            return
        if not sys.stderr.isatty():
            self._prints_lines = True
            return
        from rich import progress as bars
        from rich.console import Console

        self._bar = bars.Progress(
            bars.SpinnerColumn(),
            bars.TextColumn("{task.description}", markup=False),
            bars.BarColumn(),
            bars.MofNCompleteColumn(),
            bars.TimeElapsedColumn(),
            bars.TextColumn(tr("[dim]left")),
            bars.TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            # What others print must stay where it belongs: stdout is not rich's.
            redirect_stdout=False,
        )
        self._task = self._bar.add_task(tr(self.stage), total=None)
        self._bar.start()

    def stop(self) -> None:
        """Take the bar away; tell no more than by default from here on."""
        logging.disable(logging.NOTSET)
        for name in _OWN_PACKAGES:
            logging.getLogger(name).setLevel(logging.WARNING)
        bar = self._bar
        self._bar = None
        if bar is not None:
            bar.stop()

    def finish(self) -> dict[str, float]:
        """End the last stage; seconds of every stage and of all together."""
        self._end_stage()
        seconds = self.seconds | {mark("total"): sum(self.seconds.values())}
        return {name: round(value, 3) for name, value in seconds.items()}

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

    def format(self, record: logging.LogRecord) -> str:
        """The record's text, printable."""
        return printable(super().format(record))


@contextmanager
def ending_on_signals(progress: StageProgress) -> Iterator[None]:
    """Raise :class:`Interrupted` on Ctrl-C and SIGTERM.

    What does not listen is ended.

    A solver, a kernel or a worker thread can go on for long before Python raises
    anything. Unless files are being written, the process is then ended from a thread of
    its own, within a second. Files elsewhere (detection tables, machine code) are put
    in place whole by their writers.
    """
    read_end, write_end = os.pipe()
    os.set_blocking(write_end, False)
    is_over = threading.Event()

    def interrupt(signum: int, frame: FrameType | None) -> NoReturn:
        # One is enough: tidying up is not to be interrupted.
        for each in _SIGNALS:
            signal.signal(each, lambda signum, frame: None)
        progress.signum = signum
        raise Interrupted(signum)

    before = {each: signal.signal(each, interrupt) for each in _SIGNALS}
    wakeup_before = signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    watch = threading.Thread(
        target=_watch, args=(read_end, is_over, progress), daemon=True
    )
    watch.start()
    try:
        yield
    finally:
        is_over.set()
        signal.set_wakeup_fd(wakeup_before)
        for each, handler in before.items():
            signal.signal(each, handler)
        # The watch reads the end.
        os.close(write_end)
        watch.join()
        os.close(read_end)


@contextmanager
def no_tracker_warnings() -> Iterator[None]:
    """For a block with processes: nobody warns of what they leave behind.

    Where this process is ended at once (see :func:`ending_on_signals`), its resource
    tracker would warn of what is left to clean up, and then cleans up.
    """
    sys.warnoptions.append(_NO_WARNING)
    try:
        yield
    finally:
        sys.warnoptions.remove(_NO_WARNING)


def follow_parent() -> None:
    """In a process of workers.

    Leave Ctrl-C to the parent, and end when it does, however.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Any) -> NoReturn:
    parent.join()
    os._exit(1)


@contextmanager
def signals_held() -> Iterator[list[int]]:
    """Hold Ctrl-C and SIGTERM back during a few quick steps.

    They belong together.

    Yields the signals that came meanwhile; the first of those left in it is delivered
    in the end.
    """
    held: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield held
        return
    before = {
        each: signal.signal(each, lambda signum, frame: held.append(signum))
        for each in _SIGNALS
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
    tell(progress.interruption(), err=True)
    os._exit(128 + received[0])
