"""Trajectories of vehicles, and the windows that runs cut of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.actors import Actor, MovingActor, PlacedActor, footprint_sizes
from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.footprints import gaps_between
from scenarios.runs import Run

# A vehicle that is away for longer than so many steps has left and come back.
_GAP_STEPS = 1.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectories:
    """Vehicles on the road, each with samples in ascending order of time.

    Attributes
    ----------
    bodies : tuple of Actor
        One per vehicle.
    row_start : (n_vehicles + 1,) int
        Samples of vehicle v are row_start[v] .. row_start[v + 1] - 1.
    time_s : (n_rows,) float
        On any clock. [s]
    position_m : (n_rows, 2) float
        Middle of the footprint. World frame. [m]
    yaw_deg : (n_rows,) float
        Without jumps of a full turn from sample to sample of a vehicle. [deg]
    step_s : float
        From sample to sample. [s]
    first_s, last_s : float
        From when to when traffic is known. [s]
    """

    bodies: tuple[Actor, ...]
    row_start: IntArray
    time_s: FloatArray
    position_m: FloatArray
    yaw_deg: FloatArray
    step_s: float
    first_s: float
    last_s: float

    def __post_init__(self) -> None:
        for name in ("time_s", "position_m", "yaw_deg"):
            object.__setattr__(
                self, name, freeze(np.array(getattr(self, name), dtype=np.float64))
            )
        object.__setattr__(
            self, "row_start", freeze(np.array(self.row_start, dtype=np.int64))
        )

    def between(self, first_s: float, last_s: float) -> IntArray:
        """Vehicles with samples that may reach into a span of time, (n,)."""
        begin = self.time_s[self.row_start[:-1]]
        end = self.time_s[self.row_start[1:] - 1]
        return np.flatnonzero((begin <= last_s) & (end >= first_s))

    def at(self, vehicle: int, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position (n, 2) and yaw (n,) of a vehicle at times (n,).

        Between samples they are linear. Not a number before it comes, after it has
        left, and while it is away.
        """
        rows = slice(int(self.row_start[vehicle]), int(self.row_start[vehicle + 1]))
        known_s = self.time_s[rows]
        tolerance_s = 1.0e-6
        clipped = np.clip(time_s, known_s[0], known_s[-1])
        values = [
            np.interp(clipped, known_s, column)
            for column in (*self.position_m[rows].T, self.yaw_deg[rows])
        ]
        # A vehicle is away where its neighbouring samples are far apart.
        after = np.clip(
            np.searchsorted(known_s, time_s - tolerance_s), 0, len(known_s) - 1
        )
        before = np.searchsorted(known_s, time_s + tolerance_s, side="right") - 1
        is_away = np.abs(clipped - time_s) > tolerance_s
        is_away |= (
            known_s[after] - known_s[np.clip(before, 0, None)]
            > _GAP_STEPS * self.step_s
        )
        east, north, yaw_deg = (np.where(is_away, np.nan, column) for column in values)
        return np.column_stack([east, north]), yaw_deg


def build_trajectories(
    bodies: tuple[Actor, ...],
    *,
    vehicle: IntArray,
    time_s: FloatArray,
    front_m: FloatArray,
    angle_deg: FloatArray,
    step_s: float,
    span_s: tuple[float, float],
) -> Trajectories:
    """Trajectories from what SUMO tells, sample by sample, in any order.

    Parameters
    ----------
    bodies : tuple of Actor
        By number; those without a sample are dropped.
    vehicle : (n,) int
        Number of the vehicle of each sample.
    time_s : (n,) float
        When. [s]
    front_m : (n, 2) float
        Middle of the front bumper, in the world frame, as SUMO's x and y. [m]
    angle_deg : (n,) float
        Clockwise from north, as SUMO's angle. [deg]
    step_s : float
        From sample to sample. [s]
    span_s : (float, float)
        From when to when traffic is known. [s]
    """
    # Sort by vehicle, then by time.
    order = np.lexsort((time_s, vehicle))
    vehicle = vehicle[order]
    time_s = time_s[order]
    front_m = front_m[order]
    yaw = np.radians(90.0 - angle_deg[order])
    present, row_start = np.unique(vehicle, return_index=True)
    row_start = np.append(row_start, len(vehicle))
    if len(vehicle):
        half_m = 0.5 * np.array([body.length_m for body in bodies])[vehicle]
    else:
        half_m = yaw
    # From the front bumper back to the middle of the body.
    position = front_m - half_m[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
    # Yaws of a vehicle go on without jumps of a full turn.
    unwrapped = yaw.copy()
    for first, end in pairwise(row_start.tolist()):
        unwrapped[first:end] = np.unwrap(yaw[first:end])
    return Trajectories(
        bodies=tuple(bodies[number] for number in present.tolist()),
        row_start=row_start,
        time_s=time_s,
        position_m=position,
        yaw_deg=np.degrees(unwrapped),
        step_s=step_s,
        first_s=span_s[0],
        last_s=span_s[1],
    )


# ---------- windows
# Vehicles farther than this from the middle of the junction are cut.
REACH_M = 100.0
# Bodies nearer than this stand in one another.
_TOGETHER_M = 1.0e-3


def cut_window(
    trajectories: Trajectories,
    time_s: FloatArray,
    *,
    middle_m: FloatArray,
    reach_m: float = REACH_M,
) -> tuple[MovingActor, ...]:
    """Vehicles near a point at some times.

    Parameters
    ----------
    trajectories : Trajectories
        Vehicles on the road.
    time_s : (n_frames,) float
        On their clock, ascending. [s]
    middle_m : (2,) float
        The point. [m]
    reach_m : float
        Frames in which a vehicle is farther away are cut; so is who is never near. [m]
    """
    bodies = []
    # Frames out of reach are NaN; vehicles that are never near are left out.
    for vehicle in trajectories.between(float(time_s[0]), float(time_s[-1])).tolist():
        position, yaw = trajectories.at(vehicle, time_s)
        away = ~(np.hypot(*(position - middle_m).T) <= reach_m)
        if not away.all():
            position[away] = np.nan
            yaw[away] = np.nan
            bodies.append(
                MovingActor(
                    actor=trajectories.bodies[vehicle], position_m=position, yaw_deg=yaw
                )
            )
    return tuple(bodies)


def last_frames(body: MovingActor, n_frames: int) -> MovingActor | None:
    """A vehicle in the last frames of its window; None if it is in none of them."""
    if n_frames == len(body.yaw_deg):
        return body
    position = body.position_m[-n_frames:]
    if np.isnan(position).all():
        return None
    return MovingActor(
        actor=body.actor, position_m=position, yaw_deg=body.yaw_deg[-n_frames:]
    )


def frames_in_parked(
    window: Sequence[MovingActor], parked: Sequence[PlacedActor]
) -> tuple[BoolArray, ...]:
    """Frames in which vehicles stand in something parked.

    The window has at least one vehicle; each has (n_frames,) bool. Raises
    ValueError where vehicles have different numbers of frames.
    """
    position = np.stack([body.position_m for body in window])
    yaw = np.stack([body.yaw_deg for body in window])
    reach_m = np.array([_reach_m(body.actor) for body in window])
    is_in = np.zeros(yaw.shape, dtype=bool)
    # Circles around the bodies sort out most frames.
    for placed in parked:
        offset = position - placed.pose.position_m[:2]
        near = np.hypot(*np.moveaxis(offset, -1, 0)) <= reach_m[:, None] + _reach_m(
            placed.actor
        )
        for row in np.flatnonzero(near.any(axis=1)).tolist():
            frames = near[row]
            is_in[row, frames] |= _is_nearer(
                _TOGETHER_M,
                (placed.actor, window[row].actor),
                offset[row, frames],
                np.full(int(frames.sum()), placed.pose.yaw_deg),
                yaw[row, frames],
            )
    return tuple(is_in)


def meets_road_users(
    run: Run, traffic: Sequence[MovingActor], *, clearance_m: float
) -> tuple[bool, ...]:
    """True for vehicles that come too near to the VUT or the VRU.

    That is nearer than the clearance, before the impact. In any frame of the run,
    or midway between two.
    """
    if not traffic:
        return ()
    position, yaw = _twice(
        np.stack([body.position_m for body in traffic]),
        np.stack([b.yaw_deg for b in traffic]),
    )
    reach_m = np.array([_reach_m(body.actor) for body in traffic])
    meets = np.zeros(len(traffic), dtype=bool)
    # The VUT, then the VRU.
    for actor, own_m, own_yaw_deg in (
        (run.encounter.vut, run.vut_position_m, run.vut_yaw_deg),
        (run.encounter.vru, run.vru_position_m, run.vru_yaw_deg),
    ):
        own_position, own_yaw = _twice(own_m, own_yaw_deg)
        offset = position - own_position
        limit_m = reach_m[:, None] + _reach_m(actor) + clearance_m
        near = np.hypot(*np.moveaxis(offset, -1, 0)) <= limit_m
        for row in np.flatnonzero(near.any(axis=1) & ~meets).tolist():
            frames = near[row]
            meets[row] = _is_nearer(
                clearance_m,
                (actor, traffic[row].actor),
                offset[row, frames],
                own_yaw[frames],
                yaw[row, frames],
            ).any()
    return tuple(meets.tolist())


def _twice(
    position_m: FloatArray, yaw_deg: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Frames, and the moments midway between them.

    Shapes are (..., n, 2) and (..., n) -> (..., 2 n - 1, 2) and (..., 2 n - 1).
    """
    turn_deg = (np.diff(yaw_deg, axis=-1) + 180.0) % 360.0 - 180.0
    midway_m = 0.5 * (position_m[..., 1:, :] + position_m[..., :-1, :])
    return (
        np.concatenate([position_m, midway_m], axis=-2),
        np.concatenate([yaw_deg, yaw_deg[..., :-1] + 0.5 * turn_deg], axis=-1),
    )


def _reach_m(actor: Actor) -> float:
    return 0.5 * float(np.hypot(actor.length_m, actor.width_m))


def _is_nearer(
    limit_m: float,
    actors: tuple[Actor, Actor],
    offset_m: FloatArray,
    yaw_a_deg: FloatArray,
    yaw_b_deg: FloatArray,
) -> BoolArray:
    """Moments at which two bodies are nearer than a limit."""
    gaps_m = gaps_between(
        offset_m, yaw_a_deg, yaw_b_deg, sizes=footprint_sizes(*actors)
    )
    return np.asarray(gaps_m.max(axis=0) <= limit_m)
