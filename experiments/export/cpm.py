"""Layouts as collective perception messages (CPM).

Sensors, and what they detect in a run.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from geometry.actors import load_actors
from geometry.arrays import FloatArray, IntArray
from geometry.errors import check_one_of, refuse
from geometry.frames import parse_crs, to_carla_yaw, transform
from geometry.scene import Scene
from geometry.sensors import SEEN_RAD, CameraModel
from geometry.terrain import on_ground, terrain_of
from placement.candidates import CandidatePose, is_ring
from placement.detectors import load_detector
from placement.layout import Layout
from placement.positions import covariance_matrices_m2
from scenarios.runs import Run

from . import ExportFormat
from .json import to_json_text
from .places import longitude_latitude, require_crs
from .watched import WatchedRun, report_covariances_m2, track_watched

RELEASES = ("2.1.1", "2.4.1")
"""Versions of the dictionary, ETSI TS 102 894-2, the usual one first."""
_VERSION = 2
# ItsPduHeader.
_CPM = 14
# Latitude, Longitude.
_PER_DEGREE = 1.0e7
_RSU_CONTAINER = 2
_SENSOR_CONTAINER = 3
# CpmContainerId.
_OBJECT_CONTAINER = 5
_LIDAR = 2
# SensorType.
_MONOVIDEO = 3
# SensorInformationContainer.
_MAX_SENSORS = 128
# T_AddSensorInformation.
_SENSORS_EVERY_S = 1.0
# StandardLength12b, in 0.1 m.
_MAX_RANGE = 4093
# CartesianCoordinate, in 0.01 m.
_MAX_OFFSET = 32766
_MAX_COORDINATE = 131070
# CartesianCoordinateLarge, VelocityComponentValue.
_MAX_VELOCITY = 16381
# A full turn in 0.1 degrees: a value that is not used.
_TURN = 3600
_SEMI_AXIS_UNKNOWN = 4095
_HEADING_UNKNOWN = 3601
_ALTITUDE_UNKNOWN = 800001
_COORDINATE_UNKNOWN = 4096
_SPEED_UNKNOWN = 127
_CLASS_UNKNOWN = 101
# Confidences are half the width of an interval of 95 %, in standard deviations.
_SD_OF_95 = 1.96
# CoordinateConfidence, SpeedConfidence: beyond what they can say.
_COORDINATE_BEYOND = 4095
_SPEED_BEYOND = 126
# MatrixIncludedComponents: of 13 bits the first two, x and y of the position.
_PLACE = "C000"
# The first and the last stand for all beyond.
_ALTITUDES = -100_000, 800_000
# Of a unit: what rounding may add before it counts as the next one.
_SLACK = 1.0e-6
# Half of that over which a velocity is taken.
_STEP_S = 1.0e-3
# by road user: kind, its profile as 2.1.1 names it, and as 2.4.1 counts it
_VRU_CLASSES = {
    "on foot": ("pedestrian", "ordinary-pedestrian", 1),
    "bicycle": ("bicyclistAndLightVruVehicle", "bicyclist", 1),
    "motorcycle": ("motorcyclist", "motorcycle", 2),
}
# TrafficParticipantType.
_PASSENGER_CAR = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Station:
    """Messages of the units of a site."""

    # Empty: a unit without a site.
    site: str
    # A sensor's id is its place here.
    units: tuple[str, ...]
    messages: tuple[
        dict[str, Any], ...
    ]  # CollectivePerceptionMessage each, as JSON writes it


def to_cpm(
    layout: Layout,
    scene: Scene,
    watched: WatchedRun | None = None,
    *,
    release: str = RELEASES[0],
) -> str:
    """Layout as collective perception messages, a station (RSU) per site, as JSON.

    {"standard", "stations": [{"site", "units", "messages"}]}: see
    :func:`build_stations`.
    """
    standard = f"ETSI TS 103 324 V2.1.1 with ETSI TS 102 894-2 V{release}"
    stations = build_stations(layout, scene, watched, release=release)
    return to_json_text({"standard": standard, "stations": stations})


def build_stations(
    layout: Layout,
    scene: Scene,
    watched: WatchedRun | None = None,
    *,
    release: str = RELEASES[0],
) -> list[Station]:
    """Stations of a layout, and what they send.

    Without a run one message: header, reference time 0, reference position (WGS 84, 0.1
    microdegrees; on the road in the middle of the station's units; its altitude [0.01
    m] where the map counts heights from the ellipsoid), the RSU's container and that of
    its sensors. Their regions are radial shapes: reference point east, north, up of the
    reference position [0.01 m], range [0.1 m], horizontal opening - V2.1.1: clockwise
    from north, V2.4.1: counter-clockwise from east - and vertical opening upwards from
    the horizon [0.1 degrees].

    With a run a message for each frame in which a unit detects the road user, and each
    second one with the sensors. Reference times are milliseconds since the run's first
    frame, after the slowest unit's latency; the object's measurement is older by that.
    Position of the middle of its box [0.01 m] and velocity [0.01 m/s] are the run's
    own. Confidences are what a receiver may rely on: of the position the errors of the
    detections in this frame, fused, with their correlation; of the velocity that of the
    station's track, once it is confirmed. Of heights none is known: unavailable. Raises
    InputError if the scene has no crs; a site carries more than 128 units, or units too
    far apart, or the run leaves the standard's range; the release is unknown.

    Notes
    -----
    A camera ends where an adult is as high in the image as the least box of the default
    detector; shadowing is left to the receiver. Most maps count heights from the sea,
    up to 100 m from the ellipsoid: then the altitude is unavailable. A full turn has no
    value of its own (360.0 means "not used"), so a LiDAR that scans all round opens
    from 0 to 359.9 degrees; if it is tilted, the vertical opening is what it reaches to
    any side, not to each.

    References
    ----------
    .. [1] ETSI TS 103 324 V2.1.1, SensorInformationContainer; ETSI TS 102 894-2 V2.1.1,
       SensorType,
       RadialShape, CartesianPosition3d, Wgs84AngleValue, CartesianAngleValue.
    """
    require_crs(scene.crs, "cpm")
    check_one_of("release", release, RELEASES)
    stations: dict[tuple[str, str], list[CandidatePose]] = {}
    for unit in layout.units:
        if unit.site_id:
            key = (unit.site_id, "")
        else:
            key = ("", unit.id)
        stations.setdefault(key, []).append(unit)
    middles_m = np.array(
        [
            np.mean([unit.pose.position_m[:2] for unit in units], axis=0)
            for units in stations.values()
        ]
    )
    lon_lat = np.round(longitude_latitude(middles_m, scene.crs) * _PER_DEGREE).astype(
        int
    )
    # Offsets count from the rounded position, or they would be a centimetre off.
    origins_m = transform(lon_lat / _PER_DEGREE, "EPSG:4326", scene.crs)
    adult_px_m = load_actors()["adult"].height_m / load_detector().min_box_height_px
    found = []
    for index, ((site, own), units) in enumerate(stations.items()):
        where = f"cpm: {site or own}"
        if len(units) > _MAX_SENSORS:
            refuse(where, f"{len(units)} units", f"at most {_MAX_SENSORS}")
        road_m = on_ground(origins_m[index], terrain_of(scene))
        described = [
            {
                "sensorId": number,
                "sensorType": (
                    _MONOVIDEO if isinstance(unit.sensor, CameraModel) else _LIDAR
                ),
                "perceptionRegionShape": {
                    "radial": _radial_shape(unit, road_m, adult_px_m, where, release)
                },
                "shadowingApplies": True,
            }
            for number, unit in enumerate(units)
        ]
        sensors = _container(_SENSOR_CONTAINER, described)
        longitude, latitude = lon_lat[index].tolist()
        altitude_cm = _altitude_cm_at(scene, float(road_m[2]))
        position = _reference_position(latitude, longitude, altitude_cm)
        messages = [
            _message(index, time_ms, position, containers)
            for time_ms, containers in (
                [(0, [sensors])]
                if watched is None
                else _sent(watched, units, sensors, road_m, where, release)
            )
        ]
        names = tuple(unit.id for unit in units)
        found.append(Station(site=site, units=names, messages=tuple(messages)))
    return found


def _message(
    station_id: int,
    time_ms: int,
    position: dict[str, Any],
    containers: list[dict[str, Any]],
) -> dict[str, Any]:
    return {
        "header": {
            "protocolVersion": _VERSION,
            "messageId": _CPM,
            "stationId": station_id,
        },
        "payload": {
            "managementContainer": {
                "referenceTime": time_ms,
                "referencePosition": position,
            },
            "cpmContainers": [_container(_RSU_CONTAINER, {}), *containers],
        },
    }


def _container(container_id: int, data: object) -> dict[str, Any]:
    return {"containerId": container_id, "containerData": data}


def _reference_position(
    latitude: int, longitude: int, altitude_cm: int
) -> dict[str, Any]:
    """A place of unknown confidence, as JSON writes it."""
    return {
        "latitude": latitude,
        "longitude": longitude,
        "positionConfidenceEllipse": {
            "semiMajorConfidence": _SEMI_AXIS_UNKNOWN,
            "semiMinorConfidence": _SEMI_AXIS_UNKNOWN,
            "semiMajorOrientation": _HEADING_UNKNOWN,
        },
        "altitude": {"altitudeValue": altitude_cm, "altitudeConfidence": "unavailable"},
    }


def _sent(
    watched: WatchedRun,
    units: list[CandidatePose],
    sensors: dict[str, Any],
    origin_m: FloatArray,
    where: str,
    release: str,
) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """Reference times of a station's messages, and containers beside the RSU's own."""
    time_s = watched.run.time_s
    latency_s = max(unit.latency(watched.rule) for unit in units)
    detected = np.array([watched.detected[unit.id] for unit in units])
    covariance_m2 = report_covariances_m2(watched, units)
    tracks = track_watched(watched, units, covariance_m2)
    told_s = -np.inf
    for frame in range(len(time_s)):
        containers = []
        if time_s[frame] - told_s >= _SENSORS_EVERY_S - _SLACK:
            containers.append(sensors)
            told_s = time_s[frame]
        if detected[:, frame].any():
            seeing = np.flatnonzero(detected[:, frame]).tolist()
            described = _object(watched.run, frame, origin_m, where, release)
            described |= {
                "measurementDeltaTime": -round(1000.0 * latency_s),
                "sensorIdList": seeing,
            }
            _tell_place_error(described, fuse_m2(covariance_m2[seeing, frame]))
            # A speed is known only once a track has lasted.
            if tracks.is_live[frame]:
                variance = np.diag(tracks.covariance[frame])[2:]
                _tell_speed_error(described, np.sqrt(variance))
            data = {"numberOfPerceivedObjects": 1, "perceivedObjects": [described]}
            containers.append(_container(_OBJECT_CONTAINER, data))
        if containers:
            yield round(1000.0 * (time_s[frame] - time_s[0] + latency_s)), containers


def _object(
    run: Run, frame: int, origin_m: FloatArray, where: str, release: str
) -> dict[str, Any]:
    """Whoever the VUT meets in a frame, east.

    North and up of the reference position.
    """
    motion = run.encounter.vru_motion
    body = run.encounter.vru
    around_s = run.time_s[frame] + np.array([-_STEP_S, _STEP_S])
    places_m = on_ground(motion.path.at(motion.distance_m(around_s))[0], run.terrain)
    velocity = _count_up(np.diff(places_m, axis=0)[0] / (2.0 * _STEP_S), 100.0)
    middle_m = on_ground(run.vru_position_m[frame], run.terrain)
    middle_m = middle_m + [0.0, 0.0, 0.5 * body.height_m]
    offset = _count_up(middle_m - origin_m, 100.0)
    if np.abs(offset).max() > _MAX_COORDINATE or np.abs(velocity).max() > _MAX_VELOCITY:
        got = f"a road user {np.abs(offset).max() / 100.0:g} m away"
        refuse(where, got, f"at most {_MAX_COORDINATE / 100.0:g} m")
    kind: dict[str, Any] = {"vehicleSubClass": _PASSENGER_CAR}
    if run.road_user in _VRU_CLASSES:
        name, *profiles = _VRU_CLASSES[run.road_user]
        kind = {"vruSubClass": {name: profiles[RELEASES.index(release)]}}
    return {
        "objectId": 0,
        "position": {
            f"{axis}Coordinate": {
                "value": int(value),
                "confidence": _COORDINATE_UNKNOWN,
            }
            for axis, value in zip("xyz", offset, strict=True)
        },
        "velocity": {
            "cartesianVelocity": {
                f"{axis}Velocity": {"value": int(value), "confidence": _SPEED_UNKNOWN}
                for axis, value in zip("xyz", velocity, strict=True)
            }
        },
        "classification": [{"objectClass": kind, "confidence": _CLASS_UNKNOWN}],
    }


def fuse_m2(covariances_m2: FloatArray) -> FloatArray:
    """Covariance (2, 2) of a place that several report with these, (n, 3), in m^2.

    Inverses add up: (sum of R^-1)^-1.
    """
    information = np.linalg.inv(covariance_matrices_m2(covariances_m2)).sum(axis=0)
    fused: FloatArray = np.linalg.inv(information)
    return fused


def _tell_place_error(described: dict[str, Any], covariance_m2: FloatArray) -> None:
    """Put the confidence of east and north, and their correlation, into an object."""
    sd_m = np.sqrt(np.diag(covariance_m2))
    for axis, value_m in zip("xy", sd_m, strict=True):
        confidence = int(_count_up(_SD_OF_95 * value_m, 100.0))
        coordinate = described["position"][f"{axis}Coordinate"]
        coordinate["confidence"] = min(max(confidence, 1), _COORDINATE_BEYOND)
    correlation = covariance_m2[0, 1] / (sd_m[0] * sd_m[1])
    described["lowerTriangularCorrelationMatrices"] = [
        {
            "componentsIncludedIntheMatrix": _PLACE,
            "matrix": [[round(100.0 * float(correlation))]],
        }
    ]


def _tell_speed_error(described: dict[str, Any], sd_mps: FloatArray) -> None:
    """Put the confidence of the velocity east and north into an object."""
    velocity = described["velocity"]["cartesianVelocity"]
    for axis, value_mps in zip("xy", sd_mps, strict=True):
        confidence = int(_count_up(_SD_OF_95 * value_mps, 100.0))
        velocity[f"{axis}Velocity"]["confidence"] = min(
            max(confidence, 1), _SPEED_BEYOND
        )


def _altitude_cm_at(scene: Scene, height_m: float) -> int:
    """Height above the ellipsoid of what is some metres above the scene's zero."""
    if scene.source_crs:
        crs = parse_crs(scene.source_crs)
    else:
        crs = None
    is_ellipsoidal = crs is not None and len(crs.axis_info) == 3 and not crs.is_compound
    if scene.zero_height_m is None or not is_ellipsoidal:
        return _ALTITUDE_UNKNOWN
    value = int(_count_up(scene.zero_height_m + height_m, 100.0))
    low, high = _ALTITUDES
    return min(max(value, low), high)


def _radial_shape(
    unit: CandidatePose,
    origin_m: FloatArray,
    adult_px_m: float,
    where: str,
    release: str,
) -> dict[str, object]:
    offset = _count_up(unit.pose.position_m - origin_m, 100.0)
    if np.abs(offset).max() > _MAX_OFFSET:
        refuse(
            where,
            f"{unit.id} {np.abs(offset).max() / 100.0:g} m from the site's other units",
            f"at most {_MAX_OFFSET / 100.0:g} m",
        )
    sensor = unit.sensor
    if isinstance(sensor, CameraModel):
        range_m = sensor.focal_length_px * adult_px_m
    else:
        range_m = sensor.range_m
    half_deg = 0.5 * sensor.horizontal_fov_deg
    if isinstance(sensor, CameraModel) and not sensor.is_pinhole:
        half_deg = min(half_deg, math.degrees(SEEN_RAD))
    half_vertical_deg = 0.5 * sensor.vertical_fov_deg
    lowest_deg = highest_deg = unit.pose.pitch_deg
    # V2.2.1 turned the angles' zero and sense.
    is_old = release == RELEASES[0]
    middle_deg = unit.pose.yaw_deg
    if is_old:
        middle_deg = float(to_carla_yaw(middle_deg)) + 90.0
    start = _tenths(middle_deg - half_deg) % _TURN
    end = _tenths(middle_deg + half_deg) % _TURN
    if is_ring(unit.sensor):
        start = 0
        end = _TURN - 1
        # Tilted, its front goes down by as much as its back goes up.
        lowest_deg = -abs(unit.pose.pitch_deg)
        highest_deg = abs(unit.pose.pitch_deg)
    # What looks straight down sees beyond it, but there is no steeper direction.
    low_deg = max(lowest_deg - half_vertical_deg, -90.0)
    high_deg = min(highest_deg + half_vertical_deg, 90.0)
    if is_old:
        horizontal = "stationaryHorizontalOpeningAngle"
    else:
        horizontal = "horizontalOpeningAngle"
    return {
        "shapeReferencePoint": {
            f"{axis}Coordinate": int(value)
            for axis, value in zip("xyz", offset, strict=True)
        },
        "range": min(_tenths(range_m), _MAX_RANGE),
        f"{horizontal}Start": start,
        f"{horizontal}End": end,
        "verticalOpeningAngleStart": _tenths(low_deg) % _TURN,
        "verticalOpeningAngleEnd": _tenths(high_deg) % _TURN,
    }


def _count_up(values: ArrayLike, per_one: float) -> IntArray:
    """Values in parts, `per_one` of them each, as ETSI counts.

    N is (n - 1, n] of them.
    """
    return np.ceil(per_one * np.asarray(values) - _SLACK).astype(np.int64)


def _tenths(value: float) -> int:
    """Tenths as the standard counts them.

    N is more than n - 1 and at most n of them.
    """
    return int(_count_up(value, 10.0))


FORMAT = ExportFormat(
    write=to_cpm,
    shows_runs=True,
    options=("release",),
)
