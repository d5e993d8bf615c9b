"""Heights of the ground from GeoTIFF rasters (DEM, DTM)."""

from pathlib import Path
from typing import Any

import numpy as np
from pyproj.exceptions import ProjError

from ..arrays import FloatArray
from ..errors import InputError, MissingExtraError, Unquoted
from ..files import open_file
from .georeferences import transform
from .relief import Elevation

_COARSEST_M = 30.0  # the global models; coarser ones know no street
_MIDDLE_M = 60.0  # there must be a height this near to the junction
_LIMITS_M = (-500.0, 9000.0)
_MAX_PIXELS = 4_000_000  # around a junction: of 16 cm, 320 m by 320 m
_MAX_BLOCK_BYTES = 100_000_000  # GDAL unpacks blocks as a whole, and a mask line by line or whole
_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
# GDAL would look at files of any of its formats next to the raster, such as a mask.
_ALONE = {"GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR", "GDAL_PAM_ENABLED": "NO"}
_EXPECTED = "a GeoTIFF of heights"


def read_elevation(path: Path, *, crs: str, middle_m: FloatArray, half_m: float) -> Elevation:
    """Read the heights around a place from a raster.

    Parameters
    ----------
    path : Path
        One band of heights in metres, with a coordinate reference system.
    crs : str
        Of `middle_m` and of what is returned; projected, in metres.
    middle_m : (2,) float
        The place. [m]
    half_m : float
        Half the edge of the square around it that is read. [m]

    Returns
    -------
    elevation : Elevation
        Middles of the pixels that have a height.

    Raises
    ------
    InputError
        The raster is no GeoTIFF, has no reference system or several bands, lies elsewhere, is too
        coarse, too fine or packed in blocks that are too large, or has no height near the place.
    MissingExtraError
        rasterio is not installed.
    """
    try:
        import rasterio
    except ImportError:
        raise MissingExtraError(
            "reading rasters of heights needs rasterio: pip install place-rsus[terrain] "
            "(in a checkout: uv run --extra terrain place-rsus ..)"
        ) from None
    with open_file(path) as file:
        if not file.read(4).startswith(_MAGIC):  # GDAL goes by content: a text may name an address
            raise InputError(str(path), Unquoted("something else"), _EXPECTED)
    if not crs:
        raise InputError(
            "--terrain",
            str(path),
            "a map that says where on earth it lies: --crs says it for one that does not",
        )
    try:
        with rasterio.Env(**_ALONE), rasterio.open(path, driver="GTiff") as raster:
            points = _read(raster, str(path), crs, middle_m, half_m)
    except (rasterio.errors.RasterioError, ProjError) as error:
        why = " ".join(str(error).split())
        raise InputError(str(path), Unquoted(why), _EXPECTED) from None
    return Elevation(name=path.name, points_m=points)


def _read(raster: Any, where: str, crs: str, middle_m: FloatArray, half_m: float) -> FloatArray:
    """Points (n, 3) of an open data set within a square."""
    if raster.count != 1:
        raise InputError(where, Unquoted(f"{raster.count} bands"), "one band, of heights in metres")
    if raster.crs is None:
        raise InputError(where, Unquoted("no coordinate reference system"), "a raster with one")
    own_crs = raster.crs.to_wkt()
    grid = raster.transform
    if not np.linalg.det([[grid.a, grid.b], [grid.d, grid.e]]):
        raise InputError(where, Unquoted("pixels without area"), "a raster that lies on the map")
    sides = np.linspace(-half_m, half_m, 9)
    lattice = middle_m + np.stack(np.meshgrid(sides, sides), axis=-1).reshape(-1, 2)
    to_pixel = ~raster.transform
    columns, rows = _affine(to_pixel, transform(lattice, crs, own_crs))
    if not (np.isfinite(columns).all() and np.isfinite(rows).all()):
        raise InputError(where, Unquoted("another part of the earth"), "heights of the junction")
    left, right = _span(columns, raster.width)
    top, bottom = _span(rows, raster.height)
    if left >= right or top >= bottom:
        raise InputError(
            where, Unquoted("a raster that lies elsewhere"), "one that covers the junction"
        )
    _check_memory(raster, (right - left) * (bottom - top), where)
    column, row = np.meshgrid(np.arange(left, right) + 0.5, np.arange(top, bottom) + 0.5)
    east_north = np.stack(_affine(raster.transform, np.stack([column, row], axis=-1)), axis=-1)
    places = transform(east_north, own_crs, crs)
    size_m = _pixel_m(raster, own_crs, crs, 0.5 * (left + right), 0.5 * (top + bottom))
    if size_m > _COARSEST_M * 1.2:
        raise InputError(
            where,
            Unquoted(f"pixels of {size_m:.0f} m"),
            f"at most {_COARSEST_M:g} m: finer heights",
        )
    band = np.ma.masked_invalid(raster.read(1, window=((top, bottom), (left, right)), masked=True))
    low_m, high_m = _LIMITS_M
    heights = np.ma.filled(band.astype(np.float64), np.nan)
    is_known = np.isfinite(heights)
    if is_known.any() and not (
        low_m <= heights[is_known].min() <= heights[is_known].max() <= high_m
    ):
        raise InputError(
            where,
            Unquoted(f"heights from {heights[is_known].min():g} to {heights[is_known].max():g}"),
            f"metres above the sea, {low_m:g} to {high_m:g}",
        )
    points = np.column_stack([places[is_known], heights[is_known]])
    away_m = np.hypot(*(points[:, :2] - middle_m).T)
    if not (away_m <= _MIDDLE_M).any():
        raise InputError(
            where, Unquoted("no heights at the junction"), f"some within {_MIDDLE_M:g} m of it"
        )
    return points


def _check_memory(raster: Any, n_pixels: int, where: str) -> None:
    """Raise InputError for more pixels around the place, or larger blocks, than rasters have."""
    if n_pixels > _MAX_PIXELS:
        got = Unquoted(f"{n_pixels:,} pixels around the junction")
        raise InputError(where, got, f"at most {_MAX_PIXELS:,}: a coarser raster")
    rows, columns = raster.block_shapes[0]
    n_bytes = rows * columns * np.dtype(raster.dtypes[0]).itemsize
    if any(flag.name == "per_dataset" for flag in raster.mask_flag_enums[0]):
        n_bytes = max(n_bytes, raster.width * raster.height)
    if n_bytes > _MAX_BLOCK_BYTES:
        got = Unquoted(f"blocks of {n_bytes:,} bytes")
        raise InputError(where, got, f"at most {_MAX_BLOCK_BYTES:,}: a tiled GeoTIFF")


def _affine(matrix: Any, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (..., 2) by an affine transformation: its first and second coordinate."""
    x, y = points[..., 0], points[..., 1]
    return (
        matrix.a * x + matrix.b * y + matrix.c,
        matrix.d * x + matrix.e * y + matrix.f,
    )


def _span(values: FloatArray, size: int) -> tuple[int, int]:
    """First and last but one of the pixels that values lie in, one more on each side, inside."""
    return (
        max(int(np.floor(values.min())) - 1, 0),
        min(int(np.ceil(values.max())) + 1, size),
    )


def _pixel_m(raster: Any, own_crs: str, crs: str, column: float, row: float) -> float:
    """Longer edge of a pixel, in metres."""
    corners = np.array([[column, row], [column + 1.0, row], [column, row + 1.0]])
    at = transform(np.stack(_affine(raster.transform, corners), axis=-1), own_crs, crs)
    return float(max(np.hypot(*(at[1] - at[0])), np.hypot(*(at[2] - at[0]))))
