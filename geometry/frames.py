"""Convert between the world frame and CARLA's, glTF's and the earth's.

Only this file flips a sign.
"""

import re
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .arrays import FloatArray
from .errors import InputError, Unquoted
from .poses import Pose, wrap_deg

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

WGS84 = "EPSG:4326"
_FLIP_NORTH = np.array([1.0, -1.0, 1.0])
_PATH = re.compile(r"(?:[=,]\s*@?|^\s*)(?:\w:)?(?:[/\\~]|\.\.?[/\\])")


def from_carla_points(points_carla_m: ArrayLike) -> FloatArray:
    """Points (..., 2 or 3) from CARLA's frame to the world frame.

    CARLA's frame is left-handed, x east and y south; the world frame is east,
    north, up.

    >>> from_carla_points([1.0, 2.0])
    array([ 1., -2.])
    """
    points = np.asarray(points_carla_m, dtype=np.float64)
    return np.asarray(points * _FLIP_NORTH[: points.shape[-1]])


to_carla_points = from_carla_points
"""Points from the world (ENU) to CARLA's left-handed frame."""


def from_carla_yaw(yaw_carla_deg: ArrayLike) -> FloatArray:
    """Yaw from CARLA's sense of rotation to the world's, in (-180, 180].

    CARLA counts clockwise from east, the world frame counter-clockwise.
    """
    return wrap_deg(-np.asarray(yaw_carla_deg, dtype=np.float64))


to_carla_yaw = from_carla_yaw
"""Yaw counter-clockwise from east to clockwise from east (CARLA), in (-180, 180]."""


def from_carla_pose(*, position_m: ArrayLike, yaw_deg: float, pitch_deg: float) -> Pose:
    """Pose from CARLA's frame to the world. Pitch is positive up in both."""
    yaw_deg = float(from_carla_yaw(yaw_deg))
    return Pose(
        position_m=from_carla_points(position_m), yaw_deg=yaw_deg, pitch_deg=pitch_deg
    )


def to_gltf_points(points_m: ArrayLike) -> FloatArray:
    """Points (..., 3) from the world frame to glTF's, in metres.

    glTF has x east, y up and z south.
    """
    points = np.asarray(points_m, dtype=np.float64)
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def from_gltf_points(points_m: ArrayLike) -> FloatArray:
    """Points (..., 3) from glTF's frame to the world frame, in metres.

    glTF has x east, y up and z south.
    """
    points = np.asarray(points_m, dtype=np.float64)
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def parse_crs(declared: "str | CRS") -> "CRS":
    """A coordinate reference system, as a file or a user declares it.

    Raises pyproj's CRSError if it is unknown, or names a file by its path: PROJ would
    open it.

    >>> parse_crs("EPSG:25832").name
    'ETRS89 / UTM zone 32N'
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    if isinstance(declared, str) and _PATH.search(declared):
        raise CRSError("a file, named by its path")
    return CRS.from_user_input(declared)


def to_geographic(points_m: ArrayLike, crs: str) -> FloatArray:
    """Longitude and latitude (WGS 84, degrees), (n, 2), of points of the world frame.

    `points_m` are east, north(, up) in the coordinate reference system `crs`: anything
    that pyproj accepts.
    """
    from pyproj import Transformer

    points = np.asarray(points_m, dtype=np.float64)
    transformer = Transformer.from_crs(parse_crs(crs), "EPSG:4326", always_xy=True)
    longitude_deg, latitude_deg = transformer.transform(points[:, 0], points[:, 1])
    return np.stack([longitude_deg, latitude_deg], axis=1)


def transform(points: ArrayLike, from_crs: str, to_crs: str) -> FloatArray:
    """Points in another reference system: east or longitude first.

    Parameters
    ----------
    points : (..., 2) float
        In the coordinates of `from_crs`.
    from_crs : str
        Reference system of the points.
    to_crs : str
        The one to bring them into.

    Returns
    -------
    points : (..., 2) float
        Infinite where a point cannot be projected.

    Raises
    ------
    InputError
        Pyproj knows no way between the two.
    """
    array = np.asarray(points, dtype=np.float64)
    x, y = _transformer(from_crs, to_crs).transform(array[..., 0], array[..., 1])
    return np.stack([x, y], axis=-1)


# To make one takes longer than to transform most maps.
@lru_cache(maxsize=16)
def _transformer(from_crs: str, to_crs: str) -> "Transformer":
    """Transformer between two reference systems, made once."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    try:
        return Transformer.from_crs(
            parse_crs(from_crs),
            parse_crs(to_crs),
            always_xy=True,
        )
    except ProjError:
        where = f"coordinates from {from_crs[:80]} to {to_crs[:80]}"
        raise InputError(
            where,
            Unquoted("no way"),
            "reference systems that pyproj knows",
        ) from None


def check_crs(crs: str, where: str) -> None:
    """Raise InputError unless pyproj takes a coordinate reference system.

    An empty one is none, which is fine.
    """
    from pyproj.exceptions import CRSError

    try:
        if crs:
            parse_crs(crs)
    except CRSError:
        raise InputError(where, crs, "one that pyproj knows, or none") from None
