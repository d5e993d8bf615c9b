"""What poles of a map look like to a ray, and what they can carry: by kind, ``data/sites.toml``."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, float_array
from ..toml_files import load_toml, take, take_list, take_number, take_text
from .model import Pole

_SECTIONS = 10
_CLASSES = {"lamp post": "lamp post"}  # all others look like a signal's pole


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoleKind:
    """A kind of pole, where the map says no more.

    Attributes
    ----------
    height_m, radius_m : float
        Of its body. [m]
    height_range_m : (2,) float
        Lowest and highest mount above the road. [m]
    capacity_units : int
        Sensors that it can carry.
    """

    height_m: float
    radius_m: float
    height_range_m: FloatArray
    capacity_units: int


@cache
def load_pole_kinds() -> dict[str, PoleKind]:
    """All kinds by name, from ``data/sites.toml``."""
    table = load_toml(files(__package__) / "data" / "sites.toml")
    kinds = {}
    for index, entry in enumerate(take_list(table, "kinds", "sites.toml")):
        where = f"sites.toml: kinds[{index}]"
        kinds[take_text(entry, "kind", where)] = PoleKind(
            height_m=take_number(entry, "height_m", where),
            radius_m=take_number(entry, "radius_m", where),
            height_range_m=float_array(
                take_list(entry, "height_range_m", where), (2,), f"{where}.height_range_m"
            ),
            capacity_units=take(entry, "capacity_units", where),
        )
    return kinds


def build_pole_body(pole: Pole) -> tuple[str, FloatArray, NDArray[np.int32]]:
    """Class, vertices (n, 3) and triangles (m, 3) of a pole that stands on the road plane."""
    import trimesh

    kind = load_pole_kinds()[pole.kind]
    height_m = pole.height_m or kind.height_m
    foot = np.append(pole.position_m[:2], 0.0)
    body = trimesh.creation.cylinder(
        radius=kind.radius_m, segment=[foot, foot + [0.0, 0.0, height_m]], sections=_SECTIONS
    )
    class_name = _CLASSES.get(pole.kind, "traffic light")
    return class_name, np.asarray(body.vertices), np.asarray(body.faces, dtype=np.int32)


def mount_range_m(pole: Pole) -> FloatArray:
    """Lowest and highest mount on a pole in metres, (2,): a low pole carries sensors at its top."""
    kind = load_pole_kinds()[pole.kind]
    if pole.height_m is None:
        return kind.height_range_m
    low, high = kind.height_range_m
    top = min(max(high, low), max(pole.height_m, 1.0))
    return np.array([min(low, top), top])
