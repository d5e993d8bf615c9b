"""Parked cars and walls that hide the VRU of a case, laid beside the ways of VUT and VRU."""

from functools import cache

import numpy as np

from geometry.actors import Actor, PlacedActor, Shape
from geometry.junction import Line
from geometry.parking import park_row
from geometry.poses import Pose

from .cases import Obstruction

# Two triangles on each of a box's six sides, outward, for corners numbered as in `_build_wall`.
_BOX_TRIANGLES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ]
)  # fmt: skip


def place_beside_vut(
    obstruction: Obstruction, *, vut: Actor, vut_line: Line, vru: Actor, vru_line: Line
) -> tuple[PlacedActor, ...]:
    """Cars parked along the VUT's way, on the side from which the VRU comes.

    Parameters
    ----------
    obstruction : Obstruction
        Bodies and gaps. Their common centreline is such that the widest keeps the side gap.
    vut, vut_line : Actor, Line
        The vehicle under test and its way.
    vru, vru_line : Actor, Line
        The VRU and its way; the line's point is where the two ways cross.

    Returns
    -------
    bodies : tuple of PlacedActor
        Noses as the VUT's, the first one nearest to the VRU's line.
    """
    side = -float(np.sign(vut_line.left @ vru_line.direction))
    widest_m = max(actor.width_m for actor in obstruction.bodies)
    beside_m = 0.5 * vut.width_m + obstruction.side_gap_m + 0.5 * widest_m
    crossing_m = float(vut_line.coordinates(vru_line.point_m)[0])
    bumper = vut_line.at(crossing_m - 0.5 * vru.width_m - obstruction.first_gap_m, side * beside_m)
    return park_row(
        obstruction.bodies,
        first_bumper_m=bumper,
        yaw_deg=vut_line.yaw_deg,
        gap_m=obstruction.between_gap_m,
    )


def place_beside_vru(
    obstruction: Obstruction, *, vut: Actor, vut_line: Line, vru: Actor, vru_line: Line
) -> tuple[PlacedActor, ...]:
    """Cars parked beside the VRU's way, between it and the coming VUT; noses away from the VUT's.

    Parameters and result as for :func:`place_beside_vut`; the sides towards the VRU are flush.
    """
    bodies = []
    rear_m = obstruction.first_gap_m
    for actor in obstruction.bodies:
        beside_m = 0.5 * vru.width_m + obstruction.side_gap_m + 0.5 * actor.width_m
        middle = vru_line.at(
            -(rear_m + 0.5 * actor.length_m), _vut_side(vut_line, vru_line) * beside_m
        )
        pose = Pose(position_m=np.append(middle, 0.0), yaw_deg=vru_line.turned(180.0).yaw_deg)
        bodies.append(PlacedActor(actor=actor, pose=pose))
        rear_m += actor.length_m + obstruction.between_gap_m
    return tuple(bodies)


def place_wall(
    obstruction: Obstruction, *, vut: Actor, vut_line: Line, vru: Actor, vru_line: Line
) -> tuple[PlacedActor, ...]:
    """A wall beside the VRU's way, between it and the coming VUT.

    Parameters and result as for :func:`place_beside_vut`; one body.
    """
    wall = _build_wall(*obstruction.wall_size_m)
    beside_m = 0.5 * vru.width_m + obstruction.side_gap_m + 0.5 * wall.width_m
    middle = vru_line.at(
        -(obstruction.first_gap_m + 0.5 * wall.length_m), _vut_side(vut_line, vru_line) * beside_m
    )
    pose = Pose(position_m=np.append(middle, 0.0), yaw_deg=vru_line.yaw_deg)
    return (PlacedActor(actor=wall, pose=pose),)


def _vut_side(vut_line: Line, vru_line: Line) -> float:
    """+1 if the VUT comes from the left of the VRU's way, -1 from its right."""
    return -float(np.sign(vru_line.left @ vut_line.direction))


@cache
def _build_wall(length_m: float, thickness_m: float, height_m: float) -> Actor:
    corners = np.array(
        [
            [x * length_m, y * thickness_m, z * height_m]
            for z in (0.0, 1.0)
            for y in (-0.5, 0.5)
            for x in (-0.5, 0.5)
        ]
    )
    return Actor(
        name=f"wall {length_m:g} x {thickness_m:g} x {height_m:g} m",
        class_name="wall",
        length_m=length_m,
        width_m=thickness_m,
        height_m=height_m,
        shapes=(Shape(vertices_m=corners, triangles=_BOX_TRIANGLES),),
        cycle_m=0.0,
        reference_ahead_m=0.0,
        wheelbase_m=0.0,
        front_axle_ahead_m=0.0,
    )
