"""Runs: a case, driven from an approach at a speed, on a grid of frames that ends at the impact."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.constants import kmh

from geometry.actors import Actor, PlacedActor, pick_actor
from geometry.arrays import BoolArray, FloatArray, IntArray, float_array, freeze
from geometry.errors import InputError, Unquoted
from geometry.frames import from_carla_points, from_carla_pose, from_carla_yaw
from geometry.toml_files import (
    Table,
    load_toml,
    pick,
    take_list,
    take_number,
    take_text,
)

from .aeb import AebRule, Encounter, confirmation_time_s, last_brake_time_s
from .cases import Case, load_cases
from .paths import Motion, StraightPath

APPROACHES = ("north", "east", "south", "west")
_GRID_TOLERANCE = 1.0e-6  # of a frame
_ON_LINE_TOLERANCE_M = 0.05
_ANGLE_TOLERANCE_DEG = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CasePlacement:
    """Where a case is driven at a junction. World frame.

    Attributes
    ----------
    case : Case
        What is driven.
    approach : str
        The arm from which the VUT comes.
    vut_path, vru_path : StraightPath
        From the start points on.
    vru_meeting_m : float
        Distance along the VRU's path from its start to where the middle of the VRU is at the
        impact. [m]
    vut_meeting_m : float
        Distance along the VUT's path from its start to the point beside the VRU's middle. [m]
    obstruction : tuple of PlacedActor
        Parked bodies that belong to this case only.
    """

    case: Case
    approach: str
    vut_path: StraightPath
    vru_path: StraightPath
    vut_meeting_m: float
    vru_meeting_m: float
    obstruction: tuple[PlacedActor, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """One drive.

    Attributes
    ----------
    id : str
        "case/approach/speed".
    case : Case
        What is driven.
    approach : str
        The arm from which the VUT comes.
    vut_speed_kmh : float
        Constant. [km/h]
    encounter : Encounter
        Bodies and motions without braking.
    time_s : (n_frames,) float
        Times of the frames, ascending, relative to the impact; the last one is 0. [s]
    vut_position_m, vru_position_m : (n_frames, 2) float
        Middles of the footprints. World frame. [m]
    vut_yaw_deg, vru_yaw_deg : (n_frames,) float
        Headings. [deg]
    obstruction : tuple of PlacedActor
        Parked bodies of this run.
    last_brake_time_s : float
        Latest onset of braking that avoids. [s]
    """

    id: str
    case: Case
    approach: str
    vut_speed_kmh: float
    encounter: Encounter
    time_s: FloatArray
    vut_position_m: FloatArray
    vut_yaw_deg: FloatArray
    vru_position_m: FloatArray
    vru_yaw_deg: FloatArray
    obstruction: tuple[PlacedActor, ...]
    last_brake_time_s: float

    def __repr__(self) -> str:
        return f"Run({self.id!r}, {len(self.time_s)} frames)"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameAxis:
    """All frames of some runs, laid end to end: the second axis of every detection array.

    Attributes
    ----------
    run_ids, cases, approaches : tuple of str
        Per run.
    vut_speed_kmh, weight, last_brake_time_s : (n_runs,) float
        Per run; weights sum to 1. [km/h], share, [s]
    run_start : (n_runs + 1,) int
        Frames of run r are run_start[r] .. run_start[r + 1] - 1.
    time_s : (n_frames,) float
        Relative to the impact. [s]
    """

    run_ids: tuple[str, ...]
    cases: tuple[str, ...]
    approaches: tuple[str, ...]
    vut_speed_kmh: FloatArray
    weight: FloatArray
    last_brake_time_s: FloatArray
    run_start: IntArray
    time_s: FloatArray

    def __post_init__(self) -> None:
        n_runs = len(self.run_ids)
        for field in ("vut_speed_kmh", "weight"):
            object.__setattr__(self, field, float_array(getattr(self, field), (n_runs,), field))
        if (self.weight < 0.0).any() or not np.isclose(self.weight.sum(), 1.0):
            raise InputError("weight", self.weight.tolist(), "shares >= 0 that sum to 1")
        last_brake = np.array(self.last_brake_time_s, dtype=np.float64)  # may be -inf
        if last_brake.shape != (n_runs,) or np.isnan(last_brake).any():
            raise InputError("last_brake_time_s", last_brake.tolist(), "one time per run")
        object.__setattr__(self, "last_brake_time_s", freeze(last_brake))
        run_start = np.array(self.run_start, dtype=np.int64)
        object.__setattr__(self, "run_start", freeze(run_start))
        object.__setattr__(self, "time_s", float_array(self.time_s, (-1,), "time_s"))
        if run_start.shape != (n_runs + 1,) or run_start[0] != 0 or (np.diff(run_start) < 1).any():
            raise InputError("run_start", run_start.tolist(), "0 and ascending, one more than runs")
        if run_start[-1] != len(self.time_s):
            raise InputError("time_s", Unquoted(f"{len(self.time_s)} frames"), str(run_start[-1]))
        falls = np.diff(self.time_s) <= 0.0
        falls[run_start[1:-1] - 1] = False  # from one run to the next
        if falls.any():
            late, early = self.time_s[np.argmax(falls) :][:2].tolist()
            raise InputError(
                "time_s", Unquoted(f"{late} before {early}"), "times that ascend within a run"
            )

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.run_ids)

    @property
    def n_frames(self) -> int:
        """Number of frames of all runs."""
        return len(self.time_s)

    def frames_of(self, run_index: int) -> slice:
        """Frames of a run, as a slice."""
        return slice(int(self.run_start[run_index]), int(self.run_start[run_index + 1]))


def build_frame_axis(runs: Sequence[Run], weight: FloatArray) -> FrameAxis:
    """Lay the frames of runs end to end.

    Parameters
    ----------
    runs : sequence of Run
        At least one.
    weight : (n_runs,) float
        Shares that sum to 1.

    Raises
    ------
    InputError
        There is no run, or the weights do not fit.
    """
    if not runs:
        raise InputError("runs", Unquoted("none"), "at least one run")
    return FrameAxis(
        run_ids=tuple(run.id for run in runs),
        cases=tuple(run.case.name for run in runs),
        approaches=tuple(run.approach for run in runs),
        vut_speed_kmh=np.array([run.vut_speed_kmh for run in runs]),
        weight=weight,
        last_brake_time_s=np.array([run.last_brake_time_s for run in runs]),
        run_start=np.concatenate([[0], np.cumsum([len(run.time_s) for run in runs])]),
        time_s=np.concatenate([run.time_s for run in runs]),
    )


def confirmation_times_s(
    detected: BoolArray, axis: FrameAxis, *, n_confirmations: int
) -> FloatArray:
    """When the VRU of each run is first confirmed; no window reaches from one run into the next.

    Parameters
    ----------
    detected : (..., n_frames) bool
        Frames of all runs.
    axis : FrameAxis
        Runs and frames.
    n_confirmations : int
        Consecutive frames needed.

    Returns
    -------
    confirmation_s : (..., n_runs) float
        See :func:`scenarios.aeb.confirmation_time_s`; infinite if there is none. [s]
    """
    return np.stack(
        [
            confirmation_time_s(
                detected[..., axis.frames_of(run)],
                axis.time_s[axis.frames_of(run)],
                n_confirmations=n_confirmations,
            )
            for run in range(axis.n_runs)
        ],
        axis=-1,
    )


@cache
def load_placements() -> tuple[CasePlacement, ...]:
    """Where each case is driven at the study's junction, from ``data/town05_runs.toml``."""
    table = load_toml(files(__package__) / "data" / "town05_runs.toml")
    return tuple(
        _build_placement(entry, f"town05_runs.toml: placements[{index}]")
        for index, entry in enumerate(take_list(table, "placements", "town05_runs.toml"))
    )


def build_runs(
    placements: Iterable[CasePlacement], *, vut: Actor, rule: AebRule
) -> tuple[Run, ...]:
    """All runs of some placements, at every speed of their case.

    Parameters
    ----------
    placements : iterable of CasePlacement
        Where what is driven.
    vut : Actor
        The vehicle under test.
    rule : AebRule
        Deceleration and frame rate.

    Returns
    -------
    runs : tuple of Run
        In the order of the placements, then of the speeds.
    """
    return tuple(
        _build_run(placement, speed_kmh, vut=vut, rule=rule)
        for placement in placements
        for speed_kmh in placement.case.vut_speeds_kmh
    )


def _build_run(placement: CasePlacement, speed_kmh: float, *, vut: Actor, rule: AebRule) -> Run:
    case = placement.case
    vut_speed, vru_speed = speed_kmh * kmh, case.vru_speed_kmh * kmh
    gap_m = 0.5 * (case.vru.width_m if case.kind == "crossing" else case.vru.length_m)
    vut_distance = placement.vut_meeting_m - 0.5 * vut.length_m - gap_m
    offset_left = vut.width_m * (case.impact_percent - 50.0) / 100.0
    vru_distance = placement.vru_meeting_m + offset_left * _crossing_sign(placement)
    encounter = Encounter(
        vut=vut,
        vut_motion=Motion(
            path=placement.vut_path, speed_mps=vut_speed, start_time_s=-vut_distance / vut_speed
        ),
        vru=case.vru,
        vru_motion=Motion(
            path=placement.vru_path, speed_mps=vru_speed, start_time_s=-vru_distance / vru_speed
        ),
    )
    first_s = min(encounter.vut_motion.start_time_s, encounter.vru_motion.start_time_s)
    n_steps = int(-first_s * rule.frame_rate_hz + _GRID_TOLERANCE)
    time_s = np.arange(-n_steps, 1) / rule.frame_rate_hz
    vut_position, vut_yaw = placement.vut_path.at(encounter.vut_motion.distance_m(time_s))
    vru_position, vru_yaw = placement.vru_path.at(encounter.vru_motion.distance_m(time_s))
    return Run(
        id=f"{case.name}/{placement.approach}/{speed_kmh:g}",
        case=case,
        approach=placement.approach,
        vut_speed_kmh=speed_kmh,
        encounter=encounter,
        time_s=freeze(time_s),
        vut_position_m=freeze(vut_position),
        vut_yaw_deg=freeze(vut_yaw),
        vru_position_m=freeze(vru_position),
        vru_yaw_deg=freeze(vru_yaw),
        obstruction=placement.obstruction,
        last_brake_time_s=last_brake_time_s(encounter, deceleration_mps2=rule.deceleration_mps2),
    )


def _crossing_sign(placement: CasePlacement) -> float:
    """+1 if the VRU walks towards the VUT's left, -1 towards its right, 0 along its path."""
    if placement.case.kind == "longitudinal":
        return 0.0
    ahead, walking = placement.vut_path.direction, placement.vru_path.direction
    return float(np.sign(ahead[0] * walking[1] - ahead[1] * walking[0]))


def _build_placement(entry: Table, where: str) -> CasePlacement:
    case = pick(load_cases(), take_text(entry, "case", where), f"{where}.case")
    approach = take_text(entry, "approach", where)
    if approach not in APPROACHES:
        raise InputError(f"{where}.approach", approach, "one of " + ", ".join(APPROACHES))
    vut_path = _build_path(entry, "vut", where)
    vru_path = _build_path(entry, "vru", where)
    point = take_list(entry, "collision_point_m", where)
    collision = from_carla_points(float_array(point, (2,), f"{where}.collision_point_m"))
    if case.kind == "crossing":
        vut_meeting, vru_meeting = _crossing_distances(vut_path, vru_path, where)
    else:
        if vut_path.direction @ vru_path.direction < np.cos(np.radians(_ANGLE_TOLERANCE_DEG)):
            raise InputError(
                where,
                Unquoted(f"headings {vut_path.yaw_deg:g} and {vru_path.yaw_deg:g} degrees"),
                "one heading for VUT and VRU",
            )
        vut_meeting = float((collision - vut_path.start_m) @ vut_path.direction)
        vru_meeting = float((collision - vru_path.start_m) @ vru_path.direction)
    met_m, _ = vut_path.at(vut_meeting)
    east, north = collision - met_m
    beside_m = abs(vut_path.direction[0] * north - vut_path.direction[1] * east)
    if beside_m > _ON_LINE_TOLERANCE_M:
        raise InputError(f"{where}.collision_point_m", point, "a point on the VUT's path")
    if not (vut_meeting > 0.0 and vru_meeting > 0.0):
        raise InputError(
            where, Unquoted("paths that meet behind a start"), "starts before the meeting point"
        )
    return CasePlacement(
        case=case,
        approach=approach,
        vut_path=vut_path,
        vru_path=vru_path,
        vut_meeting_m=vut_meeting,
        vru_meeting_m=vru_meeting,
        obstruction=tuple(
            _build_parked(body, f"{where}.obstruction[{index}]")
            for index, body in enumerate(entry.get("obstruction", []))
        ),
    )


def _build_path(entry: Table, body: str, where: str) -> StraightPath:
    start = take_list(entry, f"{body}_start_m", where)
    return StraightPath(
        start_m=from_carla_points(float_array(start, (2,), f"{where}.{body}_start_m")),
        yaw_deg=float(from_carla_yaw(take_number(entry, f"{body}_yaw_deg", where))),
    )


def _crossing_distances(a: StraightPath, b: StraightPath, where: str) -> tuple[float, float]:
    # At the impact the gap between the bodies' middles is half the VRU's width only if it crosses
    # squarely.
    angle_deg = float(np.degrees(np.arccos(np.clip(abs(a.direction @ b.direction), 0.0, 1.0))))
    if angle_deg < 90.0 - _ANGLE_TOLERANCE_DEG:
        raise InputError(
            where, Unquoted(f"paths at {angle_deg:.1f} degrees"), "perpendicular paths"
        )
    matrix = np.stack([a.direction, -b.direction], axis=1)
    distances = np.linalg.solve(matrix, b.start_m - a.start_m)
    return float(distances[0]), float(distances[1])


def _build_parked(body: dict[str, Any], where: str) -> PlacedActor:
    position = float_array(take_list(body, "position_m", where), (2,), f"{where}.position_m")
    return PlacedActor(
        actor=pick_actor(take_text(body, "actor", where), f"{where}.actor"),
        pose=from_carla_pose(
            position_m=np.append(position, 0.0),
            yaw_deg=take_number(body, "yaw_deg", where),
            pitch_deg=0.0,
        ),
    )
