"""Largest values of sensors and sites, from ``data/limits.toml``."""

from functools import cache
from importlib.resources import files

from msgspec import Struct

from .files import load_toml, read_table


class _Limits(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    camera_pixels: int
    lidar_points_per_frame: int
    price_eur: float
    capacity_units: int


@cache
def load_limits() -> _Limits:
    """All of them."""
    name = "limits.toml"
    return read_table(load_toml(files(__package__) / "data" / name), _Limits, name)
