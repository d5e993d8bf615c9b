"""Features from GIS files: geometries and what their tables say of them."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, Unquoted
from .archives import unpacked
from .georeferences import WGS84
from .json_files import parse_json, read_text
from .xml_files import check_size

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

MAX_FEATURES = 200_000
SUFFIXES = (".geojson", ".json", ".gpkg", ".shp")
_GEOMETRY_TYPES = (
    *("Point", "MultiPoint", "LineString", "MultiLineString", "Polygon", "MultiPolygon"),
    "GeometryCollection",
)
# First bytes of a file: GDAL would take other things under these names too, and follow their links.
_MAGIC = {".gpkg": (b"SQLite format 3\0", "a GeoPackage"), ".shp": (b"\0\0\x27\x0a", "a Shapefile")}
_MAX_GDAL_BYTES = 2_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Feature:
    """One row of a layer.

    Attributes
    ----------
    where : str
        File and row, for messages.
    geometry : shapely geometry, optional
        In the file's coordinates; None if the row has none.
    values : mapping
        Name of a column to its value; missing ones are left out.
    """

    where: str
    geometry: "BaseGeometry | None"
    values: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Features:
    """One layer.

    Attributes
    ----------
    features : tuple of Feature
        Its rows.
    crs : str
        As the file declares it; empty: it does not.
    """

    features: tuple[Feature, ...]
    crs: str


def read_features(path: Path, layer: str | None = None) -> Features:
    """Read one layer of a GeoJSON, GeoPackage or Shapefile, or of a .zip with one of them.

    Parameters
    ----------
    path : Path
        The file.
    layer : str, optional
        Name of a layer of a GeoPackage that has several.

    Raises
    ------
    InputError
        The file cannot be read, is not what its ending says, has several layers and none is
        chosen, or has more than 200,000 features.
    """
    suffix = path.suffix.lower()
    if suffix == ".zip":
        with unpacked(path, SUFFIXES) as member:
            return read_features(member, layer)
    if suffix in (".geojson", ".json"):
        return _read_geojson(path)
    if suffix in _MAGIC:
        return _read_with_gdal(path, layer)
    raise InputError(str(path), suffix, "one of " + ", ".join((*SUFFIXES, ".zip")))


def _read_geojson(path: Path) -> Features:
    """GeoJSON (RFC 7946), and the ``crs`` member that it had before: never through a network."""
    from shapely.errors import ShapelyError
    from shapely.geometry import shape

    where = str(path)
    document = parse_json(read_text(path, "GeoJSON"), where, "GeoJSON")
    kind = document.get("type")
    rows = document.get("features") if kind == "FeatureCollection" else [document]
    if kind not in ("FeatureCollection", "Feature") or not isinstance(rows, list):
        raise InputError(f"{where}: type", kind, "a FeatureCollection with features")
    _refuse_many(len(rows), where)
    features = []
    for index, row in enumerate(rows):
        here = f"{where}: features[{index}]"
        if not isinstance(row, Mapping):
            raise InputError(here, row, "a Feature")
        values, table = row.get("properties") or {}, row.get("geometry")
        if not isinstance(values, Mapping):
            raise InputError(f"{here}.properties", values, "a table")
        values = {str(key): value for key, value in values.items() if value is not None}
        if isinstance(row.get("id"), str | int):
            values.setdefault("id", row["id"])
        geometry = None
        if table is not None:
            if not isinstance(table, Mapping) or table.get("type") not in _GEOMETRY_TYPES:
                raise InputError(f"{here}.geometry", table, "one of " + ", ".join(_GEOMETRY_TYPES))
            try:
                geometry = shape(table)
            except (
                *(ShapelyError, ValueError, TypeError, KeyError, IndexError, AttributeError),
                *(OverflowError, RecursionError),
            ):
                raise InputError(
                    f"{here}.geometry",
                    Unquoted(f"a broken {table['type']}"),
                    "finite coordinates, rings of four or more, nested as its type asks for",
                ) from None
        features.append(Feature(where=here, geometry=geometry, values=values))
    return Features(features=tuple(features), crs=_geojson_crs(document.get("crs"), where))


def _geojson_crs(table: Any, where: str) -> str:
    """Reference system of a GeoJSON file; without a word it is WGS 84."""
    if table is None:
        return WGS84
    properties = table.get("properties") if isinstance(table, Mapping) else None
    name = properties.get("name") if isinstance(properties, Mapping) else None
    if not isinstance(name, str) or not name:
        raise InputError(f"{where}: crs", table, "a named one, or none for WGS 84")
    return name


def _read_with_gdal(path: Path, layer: str | None) -> Features:
    """GeoPackage and Shapefile."""
    import pandas as pd
    import pyogrio
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError, FieldError
    from shapely.errors import ShapelyError

    where = str(path)
    magic, name = _MAGIC[path.suffix.lower()]
    try:
        check_size(path, _MAX_GDAL_BYTES)
        with path.open("rb") as file:
            if file.read(len(magic)) != magic:
                raise InputError(where, Unquoted("something else"), name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # rings left open and the like, which GDAL mends
            layers = [str(found) for found in pyogrio.list_layers(path)[:, 0]]
            if layer is None and len(layers) != 1:
                raise InputError(where, Unquoted(f"{len(layers)} layers"), _one_of(layers))
            if layer is not None and layer not in layers:
                raise InputError(f"{where}: layer", layer, _one_of(layers))
            if pyogrio.read_info(path, layer=layer)["geometry_type"] is None:
                raise InputError(where, Unquoted("a table without geometries"), name)
            table = pyogrio.read_dataframe(path, layer=layer, max_features=MAX_FEATURES + 1)
    except OSError as error:
        raise InputError(where, Unquoted(error.strerror or error), "a readable file") from None
    except (
        *(DataLayerError, DataSourceError, FeatureError, FieldError, ShapelyError),
        *(UnicodeError, TypeError, RuntimeError, OverflowError, pd.errors.OutOfBoundsDatetime),
    ) as error:
        raise InputError(where, Unquoted(_one_line(error)), name) from None
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(where, Unquoted(_one_line(error)), name) from None
    _refuse_many(len(table), where)
    geometries = table.geometry.to_numpy()
    columns = {str(column): table[column] for column in table.columns if column != "geometry"}
    has_value = {column: series.notna().to_numpy() for column, series in columns.items()}
    values = {column: series.to_numpy() for column, series in columns.items()}
    features = [
        Feature(
            where=f"{where}: row {index + 1}",
            geometry=geometry,
            values={
                column: _plain(values[column][index])
                for column, known in has_value.items()
                if known[index]
            },
        )
        for index, geometry in enumerate(geometries)
    ]
    return Features(features=tuple(features), crs="" if table.crs is None else table.crs.to_wkt())


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _one_of(layers: list[str]) -> str:
    return "one layer, by name: " + ", ".join(layers[:20]) if layers else "a layer"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def _refuse_many(n_features: int, where: str) -> None:
    if n_features > MAX_FEATURES:
        raise InputError(
            where,
            Unquoted(f"more than {MAX_FEATURES:,} features"),
            "a part of it; cut it out first",
        )
