"""Ground around a junction, and how finely cameras have it in their pictures."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from geometry.actors import LOOK_AT_M
from geometry.arrays import BoolArray, FloatArray, freeze
from geometry.phrases import Phrase
from geometry.raycast import build_caster, is_in_sight
from geometry.scene import Scene, road_area
from geometry.sensors import CameraModel, project_points
from geometry.terrain import on_ground, terrain_of
from geometry.text_formats import load_data

from .candidates import CandidatePose, depth_in_picture

REACH_M = 45.0
_SPACING_M = 1.0

BANDS: tuple[tuple[str, float], ...] = tuple(
    load_data(__package__, "pixel_densities.toml")["bands"].items()
)
"""Bands of pixel density by their least, in pixels per metre, the finest first."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundCoverage:
    """Pixel density over the roads around a junction.

    Attributes
    ----------
    east_m, north_m : (n_east,) float
        (n_north,): middles of the cells. World frame. [m]
    density : (n_north, n_east) float
        Highest of all cameras; 0: none sees the cell. [px/m]
    is_road : (n_north, n_east) bool
        Cells on a lane or in the junction.
    """

    east_m: FloatArray
    north_m: FloatArray
    density: FloatArray
    is_road: BoolArray

    def shares(self) -> dict[str, float]:
        """Share of the road's cells in each band, "unseen" last; together 1."""
        road = self.density[self.is_road]
        found = {}
        above = 0.0
        for name, least in (*BANDS, (Phrase("coarser"), np.nextafter(0.0, 1.0))):
            if len(road):
                here = float((road >= least).mean())
            else:
                here = 0.0
            found[name] = here - above
            above = here
        return found | {Phrase("unseen"): 1.0 - above}


class GroundSurvey:
    """Ground around a junction, prepared for several cameras."""

    def __init__(self, scene: Scene) -> None:
        outline = scene.outline_m
        middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
        # Middles of the cells, symmetric about the middle of the junction.
        steps = np.arange(-REACH_M + 0.5 * _SPACING_M, REACH_M, _SPACING_M)
        self.east_m = middle[0] + steps
        self.north_m = middle[1] + steps
        grid = np.stack(np.meshgrid(self.east_m, self.north_m), axis=-1)
        self._points_m = on_ground(grid.reshape(-1, 2), terrain_of(scene)) + [
            0.0,
            0.0,
            LOOK_AT_M,
        ]
        # Rays are cast relative to the junction: they have single precision.
        self._origin_m = np.append(middle, 0.0)
        self._caster = build_caster(scene.vertices_m - self._origin_m, scene.triangles)
        on_road = shapely.contains_xy(road_area(scene), grid[..., 0], grid[..., 1])
        # (n_north, n_east)
        self.is_road: BoolArray = np.asarray(on_road, dtype=bool)

    def density(self, unit: CandidatePose) -> FloatArray:
        """Pixels per metre of a camera on each cell, (n_north, n_east).

        A cell that it does not see has 0.
        """
        found = np.zeros(len(self._points_m))
        camera = unit.sensor
        if isinstance(camera, CameraModel):
            # Only cells in the picture need rays.
            depth_m = depth_in_picture(self._points_m, unit)
            shown = np.flatnonzero(np.isfinite(depth_m))
            mount_m = unit.pose.position_m - self._origin_m
            points_m = self._points_m[shown] - self._origin_m
            is_open = is_in_sight(self._caster, mount_m, points_m, near_m=camera.near_m)
            if camera.is_pinhole:
                finest = camera.focal_length_px / depth_m[shown]
            else:
                finest = _lens_density(self._points_m[shown], unit)
            found[shown] = is_open * finest
        return found.reshape(self.is_road.shape)


def find_ground_coverage(
    scene: Scene, units: Sequence[CandidatePose]
) -> GroundCoverage:
    """Pixel density of cameras on the ground around a junction.

    Nothing drives or parks there. Cells of a square metre, up to 45 m around the
    middle, one metre above the road. Pixels per metre across the line of sight are
    focal length over depth; through a lens they are what it shows of ten
    centimetres. LiDARs take no pictures.
    """
    survey = GroundSurvey(scene)
    density = np.zeros(survey.is_road.shape)
    for unit in units:
        density = np.maximum(density, survey.density(unit))
    return GroundCoverage(
        east_m=freeze(survey.east_m),
        north_m=freeze(survey.north_m),
        density=freeze(density),
        is_road=freeze(survey.is_road),
    )


# Whose pixels are counted.
_ACROSS_M = 0.1


def _lens_density(points_m: FloatArray, unit: CandidatePose) -> FloatArray:
    """Pixels per metre across the line of sight at points (n, 3).

    Points are in the picture; at its edge the density is 0.
    """
    assert isinstance(unit.sensor, CameraModel)
    east, north = (points_m - unit.pose.position_m)[:, :2].T
    # A short line across the line of sight, projected at both ends.
    across = np.stack([-north, east, np.zeros_like(east)], axis=1)
    across *= 0.5 * _ACROSS_M / np.maximum(np.hypot(east, north), 1.0e-6)[:, None]
    ends = [
        project_points(points_m + one, unit.pose, unit.sensor)[:, :2]
        for one in (across, -across)
    ]
    density = np.linalg.norm(ends[1] - ends[0], axis=1) / _ACROSS_M
    return np.where(np.isfinite(density), density, 0.0)
