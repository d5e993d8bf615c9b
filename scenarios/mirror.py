"""Stagings seen in a mirror: what the protocol lays for traffic that keeps right, for the other."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from geometry.actors import PlacedActor
from geometry.arrays import FloatArray
from geometry.poses import Pose

from .paths import Motion, Path
from .staging import Staging

_NORTH_TO_SOUTH = np.array([1.0, -1.0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MirroredPath:
    """A path in a mirror that swaps north and south.

    Attributes
    ----------
    path : Path
        What stands before the mirror.
    """

    path: Path

    @property
    def max_turn_rad_per_m(self) -> float:
        """As before the mirror, in rad/m."""
        return self.path.max_turn_rad_per_m

    @property
    def max_turn_change_rad_per_m2(self) -> float:
        """As before the mirror, in rad/m^2."""
        return self.path.max_turn_change_rad_per_m2

    def at(self, distance_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """See :meth:`scenarios.paths.Path.at`."""
        position_m, yaw_deg = self.path.at(distance_m)
        return position_m * _NORTH_TO_SOUTH, -yaw_deg


def mirror_staging(staging: Staging) -> Staging:
    """A staging in a mirror that swaps north and south.

    The bodies are no mirror images: a pedestrian sets off with the same foot, and the driver's
    side of a parked car stays.
    """
    encounter = staging.encounter
    return Staging(
        encounter=replace(
            encounter,
            vut_motion=_mirror_motion(encounter.vut_motion),
            vru_motion=_mirror_motion(encounter.vru_motion),
        ),
        obstruction=tuple(_mirror_placed(placed) for placed in staging.obstruction),
    )


def _mirror_motion(motion: Motion) -> Motion:
    return replace(motion, path=MirroredPath(path=motion.path))


def _mirror_placed(placed: PlacedActor) -> PlacedActor:
    pose = placed.pose
    return replace(
        placed,
        pose=Pose(
            position_m=pose.position_m * [1.0, -1.0, 1.0],
            yaw_deg=-pose.yaw_deg,
            pitch_deg=pose.pitch_deg,
        ),
    )
