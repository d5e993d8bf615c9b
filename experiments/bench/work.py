"""What the main job does, counted: ``python -m experiments.bench.work``.

Times depend on the machine and on what else runs there; counts do not. A test compares
them with the most that ``results/work.json`` allows, so that no change makes the main
job do more without anybody noticing.
"""

import json
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any
from unittest import mock

import click

from geometry import kernels
from geometry.raycast import EmbreexCaster, Open3dCaster

QUESTIONS = {
    "small": ["--budget", "2", "--cases", "CBNA", "--along-arms", "0"],
    "whole": ["--budget", "3"],
}
"""Options of the main job by the name of the question."""
_SLACK = 1.02
_STARTS_PROCESS = ("os.fork", "os.posix_spawn", "subprocess.Popen")


class WorkCounter:
    """Counts work while a block runs, from any thread.

    Attributes
    ----------
    counts : Counter of str
        Modules, kernels, specialisations, rays, sights, frames seen from sights,
        layouts evaluated, figures and views with their pixels, processes,
        bytes written.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._compiled: list[Any] = []
        self._is_counting = False
        sys.addaudithook(self._audit)

    def add(self, name: str, number: int) -> None:
        """Count something."""
        with self._lock:
            self.counts[name] += number

    def _audit(self, event: str, _arguments: object) -> None:
        if self._is_counting and event in _STARTS_PROCESS:
            self.add("processes", 1)

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Count what the block does; then, modules and kernels that are loaded."""
        with mock.patch.object(
            kernels._OnDisk, "_build", self._count_kernels(kernels._OnDisk._build)
        ):
            self._is_counting = True
            try:
                yield
            finally:
                self._is_counting = False
        self.counts["modules"] = len(sys.modules)
        self.counts["kernels"] = len(self._compiled)
        self.counts["specialisations"] = sum(
            len(one.overloads) for one in self._compiled
        )

    def _count_kernels(self, build: Callable[..., Any]) -> Callable[..., Any]:
        def counted(on_disk: Any) -> Any:
            compiled = build(on_disk)
            self._compiled.append(compiled)
            return compiled

        return counted

    def watch(
        self, owner: Any, name: str, measure: Callable[..., dict[str, int]]
    ) -> "mock._patch[Any]":
        """Patch that counts what `measure` says of each call.

        `measure` gets the result, then the call's arguments.
        """
        function = getattr(owner, name)

        def counted(*given: Any, **named: Any) -> Any:
            result = function(*given, **named)
            for what, number in measure(result, *given, **named).items():
                self.add(what, number)
            return result

        return mock.patch.object(owner, name, counted)


def _rays(_hits: object, _caster: object, origins_m: Any, *_: object) -> dict[str, int]:
    return {"rays": len(origins_m)}


def _sight(
    _seen: object, surroundings: Any, *_: object, **__: object
) -> dict[str, int]:
    return {"sights": 1, "frames seen": len(surroundings.draw_index)}


def _layouts(judged: Sequence[Any], *_: object, **__: object) -> dict[str, int]:
    return {"layouts evaluated": len(judged)}


def _picture(png: bytes, *_: object, **__: object) -> dict[str, int]:
    """Of the head of a PNG file: its width and height, in pixels."""
    width_px = int.from_bytes(png[16:20], "big")
    height_px = int.from_bytes(png[20:24], "big")
    return {"figures": 1, "pixels of figures": width_px * height_px}


def _view(
    drawn: tuple[Any, object, object], *_: object, **__: object
) -> dict[str, int]:
    height_px, width_px, _ = drawn[0].shape
    return {"views": 1, "pixels of views": width_px * height_px}


def count_work(arguments: Sequence[str]) -> dict[str, int]:
    """Counts of all that a main job does, in this process, which must be a new one.

    Nothing is cached but compiled kernels.

    Parameters
    ----------
    arguments : sequence of str
        Options of the main job.

    Returns
    -------
    counts : dict of str to int
        By what is counted, see :class:`WorkCounter`.
    """
    from experiments.cli import running

    counter = WorkCounter()
    patches = [
        counter.watch(caster, name, _rays)
        for caster in (EmbreexCaster, Open3dCaster)
        for name in ("is_blocked", "first_triangle")
    ]
    announce = running.Call.announce_lines

    def announce_and_watch(job: Any, lines: Sequence[str]) -> None:
        """Count what was loaded by now; what is loaded next is watched from here on."""
        counter.counts["modules before the first lines"] = len(sys.modules)
        late = _late_patches(counter)
        for patch in late:
            patch.start()
        patches.extend(late)
        announce(job, lines)

    patches.append(
        mock.patch.object(running.Call, "announce_lines", announce_and_watch)
    )
    with counter.counting():
        for patch in patches:
            patch.start()
        try:
            counter.add("bytes written", _run(arguments))
        finally:
            for patch in patches:
                patch.stop()
    return {name: counter.counts[name] for name in sorted(counter.counts)}


def _late_patches(counter: WorkCounter) -> "list[mock._patch[Any]]":
    """Patches of what the first lines of an answer do without."""
    from experiments.jobs import placement
    from experiments.parts import camera_views, section, study_cases
    from placement.evaluator import perceive

    return [
        counter.watch(perceive, "perceive_frames", _sight),
        counter.watch(placement, "evaluate_layouts", _layouts),
        counter.watch(study_cases, "evaluate_again", _layouts),
        counter.watch(camera_views, "draw_view", _view),
        counter.watch(section, "to_png", _picture),
    ]


def _run(arguments: Sequence[str]) -> int:
    """Run the main job without a cache, its words thrown away; bytes that it wrote."""
    from experiments.main import main

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        words = [*arguments, "--no-cache", "--out", str(out)]
        try:
            with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
                main(words)
        except SystemExit as end:
            if end.code:
                raise RuntimeError(f"place-rsus ended with {end.code}") from None
        return sum(path.stat().st_size for path in out.iterdir())


def exceeded(counts: Mapping[str, int], most: Mapping[str, int]) -> list[str]:
    """Counts above what is allowed, in words; also what no limit is known of.

    Rays and bytes differ by a little from run to run, so that 2 % more are allowed.

    >>> exceeded({"rays": 130, "views": 2}, {"rays": 100, "views": 2})
    ['rays: 130, allowed are 100']
    """
    words = []
    for name, number in counts.items():
        if name not in most:
            words.append(f"{name}: {number:,}, but there is no limit")
        elif number > most[name] * _SLACK:
            words.append(f"{name}: {number:,}, allowed are {most[name]:,}")
    return words


def count_in_new_process(question: str) -> dict[str, int]:
    """Counts of one of :data:`QUESTIONS`, as a new process has them."""
    command = [sys.executable, "-m", "experiments.bench.work", question]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    counts: dict[str, int] = json.loads(done.stdout)
    return counts


@click.command()
@click.argument("question", type=click.Choice([*QUESTIONS]), required=False)
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the counts of all questions to this file, as the limits of the test.",
)
def main(question: str | None, out: Path | None) -> None:
    """Count what the main job does.

    For one question, or compare all with the limits.
    """
    if question is not None:
        print(json.dumps(count_work(QUESTIONS[question]), indent=2))
        return
    counts = {name: count_in_new_process(name) for name in QUESTIONS}
    print(json.dumps(counts, indent=2))
    if out is not None:
        command = f"python -m experiments.bench.work --out {out}"
        text = json.dumps({"command": command, "most": counts}, indent=2)
        out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
