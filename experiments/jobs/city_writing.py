"""What a city's folder holds next to the fronts: layouts, what to order, tables, map, report."""

from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from geometry.catalogue import Sensor
from geometry.errors import InputError
from geometry.files import read_bytes
from geometry.scene import Scene
from geometry.scene_files import load_scene_folder
from placement.layout import Layout, layout_from_records
from placement.question import Question, question_text, save_question

from ..export.city import to_city_geopackage
from ..export.json import to_json, to_json_text
from ..export.places import placed_records
from ..figures.axes import to_png
from ..figures.city import plot_city_front, plot_city_map
from ..parts.bill_of_materials import build_bill
from ..report.city import MAX_ROWS, render_city_report, render_junction_page
from ..results.city import (
    FRONT,
    FRONTS,
    JUNCTIONS,
    SUMMARY,
    CityFrontRecord,
    CityJunctionRecord,
    CityPurchaseRecord,
    CityResult,
    fronts_table,
    load_front,
    load_summary,
)
from ..results.csv_text import csv_text
from ..results.folders import LAYOUT_FILE, write_files, write_manifest
from ..results.record import to_plain
from .city_inputs import City

REPORT, GEOPACKAGE, QUESTION = "report.html", "city.gpkg", "question.toml"
JUNCTION_TABLE, POLE_TABLE = "junctions.csv", "poles.csv"


# ---------- the junctions that get units


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ServedTask:
    """A junction with units, to be equipped by any process that sees the folder."""

    out: Path
    one: CityJunctionRecord
    sensors: tuple[Sensor, ...]
    question: Question
    kept: Layout | None
    has_page: bool
    is_new: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Served:
    """What a junction adds to the city's tables.

    Attributes
    ----------
    items : tuple of (part, name, count, sum_eur)
        What has to be ordered.
    units, poles : tuple of dict
        Rows.
    """

    items: tuple[tuple[str, str, int, float | None], ...]
    units: tuple[dict[str, Any], ...]
    poles: tuple[dict[str, Any], ...]


def write_served(task: ServedTask) -> Served:
    """Write layout, question and page of a junction, if they are new; its rows."""
    one, question = task.one, task.question
    folder = task.out / one.folder
    scene = load_scene_folder(folder)
    layout = junction_layout(one, scene, {sensor.name: sensor for sensor in task.sensors})
    names = [unit.id for unit in layout.units]
    kept = () if task.kept is None else task.kept.units
    items: list[tuple[str, str, int, float | None]] = []
    if one.units:
        bill = build_bill(
            layout,
            scene,
            site_cost_eur=question.site_cost_eur,
            kept_ids=[unit.id for unit in kept if unit.id in names],
        )
        items = [
            (item.part, item.name if item.part == "sensor" else item.kind, item.count, item.sum_eur)
            for item in (*bill.sensors, *bill.sites)
            if item.count
        ]
    if task.is_new:
        save_question(folder / QUESTION, question)
        files = {LAYOUT_FILE: to_json(layout, scene).encode()}
        if task.has_page:
            record = load_front(folder / FRONT)
            assert record is not None
            page = render_junction_page(one, record, scene, layout, question=QUESTION)
            files[REPORT] = page.encode()
        write_files(folder, files)
    head = {"junction": one.id, "name": one.name, "year": one.year}
    placed = [head | unit for unit in placed_records(layout, scene)]
    return Served(items=tuple(items), units=tuple(placed), poles=tuple(_poles(one, scene, placed)))


def junction_layout(one: CityJunctionRecord, scene: Scene, sensors: Mapping[str, Sensor]) -> Layout:
    """The units that a junction gets, with those that hang there."""
    layout = layout_from_records(
        f"city-{len(one.layout)}",
        [to_plain(unit) for unit in one.layout],
        one.folder,
        sensors=sensors,
    )
    return replace(layout, scene_name=scene.name)


def served_tasks(
    out: Path,
    result: CityResult,
    *,
    question: Question,
    kept: Mapping[str, Layout],
    sensors: Mapping[str, Sensor],
    same_fronts: Container[str],
) -> list[ServedTask]:
    """A task for each junction with units; what others had is removed.

    `same_fronts` are folders whose fronts are those of the last call: where it chose the same,
    nothing is written again. Those that gain most, which the report lists, get pages.
    """
    last = load_summary(out / SUMMARY)
    chosen = () if last is None or last.versions != result.versions else last.junctions
    same = {one.folder: one for one in chosen if one.folder in same_fronts}
    asked = question_text(question).encode()
    served = [one for one in result.junctions if one.layout and not one.reason]
    by_gain = sorted(served, key=lambda one: -one.gain)[:MAX_ROWS]
    paged = {one.folder for one in by_gain}
    right = {
        one.folder
        for one in served
        if same.get(one.folder) == one and _content(out / one.folder / QUESTION) == asked
    }
    for path in (out / JUNCTIONS).glob("*/" + REPORT):
        folder = path.parent.relative_to(out).as_posix()
        if folder not in right or folder not in paged:
            path.unlink()
    for path in (out / JUNCTIONS).glob("*/" + LAYOUT_FILE):
        if path.parent.relative_to(out).as_posix() not in right:
            path.unlink()
    return [
        ServedTask(
            out=out,
            one=one,
            sensors=tuple(sensors.values()),
            question=question,
            kept=kept.get(f"{Path(one.map).stem}/{one.id}"),
            has_page=one.folder in paged,
            is_new=one.folder not in right
            or (one.folder in paged and not (out / one.folder / REPORT).exists()),
        )
        for one in served
    ]


def _content(path: Path) -> bytes:
    try:
        return read_bytes(path)
    except InputError:
        return b""


def build_purchases(served: Iterable[Served]) -> tuple[CityPurchaseRecord, ...]:
    """What has to be ordered for all junctions."""
    count: Counter[tuple[str, str]] = Counter()
    cents: Counter[tuple[str, str]] = Counter()
    for one in served:
        for part, name, n, sum_eur in one.items:
            count[part, name] += n
            cents[part, name] += round(100.0 * (sum_eur or 0.0))
    return tuple(
        CityPurchaseRecord(part=key[0], name=key[1], count=n, sum_eur=cents[key] / 100.0)  # type: ignore[arg-type]
        for key, n in count.most_common()
    )


# ---------- the city


def write_city(
    out: Path,
    result: CityResult,
    city: City,
    records: Sequence[CityFrontRecord],
    served: Sequence[Served],
    *,
    finish: Callable[[], dict[str, float]],
) -> CityResult:
    """Write tables, map and report; the hashes of all files come last.

    `records` are without layouts, which are read again where they are needed. `finish` gives the
    seconds of all stages, when all but the summary is written.
    """
    units = [row for one in served for row in one.units]
    poles = [row for one in served for row in one.poles]
    fronts = (
        load_front(out / one.folder / FRONT) or record
        for one, record in zip(result.junctions, records, strict=True)
    )
    tables = {
        JUNCTION_TABLE: csv_text(_junction_table(result, records)).encode(),
        POLE_TABLE: csv_text(_frame(poles, _POLE_COLUMNS)).encode(),
        FRONTS: fronts_table(fronts),
    }
    (out / GEOPACKAGE).unlink(missing_ok=True)
    if city.roads[0].crs:
        tables[GEOPACKAGE] = to_city_geopackage(units, result.junctions, crs=city.crs)
    places = {one.folder: one.position_m for one in city.junctions}
    position = [places[one.folder.split("/", 1)[1]] for one in result.junctions]
    drawn = plot_city_map([*city.roads, *city.beside], position, result)
    front = plot_city_front(result)
    tables["map.png"] = to_png(drawn)
    tables["front.png"] = to_png(front)
    write_files(out, tables)
    paged = {one.folder for one in result.junctions if (out / one.folder / REPORT).exists()}
    report = render_city_report(result, drawn, front, poles=poles, paged=paged)
    result = msgspec.structs.replace(result, seconds=finish())
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
            "junction": one.id,
            "name": one.name,
            "year": one.year,
            "site": site,
            "kind": kinds.get(site, "unknown"),
            "units": len(units),
            **{key: units[0][key] for key in _POLE_COLUMNS[6:] if key in units[0]},
        }
        for site, units in at.items()
    ]


_SIZES = ("sites", "poses", "runs", "frames")


def _junction_table(result: CityResult, records: Sequence[CityFrontRecord]) -> Any:
    """A row for each junction: what it gets, how large its question was, and what that took."""
    columns = (
        *("id", "name", "map", "x", "y", "weight", "district", "units", "cost_eur", "year"),
        *("apr_before", "apr", "apr_one_failed", "reason", "folder"),
    )
    rows = [
        {name: getattr(one, name) for name in columns}
        | {name: getattr(record, name) for name in _SIZES}
        | {
            "cpu_s": round(sum(record.seconds.values()), 1),
            "peak_memory_mib": record.peak_memory_mib,
        }
        for one, record in zip(result.junctions, records, strict=True)
    ]
    return _frame(rows, (*columns, *_SIZES, "cpu_s", "peak_memory_mib"))


def _frame(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> Any:
    import pandas as pd

    return pd.DataFrame(rows, columns=list(columns))
