"""From detections to the decision to brake.

Tracks of ground positions, and the probability that paths cross. It is a second reading
of runs, next to :mod:`scenarios.confirmation`: a car does not brake for whoever is
detected, but for whoever it will meet.
"""

import math
from collections import deque
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
from .tracks import Tracks, collect, follow

DEFAULT_RULE = "default"
_FILE = "decision.toml"
_STEP_S = 0.1
# Fields that may be 0, and the most of those that have a limit.
_MAY_BE_ZERO = (
    "box_correlation",
    "acceleration_noise_m2ps3",
    "reserve_s",
    "threshold",
    "false_tracks_braked_for",
)
_MOST = {"box_correlation": 0.999, "threshold": 1.0, "box_noise_share": 1.0}


@dataclass(frozen=True, slots=True, kw_only=True)
class DecisionRule:
    """What tracks and decisions depend on; see ``data/decision.toml``.

    Attributes
    ----------
    box_noise_share : float
        Error of each side of a box, as a share of its size, of detectors that have none
        of their own.
    box_height_factor, box_width_factor : float
        Errors of lower and of left and right sides, as multiples of that share.
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
    false_tracks, false_tracks_braked_for : int
        Confirmed tracks of nothing on recordings, and those that the decision let
        through.
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
    box_height_factor: float
    box_width_factor: float
    box_correlation: float
    body_sd_m: float
    acceleration_noise_m2ps3: float
    first_speed_sd_mps: float
    reserve_s: float
    threshold: float
    car_along_sd_m: float
    car_across_sd_m: float
    false_tracks: int
    false_tracks_braked_for: int
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
        if self.false_tracks_braked_for > self.false_tracks:
            raise InputError(
                "false_tracks_braked_for",
                self.false_tracks_braked_for,
                f"at most the {self.false_tracks} of false_tracks",
            )


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
def track(
    detected: BoolArray,
    position_m: FloatArray,
    covariance_m2: FloatArray,
    axis: FrameAxis,
    *,
    aeb: AebRule,
    rule: DecisionRule,
) -> Tracks:
    """Follow the road users of an axis's runs; see :func:`scenarios.tracks.follow`."""
    steps = follow(
        detected,
        position_m,
        covariance_m2,
        axis.time_s,
        axis.run_start,
        aeb=aeb,
        acceleration_noise_m2ps3=rule.acceleration_noise_m2ps3,
        first_speed_sd_mps=rule.first_speed_sd_mps,
    )
    return collect(steps, n_frames=axis.n_frames, n_worlds=len(position_m))


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
    world: int = 0,
) -> FloatArray:
    """Probability that the footprints overlap soon, (n_reserves, n_frames).

    It is the largest of all times within the time to stop and a reserve, in steps of
    0.1 s and at the end. At each time the track's place, as foreseen with constant
    velocity, and the car's own are normal; along and across the car they are taken
    to be independent, and the road user's rectangle by its extent along and across.
    0 where no confirmed track is alive. Reserves ascend. [s] Of the tracks' worlds, one
    is looked at.
    """
    from . import track_kernels

    found = np.zeros((len(reserves_s), axis.n_frames))
    track_kernels.foresee(
        axis.time_s,
        axis.run_start,
        tracks.state[world],
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
    detected: BoolArray,
    covariance_m2: FloatArray,
    axis: FrameAxis,
    heading_rad: FloatArray,
    *,
    aeb: AebRule,
    rule: DecisionRule,
) -> FloatArray:
    """How well the place of the impact across the car's path is known, in m.

    At the last moment, the standard deviation of the live track's place at the time of
    the impact, across the car's heading there; infinite where no confirmed track is
    alive then. It depends on covariances alone: nothing is drawn.

    Parameters
    ----------
    detected : (n_layouts, n_units, n_frames) bool
        Who detects when, of several layouts.
    covariance_m2 : (n_layouts, n_units, n_frames, 3) float
        Of the reports: variance of east, covariance, variance of north. [m^2]
    axis : FrameAxis
        Runs and frames.
    heading_rad : (n_runs,) float
        Of the car at the impact. [rad]
    aeb, rule : AebRule, DecisionRule
        Confirmation and memory; noise of accelerations.

    Returns
    -------
    sd_m : (n_layouts, n_runs) float
        Standard deviations. [m]
    """
    n_layouts, n_units, _ = detected.shape
    n_runs = axis.n_runs
    in_time = frames_in_time(axis, latency_s=aeb.latency_s)
    n_in_time = np.add.reduceat(in_time.astype(np.int64), axis.run_start[:-1])
    # Only frames up to the last moment are filtered: at least one of each run.
    lengths = np.maximum(n_in_time, 1)
    starts = np.append(0, np.cumsum(lengths))
    frames = np.concatenate(
        [
            np.arange(begin, begin + length)
            for begin, length in zip(axis.run_start[:-1], lengths, strict=True)
        ]
    )
    # The runs of all layouts as one long row: they are filtered together.
    n_frames = len(frames)
    of_layouts = n_frames * np.arange(n_layouts)[:, None]
    seen = detected[:, :, frames].transpose(1, 0, 2)
    errors_m2 = covariance_m2[:, :, frames].transpose(1, 0, 2, 3)
    n_all = n_layouts * n_frames
    steps = follow(
        seen.reshape(n_units, n_all),
        np.zeros((0, n_units, n_all, 2)),
        errors_m2.reshape(n_units, n_all, 3),
        np.tile(axis.time_s[frames], n_layouts),
        np.append(starts[:-1] + of_layouts, n_all),
        aeb=aeb,
        acceleration_noise_m2ps3=rule.acceleration_noise_m2ps3,
        first_speed_sd_mps=rule.first_speed_sd_mps,
    )
    (end,) = deque(steps, maxlen=1)
    covariance = end.covariance.reshape(4, 4, n_layouts, n_runs)
    is_live = end.is_live.reshape(n_layouts, n_runs) & (n_in_time > 0)
    # Until the impact, at time 0.
    ahead_s = -axis.time_s[frames[starts[1:] - 1]]
    across = np.array([-np.sin(heading_rad), np.cos(heading_rad)])
    ahead = np.concatenate([across, ahead_s * across])
    variance = np.einsum("ir,ijlr,jr->lr", ahead, covariance, ahead)
    variance += rule.acceleration_noise_m2ps3 * ahead_s**3 / 3.0
    return np.where(is_live, np.sqrt(np.maximum(variance, 0.0)), np.inf)


def rule_values(rule: DecisionRule) -> dict[str, Any]:
    """Values of a rule by name, for JSON."""
    return {one.name: getattr(rule, one.name) for one in fields(rule)}
