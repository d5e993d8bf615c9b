"""What a layout's numbers rest on, and what else each of it might be: from a TOML file."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from geometry.errors import InputError, Unquoted
from geometry.toml_files import Table, load_toml, take_list, take_number, take_text

_FILE = "sensitivity.toml"
_REASONS = ("source", "assumption")

# Name to smallest and largest value that can be varied to.
RANGES: Mapping[str, tuple[float, float]] = {
    "latency_s": (0.0, 10.0),
    "n_confirmations": (1.0, 100.0),
    "deceleration_mps2": (0.1, 20.0),
    "packet_loss": (0.0, 1.0),
    "min_box_height_share": (0.01, 100.0),
    "min_iou": (0.0, 0.99),
    "yaw_deg": (-180.0, 180.0),
    "pitch_deg": (-90.0, 90.0),
    "height_m": (-10.0, 10.0),
    "position_m": (-10.0, 10.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumption:
    """Something that a plan takes for granted.

    Attributes
    ----------
    name : str
        One of ``RANGES``; its ending tells the unit.
    values : tuple of float
        What it might be instead, ascending, at least one.
    reason : str
        Where these come from, or why they are likely.
    is_ours : bool
        Whether the reason is an assumption of this project, not a source.
    """

    name: str
    values: tuple[float, ...]
    reason: str
    is_ours: bool


@cache
def load_assumptions() -> tuple[Assumption, ...]:
    """All that is varied, from ``data/sensitivity.toml``."""
    return read_assumptions(load_toml(files(__package__) / "data" / _FILE), _FILE)


def read_assumptions(document: Table, where: str) -> tuple[Assumption, ...]:
    """Assumptions of a document.

    Parameters
    ----------
    document : mapping
        Tables by the names of ``RANGES``, each with ``values`` and either ``source`` or
        ``assumption``.
    where : str
        Its name, for error messages.

    Raises
    ------
    InputError
        An unknown name or key, no value, or one that cannot be.
    """
    return tuple(_read(name, table, f"{where}: {name}") for name, table in document.items())


def _read(name: str, table: Any, where: str) -> Assumption:
    if name not in RANGES:
        raise InputError(where, Unquoted("an unknown assumption"), "one of " + ", ".join(RANGES))
    if not isinstance(table, dict):
        raise InputError(where, table, "a table with values")
    known = ("values", *_REASONS)
    for key in table:
        if key not in known:
            raise InputError(f"{where}.{key}", Unquoted("an unknown key"), ", ".join(known))
    low, high = RANGES[name]
    values = []
    for index, _ in enumerate(entries := take_list(table, "values", where)):
        here = f"{where}.values[{index}]"
        value = take_number({"value": entries[index]}, "value", here)
        if not low <= value <= high:
            raise InputError(here, value, f"{low:g} to {high:g}")
        if name == "n_confirmations" and not value.is_integer():
            raise InputError(here, value, "a whole number of frames")
        values.append(value)
    if not values:
        raise InputError(f"{where}.values", Unquoted("none"), "at least one")
    reasons = [key for key in _REASONS if key in table]
    if len(reasons) != 1:
        got = " and ".join(reasons) or "neither"
        raise InputError(where, Unquoted(got), "either source or assumption")
    return Assumption(
        name=name,
        values=tuple(sorted(set(values))),
        reason=take_text(table, reasons[0], where),
        is_ours=reasons == ["assumption"],
    )
