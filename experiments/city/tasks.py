"""Junctions of a city, each a task for whoever has the program: it reads no map."""

import resource
import tempfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

from geometry.errors import InputError
from geometry.maps.importing import ImportOptions, Surveyed, cut_scene
from geometry.maps.source_map import SourceMap
from geometry.opening import read_bytes
from geometry.scene_files import save_scene
from placement.city.junction import JunctionWishes, TimeUpError, solve_junction
from placement.compute import Compute
from placement.question import Question

from ..engine.tasks import TRIES, WorkerDiedError
from ..results.record import build_unit_records
from ..scene import cause_of
from .answer import CityFrontRecord


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
    """Cut a junction out and find its front.

    What cannot be done is a record with its reason.
    """
    notes: tuple[str, ...] = ()
    files: dict[str, bytes] = {}
    try:
        imported = cut_scene(task.maps, task.chosen, task.options)
        notes = tuple(str(note) for note in imported.scene.notes)
        with tempfile.TemporaryDirectory() as folder:
            save_scene(Path(folder), imported.scene, sources=imported.sources)
            files = {
                path.name: read_bytes(path) for path in sorted(Path(folder).iterdir())
            }
        solved = solve_junction(
            imported.scene,
            task.question,
            task.wishes,
            compute=Compute(seed=task.seed, workers=1),
        )
    except (InputError, TimeUpError) as error:
        # Another time, the machine may be less busy, and what it compiles once is
        # compiled.
        is_final = isinstance(error, InputError)
        if isinstance(error, InputError):
            cause = cause_of(error)
        else:
            cause = "time"
        failed = _failed(task, str(error), cause=cause, is_final=is_final, notes=notes)
        return JunctionAnswer(failed, files)
    found = {one.name: getattr(solved, one.name) for one in fields(solved)}
    found["layouts"] = tuple(
        build_unit_records(one) if one else () for one in solved.layouts
    )
    return JunctionAnswer(
        _record(task, scene=imported.scene.name, notes=notes, **found), files
    )


def _failed(task: JunctionTask, reason: str, **more: Any) -> CityFrontRecord:
    """The record of a junction that has no front."""
    return _record(task, reason=" ".join(reason.split()), **more)


def _record(task: JunctionTask, **found: Any) -> CityFrontRecord:
    source = task.maps[0].name
    junction = task.chosen.junction
    peak_mib = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, 1)
    head = {"scene": f"{Path(source).stem}/{junction.id}", "peak_memory_mib": peak_mib}
    return CityFrontRecord(
        key=task.key,
        id=junction.id,
        name=junction.name,
        map=source,
        **{**head, **found},
    )


def unsolved(task: JunctionTask, error: BaseException) -> JunctionAnswer:
    """Answer to a task that failed for no reason of its own, or whose worker died."""
    if isinstance(error, WorkerDiedError):
        if str(error):
            of, cause = (f" of {error}", "memory")
        else:
            of, cause = ("", "")
        remedy = "more --worker-memory, or fewer poses"
        reason = f"its worker died{of}, {TRIES} times: {remedy}"
    else:
        text = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        cause = ""
        reason = f"an unexpected error, {TRIES} times: {text}"
    return JunctionAnswer(_failed(task, reason, cause=cause, is_final=False), {})
