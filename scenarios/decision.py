"""From detections to the decision to brake.

Tracks of ground positions, and the probability that paths cross. It is a second reading
of runs, next to :mod:`scenarios.confirmation`: a car does not brake for whoever is
detected, but for whoever it will meet.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.errors import InputError, check_one_of, located
from geometry.tables import read_table
from geometry.text_formats import load_data, load_toml

from .aeb import TIME_TOLERANCE_S, AebRule, braking_distance_m, standstill_time_s
from .runs import FrameAxis, Run

DEFAULT_RULE = "default"
_FILE = "decision.toml"
_STEP_S = 0.1
# Fields that may be 0, and the most of those that have a limit.
_MAY_BE_ZERO = ("box_correlation", "acceleration_noise_m2ps3", "reserve_s", "threshold")
_MOST = {"box_correlation": 0.999, "threshold": 1.0, "box_noise_share": 1.0}


@dataclass(frozen=True, slots=True, kw_only=True)
class DecisionRule:
    """What tracks and decisions depend on; see ``data/decision.toml``.

    Attributes
    ----------
    box_noise_share : float
        Error of each side of a box, as a share of its size, of detectors that have none
        of their own.
    box_correlation : float
        Of that error between consecutive frames. 0 .. 0.999
    body_sd_m : float
        Middle of the footprint against what is detected. [m]
    acceleration_noise_m2ps3 : float
        Spectral density of road users' accelerations. [m^2/s^3]
    first_speed_sd_mps : float
        Of a new track's speed in each direction. [m/s]
    reserve_s, threshold : float
        Brake from this probability on that footprints overlap within the time to
        stop and this reserve. [s], 0 .. 1
    car_along_sd_m, car_across_sd_m : float
        Of the car's own place. [m]
    clearance_m, stop_mps2 : float
        How near to the car's way a twin comes, and how it slows down. [m], [m/s^2]
    draws : int
        Worlds in which errors are drawn.

    Raises
    ------
    InputError
        A number is not finite, or out of range.
    """

    box_noise_share: float
    box_correlation: float
    body_sd_m: float
    acceleration_noise_m2ps3: float
    first_speed_sd_mps: float
    reserve_s: float
    threshold: float
    car_along_sd_m: float
    car_across_sd_m: float
    clearance_m: float
    stop_mps2: float
    draws: int

    def __post_init__(self) -> None:
        for name in (one.name for one in fields(self)):
            value = getattr(self, name)
            most = _MOST.get(name, math.inf)
            if name in _MAY_BE_ZERO:
                is_valid = 0.0 <= value <= most and value < math.inf
                expected = "a number, at least 0"
            else:
                is_valid = 0.0 < value <= most and value < math.inf
                expected = "a finite number, more than 0"
            if most < math.inf:
                expected = f"{expected} and at most {most:g}"
            if not is_valid:
                raise InputError(name, value, expected)


def load_decision_rule(name_or_path: str = DEFAULT_RULE) -> DecisionRule:
    """Rule by its name, "default", or from a TOML file.

    Raises InputError if the file cannot be read, or a key or a number cannot be.
    """
    values = load_data(__package__, _FILE)
    where = _FILE
    if name_or_path != DEFAULT_RULE:
        path = Path(name_or_path)
        if path.suffix != ".toml":
            raise InputError("decision", name_or_path, f"{DEFAULT_RULE}, or a .toml")
        values = values | load_toml(path)
        where = str(path)
    known = [one.name for one in fields(DecisionRule)]
    for key in values:
        check_one_of(where, key, known)
    with located(f"{where}: "):
        return read_table(values, DecisionRule, "")


# ---------- tracks
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracks:
    """The fused track of each run's road user, after each frame.

    Attributes
    ----------
    state : (n_frames, 4) float
        East, north and their rates. World frame. [m], [m/s]
    covariance : (n_frames, 4, 4) float
        Of the state.
    is_live : (n_frames,) bool
        A confirmed track is alive; elsewhere the numbers above mean nothing.
    """

    state: FloatArray
    covariance: FloatArray
    is_live: BoolArray


def track(
    detected: BoolArray,
    position_m: FloatArray,
    covariance_m2: FloatArray,
    axis: FrameAxis,
    *,
    aeb: AebRule,
    rule: DecisionRule,
) -> Tracks:
    """Follow each run's road user by a Kalman filter of constant velocity.

    Units are fused by their covariances, one after the other. A track is confirmed by
    consecutive frames in which any unit detects, and lost after the track memory.

    Parameters
    ----------
    detected : (n_units, n_frames) bool
        Who detects when.
    position_m : (n_units, n_frames, 2) float
        Reported east and north; not read where nothing is detected. [m]
    covariance_m2 : (n_units, n_frames, 3) float
        Variance of east, covariance, variance of north. [m^2]
    axis : FrameAxis
        Runs and frames.
    aeb : AebRule
        Confirmation and memory.
    rule : DecisionRule
        Noise of accelerations, and of a first speed.

    References
    ----------
    .. [1] Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to
       Tracking and Navigation", 2001, 6.2.2: continuous white noise acceleration.
    """
    # Numba takes half a second to load.
    from . import track_kernels

    state = np.zeros((axis.n_frames, 4))
    covariance = np.zeros((axis.n_frames, 4, 4))
    is_live = np.zeros(axis.n_frames, dtype=bool)
    track_kernels.follow(
        axis.time_s,
        axis.run_start,
        detected,
        position_m,
        covariance_m2,
        aeb.n_confirmations,
        aeb.track_memory_s + TIME_TOLERANCE_S,
        rule.acceleration_noise_m2ps3,
        rule.first_speed_sd_mps**2,
        state,
        covariance,
        is_live,
    )
    return Tracks(state=state, covariance=covariance, is_live=is_live)


# ---------- the decision
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarWays:
    """Where cars are and will be, for the decision.

    Attributes
    ----------
    place : (n_points, 3) float
        East, north and heading of the car every 0.1 s, run after run, for longer than
        anybody looks ahead. [m], [m], [rad]
    start : (n_runs + 1,) int
        Points of each run; the first one is at its first frame.
    time_to_stop_s : (n_runs,) float
        Braking distance over speed, plus the latency. [s]
    half_vut_m : (2,) float
        Half the car's length and width. [m]
    half_vru_m : (n_runs, 2) float
        Half the road user's. [m]
    """

    place: FloatArray
    start: IntArray
    time_to_stop_s: FloatArray
    half_vut_m: FloatArray
    half_vru_m: FloatArray


def build_car_ways(
    runs: Sequence[Run], *, aeb: AebRule, longest_reserve_s: float
) -> CarWays:
    """Cars on their ways at constant speeds, as they foresee it themselves."""
    places = []
    to_stop_s = []
    for run in runs:
        motion = run.encounter.vut_motion
        speed = motion.speed_mps
        standstill_s = standstill_time_s(speed, rule=aeb)
        stopping_m = braking_distance_m(standstill_s, speed_mps=speed, rule=aeb)
        to_stop_s.append(float(stopping_m) / speed + aeb.latency_s)
        until_s = run.time_s[-1] + to_stop_s[-1] + longest_reserve_s
        n_steps = math.ceil((until_s - run.time_s[0]) / _STEP_S) + 1
        times_s = run.time_s[0] + _STEP_S * np.arange(n_steps + 1)
        position_m, yaw_deg = motion.path.at(motion.distance_m(times_s))
        places.append(np.column_stack([position_m, np.unwrap(np.radians(yaw_deg))]))
    vut = runs[0].encounter.vut
    vrus = [run.encounter.vru for run in runs]
    return CarWays(
        place=np.concatenate(places),
        start=np.cumsum([0, *map(len, places)]),
        time_to_stop_s=np.array(to_stop_s),
        half_vut_m=0.5 * np.array([vut.length_m, vut.width_m]),
        half_vru_m=0.5 * np.array([[one.length_m, one.width_m] for one in vrus]),
    )


def overlap_probability(
    tracks: Tracks,
    axis: FrameAxis,
    ways: CarWays,
    reserves_s: Sequence[float],
    *,
    rule: DecisionRule,
) -> FloatArray:
    """Probability that the footprints overlap soon, (n_reserves, n_frames).

    It is the largest of all times within the time to stop and a reserve, in steps of
    0.1 s and at the end. At each time the track's place, as foreseen with constant
    velocity, and the car's own are normal; along and across the car they are taken
    to be independent, and the road user's rectangle by its extent along and across.
    0 where no confirmed track is alive. Reserves ascend. [s]
    """
    from . import track_kernels

    found = np.zeros((len(reserves_s), axis.n_frames))
    track_kernels.foresee(
        axis.time_s,
        axis.run_start,
        tracks.state,
        tracks.covariance,
        tracks.is_live,
        ways.place,
        ways.start,
        ways.time_to_stop_s,
        np.array(reserves_s, dtype=np.float64),
        rule.acceleration_noise_m2ps3,
        np.array([rule.car_along_sd_m, rule.car_across_sd_m]) ** 2,
        ways.half_vut_m,
        ways.half_vru_m,
        _STEP_S,
        found,
    )
    return found


def frames_in_time(axis: FrameAxis, *, latency_s: float) -> BoolArray:
    """Frames after which braking still avoids the contact, (n_frames,)."""
    last_s = axis.last_brake_time_s.repeat(np.diff(axis.run_start))
    in_time: BoolArray = axis.time_s + latency_s <= last_s + TIME_TOLERANCE_S
    return in_time


def largest_of_runs(values: FloatArray, axis: FrameAxis) -> FloatArray:
    """Largest value in any frame of each run: (..., n_frames) -> (..., n_runs)."""
    return np.maximum.reduceat(values, axis.run_start[:-1], axis=-1)


def located_sd_m(
    tracks: Tracks,
    axis: FrameAxis,
    heading_rad: FloatArray,
    *,
    aeb: AebRule,
    rule: DecisionRule,
) -> FloatArray:
    """How well the place of the impact across the car's path is known, (n_runs,).

    At the last moment, the standard deviation of the live track's place at the time of
    the impact, across the car's heading `heading_rad` (n_runs,) there; infinite where
    no confirmed track is alive then. It depends on covariances alone: nothing is drawn.
    [m]
    """
    in_time = frames_in_time(axis, latency_s=aeb.latency_s)
    n_in_time = np.add.reduceat(in_time.astype(np.int64), axis.run_start[:-1])
    last = np.maximum(axis.run_start[:-1] + n_in_time - 1, 0)
    is_live = (n_in_time > 0) & tracks.is_live[last]
    covariance = tracks.covariance[last]
    # Until the impact, at time 0.
    ahead_s = -axis.time_s[last]
    across = np.column_stack([-np.sin(heading_rad), np.cos(heading_rad)])
    ahead = np.concatenate([across, ahead_s[:, None] * across], axis=1)
    variance = np.einsum("ri,rij,rj->r", ahead, covariance, ahead)
    variance += rule.acceleration_noise_m2ps3 * ahead_s**3 / 3.0
    return np.where(is_live, np.sqrt(np.maximum(variance, 0.0)), np.inf)


def rule_values(rule: DecisionRule) -> dict[str, Any]:
    """Values of a rule by name, for JSON."""
    return {one.name: getattr(rule, one.name) for one in fields(rule)}
