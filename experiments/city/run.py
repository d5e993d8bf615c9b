"""``place-rsus city``: fronts of many junctions, and the choice.

A folder has all of it.

The folder has a folder for each junction with its scene and front, written as soon as
that is known; started again, only what is missing, or whose inputs have changed, is
computed.
"""

from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from dataclasses import replace as replace_field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
from msgspec.structs import replace

from geometry.catalogue import Sensor
from geometry.errors import refuse
from geometry.frames import transform
from geometry.maps.cut import Neighbourhoods
from geometry.maps.importing import ImportOptions
from geometry.maps.place_lists import list_files
from geometry.maps.sites import check_sites
from geometry.opening import read_bytes
from geometry.scene import Scene
from geometry.scene_files import load_scene_folder
from placement.candidates import CandidateGrid, build_grid
from placement.city.junction import JunctionWishes
from placement.fingerprints import ALL_PACKAGES, Fingerprints, hash_of_files
from placement.layout import Layout, layout_from_records
from placement.question import Question, question_text, save_question
from placement.setting import check_question
from scenarios.weights import weight_files

from ..engine.start import LOCAL, EngineWish, start_engine
from ..engine.tasks import map_tasks
from ..export.gpkg import geopackage
from ..export.json import to_json, to_json_text
from ..export.places import drawn_records
from ..figures.axes import NARROW_IN, to_png
from ..language import mark, speaking, tr
from ..parts.bill_of_materials import build_bill
from ..progress import WRITING, StageProgress
from ..results.drives import versions
from ..results.folders import (
    LAYOUT_FILE,
    check_folder,
    sha256,
    write_files,
    write_manifest,
)
from ..results.record import Record, to_plain
from ..results.tables import csv_text
from . import inputs, pages
from .answer import (
    FRONT,
    FRONTS,
    MANIFEST,
    SCHEMA,
    SUMMARY,
    CityEntry,
    CityFrontRecord,
    CityJunctionRecord,
    CityManifest,
    CityPurchaseRecord,
    CityResult,
    choose_for_city,
    fronts_table,
    load_front,
    load_manifest,
    load_summary,
)
from .tasks import JunctionTask, run_junction, unsolved

REPORT = "report.html"
GEOPACKAGE = "city.gpkg"
QUESTION = "question.toml"
JUNCTION_TABLE = "junctions.csv"
POLE_TABLE = "poles.csv"
CITY_VERSION = 3
"""Counts up when the same inputs give another front: older ones are made anew."""

SOLVE = "junctions"
"""The stage in which fronts are found."""

SERVE = "junctions with units"
"""The stage in which their layouts and pages are written."""

# A process takes some seconds to start, a page half of one.
_NEW_FOR_A_PROCESS = 8


def run_city(
    question: Question,
    *,
    maps: Sequence[Path],
    wish: inputs.CityWish,
    search: inputs.CitySearch,
    engine: EngineWish,
    out: Path,
    seed: int,
    command: str,
    progress: StageProgress,
    tell: Callable[[str], None],
) -> CityResult:
    """Choose the units of each junction of a city, and write the answer.

    `question` has the runs and sensors at each junction; `maps` those with roads, and
    others with buildings; `engine` says where fronts are found; `out` is new, empty, or
    of the same city; `tell` gets the amount of work and the workers. Raises InputError:
    a file cannot be read, the maps overlap, no junction can be solved, a wish cannot be
    met, or the folder is of something else.
    """
    check_folder(out)
    progress.kept = f"nothing was written to {out}"
    grid = build_grid(question, is_coarse=search.is_coarse)
    check_question(question)
    progress(mark("read maps"), 0, 0)
    city = inputs.load_city(maps, search.reading, wish)
    sites_crs: dict[str, str] = {}
    for source in city.roads:
        sites_crs[source.name], notes = check_sites(
            search.sites, source, sites_crs=search.sites_crs
        )
        for note in notes:
            tell(tr(note.words))
    values = inputs.load_values(city, wish)
    existing = inputs.load_existing(wish.keep, city)
    manifest = _begin(out, city)
    task_of = _task_maker(
        city, question, search, grid, sites_crs=sites_crs, existing=existing, seed=seed
    )
    done = _find_done(out, city, task_of)
    n_todo = len(city.junctions) - len(done)
    said = {
        "n": len(city.junctions),
        "all": city.n_all,
        "done": len(done),
        "source": values.source,
    }
    tell(
        tr("Junctions: {n} of {all}; done already: {done}. Weights: {source}.", **said)
    )
    progress.kept = (
        f"junctions that are done are kept in {out}; the same command goes on"
    )
    if n_todo:
        todo = {one.scene_name: one for one in city.junctions if one.folder not in done}
        with start_engine(engine, n_tasks=n_todo, tell=tell) as started:
            tell(_workers_sentence(engine, started.capacity))
            progress(SOLVE, len(done), len(city.junctions))
            tasks = map(task_of, todo.values())
            answers = map_tasks(run_junction, tasks, engine=started, failed=unsolved)
            for task, answer in answers:
                one = todo[task.options.name]
                # The scene first: where a front is, the scene is whole.
                files = {**answer.files, FRONT: _json(answer.record)}
                write_files(out / inputs.JUNCTIONS / one.folder, files)
                done[one.folder] = answer.record.without_layouts()
                progress(SOLVE, len(done), len(city.junctions))
    unchanged = _update_manifest(out, manifest, city, done)
    progress(mark("choose"), 0, 0)
    result = choose_for_city(
        out, city, values, done, wish=wish, search=search, existing=existing
    )
    result = replace(result, command=command, computed=n_todo, versions=versions())
    served = _write_served(
        _served_tasks(
            out,
            result,
            question=question,
            existing=existing,
            grid=grid,
            same_fronts=unchanged,
        ),
        engine,
        progress,
    )
    progress(WRITING, 0, 0)
    records = [done[one.folder] for one in city.junctions]
    result = replace(result, purchases=_purchases(served))
    result = write_city(out, result, city, records, served, finish=progress.finish)
    progress.kept = f"the city is in {out}"
    return result


def _workers_sentence(engine: EngineWish, n: int) -> str:
    if engine.scheduler not in ("", LOCAL):
        return tr("Workers: {n}, of {scheduler}.", n=n, scheduler=engine.scheduler)
    if n == 1 or engine.max_bytes is None:
        return tr("Workers: {n}.", n=n)
    return tr(
        "Workers: {n}, of at most {memory} memory each.",
        n=n,
        memory=f"{engine.max_bytes / 2**30:.3g} GiB",
    )


def _begin(out: Path, city: inputs.City) -> CityManifest:
    """The folder's manifest, new or as it is.

    InputError if the folder is of something else.
    """
    new = CityManifest(maps=city.records, crs=city.crs, bounds=city.bounds)
    path = out / MANIFEST
    if not path.exists():
        if out.is_dir() and any(out.iterdir()):
            refuse(
                "--out", f"{out}, which holds other things", "a new folder, or a city's"
            )
        write_files(out, {MANIFEST: _json(new)})
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
        got = f"{out}, the folder of another city ({', '.join(sorted(old))})"
        refuse("--out", got, "a new folder, or that of the same maps")
    return replace(new, junctions=found.junctions)


def _json(record: Record) -> bytes:
    return msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n"


_TaskOf = Callable[[inputs.CityJunction], JunctionTask]


def _find_done(
    out: Path, city: inputs.City, task_of: _TaskOf
) -> dict[str, CityFrontRecord]:
    """Fronts of the same question, by their junction's folder; without layouts."""
    found = {}
    for one in city.junctions:
        record = load_front(out / inputs.JUNCTIONS / one.folder / FRONT)
        if record is None or record.schema != SCHEMA or not record.is_final:
            continue
        if record.key == task_of(one).key:
            found[one.folder] = record.without_layouts()
    return found


def _update_manifest(
    out: Path,
    manifest: CityManifest,
    city: inputs.City,
    done: dict[str, CityFrontRecord],
) -> set[str]:
    """Write the manifest with all fronts; folders whose fronts were there before."""
    before = {entry.folder: entry.sha256 for entry in manifest.junctions}
    entries = {
        one.folder: CityEntry(
            id=one.surveyed.junction.id,
            map=one.roads.name,
            folder=one.folder,
            key=done[one.folder].key,
            sha256=sha256(out / inputs.JUNCTIONS / one.folder / FRONT),
        )
        for one in city.junctions
    }
    others = [entry for entry in manifest.junctions if entry.folder not in entries]
    junctions = (*entries.values(), *others)
    write_files(out, {MANIFEST: _json(replace(manifest, junctions=junctions))})
    same = (
        folder
        for folder, entry in entries.items()
        if before.get(folder) == entry.sha256
    )
    return {f"{inputs.JUNCTIONS}/{folder}" for folder in same}


def _task_maker(
    city: inputs.City,
    question: Question,
    search: inputs.CitySearch,
    grid: CandidateGrid,
    *,
    existing: dict[str, Layout],
    seed: int,
    sites_crs: Mapping[str, str] = MappingProxyType({}),
) -> _TaskOf:
    """Function of a junction: its task, made when it is asked for.

    `sites_crs` is the reference system of a list of sites by the name of the map.

    The key of each is a hash of all that the front depends on, the program's code
    included.
    """
    around = {
        source.name: Neighbourhoods([source, *city.others], radius_m=search.radius_m)
        for source in city.roads
    }
    listed: list[str] = []
    if Path(search.sites).is_file():
        listed = [sha256(path) for path in list_files(Path(search.sites))]
    weighed = [
        sha256(path) for path in weight_files(question.weights) if path.is_file()
    ]
    code = [hash_of_files(package) for package in ALL_PACKAGES]
    prints = Fingerprints()
    same = prints.of(
        CITY_VERSION,
        code,
        seed,
        listed,
        search.radius_m,
        search.sites,
        dict(sites_crs),
        question,
        grid,
        weighed,
    )

    def task_of(one: inputs.CityJunction) -> JunctionTask:
        maps = around[one.roads.name].around(one.surveyed.junction)
        wishes = JunctionWishes(
            grid=grid,
            max_units=search.max_units,
            time_limit_s=search.max_junction_s,
            existing=existing.get(one.scene_name),
        )
        # Lanes and things lie around several junctions and are hashed once; maps are
        # cut out anew.
        parts = [[getattr(part, field.name) for field in fields(part)] for part in maps]
        limits = (wishes.max_units, wishes.time_limit_s, wishes.existing)
        return JunctionTask(
            key=prints.of(same, *limits, parts),
            maps=maps,
            chosen=one.surveyed,
            options=ImportOptions(
                radius_m=search.radius_m,
                sites=search.sites,
                sites_crs=sites_crs.get(one.roads.name, search.sites_crs),
                reading=search.reading,
                name=one.scene_name,
            ),
            question=question,
            wishes=wishes,
            seed=seed,
        )

    return task_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ServedTask:
    """A junction with units, to be equipped by any process that sees the folder."""

    out: Path
    one: CityJunctionRecord
    sensors: tuple[Sensor, ...]
    question: Question
    existing: Layout | None
    has_page: bool
    is_new: bool
    language: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Served:
    """A junction's rows of the city's tables.

    Items are (part, name, count, sum_eur).
    """

    items: tuple[tuple[str, str, int, float | None], ...]
    units: tuple[dict[str, Any], ...]
    poles: tuple[dict[str, Any], ...]


def write_served(task: ServedTask) -> Served:
    """Write layout, question and page of a junction if they are new.

    Returns its rows.
    """
    one = task.one
    question = task.question
    folder = task.out / one.folder
    scene = load_scene_folder(folder)
    layout = layout_from_records(
        f"city-{len(one.layout)}",
        [to_plain(unit) for unit in one.layout],
        one.folder,
        sensors={sensor.name: sensor for sensor in task.sensors},
    )
    layout = replace_field(layout, scene_name=scene.name)
    names = [unit.id for unit in layout.units]
    existing = () if task.existing is None else task.existing.units
    items: list[tuple[str, str, int, float | None]] = []
    if one.units:
        bill = build_bill(
            layout,
            scene,
            site_cost_eur=question.site_cost_eur,
            kept_ids=[unit.id for unit in existing if unit.id in names],
        )
        items = [
            (
                item.part,
                item.name if item.part == "sensor" else item.kind,
                item.count,
                item.sum_eur,
            )
            for item in (*bill.sensors, *bill.sites)
            if item.count
        ]
    if task.is_new:
        save_question(folder / QUESTION, question)
        files = {LAYOUT_FILE: to_json(layout, scene).encode()}
        if task.has_page:
            record = load_front(folder / FRONT)
            assert record is not None
            # It may be in another process.
            with speaking(task.language):
                page = pages.render_junction_page(
                    one, record, scene, layout, question=QUESTION
                )
            files[REPORT] = page.encode()
        write_files(folder, files)
    head = {"junction": one.id, "name": one.name, "year": one.year}
    placed = [head | unit for unit in drawn_records(layout, scene)]
    return Served(
        items=tuple(items), units=tuple(placed), poles=tuple(_poles(one, scene, placed))
    )


def _write_served(
    tasks: Sequence[ServedTask], engine: EngineWish, progress: StageProgress
) -> list[Served]:
    """Write what junctions with units have, by several processes where many are new.

    They write into the folder, which only this machine needs to see.
    """
    progress(SERVE, 0, len(tasks))
    served = {}
    n_new = sum(task.is_new for task in tasks)
    drawing = engine.on_this_machine().with_workers(n_new // _NEW_FOR_A_PROCESS)
    with start_engine(drawing, n_tasks=len(tasks), tell=_nothing) as started:
        for task, answer in map_tasks(write_served, tasks, engine=started):
            served[task.one.folder] = answer
            progress(SERVE, len(served), len(tasks))
    return [served[task.one.folder] for task in tasks]


def _nothing(sentence: str) -> None:
    """Processes of this machine have nothing to tell."""


def _served_tasks(
    out: Path,
    result: CityResult,
    *,
    question: Question,
    existing: Mapping[str, Layout],
    grid: CandidateGrid,
    same_fronts: Container[str],
) -> list[ServedTask]:
    """A task for each junction with units; layouts and pages of the others are removed.

    `same_fronts` are folders whose fronts are those of the last call: where it chose
    the same, nothing is written again. The junctions that gain most get pages.
    """
    sensors = {model.name: model for model in grid.sensors}
    for layout in existing.values():
        sensors |= {unit.sensor.name: unit.sensor for unit in layout.units}
    last = load_summary(out / SUMMARY)
    same = {}
    if last is not None and (last.versions, last.language) == (
        result.versions,
        result.language,
    ):
        same = {one.folder: one for one in last.junctions if one.folder in same_fronts}
    asked = question_text(question).encode()
    served = [one for one in result.junctions if one.layout and not one.reason]
    by_gain = sorted(served, key=lambda one: -one.gain)[: pages.MAX_ROWS]
    paged = {one.folder for one in by_gain}
    right = {
        one.folder
        for one in served
        if same.get(one.folder) == one
        and (out / one.folder / QUESTION).is_file()
        and read_bytes(out / one.folder / QUESTION) == asked
    }
    for path in (out / inputs.JUNCTIONS).glob("*/" + REPORT):
        folder = path.parent.relative_to(out).as_posix()
        if folder not in right or folder not in paged:
            path.unlink()
    for path in (out / inputs.JUNCTIONS).glob("*/" + LAYOUT_FILE):
        if path.parent.relative_to(out).as_posix() not in right:
            path.unlink()
    return [
        ServedTask(
            out=out,
            one=one,
            sensors=tuple(sensors.values()),
            question=question,
            existing=existing.get(f"{Path(one.map).stem}/{one.id}"),
            has_page=one.folder in paged,
            language=result.language,
            is_new=one.folder not in right
            or (one.folder in paged and not (out / one.folder / REPORT).exists()),
        )
        for one in served
    ]


def _purchases(served: Iterable[Served]) -> tuple[CityPurchaseRecord, ...]:
    """Parts to order for all junctions."""
    count: Counter[tuple[str, str]] = Counter()
    cents: Counter[tuple[str, str]] = Counter()
    for one in served:
        for part, name, n, sum_eur in one.items:
            count[part, name] += n
            cents[part, name] += round(100.0 * (sum_eur or 0.0))
    purchases = []
    for (part, name), n in count.most_common():
        purchase = CityPurchaseRecord(
            part=part,  # type: ignore[arg-type]
            name=name,
            count=n,
            sum_eur=cents[part, name] / 100.0,
        )
        purchases.append(purchase)
    return tuple(purchases)


def write_city(
    out: Path,
    result: CityResult,
    city: inputs.City,
    records: Sequence[CityFrontRecord],
    served: Sequence[Served],
    *,
    finish: Callable[[], dict[str, float]],
) -> CityResult:
    """Write tables, map and report; the hashes of all files come last.

    `records` are without layouts. `finish` gives the seconds of all stages.
    """
    units = [row for one in served for row in one.units]
    poles = [row for one in served for row in one.poles]
    fronts = (
        load_front(out / one.folder / FRONT) or record
        for one, record in zip(result.junctions, records, strict=True)
    )
    tables = {
        JUNCTION_TABLE: _table([*_junction_rows(result, records)], (*_GOT, *_TOOK)),
        POLE_TABLE: _table(poles, _POLE_COLUMNS),
        FRONTS: fronts_table(fronts),
    }
    (out / GEOPACKAGE).unlink(missing_ok=True)
    if city.roads[0].crs:
        tables[GEOPACKAGE] = _to_geopackage(
            units, poles, result.junctions, crs=city.crs
        )
    places = {one.folder: one.position_m for one in city.junctions}
    position = [places[one.folder.split("/", 1)[1]] for one in result.junctions]
    maps = [*city.roads, *city.others]
    drawn = pages.plot_city_map(maps, position, result)
    narrow = pages.plot_city_map(maps, position, result, width_in=NARROW_IN)
    front = pages.plot_city_front(result)
    tables["map.png"] = to_png(drawn)
    tables["front.png"] = to_png(front)
    write_files(out, tables)
    paged = {
        one.folder for one in result.junctions if (out / one.folder / REPORT).exists()
    }
    sums = pages.build_sums(maps, position, result)
    report = pages.render_city_report(
        result, drawn, narrow, front, sums=sums, poles=poles, paged=paged
    )
    result = replace(result, seconds=finish())
    write_files(out, {REPORT: report.encode(), SUMMARY: to_json_text(result).encode()})
    write_manifest(out)
    return result


_POLE_COLUMNS = (
    *("junction", "name", "year", "site", "kind", "units", "x_m", "y_m"),
    *("map_x", "map_y", "map_crs", "assumed"),
)


def _poles(
    one: CityJunctionRecord, scene: Scene, placed: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """A row for each pole that carries units."""
    kinds = {site.id: site.kind for site in scene.sites}
    at: dict[str, list[Mapping[str, Any]]] = {}
    for unit in placed:
        at.setdefault(unit["site"] or unit["id"], []).append(unit)
    return [
        {
            **{key: units[0][key] for key in _POLE_COLUMNS if key in units[0]},
            **{"site": site, "kind": kinds.get(site, "unknown"), "units": len(units)},
        }
        for site, units in at.items()
    ]


def _to_geopackage(
    units: list[dict[str, Any]],
    poles: list[dict[str, Any]],
    junctions: Sequence[CityJunctionRecord],
    *,
    crs: str,
) -> bytes:
    """Layers "units", "poles" and "junctions" in the map's coordinates.

    Units are points with height.

    Units and poles may be of maps with other reference systems.
    """
    import geopandas as gpd

    columns = (
        *("id", "name", "map", "weight", "district", "units", "cost_eur", "year"),
        *("apr_before", "apr", "apr_one_failed", "gain", "reason", "cause"),
    )

    def places(rows: Sequence[Mapping[str, Any]]) -> Iterator[Any]:
        for row in rows:
            here = [row["map_x"], row["map_y"]]
            yield (
                here if row["map_crs"] == crs else transform(here, row["map_crs"], crs)
            )

    rows = [{name: getattr(one, name) for name in columns} for one in junctions]
    points = gpd.points_from_xy(
        [one.x for one in junctions], [one.y for one in junctions]
    )
    layers = [(inputs.JUNCTIONS, "Point", rows, points)]
    if units:
        heights_m = [unit.get("map_z", unit["z_m"]) for unit in units]
        points = gpd.points_from_xy(*zip(*places(units), strict=True), z=heights_m)
        layers.append(("units", "Point Z", units, points))
        points = gpd.points_from_xy(*zip(*places(poles), strict=True))
        layers.append(("poles", "Point", poles, points))
    return geopackage(layers, crs)


_GOT = (
    *("id", "name", "map", "x", "y", "weight", "district", "units", "cost_eur", "year"),
    *("apr_before", "apr", "apr_one_failed", "reason", "cause", "folder"),
)
_TOOK = ("sites", "poses", "runs", "frames", "cpu_s", "peak_memory_mib")


def _table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> bytes:
    import pandas as pd

    return csv_text(pd.DataFrame(rows, columns=list(columns))).encode()


def _junction_rows(
    result: CityResult, records: Sequence[CityFrontRecord]
) -> Iterator[dict[str, Any]]:
    """A row for each junction.

    What it gets, how large its question was, and what that took.
    """
    for one, record in zip(result.junctions, records, strict=True):
        yield {
            **{name: getattr(one, name) for name in _GOT},
            **{name: getattr(record, name) for name in _TOOK if name != "cpu_s"},
            "cpu_s": round(sum(record.seconds.values()), 1),
        }
