"""Junctions of a city, each a task for a process on this machine."""

import logging
import multiprocessing
import os
import re
import resource
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field, fields
from itertools import islice
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for_pipes
from pathlib import Path
from typing import Any, NamedTuple

from geometry.errors import InputError
from geometry.files import read_bytes
from geometry.maps.importing import ImportOptions, Surveyed, cut_scene
from geometry.maps.source_map import SourceMap
from geometry.scene_files import save_scene
from placement.city.junction import JunctionWishes, TimeUpError, solve_junction
from placement.compute import Compute
from placement.question import Question

from ..progress import follow_parent
from ..results.record import build_unit_records
from ..scene import cause_of
from .answer import CityFrontRecord

TRIES = 3
"""Of a junction whose worker dies, or that fails for no reason of its own."""

_WATCH_S = 0.2  # the memory of processes is looked at as often
_CONTEXT = multiprocessing.get_context("spawn")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JunctionTask:
    """Inputs of a worker for a junction; it reads no file but the list of sites."""

    key: str
    maps: tuple[SourceMap, ...]
    chosen: Surveyed
    options: ImportOptions
    question: Question
    wishes: JunctionWishes
    seed: int


class JunctionAnswer(NamedTuple):
    """Answer of a worker: the front, and the files of the scene."""

    record: CityFrontRecord
    files: dict[str, bytes]


def run_junction(task: JunctionTask) -> JunctionAnswer:
    """Cut a junction out and find its front; what cannot be done is a record with its reason."""
    notes: tuple[str, ...] = ()
    files: dict[str, bytes] = {}
    try:
        imported = cut_scene(task.maps, task.chosen, task.options)
        notes = tuple(str(note) for note in imported.scene.notes)
        with tempfile.TemporaryDirectory() as folder:
            save_scene(Path(folder), imported.scene, sources=imported.sources)
            files = {path.name: read_bytes(path) for path in sorted(Path(folder).iterdir())}
        solved = solve_junction(
            imported.scene, task.question, task.wishes, compute=Compute(seed=task.seed, workers=1)
        )
    except (InputError, TimeUpError) as error:
        # Another time, the machine may be less busy, and what it compiles once is compiled.
        is_final = isinstance(error, InputError)
        cause = cause_of(error) if isinstance(error, InputError) else "time"
        failed = _failed(task, str(error), cause=cause, is_final=is_final, notes=notes)
        return JunctionAnswer(failed, files)
    found = {one.name: getattr(solved, one.name) for one in fields(solved)}
    found["layouts"] = tuple(build_unit_records(one) if one else () for one in solved.layouts)
    return JunctionAnswer(_record(task, scene=imported.scene.name, notes=notes, **found), files)


def _failed(task: JunctionTask, reason: str, **more: Any) -> CityFrontRecord:
    """The record of a junction that has no front."""
    return _record(task, reason=" ".join(reason.split()), **more)


def _record(task: JunctionTask, **found: Any) -> CityFrontRecord:
    source, junction = task.maps[0].name, task.chosen.junction
    peak_mib = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, 1)
    head = {"scene": f"{Path(source).stem}/{junction.id}", "peak_memory_mib": peak_mib}
    return CityFrontRecord(
        key=task.key, id=junction.id, name=junction.name, map=source, **{**head, **found}
    )


class WorkerDiedError(Exception):
    """A process ended without an answer."""


@dataclass(slots=True, eq=False)
class _Worker:
    """A process, and the answer it works at."""

    pipe: Connection
    process: Any
    future: Future[Any] | None = None
    death: str = field(default="", init=False)  # why it was ended, if it was


class LocalWorkers:
    """Up to `n` processes on this machine, each ended if it takes more memory than `max_bytes`.

    They are reached through pipes that nobody else can open. Memory is watched where the system has
    ``/proc``.
    """

    def __init__(self, n: int, *, max_bytes: int) -> None:
        self.capacity = n
        self._max_bytes = max_bytes
        self._workers: list[_Worker] = []

    def __enter__(self) -> "LocalWorkers":
        return self

    def __exit__(self, *error: object) -> None:
        for worker in self._workers:
            worker.process.kill()
        for worker in self._workers:
            worker.process.join()
            worker.pipe.close()
        self._workers.clear()

    def submit(self, function: Callable[[Any], Any], task: Any) -> Future[Any]:
        """Hand a task to a process that has none; no more than `capacity` at a time."""
        worker = next((one for one in self._workers if one.future is None), None) or self._start()
        future: Future[Any] = Future()
        worker.future = future
        try:
            worker.pipe.send((function, task))
        except OSError:  # it has died since
            self._lose(worker)
        return future

    def wait(self, timeout_s: float) -> None:
        """Wait for answers, no longer than a time; end processes with too much memory."""
        busy = {one.pipe: one for one in self._workers if one.future is not None}
        for pipe in wait_for_pipes([*busy], timeout_s):
            self._take(busy[pipe])  # type: ignore[index]
        for worker in self._workers:
            if worker.future is not None and _memory_bytes(worker.process.pid) > self._max_bytes:
                worker.death = f"more than {self._max_bytes / 2**30:.3g} GiB of memory"
                worker.process.kill()

    def _start(self) -> _Worker:
        ours, theirs = _CONTEXT.Pipe()
        process = _CONTEXT.Process(target=_serve, args=(theirs,), daemon=True)
        process.start()
        theirs.close()
        worker = _Worker(pipe=ours, process=process)
        self._workers.append(worker)
        return worker

    def _take(self, worker: _Worker) -> None:
        try:
            is_answer, value = worker.pipe.recv()
        except (EOFError, OSError):
            self._lose(worker)
            return
        future, worker.future = worker.future, None
        assert future is not None
        if is_answer:
            future.set_result(value)
        else:
            future.set_exception(value)

    def _lose(self, worker: _Worker) -> None:
        """Forget a process that has died."""
        self._workers.remove(worker)
        worker.process.join()
        worker.pipe.close()
        if worker.future is not None:
            worker.future.set_exception(WorkerDiedError(worker.death))


def _memory_bytes(pid: int) -> int:
    """Memory of a process; 0 where the system does not say, or the process has died."""
    try:
        pages = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]
    except OSError:
        return 0
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def _serve(pipe: Connection) -> None:
    """Main function of a process: tasks and answers, as long as the parent lives."""
    follow_parent()
    logging.disable(logging.WARNING)  # the parent warns
    while True:
        try:
            function, task = pipe.recv()
        except EOFError:
            return
        try:
            answer = (True, function(task))
        except Exception as error:  # whatever it is, the parent decides
            answer = (False, RuntimeError(f"{type(error).__name__}: {error}"))
        pipe.send(answer)


_UNITS = {"": 1, "B": 1, **{f"{unit}B": 1000**power for power, unit in enumerate("kMGT", start=1)}}
_UNITS |= {f"{unit}iB": 1024**power for power, unit in enumerate("KMGT", start=1)}


def check_memory(text: str) -> int:
    """The memory of a worker, in bytes; InputError if that is no amount, or too little."""
    found = re.fullmatch(r"([0-9.]+) *([a-zA-Z]*)", text.strip())
    units = {unit.lower(): size for unit, size in _UNITS.items()}
    try:
        size = float(found[1]) * units[found[2].lower()] if found else 0.0
    except (ValueError, KeyError):
        size = 0.0
    if not 2**28 <= size <= 2**60:
        raise InputError("--worker-memory", text, "an amount such as 1.5GiB, at least 0.25GiB")
    return int(size)


def run_junctions(
    workers: LocalWorkers, tasks: Iterable[JunctionTask]
) -> Iterator[tuple[JunctionTask, JunctionAnswer]]:
    """Run tasks on workers, in the order in which they end.

    A task that fails for no reason of its own, or whose worker dies, is tried three times in all;
    then its record says so.
    """
    waiting = iter(tasks)
    running: dict[Future[Any], tuple[JunctionTask, int]] = {}

    def hand_over(task: JunctionTask, attempt: int) -> None:
        running[workers.submit(run_junction, task)] = (task, attempt)

    while True:
        for task in islice(waiting, max(workers.capacity - len(running), 0)):
            hand_over(task, 1)
        if not running:
            return
        workers.wait(_WATCH_S)
        for future in [one for one in running if one.done()]:
            task, attempt = running.pop(future)
            try:
                answer: JunctionAnswer = future.result()
            except Exception as error:  # of a task, or of a worker that died
                if attempt < TRIES:
                    hand_over(task, attempt + 1)
                    continue
                text = " ".join(str(error).split())[:200]  # it begins with the kind
                reason, cause = f"an unexpected error, {TRIES} times: {text}", ""
                if isinstance(error, WorkerDiedError):
                    of, cause = (f" of {error}", "memory") if str(error) else ("", "")
                    remedy = "more --worker-memory, or fewer poses"
                    reason = f"its worker died{of}, {TRIES} times: {remedy}"
                answer = JunctionAnswer(_failed(task, reason, cause=cause, is_final=False), {})
            yield task, answer
