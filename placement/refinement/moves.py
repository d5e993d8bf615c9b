"""What became of each unit of a layout."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from geometry.poses import wrap_deg
from geometry.sensors import CameraModel

from ..candidates import CandidatePose
from ..layout import Layout

_SAME_PLACE_M = 1.0e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Move:
    """One unit before and after.

    Attributes
    ----------
    before : CandidatePose, optional
        None: the unit is new.
    after : CandidatePose, optional
        None: the unit is gone.
    """

    before: CandidatePose | None
    after: CandidatePose | None

    @property
    def is_same_place(self) -> bool:
        """Whether the same sensor still hangs at the same place, maybe higher or lower."""
        return (
            self.before is not None
            and self.after is not None
            and is_same_place(self.before, self.after)
        )

    @property
    def turn_deg(self) -> float:
        """Change of the yaw, counter-clockwise."""
        assert self.before is not None
        assert self.after is not None
        return float(wrap_deg(self.after.pose.yaw_deg - self.before.pose.yaw_deg))

    @property
    def tilt_deg(self) -> float:
        """Change of the pitch, up."""
        assert self.before is not None
        assert self.after is not None
        return self.after.pose.pitch_deg - self.before.pose.pitch_deg

    @property
    def lift_m(self) -> float:
        """Change of the height, up."""
        assert self.before is not None
        assert self.after is not None
        return float(self.after.pose.position_m[2] - self.before.pose.position_m[2])

    @property
    def zoom_deg(self) -> float:
        """Change of the horizontal field of view; 0 for what has no lens."""
        assert self.before is not None
        assert self.after is not None
        old, new = self.before.sensor, self.after.sensor
        if not isinstance(old, CameraModel) or not isinstance(new, CameraModel):
            return 0.0
        return new.horizontal_fov_deg - old.horizontal_fov_deg


def is_same_place(one: CandidatePose, other: CandidatePose) -> bool:
    """Whether two poses are of one sensor model at one place, whatever their heights."""
    away_m = one.pose.position_m[:2] - other.pose.position_m[:2]
    return one.sensor.name == other.sensor.name and bool(np.hypot(*away_m) <= _SAME_PLACE_M)


def pair_units(
    before: Sequence[CandidatePose], after: Sequence[CandidatePose]
) -> list[tuple[int | None, int | None]]:
    """Which new pose each unit became: the nearest in direction at the same place.

    Parameters
    ----------
    before, after : sequence of CandidatePose
        Units of a layout, and poses of another one.

    Returns
    -------
    pairs : list of (int or None, int or None)
        Every index of both once: the old units in their order, then what is new.
    """
    distances = sorted(
        (_distance_deg(one, other), old, new)
        for old, one in enumerate(before)
        for new, other in enumerate(after)
        if is_same_place(one, other)
    )
    new_of: dict[int, int] = {}
    for _, old, new in distances:
        if old not in new_of and new not in new_of.values():
            new_of[old] = new
    pairs: list[tuple[int | None, int | None]] = [
        (old, new_of.get(old)) for old in range(len(before))
    ]
    return pairs + [(None, new) for new in range(len(after)) if new not in new_of.values()]


def rename(
    before: Layout, poses: Sequence[CandidatePose], *, named: Sequence[str], name: str
) -> tuple[Layout, tuple[Move, ...]]:
    """Layout of new poses, and what became of each unit of the old one.

    Parameters
    ----------
    before : Layout
        With the names that units keep at their place.
    poses : sequence of CandidatePose
        Under ids of their own.
    named : sequence of str
        Names that mean one pose and no other, such as those of an existing layout: who has another
        pose gets another name.
    name : str
        Of the layout.

    Returns
    -------
    layout : Layout
        Units in the order of the old ones, what is new behind.
    moves : tuple of Move
        Without those that stayed as they were.
    """
    taken = {unit.id for unit in before.units}
    free = (unit_id for unit_id in (f"U{n}" for n in count(1)) if unit_id not in taken)
    moves = []
    for old, new in pair_units(before.units, poses):
        unit = None if old is None else before.units[old]
        if new is None:
            moves.append(Move(before=unit, after=None))
            continue
        keeps_name = unit is not None and (unit.id not in named or unit.id == poses[new].id)
        unit_id = unit.id if unit is not None and keeps_name else next(free)
        moves.append(Move(before=unit, after=replace(poses[new], id=unit_id)))
    units = tuple(move.after for move in moves if move.after is not None)
    return Layout(name=name, units=units), tuple(m for m in moves if not _is_unchanged(m))


def _distance_deg(one: CandidatePose, other: CandidatePose) -> float:
    turn = float(wrap_deg(one.pose.yaw_deg - other.pose.yaw_deg))
    return abs(turn) + abs(one.pose.pitch_deg - other.pose.pitch_deg)


def _is_unchanged(move: Move) -> bool:
    return move.is_same_place and not any(
        (move.turn_deg, move.tilt_deg, move.lift_m, move.zoom_deg)
    )
