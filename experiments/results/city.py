"""Results of ``place-rsus city``: fronts of junctions, what each gets, and the folder's list."""

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from geometry.errors import InputError, Unquoted
from geometry.files import read_bytes
from placement.city.fronts import JunctionFront, Point
from placement.city.junction import SolvedJunction

from .record import Record, Share, StageRecord, UnitRecord, build_unit_records, says

SCHEMA = "place-rsus/city/1"
MANIFEST, SUMMARY = "manifest.json", "city.json"
FRONT = "front.json"
FRONTS = "fronts.parquet"
JUNCTIONS = "junctions"

# ---------- one junction


class CityPointRecord(Record, frozen=True, kw_only=True):
    """A layout that a junction may get."""

    units: Annotated[int, says("New units.", ge=0)]
    cost_eur: Annotated[float, says("Of these and their sites, in EUR.", ge=0)]
    apr: Annotated[Share, says("APR on the detection table, with what hangs there already.")]
    apr_one_failed: Annotated[Share, says("APR if the unit that is needed most fails.")]
    smallest_margin_s: Annotated[float, says("Smallest time to spare, in seconds.")]
    mean_margin_s: Annotated[float, says("Mean time to spare, in seconds.")]
    layout: Annotated[tuple[UnitRecord, ...], says("All units, with those that hang there.")]

    def to_point(self) -> Point:
        """The point of the front."""
        return Point(**{name: getattr(self, name) for name in _POINT})


_POINT = (
    *("units", "cost_eur", "apr", "apr_one_failed"),
    *("smallest_margin_s", "mean_margin_s"),
)


class CityFrontRecord(Record, frozen=True, kw_only=True):
    """``front.json``: what a junction may get, or why there is nothing."""

    schema: Annotated[str, says("Name and version of the file's format.")] = SCHEMA
    key: Annotated[str, says("Hash of all that it was made from.")]
    id: Annotated[str, says("Of the junction, in its map.")]
    name: Annotated[str, says("Streets that meet.")]
    map: Annotated[str, says("File that has it.")]
    scene: Annotated[str, says("Name of its scene.")]
    reason: Annotated[str, says("Why there is no front; empty: there is one.")]
    is_final: Annotated[
        bool,
        says("Whether another try would say the same; not where a worker died, or time was up."),
    ] = True
    points: Annotated[tuple[CityPointRecord, ...], says("The first takes nothing.")]
    by_units: Annotated[
        tuple[tuple[float, float], ...],
        says("From so many new units on, no layout has a higher APR, up to the next."),
    ]
    by_cost: Annotated[
        tuple[tuple[float, float], ...],
        says("From so many EUR on, no layout has a higher APR, up to the next."),
    ]
    sites: Annotated[int, says("Mount sites.", ge=0)]
    poses: Annotated[int, says("Candidate poses.", ge=0)]
    runs: Annotated[int, says("Runs.", ge=0)]
    frames: Annotated[int, says("Frames of these.", ge=0)]
    seconds: Annotated[dict[str, float], says("Processor time by stage, in seconds.")]
    peak_memory_mib: Annotated[
        float, says("Most memory that the worker has had so far, in MiB.", ge=0)
    ]
    notes: Annotated[tuple[str, ...], says("What was left out or assumed of the maps.")] = ()

    @property
    def front(self) -> JunctionFront:
        """The front."""
        return JunctionFront(
            points=tuple(point.to_point() for point in self.points),
            by_units=self.by_units,
            by_cost=self.by_cost,
        )


def build_points(solved: SolvedJunction) -> tuple[CityPointRecord, ...]:
    """The points of a junction's front with their layouts."""
    return tuple(
        CityPointRecord(
            **{name: getattr(point, name) for name in _POINT},
            layout=() if layout is None else build_unit_records(layout),
        )
        for point, layout in zip(solved.front.points, solved.layouts, strict=True)
    )


def load_front(path: Path) -> CityFrontRecord | None:
    """Read ``front.json``; None if there is none, or it is damaged: then it is made anew."""
    try:
        return msgspec.json.decode(read_bytes(path), type=CityFrontRecord)
    except (InputError, msgspec.DecodeError, UnicodeDecodeError):
        return None


def without_layouts(record: CityFrontRecord) -> CityFrontRecord:
    """A front without what takes memory: its layouts and notes."""
    points = tuple(msgspec.structs.replace(point, layout=()) for point in record.points)
    return msgspec.structs.replace(record, points=points, notes=())


def fronts_table(records: Iterable[CityFrontRecord]) -> bytes:
    """All fronts as Parquet: a row for each point, and one for each junction that has none."""
    import pandas as pd

    rows = []
    for record in records:
        head = {"junction": record.id, "name": record.name, "map": record.map}
        for point in record.points:
            values = {name: getattr(point, name) for name in _POINT}
            poses = " ".join(unit.id for unit in point.layout)
            rows.append(head | values | {"layout": poses, "reason": ""})
        if not record.points:
            rows.append(head | dict.fromkeys(_POINT) | {"layout": "", "reason": record.reason})
    file = io.BytesIO()
    pd.DataFrame(rows).astype(dict.fromkeys(_POINT, "float64")).to_parquet(file)
    return file.getvalue()


# ---------- the folder


class CityMapRecord(Record, frozen=True, kw_only=True):
    """A map of the city."""

    name: str
    sha256: str
    has_roads: bool


class CityEntry(Record, frozen=True, kw_only=True):
    """A junction's folder, and what it was made from."""

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
    crs: str
    bounds: tuple[float, float, float, float]
    junctions: tuple[CityEntry, ...] = ()


def load_manifest(path: Path) -> CityManifest:
    """Read ``manifest.json``; InputError if it is something else."""
    data = read_bytes(path)
    try:
        found = msgspec.json.decode(data, type=CityManifest)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(str(path), Unquoted(error), "a manifest of place-rsus city") from None
    if found.schema != SCHEMA:
        raise InputError(f"{path}: schema", found.schema, SCHEMA)
    return found


# ---------- the answer


class CityJunctionRecord(Record, frozen=True, kw_only=True):
    """A junction of the city, and what it gets."""

    id: Annotated[str, says("In its map.")]
    name: Annotated[str, says("Streets that meet.")]
    map: Annotated[str, says("File that has it.")]
    folder: Annotated[str, says("With its scene and front, in the city's folder.")]
    x: Annotated[float, says("In the map's own coordinates: longitude, or metres east.")]
    y: Annotated[float, says("Latitude, or metres north.")]
    weight: Annotated[float, says("Of its accidents among those of the city.", ge=0)]
    district: Annotated[str, says("That it lies in; empty: none.")] = ""
    reason: Annotated[str, says("Why it has no front; empty: it has.")] = ""
    units: Annotated[int, says("New units that it gets.", ge=0)] = 0
    cost_eur: Annotated[float, says("Of these and their sites, in EUR.", ge=0)] = 0.0
    year: Annotated[int, says("In which it is ready, from 1; 0: not known, or nothing.")] = 0
    apr_before: Annotated[Share, says("APR of what hangs there already.")] = 0.0
    apr: Annotated[Share, says("APR with what it gets.")] = 0.0
    apr_one_failed: Annotated[Share, says("APR if the unit that is needed most fails.")] = 0.0
    layout: Annotated[tuple[UnitRecord, ...], says("All units, with those that hang there.")] = ()
    kept: Annotated[int, says("Units that hang there already.", ge=0)] = 0

    @property
    def label(self) -> str:
        """Name for people."""
        return self.name or self.id

    @property
    def gain(self) -> float:
        """Weighted accidents that the new units prevent."""
        return self.weight * (self.apr - self.apr_before)


class CityStepRecord(Record, frozen=True, kw_only=True):
    """A step of the city's front: a junction gets more."""

    junction: Annotated[str, says("That gets more.")]
    units: Annotated[int, says("New units that it has from here on.", ge=0)]
    taken: Annotated[float, says("By all junctions together: EUR, or units.", ge=0)]
    apr: Annotated[Share, says("Accidents prevented at all junctions together, by weight.")]


class CityPurchaseRecord(Record, frozen=True, kw_only=True):
    """A line of what has to be ordered."""

    part: Annotated[Literal["sensor", "site"], says("What it is.")]
    name: Annotated[str, says("The sensor's model, or the kind of site.")]
    count: Annotated[int, says("To buy, or to make ready.", ge=1)]
    sum_eur: Annotated[float, says("Of all of them, in EUR; 0: no price is known.", ge=0)]


class CitySearchRecord(Record, frozen=True, kw_only=True):
    """How the fronts were looked for."""

    poses: Annotated[Literal["fine", "coarse"], says("Poses at each site.")]
    max_units: Annotated[int, says("Most new units at a junction.", ge=1)]
    max_junction_seconds: Annotated[float, says("Time for each junction, in seconds.")]
    radius_m: Annotated[float, says("Of what is kept around a junction, in metres.")]
    sites: Annotated[str, says("Where sensors may hang.")]


class CityResult(Record, frozen=True, kw_only=True):
    """What ``place-rsus city`` finds: ``city.json``, and what ``--json`` prints."""

    schema: str = SCHEMA
    command: str
    maps: Annotated[tuple[CityMapRecord, ...], says("Files.")]
    budget_units: Annotated[int | None, says("New units at most.")]
    budget_eur: Annotated[float | None, says("Money at most, in EUR.")]
    weights: Annotated[str, says("Where the weights of the junctions come from, in words.")]
    units: Annotated[int, says("New units that are mounted.", ge=0)]
    cost_eur: Annotated[float, says("Of these and their sites, in EUR.", ge=0)]
    apr_before: Annotated[Share, says("Accidents prevented by what hangs there, by weight.")]
    stages: Annotated[tuple[StageRecord, ...], says("What was optimised, in order.")]
    bound_of_fronts: Annotated[
        Share, says("What no choice among the points of the fronts exceeds in the first stage.")
    ]
    solver: Annotated[str, says("What the proof rests on.")]
    is_proven: Annotated[bool, says("Whether the gaps of all stages are closed.")]
    junctions: Annotated[tuple[CityJunctionRecord, ...], says("What each gets.")]
    not_done: Annotated[int, says("Junctions that have no front.", ge=0)]
    computed: Annotated[int, says("Junctions whose fronts this call has computed.", ge=0)]
    by: Annotated[Literal["units", "cost"], says("What the city's front counts.")]
    front: Annotated[tuple[CityStepRecord, ...], says("Who joins at each step.")]
    cheapest: Annotated[
        str, says("What the cheapest useful unit costs and buys, where the budget buys none.")
    ] = ""
    gain_years: Annotated[float | None, says("Gain times years of what is mounted earlier.")] = None
    purchases: Annotated[tuple[CityPurchaseRecord, ...], says("What has to be ordered.")]
    search: Annotated[CitySearchRecord, says("How the fronts were looked for.")]
    sentences: Annotated[tuple[str, ...], says("What matters, in words.")]
    notes: Annotated[tuple[str, ...], says("What was left out or assumed.")]
    seconds: dict[str, float]
    versions: dict[str, str]


def load_summary(path: Path) -> CityResult | None:
    """Read ``city.json``; None if there is none, or it is of another program."""
    try:
        return msgspec.json.decode(read_bytes(path), type=CityResult)
    except (OSError, InputError, msgspec.DecodeError, UnicodeDecodeError):
        return None
