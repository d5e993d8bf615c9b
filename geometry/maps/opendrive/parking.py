"""Parking spaces, taken together as rows along the road."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..model import MapLane
from .copies import Copy, Outline, Sweep, box_corners
from .roads import Road

_SAME_ROW_T_M = 1.0
_SAME_ROW_GAP_M = 1.5
_STEP_M = 2.0
_MIN_SIZE_M = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Space:
    """A parking space, as its box along the road.

    Attributes
    ----------
    first_m, last_m : float
        Where it begins and ends along the road. [m]
    right_m, left_m : float
        And beside it, to the left of the reference line. [m]
    """

    first_m: float
    last_m: float
    right_m: float
    left_m: float

    @property
    def t_m(self) -> float:
        """Of its middle, to the left of the reference line, in metres."""
        return 0.5 * (self.right_m + self.left_m)


def read_space(one: Copy | Sweep, outlines: Sequence[Outline], turn_rad: float) -> Space | None:
    """One parking space, or a strip of them; None: it has no extent.

    Parameters
    ----------
    one : Copy or Sweep
        Where.
    outlines : sequence of Outline
        What it has there.
    turn_rad : float
        Of its length against the road. [rad]
    """
    if isinstance(one, Sweep):
        start, end = one.start, one.end
        if start.width_m is None:
            return None
        t_m, half_m = 0.5 * (start.t_m + end.t_m), 0.5 * start.width_m
        corners = np.array([[start.s_m, t_m - half_m], [end.s_m, t_m + half_m]])
    else:
        outer = next((outline for outline in outlines if outline.is_outer), None)
        if outer is not None:
            corners = outer.road_m
        else:
            box = box_corners(one, turn_rad)
            if box is None:
                return None
            corners = box
    (first_m, right_m), (last_m, left_m) = corners.min(axis=0), corners.max(axis=0)
    if min(last_m - first_m, left_m - right_m) < _MIN_SIZE_M:
        return None
    return Space(
        first_m=float(first_m),
        last_m=float(last_m),
        right_m=float(right_m),
        left_m=float(left_m),
    )


def build_rows(road: Road, spaces: Sequence[Space]) -> list[MapLane]:
    """Parking lanes of a road: spaces that lie side by side, or one behind the other.

    Parameters
    ----------
    road : Road
        That the spaces belong to.
    spaces : sequence of Space
        In any order.

    Returns
    -------
    lanes : list of MapLane
        As wide as the spaces reach across; in the direction of the traffic on their side.
    """
    rows: list[list[Space]] = []
    open_rows: list[list[Space]] = []  # those that may still go on
    for space in sorted(spaces, key=lambda space: space.first_m):
        reach_m = space.first_m - _SAME_ROW_GAP_M
        open_rows = [row for row in open_rows if row[-1].last_m >= reach_m]
        for row in open_rows:
            if abs(row[-1].t_m - space.t_m) <= _SAME_ROW_T_M:
                row.append(space)
                break
        else:
            rows.append([space])
            open_rows.append(rows[-1])
    return [
        lane
        for index, row in enumerate(rows)
        if (lane := _build_row(road, row, f"{road.id}/parking {index + 1}")) is not None
    ]


def _build_row(road: Road, row: Sequence[Space], name: str) -> MapLane | None:
    first_m = max(min(space.first_m for space in row), 0.0)
    last_m = min(max(space.last_m for space in row), road.length_m)
    if last_m - first_m < _MIN_SIZE_M:
        return None
    s_m = np.linspace(first_m, last_m, max(2, int(np.ceil((last_m - first_m) / _STEP_M)) + 1))
    middles = np.array([0.5 * (space.first_m + space.last_m) for space in row])
    order = np.argsort(middles)
    t_m = np.interp(s_m, middles[order], np.array([space.t_m for space in row])[order])
    points, _ = road.place(s_m, t_m)
    follows = (float(t_m.mean()) < 0.0) != road.keeps_left
    return MapLane(
        id=name,
        kind="parking",
        width_m=float(np.mean([space.left_m - space.right_m for space in row])),
        centreline_m=points if follows else points[::-1],
    )
