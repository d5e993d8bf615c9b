"""Where on earth a file lies, and how its coordinates are shifted to get there."""

import math
import warnings
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from ...arrays import FloatArray
from .attributes import take_number_or
from .omissions import Omissions

_MAX_CRS_CHARACTERS = 20_000
# They speak of heights, and name grids that need not be at hand.
_VERTICAL_PARAMETERS = ("+geoidgrids=", "+vunits=", "+vto_meter=", "+geoid_crs=")


@dataclass(frozen=True, slots=True, kw_only=True)
class Offset:
    """From the coordinates of a file to those of its projection.

    Attributes
    ----------
    x_m, y_m, z_m : float
        [m]
    heading_rad : float
        About the vertical, applied first. [rad]

    References
    ----------
    .. [1] ASAM OpenDRIVE 1.8, "Georeferencing": x' = x cos(hdg) - y sin(hdg) + xOffset,
       y' = x sin(hdg) + y cos(hdg) + yOffset, z' = z + zOffset.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    heading_rad: float = 0.0

    def apply(self, points_m: FloatArray) -> FloatArray:
        """Points (n, 2) in the projection."""
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        moved: FloatArray = points_m @ np.array([[cos, sin], [-sin, cos]]) + [self.x_m, self.y_m]
        return moved


def read_offset(root: Element, where: str) -> Offset:
    """Offset of a document's header; none: all zero.

    Raises
    ------
    InputError
        A number is not finite.
    """
    element = root.find("header/offset")
    if element is None:
        return Offset()
    x_m, y_m, z_m, heading = (
        take_number_or(element, key, f"{where}: header offset", 0.0)
        for key in ("x", "y", "z", "hdg")
    )
    return Offset(x_m=x_m, y_m=y_m, z_m=z_m, heading_rad=heading)


def read_crs(root: Element, omissions: Omissions) -> tuple[str, str]:
    """Coordinate reference system of a document.

    Returns
    -------
    crs : str
        For pyproj, projected and in metres, without what it says about heights; empty: the file
        names none, or one that is no such thing (noted in `omissions`).
    source_crs : str
        What the file says, or of CARLA's maps means.
    """
    element = root.find("header/geoReference")
    source = "" if element is None else " ".join("".join(element.itertext()).split())
    if not source:
        return "", ""
    source = _with_projection(source)
    crs = _without_heights(source)
    why = _why_not(crs)
    if why:
        omissions.add("geoReferences", f"geoReference {source[:120]}", why)
        return "", source
    return crs, source


def _without_heights(source: str) -> str:
    if not source.startswith("+"):
        return source
    return " ".join(word for word in source.split() if not word.startswith(_VERTICAL_PARAMETERS))


def _with_projection(crs: str) -> str:
    """CARLA writes the point alone (+lat_0=49 +lon_0=8) and means a transverse Mercator there."""
    words = [word.partition("=")[0] for word in crs.split()]
    if set(words) != {"+lat_0", "+lon_0"}:
        return crs
    return f"+proj=tmerc {crs} +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"


def _why_not(crs: str) -> str:
    """Why pyproj cannot take it as metres on a plane; empty: it can."""
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    if len(crs) > _MAX_CRS_CHARACTERS:
        return f"longer than {_MAX_CRS_CHARACTERS} characters"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # +init=epsg:.. is old, not wrong
            system = CRS.from_user_input(crs)
            if system.is_geographic or system.is_geocentric:
                return "degrees or geocentric, while roads are in metres on a plane"
            if not system.is_projected:
                return "no projection"
            units = {round(axis.unit_conversion_factor, 9) for axis in system.axis_info[:2]}
    except (CRSError, ValueError, TypeError):
        return "not a coordinate reference system that pyproj knows"
    return "" if units == {1.0} else "not in metres"
