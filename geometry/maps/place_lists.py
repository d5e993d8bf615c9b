"""Lists of places: sites; areas of a city; counts such as accidents."""

import logging
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from scipy.spatial import cKDTree
from shapely.geometry.base import BaseGeometry

from ..arrays import FloatArray, set_arrays
from ..csv_files import csv_rows
from ..errors import InputError, check_name, refuse
from ..frames import WGS84, parse_crs, transform
from ..opening import read_text
from ..text_formats import float_of, load_data
from .georeferences import horizontal_crs
from .gis_files import Feature, Features, read_features

if TYPE_CHECKING:
    from pyproj import CRS


_log = logging.getLogger(__name__)
SUFFIXES = (".csv", ".geojson", ".json")
_MAX_SITES = 50_000
_WORDS: dict[str, Any] = load_data("geometry.maps", "words.toml")["places"]
PLACE_FIELDS: dict[str, list[str]] = _WORDS["fields"]
_FIELDS: dict[str, list[str]] = PLACE_FIELDS | _WORDS["site_fields"]
_YES_NO: dict[str, bool] = _WORDS["answers"]
_Row = tuple[str, dict[str, Any]]
# A transverse Mercator around a junction has its origin there.
_NEAR_M = 200_000.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SiteWish:
    """Place where somebody would mount sensors; None: nothing is stated.

    Attributes
    ----------
    id : str
        Unique in its list.
    position_m : (2,) float
        In the scene's coordinate reference system. [m]
    kind : str
        In the source's words, in lower case: "lamp post", "kerb".
    z_m : float or None
        Of the foot, as the source counts heights. [m]
    min_height_m : float or None
        Lowest mount above the foot. [m]
    max_height_m : float or None
        Highest mount above the foot. [m]
    cost_eur : float or None
        Of making the site ready.
    capacity_units : int or None
        Units that it can carry.
    has_power : bool or None
        Electricity is at hand.
    has_fibre : bool or None
        A fibre is at hand.
    is_forbidden : bool
        Nothing may be mounted there.
    """

    id: str
    position_m: FloatArray
    kind: str = ""
    z_m: float | None = None
    min_height_m: float | None = None
    max_height_m: float | None = None
    cost_eur: float | None = None
    capacity_units: int | None = None
    has_power: bool | None = None
    has_fibre: bool | None = None
    is_forbidden: bool = False

    def __post_init__(self) -> None:
        set_arrays(self, f"site {self.id}.", position_m=(2,))

    @property
    def n_said(self) -> int:
        """Number of details that are given."""
        # But for id and position.
        details = fields(self)[2:]
        return sum(getattr(self, one.name) != one.default for one in details)


def read_sites(path: Path, *, crs: str) -> tuple[SiteWish, ...]:
    """Read a list of sites: CSV with a header, or GeoJSON with points.

    Columns are those of ``docs/formats.md``; case does not matter, nor do units
    at the end of a name, "height [m]"; a comma may stand for the decimal point.
    Columns are separated by comma, semicolon or tab.

    Parameters
    ----------
    path : Path
        File to read.
    crs : str
        Projected reference system of the scene; empty: it has none.

    Returns
    -------
    sites : tuple of SiteWish
        At least one; ids are unique.

    Raises
    ------
    InputError
        The file cannot be read, or a field is missing or wrong.
    """
    suffix = path.suffix.lower()
    if suffix == ".csv":
        rows = list(read_csv_rows(path))
        names: list[str] = []
        if rows:
            names = list(rows[0][1])
        fields = known_columns(names, str(path))
        tell_unknown(names, fields, path)
        rows = [
            (here, {fields[name]: row[name] for name in fields}) for here, row in rows
        ]
    elif suffix in SUFFIXES:
        rows = list(_geojson_rows(path, crs))
    else:
        raise InputError(str(path), suffix, "one of " + ", ".join(SUFFIXES))
    if not rows:
        refuse(str(path), "no sites", "one per line")
    # One site for each row; ids must be unique.
    sites = []
    seen: set[str] = set()
    for where, values in rows:
        site = _site(values, where, crs)
        if site.id in seen:
            raise InputError(f"{where}: id", site.id, "every id once")
        seen.add(site.id)
        sites.append(site)
    return tuple(sites)


def known_columns(
    names: Sequence[str],
    where: str,
    fields: Mapping[str, Sequence[str]] = _FIELDS,
) -> dict[str, str]:
    """Field of every known column.

    Parameters
    ----------
    names : sequence of str
        Names of the columns.
    where : str
        File and element at hand, for messages.
    fields : Mapping[str, Sequence[str]]
        Names under which each field is known.

    Returns
    -------
    known : dict of str to str
        Field by column; unknown columns are left out.

    Raises
    ------
    InputError
        Two columns are one field, or one has another unit.
    """
    found: dict[str, str] = {}
    field_of: dict[str, str] = {}
    for known_field, aliases in fields.items():
        for alias in aliases:
            field_of[alias] = known_field
    for name in names:
        # Drop units at the end of the name.
        words = re.findall(r"[^\W\d_]+", name.strip().lower()[:60])
        while words and words[-1] in _WORDS["units"] and len(words) > 1:
            words.pop()
            # "height in m".
            if words[-1] == "in" and len(words) > 1:
                words.pop()
        is_other = len(words) > 1 and words[-1] in _WORDS["other_units"]
        if is_other and "_".join(words[:-1]) in field_of:
            raise InputError(
                f"{where}: column {name!r:.60}",
                words[-1],
                "metres and euros",
            )
        field = field_of.get("_".join(words))
        if field is None:
            continue
        if field in found.values():
            refuse(f"{where}: column {name!r:.60}", f"a second {field}", "one")
        found[name] = field
    return found


def read_csv_rows(path: Path) -> Iterator[_Row]:
    """Rows of a CSV file with a header.

    Cells are separated by comma, semicolon or tab; empty lines are left out.

    Parameters
    ----------
    path : Path
        File to read.

    Yields
    ------
    row : (str, dict of str to str)
        Where the row is, and its cells by the names of the columns.

    Raises
    ------
    InputError
        The file is no CSV.
    """
    rows = csv_rows(read_text(path, "CSV"), str(path), separators=";\t,")
    _, names = next(rows, ("", []))
    for number, (here, cells) in enumerate(rows, start=2):
        if number > _MAX_SITES:
            refuse(str(path), f"more than {_MAX_SITES:,} lines", "fewer")
        yield here, dict(zip(names, cells, strict=True))


def tell_unknown(names: Iterable[str], known: Mapping[str, str], path: Path) -> None:
    """Log which columns of a file are not read, in one line."""
    unknown = [name[:60] for name in dict.fromkeys(names) if name not in known]
    if unknown:
        _log.warning(
            "%s: columns that are not known, and not read: %s",
            path,
            ", ".join(unknown),
        )


def _geojson_rows(path: Path, crs: str) -> Iterator[_Row]:
    """Rows of a GeoJSON file of points, with the fields of sites.

    Parameters
    ----------
    path : Path
        File to read.
    crs : str
        Reference system of the scene; empty: it has none.

    Yields
    ------
    row : (str, dict of str to Any)
        Where the row is, and its values by field.

    Raises
    ------
    InputError
        A geometry is no point, or its coordinates fit no scene.
    """
    table = read_features(path)
    declared = _declared_crs(table, str(path))
    if len(table.features) > _MAX_SITES:
        refuse(str(path), f"{len(table.features):,} features", "fewer")
    known: dict[str, str] = {}
    for feature in table.features:
        geometry = feature.geometry
        where = feature.where
        fields = known_columns(list(feature.values), where)
        known |= fields
        values = {
            fields[name]: value
            for name, value in feature.values.items()
            if name in fields
        }
        if geometry is not None and not geometry.is_empty:
            if geometry.geom_type != "Point":
                raise InputError(f"{where}.geometry", geometry.geom_type, "a Point")
            for name in ("x", "y", "lat", "lon"):
                values.pop(name, None)
            if declared.is_geographic and declared.to_authority() in (
                None,
                ("EPSG", "4326"),
            ):
                values |= {"lon": geometry.x, "lat": geometry.y}
            elif not crs:
                refuse(
                    where,
                    f"coordinates in {table.crs[:80]}",
                    "x and y of the scene",
                )
            else:
                place = transform([geometry.x, geometry.y], table.crs, crs)
                values["x"], values["y"] = place.tolist()
            if geometry.has_z:
                values.setdefault("z", geometry.z)
        yield where, values
    tell_unknown(
        (name for feature in table.features for name in feature.values),
        known,
        path,
    )


def _declared_crs(table: Features, where: str) -> "CRS":
    """Reference system of a layer; InputError: pyproj does not know it."""
    from pyproj.exceptions import ProjError

    try:
        declared = horizontal_crs(table.crs)
    except ProjError:
        declared = None
    if declared is None:
        raise InputError(f"{where}: crs", table.crs[:80], "a code that pyproj knows")
    return declared


def _site(values: Mapping[str, Any], where: str, crs: str) -> SiteWish:
    """Site of one row; InputError: a field is missing or wrong."""
    site_id = str(values.get("id", "")).strip()
    if not site_id:
        refuse(f"{where}: id", "nothing", "a name")
    check_name(site_id, f"{where}: id")
    kind = " ".join(str(values.get("kind", "")).lower().replace("_", " ").split())
    check_name(kind, f"{where}: kind")
    low = read_number(values, "min_height", where, least=0.0)
    high = read_number(values, "max_height", where, least=0.0)
    if high is None:
        high = read_number(values, "height", where, least=0.0)
    if low is not None and high is not None and low > high:
        raise InputError(f"{where}: max_height", high, f"at least min_height, {low}")
    capacity = read_number(values, "capacity", where, least=1.0)
    if capacity is not None and capacity != int(capacity):
        raise InputError(f"{where}: capacity", capacity, "a whole number, at least 1")
    capacity_units = None
    if capacity is not None:
        capacity_units = int(capacity)
    words = str(values.get("kind", "")).lower().replace("_", " ").split()
    kind = " ".join(words)
    return SiteWish(
        id=site_id[:120],
        position_m=read_position(values, where, crs),
        kind=kind[:60],
        z_m=read_number(values, "z", where),
        min_height_m=low,
        max_height_m=high,
        cost_eur=read_number(values, "cost", where, least=0.0),
        capacity_units=capacity_units,
        has_power=_yes_no(values, "power", where),
        has_fibre=_yes_no(values, "fibre", where),
        is_forbidden=bool(_yes_no(values, "forbidden", where)),
    )


def read_position(values: Mapping[str, Any], where: str, crs: str) -> FloatArray:
    """Position in a scene's system, by x and y, or by lat and lon.

    Parameters
    ----------
    values : Mapping[str, Any]
        Values of the row, by the names of the fields.
    where : str
        File and element at hand, for messages.
    crs : str
        Reference system of the scene; empty: it has none.

    Returns
    -------
    position_m : (2,) float
        In the scene's system. [m]

    Raises
    ------
    InputError
        A coordinate is missing or out of range, or latitude and longitude are
        swapped.
    """
    given = {
        name: read_number(values, name, where) for name in ("x", "y", "lat", "lon")
    }
    x, y, lat, lon = given.values()
    if x is not None and y is not None:
        return np.array([x, y])
    if lat is None or lon is None:
        wanted = ("lat", "lon")
        if (x is None) != (y is None):
            wanted = ("x", "y")
        missing = " and ".join(name for name in wanted if given[name] is None)
        refuse(f"{where}: {missing}", "nothing", "x and y, or lat and lon")
    if not crs:
        expected = "x and y in metres: the scene does not say where on earth it lies"
        raise InputError(f"{where}: lat", lat, expected)
    if abs(lat) > 90.0 >= abs(lon):
        expected = "-90 to 90 degrees: are latitude and longitude swapped?"
        raise InputError(f"{where}: lat", lat, expected)
    for name, value, limit in (("lat", lat, 90.0), ("lon", lon, 180.0)):
        if abs(value) > limit:
            raise InputError(
                f"{where}: {name}",
                value,
                f"-{limit:g} to {limit:g} degrees",
            )
    # A place that lies here only with latitude and longitude swapped is refused.
    position = transform([lon, lat], WGS84, crs)
    swapped = np.full(2, np.inf)
    if abs(lon) <= 90.0:
        swapped = transform([lat, lon], WGS84, crs)
    if _is_here(swapped, crs, [lat, lon]) and not _is_here(position, crs, [lon, lat]):
        expected = "a place near the scene: are latitude and longitude swapped?"
        raise InputError(f"{where}: lat", lat, expected)
    if not np.isfinite(position).all():
        raise InputError(f"{where}: lat", lat, f"a place in {crs}")
    return position


def _is_here(position_m: FloatArray, crs: str, lonlat_deg: list[float]) -> bool:
    """True if a position lies in a reference system's area.

    If no area is known, it must lie near the origin.
    """
    if not np.isfinite(position_m).all():
        return False
    area = parse_crs(crs).area_of_use
    if area is None:
        return bool((np.abs(position_m) < _NEAR_M).all())
    west, south, east, north = area.bounds
    return west <= lonlat_deg[0] <= east and south <= lonlat_deg[1] <= north


def read_number(
    values: Mapping[str, Any],
    field: str,
    where: str,
    *,
    least: float | None = None,
) -> float | None:
    """Finite number of a field, or None where nothing is stated.

    A comma may be the decimal point.

    Parameters
    ----------
    values : Mapping[str, Any]
        Values of the row, by the names of the fields.
    field : str
        Name of the field.
    where : str
        File and element at hand, for messages.
    least : float or None
        Smallest value that makes sense; None: any.

    Returns
    -------
    number : float or None
        In the unit of the field.

    Raises
    ------
    InputError
        It is no number, or too small.
    """
    value = values.get(field)
    if value is None or value == "":
        return None
    if isinstance(value, str) and "," in value:
        thousands = ","
        if value.rfind(",") > value.rfind("."):
            thousands = "."
        value = value.replace(thousands, "").replace(",", ".")
    number = float_of(value)
    if not np.isfinite(number) or (least is not None and number < least):
        expected = "a finite number" + (
            "" if least is None else f", at least {least:g}"
        )
        raise InputError(f"{where}: {field}", value, expected)
    return number


def _yes_no(values: Mapping[str, Any], field: str, where: str) -> bool | None:
    """Answer in a field; None: nothing is stated."""
    value = values.get(field)
    if value is None or value == "":
        return None
    word = str(value).strip().lower()
    if word not in _YES_NO:
        raise InputError(f"{where}: {field}", value, "yes or no")
    return _YES_NO[word]


# ---------- areas, and counts at places
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Area:
    """Polygon, or a place that something is near to.

    Attributes
    ----------
    where : str
        File and row, for messages.
    name : str
        Name in the file, or a number.
    geometry : BaseGeometry
        In the coordinates of the map.
    values : Mapping[str, Any]
        By the name of the column, in lower case.
    """

    where: str
    name: str
    geometry: BaseGeometry
    values: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Counts:
    """Counts at places, or by junction.

    Attributes
    ----------
    positions_m : (n, 2) float or None
        In the coordinates of the map; None: `junctions` are named.
    junctions : tuple of str
        Id or name of the junction of each; empty: places are given.
    values : (n,) float
        At least 0.
    column : str
        Where the values stand; empty: each place counts 1.
    """

    positions_m: FloatArray | None
    junctions: tuple[str, ...]
    values: FloatArray
    column: str


def read_areas(path: Path, *, crs: str) -> tuple[Area, ...]:
    """Read areas from a GIS file into a map's coordinates.

    Parameters
    ----------
    path : Path
        GeoJSON, GeoPackage or Shapefile.
    crs : str
        Projected coordinate reference system of the map, for pyproj; empty:
        unknown.

    Returns
    -------
    areas : tuple of Area
        At least one.

    Raises
    ------
    InputError
        The file cannot be read, has no geometry, or the map does not say where
        on earth it lies.
    """
    table = read_features(path)
    areas = []
    for number, feature in enumerate(table.features, start=1):
        if feature.geometry is not None and not feature.geometry.is_empty:
            values = {
                str(key).strip().lower(): value for key, value in feature.values.items()
            }
            name = next(
                (str(values[key]) for key in _WORDS["names"] if key in values),
                f"area {number}",
            )
            place = _in_crs(feature, table, crs)
            areas.append(
                Area(where=feature.where, name=name, geometry=place, values=values)
            )
    if not areas:
        refuse(str(path), "no geometry", "polygons")
    return tuple(areas)


def read_counts(path: Path, *, crs: str, column: str = "") -> Counts:
    """Read counts: CSV with x and y, lat and lon, or junction; or points of a GIS file.

    Parameters
    ----------
    path : Path
        CSV, GeoJSON, GeoPackage or Shapefile.
    crs : str
        Of the map; columns x and y are in it.
    column : str
        Of the counts; empty: "weight", "count" or the like, and where there is none,
        each place counts 1.

    Raises
    ------
    InputError
        The file cannot be read; there is no such column, or no place; a count is no
        number of at least 0.
    """
    if path.suffix.lower() == ".csv":
        rows = list(read_csv_rows(path))
        places = None
    else:
        table = read_features(path)
        rows = [(feature.where, dict(feature.values)) for feature in table.features]
        places = []
        for feature in table.features:
            if feature.geometry is None or feature.geometry.is_empty:
                refuse(f"{feature.where}.geometry", "nothing", "a Point")
            middle = _in_crs(feature, table, crs).centroid
            places.append(np.array([middle.x, middle.y]))
    if not rows:
        refuse(str(path), "nothing", "a row for each place")
    names = {
        str(name): str(name).strip().lower() for _, values in rows for name in values
    }
    # The counts, and where they are: by junction or by place.
    found = _column(names, column, path)
    counts = [_count(row, found, where) for where, row in rows]
    junctions: tuple[str, ...] = ()
    by = next(
        (name for name, plain in names.items() if plain in _WORDS["junctions"]), None
    )
    if places is None and by is not None:
        junctions = tuple(str(row[by]).strip() for _, row in rows)
    elif places is None:
        places = []
        for where, row in rows:
            known = known_columns(list(row), where)
            places.append(
                read_position({known[one]: row[one] for one in known}, where, crs)
            )
    positions = None
    if places is not None:
        positions = np.array(places).reshape(-1, 2)
    values = np.array(counts)
    return Counts(
        positions_m=positions,
        junctions=junctions,
        values=values,
        column=found,
    )


def _column(names: Mapping[str, str], column: str, path: Path) -> str:
    """Column of the counts; empty: there is none."""
    if column:
        if column not in names:
            known = ", ".join(sorted(names)) or "none"
            raise InputError(f"{path}: column", column, f"one of {known}")
        return column
    plain = {lower: name for name, lower in names.items()}
    return next((plain[name] for name in _WORDS["counts"] if name in plain), "")


def _count(row: Mapping[str, Any], column: str, where: str) -> float:
    """Count of one row; InputError: it is no number of at least 0."""
    value: Any = 1.0
    if column:
        value = row.get(column)
    number = float_of(value)
    if not (np.isfinite(number) and number >= 0.0):
        raise InputError(f"{where}: {column}", value, "a number, at least 0")
    return number


def _in_crs(feature: Feature, table: Features, crs: str) -> BaseGeometry:
    """Geometry of a feature in the map's coordinates."""
    assert feature.geometry is not None
    if not crs:
        got = f"coordinates in {table.crs[:80] or 'an unknown system'}"
        refuse(feature.where, got, "a map that says where on earth it lies: `crs`")
    declared = _declared_crs(table, feature.where)
    flat = shapely.force_2d(feature.geometry)
    own_crs = declared.to_wkt()
    moved: BaseGeometry = shapely.transform(
        flat, lambda points: transform(points, own_crs, crs)
    )
    if not np.isfinite(shapely.get_coordinates(moved)).all():
        refuse(feature.where, "a place that is nowhere", f"places in {crs}")
    return moved


def snap(
    points_m: FloatArray,
    junctions_m: FloatArray,
    *,
    within_m: float,
) -> tuple[FloatArray, FloatArray]:
    """Nearest junction of each point, and how far it is.

    Parameters
    ----------
    points_m : (n, 2) float
        Points. [m]
    junctions_m : (m, 2) float
        Middles of the junctions. [m]
    within_m : float
        Largest distance. [m]

    Returns
    -------
    index : (n,) int
        -1: none is so near.
    distance_m : (n,) float
        To the nearest junction. [m]
    """
    found, nearest = cKDTree(junctions_m).query(points_m)
    distance: FloatArray = np.asarray(found)
    return np.where(distance <= within_m, nearest, -1), distance


def areas_of(
    areas: Sequence[Area],
    points_m: FloatArray,
    *,
    within_m: float = 0.0,
) -> list[list[int]]:
    """Indices of the areas that each point lies in.

    Parameters
    ----------
    areas : sequence of Area
        Areas.
    points_m : (n, 2) float
        Points. [m]
    within_m : float
        Distance from an area that still counts. [m]

    Returns
    -------
    found : list of list of int
        One list for each point, ascending.
    """
    tree = shapely.STRtree([area.geometry for area in areas])
    point, area = tree.query(
        shapely.points(points_m),
        predicate="dwithin",
        distance=within_m,
    )
    found: list[list[int]] = [[] for _ in points_m]
    for index, one in sorted(zip(point.tolist(), area.tolist(), strict=True)):
        found[index].append(one)
    return found
