"""What stands still in pictures of a scene: preparing it takes long, and tests look at
few. And where they are taken from.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from geometry.actors import PlacedActor
from geometry.poses import Pose
from geometry.scene import Scene
from placement.imaging import Backdrop, build_backdrop

CORNER = Pose(
    position_m=np.array([-138.94, -11.56, 7.97]), yaw_deg=44.5, pitch_deg=-34.3
)
"""At a corner of the study's junction, towards its middle."""
_kept: dict[tuple[Any, ...], Backdrop] = {}


def kept_backdrop(scene: Scene, obstruction: Sequence[PlacedActor]) -> Backdrop:
    """As `build_backdrop`, which it asks once for each scene and what parks in it."""
    key = (scene, *(one.key for one in obstruction))
    if key not in _kept:
        _kept[key] = build_backdrop(scene, obstruction)
    return _kept[key]
