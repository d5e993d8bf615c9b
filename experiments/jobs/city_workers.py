"""Junctions of a city, each a task for a worker of dask: here, or of a cluster."""

import logging
import resource
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geometry.errors import InputError, MissingExtraError, Unquoted
from geometry.files import read_bytes
from geometry.maps.importing import ImportOptions, cut_scene
from geometry.maps.junctions import Surveyed
from geometry.maps.source_map import SourceMap
from geometry.scene_files import save_scene
from placement.city.junction import JunctionWishes, TimeUpError, solve_junction
from placement.compute import Compute
from placement.question import Question

from ..results.city import CityFrontRecord, build_points
from .schedulers import ANSWER_S, connect_to_scheduler

TRIES = 3
"""Of a junction whose worker dies, or that fails for no reason of its own."""

_NO_WARNING = "ignore:resource_tracker:UserWarning"
_SETTINGS = {
    "distributed.scheduler.allowed-failures": TRIES - 1,
    # A junction needs its memory now: a worker that waits for some to be free waits for ever.
    **{f"distributed.worker.memory.{what}": False for what in ("target", "spill", "pause")},
}
_AHEAD = 2  # tasks per worker that are handed over before their turn


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JunctionTask:
    """All that a worker needs for a junction; it reads no file but the list of sites."""

    key: str
    maps: tuple[SourceMap, ...]
    chosen: Surveyed
    options: ImportOptions
    question: Question
    wishes: JunctionWishes
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JunctionAnswer:
    """What a worker found: the record, and the files of the scene."""

    record: CityFrontRecord
    files: dict[str, bytes]


def run_junction(task: JunctionTask) -> JunctionAnswer:
    """Cut a junction out and find its front; what cannot be done is a record with its reason."""
    notes: tuple[str, ...] = ()
    files: dict[str, bytes] = {}
    try:
        imported = cut_scene(task.maps, task.chosen, task.options)
        notes = tuple(f"{what}: {why}" for what, why in imported.skipped)
        with tempfile.TemporaryDirectory() as folder:
            save_scene(
                Path(folder),
                imported.scene,
                sources=imported.sources,
                skipped=imported.skipped,
                assumed_heights=sorted(imported.assumed_heights),
                roads=imported.roads,
            )
            files = {path.name: read_bytes(path) for path in sorted(Path(folder).iterdir())}
        solved = solve_junction(
            imported.scene,
            task.question,
            task.wishes,
            compute=Compute(seed=task.seed, workers=1),
        )
    except (InputError, TimeUpError) as error:
        # Another time, the machine may be less busy, and what it compiles once is compiled.
        is_final = isinstance(error, InputError)
        record = failed_record(task, str(error), is_final=is_final, notes=notes)
        return JunctionAnswer(record=record, files=files)
    record = CityFrontRecord(
        key=task.key,
        id=task.chosen.junction.id,
        name=task.chosen.junction.name,
        map=task.maps[0].name,
        scene=imported.scene.name,
        reason="",
        points=build_points(solved),
        by_units=solved.front.by_units,
        by_cost=solved.front.by_cost,
        sites=solved.n_sites,
        poses=solved.n_poses,
        runs=solved.n_runs,
        frames=solved.n_frames,
        seconds=solved.seconds,
        peak_memory_mib=_peak_mib(),
        notes=notes,
    )
    return JunctionAnswer(record=record, files=files)


def failed_record(
    task: JunctionTask, reason: str, *, is_final: bool = True, notes: tuple[str, ...] = ()
) -> CityFrontRecord:
    """The row of a junction that has no front."""
    return CityFrontRecord(
        key=task.key,
        id=task.chosen.junction.id,
        name=task.chosen.junction.name,
        map=task.maps[0].name,
        scene=f"{Path(task.maps[0].name).stem}/{task.chosen.junction.id}",
        reason=" ".join(reason.split()),
        is_final=is_final,
        points=(),
        by_units=(),
        by_cost=(),
        sites=0,
        poses=0,
        runs=0,
        frames=0,
        seconds={},
        peak_memory_mib=_peak_mib(),
        notes=notes,
    )


def _peak_mib() -> float:
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, 1)


# ---------- workers


@contextmanager
def start_workers(
    scheduler: str, *, n_workers: int, memory: str, tell: Callable[[str], None]
) -> Iterator[Any]:
    """A dask client: of processes on this machine, or of a scheduler by its address.

    Raises
    ------
    InputError
        The scheduler does not answer, has no workers, or these lack this program.
    """
    import dask
    from distributed import Client, LocalCluster

    if scheduler:
        with connect_to_scheduler(scheduler) as client:
            _check_workers(client, scheduler)
            tell(f"Dashboard of the workers: {client.dashboard_link}")
            yield client
        return
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # deaths are told by us
    # Where this process is ended at once (see `ending_on_signals`), its helper would warn of what
    # is left for it to clean up.
    sys.warnoptions.append(_NO_WARNING)
    with (
        dask.config.set(_SETTINGS),
        LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=check_memory(memory),
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        tell(
            f"{n_workers} worker{'s' if n_workers > 1 else ''} of at most {memory} memory each; "
            f"dashboard: {client.dashboard_link}"
        )
        yield client
    sys.warnoptions.remove(_NO_WARNING)


def check_memory(text: str) -> int:
    """The memory of a worker, in bytes.

    Raises
    ------
    MissingExtraError
        dask is not installed.
    InputError
        That is no amount, or too little.
    """
    try:
        import distributed  # noqa: F401
        from dask.utils import parse_bytes
    except ImportError:
        raise MissingExtraError(
            "place-rsus city needs dask: pip install 'place-rsus[city]'"
        ) from None
    try:
        size = int(parse_bytes(text))
    except ValueError:
        size = 0
    if size < 2**28:
        raise InputError("--worker-memory", text, "an amount such as 1.5GiB, at least 0.25GiB")
    return size


def _check_workers(client: Any, address: str) -> None:
    from distributed import TimeoutError as DaskTimeoutError

    try:
        client.wait_for_workers(1, timeout=ANSWER_S)
    except DaskTimeoutError:
        raise InputError(
            "--scheduler", Unquoted(f"{address} without workers"), "a scheduler with workers"
        ) from None
    try:
        client.run(_hello)
    except Exception as error:  # whatever their Python says
        raise InputError(
            "--scheduler",
            Unquoted(f"{address}: {type(error).__name__} on a worker: {str(error)[:120]}"),
            "workers with this version of place-rsus",
        ) from None


def _hello() -> str:
    """Whether a worker has this program."""
    return __name__


def run_junctions(
    client: Any, tasks: Iterable[JunctionTask]
) -> Iterator[tuple[JunctionTask, JunctionAnswer]]:
    """Run tasks on workers, in the order in which they end.

    Only some are handed over at a time. What fails without a reason of its own, and what a worker
    takes along that dies, is tried three times in all; then it is a record that says so.
    """
    from distributed import as_completed

    waiting = iter(tasks)
    running: dict[Any, JunctionTask] = {}
    with client.as_current():
        done = as_completed()

    def hand_over(most: int) -> None:
        while len(running) < most:
            task = next(waiting, None)
            if task is None:
                return
            future = client.submit(
                run_junction, task, key=f"junction-{task.key}", retries=TRIES - 1, pure=False
            )
            running[future] = task
            done.add(future)

    def most() -> int:
        return _AHEAD * max(len(client.scheduler_info(n_workers=-1)["workers"]), 1)

    try:
        hand_over(most())
        for future in done:
            task = running.pop(future)
            yield task, _answer(future, task)
            future.release()
            hand_over(most())
    finally:
        for future in running:
            future.cancel()


def _answer(future: Any, task: JunctionTask) -> JunctionAnswer:
    from distributed import KilledWorker

    try:
        answer: JunctionAnswer = future.result()
    except KilledWorker:
        reason = f"its worker died, {TRIES} times: more --worker-memory, or fewer poses (--coarse)"
    except Exception as error:  # of a task, tried again and again
        told = " ".join(str(error).split())[:200]
        reason = f"an unexpected error, {TRIES} times: {type(error).__name__}: {told}"
    else:
        return answer
    return JunctionAnswer(record=failed_record(task, reason, is_final=False), files={})
