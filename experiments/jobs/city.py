"""``place-rsus city``: the fronts of many junctions, what each gets, and a folder with all of it.

The folder has a folder for each junction with its scene and front, written as soon as that is
known; started again, only what is missing, or whose inputs have changed, is computed.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, fields
from multiprocessing import get_context
from pathlib import Path

import msgspec

from geometry.errors import InputError, Unquoted
from geometry.maps.importing import ImportOptions
from geometry.maps.sites import check_sites
from placement.cache import ALL_PACKAGES, Fingerprints, hash_of_files
from placement.candidates import CandidateGrid, build_grid
from placement.city.junction import JunctionWishes
from placement.layout import Layout
from placement.question import Question
from placement.setting import check_question

from ..progress import WRITING, StageProgress, follow_parent
from ..results.city import (
    FRONT,
    JUNCTIONS,
    MANIFEST,
    SCHEMA,
    CityEntry,
    CityFrontRecord,
    CityManifest,
    CityResult,
    load_front,
    load_manifest,
    without_layouts,
)
from ..results.drives import versions
from ..results.folders import check_folder, sha256, write_files
from ..results.numbers import several
from .city_answer import choose_for_city
from .city_inputs import (
    City,
    CityJunction,
    CitySearch,
    CityWish,
    load_city,
    load_kept,
    load_values,
)
from .city_workers import (
    JunctionAnswer,
    JunctionTask,
    check_memory,
    run_junctions,
    start_workers,
)
from .city_writing import (
    Served,
    ServedTask,
    build_purchases,
    served_tasks,
    write_city,
    write_served,
)

CITY_VERSION = 3
"""Counts up when the same inputs give another front: older ones in a folder are made anew."""

SOLVE = "junctions"
"""The stage in which fronts are found."""

SERVE = "junctions with units"
"""The stage in which their layouts and pages are written."""

_NEW_FOR_A_PROCESS = 8  # a process takes some seconds to start, a page half of one


@dataclass(frozen=True, slots=True, kw_only=True)
class CityWorkers:
    """Where the junctions are solved.

    Attributes
    ----------
    scheduler : str
        Address of a dask scheduler; empty: processes on this machine.
    n_workers : int
        Of these.
    memory : str
        Of each at most.
    """

    scheduler: str = ""
    n_workers: int = 1
    memory: str = "1.5GiB"


def run_city(
    question: Question,
    *,
    maps: Sequence[Path],
    wish: CityWish,
    search: CitySearch,
    workers: CityWorkers,
    out: Path,
    seed: int,
    command: str,
    progress: StageProgress,
    tell: Callable[[str], None],
) -> CityResult:
    """Find what each junction of a city gets, and write it.

    Parameters
    ----------
    question : Question
        What is driven at each junction, and what may be mounted.
    maps : sequence of Path
        Maps with roads, and others with buildings.
    wish : CityWish
        Budgets, which junctions count and how much, what has to be reached.
    search : CitySearch
        How each front is looked for.
    workers : CityWorkers
        Where.
    out : Path
        Folder: new, empty, or of the same city.
    seed : int
        Of points on the road users.
    command : str
        Command line that makes the result again.
    progress : StageProgress
        Is told the stages.
    tell : callable
        Is told what there is to do, and where the workers are watched.

    Returns
    -------
    result : CityResult
        Also in ``city.json``.

    Raises
    ------
    InputError
        A file cannot be read, the maps overlap, no junction can be solved, a wish cannot be met,
        or the folder is of something else.
    """
    check_folder(out)
    progress.kept = f"nothing was written to {out}"
    grid = build_grid(question, is_coarse=search.is_coarse)
    check_question(question)
    check_memory(workers.memory)
    progress("read maps", 0, 0)
    city = load_city(maps, search.reading, wish)
    for source in city.roads:
        check_sites(search.sites, crs=source.crs)
    values = load_values(city, wish)
    kept = load_kept(wish.keep, city)
    manifest = _begin(out, city)
    tasks = _Tasks(city, question, search, grid, kept=kept, seed=seed)
    done = _find_done(out, tasks)
    n_todo = len(city.junctions) - len(done)
    tell(
        f"{several(len(city.junctions), 'junction', 'junctions')} of {city.n_all}; "
        f"{len(done)} {'is' if len(done) == 1 else 'are'} done already. {values.told}."
    )
    progress.kept = f"junctions that are done are kept in {out}; the same command goes on"
    if n_todo:
        with start_workers(
            workers.scheduler,
            n_workers=min(workers.n_workers, n_todo),
            memory=workers.memory,
            tell=tell,
        ) as started:
            todo = [one for one in city.junctions if one.folder not in done]
            by_id = {one.scene_name: one for one in todo}
            progress(SOLVE, len(done), len(city.junctions))
            for task, answer in run_junctions(started, map(tasks.task, todo)):
                one = by_id[task.options.name]
                _keep(out, one, answer)
                done[one.folder] = without_layouts(answer.record)
                progress(SOLVE, len(done), len(city.junctions))
    before = {entry.folder: entry.sha256 for entry in manifest.junctions}
    entries = _entries(out, city, done)
    new = {entry.folder for entry in entries}
    others = [entry for entry in manifest.junctions if entry.folder not in new]
    manifest = msgspec.structs.replace(manifest, junctions=(*entries, *others))
    _write_manifest(out, manifest)
    progress("choose", 0, 0)
    result = choose_for_city(
        out, city, values, done, question=question, wish=wish, search=search, kept=kept
    )
    result = msgspec.structs.replace(result, command=command, computed=n_todo, versions=versions())
    sensors = {model.name: model for model in grid.sensors}
    for layout in kept.values():
        sensors |= {unit.sensor.name: unit.sensor for unit in layout.units}
    serving = served_tasks(
        out,
        result,
        question=question,
        kept=kept,
        sensors=sensors,
        same_fronts={
            f"{JUNCTIONS}/{one.folder}" for one in entries if before.get(one.folder) == one.sha256
        },
    )
    served = _write_served(serving, workers.n_workers, progress)
    progress(WRITING, 0, 0)
    result = msgspec.structs.replace(result, purchases=build_purchases(served))
    result = write_city(
        out,
        result,
        city,
        [done[one.folder] for one in city.junctions],
        served,
        finish=progress.finish,
    )
    progress.kept = f"the city is in {out}"
    return result


# ---------- the folder


def _begin(out: Path, city: City) -> CityManifest:
    """The folder's list, new or as it is; InputError if the folder is of something else."""
    new = CityManifest(maps=city.records, crs=city.crs, bounds=city.bounds)
    path = out / MANIFEST
    if not path.exists():
        if out.is_dir() and any(out.iterdir()):
            raise InputError(
                "--out", Unquoted(f"{out}, which holds other things"), "a new folder, or a city's"
            )
        _write_manifest(out, new)
        return new
    found = load_manifest(path)
    old = {one.name for one in found.maps if one.has_roads}
    names = {one.name for one in city.records if one.has_roads}
    west, south, east, north = city.bounds
    is_apart = found.crs != city.crs or not (
        found.bounds[0] <= east
        and west <= found.bounds[2]
        and found.bounds[1] <= north
        and south <= found.bounds[3]
    )
    if is_apart or not old & names:
        raise InputError(
            "--out",
            Unquoted(f"{out}, the folder of another city ({', '.join(sorted(old))})"),
            "a new folder, or that of the same maps",
        )
    return msgspec.structs.replace(new, junctions=found.junctions)


def _write_manifest(out: Path, manifest: CityManifest) -> None:
    text = msgspec.json.format(msgspec.json.encode(manifest), indent=1)
    write_files(out, {MANIFEST: text + b"\n"})


def _find_done(out: Path, tasks: "_Tasks") -> dict[str, CityFrontRecord]:
    """Fronts of the same question, by their junction's folder; without layouts."""
    found = {}
    for one in tasks.city.junctions:
        record = load_front(out / JUNCTIONS / one.folder / FRONT)
        if record is None or record.schema != SCHEMA or not record.is_final:
            continue
        if record.key == tasks.task(one).key:
            found[one.folder] = without_layouts(record)
    return found


def _keep(out: Path, one: CityJunction, answer: JunctionAnswer) -> None:
    """Write a junction's scene, then its front: where that is, all is."""
    text = msgspec.json.format(msgspec.json.encode(answer.record), indent=1)
    write_files(out / JUNCTIONS / one.folder, {**answer.files, FRONT: text + b"\n"})


def _entries(out: Path, city: City, done: dict[str, CityFrontRecord]) -> tuple[CityEntry, ...]:
    return tuple(
        CityEntry(
            id=one.surveyed.junction.id,
            map=one.roads.name,
            folder=one.folder,
            key=done[one.folder].key,
            sha256=sha256(out / JUNCTIONS / one.folder / FRONT),
        )
        for one in city.junctions
        if one.folder in done
    )


# ---------- tasks


class _Tasks:
    """Tasks for junctions, each made when it is asked for.

    The key of each is a hash of all that the front depends on, the program's code included.
    """

    def __init__(
        self,
        city: City,
        question: Question,
        search: CitySearch,
        grid: CandidateGrid,
        *,
        kept: dict[str, Layout],
        seed: int,
    ) -> None:
        self.city = city
        self._question, self._search, self._grid = question, search, grid
        self._kept, self._seed = kept, seed
        self._around = city.neighbourhoods(radius_m=search.radius_m)
        sites = Path(search.sites)
        listed = sha256(sites) if sites.is_file() else ""
        code = [hash_of_files(package) for package in ALL_PACKAGES]
        self._prints = Fingerprints()
        self._same = self._prints.of(
            *(CITY_VERSION, code, seed, listed, search.radius_m, search.sites, question, grid)
        )

    def task(self, one: CityJunction) -> JunctionTask:
        """The task of a junction."""
        search = self._search
        maps = self._around[one.roads.name].around(one.surveyed.junction)
        wishes = JunctionWishes(
            grid=self._grid,
            max_units=search.max_units,
            time_limit_s=search.max_junction_s,
            existing=self._kept.get(one.scene_name),
        )
        # Lanes and things lie around several junctions and are hashed once; maps are cut out anew.
        parts = [[getattr(part, field.name) for field in fields(part)] for part in maps]
        limits = (wishes.max_units, wishes.time_limit_s, wishes.existing)
        return JunctionTask(
            key=self._prints.of(self._same, *limits, parts),
            maps=maps,
            chosen=one.surveyed,
            options=ImportOptions(
                radius_m=search.radius_m,
                sites=search.sites,
                reading=search.reading,
                name=one.scene_name,
            ),
            question=self._question,
            wishes=wishes,
            seed=self._seed,
        )


def _write_served(
    tasks: Sequence[ServedTask], n_workers: int, progress: StageProgress
) -> list[Served]:
    """Write what junctions with units have, by several processes where many are new."""
    progress(SERVE, 0, len(tasks))
    served: list[Served] = []
    n_processes = min(n_workers, sum(task.is_new for task in tasks) // _NEW_FOR_A_PROCESS)
    with ExitStack() as stack:
        answers: Iterator[Served] = map(write_served, tasks)
        if n_processes > 1:
            pool = ProcessPoolExecutor(
                n_processes, mp_context=get_context("spawn"), initializer=follow_parent
            )
            answers = stack.enter_context(pool).map(write_served, tasks)
        for answer in answers:
            served.append(answer)
            progress(SERVE, len(served), len(tasks))
    return served
