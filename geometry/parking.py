"""Bodies parked one behind the other."""

from collections.abc import Sequence

import numpy as np

from .actors import Actor, PlacedActor
from .arrays import FloatArray
from .poses import Pose


def park_row(
    actors: Sequence[Actor], *, first_bumper_m: FloatArray, yaw_deg: float, gap_m: float
) -> tuple[PlacedActor, ...]:
    """Place bodies nose to tail, the first one in front.

    Parameters
    ----------
    actors : sequence of Actor
        From the first to the last.
    first_bumper_m : (2,) float
        Middle of the first one's front bumper. World frame. [m]
    yaw_deg : float
        Where all of them look. [deg]
    gap_m : float
        From bumper to bumper. [m]

    Returns
    -------
    row : tuple of PlacedActor
        In the order given.
    """
    yaw = np.radians(yaw_deg)
    backwards = -np.array([np.cos(yaw), np.sin(yaw)])
    bumper = np.asarray(first_bumper_m, dtype=np.float64)
    row = []
    for actor in actors:
        middle = np.append(bumper + 0.5 * actor.length_m * backwards, 0.0)
        row.append(PlacedActor(actor=actor, pose=Pose(position_m=middle, yaw_deg=yaw_deg)))
        bumper = bumper + (actor.length_m + gap_m) * backwards
    return tuple(row)
