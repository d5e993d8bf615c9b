"""Parked cars and walls that hide the VRU."""

from dataclasses import replace
from functools import cache

import numpy as np

from geometry.actors import Actor, PlacedActor, Shape, park_row
from geometry.arrays import FloatArray
from geometry.poses import Pose

from .cases import Obstruction
from .encounters import Encounter
from .laying import load_obstruction_rules
from .staging import Staging
from .ways import StraightWay, Way

# Two triangles on each of a box's six sides, outward, for corners numbered as in `_build_wall`.
_BOX_TRIANGLES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ]
)  # fmt: skip


def hide(
    encounter: Encounter,
    obstruction: Obstruction,
    *,
    vut_way: Way,
    vut_m: float,
    vru_way: Way,
    vru_m: float,
) -> Staging:
    """An encounter with its obstruction in place, where the protocol has it.

    The ways cross at stations `vut_m` and `vru_m`.
    """
    vut_line, vru_line = vut_way.direction(vut_m), vru_way.direction(vru_m)
    vut, vru = encounter.vut, encounter.vru
    max_aside_m = load_obstruction_rules().max_aside_m[obstruction.kind]
    if obstruction.kind == "beside-vut":
        side = -float(np.sign(vut_line.left @ vru_line.direction))
        return Staging(
            encounter=encounter,
            obstruction=_beside_vut(
                obstruction, vut=vut, vut_way=vut_way, vut_m=vut_m, vru=vru, side=side
            ),
            aside=side * vut_line.left,
            back=-vut_line.direction,
            max_aside_m=max_aside_m,
        )
    # +1 if the VUT comes from the left of the VRU's way, -1 from its right
    side = -float(np.sign(vru_line.left @ vut_line.direction))
    actors = obstruction.bodies
    if obstruction.kind == "wall":
        actors = (_build_wall(*obstruction.wall_size_m),)
    return Staging(
        encounter=encounter,
        obstruction=_beside_vru(
            obstruction, actors, vru_way=vru_way, vru_m=vru_m, vru=vru, side=side
        ),
        aside=side * vru_line.left,
        back=-vru_line.direction,
        max_aside_m=max_aside_m,
    )


def moved(staging: Staging, *, aside_m: float, back_m: float) -> Staging:
    """A staging whose obstruction stands elsewhere; the rest stays."""
    east, north = aside_m * staging.aside + back_m * staging.back
    obstruction = tuple(
        replace(body, pose=replace(body.pose, position_m=body.pose.position_m + [east, north, 0.0]))
        for body in staging.obstruction
    )
    return replace(staging, obstruction=obstruction)


def _beside_vut(
    obstruction: Obstruction, *, vut: Actor, vut_way: Way, vut_m: float, vru: Actor, side: float
) -> tuple[PlacedActor, ...]:
    """Cars parked along the VUT's way, on the side from which the VRU comes.

    Their common centreline is such that the widest keeps the side gap; noses as the VUT's, the
    first one nearest to the VRU's line.
    """
    widest_m = max(actor.width_m for actor in obstruction.bodies)
    left_m = side * (0.5 * vut.width_m + obstruction.side_gap_m + 0.5 * widest_m)
    bumper_m = vut_m - 0.5 * vru.width_m - obstruction.first_gap_m
    if isinstance(vut_way, StraightWay):
        line = vut_way.line
        return park_row(
            obstruction.bodies,
            first_bumper_m=line.at(bumper_m, left_m),
            yaw_deg=line.yaw_deg,
            gap_m=obstruction.between_gap_m,
        )
    row_m = sum(actor.length_m + obstruction.between_gap_m for actor in obstruction.bodies)
    row, bumper_m = vut_way.beside(left_m, bumper_m, back_m=row_m, ahead_m=0.0)
    bodies = []
    for actor in obstruction.bodies:
        station_m = bumper_m - 0.5 * actor.length_m
        yaw_deg = row.direction(station_m).yaw_deg
        bodies.append(_placed(actor, row.point(station_m, 0.0), yaw_deg))
        bumper_m -= actor.length_m + obstruction.between_gap_m
    return tuple(bodies)


def _beside_vru(
    obstruction: Obstruction,
    actors: tuple[Actor, ...],
    *,
    vru_way: Way,
    vru_m: float,
    vru: Actor,
    side: float,
) -> tuple[PlacedActor, ...]:
    """Cars or a wall beside the VRU's way, between it and the coming VUT.

    The sides towards the VRU are flush; cars' noses look away from the VUT's way.
    """
    bodies = []
    rear_m = obstruction.first_gap_m
    for actor in actors:
        beside_m = 0.5 * vru.width_m + obstruction.side_gap_m + 0.5 * actor.width_m
        station_m = vru_m - (rear_m + 0.5 * actor.length_m)
        line = vru_way.direction(station_m)
        if actor.class_name != "wall":
            line = line.turned(180.0)
        bodies.append(_placed(actor, vru_way.point(station_m, side * beside_m), line.yaw_deg))
        rear_m += actor.length_m + obstruction.between_gap_m
    return tuple(bodies)


def _placed(actor: Actor, point_m: FloatArray, yaw_deg: float) -> PlacedActor:
    return PlacedActor(actor=actor, pose=Pose(position_m=np.append(point_m, 0.0), yaw_deg=yaw_deg))


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
