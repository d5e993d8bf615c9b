"""Named sensor models, read from ``data/sensors.toml`` and ``data/lidars.toml``."""

from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from .errors import InputError, Unquoted
from .files import (
    Table,
    load_toml,
    pick,
    take,
    take_list,
    take_number,
)
from .lidar import LidarModel, load_lidars, read_lidar
from .sensors import CameraModel

Sensor = CameraModel | LidarModel
SENSOR_KINDS = ("camera", "lidar")


@cache
def load_cameras() -> dict[str, CameraModel]:
    """All camera models of the catalogue, by name."""
    table = load_toml(files(__package__) / "data" / "sensors.toml")
    return {name: read_camera(name, entry, "sensors.toml") for name, entry in table.items()}


def read_camera(name: str, entry: Table, source: str) -> CameraModel:
    """Camera model from the fields of a TOML table.

    Parameters
    ----------
    name : str
        Name in the catalogue.
    entry : mapping
        Fields of :class:`geometry.sensors.CameraModel`; fov_range_deg may be missing.
    source : str
        What is being read, for error messages.

    Raises
    ------
    InputError
        A field is missing or not of its kind.
    """
    where = f"{source}: {name}"
    return CameraModel(
        name=name,
        width_px=take(entry, "width_px", where),
        height_px=take(entry, "height_px", where),
        fov_range_deg=_read_fov_range_deg(entry, where),
        **{
            key: take_number(entry, key, where)
            for key in ("horizontal_fov_deg", "frame_rate_hz", "near_m", "price_eur")
        },
    )


def _read_fov_range_deg(entry: Table, where: str) -> tuple[float, float] | None:
    key = "fov_range_deg"
    if key not in entry:
        return None
    numbers = take_list(entry, key, where)
    if len(numbers) != 2:
        raise InputError(f"{where}.{key}", numbers, "[low, high] in degrees")
    low, high = (take_number({key: number}, key, where) for number in numbers)
    return low, high


def load_catalogue(path: Path) -> dict[str, Sensor]:
    """Somebody's own sensor models, by name.

    Parameters
    ----------
    path : Path
        TOML with tables ``[cameras.NAME]`` and ``[lidars.NAME]``, whose fields are those of
        ``data/sensors.toml`` and ``data/lidars.toml``.

    Raises
    ------
    InputError
        The file cannot be read, has no model, or a field is missing or not of its kind.
    """
    table = load_toml(path)
    models: dict[str, Sensor] = {}
    expected = "[cameras.NAME] or [lidars.NAME]"
    for group, entries in table.items():
        if group not in ("cameras", "lidars") or not isinstance(entries, Mapping):
            raise InputError(f"{path}: {group}", Unquoted("it"), expected)
    for kind, group in (("camera", "cameras"), ("lidar", "lidars")):
        for name, entry in table.get(group, {}).items():
            models[name] = read_sensor(name, entry, kind, str(path))
    if not models:
        raise InputError(str(path), Unquoted("no model"), expected)
    return models


def read_sensor(name: str, entry: Any, kind: str, source: str) -> Sensor:
    """Sensor model of a kind from its fields; see :func:`read_camera`."""
    if not isinstance(entry, Mapping):
        raise InputError(f"{source}: {name}", entry, "a table of fields")
    if kind == "lidar":
        return read_lidar(name, entry, source)
    return read_camera(name, entry, source)


def own_sensor_record(sensor: Sensor) -> dict[str, Any] | None:
    """Fields of a model for a file, with its kind; None of one in the catalogue."""
    kind = sensor_kind(sensor)
    known: Mapping[str, Sensor] = load_lidars() if kind == "lidar" else load_cameras()
    if sensor.name in known:
        return None
    fields = {key: value for key, value in asdict(sensor).items() if value is not None}
    return {"kind": kind} | {key: value for key, value in fields.items() if key != "name"}


def sensor_kind(sensor: Sensor) -> str:
    """One of ``SENSOR_KINDS``."""
    return "lidar" if isinstance(sensor, LidarModel) else "camera"


def pick_camera(name: str, where: str) -> CameraModel:
    """Camera model by name; see :func:`pick_sensor`."""
    camera: CameraModel = pick(load_cameras(), name, where)
    return camera


def pick_sensor(name: str, where: str, *, kind: str | None = None) -> Sensor:
    """Sensor model by name.

    Parameters
    ----------
    name : str
        Name in the catalogue.
    where : str
        What named it, for the error message.
    kind : str, optional
        One of ``SENSOR_KINDS``; by default any.

    Returns
    -------
    sensor : CameraModel or LidarModel
        The model.

    Raises
    ------
    InputError
        The name is unknown.
    """
    known: dict[str, Sensor] = {}
    if kind != "lidar":
        known |= load_cameras()
    if kind != "camera":
        known |= load_lidars()
    sensor: Sensor = pick(known, name, where)
    return sensor
