"""Layouts as files of other programs, and runs as the units see them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError, Unquoted
from geometry.junction import build_junction
from geometry.scene import Scene
from geometry.scene_sources import load_scene
from geometry.weather import pick_weather
from placement.candidates import CandidatePose
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.detectors import load_detector, load_planning_detector
from placement.layout import Layout, check_layout
from placement.positions import aim_sd_deg, build_feet, unit_errors
from placement.question import Question
from placement.sampling.uncertainty import CALIBRATED
from placement.setting import Setting, drive_one
from scenarios.aeb import AebRule, load_aeb_rule
from scenarios.decision import (
    build_car_ways,
    load_decision_rule,
    overlap_probability,
    track,
)
from scenarios.positions import AT_ZERO
from scenarios.runs import WEATHERS, Run, build_frame_axis
from scenarios.tracks import Tracks

from . import load_format

_RUN_ID = (
    "case/approach/speed or case/approach/speed/weather, such as CPNC-50/east/40/night"
    " or, away from the junction, CPNC-50/east-15/40"
)

_ELLIPSE_POINTS = 36
# Of a normal place in the plane, 95 % lie within so many standard deviations.
_SD_OF_95 = 2.448


def find_run(run_id: str, scene: Scene, *, weather: str | None = None) -> Run:
    """The run that an id names.

    Parameters
    ----------
    run_id : str
        "case/approach/speed", by day, or "case/approach/speed/weather"; see
        :attr:`scenarios.runs.Run.id`.
    scene : Scene
        The junction.
    weather : str, optional
        In place of the id's.

    Returns
    -------
    run : Run
        Laid on the junction.

    Raises
    ------
    InputError
        Some part of it is unknown; says what is known.
    """
    parts = run_id.split("/")
    if len(parts) not in (3, 4) or not all(parts):
        raise InputError("--run", run_id, _RUN_ID)
    case, place, speed = parts[:3]
    # "east-15": the arm with the longest name that it begins with, and the position.
    arms = [arm for arm in build_junction(scene).arms if place.startswith(arm)]
    approach = max(arms, key=len, default=place)
    position = place.removeprefix(approach) or AT_ZERO.name
    light = WEATHERS[0]
    if len(parts) == 4:
        light = parts[3]
    if weather is not None:
        pick_weather(weather, "weather")
        light = weather
    question = Question(cases=case, approaches=approach, speeds=speed, weather=light)
    try:
        return drive_one(question, scene, position=position)
    except InputError as error:
        where = f"--run {run_id}: {error.where.removeprefix('--')}"
        raise InputError(where, error.got, error.expected) from None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WatchedRun:
    """A run, and what a layout's units detect of whoever the VUT meets."""

    run: Run
    # by unit's id (n_frames,): frames in which the evaluator's detector finds the road
    # user
    detected: Mapping[str, BoolArray]
    # From detected frames to braking.
    rule: AebRule
    # How the units are aimed, which decides how well they know places.
    aimed: str = CALIBRATED


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Followed:
    """The road user's track in a watched run, and what the car makes of it.

    Reports are without errors; what they could be off by is in the covariances.

    Attributes
    ----------
    tracks : Tracks
        In one world.
    probability : (n_frames,) float
        That the bodies overlap within the time to stop and the rule's reserve.
    ahead_s : float
        So far the car looks ahead. [s]
    brakes : (n_frames,) bool
        The probability has reached the rule's threshold.
    """

    tracks: Tracks
    probability: FloatArray
    ahead_s: float
    brakes: BoolArray


def report_covariances_m2(
    watched: WatchedRun, units: Sequence[CandidatePose]
) -> FloatArray:
    """Covariances of the places that units report, (n_units, n_frames, 3), in m^2.

    Variance of east, covariance, variance of north; see
    :func:`placement.positions.unit_errors`.
    """
    feet = build_feet((watched.run,))
    detector = load_detector()
    errors = [
        unit_errors(
            unit,
            detector,
            feet,
            rule=load_decision_rule(),
            aim_sd_deg=aim_sd_deg(watched.aimed),
        )
        for unit in units
    ]
    return np.array([one.covariance_m2() for one in errors])


def track_watched(
    watched: WatchedRun, units: Sequence[CandidatePose], covariance_m2: FloatArray
) -> Tracks:
    """Track of a watched run's road user, with reports of these covariances.

    They are those of :func:`report_covariances_m2`.
    """
    run = watched.run
    axis = build_frame_axis((run,), np.ones(1))
    reported_m = np.broadcast_to(run.vru_position_m, (1, len(units), axis.n_frames, 2))
    return track(
        np.array([watched.detected[unit.id] for unit in units]),
        reported_m,
        covariance_m2,
        axis,
        aeb=watched.rule,
        rule=load_decision_rule(),
    )


def follow_watched(watched: WatchedRun, units: Sequence[CandidatePose]) -> Followed:
    """Follow the road user of a watched run, and decide by the default rule."""
    run = watched.run
    rule = load_decision_rule()
    latency_s = max(unit.latency(watched.rule) for unit in units)
    aeb = replace(watched.rule, latency_s=latency_s)
    axis = build_frame_axis((run,), np.ones(1))
    tracks = track_watched(watched, units, report_covariances_m2(watched, units))
    ways = build_car_ways((run,), aeb=aeb, longest_reserve_s=rule.reserve_s)
    (probability,) = overlap_probability(
        tracks, axis, ways, [rule.reserve_s], rule=rule
    )
    reached = probability >= rule.threshold
    return Followed(
        tracks=tracks,
        probability=probability,
        ahead_s=float(ways.time_to_stop_s[0]) + rule.reserve_s,
        brakes=np.logical_or.accumulate(reached),
    )


def ellipse_points_m(middle_m: FloatArray, covariance_m2: FloatArray) -> FloatArray:
    """Points (n, 2) of the ellipse in which a place lies with 95 %, in m."""
    variances_m2, axes = np.linalg.eigh(covariance_m2)
    half_m = _SD_OF_95 * np.sqrt(np.maximum(variances_m2, 0.0))
    angles = np.linspace(0.0, 2.0 * np.pi, _ELLIPSE_POINTS, endpoint=False)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    points_m: FloatArray = middle_m + (half_m * circle) @ axes.T
    return points_m


def watch_run(
    layout: Layout,
    scene: Scene,
    run_id: str,
    *,
    aimed: str = CALIBRATED,
    compute: Compute = DEFAULT_COMPUTE,
) -> WatchedRun:
    """Run that an id names, watched by a layout whose units are aimed so.

    The detector is the default one. Raises InputError if there is no such run.
    """
    from placement.evaluator.evaluate import unit_key, watch

    run = find_run(run_id, scene)
    rule = load_aeb_rule()
    setting = Setting(
        scene=scene,
        runs=(run,),
        axis=build_frame_axis((run,), np.ones(1)),
        rule=rule,
        detector=load_detector(),
        table_detector=load_planning_detector(),
    )
    found = watch(
        setting, {unit_key(unit): unit for unit in layout.units}, compute=compute
    )
    detected = {unit.id: found[unit_key(unit)] for unit in layout.units}
    return WatchedRun(run=run, detected=detected, rule=rule, aimed=aimed)


def export_layout(
    layout: Layout,
    format_name: str,
    *,
    scene_path: str = "",
    run_id: str = "",
    aimed: str = CALIBRATED,
    compute: Compute = DEFAULT_COMPUTE,
    options: Mapping[str, Any] | None = None,
) -> str | bytes:
    """Content of a layout's file for another program.

    `format_name` is one of ``FORMAT_NAMES``, `options` are its own. `scene_path`:
    folder or .zip file of the layout's scene; empty: the study's junction. `run_id`: a
    run to show as the units see it, `aimed` so; empty: none. Raises InputError: the
    layout does not fit the scene, or the format needs a place on earth, shows no runs,
    or lacks an option.
    """
    chosen = load_format(format_name)
    if run_id and not chosen.shows_runs:
        raise InputError("--run", run_id, f"none: {format_name} shows no runs")
    given = options or {}
    for name, value in given.items():
        if name not in chosen.options:
            if isinstance(value, str | float):
                got = value
            else:
                got = Unquoted("it")
            option = f"--{name.replace('_', '-')}"
            raise InputError(option, got, f"none: {format_name} has no such option")
    scene = load_scene(scene_path)
    check_layout(layout, scene)
    if not run_id:
        return chosen.write(layout, scene, **given)
    watched = watch_run(layout, scene, run_id, aimed=aimed, compute=compute)
    return chosen.write(layout, scene, watched, **given)
