"""Windows of traffic: what drives by while a run lasts, without those who would be in the way."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.actors import Actor, MovingActor, PlacedActor
from geometry.arrays import BoolArray, FloatArray
from geometry.footprints import FootprintSizes, separation_between
from scenarios.runs import Run

from .trajectories import Trajectories

REACH_M = 100.0
"""Vehicles farther than this from the middle of the junction are cut."""
_TOGETHER_M = 1.0e-3  # bodies nearer than this stand in one another


@dataclass(frozen=True, slots=True)
class TrafficCount:
    """Vehicles that drive by, in all runs together.

    Attributes
    ----------
    n_runs : int
        Number of runs.
    n_vehicles : int
        Near the junction, those left out among them.
    n_left_out : int
        Of these: they would have come into the way of VUT or VRU.
    n_departed : int
        By SUMO: entered the network.
    n_waiting : int
        By SUMO: found no room to.
    """

    n_runs: int = 0
    n_vehicles: int = 0
    n_left_out: int = 0
    n_departed: int = 0
    n_waiting: int = 0

    def __add__(self, other: "TrafficCount") -> "TrafficCount":
        return TrafficCount(
            self.n_runs + other.n_runs,
            self.n_vehicles + other.n_vehicles,
            self.n_left_out + other.n_left_out,
            self.n_departed + other.n_departed,
            self.n_waiting + other.n_waiting,
        )

    def __str__(self) -> str:
        text = (
            f"{self.n_left_out} of {self.n_vehicles} vehicles in {self.n_runs} runs left out: they "
            "would have been in the way"
        )
        if self.n_waiting:
            n_wanted = self.n_departed + self.n_waiting
            text += f"; SUMO found no room for {self.n_waiting} of {n_wanted} vehicles"
        return text


NO_TRAFFIC = TrafficCount()
"""Nobody drives by."""


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
    for vehicle in trajectories.between(float(time_s[0]), float(time_s[-1])).tolist():
        position, yaw = trajectories.at(vehicle, time_s)
        away = ~(np.hypot(*(position - middle_m).T) <= reach_m)
        if not away.all():
            position[away], yaw[away] = np.nan, np.nan
            bodies.append(
                MovingActor(actor=trajectories.bodies[vehicle], position_m=position, yaw_deg=yaw)
            )
    return tuple(bodies)


def last_frames(body: MovingActor, n_frames: int) -> MovingActor | None:
    """A vehicle in the last frames of its window; None if it is in none of them."""
    if n_frames == len(body.yaw_deg):
        return body
    position = body.position_m[-n_frames:]
    if np.isnan(position).all():
        return None
    return MovingActor(actor=body.actor, position_m=position, yaw_deg=body.yaw_deg[-n_frames:])


def frames_in_parked(
    window: Sequence[MovingActor], parked: Sequence[PlacedActor]
) -> tuple[BoolArray, ...]:
    """Frames in which each vehicle of a window, at least one, stands in something parked.

    Raises ValueError where vehicles have different numbers of frames.
    """
    position = np.stack([body.position_m for body in window])
    yaw = np.stack([body.yaw_deg for body in window])
    reach_m = np.array([_reach_m(body.actor) for body in window])
    is_in = np.zeros(yaw.shape, dtype=bool)
    for placed in parked:
        offset = position - placed.pose.position_m[:2]
        near = np.hypot(*np.moveaxis(offset, -1, 0)) <= reach_m[:, None] + _reach_m(placed.actor)
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
    """Which vehicles come nearer than the clearance to the VUT or the VRU before the impact.

    In any frame of the run, or midway between two.
    """
    if not traffic:
        return ()
    position, yaw = _twice(
        np.stack([body.position_m for body in traffic]), np.stack([b.yaw_deg for b in traffic])
    )
    reach_m = np.array([_reach_m(body.actor) for body in traffic])
    meets = np.zeros(len(traffic), dtype=bool)
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


def _twice(position_m: FloatArray, yaw_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frames, and the moments midway between them: (..., n, 2), (..., n) -> (..., 2 n - 1, ..)."""
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
    """Whether two bodies are nearer than so much, moment by moment."""
    one, other = actors
    sizes = FootprintSizes(
        length_a_m=one.length_m,
        width_a_m=one.width_m,
        length_b_m=other.length_m,
        width_b_m=other.width_m,
    )
    apart = separation_between(offset_m, yaw_a_deg, yaw_b_deg, sizes=sizes)
    nearer: BoolArray = apart <= limit_m
    return nearer
