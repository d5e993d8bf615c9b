"""Where a map's coordinates lie in the world frame of a scene: metres around its junction."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..errors import InputError, Unquoted
from .model import SourceMap

_DIGITS = 7  # of a degree: a centimetre


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalFrame:
    """East, north and up around a point.

    Attributes
    ----------
    crs : str
        Transverse Mercator around the point, for pyproj: within a kilometre its metres are those
        of the tangent plane to a hundredth of a millimetre. Empty: nobody knows where on earth.
    map_crs : str
        The coordinate reference system of the map that has the junction; empty: unknown.
    origin_m : (2,) float
        The point, in the map's own coordinates. [m]
    """

    crs: str
    map_crs: str
    origin_m: FloatArray

    def take(self, points_m: ArrayLike, source: SourceMap) -> FloatArray:
        """Points of a map in this frame; what is not the first two coordinates stays.

        Parameters
        ----------
        points_m : (..., 2) or (..., 3) float
            In the map's coordinates. [m]
        source : SourceMap
            The map. One that does not say where it lies is taken to lie in the coordinates of the
            map that has the junction.

        Raises
        ------
        InputError
            It says where it lies, but the map that has the junction does not; or it cannot be
            projected.
        """
        points: FloatArray = np.array(points_m, dtype=np.float64)
        if source.crs and not self.map_crs:
            raise InputError(
                source.name,
                Unquoted(f"coordinates in {source.crs}"),
                "a file without a coordinate reference system, as the map with the junction; or "
                "--crs for that one",
            )
        if not self.crs:
            points[..., :2] -= self.origin_m
            return points
        points[..., :2] = transform(points[..., :2], source.crs or self.map_crs, self.crs)
        if not np.isfinite(points).all():
            raise InputError(
                source.name,
                Unquoted(f"coordinates that {source.crs or self.map_crs} does not have"),
                "metres within the area of its coordinate reference system",
            )
        return points


def frame_at(source: SourceMap, point_m: ArrayLike) -> LocalFrame:
    """Frame around a point of a map.

    Parameters
    ----------
    source : SourceMap
        The map that has the junction.
    point_m : (2,) float
        In its coordinates. [m]

    Raises
    ------
    InputError
        The point lies nowhere on earth, in the map's coordinate reference system.
    """
    point: FloatArray = np.array(point_m, dtype=np.float64).round()
    crs = local_crs(point, source.crs, where=source.name) if source.crs else ""
    return LocalFrame(crs=crs, map_crs=source.crs, origin_m=point)


def local_crs(point_m: ArrayLike, crs: str, *, where: str) -> str:
    """Transverse Mercator around a point of another coordinate reference system.

    Raises
    ------
    InputError
        The point lies nowhere on earth.
    """
    lon_deg, lat_deg = np.round(transform(point_m, crs, "EPSG:4326"), _DIGITS)
    if not (np.isfinite([lon_deg, lat_deg]).all() and abs(lat_deg) <= 89.0):
        raise InputError(
            where, Unquoted(f"a junction at {np.asarray(point_m).tolist()}"), f"a place in {crs}"
        )
    return (
        f"+proj=tmerc +lat_0={lat_deg:.{_DIGITS}f} +lon_0={lon_deg:.{_DIGITS}f} "
        "+k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"
    )


def transform(points: ArrayLike, from_crs: str, to_crs: str) -> FloatArray:
    """Points of one coordinate reference system in another, (..., 2): east or longitude first."""
    from pyproj import Transformer

    array = np.asarray(points, dtype=np.float64)
    transformer = Transformer.from_crs(from_crs, to_crs, always_xy=True)
    x, y = transformer.transform(array[..., 0], array[..., 1])
    return np.stack([x, y], axis=-1)
