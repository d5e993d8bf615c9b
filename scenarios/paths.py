"""Paths on the road plane and motion along them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray, float_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StraightPath:
    """A straight line, driven in one direction.

    Attributes
    ----------
    start_m : (2,) float
        East, north at distance 0. [m]
    yaw_deg : float
        Direction, counter-clockwise from east. [deg]
    """

    start_m: FloatArray
    yaw_deg: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "start_m", float_array(self.start_m, (2,), "start_m"))

    @property
    def direction(self) -> FloatArray:
        """Unit vector of the driving direction, (2,)."""
        yaw = np.radians(self.yaw_deg)
        return np.array([np.cos(yaw), np.sin(yaw)])

    def at(self, distance_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position and heading after a distance.

        Parameters
        ----------
        distance_m : (...,) float
            Along the path; may be negative or beyond its end. [m]

        Returns
        -------
        position_m : (..., 2) float
            East, north. [m]
        yaw_deg : (...,) float
            Heading. [deg]
        """
        distance = np.asarray(distance_m, dtype=np.float64)
        position: FloatArray = self.start_m + distance[..., None] * self.direction
        return position, np.full(distance.shape, self.yaw_deg)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Stands at the path's start, sets off at `start_time_s` and keeps its speed.

    Attributes
    ----------
    path : StraightPath
        Where to.
    speed_mps : float
        Constant. [m/s]
    start_time_s : float
        When it sets off; the impact is at 0. [s]
    """

    path: StraightPath
    speed_mps: float
    start_time_s: float

    def distance_m(self, time_s: ArrayLike) -> FloatArray:
        """Distance from the path's start at each time, in metres."""
        moving_s = np.maximum(0.0, np.asarray(time_s, dtype=np.float64) - self.start_time_s)
        return self.speed_mps * moving_s
