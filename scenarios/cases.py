"""Test cases, from ``data/cases.toml``: a new case is a new table there, not new code."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from geometry.actors import Actor, pick_actor
from geometry.errors import InputError
from geometry.toml_files import load_toml, take, take_number, take_text

KINDS = ("crossing", "longitudinal")


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A Euro NCAP AEB VRU case.

    Attributes
    ----------
    name : str
        Name.
    label, title : str
        The study's label; what happens, in words.
    kind : str
        "crossing" or "longitudinal".
    vru : Actor
        The vulnerable road user's body.
    vru_speed_kmh : float
        Constant. [km/h]
    vut_speeds_kmh : tuple of float
        Speeds to be driven. [km/h]
    impact_percent : float
        Where the VRU meets the VUT's width: 0 = right edge, 100 = left edge. [%]
    """

    name: str
    label: str
    title: str
    kind: str
    vru: Actor
    vru_speed_kmh: float
    vut_speeds_kmh: tuple[float, ...]
    impact_percent: float


@cache
def load_cases() -> dict[str, Case]:
    """All cases, by name."""
    table = load_toml(files(__package__) / "data" / "cases.toml")
    cases = {}
    for name, entry in table.items():
        where = f"cases.toml: {name}"
        kind = take_text(entry, "kind", where)
        if kind not in KINDS:
            raise InputError(f"{where}.kind", kind, "one of " + ", ".join(KINDS))
        speeds = take(entry, "vut_speed_kmh", where)
        if not isinstance(speeds, Mapping):
            raise InputError(f"{where}.vut_speed_kmh", speeds, "a table with min, max and step")
        low, high, step = (
            take_number(speeds, key, f"{where}.vut_speed_kmh") for key in ("min", "max", "step")
        )
        if not (0.0 < low <= high and step > 0.0):
            raise InputError(f"{where}.vut_speed_kmh", dict(speeds), "0 < min <= max, step > 0")
        cases[name] = Case(
            name=name,
            label=take_text(entry, "label", where),
            title=take_text(entry, "title", where),
            kind=kind,
            vru=pick_actor(take_text(entry, "vru_actor", where), f"{where}.vru_actor"),
            vru_speed_kmh=take_number(entry, "vru_speed_kmh", where),
            vut_speeds_kmh=tuple(np.arange(low, high + 0.5 * step, step).tolist()),
            impact_percent=take_number(entry, "impact_percent", where),
        )
    return cases
