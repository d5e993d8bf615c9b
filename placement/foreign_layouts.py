"""Layouts in forms of others: lists of cameras as people have them, and calibrations.

They become units of a layout file, whose fields are checked as those of any other.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geometry.calibrations import calibrated_sensor, read_cameras
from geometry.catalogue import SENSOR_KINDS, Sensor, pick_sensor, sensor_kind
from geometry.errors import InputError, refuse
from geometry.maps.place_lists import (
    PLACE_FIELDS,
    known_columns,
    read_csv_rows,
    read_number,
    read_position,
    tell_unknown,
)
from geometry.scene import Scene
from geometry.tables import pick
from geometry.terrain import ground_height_m

from .candidates import CandidatePose
from .layout import Layout, layout_from_records


# ---------- calibrations of real cameras
def read_calibrations(
    path: Path, *, scene: Scene | None, sensors: Mapping[str, Sensor]
) -> Layout:
    """Layout from calibrations of real cameras, YAML or XML.

    See :mod:`geometry.calibrations`. They have positions and models of their own, so
    that `scene` and `sensors` are not used. Raises InputError if the file cannot be
    read.
    """
    units = []
    for name, camera in read_cameras(path).items():
        sensor, pose = calibrated_sensor(name, camera)
        units.append(CandidatePose(id=name, site_id="", pose=pose, sensor=sensor))
    return Layout(name=path.stem, units=tuple(units))


# ---------- lists of cameras as people have them
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


def _is_list(records: Sequence[Any]) -> bool:
    """True if units are given as people write them, not as a layout file has them."""
    named = [list(one) for one in records if isinstance(one, Mapping)]
    return any(
        _OF_PEOPLE & set(known_columns(names, "", _FIELDS).values()) for names in named
    )


def read_layout_rows(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """Rows of a CSV file with a header, each with where it stands.

    A warning names columns that are not known. Raises InputError for what is no
    CSV, or has no row.
    """
    rows = list(read_csv_rows(path))
    if not rows:
        refuse(str(path), "no units", "one per line")
    names = list(rows[0][1])
    tell_unknown(names, known_columns(names, str(path), _FIELDS), path)
    return rows


def read_list(
    path: Path, *, scene: Scene | None, sensors: Mapping[str, Sensor]
) -> Layout:
    """Layout from a CSV file with a unit in each row, see :func:`unit_record`.

    Raises InputError if the file cannot be read, there is no scene, or a field is
    wrong.
    """
    rows = read_layout_rows(path)
    if scene is None:
        refuse(str(path), "a list of units", "a layout file of place-rsus here")
    records = [unit_record(row, here, scene, sensors) for here, row in rows]
    return layout_from_records(path.stem, records, str(path), sensors=sensors)


def records_of_list(
    records: Sequence[Any], where: str, *, scene: Scene, sensors: Mapping[str, Sensor]
) -> Sequence[Any]:
    """Units as a layout file has them, out of units as people write them.

    Those that are as in a layout file stay. Raises InputError where a unit is no
    object, or a field is wrong.
    """
    if not _is_list(records):
        return records
    units = []
    for index, record in enumerate(records):
        here = f"{where}: layout[{index}]"
        if not isinstance(record, Mapping):
            raise InputError(here, record, "an object with the fields of a unit")
        units.append(unit_record(record, here, scene, sensors))
    return units


def unit_record(
    values: Mapping[str, Any], where: str, scene: Scene, sensors: Mapping[str, Sensor]
) -> dict[str, Any]:
    """A unit as a layout file has it, out of what people write.

    `values` are id; site (may be empty); lat and lon, or x and y in the scene's frame,
    or neither: at the site; height above the ground, or z; bearing clockwise from
    north, or yaw; tilt, positive down, or pitch; model. Case and units at the end of a
    name do not matter. Raises InputError where a field is missing or not of its kind, a
    site or a model is unknown.
    """
    # Columns by what they mean, whatever they are called.
    columns = known_columns(list(values), where, _FIELDS)
    row = {field: values[name] for name, field in columns.items()}
    unit_id, site_id = (str(row.get(name) or "").strip() for name in ("id", "site"))
    if not unit_id:
        refuse(f"{where}: id", "nothing", "a name")
    sites = {site.id: site for site in scene.sites}
    if site_id:
        pick(sites, site_id, f"{where}: site")
    has_place = any(
        row.get(name) not in (None, "") for name in ("x", "y", "lat", "lon")
    )
    if site_id and not has_place:
        position = sites[site_id].position_m[:2]
    else:
        position = read_position(row, where, scene.crs)
    # Heights above the ground become heights in the world frame.
    height_m = _one_of(row, where, ("height", 1.0), ("z", 1.0))
    if read_number(row, "height", where) is not None:
        height_m += float(ground_height_m(scene, np.asarray(position)))
    yaw_deg = _one_of(row, where, ("yaw", 1.0), ("bearing", -1.0))
    if read_number(row, "yaw", where) is None:
        # Counter-clockwise from east.
        yaw_deg = (yaw_deg + 90.0 + 180.0) % 360.0 - 180.0
    model = str(row.get("model") or "").strip()
    if not model:
        refuse(f"{where}: model", "nothing", "a model of the catalogue")
    sensor = sensors.get(model) or pick_sensor(model, f"{where}: model")
    # The record has the fields of a layout file.
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
    row: Mapping[str, Any],
    where: str,
    first: tuple[str, float],
    other: tuple[str, float],
) -> float:
    """Number in one of two fields, times the field's factor.

    Raises InputError unless exactly one of them is given.
    """
    found = [
        (name, factor * value)
        for name, factor in (first, other)
        if (value := read_number(row, name, where)) is not None
    ]
    if len(found) != 1:
        if found:
            got = "both"
        else:
            got = "nothing"
        refuse(f"{where}: {first[0]}", got, f"a number, or {other[0]} in its place")
    return found[0][1] + 0.0
