"""Uncertainties by name, or from a user's TOML file."""

from collections.abc import Callable
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from geometry.actors import Actor, Shape, pick_actor
from geometry.errors import InputError, Unquoted
from geometry.toml_files import Table, load_toml, take, take_list, take_number, take_text

from ..latency import load_latency_budget
from .uncertainty import (
    LatencyJitter,
    MountingErrors,
    StandingTraffic,
    Uncertainty,
    VehicleKind,
)

UNCERTAINTY_NAMES = ("default", "none")
DEFAULT_UNCERTAINTY = UNCERTAINTY_NAMES[0]
_FILE = "uncertainty.toml"
_SECTIONS = ("mounting", "latency", "messages", "detector", "traffic", "vehicles")
_MOUNTING = ("yaw_sd_deg", "pitch_sd_deg", "height_sd_m")
_TRAFFIC = (
    "taken_share",
    "waiting_share",
    "following_share",
    "free_place_m",
    "parked_gap_m",
    "clear_of_mouth_m",
    "waiting_gap_m",
    "crosswalk_gap_m",
    "along_arm_m",
    "clearance_m",
)
_SIZES = ("length_m", "width_m", "height_m")
_SHARES = ("parked_share", "waiting_share")
# Two triangles on each side, outward; corner x + 2 y + 4 z of a box has these bits.
_BOX_TRIANGLES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ]
)  # fmt: skip
_T = TypeVar("_T")


def load_uncertainty(
    name_or_path: str = DEFAULT_UNCERTAINTY, *, where: str = "uncertainty"
) -> Uncertainty:
    """Uncertainty by name or file.

    Parameters
    ----------
    name_or_path : str
        "default", "none", or a ``.toml`` file with the sections of ``data/uncertainty.toml``.
    where : str
        What named it, for error messages.

    Returns
    -------
    uncertainty : Uncertainty
        Checked.

    Raises
    ------
    InputError
        The name is unknown, or the file or a field is not what it should be.
    """
    if name_or_path in UNCERTAINTY_NAMES:
        return _load_named(name_or_path)
    path = Path(name_or_path)
    if path.suffix != ".toml":
        names = ", ".join(UNCERTAINTY_NAMES)
        raise InputError(where, name_or_path, f"{names}, or a .toml file with uncertainties")
    return _read(load_toml(path), path.name, f"{path}: ")


@cache
def _load_named(name: str) -> Uncertainty:
    document = load_toml(files("placement") / "data" / _FILE)
    return _read(take(document, name, _FILE), name, f"{_FILE}: {name}.")


def _read(document: Table, name: str, prefix: str) -> Uncertainty:
    _refuse_unknown(document, _SECTIONS, prefix.rstrip(".: "))
    sections = {key: _section(document, key, prefix) for key in _SECTIONS if key != "vehicles"}
    vehicles = _read_vehicles(document, prefix)
    traffic = sections["traffic"]
    where = f"{prefix}traffic"
    fields: dict[str, Any] = {}
    if traffic is not None:
        _refuse_unknown(traffic, _TRAFFIC, where)
        fields = {key: take_number(traffic, key, where) for key in _TRAFFIC}
    elif vehicles:
        raise InputError(f"{prefix}vehicles", Unquoted("no section traffic"), "where they stand")
    return _named(
        prefix,
        lambda: Uncertainty(
            name=name,
            mounting=_read_mounting(sections["mounting"], f"{prefix}mounting"),
            latency=_read_latency(sections["latency"], f"{prefix}latency"),
            packet_loss=_read_loss(sections["messages"], f"{prefix}messages"),
            draws_detections=_read_is_drawn(sections["detector"], f"{prefix}detector"),
            traffic=_named(f"{where}.", lambda: StandingTraffic(vehicles=vehicles, **fields)),
        ),
    )


def _section(document: Table, key: str, prefix: str) -> Table | None:
    table = document.get(key)
    if table is not None and not isinstance(table, dict):
        raise InputError(f"{prefix}{key}", table, f"a section [{key}]")
    return table


def _read_mounting(table: Table | None, where: str) -> MountingErrors:
    if table is None:
        return MountingErrors()
    _refuse_unknown(table, _MOUNTING, where)
    fields = {key: take_number(table, key, where) for key in _MOUNTING}
    return _named(f"{where}.", lambda: MountingErrors(**fields))


def _read_latency(table: Table | None, where: str) -> LatencyJitter:
    if table is None:
        return LatencyJitter()
    if "budget" in table:
        _refuse_unknown(table, ("budget", "drawn_per"), where)
        budget = load_latency_budget(take_text(table, "budget", where), where=f"{where}.budget")
        fields: dict[str, Any] = {"budget": budget}
    else:
        _refuse_unknown(table, ("distribution", "mean_s", "sd_s", "drawn_per"), where)
        fields = {key: take_number(table, key, where) for key in ("mean_s", "sd_s")}
        fields["distribution"] = take_text(table, "distribution", where)
    fields["drawn_per"] = take_text(table, "drawn_per", where)
    return _named(f"{where}.", lambda: LatencyJitter(**fields))


def _read_loss(table: Table | None, where: str) -> float:
    if table is None:
        return 0.0
    _refuse_unknown(table, ("packet_loss",), where)
    loss = take_number(table, "packet_loss", where)
    if not 0.0 <= loss <= 1.0:
        raise InputError(f"{where}.packet_loss", loss, "0 to 1")
    return loss


def _read_is_drawn(table: Table | None, where: str) -> bool:
    if table is None:
        return False
    _refuse_unknown(table, ("is_drawn",), where)
    is_drawn = take(table, "is_drawn", where)
    if not isinstance(is_drawn, bool):
        raise InputError(f"{where}.is_drawn", is_drawn, "true or false")
    return is_drawn


def _read_vehicles(document: Table, prefix: str) -> tuple[VehicleKind, ...]:
    if "vehicles" not in document:
        return ()
    kinds = []
    for index, entry in enumerate(take_list(document, "vehicles", prefix.rstrip(".: "))):
        where = f"{prefix}vehicles[{index}]"
        if not isinstance(entry, dict):
            raise InputError(where, entry, "a table [[vehicles]]")
        shares = {key: take_number(entry, key, where) for key in _SHARES}
        actor = _read_body(entry, where)
        kinds.append(_named(f"{where}.", partial(VehicleKind, actor=actor, **shares)))
    return tuple(kinds)


def _read_body(entry: Table, where: str) -> Actor:
    if "actor" in entry:
        _refuse_unknown(entry, ("actor", *_SHARES), where)
        actor = pick_actor(take_text(entry, "actor", where), f"{where}.actor")
        if actor.class_name != "parked vehicle":
            raise InputError(f"{where}.actor", actor.name, "a parked vehicle")
        return actor
    _refuse_unknown(entry, ("name", *_SIZES, *_SHARES), where)
    sizes = {key: take_number(entry, key, where) for key in _SIZES}
    name = take_text(entry, "name", where)
    return _named(f"{where}: ", lambda: _build_box(name, **sizes))


def _build_box(name: str, *, length_m: float, width_m: float, height_m: float) -> Actor:
    """A vehicle as a box that reaches down to the road."""
    bits = np.array([[index & 1, index >> 1 & 1, index >> 2] for index in range(8)])
    corners = (bits - [0.5, 0.5, 0.0]) * [length_m, width_m, height_m]
    return Actor(
        name=name,
        class_name="parked vehicle",
        length_m=length_m,
        width_m=width_m,
        height_m=height_m,
        shapes=(Shape(vertices_m=corners, triangles=_BOX_TRIANGLES),),
    )


def _refuse_unknown(table: Table, known: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in known:
            raise InputError(where, key, "one of " + ", ".join(known))


def _named(prefix: str, build: Callable[[], _T]) -> _T:
    """Build a value; what is wrong with it is said with the place where it stands."""
    try:
        return build()
    except InputError as error:
        if error.where.startswith(prefix.rstrip(".: ")):
            raise
        raise InputError(f"{prefix}{error.where}", error.got, error.expected) from None
