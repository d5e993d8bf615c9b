"""Bodies as OpenSCENARIO wants them: kind, box, axles, point of reference."""

import importlib
import math
from functools import cache
from importlib.resources import files
from typing import Any

from geometry.actors import Actor
from geometry.errors import InputError, MissingExtraError
from geometry.toml_files import Table, load_toml, pick, take, take_number, take_text

DECIMALS = 6  # of metres, seconds, radians: what differs in the last bits gives the same file
TABLE = "openscenario.toml"


@cache
def load_xosc() -> Any:
    """The library's module for OpenSCENARIO.

    Raises
    ------
    MissingExtraError
        It is not installed.
    """
    try:
        return importlib.import_module("scenariogeneration.xosc")
    except ImportError:
        raise MissingExtraError(
            "OpenSCENARIO needs scenariogeneration: pip install place-rsus[openscenario]"
        ) from None


@cache
def load_table(name: str) -> Table:
    """Part of ``data/openscenario.toml``: "bodies" or "weather"."""
    table: Table = take(load_toml(files(__package__) / "data" / TABLE), name, TABLE)
    return table


def _body(actor: Actor) -> tuple[Table, str]:
    """What the standard asks for of a body, and where that stands."""
    bodies = load_table("bodies")
    name = actor.name if actor.name in bodies else actor.class_name
    return pick(bodies, name, "class_name"), f"{TABLE}: bodies.{name}"


def _axles_m(actor: Actor) -> tuple[float, float]:
    """Front and rear axle of a vehicle, ahead of the middle of its box."""
    body, where = _body(actor)
    if "wheelbase_m" in body:  # of a bicycle
        front_m = take_number(body, "front_axle_ahead_m", where)
        return front_m, front_m - take_number(body, "wheelbase_m", where)
    if not actor.wheelbase_m > 0.0:
        raise InputError(f"actor {actor.name}.wheelbase_m", actor.wheelbase_m, "> 0 metres")
    return actor.front_axle_ahead_m, actor.front_axle_ahead_m - actor.wheelbase_m


def reference_ahead_m(actor: Actor) -> float:
    """How far a body's point of reference is ahead of the middle of its box.

    Parameters
    ----------
    actor : Actor
        The body.

    Returns
    -------
    ahead_m : float
        The rear axle of cars and bicycles; 0, the middle itself, of pedestrians and walls. [m]

    Raises
    ------
    InputError
        ``data/openscenario.toml`` knows neither its name nor its class, or a car has no axles.
    """
    body, _ = _body(actor)
    return _axles_m(actor)[1] if body["entity"] == "Vehicle" else 0.0


def build_entity(actor: Actor) -> Any:
    """Vehicle, Pedestrian or MiscObject of the library.

    Raises
    ------
    InputError
        See :func:`reference_ahead_m`.
    """
    xosc = load_xosc()
    body, where = _body(actor)
    entity, category = take_text(body, "entity", where), take_text(body, "category", where)
    mass_kg = take_number(body, "mass_kg", where)
    box = xosc.BoundingBox(
        actor.width_m,
        actor.length_m,
        actor.height_m,
        round(-reference_ahead_m(actor), DECIMALS) + 0.0,
        0.0,
        round(0.5 * actor.height_m, DECIMALS),
    )
    kind = getattr(getattr(xosc, f"{entity}Category"), category)
    if entity != "Vehicle":
        return getattr(xosc, entity)(actor.name, mass_kg, kind, box)
    front_m, rear_m = _axles_m(actor)
    wheel_m, track_m = (
        take_number(body, key, where) for key in ("wheel_diameter_m", "track_width_m")
    )
    steering_rad = to_radians(take_number(body, "max_steering_deg", where))
    ahead_m = round(front_m - rear_m, DECIMALS)
    vehicle = xosc.Vehicle(
        actor.name,
        kind,
        box,
        xosc.Axle(steering_rad, wheel_m, track_m, ahead_m, 0.5 * wheel_m),
        xosc.Axle(0.0, wheel_m, track_m, 0.0, 0.5 * wheel_m),
        take_number(body, "max_speed_mps", where),
        take_number(body, "max_acceleration_mps2", where),
        take_number(body, "max_deceleration_mps2", where),
        mass=mass_kg,
    )
    if "note" in body:
        vehicle.add_property("note", take_text(body, "note", where))
    return vehicle


def to_radians(angle_deg: float) -> float:
    """Angle as it stands in the file, in radians."""
    return round(math.radians(angle_deg), DECIMALS) + 0.0
