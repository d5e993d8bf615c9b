"""Lists of places: sites; areas of a city; counts such as accidents."""

import glob
import logging
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from scipy.spatial import cKDTree
from shapely.geometry.base import BaseGeometry

from ..arrays import FloatArray, set_arrays
from ..csv_files import csv_rows, read_csv_text
from ..errors import Faults, InputError, check_name, gathering, refuse
from ..frames import WGS84, parse_crs, transform
from ..text_formats import float_of, load_data
from .georeferences import crs_name, horizontal_crs
from .gis_files import SUFFIXES as GIS_SUFFIXES
from .gis_files import Feature, Features, read_features

if TYPE_CHECKING:
    from pyproj import CRS


_log = logging.getLogger(__name__)
SUFFIXES = (".csv", *GIS_SUFFIXES, ".zip")
_MAX_SITES = 50_000
_WORDS: dict[str, Any] = load_data("geometry.maps", "words.toml")["places"]
PLACE_FIELDS: dict[str, list[str]] = _WORDS["fields"]
_FIELDS: dict[str, list[str]] = PLACE_FIELDS | _WORDS["site_fields"]
_FIRST_COUNTS: list[str] = _WORDS["first_counts"]
_YES_NO: dict[str, bool] = _WORDS["answers"]
_Row = tuple[str, dict[str, Any]]
_POINTS = ("Point", "MultiPoint")
# Numbers of a site, and the least that makes sense.
_SITE_NUMBERS: dict[str, float | None] = {
    "z": None,
    "min_height": 0.0,
    "max_height": 0.0,
    "height": 0.0,
    "cost": 0.0,
    "capacity": 1.0,
}
_SPELLED = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})
# Names of columns that a message offers.
_MAX_HEADERS = 12
# Of a column, in a Shapefile.
_MAX_SHAPEFILE_NAME = 10
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
    surveyed_m : (2,) float or None
        Where it stands by the list, if the site was moved. [m]
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
    surveyed_m: FloatArray | None = None

    def __post_init__(self) -> None:
        set_arrays(self, f"site {self.id}.", position_m=(2,))

    @property
    def n_said(self) -> int:
        """Number of details that are given."""
        # But for id and position.
        details = [one for one in fields(self)[2:] if one.name != "surveyed_m"]
        return sum(getattr(self, one.name) != one.default for one in details)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SiteRows:
    """Rows of a list of sites, before they are brought onto a map.

    Attributes
    ----------
    path : Path
        The file.
    rows : tuple of (str, dict of str to Any)
        Where each row is, and its values by field; x and y are in `crs`.
    crs : str
        Reference system of x and y as the file declares it; empty: it does not.
    faults : Faults
        What is wrong so far.
    """

    path: Path
    rows: tuple[_Row, ...]
    crs: str
    faults: Faults


def read_sites(path: Path, *, crs: str) -> tuple[SiteWish, ...]:
    """Read a list of sites: CSV with a header, or points of a GIS file.

    Columns are those of ``docs/formats.md``; case does not matter, nor do units
    at the end of a name, "height [m]"; a comma may stand for the decimal point.
    Columns are separated by comma, semicolon or tab.

    Parameters
    ----------
    path : Path
        CSV, GeoJSON, GeoPackage or Shapefile.
    crs : str
        Projected reference system of the scene; empty: it has none.

    Returns
    -------
    sites : tuple of SiteWish
        At least one; ids are unique.

    Raises
    ------
    InputError
        The file cannot be read, or a field is missing or wrong; all that is wrong
        stands in one message.
    """
    return sites_of(read_site_rows(path), crs=crs)


def read_site_rows(path: Path) -> SiteRows:
    """Rows of a list of sites with at least one row.

    Parameters
    ----------
    path : Path
        CSV, GeoJSON, GeoPackage or Shapefile.

    Raises
    ------
    InputError
        The file cannot be read, or has no rows.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        expected = "one of " + ", ".join(SUFFIXES) + "; of a spreadsheet, a CSV file"
        raise InputError(str(path), suffix, expected)
    faults = Faults(str(path))
    declared = ""
    if suffix == ".csv":
        table = list(read_csv_rows(path, faults=faults))
        names: list[str] = []
        if table:
            names = list(table[0][1])
        fields = known_columns(names, str(path), faults=faults)
        tell_unknown(names, fields, path)
        rows = [
            (here, {fields[name]: row[name] for name in fields}) for here, row in table
        ]
        if rows:
            _check_fields(set(fields.values()), names, faults)
    else:
        rows, declared = _gis_rows(path, faults)
    if not rows:
        faults.tell()
        refuse(str(path), "no sites", "one per line")
    return SiteRows(path=path, rows=tuple(rows), crs=declared, faults=faults)


def sites_of(
    listed: SiteRows, *, crs: str, sites_crs: str = ""
) -> tuple[SiteWish, ...]:
    """Sites of the rows of a list, see :func:`read_sites`."""
    if listed.crs and sites_crs and parse_crs(sites_crs) != parse_crs(listed.crs):
        expected = (
            f"none: {listed.path.name} says that it is in {crs_words(listed.crs)}"
        )
        raise InputError("sites_crs", sites_crs, expected)
    own_crs = listed.crs or sites_crs
    faults = listed.faults
    # Of a column that is missing, each row would tell.
    is_told = bool(faults.found)
    sites: list[SiteWish] = []
    lines: dict[str, str] = {}
    for where, values in listed.rows:
        site = _site(values, where, crs, own_crs, faults, is_told=is_told)
        if site is None:
            continue
        if site.id in lines and site.id:
            expected = f"every id once: {lines[site.id]} has it, too"
            with gathering(faults):
                raise InputError(f"{where}: id", site.id, expected)
        lines.setdefault(site.id, where.removeprefix(f"{listed.path}: "))
        sites.append(site)
    faults.tell()
    return tuple(sites)


def crs_words(crs: str) -> str:
    """Code and title of a reference system, for messages.

    >>> crs_words("EPSG:25832")
    'EPSG:25832 (ETRS89 / UTM zone 32N)'
    """
    system = parse_crs(crs)
    code = crs_name(system)
    if code.startswith(("PROJCRS", "GEOGCRS", "BOUNDCRS", "COMPOUNDCRS")):
        return system.name
    return f"{code} ({system.name})"


def _check_fields(found: set[str], names: Sequence[str], faults: Faults) -> None:
    """Add faults for columns that a list of sites lacks."""
    where = _columns_at(faults.where, names)
    if "id" not in found:
        with gathering(faults):
            refuse(where, "no id", f"one of {_headers('id')}")
    has_metres = {"x", "y"} <= found
    has_degrees = {"lat", "lon"} <= found
    if has_metres or has_degrees:
        return
    pair = ("x", "y")
    if found & {"lat", "lon"}:
        pair = ("lat", "lon")
    missing = [name for name in pair if name not in found]
    if len(missing) == 1:
        expected = f"one of {_headers(missing[0])}"
        with gathering(faults):
            refuse(where, f"no {missing[0]}", expected)
        return
    expected = (
        f"x and y ({_headers('x')}; {_headers('y')}), or lat and lon"
        f" ({_headers('lat')}; {_headers('lon')})"
    )
    with gathering(faults):
        refuse(where, "no place", expected)


def _columns_at(file: str | Path, names: Sequence[str]) -> str:
    """A file and its columns, for messages."""
    return f"{file}: columns {', '.join(names)[:120]}".removesuffix(" ")


def _headers(field: str) -> str:
    """Some names of a field's column, for messages."""
    return ", ".join(_FIELDS[field][:_MAX_HEADERS])


def known_columns(
    names: Sequence[str],
    where: str,
    fields: Mapping[str, Sequence[str]] = _FIELDS,
    *,
    faults: Faults | None = None,
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
    faults : Faults or None
        Takes what is wrong, and the column is left out; None: it is raised.

    Returns
    -------
    known : dict of str to str
        Field by column; unknown columns are left out.

    Raises
    ------
    InputError
        Two columns are one field, or one has another unit.
    """
    table = _aliases(tuple((field, tuple(names)) for field, names in fields.items()))
    found: dict[str, tuple[str, int]] = {}
    column_of: dict[str, str] = {}
    for name in names:
        with gathering(faults):
            match = _field_of(name, table, where)
            if match is None:
                continue
            field, rank = match
            other = column_of.get(field)
            if other is None:
                column_of[field] = name
            elif field not in _FIRST_COUNTS or found[other][1] == rank:
                expected = f"one of {other!r:.60} and {name!r:.60}"
                refuse(f"{where}: column {name!r:.60}", f"a second {field}", expected)
            elif rank < found[other][1]:
                column_of[field] = name
            found[name] = match
    kept = set(column_of.values())
    return {name: found[name][0] for name in names if name in kept}


def plain_column(name: str) -> list[str]:
    """Words of a column's name in lower case, without accents, digits and units.

    >>> plain_column("Lichtpunkthöhe [m]")
    ['lichtpunkthoehe']
    >>> plain_column("N° de support")
    ['numero', 'de', 'support']
    """
    text = re.sub(r"\bn[°º]", "numero ", name.strip().lower()[:60])
    text = text.translate(_SPELLED)
    text = "".join(
        letter
        for letter in unicodedata.normalize("NFKD", text)
        if not unicodedata.combining(letter)
    )
    words = re.findall(r"[^\W\d_]+", text)
    while len(words) > 1 and words[-1] in _WORDS["units"]:
        words.pop()
        if len(words) > 1 and words[-1] in _WORDS["before_units"]:
            words.pop()
    return words


@lru_cache(maxsize=8)
def _aliases(
    fields: tuple[tuple[str, tuple[str, ...]], ...],
) -> dict[str, tuple[str, int]]:
    """Field, and rank among its names, of every name that a column may have.

    Names of ten letters that begin one field's names alone are names of it, too:
    Shapefiles cut names off.
    """
    table: dict[str, tuple[str, int]] = {}
    for field, names in fields:
        for rank, name in enumerate(names):
            table[name.replace("_", "")] = (field, rank)
    beginnings: dict[str, set[tuple[str, int]]] = {}
    for name, match in table.items():
        if len(name) > _MAX_SHAPEFILE_NAME:
            beginnings.setdefault(name[:_MAX_SHAPEFILE_NAME], set()).add(match)
    for name, matches in beginnings.items():
        if len({field for field, _ in matches}) == 1:
            table.setdefault(name, min(matches, key=lambda match: match[1]))
    return table


def _field_of(
    name: str, table: Mapping[str, tuple[str, int]], where: str
) -> tuple[str, int] | None:
    """Field and rank of a column; InputError: it is in another unit."""
    words = plain_column(name)
    axis = [word for word in words if word not in _WORDS["qualifiers"]]
    for kept in (words, axis):
        match = table.get("".join(kept))
        if match is not None:
            return match
        is_other = len(kept) > 1 and kept[-1] in _WORDS["other_units"]
        if is_other and "".join(kept[:-1]) in table:
            raise InputError(
                f"{where}: column {name!r:.60}", kept[-1], "metres and euros"
            )
    return None


def read_csv_rows(path: Path, *, faults: Faults | None = None) -> Iterator[_Row]:
    """Rows of a CSV file with a header.

    Cells are separated by comma, semicolon or tab; empty lines are left out.

    Parameters
    ----------
    path : Path
        File to read.
    faults : Faults or None
        Takes rows with other numbers of cells; None: they are raised.

    Yields
    ------
    row : (str, dict of str to str)
        Where the row is, and its cells by the names of the columns.

    Raises
    ------
    InputError
        The file is no CSV.
    """
    text = read_csv_text(path)
    rows = csv_rows(text, str(path), separators=";\t,", faults=faults)
    here, names = next(rows, ("", []))
    for name, number in Counter(names).items():
        if number > 1 and name:
            with gathering(faults):
                refuse(f"{here}: column {name!r:.60}", f"{number} of it", "one")
    for count, (here, cells) in enumerate(rows, start=2):
        if count > _MAX_SITES:
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


def list_files(path: Path) -> tuple[Path, ...]:
    """A list and the files beside it that belong to it, in the order of their names.

    A Shapefile has its names in a .dbf file, and its reference system in a .prj.
    """
    if path.suffix.lower() != ".shp":
        return (path,)
    beside = path.parent.glob(f"{glob.escape(path.stem)}.*")
    parts = (".shp", ".shx", ".dbf", ".prj", ".cpg")
    return tuple(sorted(one for one in beside if one.suffix.lower() in parts))


def _gis_rows(path: Path, faults: Faults) -> tuple[list[_Row], str]:
    """Rows of a GIS file of points, and the reference system of x and y.

    Parameters
    ----------
    path : Path
        GeoJSON, GeoPackage or Shapefile.
    faults : Faults
        Takes what is wrong with a row, which is left out then.

    Returns
    -------
    rows : list of (str, dict of str to Any)
        Where each row is, and its values by field.
    crs : str
        Empty: the file does not say, or has latitudes and longitudes.

    Raises
    ------
    InputError
        The file cannot be read, or pyproj does not know its reference system.
    """
    table = read_features(path, kinds=_POINTS, named=("sites", path.stem))
    is_in_degrees = False
    crs = ""
    if table.crs:
        declared = _declared_crs(table, str(path))
        is_in_degrees = declared.is_geographic and declared.to_authority() in (
            None,
            ("EPSG", "4326"),
        )
        if not is_in_degrees:
            crs = crs_name(declared)
    if len(table.features) > _MAX_SITES:
        refuse(str(path), f"{len(table.features):,} features", "fewer")
    # Rows of a GeoJSON file may have different columns.
    known_of: dict[tuple[str, ...], dict[str, str]] = {}
    for feature in table.features:
        names = tuple(feature.values)
        if names not in known_of:
            known_of[names] = known_columns(names, feature.where, faults=faults)
    known: dict[str, str] = {}
    for own in known_of.values():
        known |= own
    every = [name for names in known_of for name in names]
    tell_unknown(every, known, path)
    if table.features and "id" not in known.values():
        with gathering(faults):
            refuse(_columns_at(path, every), "no id", f"one of {_headers('id')}")
    rows: list[_Row] = []
    for feature in table.features:
        own = known_of[tuple(feature.values)]
        values = {
            own[name]: value for name, value in feature.values.items() if name in own
        }
        with gathering(faults):
            point = _point_of(feature)
            if point is not None:
                for name in ("x", "y", "lat", "lon"):
                    values.pop(name, None)
                pair = ("x", "y")
                if is_in_degrees:
                    pair = ("lon", "lat")
                values |= dict(zip(pair, (point.x, point.y), strict=True))
                if point.has_z:
                    values.setdefault("z", point.z)
            rows.append((feature.where, values))
    return rows, crs


def _point_of(feature: Feature) -> "shapely.Point | None":
    """Point of a feature, or of its multipoint of one; None: it has no geometry.

    Raises InputError if it is another geometry.
    """
    geometry = feature.geometry
    if geometry is None or geometry.is_empty:
        return None
    parts = shapely.get_parts(geometry)
    if geometry.geom_type not in _POINTS or len(parts) != 1:
        raise InputError(f"{feature.where}.geometry", geometry.geom_type, "a Point")
    point: shapely.Point = parts[0]
    return point


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


def _site(
    values: Mapping[str, Any],
    where: str,
    crs: str,
    own_crs: str,
    faults: Faults,
    *,
    is_told: bool,
) -> SiteWish | None:
    """Site of one row; None: a field is missing or wrong, which `faults` takes.

    `is_told`: columns are missing, and the file has been told about them.
    """
    n_before = len(faults.found)
    has_place = {"x", "y"} <= set(values) or {"lat", "lon"} <= set(values)
    site_id = str(values.get("id", "")).strip()
    with gathering(faults):
        if not site_id and ("id" in values or not is_told):
            refuse(f"{where}: id", "nothing", "a name")
        check_name(site_id, f"{where}: id")
    words = str(values.get("kind", "")).lower().replace("_", " ").split()
    kind = " ".join(words)
    with gathering(faults):
        check_name(kind, f"{where}: kind")
    position = np.zeros(2)
    with gathering(faults):
        if has_place or not is_told:
            position = read_position(values, where, crs, own_crs)
    numbers: dict[str, float | None] = {}
    for field, least in _SITE_NUMBERS.items():
        numbers[field] = None
        with gathering(faults):
            numbers[field] = read_number(values, field, where, least=least)
    low = numbers["min_height"]
    high = numbers["max_height"]
    if high is None:
        high = numbers["height"]
    if low is not None and high is not None and low > high:
        expected = f"at least min_height, {low}"
        with gathering(faults):
            raise InputError(f"{where}: max_height", high, expected)
    capacity = numbers["capacity"]
    capacity_units = None
    if capacity is not None:
        capacity_units = int(capacity)
        if capacity != capacity_units:
            expected = "a whole number, at least 1"
            with gathering(faults):
                raise InputError(f"{where}: capacity", capacity, expected)
    answers: dict[str, bool | None] = {}
    for field in ("power", "fibre", "forbidden"):
        answers[field] = None
        with gathering(faults):
            answers[field] = _yes_no(values, field, where)
    if len(faults.found) > n_before:
        return None
    return SiteWish(
        id=site_id[:120],
        position_m=position,
        kind=kind[:60],
        z_m=numbers["z"],
        min_height_m=low,
        max_height_m=high,
        cost_eur=numbers["cost"],
        capacity_units=capacity_units,
        has_power=answers["power"],
        has_fibre=answers["fibre"],
        is_forbidden=bool(answers["forbidden"]),
    )


def read_position(
    values: Mapping[str, Any], where: str, crs: str, own_crs: str = ""
) -> FloatArray:
    """Position in a scene's system, by x and y, or by lat and lon.

    Parameters
    ----------
    values : Mapping[str, Any]
        Values of the row, by the names of the fields.
    where : str
        File and element at hand, for messages.
    crs : str
        Reference system of the scene; empty: it has none.
    own_crs : str
        Reference system of x and y; empty: that of the scene.

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
        return _in_scene(np.array([x, y]), where, crs, own_crs)
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


def _in_scene(position_m: FloatArray, where: str, crs: str, own_crs: str) -> FloatArray:
    """Easting and northing of a list in the scene's system; see read_position."""
    if not own_crs:
        return position_m
    if not crs:
        expected = "x and y of the scene, which does not say where on earth it lies"
        refuse(where, f"coordinates in {crs_words(own_crs)}", expected)
    moved = transform(position_m, own_crs, crs)
    if not np.isfinite(moved).all():
        expected = f"a place in {crs_words(own_crs)}"
        raise InputError(f"{where}: x and y", position_m.tolist(), expected)
    return moved


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

    A comma may be the decimal point; points, apostrophes and spaces may part
    thousands.

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
    number = float_of(value)
    if isinstance(value, str):
        number = float_of(_plain_number(value))
    if not np.isfinite(number) or (least is not None and number < least):
        expected = "a finite number" + (
            "" if least is None else f", at least {least:g}"
        )
        raise InputError(f"{where}: {field}", value, expected)
    return number


def _plain_number(text: str) -> str:
    """A number as people write it, with a decimal point and no marks of thousands.

    >>> [_plain_number(text) for text in ("7,5", "1.250,50", "5 650 294.9")]
    ['7.5', '1250.50', '5650294.9']
    """
    plain = re.sub(r"(?<=\d)[\s'\u2019](?=\d{3})", "", text.strip())
    marks = [mark for mark in ",." if mark in plain]
    if not marks:
        return plain
    # The last mark is the decimal one, unless it stands there several times.
    decimal = max(marks, key=plain.rfind)
    for mark in marks:
        if mark != decimal or plain.count(mark) > 1:
            plain = plain.replace(mark, "")
    return plain.replace(",", ".")


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
