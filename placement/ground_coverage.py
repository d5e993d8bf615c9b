"""Ground that cameras see: pixels per metre, and shares of private areas."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray, FloatArray, freeze
from geometry.raycast import RayCaster, build_caster
from geometry.scene import Scene, road_area
from geometry.sensors import CameraModel, project_points
from geometry.terrain import on_ground, terrain_of

from .candidates import CandidatePose

LOOK_AT_M = 1.0  # height above the road: the middle of a road user
REACH_M = 45.0
_SPACING_M = 1.0

BANDS = (
    ("inspect", 1000.0),
    ("identify", 250.0),
    ("recognise", 125.0),
    ("observe", 62.5),
    ("detect", 25.0),
    ("monitor", 12.5),
)
"""Bands of pixel density by their least, in pixels per metre, the finest first.

EN IEC 62676-4:2015, annex on pixel densities (figures from memory, no copy was at hand).
"""

_SHORT_OF_M = 0.05  # rays end a little before the point


def is_in_sight(
    caster: RayCaster, mount_m: ArrayLike, points_m: FloatArray, *, near_m: float
) -> BoolArray:
    """Points (n, 3) that nothing hides from a mount; False for those nearer than `near_m`, too.

    The caster has the same frame as the points. Things nearer than `near_m` hide nothing, such as
    the pole that carries the sensor, see :class:`geometry.sensors.CameraModel`.
    """
    mount = np.asarray(mount_m, dtype=np.float64)
    ways = points_m - mount
    lengths = np.linalg.norm(ways, axis=1)
    is_far = lengths > near_m + _SHORT_OF_M
    directions = ways / np.maximum(lengths, 1.0e-9)[:, None]
    starts = mount + near_m * directions
    vectors = directions * np.maximum(lengths - near_m - _SHORT_OF_M, 0.0)[:, None]
    is_free: BoolArray = ~caster.is_blocked(starts.astype(np.float32), vectors.astype(np.float32))
    is_seen: BoolArray = is_free & is_far
    return is_seen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundCoverage:
    """Pixel density over the roads around a junction."""

    # east_m, north_m: (n_east,), (n_north,): middles of the cells. World frame. [m]
    east_m: FloatArray
    north_m: FloatArray
    # (n_north, n_east): the highest of all cameras; 0: none sees the cell. [px/m]
    density: FloatArray
    is_road: BoolArray  # (n_north, n_east): cells on a lane or in the junction

    def shares(self) -> dict[str, float]:
        """Share of the road's cells in each band, "unseen" last; together 1."""
        road = self.density[self.is_road]
        found, above = {}, 0.0
        for name, least in BANDS:
            here = float((road >= least).mean()) if len(road) else 0.0
            found[name] = here - above
            above = here
        seen = float((road > 0.0).mean()) if len(road) else 0.0
        found["coarser"] = seen - above
        found["unseen"] = 1.0 - seen
        return found


def find_ground_coverage(scene: Scene, units: Sequence[CandidatePose]) -> GroundCoverage:
    """Pixel density of cameras on the ground around a junction, where nothing drives or parks.

    Cells of a square metre, up to 45 m around the junction's middle, one metre above the road.
    Pixels per metre across the line of sight are focal length over depth. LiDARs take no pictures.
    """
    import shapely

    outline = scene.outline_m
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    steps = np.arange(-REACH_M + 0.5 * _SPACING_M, REACH_M, _SPACING_M)
    east, north = middle[0] + steps, middle[1] + steps
    grid = np.stack(np.meshgrid(east, north), axis=-1)
    points = on_ground(grid.reshape(-1, 2), terrain_of(scene)) + [0.0, 0.0, LOOK_AT_M]
    origin = np.append(middle, 0.0)
    caster = build_caster(scene.vertices_m - origin, scene.triangles)
    density = np.zeros(len(points))
    for unit in units:
        camera = unit.sensor
        if not isinstance(camera, CameraModel):
            continue
        mount = unit.pose.position_m - origin
        is_open = is_in_sight(caster, mount, points - origin, near_m=camera.near_m)
        column, row, depth = project_points(points, unit.pose, camera).T
        with np.errstate(invalid="ignore"):
            is_open &= (column >= 0.0) & (column < camera.width_px) & (depth > camera.near_m)
            is_open &= (row >= 0.0) & (row < camera.height_px)
        seen = np.where(is_open, camera.focal_length_px / np.maximum(depth, camera.near_m), 0.0)
        density = np.maximum(density, seen)
    is_road = shapely.contains_xy(road_area(scene), grid[..., 0], grid[..., 1])
    return GroundCoverage(
        east_m=freeze(east),
        north_m=freeze(north),
        density=freeze(density.reshape(len(north), len(east))),
        is_road=freeze(np.asarray(is_road, dtype=bool)),
    )
