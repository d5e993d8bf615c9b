"""What can hang at a junction that has units already: those, the same turned, and new ones."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import IntArray
from geometry.errors import InputError

from .candidates import CandidateGrid, CandidatePose, is_turn_useless
from .layout import Layout

_SAME_DEG = 1.0e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RetrofitPoses:
    """Everything that can hang in the end.

    Attributes
    ----------
    candidates : tuple of CandidatePose
        The units as they hang, in the layout's order; then their re-aims; then what can be added.
    unit_index : (n_poses,) int
        Which unit each of them is; -1: a new one.
    """

    candidates: tuple[CandidatePose, ...]
    unit_index: IntArray

    @property
    def n_units(self) -> int:
        """Units that hang already."""
        return int(self.unit_index.max()) + 1

    def aims_of(self, unit: int) -> IntArray:
        """Rows of the re-aims of a unit."""
        rows: IntArray = np.flatnonzero(self.unit_index == unit)
        return rows[rows >= self.n_units]


def build_retrofit_poses(
    layout: Layout, grid: CandidateGrid, additions: Sequence[CandidatePose]
) -> RetrofitPoses:
    """The units, their re-aims (same place and sensor, directions of a grid), and new poses.

    Parameters
    ----------
    layout : Layout
        What hangs.
    grid : CandidateGrid
        Only its directions.
    additions : sequence of CandidatePose
        What can be added; poses with the id of a unit are left out.

    Raises
    ------
    InputError
        Two ids are equal.
    """
    aims = [
        (number, _aimed(unit, yaw_deg=yaw_deg, pitch_deg=pitch_deg))
        for number, unit in enumerate(layout.units)
        for yaw_deg, pitch_deg in grid.directions_deg(unit.sensor)
        if not _looks_there(unit, yaw_deg=yaw_deg, pitch_deg=pitch_deg)
    ]
    taken = {unit.id for unit in layout.units}
    new = [candidate for candidate in additions if candidate.id not in taken]
    candidates = (*layout.units, *(aim for _, aim in aims), *new)
    ids = [candidate.id for candidate in candidates]
    if len(set(ids)) < len(ids):
        repeated = next(name for name in ids if ids.count(name) > 1)
        raise InputError(f"layout {layout.name}: id", repeated, "ids unlike those of candidates")
    numbers = [*range(len(layout.units)), *(number for number, _ in aims), *([-1] * len(new))]
    return RetrofitPoses(candidates=candidates, unit_index=np.array(numbers, dtype=np.int64))


def _aimed(unit: CandidatePose, *, yaw_deg: float, pitch_deg: float) -> CandidatePose:
    pose = replace(unit.pose, yaw_deg=yaw_deg, pitch_deg=pitch_deg)
    return replace(unit, id=f"{unit.id}/aim/{yaw_deg:g}/{pitch_deg:g}", pose=pose)


def _looks_there(unit: CandidatePose, *, yaw_deg: float, pitch_deg: float) -> bool:
    turn_deg = (unit.pose.yaw_deg - yaw_deg + 180.0) % 360.0 - 180.0
    if is_turn_useless(unit.sensor, pitch_deg=pitch_deg):
        turn_deg = 0.0
    return max(abs(turn_deg), abs(unit.pose.pitch_deg - pitch_deg)) <= _SAME_DEG
