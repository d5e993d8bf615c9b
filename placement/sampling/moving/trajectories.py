"""Where vehicles are at what time, sampled at a steady step."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray, IntArray, freeze

_GAP_STEPS = 1.5  # a vehicle that is away for longer than so many steps has left and come back


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
            object.__setattr__(self, name, freeze(np.array(getattr(self, name), dtype=np.float64)))
        object.__setattr__(self, "row_start", freeze(np.array(self.row_start, dtype=np.int64)))

    def __repr__(self) -> str:
        return f"Trajectories({len(self.bodies)} vehicles, {len(self.time_s)} samples)"

    def between(self, first_s: float, last_s: float) -> IntArray:
        """Vehicles with samples that may reach into a span of time, (n,)."""
        begin = self.time_s[self.row_start[:-1]]
        end = self.time_s[self.row_start[1:] - 1]
        return np.flatnonzero((begin <= last_s) & (end >= first_s))

    def at(self, vehicle: int, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position (n, 2) and yaw (n,) of a vehicle at any times (n,), between samples linearly.

        Not a number before it comes, after it has left, and while it is away.
        """
        rows = slice(int(self.row_start[vehicle]), int(self.row_start[vehicle + 1]))
        known_s = self.time_s[rows]
        tolerance_s = 1.0e-6
        clipped = np.clip(time_s, known_s[0], known_s[-1])
        values = [
            np.interp(clipped, known_s, column)
            for column in (*self.position_m[rows].T, self.yaw_deg[rows])
        ]
        after = np.clip(np.searchsorted(known_s, time_s - tolerance_s), 0, len(known_s) - 1)
        before = np.searchsorted(known_s, time_s + tolerance_s, side="right") - 1
        is_away = np.abs(clipped - time_s) > tolerance_s
        is_away |= known_s[after] - known_s[np.clip(before, 0, None)] > _GAP_STEPS * self.step_s
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
    order = np.lexsort((time_s, vehicle))
    vehicle, time_s, front_m = vehicle[order], time_s[order], front_m[order]
    yaw = np.radians(90.0 - angle_deg[order])
    present, row_start = np.unique(vehicle, return_index=True)
    row_start = np.append(row_start, len(vehicle))
    half_m = 0.5 * np.array([body.length_m for body in bodies])[vehicle] if len(vehicle) else yaw
    position = front_m - half_m[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
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
