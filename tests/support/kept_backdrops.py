"""What stands still in pictures of a scene: preparing it takes long, and tests look at
few.
"""

from collections.abc import Sequence
from typing import Any

from geometry.actors import PlacedActor
from geometry.scene import Scene
from placement.imaging import Backdrop, build_backdrop

_kept: dict[tuple[Any, ...], Backdrop] = {}


def kept_backdrop(scene: Scene, obstruction: Sequence[PlacedActor]) -> Backdrop:
    """As `build_backdrop`, which it asks once for each scene and what parks in it."""
    key = (scene, *(one.key for one in obstruction))
    if key not in _kept:
        _kept[key] = build_backdrop(scene, obstruction)
    return _kept[key]
