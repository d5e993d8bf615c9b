"""Lists of cameras as people have them: latitude and longitude, compass bearings, heights."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geometry.catalogue import SENSOR_KINDS, Sensor, pick_sensor, sensor_kind
from geometry.errors import InputError, Unquoted
from geometry.files import pick
from geometry.maps.place_lists import (
    PLACE_FIELDS,
    known_columns,
    read_csv_rows,
    read_number,
    read_position,
    tell_unknown,
)
from geometry.scene import Scene
from geometry.terrain import ground_height_m

_FIELDS = PLACE_FIELDS | {
    "id": ("id", "name", "unit", "camera_id", "nr", "nummer"),
    "site": ("site", "site_id", "pole", "pole_id", "mast"),
    "height": (*PLACE_FIELDS["height"], "mount_height", "mounting_height"),
    "bearing": ("bearing", "azimuth", "azimut", "heading", "compass", "richtung"),
    "yaw": ("yaw",),
    "tilt": ("tilt", "tilt_down", "neigung"),
    "pitch": ("pitch",),
    "model": ("model", "sensor", "modell", *SENSOR_KINDS),
    "fov": ("fov",),
    "latency": ("latency", "latency_s"),
}
_OF_PEOPLE = {"lat", "lon", "height", "bearing", "tilt"}


def is_list(records: Sequence[Any]) -> bool:
    """Whether units are given as people write them, not as a layout file has them."""
    named = [list(one) for one in records if isinstance(one, Mapping)]
    return any(_OF_PEOPLE & set(known_columns(names, "", _FIELDS).values()) for names in named)


def read_layout_rows(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """Rows of a CSV file with a header, each with where it stands; a warning names other columns.

    Raises InputError for what is no CSV, or has no row.
    """
    rows = list(read_csv_rows(path))
    if not rows:
        raise InputError(str(path), Unquoted("no units"), "one per line")
    names = list(rows[0][1])
    tell_unknown(names, known_columns(names, str(path), _FIELDS), path)
    return rows


def unit_record(
    values: Mapping[str, Any], where: str, scene: Scene, sensors: Mapping[str, Sensor]
) -> dict[str, Any]:
    """A unit as a layout file has it, out of what people write.

    Parameters
    ----------
    values : mapping
        id; site (may be empty); lat and lon, or x and y in the scene's frame, or neither: at the
        site; height above the ground, or z; bearing clockwise from north, or yaw; tilt, positive
        down, or pitch; model. Case and units at the end of a name do not matter.
    where : str
        What is read, for error messages.
    scene : Scene
        Says where on earth it lies, how high the ground is, and its sites.
    sensors : mapping of str to Sensor
        Models beside those of the catalogue.

    Raises
    ------
    InputError
        A field is missing or not of its kind, a site or a model is unknown.
    """
    columns = known_columns(list(values), where, _FIELDS)
    row = {field: values[name] for name, field in columns.items()}
    unit_id, site_id = (str(row.get(name) or "").strip() for name in ("id", "site"))
    if not unit_id:
        raise InputError(f"{where}: id", Unquoted("nothing"), "a name")
    sites = {site.id: site for site in scene.sites}
    if site_id:
        pick(sites, site_id, f"{where}: site")
    has_place = any(row.get(name) not in (None, "") for name in ("x", "y", "lat", "lon"))
    if site_id and not has_place:
        position = sites[site_id].position_m[:2]
    else:
        position = read_position(row, where, scene.crs)
    height_m = _one_of(row, where, ("height", 1.0), ("z", 1.0))
    if read_number(row, "height", where) is not None:
        height_m += float(ground_height_m(scene, np.asarray(position)))
    yaw_deg = _one_of(row, where, ("yaw", 1.0), ("bearing", -1.0))
    if read_number(row, "yaw", where) is None:
        yaw_deg = (yaw_deg + 90.0 + 180.0) % 360.0 - 180.0  # counter-clockwise from east
    model = str(row.get("model") or "").strip()
    if not model:
        raise InputError(f"{where}: model", Unquoted("nothing"), "a model of the catalogue")
    sensor = sensors.get(model) or pick_sensor(model, f"{where}: model")
    record = {
        "id": unit_id,
        "site": site_id,
        "x_m": float(position[0]),
        "y_m": float(position[1]),
        "z_m": height_m,
        "yaw_deg": yaw_deg,
        "pitch_deg": _one_of(row, where, ("pitch", 1.0), ("tilt", -1.0)),
        sensor_kind(sensor): model,
    }
    for name, key in (("fov", "fov_deg"), ("latency", "latency_s")):
        value = read_number(row, name, where)
        if value is not None:
            record[key] = value
    return record


def _one_of(
    row: Mapping[str, Any], where: str, first: tuple[str, float], other: tuple[str, float]
) -> float:
    """The number in one of two fields, times the field's factor; exactly one must be given."""
    found = [
        (name, factor * value)
        for name, factor in (first, other)
        if (value := read_number(row, name, where)) is not None
    ]
    if len(found) != 1:
        got = "both" if found else "nothing"
        raise InputError(
            f"{where}: {first[0]}", Unquoted(got), f"a number, or {other[0]} in its place"
        )
    return found[0][1] + 0.0
