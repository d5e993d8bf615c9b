"""A run as an OpenSCENARIO file, for a simulator that knows the map."""

import importlib
import importlib.metadata
import math
import xml.etree.ElementTree as ET
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import InputError, MissingExtraError, Unquoted, refuse
from geometry.poses import wrap_deg
from geometry.tables import Table, pick
from geometry.terrain import Terrain, on_ground
from geometry.text_formats import load_data
from geometry.weather import pick_weather
from scenarios.runs import Run

from . import load_extra
from .xml import xml_text

VUT = "vut"
VRU = "vru"
# of metres, seconds, radians: what differs in the last bits gives the same file
_DECIMALS = 6
_DISTRIBUTION = "scenariogeneration"
_SCHEMA = "OpenSCENARIO_1_3_1.xsd"
_SPEED_DECIMALS = 3
_SPEED_STEP_S = 1.0e-6
_TURN_DEG = 0.1
# Between two frames: from which turn on, and how often.
_TURN_STEP_S = 0.02
_EPSILON_S = 1.0e-6
_Place = tuple[float, float, float, float]
"""East, north, up [m] and heading [rad] of a point of reference."""


@cache
def load_xosc() -> Any:
    """The library's module for OpenSCENARIO, or MissingExtraError."""
    return load_extra(
        "scenariogeneration.xosc",
        "OpenSCENARIO needs scenariogeneration",
        "openscenario",
    )


@cache
def _tables() -> Table:
    """Bodies and weather as ``data/openscenario.toml`` has them."""
    return load_data("experiments", "openscenario.toml")


def _body(actor: Actor) -> Table:
    """Properties of a body that the standard asks for."""
    bodies = _tables()["bodies"]
    if actor.name in bodies:
        name = actor.name
    else:
        name = actor.class_name
    found: Table = pick(bodies, name, "class_name")
    return found


def _axles_m(actor: Actor) -> tuple[float, float]:
    """Front and rear axle of a vehicle, ahead of the middle of its box."""
    body = _body(actor)
    # Of a bicycle.
    if "wheelbase_m" in body:
        return (
            body["front_axle_ahead_m"],
            body["front_axle_ahead_m"] - body["wheelbase_m"],
        )
    if not actor.wheelbase_m > 0.0:
        raise InputError(
            f"actor {actor.name}.wheelbase_m", actor.wheelbase_m, "> 0 metres"
        )
    return actor.front_axle_ahead_m, actor.front_axle_ahead_m - actor.wheelbase_m


def reference_ahead_m(actor: Actor) -> float:
    """Distance of a body's reference point ahead of its middle, in metres.

    The rear axle of cars, motorcycles and bicycles; 0, the middle, of pedestrians and
    walls. Raises InputError if ``data/openscenario.toml`` does not know it, or a car
    has no axles.
    """
    if _body(actor)["entity"] == "Vehicle":
        return _axles_m(actor)[1]
    return 0.0


def _described(name: str, actor: Actor) -> tuple[str, Actor, Table, Table]:
    """An entity's name, body, entry in the table, and axles."""
    body = {"note": "", **_body(actor)}
    axles = {"middle_m": round(-reference_ahead_m(actor), _DECIMALS) + 0.0}
    if body["entity"] == "Vehicle":
        front_m, rear_m = _axles_m(actor)
        axles["front_m"] = round(front_m - rear_m, _DECIMALS)
        axles["steering_rad"] = _radians(body["max_steering_deg"])
    return name, actor, body, axles


def _radians(angle_deg: float) -> float:
    """Angle as it stands in the file, in radians."""
    return round(math.radians(angle_deg), _DECIMALS) + 0.0


def to_openscenario(run: Run, *, road_network: str) -> str:
    """Run as an OpenSCENARIO 1.3 file.

    Nobody brakes; it ends at the impact.

    XML. Scenario time 0 is the run's first frame. The entities "vut" and "vru" follow
    the run's frames; "obstruction-1" .. stand. The header's properties say what the run
    is; the parameters "impact_time_s" and, unless no braking avoids,
    "last_brake_time_s" are scenario times. The same run gives the same text. Raises
    InputError if there is no road network, or the standard's schema rejects the result.
    Raises MissingExtraError if scenariogeneration is not installed.

    Notes
    -----
    Reference points are those of the standard: the middle of the rear axle of cars and
    bicycles, the middle of the footprint of pedestrians and walls. The gait is left to
    the simulator.

    References
    ----------
    .. [1] ASAM OpenSCENARIO XML 1.3.1, "Coordinate systems" and class reference.
    """
    # Brings the schema.
    load_xosc()
    if not road_network:
        raise InputError("road_network", road_network, "the name of an OpenDRIVE file")
    met = run.encounter
    bodies = [(VUT, met.vut), (VRU, met.vru)]
    bodies += [
        (f"obstruction-{n}", one.actor) for n, one in enumerate(run.obstruction, 1)
    ]
    described = [_described(*one) for one in bodies]
    sky = pick(_tables()["weather"], run.weather, "weather")
    light = pick_weather(run.weather, "weather")
    impact_s = round(-float(run.time_s[0]), _DECIMALS)
    times_s = {"impact_time_s": impact_s}
    is_avoidable = bool(np.isfinite(run.last_brake_time_s))
    if is_avoidable:
        last_s = float(run.last_brake_time_s - run.time_s[0])
        times_s["last_brake_time_s"] = round(last_s, _DECIMALS) + 0.0
    # Clockwise from north.
    text = xml_text(
        "openscenario.xml.j2",
        run=run,
        properties={
            "run": run.id,
            "case": run.case.name,
            "source": run.case.source,
            "approach": run.approach,
            "position": run.position,
            "weather": run.weather,
            "vut_speed_kmh": f"{run.vut_speed_kmh:g}",
            "vru_speed_kmh": f"{run.case.vru_speed_kmh:g}",
            "is_avoidable_by_braking": str(is_avoidable).lower(),
        },
        times_s=times_s,
        road_network=road_network,
        bodies=described,
        sky=sky,
        light=light,
        azimuth_rad=_radians((90.0 - light.sun_yaw_deg) % 360.0),
        elevation_rad=_radians(light.sun_elevation_deg),
        tracks=[_build_track(name, run) for name in (VUT, VRU)],
        standing=[
            _places(
                one.actor,
                one.pose.position_m[None, :2],
                [one.pose.yaw_deg],
                run.terrain,
            )[0]
            for one in run.obstruction
        ],
        end_s=impact_s,
    )
    validate_openscenario(text)
    return text


def validate_openscenario(text: str) -> None:
    """Check a file against the schema of OpenSCENARIO 1.3.1.

    The schema comes with scenariogeneration.

    Raises InputError where it is not XML, or the schema rejects it; or
    MissingExtraError.
    """
    expected = f"XML that {_SCHEMA} accepts"
    try:
        ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError("OpenSCENARIO", Unquoted(error), expected) from None
    lxml = importlib.import_module("lxml.etree")
    schema = _schema()
    parser = lxml.XMLParser(resolve_entities=False)
    if not schema.validate(lxml.fromstring(text.encode(), parser)):
        first = schema.error_log[0]
        refuse(f"OpenSCENARIO: {first.path}", first.message, expected)


@cache
def _schema() -> Any:
    """The schema, which scenariogeneration brings along, as lxml has it."""
    load_xosc()
    for file in importlib.metadata.files(_DISTRIBUTION) or ():
        if file.name == _SCHEMA:
            return importlib.import_module("lxml.etree").XMLSchema(
                file=str(file.locate())
            )
    raise MissingExtraError(
        f"OpenSCENARIO needs {_SCHEMA}, which this {_DISTRIBUTION} lacks: "
        "pip install --force-reinstall place-rsus[openscenario]"
    )


def _build_track(name: str, run: Run) -> dict[str, Any]:
    """An entity's way from the first frame on, and its speed at the end.

    The first frame is time 0.
    """
    # Names of entities are those of the run's fields.
    actor = getattr(run.encounter, name)
    motion = getattr(run.encounter, f"{name}_motion")
    position_m = getattr(run, f"{name}_position_m")
    yaw_deg = getattr(run, f"{name}_yaw_deg")
    first_s, last_s = run.time_s[[0, -1]]
    # Between two frames lies the impact: the last frame may be before it.
    ends_s = [0.0] if last_s < 0.0 else []
    # Simulators drive straight between vertices: more of them where the body turns.
    bounds_s = np.concatenate([run.time_s, ends_s])
    steps_deg = wrap_deg(np.diff(motion.path.at(motion.distance_m(bounds_s))[1]))
    between_s = [
        np.arange(start_s + _TURN_STEP_S, end_s - _EPSILON_S, _TURN_STEP_S)
        for (start_s, end_s), step_deg in zip(
            pairwise(bounds_s), steps_deg, strict=True
        )
        if abs(step_deg) > _TURN_DEG
    ]
    more_s = np.concatenate([*between_s, ends_s])
    more_m, more_deg = motion.path.at(motion.distance_m(more_s))
    time_s = np.concatenate([run.time_s, more_s])
    order = np.argsort(time_s)
    time_s = time_s[order]
    position_m = np.concatenate([position_m, more_m])[order]
    yaw_deg = np.concatenate([yaw_deg, more_deg])[order]
    way_m = np.diff(motion.distance_m(first_s + np.array([0.0, _SPEED_STEP_S])))[0]
    # Without jumps by full turns.
    yaw_deg = np.unwrap(yaw_deg, period=360.0)
    return {
        "name": name,
        "times_s": ((time_s - first_s).round(_DECIMALS) + 0.0).tolist(),
        "places": _places(actor, position_m, yaw_deg, run.terrain),
        "speed_mps": round(float(way_m) / _SPEED_STEP_S, _SPEED_DECIMALS),
    }


def _places(
    actor: Actor, position_m: FloatArray, yaw_deg: ArrayLike, terrain: Terrain | None
) -> list[_Place]:
    """The standard's reference points, of middles of a footprint (n, 2).

    They are on the ground.
    """
    yaw_rad = np.radians(yaw_deg)
    ahead = np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=-1)
    points_m = on_ground(position_m + reference_ahead_m(actor) * ahead, terrain)
    # Adding zero turns -0.0 into 0.0.
    points = (points_m.round(_DECIMALS) + 0.0).tolist()
    return [
        (*at, _radians(yaw))
        for at, yaw in zip(points, np.asarray(yaw_deg), strict=True)
    ]
