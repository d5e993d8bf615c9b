"""What a city brings beside its maps: areas, and counts at places, such as accidents or cars."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray
from ..errors import InputError, Unquoted
from .georeferences import horizontal_crs, transform
from .gis_files import Feature, Features, read_features
from .site_files import read_csv_rows, read_place

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

_COUNTS = ("weight", "count", "accidents", "aadt", "traffic", "value")
_NAMES = ("name", "id", "district", "title")
_JUNCTIONS = ("junction", "junction_id")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Area:
    """A polygon, or a place that something is near to."""

    where: str  # file and row, for messages
    name: str
    geometry: "BaseGeometry"  # in the coordinates of the map
    values: Mapping[str, Any]  # by the name of the column, in lower case


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
    """Read areas from GeoJSON, GeoPackage or Shapefile into a map's coordinates.

    Raises InputError if the file cannot be read, has no geometry, or the map does not say where on
    earth it lies.
    """
    table = read_features(path)
    areas = [
        Area(
            where=feature.where,
            name=_name(feature, f"area {number}"),
            geometry=_projected(feature, table, crs),
            values={key.strip().lower(): value for key, value in feature.values.items()},
        )
        for number, feature in enumerate(table.features, start=1)
        if feature.geometry is not None and not feature.geometry.is_empty
    ]
    if not areas:
        raise InputError(str(path), Unquoted("no geometry"), "polygons")
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
        Of the counts; empty: "weight", "count" or the like, and where there is none, each place
        counts 1.

    Raises
    ------
    InputError
        The file cannot be read; there is no such column, or no place; a count is no number of at
        least 0.
    """
    if path.suffix.lower() == ".csv":
        rows = list(read_csv_rows(path))
        places = None
    else:
        table = read_features(path)
        rows = [(feature.where, dict(feature.values)) for feature in table.features]
        places = [_point(feature, table, crs) for feature in table.features]
    if not rows:
        raise InputError(str(path), Unquoted("nothing"), "a row for each place")
    names = {str(name): str(name).strip().lower() for _, values in rows for name in values}
    found = _column(names, column, path)
    values = np.array([_count(row, found, where) for where, row in rows])
    if places is not None:
        return Counts(
            positions_m=np.array(places).reshape(-1, 2), junctions=(), values=values, column=found
        )
    by = next((name for name, plain in names.items() if plain in _JUNCTIONS), None)
    if by is not None:
        junctions = tuple(str(row[by]).strip() for _, row in rows)
        return Counts(positions_m=None, junctions=junctions, values=values, column=found)
    return Counts(
        positions_m=np.array([read_place(row, where, crs) for where, row in rows]),
        junctions=(),
        values=values,
        column=found,
    )


def _column(names: Mapping[str, str], column: str, path: Path) -> str:
    if column:
        if column not in names:
            known = ", ".join(sorted(names)) or "none"
            raise InputError(f"{path}: column", column, f"one of {known}")
        return column
    plain = {lower: name for name, lower in names.items()}
    return next((plain[name] for name in _COUNTS if name in plain), "")


def _count(row: Mapping[str, Any], column: str, where: str) -> float:
    if not column:
        return 1.0
    value = row.get(column)
    try:
        number = np.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = np.nan
    if not (np.isfinite(number) and number >= 0.0):
        raise InputError(f"{where}: {column}", value, "a number, at least 0")
    return number


def _point(feature: Feature, table: Features, crs: str) -> FloatArray:
    if feature.geometry is None or feature.geometry.is_empty:
        raise InputError(f"{feature.where}.geometry", Unquoted("nothing"), "a Point")
    middle = _projected(feature, table, crs).centroid
    return np.array([middle.x, middle.y])


def _projected(feature: Feature, table: Features, crs: str) -> "BaseGeometry":
    """A feature's geometry in a map's coordinates."""
    import shapely
    from pyproj.exceptions import ProjError

    assert feature.geometry is not None
    if not crs:
        raise InputError(
            feature.where,
            Unquoted(f"coordinates in {table.crs[:80] or 'an unknown system'}"),
            "a map that says where on earth it lies: --crs",
        )
    try:
        declared = horizontal_crs(table.crs)
    except ProjError:
        declared = None
    if declared is None:
        raise InputError(f"{feature.where}: crs", table.crs[:80], "a code that pyproj knows")
    moved: BaseGeometry = shapely.transform(
        shapely.force_2d(feature.geometry),
        lambda points: transform(points, declared.to_wkt(), crs),
    )
    if not np.isfinite(shapely.get_coordinates(moved)).all():
        raise InputError(feature.where, Unquoted("a place that is nowhere"), f"places in {crs}")
    return moved


def _name(feature: Feature, otherwise: str) -> str:
    plain = {str(key).strip().lower(): value for key, value in feature.values.items()}
    return next((str(plain[name]) for name in _NAMES if name in plain), otherwise)


def snap(
    points_m: FloatArray, junctions_m: FloatArray, *, within_m: float
) -> tuple[FloatArray, FloatArray]:
    """Nearest junction of each point, (n,), -1: none so near; and how far it is, (n,) metres."""
    from scipy.spatial import cKDTree

    found, nearest = cKDTree(junctions_m).query(points_m)
    distance: FloatArray = np.asarray(found)
    return np.where(distance <= within_m, nearest, -1), distance


def areas_of(
    areas: Sequence[Area], points_m: FloatArray, *, within_m: float = 0.0
) -> list[list[int]]:
    """Indices of the areas that each point lies in, or no farther from than some metres."""
    import shapely

    tree = shapely.STRtree([area.geometry for area in areas])
    points = shapely.points(points_m)
    point, area = tree.query(points, predicate="dwithin", distance=within_m)
    found: list[list[int]] = [[] for _ in points_m]
    for index, one in sorted(zip(point.tolist(), area.tolist(), strict=True)):
        found[index].append(one)
    return found
