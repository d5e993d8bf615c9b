"""VRU awareness messages (VAM): what the device of a run's road user sends."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.arrays import FloatArray
from geometry.errors import InputError, check_one_of, refuse
from geometry.scene import Scene
from geometry.terrain import on_ground, terrain_of
from scenarios.runs import Run

from . import ExportFormat
from .cpm import (
    PER_DEGREE,
    RELEASES,
    VRU_CLASSES,
    altitude_cm_at,
    count_up,
    reference_position,
)
from .json import to_json_text
from .places import longitude_latitude, require_crs

RATES_HZ = (0.2, 10.0)
"""Fewest and most messages per second: T_GenVamMax and T_GenVamMin."""
_VERSION, _VAM, _STATION = 3, 16, 1  # ItsPduHeader
_STATION_TYPES = {"on foot": 1, "bicycle": 2, "motorcycle": 4}  # TrafficParticipantType
_PROFILE_EVERY_S = 2.0  # T_GenVamLFMin
_MAX_SPEED_MPS, _ACCELERATIONS = 163.81, (-16.0, 16.0)
_UNKNOWN, _ACCELERATION_UNKNOWN = 127, 102  # confidences
_DELTA_TIMES = 65536  # GenerationDeltaTime
_STEP_S = 1.0e-3  # half of that over which a speed is taken
_AHEAD_M = 1.0  # over which the heading is taken
_EPSILON_S = 1.0e-6
_ELLIPSE = "semiMajorAxisLength", "semiMinorAxisLength", "semiMajorAxisOrientation"


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadUser:
    """A vulnerable road user at a moment, as its device knows it."""

    kind: str  # "on foot", "bicycle" or "motorcycle"
    longitude_deg: float  # of the middle of its footprint. WGS 84
    latitude_deg: float
    altitude_cm: int  # above the ellipsoid, or the dictionary's 800001: not known
    heading_deg: float  # clockwise from true north
    speed_mps: float
    acceleration_mps2: float  # along the heading


def build_message(
    user: RoadUser, *, time_ms: int, has_profile: bool, release: str = RELEASES[0]
) -> dict[str, Any]:
    """A VAM, as JSON writes it, not of a cluster; `has_profile`: with the low frequency container.

    Heading in 0.1 degrees, rounded; speed in 0.01 m/s and acceleration in 0.1 m/s^2, where n is (n
    - 1, n] of them; acceleration beyond 16 m/s^2 is 16 m/s^2. Their confidence, and that of the
    place, is unavailable. Raises InputError: the road user is none that sends VAMs, or its place or
    speed is beyond what the message can carry.

    References
    ----------
    .. [1] ETSI TS 103 300-3 V2.2.1, VAM-PDU-Descriptions; ETSI TS 102 894-2, BasicContainer,
       Wgs84Angle, Speed, LongitudinalAcceleration, VruProfileAndSubprofile.
    """
    check_one_of("release", release, RELEASES)
    if user.kind not in _STATION_TYPES:
        who = f"a road user by {user.kind}"
        refuse("vam", who, f"one of: {', '.join(_STATION_TYPES)}")
    within = {
        "latitude_deg": (user.latitude_deg, -90.0, 90.0),
        "longitude_deg": (user.longitude_deg, -180.0, 180.0),
        "speed_mps": (user.speed_mps, 0.0, _MAX_SPEED_MPS),
        "heading_deg": (user.heading_deg, -360.0, 360.0),
    }
    for name, (value, low, high) in within.items():
        if not low <= value <= high:
            raise InputError(f"vam: {name}", value, f"{low:g} to {high:g}")
    acceleration = int(count_up(np.clip(user.acceleration_mps2, *_ACCELERATIONS), 10.0))
    heading = round(10.0 * user.heading_deg) % 3600
    high_frequency = {
        "heading": {"value": heading, "confidence": _UNKNOWN},
        "speed": {
            "speedValue": int(count_up(user.speed_mps, 100.0)),
            "speedConfidence": _UNKNOWN,
        },
        "longitudinalAcceleration": {
            "longitudinalAccelerationValue": acceleration,
            "longitudinalAccelerationConfidence": _ACCELERATION_UNKNOWN,
        },
    }
    latitude, longitude = (
        round(PER_DEGREE * angle_deg) for angle_deg in (user.latitude_deg, user.longitude_deg)
    )
    position = reference_position(latitude, longitude, user.altitude_cm, ellipse=_ELLIPSE)
    parameters: dict[str, Any] = {
        "basicContainer": {
            "stationType": _STATION_TYPES[user.kind],
            "referencePosition": position,
        },
        "vruHighFrequencyContainer": high_frequency,
    }
    if has_profile:
        name, *profiles = VRU_CLASSES[user.kind]
        parameters["vruLowFrequencyContainer"] = {
            "profileAndSubprofile": {name: profiles[RELEASES.index(release)]}
        }
    return {
        "header": {"protocolVersion": _VERSION, "messageId": _VAM, "stationId": _STATION},
        "vam": {"generationDeltaTime": time_ms % _DELTA_TIMES, "vamParameters": parameters},
    }


def build_messages(
    run: Run, scene: Scene, *, vam_rate: float | None = None, release: str = RELEASES[0]
) -> list[tuple[int, dict[str, Any]]]:
    """Times [ms since the run's first frame] and VAMs of whoever the VUT meets, until the impact.

    Without `vam_rate` [Hz] by the standard's rules for a single road user, asked at each frame: at
    the latest after 5 s, sooner when it has moved by more than 4 m, changed its speed by more than
    0.5 m/s or turned by more than 4 degrees; not in them: clusters, redundancy, trajectories that
    cross. The profile comes with the first message and each 2 s. Headings are to true north, not to
    the map's. Raises InputError as :func:`build_message`, or for a scene without crs, a rate
    beyond 0.2 to 10 Hz.

    References
    ----------
    .. [1] ETSI TS 103 300-3 V2.2.1, clauses 6.2 and 6.4.1.
    """
    require_crs(scene.crs, "vam")
    low, high = RATES_HZ
    if vam_rate is None:
        from placement.evaluator.evaluate import load_vam_rule, sent_frames

        times_s = run.time_s[sent_frames(run, load_vam_rule())]
    elif low <= vam_rate <= high:
        times_s = np.arange(run.time_s[0], _EPSILON_S, 1.0 / vam_rate)
    else:
        raise InputError("--vam-rate", vam_rate, f"{low:g} to {high:g} messages per second")
    found = []
    told_s = -np.inf
    for time_s, user in zip(times_s.tolist(), _users(run, scene, times_s), strict=True):
        has_profile = time_s - told_s >= _PROFILE_EVERY_S - _EPSILON_S
        told_s = time_s if has_profile else told_s
        at_ms = round(1000.0 * (time_s - run.time_s[0]))
        message = build_message(user, time_ms=at_ms, has_profile=has_profile, release=release)
        found.append((at_ms, message))
    return found


def _users(run: Run, scene: Scene, times_s: FloatArray) -> list[RoadUser]:
    from pyproj import Geod

    motion = run.encounter.vru_motion
    around_m = motion.distance_m(times_s[:, None] + _STEP_S * np.array([-1.0, 0.0, 1.0]))
    speeds_mps = (around_m[:, 2] - around_m[:, 0]) / (2.0 * _STEP_S)
    changes_mps2 = np.diff(around_m, n=2, axis=1)[:, 0] / _STEP_S**2
    places_m, yaw_deg = motion.path.at(around_m[:, 1])
    yaw_rad = np.radians(yaw_deg)
    ahead_m = places_m + _AHEAD_M * np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
    lon_lat_deg = longitude_latitude(places_m, scene.crs)
    ends_deg = longitude_latitude(ahead_m, scene.crs)
    turns_deg, _, _ = Geod(ellps="WGS84").inv(*lon_lat_deg.T, *ends_deg.T)
    heights_m = on_ground(places_m, terrain_of(scene))[:, 2]
    return [
        RoadUser(
            kind=run.road_user,
            longitude_deg=float(lon_lat_deg[i, 0]),
            latitude_deg=float(lon_lat_deg[i, 1]),
            altitude_cm=altitude_cm_at(scene, float(heights_m[i])),
            heading_deg=float(turns_deg[i]),
            speed_mps=max(float(speeds_mps[i]), 0.0),
            acceleration_mps2=float(changes_mps2[i]),
        )
        for i in range(len(times_s))
    ]


def to_vam(
    run: Run, scene: Scene, *, vam_rate: float | None = None, release: str = RELEASES[0]
) -> str:
    """Messages of :func:`build_messages` as JSON: {"standard", "run", "messages"}."""
    standard = f"ETSI TS 103 300-3 V2.2.1 with ETSI TS 102 894-2 V{release}"
    messages = [
        {"time_ms": time_ms, "message": message}
        for time_ms, message in build_messages(run, scene, vam_rate=vam_rate, release=release)
    ]
    return to_json_text({"standard": standard, "run": run.id, "messages": messages})


FORMAT = ExportFormat(
    write=to_vam,
    content="of a run's road user, ETSI TS 103 300-3 as JSON; V2X stacks",
    drives_run=True,
    has_units=False,
    options=("release", "vam_rate"),
)
