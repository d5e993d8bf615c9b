"""``place-rsus city``: the fronts of many junctions, what each gets, and a folder with all of it.

The folder has a folder for each junction with its scene and front, written as soon as that is
known; started again, only what is missing, or whose inputs have changed, is computed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path

import msgspec
import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError, Unquoted
from geometry.maps.importing import DEFAULT_RADIUS_M, ImportOptions, ReadingOptions
from geometry.maps.sites import check_sites
from placement.candidates import CandidateGrid
from placement.city.choose import CityChoice, choose, city_front
from placement.city.fronts import Options, stack_bounds, stack_fronts
from placement.city.junction import JunctionWishes
from placement.city.phases import Phases, plan_phases
from placement.kept import Fingerprints
from placement.layout import Layout
from placement.optimiser.tolerances import TOLERANCE
from placement.planning import build_grid
from placement.question import Question
from placement.setting import check_question

from ..progress import WRITING, StageProgress
from ..results.city import (
    FRONT,
    JUNCTIONS,
    MANIFEST,
    SCHEMA,
    CityEntry,
    CityFrontRecord,
    CityJunctionRecord,
    CityManifest,
    CityResult,
    CitySearchRecord,
    CityStepRecord,
    load_front,
    load_manifest,
)
from ..results.drives import versions
from ..results.folders import check_folder, sha256, write_files
from ..results.numbers import euros, percent, several
from ..results.record import StageRecord, build_stage_records
from .city_inputs import City, CityJunction, CityValues, CityWish, load_city, load_kept, load_values
from .city_workers import (
    JunctionAnswer,
    JunctionTask,
    check_memory,
    run_junctions,
    start_workers,
)
from .city_writing import complete_result, write_city

CITY_VERSION = 3
"""Counts up when the same inputs give another front: older ones in a folder are made anew."""

SOLVE = "junctions"
"""The stage in which fronts are found."""

_CHOICE_S = 120.0
_MAX_STEPS = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class CitySearch:
    """How the fronts of the junctions are looked for.

    Attributes
    ----------
    is_coarse : bool
        Whether a ninth of the poses is tried.
    max_units : int
        Most new units at a junction.
    max_junction_s : float
        For each junction. [s]
    radius_m : float
        Of what is kept around a junction. [m]
    sites : str
        See :class:`geometry.maps.importing.ImportOptions`.
    reading : ReadingOptions
        What map files do not say of themselves.
    gap : float
        Relative gap at which the city's choice counts as settled.
    """

    is_coarse: bool = False
    max_units: int = 6
    max_junction_s: float = 300.0
    radius_m: float = DEFAULT_RADIUS_M
    sites: str = "auto"
    reading: ReadingOptions = field(default_factory=ReadingOptions)
    gap: float = 0.0


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
    grid = build_grid(question.sensors, is_coarse=search.is_coarse)
    check_question(question)
    check_memory(workers.memory)
    progress("read maps", 0, 0)
    city = load_city(maps, search.reading, wish)
    for source in city.roads:
        check_sites(search.sites, crs=source.crs)
    values = load_values(city, wish)
    kept = load_kept(wish.keep, city)
    manifest = _begin(out, city)
    records = _find_done(out, city)
    tasks = _tasks(city, question, search, grid, kept=kept, seed=seed)
    todo = [(one, task) for one, task in tasks if not _is_done(records.get(one.folder), task)]
    done = {one.folder: records[one.folder] for one, task in tasks if one.folder in records}
    for one, _ in todo:
        done.pop(one.folder, None)
    tell(
        f"{several(len(city.junctions), 'junction', 'junctions')} of {city.n_all}; "
        f"{len(done)} {'is' if len(done) == 1 else 'are'} done already. {values.told}."
    )
    progress.kept = f"junctions that are done are kept in {out}; the same command goes on"
    if todo:
        with start_workers(
            workers.scheduler,
            n_workers=min(workers.n_workers, len(todo)),
            memory=workers.memory,
            tell=tell,
        ) as client:
            by_key = {task.key: one for one, task in todo}
            progress(SOLVE, len(done), len(city.junctions))
            for task, answer in run_junctions(client, [task for _, task in todo]):
                one = by_key[task.key]
                _keep(out, one, answer)
                done[one.folder] = answer.record
                progress(SOLVE, len(done), len(city.junctions))
    entries = _entries(out, city, done)
    new = {entry.folder for entry in entries}
    others = [entry for entry in manifest.junctions if entry.folder not in new]
    manifest = msgspec.structs.replace(manifest, junctions=(*entries, *others))
    _write_manifest(out, manifest)
    progress("choose", 0, 0)
    result = _choose(city, values, done, question=question, wish=wish, search=search, kept=kept)
    result = msgspec.structs.replace(
        result, command=command, computed=len(todo), versions=versions()
    )
    progress(WRITING, 0, 0)
    sensors = {model.name: model for model in grid.sensors}
    for layout in kept.values():
        sensors |= {unit.sensor.name: unit.sensor for unit in layout.units}
    result = complete_result(out, result, question=question, kept=kept, sensors=sensors)
    result = msgspec.structs.replace(result, seconds=progress.finish())
    write_city(
        out,
        result,
        city,
        [done[one.folder] for one in city.junctions],
        sensors=sensors,
        question=question,
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


def _find_done(out: Path, city: City) -> dict[str, CityFrontRecord]:
    found = {}
    for one in city.junctions:
        record = load_front(out / JUNCTIONS / one.folder / FRONT)
        if record is not None and record.schema == SCHEMA:
            found[one.folder] = record
    return found


def _is_done(record: CityFrontRecord | None, task: JunctionTask) -> bool:
    return record is not None and record.key == task.key and record.is_final


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


def _tasks(
    city: City,
    question: Question,
    search: CitySearch,
    grid: CandidateGrid,
    *,
    kept: dict[str, Layout],
    seed: int,
) -> list[tuple[CityJunction, JunctionTask]]:
    """A task for each junction; its key is a hash of all that the front depends on."""
    around = city.neighbourhoods(radius_m=search.radius_m)
    prints = Fingerprints()
    sites = Path(search.sites)
    listed = sha256(sites) if sites.is_file() else ""
    options = ImportOptions(radius_m=search.radius_m, sites=search.sites, reading=search.reading)
    tasks = []
    for one in city.junctions:
        maps = around[one.roads.name].around(one.surveyed.junction)
        wishes = JunctionWishes(
            grid=grid,
            max_units=search.max_units,
            time_limit_s=search.max_junction_s,
            kept=kept.get(one.scene_name),
        )
        key = prints.of(
            *(CITY_VERSION, version("place-rsus"), seed, listed),
            *(search.radius_m, search.sites, question, wishes, maps),
        )
        tasks.append(
            (
                one,
                JunctionTask(
                    key=key,
                    maps=maps,
                    chosen=one.surveyed,
                    options=replace(options, name=one.scene_name),
                    question=question,
                    wishes=wishes,
                    seed=seed,
                ),
            )
        )
    return tasks


# ---------- the choice


def _choose(
    city: City,
    values: CityValues,
    done: dict[str, CityFrontRecord],
    *,
    question: Question,
    wish: CityWish,
    search: CitySearch,
    kept: dict[str, Layout],
) -> CityResult:
    records = [done[one.folder] for one in city.junctions]
    solved = [index for index, record in enumerate(records) if not record.reason]
    if not solved:
        failed = records[0]
        told = f"no junction with a front; {failed.name or failed.id}: {failed.reason}"
        raise InputError(
            city.records[0].name,
            Unquoted(told),
            "one at which runs can be laid and sites can carry units",
        )
    weight = values.weight[solved]
    if not weight.sum() > 0.0:
        raise InputError(
            "--junction-weights",
            Unquoted("weights only of junctions that have no front"),
            "a weight above 0 for one that has",
        )
    fronts = [records[index].front for index in solved]
    options = stack_fronts(fronts)
    asked = values.wishes(wish, solved)
    choice = choose(
        options,
        weight,
        asked,
        bounds=stack_bounds(
            fronts,
            counts_units=asked.budget_units is not None,
            counts_cost=asked.budget_eur is not None,
        ),
        names=[city.junctions[index].label for index in solved],
        gap=search.gap,
        time_limit_s=_CHOICE_S,
    )
    first = np.flatnonzero(np.diff(options.junction, prepend=-1))
    share = weight / weight.sum()
    phases = _phases(options, choice, first, share, wish)
    by_cost = wish.budget_eur is not None
    got = {index: row for row, index in enumerate(solved)}
    total = values.weight.sum()
    junctions = []
    for index, (one, record) in enumerate(zip(city.junctions, records, strict=True)):
        x, y = (float(value) for value in one.surveyed.position)
        answer = CityJunctionRecord(
            id=one.surveyed.junction.id,
            name=one.surveyed.junction.name,
            map=one.roads.name,
            folder=f"{JUNCTIONS}/{one.folder}",
            x=x,
            y=y,
            weight=float(values.weight[index] / total),
            district=values.district_of(index),
            reason=record.reason,
        )
        if index in got:
            row, before = int(choice.rows[got[index]]), int(first[got[index]])
            chosen = record.points[row - before]
            answer = msgspec.structs.replace(
                answer,
                units=chosen.units,
                cost_eur=chosen.cost_eur,
                apr_before=record.points[0].apr,
                apr=chosen.apr,
                apr_one_failed=chosen.apr_one_failed,
                layout=chosen.layout,
                kept=len(chosen.layout) - chosen.units,
                year=0 if phases is None else int(phases.year[got[index]]),
            )
        junctions.append(answer)
    steps = city_front(options, weight, by_cost=by_cost)
    stages = build_stage_records(choice.certificate)
    result = CityResult(
        command="",
        maps=city.records,
        budget_units=wish.budget_units,
        budget_eur=wish.budget_eur,
        weights=values.told,
        units=sum(one.units for one in junctions),
        cost_eur=sum(one.cost_eur for one in junctions),
        apr_before=float(share @ options.apr[first]),
        stages=stages,
        bound_of_fronts=choice.bound_of_points,
        solver=choice.certificate.solver,
        is_proven=choice.certificate.is_proven,
        junctions=tuple(junctions),
        not_done=len(records) - len(solved),
        computed=0,
        by="cost" if by_cost else "units",
        front=tuple(
            CityStepRecord(
                junction=city.junctions[solved[step.junction]].label,
                units=int(options.units[step.row]),
                taken=step.taken,
                apr=step.apr,
            )
            for step in steps[:_MAX_STEPS]
        ),
        cheapest=_cheapest(city, options, solved, share, first, by_cost=by_cost),
        gain_years=None if phases is None else phases.gain_years,
        purchases=(),
        search=CitySearchRecord(
            poses="coarse" if search.is_coarse else "fine",
            max_units=search.max_units,
            max_junction_seconds=search.max_junction_s,
            radius_m=search.radius_m,
            sites=search.sites,
        ),
        sentences=(),
        notes=(*city.notes, *values.notes),
        seconds={},
        versions={},
    )
    return msgspec.structs.replace(result, sentences=_sentences(result, wish, phases))


def _phases(
    options: Options, choice: CityChoice, first: IntArray, share: FloatArray, wish: CityWish
) -> Phases | None:
    if wish.units_per_year is None:
        return None
    gain = share * (options.apr[choice.rows] - options.apr[first])
    return plan_phases(
        options.units[choice.rows],
        np.maximum(gain, 0.0),
        units_per_year=wish.units_per_year,
        years=wish.years,
    )


def _cheapest(
    city: City,
    options: Options,
    solved: Sequence[int],
    share: FloatArray,
    first: IntArray,
    *,
    by_cost: bool,
) -> str:
    """What the cheapest useful option costs and buys."""
    gain = share[options.junction] * (options.apr - options.apr[first][options.junction])
    useful = np.flatnonzero(gain > TOLERANCE)
    if not len(useful):
        return "No unit at any junction prevents anything."
    taken = options.cost_eur if by_cost else options.units.astype(np.float64)
    cheap = useful[taken[useful] <= taken[useful].min() + TOLERANCE]
    best = int(cheap[np.argmax(gain[cheap])])
    one = city.junctions[solved[int(options.junction[best])]]
    return (
        f"The cheapest useful choice is {several(int(options.units[best]), 'unit', 'units')} at "
        f"{one.label} for {euros(options.cost_eur[best])}: it would prevent "
        f"{percent(float(gain[best]))} of the city's accidents."
    )


def _sentences(result: CityResult, wish: CityWish, phases: Phases | None) -> tuple[str, ...]:
    """What matters, the first line first of all."""
    apr = result.stages[0]
    served = sum(one.units > 0 for one in result.junctions)
    n_fronts = len(result.junctions) - result.not_done
    head = (
        f"{several(result.units, 'unit', 'units')} at {served} of {n_fronts} junctions for "
        f"{euros(result.cost_eur)}: {percent(apr.objective)} of the accidents there are prevented"
    )
    if result.units == 0:
        budget = (
            several(result.budget_units or 0, "unit", "units")
            if result.budget_eur is None
            else euros(result.budget_eur)
        )
        head = f"Nothing at {several(n_fronts, 'junction', 'junctions')} for at most {budget}"
    if result.not_done:
        head += f"; {several(result.not_done, 'junction', 'junctions')} not done"
    lines = [head + "."]
    if result.units == 0:
        lines.append(result.cheapest)
    lines.append(_proof(apr, result.bound_of_fronts))
    if result.apr_before > 0.0:
        lines.append(
            f"What hangs there already prevents {percent(result.apr_before)} of the accidents."
        )
    if phases is not None:
        n_years = int(phases.year.max(initial=0))
        lines.append(
            f"At most {wish.units_per_year} units a year: all hang after "
            f"{several(n_years, 'year', 'years')}, those that gain most per unit first"
            + (" (proven)." if phases.bound <= phases.gain_years else ".")
        )
    if result.not_done:
        lost = sum(one.weight for one in result.junctions if one.reason)
        lines.append(
            f"Junctions that are not done have {percent(lost)} of the weight; the table says why."
        )
    return tuple(lines)


def _proof(apr: StageRecord, of_fronts: float) -> str:
    if apr.gap == 0.0:
        return (
            "Proven: no other units for the same budget, at these sites and in these poses, "
            "prevent more."
        )
    bound = percent(apr.bound)
    if of_fronts <= apr.objective + TOLERANCE:
        return (
            f"No choice prevents more than {bound}; among the layouts found this choice is the "
            "best one, what is open are the fronts of the junctions."
        )
    return (
        f"No choice prevents more than {bound}, none among the layouts found more than "
        f"{percent(of_fronts)}."
    )
