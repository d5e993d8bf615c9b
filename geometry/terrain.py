"""Ground that is not flat: heights on a regular grid.

The heights are kept as the mesh of the scene's ground.

The mesh is what rays meet, and heights are those of its triangles: bodies stand on it
exactly. In plan everything stays as it is: paths, lanes and braking are those of the
plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon

from .actors import PlacedActor
from .arrays import FloatArray, float_array
from .errors import InputError, refuse
from .scene import Scene, thing_footprint

GROUND = "ground"
"""Id and class of the ground of a scene."""
HEADROOM_M = 2.0
"""People, cyclists and cars pass below what begins higher above the ground."""
GRID_DECIMALS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Terrain:
    """Heights of the ground on a grid.

    Attributes
    ----------
    east_m, north_m : (n_columns,), (n_rows,) float
        Lines of the grid, in rising order. World frame. [m]
    height_m : (n_rows, n_columns) float
        Of its nodes; the ground between them is two triangles per cell. [m]
    """

    east_m: FloatArray
    north_m: FloatArray
    height_m: FloatArray

    def __post_init__(self) -> None:
        for name in ("east_m", "north_m"):
            line = float_array(getattr(self, name), (-1,), f"terrain.{name}")
            if len(line) < 2 or (np.diff(line) <= 0.0).any():
                raise InputError(
                    f"terrain.{name}", len(line), "at least two, in rising order"
                )
            object.__setattr__(self, name, line)
        shape = (len(self.north_m), len(self.east_m))
        object.__setattr__(
            self, "height_m", float_array(self.height_m, shape, "terrain.height_m")
        )

    def at(self, points_m: ArrayLike) -> FloatArray:
        """Height of the ground at points (..., 2), in metres.

        Beyond the grid it is that of the grid's edge.

        >>> slope = Terrain(east_m=[0, 10], north_m=[0, 10], height_m=[[0, 1], [0, 1]])
        >>> slope.at([[5.0, 2.0], [20.0, 0.0]])
        array([0.5, 1. ])
        """
        points = np.asarray(points_m, dtype=np.float64)
        column, u = _cell(self.east_m, points[..., 0])
        row, v = _cell(self.north_m, points[..., 1])
        z = self.height_m
        south_west = z[row, column]
        north_east = z[row + 1, column + 1]
        south_east = z[row, column + 1]
        north_west = z[row + 1, column]
        # South-east of the diagonal and north-west of it the triangles differ.
        return np.where(
            u >= v,
            south_west + u * (south_east - south_west) + v * (north_east - south_east),
            south_west + v * (north_west - south_west) + u * (north_east - north_west),
        )

    def mesh(self) -> tuple[FloatArray, NDArray[np.int32]]:
        """Vertices (n, 3) and triangles (m, 3), seen from above counter-clockwise."""
        east, north = np.meshgrid(self.east_m, self.north_m)
        vertices = np.stack([east, north, self.height_m], axis=-1).reshape(-1, 3)
        n_rows, n_columns = self.height_m.shape
        node = np.arange(n_rows * n_columns, dtype=np.int32).reshape(n_rows, n_columns)
        south_west = node[:-1, :-1].ravel()
        south_east = node[:-1, 1:].ravel()
        north_west = node[1:, :-1].ravel()
        north_east = node[1:, 1:].ravel()
        corners = [
            south_west,
            south_east,
            north_east,
            south_west,
            north_east,
            north_west,
        ]
        return vertices, np.stack(corners, axis=1).reshape(-1, 3)


def _cell(
    lines_m: FloatArray, values_m: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Cell of each value between lines, and how far it lies in it, 0 .. 1."""
    inside = np.clip(values_m, lines_m[0], lines_m[-1])
    index = np.clip(
        np.searchsorted(lines_m, inside, side="right") - 1, 0, len(lines_m) - 2
    )
    return index, (inside - lines_m[index]) / (lines_m[index + 1] - lines_m[index])


@lru_cache(maxsize=64)
def terrain_of(scene: Scene) -> Terrain | None:
    """Terrain of a scene, from the mesh of its ground.

    None: the ground is the plane z = 0.

    Raises
    ------
    InputError
        The nodes of the ground are no grid.
    """
    index = [
        number for number, one in enumerate(scene.instances) if one.class_name == GROUND
    ]
    nodes = scene.vertices_m[
        np.unique(scene.triangles[np.isin(scene.triangle_instance, index)])
    ]
    if not nodes[:, 2].any():
        return None
    east_m, column = np.unique(nodes[:, 0].round(GRID_DECIMALS), return_inverse=True)
    north_m, row = np.unique(nodes[:, 1].round(GRID_DECIMALS), return_inverse=True)
    # Nodes of a grid, row by row from the south-west.
    order = np.lexsort((column, row))
    number = row[order] * len(east_m) + column[order]
    is_full = len(nodes) == len(east_m) * len(north_m)
    if not (is_full and np.array_equal(number, np.arange(len(nodes)))):
        expected = "a plane z = 0, or heights on a grid, as imported scenes have them"
        refuse(
            f"{scene.name}: ground", f"{len(nodes)} nodes that are no grid", expected
        )
    height_m = nodes[order, 2].reshape(len(north_m), len(east_m))
    return Terrain(east_m=east_m, north_m=north_m, height_m=height_m)


def ground_height_m(scene: Scene, points_m: ArrayLike) -> FloatArray:
    """Height of a scene's ground at points (..., 2), in metres; zeros on the plane."""
    terrain = terrain_of(scene)
    if terrain is None:
        return np.zeros(np.shape(points_m)[:-1])
    return terrain.at(points_m)


def on_ground(points_m: ArrayLike, terrain: Terrain | None) -> FloatArray:
    """Points (..., 2) with the height of the ground there, (..., 3)."""
    points = np.asarray(points_m, dtype=np.float64)
    if terrain is None:
        height = np.zeros(points.shape[:-1])
    else:
        height = terrain.at(points)
    return np.concatenate([points, height[..., None]], axis=-1)


def headroom_m(vertices_m: FloatArray, terrain: Terrain | None) -> float:
    """Least height of vertices (n, 3) above the ground below them, in metres."""
    return float((vertices_m - on_ground(vertices_m[:, :2], terrain))[:, 2].min())


def standing_footprint(scene: Scene, index: int) -> Any:
    """Ground that a thing covers, a shapely geometry.

    Empty where people pass below the thing.
    """
    used = scene.triangles[scene.triangle_instance == index]
    if (
        len(used)
        and headroom_m(scene.vertices_m[used.ravel()], terrain_of(scene)) >= HEADROOM_M
    ):
        return Polygon()
    return thing_footprint(scene, index)


def houses_of(scene: Scene) -> Any:
    """Ground that buildings and walls cover.

    It is a shapely geometry in the world frame, in metres.
    """
    kinds = [thing.class_name for thing in scene.instances]
    solid = [index for index, kind in enumerate(kinds) if kind in ("building", "wall")]
    return shapely.union_all([standing_footprint(scene, index) for index in solid])


def pitch_on_ground_deg(
    position_m: ArrayLike,
    yaw_deg: ArrayLike,
    terrain: Terrain | None,
    *,
    front_m: float,
    wheelbase_m: float,
) -> FloatArray:
    """By how much vehicles on two axles look up, (n,), in degrees; zeros on the plane.

    Their middles are at points (n, 2), their front axles `front_m` ahead of them.
    """
    position = np.asarray(position_m, dtype=np.float64)
    if terrain is None:
        return np.zeros(position.shape[:-1])
    yaw = np.radians(np.asarray(yaw_deg, dtype=np.float64))
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    front, rear = (position + at_m * ahead for at_m in (front_m, front_m - wheelbase_m))
    rise_m = terrain.at(front) - terrain.at(rear)
    return np.degrees(np.arctan2(rise_m, wheelbase_m))


def set_down(bodies: Sequence[PlacedActor], scene: Scene) -> tuple[PlacedActor, ...]:
    """Bodies set upright on the ground under their middles.

    On the plane they stay the same objects.
    """
    terrain = terrain_of(scene)
    if terrain is None:
        return tuple(bodies)
    feet_m = [on_ground(body.pose.position_m[:2], terrain) for body in bodies]
    poses = [
        replace(one.pose, position_m=m) for one, m in zip(bodies, feet_m, strict=True)
    ]
    return tuple(
        replace(body, pose=pose) for body, pose in zip(bodies, poses, strict=True)
    )
