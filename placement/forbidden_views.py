"""Registry of the areas that cameras must not look into.

And which poses respect them.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.errors import refuse
from geometry.registry import pick_entry
from geometry.scene import Scene

from .candidates import CandidatePose

_GIS_FILES = "placement.private_ground:load_private_ground"
READERS = {
    ".geojson": _GIS_FILES,
    ".json": _GIS_FILES,
    ".gpkg": _GIS_FILES,
    ".shp": _GIS_FILES,
    ".zip": _GIS_FILES,
}
"""Readers of areas, by the suffix of the file; each entry is an :class:`AreaReader`."""


class ForbiddenAreas(Protocol):
    """Areas that cameras must not look into."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the areas."""

    @property
    def area_m2(self) -> FloatArray:
        """Size of each, (n_areas,), in square metres."""

    def shares(self, scene: Scene, candidates: Sequence[CandidatePose]) -> FloatArray:
        """Share of each area that each pose sees, (n_candidates, n_areas), 0 .. 1."""


class AreaReader(Protocol):
    """What reads areas from a file."""

    def __call__(self, path: Path, scene: Scene) -> ForbiddenAreas:
        """Areas in a scene's world frame. Raises InputError: the file is no such."""


def load_forbidden_areas(path: Path, scene: Scene) -> ForbiddenAreas:
    """Areas of a file that cameras must not look into, in a scene's world frame.

    Raises InputError if the file is of no known kind, or cannot be used.
    """
    read: AreaReader = pick_entry(READERS, path.suffix.lower(), where=str(path))
    return read(path, scene)


def respects_private_ground(shares: FloatArray, *, max_share: float) -> BoolArray:
    """True for candidates that respect every private area.

    They see at most `max_share` of it; (n_candidates,) bool. Raises InputError
    where no candidate is left.
    """
    share = shares.max(axis=1)
    kept = np.asarray(share <= max_share)
    if not kept.any():
        least = np.ceil(1000.0 * share.min()) / 1000.0
        expected = (
            f"at least {least:g}, the share that the pose with the least in its picture"
            " sees"
        )
        refuse("no_look_share", f"{100.0 * max_share:.1f} %", expected)
    return kept
