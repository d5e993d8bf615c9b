"""Named sensor models, read from ``data/sensors.toml``."""

from functools import cache
from importlib.resources import files

from .sensors import CameraModel
from .toml_files import load_toml, pick, take, take_number


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


def pick_camera(name: str, where: str) -> CameraModel:
    """Camera model by name.

    Parameters
    ----------
    name : str
        Name in the catalogue.
    where : str
        What named it, for the error message.

    Returns
    -------
    camera : CameraModel
        The model.

    Raises
    ------
    InputError
        The name is unknown.
    """
    camera: CameraModel = pick(load_cameras(), name, where)
    return camera
