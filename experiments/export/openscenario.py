"""A run as an OpenSCENARIO file, for a simulator that knows the map."""

import datetime as dt
import importlib
import importlib.metadata
import math
import warnings
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import InputError, MissingExtraError, Unquoted
from geometry.files import Table, load_data, pick, take, take_number, take_text
from geometry.poses import wrap_deg
from geometry.terrain import Terrain, on_ground
from geometry.weather import pick_weather
from scenarios.runs import Run

# ---------- bodies: kind, box, axles, point of reference


DECIMALS = 6  # of metres, seconds, radians: what differs in the last bits gives the same file
TABLE = "openscenario.toml"


@cache
def load_xosc() -> Any:
    """The library's module for OpenSCENARIO, or MissingExtraError."""
    try:
        return importlib.import_module("scenariogeneration.xosc")
    except ImportError:
        raise MissingExtraError(
            "OpenSCENARIO needs scenariogeneration: pip install place-rsus[openscenario]"
        ) from None


@cache
def load_table(name: str) -> Table:
    """Part of ``data/openscenario.toml``: "bodies" or "weather"."""
    table: Table = take(load_data("experiments", TABLE), name, TABLE)
    return table


def _body(actor: Actor) -> tuple[Table, str]:
    """Properties of a body that the standard asks for, and their place."""
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
    """Distance of a body's point of reference ahead of the middle of its box, in metres.

    The rear axle of cars, motorcycles and bicycles; 0, the middle, of pedestrians and walls. Raises
    InputError if ``data/openscenario.toml`` does not know it, or a car has no axles.
    """
    body, _ = _body(actor)
    return _axles_m(actor)[1] if body["entity"] == "Vehicle" else 0.0


def build_entity(actor: Actor) -> Any:
    """Vehicle, Pedestrian or MiscObject of the library."""
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


# ---------- the file


VUT, VRU = "vut", "vru"
_DISTRIBUTION, _SCHEMA, _MINOR = "scenariogeneration", "OpenSCENARIO_1_3_1.xsd", 3
# The header must have a date, and the same run gives the same file.
_UNDATED = dt.datetime(1970, 1, 1)
_SPEED_DECIMALS = 3
_SPEED_STEP_S = 1.0e-6
_TURN_DEG, _TURN_STEP_S = 0.1, 0.02  # between two frames: from which turn on, and how often
_EPSILON_S = 1.0e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Track:
    """Places of a body's reference point, from the first frame (time 0) to the impact."""

    name: str  # of the entity
    time_s: FloatArray  # (n,); ascending
    position_m: FloatArray  # (n, 3); world frame
    yaw_deg: FloatArray  # (n,); without jumps by full turns
    speed_mps: float  # with which it leaves the first frame


def to_openscenario(run: Run, *, road_network: str, after_s: float = 0.0) -> str:
    """Run as an OpenSCENARIO 1.3 file: nobody brakes; it ends at the impact, or `after_s` later.

    XML. Scenario time 0 is the run's first frame. The entities "vut" and "vru" follow the run's
    frames; "obstruction-1" .. stand. The header's properties say what the run is; the parameters
    "impact_time_s" and, unless no braking avoids, "last_brake_time_s" are scenario times. The same
    run gives the same text. Raises InputError if there is no road network, or the standard's schema
    rejects the result. Raises MissingExtraError if scenariogeneration is not installed.

    Notes
    -----
    Reference points are those of the standard: the middle of the rear axle of cars and bicycles,
    the middle of the footprint of pedestrians and walls. The gait is left to the simulator.

    References
    ----------
    .. [1] ASAM OpenSCENARIO XML 1.3.1, "Coordinate systems" and class reference.
    """
    if not road_network:
        raise InputError("road_network", road_network, "the name of an OpenDRIVE file")
    version = load_xosc().VersionBase()
    minor_before = version.version_minor
    version.setVersion(minor=_MINOR)  # of the whole library: others may write another one
    try:
        element = _build_element(run, road_network, after_s)
    finally:
        version.setVersion(minor=minor_before)
    for action in element.iter("LightStateAction"):
        # 0.16.7 writes the two children the wrong way round.
        action[:] = sorted(action, key=lambda child: child.tag != "LightType")
    ET.indent(element, space="  ")
    text = ET.tostring(element, encoding="unicode")
    validate_openscenario(text)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def validate_openscenario(text: str) -> None:
    """Check a file against the schema of OpenSCENARIO 1.3.1, which comes with scenariogeneration.

    Raises InputError where it is not XML, or the schema rejects it; or MissingExtraError.
    """
    expected = f"XML that {_SCHEMA} accepts"
    try:
        element = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError("OpenSCENARIO", Unquoted(error), expected) from None
    quick = _schema("lxml.etree")
    lxml = importlib.import_module("lxml.etree")
    if quick.validate(lxml.fromstring(text.encode(), lxml.XMLParser(resolve_entities=False))):
        return
    for problem in _schema("xmlschema").iter_errors(element):  # says where, but takes long
        raise InputError(f"OpenSCENARIO: {problem.path}", Unquoted(problem.reason), expected)
    raise InputError("OpenSCENARIO", Unquoted(quick.error_log.last_error.message), expected)


@cache
def _schema(library: Literal["lxml.etree", "xmlschema"]) -> Any:
    """The schema as a library has it: scenariogeneration brings both."""
    load_xosc()
    build = importlib.import_module(library).XMLSchema
    for file in importlib.metadata.files(_DISTRIBUTION) or ():
        if file.name == _SCHEMA:
            path = str(file.locate())
            return build(file=path) if library == "lxml.etree" else build(path)
    raise MissingExtraError(
        f"OpenSCENARIO needs {_SCHEMA}, which this {_DISTRIBUTION} lacks: "
        "pip install --force-reinstall place-rsus[openscenario]"
    )


def _build_element(run: Run, road_network: str, after_s: float) -> ET.Element:
    xosc = load_xosc()
    bodies = {VUT: run.encounter.vut, VRU: run.encounter.vru} | {
        f"obstruction-{index}": placed.actor for index, placed in enumerate(run.obstruction, 1)
    }
    entities = xosc.Entities()
    for name, actor in bodies.items():
        entities.add_scenario_object(name, build_entity(actor))
    impact_s = round(-float(run.time_s[0]), DECIMALS)
    scenario = xosc.Scenario(
        f"{run.id}: {run.case.title}",
        "place-rsus",
        _build_parameters(run, impact_s),
        entities,
        _build_storyboard(run, impact_s + after_s, after_s),
        xosc.RoadNetwork(roadfile=road_network),
        xosc.Catalog(),
        osc_minor_version=_MINOR,
        creation_date=_UNDATED,
        header_properties=_build_properties(run),
    )
    with warnings.catch_warnings():
        # 0.16.7 asks an XML element whether it is true, of which Python 3.12 and later warn.
        warnings.simplefilter("ignore", DeprecationWarning)
        element: ET.Element = scenario.get_element()
    return element


def _build_parameters(run: Run, impact_s: float) -> Any:
    xosc = load_xosc()
    times = {"impact_time_s": impact_s}
    if np.isfinite(run.last_brake_time_s):
        last_s = float(run.last_brake_time_s - run.time_s[0])
        times["last_brake_time_s"] = round(last_s, DECIMALS) + 0.0
    parameters = xosc.ParameterDeclarations()
    for name, time_s in times.items():
        parameters.add_parameter(xosc.Parameter(name, xosc.ParameterType.double, str(time_s)))
    return parameters


def _build_properties(run: Run) -> Any:
    properties = load_xosc().Properties()
    for name, value in {
        "run": run.id,
        "case": run.case.name,
        "source": run.case.source,
        "approach": run.approach,
        "position": run.position,
        "weather": run.weather,
        "vut_speed_kmh": f"{run.vut_speed_kmh:g}",
        "vru_speed_kmh": f"{run.case.vru_speed_kmh:g}",
        "is_avoidable_by_braking": str(bool(np.isfinite(run.last_brake_time_s))).lower(),
    }.items():
        properties.add_property(name, value)
    return properties


def _build_storyboard(run: Run, end_s: float, after_s: float) -> Any:
    xosc = load_xosc()
    tracks = (_build_track(VUT, run, after_s), _build_track(VRU, run, after_s))
    storyboard = xosc.StoryBoard(
        _build_init(run, tracks),
        xosc.ValueTrigger(
            "after the impact",
            0.0,
            xosc.ConditionEdge.none,
            xosc.SimulationTimeCondition(end_s, xosc.Rule.greaterThan),
            triggeringpoint="stop",
        ),
    )

    def at_start(name: str) -> Any:
        condition = xosc.SimulationTimeCondition(0.0, xosc.Rule.greaterOrEqual)
        return xosc.ValueTrigger(name, 0.0, xosc.ConditionEdge.none, condition)

    act = xosc.Act("unbraked", at_start("start of the act"))
    for track in tracks:
        event = xosc.Event(f"{track.name} sets off", xosc.Priority.override)
        positions = [
            _world_position(point_m, yaw_deg)
            for point_m, yaw_deg in zip(track.position_m, track.yaw_deg, strict=True)
        ]
        times_s = (track.time_s.round(DECIMALS) + 0.0).tolist()
        trajectory = xosc.Trajectory(f"{track.name} unbraked", False)
        trajectory.add_shape(xosc.Polyline(times_s, positions))
        event.add_trigger(at_start(f"start of {track.name}"))
        event.add_action(
            f"{track.name} follows its frames",
            xosc.FollowTrajectoryAction(
                trajectory,
                xosc.FollowingMode.position,
                xosc.ReferenceContext.absolute,
                1.0,
                0.0,
            ),
        )
        maneuver = xosc.Maneuver(f"{track.name} moves")
        maneuver.add_event(event)
        group = xosc.ManeuverGroup(f"{track.name} alone")
        group.add_actor(track.name)
        group.add_maneuver(maneuver)
        act.add_maneuver_group(group)
    storyboard.add_act(act)
    return storyboard


def _build_init(run: Run, tracks: tuple[_Track, ...]) -> Any:
    xosc = load_xosc()
    init = xosc.Init()
    init.add_global_action(xosc.EnvironmentAction(_build_environment(run.weather)))
    at_once = xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0.0)
    for track in tracks:
        position = _world_position(track.position_m[0], track.yaw_deg[0])
        init.add_init_action(track.name, xosc.TeleportAction(position))
        init.add_init_action(track.name, xosc.AbsoluteSpeedAction(track.speed_mps, at_once))
    if load_table("weather")[run.weather]["low_beam"]:
        lights = xosc.LightStateAction(xosc.VehicleLightType.lowBeam, xosc.LightMode.on)
        init.add_init_action(VUT, lights)
    for index, placed in enumerate(run.obstruction, 1):
        pose = placed.pose
        point_m = _reference_m(placed.actor, pose.position_m[:2], pose.yaw_deg, run.terrain)
        teleport = xosc.TeleportAction(_world_position(point_m, pose.yaw_deg))
        init.add_init_action(f"obstruction-{index}", teleport)
    return init


def _build_environment(weather: str) -> Any:
    xosc = load_xosc()
    sky: Table = pick(load_table("weather"), weather, "weather")
    where = f"{TABLE}: weather.{weather}"
    light = pick_weather(weather, "weather")
    is_raining = light.rain_rate_mmph > 0.0
    falling = xosc.PrecipitationType.rain if is_raining else xosc.PrecipitationType.dry
    time: dt.datetime = take(sky, "date_time", where)
    return xosc.Environment(
        weather,
        xosc.TimeOfDay(False, time.year, time.month, time.day, time.hour, time.minute, time.second),
        xosc.Weather(
            getattr(xosc.FractionalCloudCover, take_text(sky, "cloud_cover", where)),
            sun=xosc.Sun(
                light.level_lux,
                to_radians((90.0 - light.sun_yaw_deg) % 360.0),  # clockwise from north
                to_radians(light.sun_elevation_deg),
            ),
            fog=xosc.Fog(light.visibility_m),
            precipitation=xosc.Precipitation(falling, light.rain_rate_mmph),
        ),
        # 1: the runs brake alike in every weather.
        xosc.RoadCondition(1.0, wetness=getattr(xosc.Wetness, take_text(sky, "wetness", where))),
    )


def _build_track(name: str, run: Run, after_s: float) -> _Track:
    # Names of entities are those of the run's fields.
    actor, motion = getattr(run.encounter, name), getattr(run.encounter, f"{name}_motion")
    position_m, yaw_deg = getattr(run, f"{name}_position_m"), getattr(run, f"{name}_yaw_deg")
    first_s, last_s = run.time_s[[0, -1]]
    # Between two frames lies the impact: the last frame may be before it.
    ends_s = [end_s for end_s in sorted({0.0, after_s}) if end_s > last_s]
    # Simulators drive straight between vertices: more of them where the body turns.
    bounds_s = np.concatenate([run.time_s, ends_s])
    steps_deg = wrap_deg(np.diff(motion.path.at(motion.distance_m(bounds_s))[1]))
    between_s = [
        np.arange(start_s + _TURN_STEP_S, end_s - _EPSILON_S, _TURN_STEP_S)
        for (start_s, end_s), step_deg in zip(pairwise(bounds_s), steps_deg, strict=True)
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
    return _Track(
        name=name,
        time_s=time_s - first_s,
        position_m=_reference_m(actor, position_m, yaw_deg, run.terrain),
        yaw_deg=np.unwrap(yaw_deg, period=360.0),
        speed_mps=round(float(way_m) / _SPEED_STEP_S, _SPEED_DECIMALS),
    )


def _reference_m(
    actor: Actor, position_m: FloatArray, yaw_deg: ArrayLike, terrain: Terrain | None
) -> FloatArray:
    """From the middle of the footprint to the standard's reference point on the ground, (.., 3)."""
    yaw_rad = np.radians(yaw_deg)
    ahead = np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=-1)
    return on_ground(position_m + reference_ahead_m(actor) * ahead, terrain)


def _world_position(point_m: FloatArray, yaw_deg: float) -> Any:
    # Adding zero turns -0.0 into 0.0.
    east_m, north_m, up_m = (point_m.round(DECIMALS) + 0.0).tolist()
    return load_xosc().WorldPosition(east_m, north_m, up_m, to_radians(yaw_deg), 0.0, 0.0)
