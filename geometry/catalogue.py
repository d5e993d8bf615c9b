"""Named sensor models, read from ``data/sensors.toml`` and ``data/lidars.toml``."""

from functools import cache
from importlib.resources import files

from .lidar import LidarModel, load_lidars
from .sensors import CameraModel
from .toml_files import load_toml, pick, take, take_number

Sensor = CameraModel | LidarModel
SENSOR_KINDS = ("camera", "lidar")


@cache
def load_cameras() -> dict[str, CameraModel]:
    """All camera models of the catalogue, by name."""
    table = load_toml(files(__package__) / "data" / "sensors.toml")
    return {
        name: CameraModel(
            name=name,
            width_px=take(entry, "width_px", f"sensors.toml: {name}"),
            height_px=take(entry, "height_px", f"sensors.toml: {name}"),
            **{
                key: take_number(entry, key, f"sensors.toml: {name}")
                for key in ("horizontal_fov_deg", "frame_rate_hz", "near_m", "price_eur")
            },
        )
        for name, entry in table.items()
    }


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
