"""Features, buildings and walls from GeoJSON, GeoPackage and Shapefile."""

import glob
import logging
import re
import sqlite3
import sys
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.errors import ShapelyError
from shapely.geometry import shape
from shapely.geometry.base import BaseGeometry

from ..archives import unpacked
from ..errors import InputError, Unquoted, check_one_of, refuse
from ..frames import WGS84
from ..notes import Note
from ..opening import check_file, open_file, read_text, reading
from ..scene import CLASS_NAMES, join
from ..text_formats import load_data, parse_object
from .georeferences import Georeference, georeference
from .source_map import (
    UNITS_M,
    SourceMap,
    Thing,
    ThingKind,
    counted,
    extrude_polygon,
    kind_from_name,
    kind_of_class,
    parse_length_m,
    parts_of,
    polygons_of,
    shortened,
    thing_defaults,
    unique_id,
)

_log = logging.getLogger(__name__)
MAX_FEATURES = 200_000
SUFFIXES = (".geojson", ".json", ".gpkg", ".shp")
# First bytes of a file: GDAL would take other things under these names too, and follow
# their links.
_MAGIC = {
    ".gpkg": (b"SQLite format 3\0", "a GeoPackage"),
    ".shp": (b"\0\0\x27\x0a", "a Shapefile"),
}
_DRIVERS = {".gpkg": "GPKG", ".shp": "ESRI Shapefile"}
_MAX_GDAL_BYTES = 2_000_000_000
# What shapely raises for a geometry that is not nested as its type asks for.
_BROKEN_GEOMETRY = (
    ShapelyError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    RecursionError,
)
_WORDS: dict[str, Any] = load_data("geometry.maps", "words.toml")["gis"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Feature:
    """One row of a layer.

    Attributes
    ----------
    where : str
        File and row, for messages.
    geometry : BaseGeometry or None
        In the file's coordinates.
    values : Mapping[str, Any]
        By name of the column; missing ones are left out.
    """

    where: str
    geometry: BaseGeometry | None
    values: Mapping[str, Any]

    @property
    def named(self) -> dict[str, Any]:
        """Values by column, in lower case and with _ between words."""
        return {_column(key): value for key, value in self.values.items()}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Features:
    """One layer.

    Attributes
    ----------
    features : tuple of Feature
        Rows of the layer.
    crs : str
        As the file declares it; empty: it does not.
    """

    features: tuple[Feature, ...]
    crs: str


def read_features(
    path: Path, *, kinds: Sequence[str] = (), named: Sequence[str] = ()
) -> Features:
    """Read the layer of a GIS file, or of a .zip with one.

    Parameters
    ----------
    path : Path
        GeoJSON, GeoPackage or Shapefile.
    kinds : sequence of str
        Types of geometries for which a layer of several is chosen; empty: any.
    named : sequence of str
        Names of which the first decides where several layers are left.

    Returns
    -------
    table : Features
        In the file's coordinates.

    Raises
    ------
    InputError
        The file cannot be read, does not have the format of its suffix, has
        several layers, or has more than 200,000 features.
    """
    suffix = path.suffix.lower()
    if suffix == ".zip":
        with unpacked(path, SUFFIXES) as member:
            return read_features(member, kinds=kinds, named=(*named, member.stem))
    if suffix in (".geojson", ".json"):
        return _read_geojson(path)
    if suffix in _MAGIC:
        return _read_with_gdal(path, kinds, named)
    raise InputError(str(path), suffix, "one of " + ", ".join((*SUFFIXES, ".zip")))


def _read_geojson(path: Path) -> Features:
    """Read GeoJSON (RFC 7946), or its predecessor with a ``crs`` member.

    Nothing that the file refers to is fetched.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    table : Features
        In the file's coordinates.

    Raises
    ------
    InputError
        The file is no GeoJSON, or a geometry is broken.
    """
    where = str(path)
    document = parse_object(read_text(path, "GeoJSON"), where, "GeoJSON")
    kind = document.get("type")
    rows: Any = [document]
    if kind == "FeatureCollection":
        rows = document.get("features")
    if kind not in ("FeatureCollection", "Feature") or not isinstance(rows, list):
        raise InputError(f"{where}: type", kind, "a FeatureCollection with features")
    _refuse_many(len(rows), where)
    features = []
    for index, row in enumerate(rows):
        here = f"{where}: features[{index}]"
        if not isinstance(row, Mapping):
            raise InputError(here, row, "a Feature")
        values = row.get("properties") or {}
        table = row.get("geometry")
        if not isinstance(values, Mapping):
            raise InputError(f"{here}.properties", values, "a table")
        values = {str(key): value for key, value in values.items() if value is not None}
        if isinstance(row.get("id"), str | int):
            values.setdefault("id", row["id"])
        geometry = None
        if table is not None:
            if (
                not isinstance(table, Mapping)
                or table.get("type") not in _WORDS["geometries"]
            ):
                raise InputError(
                    f"{here}.geometry",
                    table,
                    "one of " + ", ".join(_WORDS["geometries"]),
                )
            try:
                geometry = shape(table)
            except _BROKEN_GEOMETRY:
                got = Unquoted(f"a broken {table['type']}")
                expected = (
                    "finite coordinates, rings of four or more, nested as its type"
                    " asks for"
                )
                raise InputError(f"{here}.geometry", got, expected) from None
        features.append(Feature(where=here, geometry=geometry, values=values))
    return Features(
        features=tuple(features),
        crs=_geojson_crs(document.get("crs"), where),
    )


def _geojson_crs(table: Any, where: str) -> str:
    """Reference system of a GeoJSON file: WGS 84 unless it names another."""
    if table is None:
        return WGS84
    properties = None
    if isinstance(table, Mapping):
        properties = table.get("properties")
    name = None
    if isinstance(properties, Mapping):
        name = properties.get("name")
    if not isinstance(name, str) or not name:
        raise InputError(f"{where}: crs", table, "a named one, or none for WGS 84")
    return name


def _read_with_gdal(path: Path, kinds: Sequence[str], named: Sequence[str]) -> Features:
    """Read a GeoPackage or Shapefile through GDAL.

    Parameters
    ----------
    path : Path
        File to read.
    kinds, named : sequence of str
        Which of several layers is read, see :func:`read_features`.

    Returns
    -------
    table : Features
        In the file's coordinates.

    Raises
    ------
    InputError
        The file is damaged or of another format, or has several layers.
    """
    import pyogrio

    where = str(path)
    magic, name = _MAGIC[path.suffix.lower()]
    damage = (ShapelyError, ValueError, TypeError, RuntimeError, OverflowError)
    with reading(path, name, *damage):
        with open_file(path, max_bytes=_MAX_GDAL_BYTES) as file:
            if file.read(len(magic)) != magic:
                refuse(where, "something else", name)
        # .dbf, .gpkg-wal, ..
        for other in path.parent.glob(f"{glob.escape(path.stem)}.*"):
            check_file(other)
        if path.suffix.lower() == ".gpkg":
            _check_tables(path)
        with warnings.catch_warnings():
            # Rings left open and the like, which GDAL mends.
            warnings.simplefilter("ignore")
            layer = _choose_layer(where, pyogrio.list_layers(path), kinds, named)
            info = pyogrio.read_info(path, layer=layer)
            if info["driver"] != _DRIVERS[path.suffix.lower()]:
                refuse(where, f"a file for {info['driver']}", name)
            if info["geometry_type"] is None:
                refuse(where, "a table without geometries", name)
            table = pyogrio.read_dataframe(
                path, layer=layer, max_features=MAX_FEATURES + 1
            )
    _refuse_many(len(table), where)
    # Cells that have a value, row by row.
    columns = {
        str(name): table[name].to_numpy()
        for name in table.columns
        if name != "geometry"
    }
    is_known = {name: table[name].notna().to_numpy() for name in columns}
    features = []
    for index, geometry in enumerate(table.geometry.to_numpy()):
        values: dict[str, Any] = {}
        for name, column in columns.items():
            if is_known[name][index]:
                value = column[index]
                # Plain numbers, as GeoJSON has them.
                if isinstance(value, np.generic):
                    value = value.item()
                values[name] = value
        here = f"{where}: row {index + 1}"
        features.append(Feature(where=here, geometry=geometry, values=values))
    crs = ""
    if table.crs is not None:
        crs = table.crs.to_wkt()
    return Features(features=tuple(features), crs=crs)


def _choose_layer(
    where: str, layers: Any, kinds: Sequence[str], named: Sequence[str]
) -> str:
    """Layer to read: the only one, the only one of these kinds, or the named one.

    `layers` are rows of name and type of geometry. Raises InputError if several are
    left.
    """
    every = [(str(name), str(kind).removesuffix(" Z")) for name, kind in layers]
    fitting = [name for name, kind in every if not kinds or kind in kinds]
    if len(every) == 1:
        return every[0][0]
    if len(fitting) == 1:
        return fitting[0]
    for name in named:
        if name in fitting:
            if len(every) > 1:
                _log.warning("%s: layer %s is read, of %d", where, name, len(every))
            return name
    names = ", ".join(name[:60] for name, _ in every[:20])
    expected = "a file with one"
    if named:
        expected = f"one, or one that is called {' or '.join(dict.fromkeys(named))}"
    refuse(where, f"{len(every)} layers: {names}", expected)


def _check_tables(path: Path) -> None:
    """Refuse a GeoPackage that computes what it holds.

    Such a computation may go on for ever.
    """
    computed = []
    try:
        with closing(
            sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)
        ) as database:
            for kind, name, made in database.execute(
                "SELECT type, name, sql FROM sqlite_master"
            ):
                if kind == "view":
                    computed.append(name)
                elif kind == "table" and re.match(
                    r"\s*CREATE\s+VIRTUAL",
                    made or "",
                    re.IGNORECASE,
                ):
                    if not re.search(r"\sUSING\s+rtree\b", made, re.IGNORECASE):
                        computed.append(name)
                elif kind == "table":
                    columns = "SELECT hidden FROM pragma_table_xinfo(?)"
                    computed += [
                        name
                        for (hidden,) in database.execute(columns, (name,))
                        if hidden
                    ]
    except sqlite3.Error as error:
        raise InputError(str(path), Unquoted(error), "a GeoPackage") from None
    if computed:
        got = f"{computed[0]}, a view or a table with computed columns"
        refuse(str(path), got, "plain tables alone")


def _refuse_many(n_features: int, where: str) -> None:
    """Refuse a layer with too many features."""
    if n_features > MAX_FEATURES:
        refuse(
            where,
            f"more than {MAX_FEATURES:,} features",
            "a part of it; cut it out first",
        )


# ---------- footprints
def read_footprints(path: Path, *, class_name: str = "building") -> SourceMap:
    """Read footprints and raise them to solids.

    Heights come from columns such as ``height``, ``building:levels`` or
    ``min_height``, in metres unless the column (``height_ft``) or the value
    ("40 ft") says otherwise; missing or impossible ones are replaced by the
    defaults of ``data/things.toml``. Third coordinates are ignored.

    Parameters
    ----------
    path : Path
        File to read.
    class_name : str
        Class of features that do not state theirs. Lines become walls if it is
        "wall", or if a column ``class``, ``kind``, ``type`` or ``barrier`` says
        wall, fence or hedge.

    Returns
    -------
    source : SourceMap
        Heights are above ground.

    Raises
    ------
    InputError
        The file cannot be read, has no area, or has coordinates that are not
        finite or do not fit its reference system.
    """
    check_one_of("class_name", class_name, CLASS_NAMES)
    table = read_features(path)
    where = str(path)
    if not table.features:
        refuse(where, "an empty layer", "footprints")
    left_out: Counter[str] = Counter()
    kinds = [_kind(feature, class_name, left_out) for feature in table.features]
    every = zip(table.features, kinds, strict=True)
    # Only areas and walls become solids.
    solid = [(feature, kind) for feature, kind in every if kind is not None]
    if not solid:
        got = "no areas: " + ", ".join(f"{n} {name}" for name, n in left_out.items())
        refuse(where, got, "polygons")
    points = np.concatenate(
        [shapely.get_coordinates(feature.geometry) for feature, _ in solid]
    )
    # Where the layer lies on earth.
    place = georeference(points, table.crs, where=where)
    things: list[Thing] = []
    failed: list[Note] = []
    ids: Counter[str] = Counter()
    for feature, kind in solid:
        named = feature.named
        wanted = next((str(named[key]) for key in _WORDS["ids"] if key in named), "")
        thing_id = unique_id(wanted or feature.where.rpartition(": ")[2], ids)
        try:
            things.append(_raised(feature, kind, thing_id, place))
        except InputError as error:
            failed.append(Note(f"{kind.kind} {thing_id}", str(error)))
    if not things:
        refuse(where, f"no footprint with an area; {failed[0].why}", "polygons")
    return SourceMap(
        name=path.name,
        crs=place.crs,
        source_crs=place.source_crs,
        things=tuple(things),
        skipped=(*place.notes, *counted(left_out, "no area"), *shortened(failed)),
    )


def _kind(
    feature: Feature,
    class_name: str,
    left_out: Counter[str],
) -> ThingKind | None:
    """Kind of a feature; None: it is not solid, which is counted."""
    if feature.geometry is None or feature.geometry.is_empty:
        left_out["rows without geometry"] += 1
        return None
    types = {part.geom_type for part in parts_of(feature.geometry)}
    values = feature.named
    said = kind_from_name(
        " ".join(str(values[key]) for key in _WORDS["kinds"] if key in values)
    )
    if said is not None and said.kind not in ("wall", "fence", "hedge"):
        said = None
    is_line = bool(types & {"LineString", "LinearRing"})
    if "Polygon" in types or (is_line and (said is not None or class_name == "wall")):
        return said or kind_of_class(class_name)
    if is_line:
        left_out["lines"] += 1
    else:
        left_out["points"] += 1
    return None


def _raised(
    feature: Feature,
    kind: ThingKind,
    thing_id: str,
    place: Georeference,
) -> Thing:
    """Feature as a solid; InputError: it has no area.

    Parameters
    ----------
    feature : Feature
        The feature.
    kind : ThingKind
        Its kind.
    thing_id : str
        Id of the thing.
    place : Georeference
        How to bring the file's coordinates into metres.

    Returns
    -------
    thing : Thing
        Lines become strips as thick as their kind.
    """
    # Third coordinates are ignored: heights come from columns.
    flat = shapely.force_2d(feature.geometry)
    where = feature.where
    geometry = shapely.transform(flat, lambda points: place.to_metres(points, where))
    parts = parts_of(geometry)
    style = {"cap_style": "flat", "join_style": "mitre"}
    areas = [one for one in parts if one.geom_type == "Polygon" and not one.is_empty]
    if not areas:
        lines = [one for one in parts if one.geom_type in ("LineString", "LinearRing")]
        strips = [line.buffer(0.5 * kind.thickness_m, **style) for line in lines]
        areas = [part for strip in strips for part in polygons_of(strip)]
    bottom_m, top_m, is_assumed = _span_m(feature.values, kind)
    pieces = [
        extrude_polygon(one, bottom_m=bottom_m, top_m=top_m, where=thing_id)
        for one in areas
    ]
    if not pieces:
        refuse(thing_id, "no area", "a footprint")
    return Thing.of(
        thing_id,
        kind.class_name,
        join(pieces),
        is_height_assumed=is_assumed,
    )


def _span_m(values: Mapping[str, Any], kind: ThingKind) -> tuple[float, float, bool]:
    """Heights of floor and roof above ground.

    Parameters
    ----------
    values : Mapping[str, Any]
        Values of the row, by column.
    kind : ThingKind
        Kind of the thing, for the usual height.

    Returns
    -------
    bottom_m : float
        Height of the floor. [m]
    top_m : float
        Height of the roof. [m]
    is_assumed : bool
        The height of the roof is the usual one.
    """
    defaults = thing_defaults()
    top = _length_m(values, _WORDS["tops"])
    storeys = _length_m(values, _WORDS["storeys"])
    bottom = _length_m(values, _WORDS["bottoms"])
    lowest = _length_m(values, _WORDS["lowest_storeys"])
    if top is None and storeys is not None and 0.0 < storeys <= defaults.max_storeys:
        top = storeys * defaults.storey_height_m
    if top is not None and not 0.0 < top <= defaults.max_height_m:
        top = None
    if bottom is None:
        bottom = (lowest or 0.0) * defaults.storey_height_m
    top_m = kind.height_m
    if top is not None:
        top_m = top
    # A floor above the roof, or below the ground, makes no sense.
    if not 0.0 <= bottom < top_m:
        bottom = 0.0
    return bottom, top_m, top is None


def _length_m(values: Mapping[str, Any], names: Sequence[str]) -> float | None:
    """First finite number of some columns in metres, or None."""
    found: dict[int, float] = {}
    for key, value in values.items():
        column = _column(key)
        base, _, unit = column.rpartition("_")
        # The unit at the end of a column's name: "height_ft".
        scale = 1.0
        if unit in UNITS_M and base:
            column = base
            scale = UNITS_M[unit]
        if column not in names:
            continue
        number = _number(value)
        if number is not None:
            found.setdefault(names.index(column), number * scale)
    if found:
        return found[min(found)]
    return None


def _number(value: Any) -> float | None:
    """Number of a cell, in metres or without a unit; None: it is none.

    A text may be such as "12", "12,5 m" or "40 ft".
    """
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        if abs(value) <= sys.float_info.max:
            return float(value)
        return None
    return parse_length_m(str(value)[:60])


def _column(key: str) -> str:
    """Name of a column in lower case, with _ between words."""
    return (
        re.sub(r"[^0-9a-zäöüß]+", "_", key.strip().lower()[:60])
        .replace("ö", "oe")
        .strip("_")
    )
