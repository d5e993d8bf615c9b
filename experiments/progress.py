"""Progress on stderr: a bar on a terminal, one line per stage elsewhere, nothing with --quiet."""

import sys
import time
from types import TracebackType
from typing import Self


class StageProgress:
    """Shows which stage runs and how far it is, and keeps the time of each.

    Parameters
    ----------
    quiet : bool
        Show nothing.

    Attributes
    ----------
    stage : str
        The stage that runs, or ran last.
    seconds : dict of str to float
        Time per finished stage. [s]
    """

    def __init__(self, *, quiet: bool) -> None:
        self.stage = "start"
        self.seconds: dict[str, float] = {}
        self._began_s = time.perf_counter()
        self._has_terminal = sys.stderr.isatty() and not quiet
        self._prints_lines = not self._has_terminal and not quiet

    def __enter__(self) -> Self:
        if self._has_terminal:
            from rich.console import Console
            from rich.progress import (
                BarColumn,
                MofNCompleteColumn,
                Progress,
                SpinnerColumn,
                TextColumn,
                TimeElapsedColumn,
            )

            self._bar = Progress(
                SpinnerColumn(),
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task(self.stage, total=None)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end_stage()
        if self._has_terminal:
            self._bar.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show a stage; a new name ends the one before."""
        if stage != self.stage:
            self._end_stage()
            self.stage = stage
            if self._prints_lines:
                sys.stderr.write(f"{stage} ...\n")
                sys.stderr.flush()
        if self._has_terminal:
            self._bar.update(self._task, description=stage, completed=done, total=total or None)

    def finish(self) -> dict[str, float]:
        """End the last stage; seconds of every stage and of all together."""
        self._end_stage()
        total_s = sum(self.seconds.values())
        return {name: round(value, 3) for name, value in (*self.seconds.items(), ("total", total_s))}

    def _end_stage(self) -> None:
        now_s = time.perf_counter()
        stage = self.stage.split(":")[0]
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now_s - self._began_s
        self._began_s = now_s
