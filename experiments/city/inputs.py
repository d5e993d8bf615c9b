"""Inputs of a city question.

Maps, junctions, weights, areas, and units mounted already.
"""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted, refuse
from geometry.frames import transform
from geometry.maps import importing
from geometry.maps.elsewhere import check_maps_lie_here
from geometry.maps.place_lists import areas_of, read_areas, read_counts, snap
from geometry.maps.source_map import SourceMap
from geometry.opening import read_text
from geometry.text_formats import load_data
from placement.city.choose import CityWishes, District
from placement.layout import Layout, load_layout

from ..language import tr
from ..results.folders import LAYOUT_FILE, sha256
from ..results.record import Record

JUNCTIONS = "junctions"
"""Folder of a city's junctions, and their layer in its GeoPackage."""

PROXY = Path("proxy")
"""In place of a file of counts: an estimate by roads, lanes and signals."""

# Two junctions of different maps that are one.
_SAME_M = 15.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CityWish:
    """Budget of a city, weights of junctions, and what has to be reached."""

    # New ones, at most.
    budget_units: int | None = None
    # For these and their sites, at most.
    budget_eur: float | None = None
    # Areas in which junctions count.
    within: Path | None = None
    # ids or names with semicolons between, or a file with one a line
    junctions: str = ""
    min_arms: int = 3
    signals_only: bool = False
    # counts: geometry.maps.place_lists.read_counts; or PROXY
    weights_file: Path | None = None
    weight_column: str = ""
    # in which the accidents of `weights_file` happened
    counted_years: float | None = None
    # From a place that counts to its junction, at most.
    snap_m: float = 50.0
    # Areas that each reach `min_district_apr`.
    districts: Path | None = None
    min_district_apr: float = 0.0
    # with columns "weight" (a factor) or "min_apr" (of each junction)
    areas: Path | None = None
    # A junction belongs to such an area if it is no farther away.
    near_m: float = 0.0
    keep: tuple[
        Path, ...
    ] = ()  # layouts, or folders of a city, of the units mounted already
    units_per_year: int | None = None
    # That money is for, and in which everything is mounted.
    years: int | None = None

    def __post_init__(self) -> None:
        for name, other in _TOGETHER.items():
            value = getattr(self, name)
            if value and not getattr(self, other):
                raise InputError(name, value, f"`{other}` as well")
        if self.years and not (self.units_per_year or self.counted_years):
            raise InputError(
                "years", self.years, "`units_per_year` or `counted_years` as well"
            )
        for name in ("weight_column", "counted_years"):
            if self.weights_file == PROXY and getattr(self, name):
                raise InputError(
                    name, getattr(self, name), "a file of --junction-weights"
                )

    @property
    def has_accidents(self) -> bool:
        """True if weights are accidents, not traffic, estimated, or all alike.

        Points that are counted one by one are accidents. A column may be traffic as
        well, unless it was counted in some years.
        """
        if self.weights_file in (None, PROXY):
            return False
        return not self.weight_column or self.counted_years is not None


# Wishes that need another one.
_TOGETHER = {
    "min_district_apr": "districts",
    "districts": "min_district_apr",
    "weight_column": "weights_file",
    "counted_years": "weights_file",
}


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
    sites_crs : str
        Of x and y in a list of sites that does not say.
    reading : ReadingOptions
        What map files do not say of themselves.
    gap : float
        Relative gap at which the city's choice counts as settled.
    """

    # A ninth of the poses.
    is_coarse: bool = False
    # New ones at a junction.
    max_units: int = 6
    max_junction_s: float = 300.0
    radius_m: float = importing.DEFAULT_RADIUS_M
    sites: str = "auto"
    sites_crs: str = ""
    reading: importing.ReadingOptions = field(default_factory=importing.ReadingOptions)
    # Relative, at which the city's choice counts as settled.
    gap: float = 0.0


class CityMapRecord(Record, frozen=True, kw_only=True):
    """A map of the city."""

    name: str
    sha256: str
    has_roads: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CityJunction:
    """A junction that counts, the map with its roads, and the name of its folder.

    Its position, (2,) float, is in the coordinates of the first map with roads. [m]
    """

    surveyed: importing.Surveyed
    roads: SourceMap
    folder: str
    position_m: FloatArray

    @property
    def scene_name(self) -> str:
        """Name of its scene."""
        return f"{Path(self.roads.name).stem}/{self.surveyed.junction.id}"

    @property
    def label(self) -> str:
        """Name for people."""
        return self.surveyed.junction.name or self.surveyed.junction.id


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class City:
    """Maps with and without roads, their files, and the junctions that count.

    The largest junction comes first.

    `n_all` counts all junctions of the maps; `bounds` are their west, south, east and
    north, in the coordinates of the first map's file; `notes` say what was left out.
    """

    roads: tuple[SourceMap, ...]
    others: tuple[SourceMap, ...]
    records: tuple[CityMapRecord, ...]
    junctions: tuple[CityJunction, ...]
    n_all: int
    bounds: tuple[float, float, float, float]
    notes: tuple[str, ...]

    @property
    def crs(self) -> str:
        """Coordinate reference system of the first map's file."""
        return self.roads[0].source_crs or self.roads[0].crs


def load_city(
    paths: Sequence[Path], reading: importing.ReadingOptions, wish: CityWish
) -> City:
    """Read maps once, and find the junctions that count.

    Raises InputError: a file cannot be read, none has roads, two have the same name or
    overlap, or no junction counts.
    """
    if not paths:
        refuse("MAP", "nothing", "a map: OpenDRIVE or OpenStreetMap")
    names = [path.name for path in paths]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        refuse("MAP", f"two files called {twice[0]}", "each map once")
    maps = [importing.read_map(path, reading) for path in paths]
    roads = tuple(source for source in maps if source.lanes)
    if not roads:
        refuse(", ".join(names), "no roads", "a map with roads")
    check_maps_lie_here(maps)
    records = tuple(
        CityMapRecord(
            name=source.name, sha256=sha256(path), has_roads=bool(source.lanes)
        )
        for source, path in zip(maps, paths, strict=True)
    )
    found: list[CityJunction] = []
    for source in roads:
        for surveyed in importing.survey_junctions(source):
            place = surveyed.junction.position_m
            if source.crs != roads[0].crs:
                if not (source.crs and roads[0].crs):
                    got = f"coordinates unlike those of {roads[0].name}"
                    expected = (
                        "maps that all say where on earth they lie, or none of them"
                    )
                    refuse(source.name, got, expected)
                place = transform(place, source.crs, roads[0].crs)
            folder = _folder_name(
                source.name if len(roads) > 1 else "", surveyed.junction.id
            )
            found.append(
                CityJunction(
                    surveyed=surveyed, roads=source, folder=folder, position_m=place
                )
            )
    if not found:
        refuse(", ".join(s.name for s in roads), "no junction", "some")
    _refuse_overlap(found)
    chosen, notes = _counting(found, roads[0], wish)
    places = np.array(
        [one.surveyed.position for one in found if one.roads.crs == roads[0].crs]
    )
    return City(
        roads=roads,
        others=tuple(source for source in maps if not source.lanes),
        records=records,
        junctions=tuple(chosen),
        n_all=len(found),
        bounds=(*places.min(axis=0).tolist(), *places.max(axis=0).tolist()),
        notes=tuple(notes),
    )


def _folder_name(map_name: str, junction_id: str) -> str:
    """A name for a folder.

    Ids that had to be changed, or are long, have a hash behind them.
    """
    if map_name:
        name = f"{Path(map_name).stem}-{junction_id}"
    else:
        name = junction_id
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:60] or "junction"
    if plain == name:
        return plain
    return f"{plain}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def _refuse_overlap(found: Sequence[CityJunction]) -> None:
    from scipy.spatial import cKDTree

    places = np.array([one.position_m for one in found])
    for one, other in sorted(cKDTree(places).query_pairs(_SAME_M)):
        first = found[one]
        second = found[other]
        if first.roads is not second.roads:
            got = f"maps that overlap: both have a junction at {first.label}"
            expected = "maps of different places"
            refuse(f"{first.roads.name} and {second.roads.name}", got, expected)


def _counting(
    found: Sequence[CityJunction], roads: SourceMap, wish: CityWish
) -> tuple[list[CityJunction], list[str]]:
    """Junctions that count, and how many do not, and why."""
    left = list(found)
    notes = []
    if wish.within is not None:
        areas = read_areas(wish.within, crs=roads.crs)
        hits = areas_of(areas, np.array([one.position_m for one in left]))
        left = [one for one, hit in zip(left, hits, strict=True) if hit]
        if not left:
            expected = f"an area with some of the {len(found)} junctions"
            raise InputError("--within", str(wish.within), expected)
        n_outside = len(found) - len(left)
        notes.append(
            tr("Junctions outside {file}: {n}.", file=wish.within.name, n=n_outside)
        )
    if wish.junctions:
        named = _named(left, roads, wish.junctions)
        return named, [
            *notes,
            tr("Junctions not named: {n}.", n=len(left) - len(named)),
        ]
    large = [one for one in left if len(one.surveyed.arms) >= wish.min_arms]
    lit = [one for one in large if one.surveyed.n_signals or not wish.signals_only]
    for few, all_of_them, said in (
        (large, left, tr("Junctions with fewer than {n} arms", n=wish.min_arms)),
        (lit, large, tr("Junctions without traffic lights")),
    ):
        if len(few) < len(all_of_them):
            notes.append(f"{said}: {len(all_of_them) - len(few)}.")
    if not lit:
        refuse(roads.name, "no junction that counts: " + " ".join(notes), "some")
    return lit, notes


def _named(
    found: Sequence[CityJunction], roads: SourceMap, text: str
) -> list[CityJunction]:
    names = text.split(";")
    if Path(text).is_file():
        names = read_text(Path(text), "a list of junctions").splitlines()
    by_survey = {id(one.surveyed): one for one in found}
    chosen: dict[int, CityJunction] = {}
    for name in filter(None, map(str.strip, names)):
        try:
            surveyed = importing.choose_junction(
                roads, [one.surveyed for one in found], name=name
            )
        except InputError as error:
            raise InputError("--junctions", error.got, error.expected) from None
        chosen[id(surveyed)] = by_survey[id(surveyed)]
    if not chosen:
        raise InputError("--junctions", text, "ids or names, or a file with one a line")
    return list(chosen.values())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CityValues:
    """Weights of junctions, their source, and what has to be reached."""

    # (n,): not all 0; 0: nothing is asked.
    weight: FloatArray
    source: str
    # (n,).
    least_apr: FloatArray
    # Names and junctions.
    districts: tuple[tuple[str, tuple[int, ...]], ...]
    # Rows and districts that were not used.
    notes: tuple[str, ...]
    # (n,): accidents, where it is known in how many years
    per_year: FloatArray | None = None

    def wishes(self, wish: CityWish, solved: Sequence[int]) -> CityWishes:
        """The wishes for the junctions that have a front, by their indices."""
        place = {index: row for row, index in enumerate(solved)}
        districts = []
        least_apr = wish.min_district_apr
        for name, members in self.districts:
            rows = np.array(
                [place[index] for index in members if index in place], dtype=np.int64
            )
            if len(rows) and self.weight[list(members)].sum() > 0.0:
                districts.append(
                    District(name=name, junctions=rows, least_apr=least_apr)
                )
        limit = wish.budget_units
        if wish.units_per_year is not None and wish.years is not None:
            most = wish.units_per_year * wish.years
            if limit is None:
                limit = most
            else:
                limit = min(limit, most)
        return CityWishes(
            budget_units=limit,
            budget_eur=wish.budget_eur,
            districts=tuple(districts),
            least_apr=self.least_apr[list(solved)],
        )


def load_values(city: City, wish: CityWish) -> CityValues:
    """Weights, areas and districts of a city's junctions.

    Raises InputError: a file cannot be read, or nothing of it is at the junctions.
    """
    places = np.array([one.position_m for one in city.junctions])
    crs = city.roads[0].crs
    weight = np.ones(len(places))
    source = tr("every junction counts the same")
    notes = []
    if wish.weights_file == PROXY:
        weight = np.array([estimated_accidents(one.surveyed) for one in city.junctions])
        source = tr("estimated from road class, number of lanes and traffic lights")
        roads = [name for one in city.junctions for name, _ in one.surveyed.roads]
        if "" in roads:
            notes.append(
                tr(
                    "The map does not give the class of every road: without a class,"
                    " only lanes count."
                )
            )
    elif wish.weights_file is not None:
        weight, source, more = _weights(city, wish.weights_file, wish, places)
        notes += more
    if wish.counted_years:
        per_year = weight / wish.counted_years
    else:
        per_year = None
    least = np.zeros(len(places))
    if wish.areas is not None:
        areas = read_areas(wish.areas, crs=crs)
        columns = {name for area in areas for name in area.values}
        if not columns & {"weight", "min_apr"}:
            known = ", ".join(sorted(columns)) or "none"
            refuse(f"{wish.areas}: columns", known, "weight or min_apr, or both")
        for index, hits in enumerate(areas_of(areas, places, within_m=wish.near_m)):
            for hit in hits:
                area = areas[hit]
                weight[index] *= _number(area.values, area.where, "weight", 1.0)
                floor = _number(area.values, area.where, "min_apr", 0.0)
                least[index] = max(least[index], floor)
    districts: list[tuple[str, tuple[int, ...]]] = []
    if wish.districts is not None:
        areas = read_areas(wish.districts, crs=crs)
        inside = areas_of(areas, places)
        for number, area in enumerate(areas):
            members = tuple(index for index, hit in enumerate(inside) if number in hit)
            if members:
                districts.append((area.name, members))
            else:
                notes.append(tr("District {name} has no junction.", name=area.name))
        if not districts:
            raise InputError(
                "--districts", str(wish.districts), "areas with junctions in them"
            )
    if not weight.sum() > 0.0:
        refuse("--junction-weights", "only zeros", "a weight above 0")
    return CityValues(
        weight=weight,
        source=source,
        least_apr=least,
        districts=tuple(districts),
        notes=tuple(notes),
        per_year=per_year,
    )


def estimated_accidents(surveyed: importing.Surveyed) -> float:
    """Accidents at a junction in a year, by its roads and signals.

    To compare it with others.

    Formula, coefficients and traffic by class:
    ``experiments/data/junction_accidents.toml``.
    """
    table = load_data("experiments", "junction_accidents.toml")
    per_lane = table["vehicles_per_day_and_lane"]
    flows = sorted(
        (
            n_lanes * per_lane.get(name.removesuffix("_link"), per_lane["unknown"])
            for name, n_lanes in surveyed.roads
        ),
        reverse=True,
    )
    if not flows:
        return 0.0
    if len(flows) <= 3:
        kind = "3 arms"
    else:
        kind = "4 arms"
    model = table["model"][f"{kind}, signals" if surveyed.n_signals else kind]
    # The two busiest arms are those of the major road.
    major = max(flows[0], 1)
    minor = max(flows[min(2, len(flows) - 1)], 1)
    return float(np.exp(model["a"]) * major ** model["b"] * minor ** model["c"])


def _weights(
    city: City, path: Path, wish: CityWish, places: FloatArray
) -> tuple[FloatArray, str, list[str]]:
    """Weights, their source in words, and notes on what was not used."""
    counts = read_counts(path, crs=city.roads[0].crs, column=wish.weight_column)
    weight = np.zeros(len(places))
    said = {"file": path.name, "column": counts.column, "snap_m": wish.snap_m}
    if counts.positions_m is None:
        known: dict[str, int] = {}
        for index, one in enumerate(city.junctions):
            known.setdefault(one.surveyed.junction.id, index)
            known.setdefault(one.surveyed.junction.name, index)
        lost = []
        for name, value in zip(counts.junctions, counts.values, strict=True):
            if name in known:
                weight[known[name]] += value
            else:
                lost.append(name)
        if len(lost) == len(counts.junctions):
            raise InputError(
                f"{path}: junction", lost[0], "ids or names of junctions that count"
            )
        source = tr("{file}, each row counts 1, by junction", **said)
        if counts.column:
            source = tr("{file}, column {column}, by junction", **said)
        if not lost:
            return weight, source, []
        said |= {"n": len(lost), "first": lost[0]}
        return (
            weight,
            source,
            [
                tr(
                    "{file}: rows of junctions that do not count, such as {first}:"
                    " {n}.",
                    **said,
                )
            ],
        )
    nearest, distance = snap(counts.positions_m, places, within_m=wish.snap_m)
    is_near = nearest >= 0
    if not is_near.any():
        got = f"{path}, whose nearest place is {distance.min():,.0f} m from a junction"
        expected = f"places within {wish.snap_m:g} m (--snap) of a junction that counts"
        refuse("--junction-weights", got, expected)
    np.add.at(weight, nearest[is_near].astype(np.int64), counts.values[is_near])
    source = tr(
        "{file}, each place counts 1, at the nearest junction within {snap_m:g} m",
        **said,
    )
    if counts.column:
        source = tr(
            "{file}, column {column}, at the nearest junction within {snap_m:g} m",
            **said,
        )
    notes = []
    if not is_near.all():
        notes.append(
            tr(
                "{file}: {n} of {all} places ({lost:g} of {total:g} by weight) are"
                " not used: they are more than {snap_m:g} m from every junction that"
                " counts.",
                n=int((~is_near).sum()),
                all=len(is_near),
                lost=float(counts.values[~is_near].sum()),
                total=float(counts.values.sum()),
                file=path.name,
                snap_m=wish.snap_m,
            )
        )
    n_zero = int((weight == 0.0).sum())
    if n_zero:
        notes.append(
            tr(
                "Junctions without a weight, which get no sensors of their own: {n}.",
                n=n_zero,
            )
        )
    return weight, source, notes


def _number(
    values: Mapping[str, object], where: str, name: str, otherwise: float
) -> float:
    """The number of a column; a least APR is a share."""
    value = values.get(name)
    if name == "min_apr":
        most = 1.0
    else:
        most = np.inf
    if value is None:
        return otherwise
    try:
        if isinstance(value, bool):
            number = np.nan
        else:
            number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = np.nan
    if not (np.isfinite(number) and 0.0 <= number <= most):
        if most == np.inf:
            top = ""
        else:
            top = f" to {most:g}"
        raise InputError(f"{where}: {name}", value, f"a number from 0{top}")
    return number


def load_existing(paths: Sequence[Path], city: City) -> dict[str, Layout]:
    """Layouts of the units mounted already, by the name of the scene.

    A folder of a city stands for the layouts that it chose. Raises InputError: a file
    is no layout, two are of the same junction, or one is of none that counts.
    """
    scenes = {one.scene_name for one in city.junctions}
    existing: dict[str, Layout] = {}
    for path in paths:
        files = [path]
        if path.is_dir():
            files = sorted((path / JUNCTIONS).glob(f"*/{LAYOUT_FILE}"))
            if not files:
                expected = "a folder of place-rsus city with layouts"
                raise InputError("--keep", str(path), expected)
        for file in files:
            layout = load_layout(file)
            name = layout.scene_name
            if name not in scenes:
                expected = "a junction that counts, such as " + sorted(scenes)[0]
                raise InputError(
                    f"--keep {file}: scene", name or Unquoted("nothing"), expected
                )
            if name in existing:
                raise InputError("--keep", str(file), f"one layout of {name}")
            existing[name] = layout
    return existing
