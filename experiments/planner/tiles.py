"""Tiles of a map behind the plan, of a server that the user names with ``--tiles``."""

import re
from typing import Any, NamedTuple

import numpy as np

from geometry.arrays import FloatArray
from geometry.errors import InputError
from geometry.frames import to_geographic
from geometry.scene import Scene

_HOST = r"[A-Za-z0-9](?:[A-Za-z0-9.-]*[A-Za-z0-9])?"
_TEMPLATE = re.compile(
    # no ' " < >
    rf"(?P<origin>https?://(?P<host>{_HOST})(?::(?P<port>\d{{1,5}}))?)/[!#-&(-;=?-~]*"
)
_HIGHEST_PORT = 65535
# Around the junction, to each side
_TILES_M = 1500.0
# Points of the grid along each side
_FIT_STEPS = 9
# Of the polynomials
_FIT_ORDER = 3
# Its tiles end a little farther north
_MERCATOR_DEG = 85.0


class TileServer(NamedTuple):
    """Where tiles of a map come from, and whose they are.

    Attributes
    ----------
    template : str
        Address such as ``https://HOST/{z}/{x}/{y}.png``.
    attribution : str
        Text that stands on the plan.
    origin : str
        The only server that the page may ask, such as ``https://HOST``.
    """

    template: str
    attribution: str
    origin: str


def read_tile_server(template: str, attribution: str) -> TileServer:
    """The server of ``--tiles``.

    Parameters
    ----------
    template : str
        What the user gave.
    attribution : str
        Empty: the host's name.

    Raises
    ------
    InputError
        It is no such address.
    """
    found = _TEMPLATE.fullmatch(template)
    names = sorted(re.findall(r"\{(.*?)\}", template))
    is_address = found is not None and int(found["port"] or 0) <= _HIGHEST_PORT
    if found is None or not is_address or names != ["x", "y", "z"]:
        raise InputError(
            "--tiles", template, "an address such as https://HOST/{z}/{x}/{y}.png"
        )
    return TileServer(template, attribution or found["host"], found["origin"])


def tile_frame(scene: Scene) -> dict[str, Any] | None:
    """How tiles lie on the plan of a scene.

    Tiles are squares of Web Mercator: of the whole map, 0 to 1 from west to east and
    from north to south (EPSG:3857, scaled). Around the junction the plan is a
    polynomial of these and they are one of the plan; each is fitted to a grid of 1.5 km
    to all sides, to less than a millimetre.

    Returns
    -------
    dict or None
        For the page: "toPlan" and "toTiles" are the polynomials' coefficients, see
        :func:`_fit`. None: the scene does not say where on earth it lies.
    """
    if not scene.crs:
        return None
    centre_m = scene.outline_m.mean(axis=0)
    steps = np.linspace(-1.0, 1.0, _FIT_STEPS)
    plan = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    lon_deg, lat_deg = to_geographic(centre_m + _TILES_M * plan, scene.crs).T
    if not (np.isfinite(lon_deg).all() and (np.abs(lat_deg) <= _MERCATOR_DEG).all()):
        return None
    north = np.arcsinh(np.tan(np.radians(lat_deg))) / (2.0 * np.pi)
    places = np.column_stack([(lon_deg + 180.0) / 360.0, 0.5 - north])
    middle = places.mean(axis=0)
    size = float(np.abs(places - middle).max())
    tiles = (places - middle) / size

    return {
        "middle": middle.tolist(),
        "size": size,
        "centre": (100.0 * centre_m).tolist(),
        "reach": 100.0 * _TILES_M,
        "toPlan": _fit(tiles, plan),
        "toTiles": _fit(plan, tiles),
    }


def _fit(given: FloatArray, wanted: FloatArray) -> list[list[float]]:
    """Least-squares polynomial of two variables, with two values.

    Parameters
    ----------
    given, wanted : ndarray, shape (n, 2)
        Points, and what the polynomial should be there.

    Returns
    -------
    list of list of float
        A pair of coefficients for each of 1, u, v, u^2, u v, v^2, u^3 ..
    """
    u, v = given.T
    powers = []
    for order in range(_FIT_ORDER + 1):
        for of_u in range(order, -1, -1):
            powers.append(u**of_u * v ** (order - of_u))
    matrix = np.stack(powers, axis=1)
    found: list[list[float]] = np.linalg.lstsq(matrix, wanted)[0].tolist()
    return found
