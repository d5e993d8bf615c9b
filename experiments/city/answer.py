"""A city's answer: the choice for each junction, its sentences, and the files it is in.

``junctions/ID/front.json`` says what a junction may get, ``city.json`` what each gets,
and ``manifest.json`` which city a folder is of.
"""

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from msgspec import Meta
from msgspec.structs import replace

from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError, refuse
from geometry.opening import read_bytes
from geometry.tables import read_table
from geometry.text_formats import parse_json
from placement.city.choose import Step, choose, city_front, plan_phases
from placement.city.fronts import (
    JunctionFront,
    Options,
    Point,
    stack_bounds,
    stack_fronts,
)
from placement.layout import Layout
from placement.optimiser.constants import TOLERANCE
from placement.recordings.files import json_of

from ..language import language, tr, trn
from ..results.numbers import euros, joined, percent, points
from ..results.record import Record, Share, StageRecord, UnitRecord, build_stage_records
from ..scene import CAUSES
from .inputs import (
    JUNCTIONS,
    PROXY,
    City,
    CityMapRecord,
    CitySearch,
    CityValues,
    CityWish,
)

SCHEMA = "place-rsus/city/1"
MANIFEST = "manifest.json"
SUMMARY = "city.json"
FRONT = "front.json"
FRONTS = "fronts.parquet"
_CHOICE_S = 120.0
_MAX_STEPS = 200
_OF_POINT = ("units", "cost_eur", "apr", "apr_one_failed")

_T = TypeVar("_T")
Count = Annotated[int, Meta(ge=0)]
Amount = Annotated[float, Meta(ge=0)]


class CityFrontRecord(Record, frozen=True, kw_only=True):
    """``front.json``: what a junction may get, or why there is nothing."""

    schema: str = SCHEMA
    # Hash of all that it was made from.
    key: str
    id: str
    # Streets that meet.
    name: str
    map: str
    scene: str
    # Why there is no front, as the program says it.
    reason: str = ""
    # The same as a kind of cause, where it is one of those foreseen.
    cause: str = ""
    # False where another try may end otherwise.
    is_final: bool = True
    front: JunctionFront | None = None
    layouts: tuple[
        tuple[UnitRecord, ...], ...
    ] = ()  # of each point, with the existing units
    sites: Count = 0
    poses: Count = 0
    runs: Count = 0
    # These, and those for which there is no room.
    possible_runs: Count = 0
    frames: Count = 0
    seconds: dict[str, float] = msgspec.field(
        default_factory=dict
    )  # processor time by stage
    peak_memory_mib: Amount
    notes: tuple[str, ...] = ()

    @property
    def points(self) -> tuple[Point, ...]:
        """Points of the front; none where there is no front."""
        if self.front is None:
            return ()
        return self.front.points

    def without_layouts(self) -> "CityFrontRecord":
        """A record without the parts that take memory: its layouts and notes."""
        return replace(self, layouts=(), notes=())


def load_front(path: Path) -> CityFrontRecord | None:
    """Read ``front.json``.

    None if there is none, or it is damaged: then it is made anew.
    """
    return _load(path, CityFrontRecord)


def load_summary(path: Path) -> "CityResult | None":
    """Read ``city.json``; None if there is none, or it is of another program."""
    return _load(path, CityResult)


def _load(path: Path, kind: type[_T]) -> _T | None:
    try:
        where = str(path)
        return read_table(parse_json(read_bytes(path), where, "a record"), kind, where)
    except (OSError, InputError):
        return None


def fronts_table(records: Iterable[CityFrontRecord]) -> bytes:
    """All fronts as Parquet.

    A row for each point, and one for each junction that has none.
    """
    import pandas as pd

    values = list(Point.__dataclass_fields__)
    rows = []
    for record in records:
        head = {"junction": record.id, "name": record.name, "map": record.map}
        layouts = record.layouts or ((),) * len(
            record.points
        )  # none: the file is damaged
        for point, layout in zip(record.points, layouts, strict=True):
            poses = " ".join(unit.id for unit in layout)
            rows.append(head | asdict(point) | {"layout": poses, "reason": ""})
        if not record.points:
            rows.append(
                head | dict.fromkeys(values) | {"layout": "", "reason": record.reason}
            )
    file = io.BytesIO()
    pd.DataFrame(rows).astype(dict.fromkeys(values, "float64")).to_parquet(file)
    return file.getvalue()


class CityEntry(Record, frozen=True, kw_only=True):
    """A junction's folder, and the hashes of what it was made from and of its front."""

    id: str
    map: str
    folder: str
    key: str
    sha256: str


class CityManifest(Record, frozen=True, kw_only=True):
    """``manifest.json``: which city a folder is of, and what has been computed.

    Attributes
    ----------
    maps : tuple of CityMapRecord
        Files and their hashes.
    crs : str
        Of `bounds`; empty: the maps' own.
    bounds : tuple of float
        West, south, east and north of the junctions.
    junctions : tuple of CityEntry
        Those that are done.
    """

    schema: str = SCHEMA
    maps: tuple[CityMapRecord, ...]
    # Of the bounds; empty: the maps' own.
    crs: str
    bounds: tuple[
        float, float, float, float
    ]  # west, south, east and north of all junctions
    junctions: tuple[CityEntry, ...] = ()


def load_manifest(path: Path) -> CityManifest:
    """Read ``manifest.json``; InputError if it is something else."""
    found = read_table(json_of(path), CityManifest, str(path))
    if found.schema != SCHEMA:
        raise InputError(f"{path}: schema", found.schema, SCHEMA)
    return found


class CityJunctionRecord(Record, frozen=True, kw_only=True):
    """A junction of the city, and what it gets."""

    id: str
    name: str
    map: str
    folder: str
    # In the map's own coordinates: longitude, or metres.
    x: float
    y: float
    # Its accidents, as a share of the city's.
    weight: Amount
    district: str = ""
    # Why it has no front, as the program says it.
    reason: str = ""
    # The same as a kind of cause, where it is one of those foreseen.
    cause: str = ""
    # New ones.
    units: Count = 0
    # Of these and their sites.
    cost_eur: Amount = 0.0
    # In which it is ready, from 1; 0: not known, or nothing.
    year: Count = 0
    # Of the existing units.
    apr_before: Share = 0.0
    apr: Share = 0.0
    # If the unit fails that is needed most.
    apr_one_failed: Share = 0.0
    # All units.
    layout: tuple[UnitRecord, ...] = ()
    # Existing ones among them.
    kept: Count = 0

    @property
    def label(self) -> str:
        """Name for people."""
        return self.name or self.id

    @property
    def gain(self) -> float:
        """Weighted accidents that the new units prevent."""
        return self.weight * (self.apr - self.apr_before)

    @property
    def why(self) -> str:
        """Why it has no front, in plain words."""
        if self.cause in CAUSES:
            return tr(CAUSES[self.cause])
        return tr("It could not be computed: {reason}.", reason=self.reason.rstrip("."))


class CityStepRecord(Record, frozen=True, kw_only=True):
    """A step of the city's front: a junction gets more."""

    junction: str
    # Of the junction.
    folder: str = ""
    # New ones at it from here on.
    units: Count
    # By all junctions together: EUR, or units.
    taken: Amount
    # Accidents prevented at all junctions together, by weight.
    apr: Share


class CityPurchaseRecord(Record, frozen=True, kw_only=True):
    """A line of what has to be ordered; its sum is 0 where no price is known."""

    part: Literal["sensor", "site"]
    # The sensor's model, or the kind of site.
    name: str
    count: Annotated[int, Meta(ge=1)]
    sum_eur: Amount


class CitySearchRecord(Record, frozen=True, kw_only=True):
    """How the fronts were searched for, see :class:`.inputs.CitySearch`."""

    poses: Literal["fine", "coarse"]
    max_units: Annotated[int, Meta(ge=1)]
    max_junction_seconds: float
    radius_m: float
    sites: str


class CityResult(Record, frozen=True, kw_only=True):
    """Result of ``place-rsus city``: ``city.json``, and the output of ``--json``."""

    schema: str = SCHEMA
    command: str = ""
    # Of its sentences and pages.
    language: str = "en"
    maps: tuple[CityMapRecord, ...]
    budget_units: int | None
    budget_eur: float | None
    # Their source, in words.
    weights: str
    # They were read from a file of accidents, not estimated or all alike.
    has_accidents: bool = False
    # What must not be overlooked.
    warnings: tuple[str, ...] = ()
    units: Count
    cost_eur: Amount
    # Of the existing units, by weight.
    apr_before: Share
    stages: tuple[StageRecord, ...]
    bound_of_fronts: (
        Share  # of the first stage, for all choices among the points of the fronts
    )
    solver: str
    is_proven: bool
    junctions: tuple[CityJunctionRecord, ...]
    # Junctions without a front.
    not_done: Count
    # At all junctions with a front.
    runs: Count = 0
    # These, and those for which there is no room.
    possible_runs: Count = 0
    # Fronts that this call has found.
    computed: Count = 0
    # Counted by the city's front.
    by: Literal["units", "cost"]
    front: tuple[CityStepRecord, ...]
    # Useful choice, in words.
    cheapest: str = ""
    # Gain times years of what is mounted earlier.
    gain_years: float | None = None
    # accidents, where it is known in how many years they were counted: of all
    # junctions, those prevented when all is mounted, and those prevented in the years
    # that were asked about
    accidents_per_year: Amount | None = None
    prevented_per_year: Amount | None = None
    prevented_in_years: Amount | None = None
    purchases: tuple[CityPurchaseRecord, ...] = ()
    search: CitySearchRecord
    sentences: tuple[str, ...] = ()
    not_counted: tuple[
        str, ...
    ] = ()  # junctions of the maps that were not asked about, and why
    notes: tuple[str, ...]
    seconds: dict[str, float] = msgspec.field(default_factory=dict)
    versions: dict[str, str] = msgspec.field(default_factory=dict)

    @property
    def is_proven_best(self) -> bool:
        """No choice prevents more."""
        return self.stages[0].gap == 0.0

    def of_all(self, name: str) -> float:
        """A share that each junction has, such as its APR, of all by weight."""
        return sum(one.weight * float(getattr(one, name)) for one in self.junctions)

    @property
    def of_what(self) -> str:
        """Of what a share is: "of the accidents" only where some were read."""
        if self.has_accidents:
            return tr("of the accidents")
        return tr("of the simulated collisions")

    @property
    def most_better(self) -> float:
        """How much more another choice could prevent at most, as a share of all."""
        apr = self.stages[0]
        bound = 1.0 if apr.bound is None else apr.bound
        done = sum(one.weight for one in self.junctions if not one.reason)
        return done * max(bound - apr.objective, 0.0)

    @property
    def map_names(self) -> str:
        """Names of the maps with roads, in words."""
        return joined([one.name for one in self.maps if one.has_roads])


def choose_for_city(
    out: Path,
    city: City,
    values: CityValues,
    done: dict[str, CityFrontRecord],
    *,
    wish: CityWish,
    search: CitySearch,
    existing: dict[str, Layout],
) -> CityResult:
    """Choose a point of each junction's front; `done` has the fronts by their folders.

    Raises InputError: no junction, or none with a weight, has a front; a wish cannot be
    met.
    """
    records = [done[one.folder] for one in city.junctions]
    solved = _solved(city, records, values)
    weight = values.weight[solved]
    fronts = [front for record in records if (front := record.front) is not None]
    options = stack_fronts(fronts)
    asked = values.wishes(wish, solved)
    by_cost = asked.budget_eur is not None
    by_units = asked.budget_units is not None
    choice = choose(
        options,
        weight,
        asked,
        bounds=stack_bounds(fronts, counts_units=by_units, counts_cost=by_cost),
        names=[city.junctions[index].label for index in solved],
        gap=search.gap,
        time_limit_s=_CHOICE_S,
    )
    first = np.flatnonzero(np.diff(options.junction, prepend=-1))
    share = weight / weight.sum()
    phases = None
    if wish.units_per_year is not None:
        phases = plan_phases(
            options.units[choice.rows],
            np.maximum(share * (options.apr[choice.rows] - options.apr[first]), 0.0),
            units_per_year=wish.units_per_year,
            years=wish.years,
        )
    if phases is None:
        years = np.zeros_like(first)
    else:
        years = phases.year
    got = zip((choice.rows - first).tolist(), years.tolist(), strict=True)
    got_at = dict(zip(solved, got, strict=True))
    junctions = [*_junctions(out, city, values, records, existing, got=got_at)]
    result = CityResult(
        language=language(),
        maps=city.records,
        budget_units=wish.budget_units,
        budget_eur=wish.budget_eur,
        weights=values.source,
        has_accidents=wish.has_accidents,
        warnings=says("warnings", wish, search, wish.weights_file == PROXY),
        units=sum(one.units for one in junctions),
        cost_eur=sum(one.cost_eur for one in junctions),
        apr_before=float(share @ options.apr[first]),
        stages=build_stage_records(choice.certificate),
        bound_of_fronts=choice.bound_of_points,
        solver=choice.certificate.solver,
        is_proven=choice.certificate.is_proven,
        junctions=tuple(junctions),
        not_done=len(records) - len(solved),
        runs=sum(records[index].runs for index in solved),
        possible_runs=sum(records[index].possible_runs for index in solved),
        by="cost" if by_cost else "units",
        front=_steps(
            city, solved, options, city_front(options, weight, by_cost=by_cost)
        ),
        gain_years=None if phases is None else phases.gain_years,
        search=CitySearchRecord(
            poses="coarse" if search.is_coarse else "fine",
            max_units=search.max_units,
            max_junction_seconds=search.max_junction_s,
            radius_m=search.radius_m,
            sites=search.sites,
        ),
        not_counted=city.notes,
        notes=(*city.notes, *values.notes),
    )
    cheapest = _cheapest(city, options, solved, share, first, of_what=result.of_what)
    yearly = _accidents(values, junctions, wish.years)
    result = replace(result, cheapest=cheapest, **yearly)
    head = " ".join([*says("head", result), *says("undone", result)])
    return replace(
        result, sentences=(head, *says("rest", result, wish, phases, TOLERANCE))
    )


def _steps(
    city: City, solved: Sequence[int], options: Options, steps: Sequence[Step]
) -> tuple[CityStepRecord, ...]:
    return tuple(
        CityStepRecord(
            junction=city.junctions[solved[step.junction]].label,
            folder=f"{JUNCTIONS}/{city.junctions[solved[step.junction]].folder}",
            units=int(options.units[step.row]),
            taken=step.taken,
            apr=step.apr,
        )
        for step in steps[:_MAX_STEPS]
    )


def _accidents(
    values: CityValues, junctions: Sequence[CityJunctionRecord], years: int | None
) -> dict[str, float]:
    """Accidents in a year, and those prevented.

    In a year, and in the years asked about.
    """
    if values.per_year is None:
        return {}
    prevented = values.per_year * [one.apr - one.apr_before for one in junctions]
    found = {
        "accidents_per_year": float(values.per_year.sum()),
        "prevented_per_year": float(prevented.sum()),
    }
    if years is None:
        return found
    # A junction prevents from the year on in which its last unit is mounted.
    there = [max(years + 1 - max(one.year, 1), 0) for one in junctions]
    return found | {"prevented_in_years": float(prevented @ there)}


def _junctions(
    out: Path,
    city: City,
    values: CityValues,
    records: Sequence[CityFrontRecord],
    existing: dict[str, Layout],
    *,
    got: Mapping[int, tuple[int, int]],
) -> Iterator[CityJunctionRecord]:
    """All junctions; those with a front with the point that was chosen.

    Its number and year.

    Layouts are read from the folder.
    """
    for index, (one, record) in enumerate(zip(city.junctions, records, strict=True)):
        gets: dict[str, Any] = {}
        if record.front is not None and index in got:
            number, year = got[index]
            point = record.front.points[number]
            layout: tuple[UnitRecord, ...] = ()
            if point.units or one.scene_name in existing:
                path = out / JUNCTIONS / one.folder / FRONT
                found = load_front(path)
                if found is None or number >= len(found.layouts):
                    refuse(str(path), "a file that has changed", "what was written")
                layout = found.layouts[number]
            gets = {name: getattr(point, name) for name in _OF_POINT}
            gets |= {"apr_before": record.front.points[0].apr, "year": year}
            gets |= {"layout": layout, "kept": max(len(layout) - point.units, 0)}
        x, y = one.surveyed.position.tolist()
        yield CityJunctionRecord(
            id=one.surveyed.junction.id,
            name=one.surveyed.junction.name,
            map=one.roads.name,
            folder=f"{JUNCTIONS}/{one.folder}",
            x=x,
            y=y,
            weight=float(values.weight[index] / values.weight.sum()),
            district=", ".join(
                name for name, members in values.districts if index in members
            ),
            reason=record.reason,
            cause=record.cause,
            **gets,
        )


def _solved(
    city: City, records: Sequence[CityFrontRecord], values: CityValues
) -> list[int]:
    """Indices of the junctions that have a front.

    InputError if none has, or none with a weight.
    """
    solved = [index for index, record in enumerate(records) if not record.reason]
    if not solved:
        # One that another try could mend says what to change.
        failed = min(records, key=lambda record: record.is_final)
        refuse(
            city.records[0].name,
            f"no junction with a front; {failed.name or failed.id}: {failed.reason}",
            (
                "one at which runs can be laid and sites can carry units"
                if failed.is_final
                else (
                    "more time or memory for each: --max-junction-seconds,"
                    " --worker-memory"
                )
            ),
        )
    if not values.weight[solved].sum() > 0.0:
        got = "weights only of junctions that have no front"
        refuse("--junction-weights", got, "a weight above 0 for one that has")
    return solved


def _cheapest(
    city: City,
    options: Options,
    solved: Sequence[int],
    share: FloatArray,
    first: IntArray,
    *,
    of_what: str,
) -> str:
    """Cost and benefit of the cheapest useful option, in words."""
    gain = share[options.junction] * (
        options.apr - options.apr[first][options.junction]
    )
    useful = np.flatnonzero(gain > TOLERANCE)
    if not len(useful):
        return says("cheapest", 0, "", 0.0, 0.0, of_what)[0]
    order = np.lexsort((-gain[useful], options.units[useful], options.cost_eur[useful]))
    best = int(useful[order[0]])
    label = city.junctions[solved[int(options.junction[best])]].label
    sizes = int(options.units[best]), float(options.cost_eur[best]), float(gain[best])
    return says("cheapest", sizes[0], label, *sizes[1:], of_what)[0]


@cache
def _templates() -> Any:
    loader = PackageLoader(__package__, "")
    words = {
        "tr": tr,
        "trn": trn,
        "percent": percent,
        "points": points,
        "euros": euros,
    }
    environment = Environment(
        loader=loader, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("sentences.txt.j2", globals=words).module


def says(macro: str, *values: object) -> tuple[str, ...]:
    """Sentences of a macro of ``sentences.txt.j2`` in the spoken language."""
    lines = str(getattr(_templates(), macro)(*values)).splitlines()
    return tuple(line for line in map(str.strip, lines) if line)
