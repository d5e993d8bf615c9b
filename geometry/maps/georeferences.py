"""Coordinate reference systems of map files, and a scene's world frame."""

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..errors import refuse
from ..frames import WGS84, parse_crs, transform
from ..notes import Note
from .source_map import SourceMap

if TYPE_CHECKING:
    from pyproj import CRS


# Of a degree: a centimetre.
_DIGITS = 7
_SPELLINGS: tuple[tuple[str, Callable[[re.Match[str]], str]], ...] = (
    (r"urn:adv:crs:ETRS89_UTM(\d\d)\b.*", lambda match: f"EPSG:258{match[1]}"),
    (r"urn:adv:crs:DE_DHDN_3GK(\d)\b.*", lambda match: f"EPSG:{31464 + int(match[1])}"),
    (r".*epsg\.xml#(\d+)", lambda match: f"EPSG:{match[1]}"),
)
_MAX_TEXT = 20_000
# Twice around the earth.
_MAX_M = 1e8
_MAX_STRETCH = 0.005
# Of the width of an area of use: Bavaria uses UTM 32 two degrees east of it.
_EDGE_SHARE = 0.5
_ORIGIN_M = 1000.0
_MIN_EXTENT_M = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalFrame:
    """World frame of a scene: east, north and up around a point of a map.

    The map is that with the junction. `crs` is a transverse Mercator around the
    point: within a kilometre its metres are those of the tangent plane to a
    hundredth of a millimetre.

    Attributes
    ----------
    crs : str
        For pyproj; empty: the place on earth is unknown.
    map_crs : str
        Of the map with the junction; empty: unknown.
    origin_m : (2,) float
        The point in the map's own coordinates. [m]
    """

    crs: str
    map_crs: str
    origin_m: FloatArray

    def take(self, points_m: ArrayLike, source: SourceMap) -> FloatArray:
        """Points of a map in this frame; heights stay.

        A map without a reference system is taken to lie in the coordinates of the
        map with the junction.

        Parameters
        ----------
        points_m : (..., 2) or (..., 3) float
            Points in the map's coordinates. [m]
        source : SourceMap
            The map that they are from.

        Returns
        -------
        points_m : FloatArray
            Same shape. [m]

        Raises
        ------
        InputError
            Only `source` has a reference system, or points cannot be projected.
        """
        points: FloatArray = np.array(points_m, dtype=np.float64)
        if source.crs and not self.map_crs:
            alike = (
                "a file without a coordinate reference system, as the map with the"
                " junction"
            )
            got = f"coordinates in {source.crs}"
            refuse(source.name, got, f"{alike}; or `crs` for that one")
        if not self.crs:
            points[..., :2] -= self.origin_m
            return points
        points[..., :2] = transform(
            points[..., :2],
            source.crs or self.map_crs,
            self.crs,
        )
        if not np.isfinite(points).all():
            got = f"coordinates that {source.crs or self.map_crs} does not have"
            refuse(
                source.name,
                got,
                "metres within the area of its coordinate reference system",
            )
        return points


def frame_at(source: SourceMap, point_m: ArrayLike) -> LocalFrame:
    """Frame around a point of a map.

    Parameters
    ----------
    source : SourceMap
        The map.
    point_m : (2,) float
        In the map's coordinates; rounded to metres. [m]

    Returns
    -------
    frame : LocalFrame
        Without a CRS if the map has none.

    Raises
    ------
    InputError
        The point is nowhere on earth.
    """
    point: FloatArray = np.array(point_m, dtype=np.float64).round()
    crs = ""
    if source.crs:
        crs = local_crs(point, source.crs, where=source.name)
    return LocalFrame(crs=crs, map_crs=source.crs, origin_m=point)


def local_crs(point_m: ArrayLike, crs: str, *, where: str) -> str:
    """Transverse Mercator around a point, as text for pyproj.

    Parameters
    ----------
    point_m : (2,) float
        In the coordinates of `crs`.
    crs : str
        Reference system of the point.
    where : str
        File and element at hand, for messages.

    Returns
    -------
    crs : str
        In metres, with the point as its origin.

    Raises
    ------
    InputError
        The point is nowhere on earth.
    """
    lon_deg, lat_deg = np.round(transform(point_m, crs, WGS84), _DIGITS)
    if not (np.isfinite([lon_deg, lat_deg]).all() and abs(lat_deg) <= 89.0):
        refuse(
            where,
            f"a junction at {np.asarray(point_m).tolist()}",
            f"a place in {crs}",
        )
    return (
        f"+proj=tmerc +lat_0={lat_deg:.{_DIGITS}f} +lon_0={lon_deg:.{_DIGITS}f} "
        "+k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Georeference:
    """How to bring a file's coordinates into a projected reference system.

    Attributes
    ----------
    crs : str
        Projected, in metres, for pyproj; empty: unknown.
    source_crs : str
        The horizontal part of the declared one; empty: none, or none that fits.
    is_northing_first : bool
        The file's first coordinate is the northing or the latitude.
    z_m : float
        Length of the file's unit of height. [m]
    notes : tuple of Note
        On a declaration that was not followed.
    """

    crs: str
    source_crs: str
    is_northing_first: bool = False
    z_m: float = 1.0
    notes: tuple[Note, ...] = ()

    def to_metres(self, points: ArrayLike, where: str) -> FloatArray:
        """Easting, northing and height of points, in metres.

        Parameters
        ----------
        points : (n, 2) or (n, 3) float
            In the file's coordinates.
        where : str
            File and element at hand, for messages.

        Returns
        -------
        points_m : FloatArray
            In the coordinates of `crs`. [m]

        Raises
        ------
        InputError
            A point is not on earth.
        """
        array: FloatArray = np.array(points, dtype=np.float64)
        if self.is_northing_first:
            array[:, :2] = array[:, 1::-1]
        if self.crs != self.source_crs:
            array[:, :2] = transform(array[:, :2], self.source_crs, self.crs)
        if array.shape[1] > 2:
            array[:, 2] *= self.z_m
        # Also if a coordinate is not finite.
        if not (np.abs(array) < _MAX_M).all():
            got = "coordinates that are not on earth"
            refuse(where, got, f"coordinates in {self.source_crs or 'metres'}")
        return array


def georeference(
    points: ArrayLike,
    declared: "str | CRS | None",
    *,
    where: str,
    follows_authority: bool = False,
) -> Georeference:
    """Find out where a file's coordinates lie on earth.

    Degrees, feet, and projections that stretch are projected to a transverse
    Mercator around the middle of the data; projections in metres stay. An
    unknown reference system, or one of elsewhere, is left out with a note.

    Parameters
    ----------
    points : (n, 2) float
        All points, or the corners of their box.
    declared : 'str | CRS or None'
        Reference system that the file declares; None or empty: none.
    where : str
        File and element at hand, for messages.
    follows_authority : bool
        Coordinates come in the order of the reference system's definition
        (GML), unless only the other lies in its area of use.

    Returns
    -------
    place : Georeference
        Without a CRS if none is known.

    Raises
    ------
    InputError
        Coordinates are not finite, are degrees instead of metres or the
        reverse, or have latitude and longitude, or easting and northing, swapped.
    """
    from pyproj.exceptions import ProjError

    xy = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    if not len(xy):
        return Georeference(crs="", source_crs="")
    if not np.isfinite(xy).all():
        refuse(where, "a coordinate that is not finite", "finite numbers")
    # The box around the data is enough to place them.
    box = np.array([xy.min(axis=0), xy.max(axis=0)])
    if np.abs(box).max() > _MAX_M:
        refuse(where, f"a coordinate of {np.abs(box).max():.3g}", "places on earth")
    try:
        crs = horizontal_crs(declared)
        # It may be well-formed, and its numbers make no sense.
        if crs is not None:
            transform(box[:1], crs_name(crs), WGS84)
    except ProjError:
        crs = None
    if crs is None:
        _refuse_degrees(box, where)
        text = str(declared or "").strip()
        why = "not a known horizontal one: taken as metres without a place on earth"
        note = Note(f"coordinate reference system {text[:80]}", why)
        if not text:
            return Georeference(crs="", source_crs="")
        return Georeference(crs="", source_crs="", notes=(note,))
    name = crs_name(crs)
    z_m = _vertical_unit_m(declared)
    is_swapped = follows_authority and crs.axis_info[0].direction in ("north", "south")
    if crs.is_geographic:
        northing_first = is_swapped
        if is_swapped:
            box = box[:, ::-1]
        _refuse_no_degrees(box, where)
        lonlat = box.mean(axis=0)
    else:
        _refuse_degrees(box, where)
        for northing_first in (
            (is_swapped, not is_swapped) if follows_authority else (False,)
        ):
            middle = (box[:, ::-1] if northing_first else box).mean(axis=0)
            if _is_meant_for(crs, middle):
                break
        else:
            area = "its area"
            if crs.area_of_use:
                area = crs.area_of_use.name
            if not follows_authority and _is_meant_for(crs, middle[::-1]):
                got = f"coordinates around {middle[0]:.0f}, {middle[1]:.0f}"
                refuse(
                    where,
                    got,
                    f"some in {area.removesuffix('.')}: easting and northing swapped?",
                )
            why = (
                f"the coordinates lie outside {area}: taken as metres without a place"
                " on earth"
            )
            note = Note(f"coordinate reference system {name}", why)
            return Georeference(crs="", source_crs="", z_m=z_m, notes=(note,))
        lonlat = None
        if not _is_in_metres(crs, middle):
            lonlat = transform(middle[None, :], name, WGS84)[0]
    # Projections in metres stay; others give way to one around the middle.
    plane = name
    if lonlat is not None:
        plane = local_crs(lonlat, WGS84, where=where)
    return Georeference(
        crs=plane,
        source_crs=name,
        is_northing_first=northing_first,
        z_m=z_m,
    )


def horizontal_crs(declared: "str | CRS | None") -> "CRS | None":
    """Horizontal part of a declared coordinate reference system; None if it has none.

    `declared` is what pyproj takes, or one of the spellings of CityGML files. Raises
    pyproj's ProjError if it is unknown.
    """
    if declared is None or not str(declared).strip():
        return None
    # Take the horizontal part of compound and bound systems.
    crs = parse_crs(_spelling(declared) if isinstance(declared, str) else declared)
    while crs.is_compound or crs.is_bound:
        inner = crs.sub_crs_list[0] if crs.is_compound else crs.source_crs
        if inner is None:
            break
        crs = inner
    crs = crs.to_2d()
    if crs.is_geographic or crs.is_projected:
        return crs
    return None


def why_no_plane(crs: str) -> str:
    """Why pyproj cannot take it as metres on a plane; empty: it can."""
    from pyproj.exceptions import CRSError

    if len(crs) > _MAX_TEXT:
        return f"longer than {_MAX_TEXT} characters"
    try:
        with warnings.catch_warnings():
            # +init=epsg:.. is old, not wrong.
            warnings.simplefilter("ignore")
            system = parse_crs(crs)
    except (CRSError, ValueError, TypeError):
        return "not a coordinate reference system that pyproj knows"
    if system.is_geographic or system.is_geocentric:
        return "degrees or geocentric, while roads are in metres on a plane"
    if not system.is_projected:
        return "no projection"
    units = {round(axis.unit_conversion_factor, 9) for axis in system.axis_info[:2]}
    if units == {1.0}:
        return ""
    return "not in metres"


def crs_name(crs: "CRS") -> str:
    """Shortest text that stands for a reference system: a code, or WKT."""
    authority = crs.to_authority(min_confidence=100)
    if authority:
        return ":".join(authority)
    return crs.to_wkt()


def _spelling(declared: str) -> str:
    """A code that pyproj knows, for spellings that it does not."""
    text = declared.strip()[:_MAX_TEXT]
    found = ((re.fullmatch(pattern, text), code) for pattern, code in _SPELLINGS)
    return next((code(match) for match, code in found if match), text)


def _vertical_unit_m(declared: "str | CRS | None") -> float:
    """Unit of heights in metres: that of the third axis, or else that of the plane."""
    crs = parse_crs(
        _spelling(declared) if isinstance(declared, str) else declared or ""
    )
    axes = [one.unit_conversion_factor for one in crs.axis_info]
    is_plane = len(axes) < 3 and (crs.is_geographic or not axes)
    if is_plane:
        return 1.0
    return float(axes[2 if len(axes) > 2 else 0])


def _refuse_degrees(box: FloatArray, where: str) -> None:
    """Refuse coordinates that must be degrees where metres are meant.

    They lie within -180 to 180 and span less than a metre: no map is so small.
    """
    if (np.abs(box) <= [180.0, 90.0]).all() and (box[1] - box[0] < _MIN_EXTENT_M).all():
        size = " x ".join(f"{length:.6f}" for length in box[1] - box[0])
        expected = (
            "coordinates in metres, or the coordinate reference system that they are in"
        )
        refuse(
            where,
            f"degrees where metres are meant: {size} around {_words(box)}",
            expected,
        )


def _refuse_no_degrees(box: FloatArray, where: str) -> None:
    """Refuse coordinates that cannot be longitude and latitude."""
    if (np.abs(box) <= [180.0, 90.0]).all():
        return
    if (np.abs(box[:, ::-1]) <= [180.0, 90.0]).all():
        got = (
            f"latitude and longitude swapped: a latitude of {np.abs(box[:, 1]).max():g}"
        )
        refuse(where, got, "longitude first, latitude second, in degrees")
    got = (
        "metres or another CRS where degrees are expected: coordinates around"
        f" {_words(box)}"
    )
    expected = (
        "longitude -180 to 180, latitude -90 to 90, or the coordinate reference system"
    )
    refuse(where, got, f"{expected} in the file")


def _words(box: FloatArray) -> str:
    """Middle of a box, for messages."""
    return ", ".join(f"{middle:g}" for middle in box.mean(axis=0))


def _is_meant_for(crs: "CRS", point: FloatArray) -> bool:
    """True if a point lies in a reference system's area of use.

    Beside the area counts, too, except at the origin of the coordinates.
    """
    if crs.area_of_use is None:
        return True
    west, south, east, north = crs.area_of_use.bounds
    lon, lat = transform(point[None, :], crs_name(crs), WGS84)[0]
    if not np.isfinite([lon, lat]).all():
        return False
    # An area of use may lie across the 180th meridian.
    width = east - west
    if east < west:
        width = (east - west) % 360.0
    height = north - south
    # East of the western edge.
    beside = (lon - west + 180.0) % 360.0 - 180.0
    edge = _EDGE_SHARE
    if (np.abs(point) < _ORIGIN_M).all():
        edge = 0.0
    is_beside = -edge * width <= beside and (
        width >= 180.0 or beside <= (1.0 + edge) * width
    )
    return bool(is_beside and south - edge * height <= lat <= north + edge * height)


def _is_in_metres(crs: "CRS", point: FloatArray) -> bool:
    """True if a projection's unit is a metre on the ground at a point."""
    from pyproj import Proj
    from pyproj.exceptions import ProjError

    axes = crs.axis_info
    if any(abs(axis.unit_conversion_factor - 1.0) > 1e-9 for axis in axes):
        return False
    if {axis.direction for axis in axes} != {"east", "north"}:
        return False
    lon, lat = transform(point[None, :], crs_name(crs), WGS84)[0]
    try:
        factors = Proj(crs.to_wkt()).get_factors(lon, lat)
    except ProjError:
        return True
    scales = np.array([factors.meridional_scale, factors.parallel_scale])
    return bool(
        not np.isfinite(scales).all() or (np.abs(scales - 1.0) < _MAX_STRETCH).all()
    )
