"""OpenStreetMap data of a place, from a public server."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ...arrays import float_array
from ...atomic_files import write_atomically
from ...errors import InputError, MissingExtraError, Unquoted
from .defaults import DEFAULTS


def fetch_openstreetmap(bbox: ArrayLike, path: Path) -> None:
    """Fetch all of OpenStreetMap within a box, by the Overpass API.

    Parameters
    ----------
    bbox : (4,) float
        West, south, east, north. WGS 84. [deg]
    path : Path
        File to write, as XML; its folder must exist.

    Raises
    ------
    InputError
        The box is none, or too large; or the server does not answer with a map.
    MissingExtraError
        The package for requests over the network is not installed.
    """
    west, south, east, north = box = float_array(bbox, (4,), "bbox")
    online = DEFAULTS["online"]
    size_deg = np.array([east - west, north - south])
    if not ((size_deg > 0.0).all() and (np.abs(box) <= [180.0, 90.0, 180.0, 90.0]).all()):
        raise InputError("bbox", box.tolist(), "west, south, east, north in degrees")
    if size_deg.max() > online["max_size_deg"]:
        raise InputError("bbox", box.tolist(), f"at most {online['max_size_deg']} degrees wide")
    try:
        import requests
    except ImportError:
        raise MissingExtraError(
            "fetching a map needs requests: pip install place-rsus[online] "
            "(in a checkout: uv run --extra online place-rsus ..)"
        ) from None
    timeout_s = online["timeout_s"]
    query = (
        f"[out:xml][timeout:{timeout_s}];nwr({south:.7f},{west:.7f},{north:.7f},{east:.7f});"
        "(._;>;);out body;"
    )
    try:
        answer = requests.post(online["url"], data={"data": query}, timeout=timeout_s)
        answer.raise_for_status()
    except requests.RequestException as error:
        raise InputError(online["url"], Unquoted(error), "a server that answers") from None
    if b"<osm" not in answer.content[:1000]:
        raise InputError(online["url"], Unquoted("no map"), "OpenStreetMap data as XML")
    write_atomically(path, lambda file: file.write(answer.content))
