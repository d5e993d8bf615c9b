"""Named sensor models, read from ``data/sensors.toml`` and ``data/lidars.toml``."""

from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from msgspec import to_builtins

from .errors import InputError, refuse
from .lidar import LidarModel, load_lidars
from .sensors import CameraModel
from .tables import pick, read_tables
from .text_formats import load_data, load_toml

Sensor = CameraModel | LidarModel
_KINDS: dict[str, type[CameraModel] | type[LidarModel]] = {
    "camera": CameraModel,
    "lidar": LidarModel,
}
SENSOR_KINDS = tuple(_KINDS)
_LENS_FIELDS = (
    *("distortion", "distortion_coefficients", "kappa", "kappa1"),
    *("k1", "k2", "k3", "k4", "p1", "p2"),
)


@cache
def load_cameras() -> dict[str, CameraModel]:
    """All camera models of the catalogue, by name."""
    table = load_data(__package__, "sensors.toml")
    return read_tables(table, CameraModel, "sensors.toml")


def load_catalogue(path: str | Path) -> dict[str, Sensor]:
    """A user's own sensor models, by name.

    Parameters
    ----------
    path : Path
        TOML with tables ``[cameras.NAME]`` and ``[lidars.NAME]``, whose fields are
        those of ``data/sensors.toml`` and ``data/lidars.toml``.

    Raises
    ------
    InputError
        The file cannot be read, has no model, or a field is missing or not of its kind.
    """
    table = load_toml(Path(path))
    models: dict[str, Sensor] = {}
    expected = "[cameras.NAME] or [lidars.NAME]"
    for group, entries in table.items():
        if group not in ("cameras", "lidars") or not isinstance(entries, Mapping):
            refuse(f"{path}: {group}", "it", expected)
    # Terms outside of the lens's own table would be ignored without a word.
    for name, entry in table.get("cameras", {}).items():
        _check_lens(entry, f"{path}: cameras.{name}")
    for kind, group in (("camera", "cameras"), ("lidar", "lidars")):
        models |= read_tables(table.get(group, {}), _KINDS[kind], str(path))
    if not models:
        refuse(str(path), "no model", expected)
    return models


def read_sensor(name: str, entry: Any, kind: str, source: str) -> Sensor:
    """Sensor model of a kind from its fields; `source` names the file in messages."""
    if kind == "camera":
        _check_lens(entry, f"{source}: {name}")
    return read_tables({name: entry}, _KINDS[kind], source)[name]


def _check_lens(entry: Any, where: str) -> None:
    """Refuse terms of a lens that stand outside its own table.

    Other fields that mean nothing are ignored.
    """
    if isinstance(entry, Mapping) and (
        named := [one for one in _LENS_FIELDS if one in entry]
    ):
        expected = 'no such field here, but lens = {model = "brown-conrady", k1 = ..}'
        raise InputError(f"{where}.{named[0]}", entry[named[0]], expected)


def own_sensor_record(sensor: Sensor) -> dict[str, Any] | None:
    """Fields of a model for a file, with its kind; None of one in the catalogue."""
    kind = sensor_kind(sensor)
    known: Mapping[str, Sensor] = load_lidars() if kind == "lidar" else load_cameras()
    if sensor.name in known:
        return None
    fields = {key: value for key, value in asdict(sensor).items() if value is not None}
    if "lens" in fields:
        fields["lens"] = to_builtins(fields["lens"])
    return {"kind": kind} | {
        key: value for key, value in fields.items() if key != "name"
    }


def sensor_kind(sensor: Sensor) -> str:
    """One of ``SENSOR_KINDS``."""
    if isinstance(sensor, LidarModel):
        return "lidar"
    return "camera"


def pick_camera(name: str, where: str) -> CameraModel:
    """Camera model by name; see :func:`pick_sensor`."""
    return pick(load_cameras(), name, where)


def pick_sensor(name: str, where: str, *, kind: str | None = None) -> Sensor:
    """Sensor model by name.

    `kind` is one of ``SENSOR_KINDS``; without it, models of all kinds count.

    Raises
    ------
    InputError
        No model has this name.
    """
    known: dict[str, Sensor] = {}
    if kind != "lidar":
        known |= load_cameras()
    if kind != "camera":
        known |= load_lidars()
    return pick(known, name, where)
