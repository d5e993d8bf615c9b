"""What a city's folder holds beside the fronts: layouts, what to order, tables, map, report."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from geometry.catalogue import Sensor
from geometry.scene import Scene
from geometry.scene_files import load_scene_folder
from placement.layout import Layout, layout_from_records
from placement.question import Question, save_question

from ..export.city import to_city_geopackage
from ..export.json import to_json, to_json_text
from ..export.places import placed_records
from ..figures.axes import to_png
from ..figures.city import plot_city_front, plot_city_map
from ..report.bill_of_materials import build_bill
from ..report.city import render_city_report, render_junction_page
from ..results.city import (
    FRONTS,
    JUNCTIONS,
    SUMMARY,
    CityFrontRecord,
    CityJunctionRecord,
    CityPurchaseRecord,
    CityResult,
    fronts_table,
)
from ..results.csv_text import csv_text
from ..results.folders import LAYOUT_FILE, write_files, write_manifest
from ..results.record import to_plain
from .city_inputs import City

REPORT, GEOPACKAGE, QUESTION = "report.html", "city.gpkg", "question.toml"
JUNCTION_TABLE, POLE_TABLE = "junctions.csv", "poles.csv"


def complete_result(
    out: Path,
    result: CityResult,
    *,
    question: Question,
    kept: Mapping[str, Layout],
    sensors: Mapping[str, Sensor],
) -> CityResult:
    """A result with what has to be ordered."""
    count: Counter[tuple[str, str]] = Counter()
    cost: Counter[tuple[str, str]] = Counter()
    for one in result.junctions:
        if not one.units:
            continue
        scene = load_scene_folder(out / one.folder)
        layout = junction_layout(one, scene, sensors)
        names = [unit.id for unit in layout.units]
        bill = build_bill(
            layout,
            scene,
            site_cost_eur=question.site_cost_eur,
            kept_ids=_kept_ids(one, kept, names),
        )
        for item in (*bill.sensors, *bill.sites):
            if item.count:
                key = (item.part, item.name if item.part == "sensor" else item.kind)
                count[key] += item.count
                cost[key] += round(100.0 * (item.sum_eur or 0.0))  # cents
    return msgspec.structs.replace(
        result,
        purchases=tuple(
            CityPurchaseRecord(part=key[0], name=key[1], count=n, sum_eur=cost[key] / 100.0)  # type: ignore[arg-type]
            for key, n in count.most_common()
        ),
    )


def _kept_ids(
    one: CityJunctionRecord, kept: Mapping[str, Layout], names: Sequence[str]
) -> list[str]:
    """Units that hang there already: their ids are their own."""
    stem = f"{Path(one.map).stem}/{one.id}"
    return [unit.id for unit in kept[stem].units if unit.id in names] if stem in kept else []


def junction_layout(one: CityJunctionRecord, scene: Scene, sensors: Mapping[str, Sensor]) -> Layout:
    """The units that a junction gets, with those that hang there."""
    layout = layout_from_records(
        f"city-{len(one.layout)}",
        [to_plain(unit) for unit in one.layout],
        one.folder,
        sensors=sensors,
    )
    return replace(layout, scene_name=scene.name)


def write_city(
    out: Path,
    result: CityResult,
    city: City,
    records: Sequence[CityFrontRecord],
    *,
    sensors: Mapping[str, Sensor],
    question: Question,
) -> None:
    """Write all that is known of a city; the hashes of all files come last."""
    units: list[dict[str, Any]] = []
    poles: list[dict[str, Any]] = []
    for name in (LAYOUT_FILE, REPORT):  # of an earlier choice, maybe among other junctions
        for path in (out / JUNCTIONS).glob(f"*/{name}"):
            path.unlink()
    for one, record in zip(result.junctions, records, strict=True):
        folder = out / one.folder
        if record.reason or not one.layout:
            continue
        scene = load_scene_folder(folder)
        layout = junction_layout(one, scene, sensors)
        page = render_junction_page(one, record, scene, layout, question=QUESTION)
        save_question(folder / QUESTION, question)
        write_files(folder, {REPORT: page.encode(), LAYOUT_FILE: to_json(layout, scene).encode()})
        head = {"junction": one.id, "name": one.name, "year": one.year}
        placed = [head | unit for unit in placed_records(layout, scene)]
        units += placed
        poles += _poles(one, scene, placed)
    tables = {
        JUNCTION_TABLE: csv_text(_junction_table(result, records)).encode(),
        POLE_TABLE: csv_text(_frame(poles, _POLE_COLUMNS)).encode(),
        FRONTS: fronts_table(records),
        SUMMARY: to_json_text(result).encode(),
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
    tables[REPORT] = render_city_report(result, drawn, front, poles=poles).encode()
    write_files(out, tables)
    write_manifest(out)


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
