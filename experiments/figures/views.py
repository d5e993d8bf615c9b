"""Ground on which a sensor can detect a road user.

Up to its detector's reach, and up to walls.
"""

import threading
from collections import OrderedDict
from functools import cached_property
from typing import Any

import numpy as np

from geometry.actors import LOOK_AT_M
from geometry.arrays import FloatArray
from geometry.catalogue import Sensor
from geometry.lidar import LidarModel
from geometry.raycast import build_caster, is_in_sight
from geometry.sensors import CameraModel
from geometry.terrain import on_ground, terrain_of
from geometry.weather import load_weathers
from placement.candidates import CandidatePose, above_ground
from placement.detectors import VRU_CLASSES, Evidence, vru_class
from placement.setting import Setting

from .outlines import ground_footprint, ground_rings, is_wide

MAX_RANGE_M = 150.0
"""Views are drawn up to here: no run starts farther from a junction's poles."""

_N_BEARINGS = 360
_FINE_M = 1.0
_FINE_UP_TO_M = 50.0
# Between the places that are asked of.
_COARSE_M = 2.0
_HAIR_M = 0.05
# Of the reach.
_STEP_M = 0.5
_MAX_MOUNTS = 256


class GroundViews:
    """Views in one setting.

    Rays are cast once per mount position. For several threads.
    """

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        self._open: OrderedDict[tuple[float, ...], Any] = OrderedDict()
        self._lock = threading.Lock()

    def reach_m(self, sensor: Sensor) -> float:
        """Distance up to which a sensor detects the tallest road user.

        If nothing occludes them.

        Of a camera, depth along its axis: where the box is as high as the planning
        detector asks for at the contrast of the clearest weather that is driven. At
        most `MAX_RANGE_M`.
        """
        if not isinstance(sensor, CameraModel):
            return min(sensor.range_m, MAX_RANGE_M)
        setting = self._setting
        tallest = max(
            (run.encounter.vru for run in setting.runs), key=lambda vru: vru.height_m
        )
        depth_m = np.arange(_STEP_M, MAX_RANGE_M + _STEP_M, _STEP_M)
        height_px = sensor.focal_length_px * tallest.height_m / depth_m
        known = load_weathers()
        is_high = np.zeros(len(depth_m), dtype=bool)
        for name in set(setting.axis.weathers):
            weather = known[name]
            evidence = Evidence(
                visible_px=np.empty((len(depth_m), 0)),
                amodal_px=np.empty((len(depth_m), 0)),
                contrast=weather.contrast * weather.transmission(depth_m),
                visible_share=np.ones(1),
                inside_share=np.ones(1),
                aspect_deg=np.full(1, 90.0),
                vru_class=np.array([VRU_CLASSES.index(vru_class(tallest))]),
                draw_index=np.arange(len(depth_m)),
            )
            is_high |= height_px >= setting.table_detector.least_height_px(evidence)
        return float(depth_m[is_high].max(initial=0.0))

    def shape(self, unit: CandidatePose) -> Any:
        """Ground in a unit's view as a shapely shape, maybe in parts or empty.

        World frame, metres.

        What its image shows of the ground within its reach, without what the scene
        occludes one metre above it. Shadows of poles, narrower than two degrees, are
        left out.
        """
        import shapely

        reach_m = self.reach_m(unit.sensor)
        level = above_ground(unit, self._setting.scene)
        if is_wide(unit):
            far, near = ground_rings(level, max_range_m=reach_m)
            image = shapely.difference(_polygon(far), _polygon(near))
        elif isinstance(unit.sensor, LidarModel):
            image = _polygon(ground_footprint(level, max_range_m=reach_m))
        else:
            corners_m = ground_footprint(
                level, max_range_m=MAX_RANGE_M, max_depth_m=reach_m
            )
            image = _polygon(corners_m)
        return shapely.intersection(shapely.make_valid(image), self._open_ground(unit))

    def has_rays(self, unit: CandidatePose) -> bool:
        """True if rays have been cast from the place of a unit."""
        return _mount_key(unit) in self._open

    @cached_property
    def _caster(self) -> Any:
        scene = self._setting.scene
        return build_caster(scene.vertices_m - self._origin_m, scene.triangles)

    @cached_property
    def _origin_m(self) -> FloatArray:
        return np.append(self._setting.scene.outline_m.mean(axis=0), 0.0)

    def _open_ground(self, unit: CandidatePose) -> Any:
        """Ground that nothing hides from where a unit is, in all directions."""
        key = _mount_key(unit)
        with self._lock:
            if key not in self._open:
                self._open[key] = self._cast(unit)
                while len(self._open) > _MAX_MOUNTS:
                    self._open.popitem(last=False)
            self._open.move_to_end(key)
            return self._open[key]

    def _cast(self, unit: CandidatePose) -> Any:
        import shapely

        eye_m = unit.pose.position_m
        fine_m = np.arange(0.0, _FINE_UP_TO_M, _FINE_M)
        coarse_m = np.arange(_FINE_UP_TO_M, MAX_RANGE_M + _COARSE_M, _COARSE_M)
        edges_m = np.concatenate([fine_m, coarse_m])
        bearings = np.radians(np.arange(_N_BEARINGS) * (360.0 / _N_BEARINGS))
        between = (bearings + 0.5 * bearings[1])[:, None]
        middles = _polar(0.5 * (edges_m[1:] + edges_m[:-1])[None, :], between)
        ground_m = on_ground(
            eye_m[:2] + middles.reshape(-1, 2), terrain_of(self._setting.scene)
        )
        eye = eye_m - self._origin_m
        places = ground_m + [0.0, 0.0, LOOK_AT_M] - self._origin_m
        is_open = is_in_sight(self._caster, eye, places, near_m=unit.sensor.near_m)
        is_open = is_open.reshape(_N_BEARINGS, -1)
        # Rays do not begin nearer.
        is_open[:, 0] = True
        is_open |= np.roll(is_open, 1, axis=0) & np.roll(is_open, -1, axis=0)
        change = np.diff(np.pad(is_open.astype(np.int8), ((0, 0), (1, 1))), axis=1)
        row, first = np.nonzero(change == 1)
        last = np.nonzero(change == -1)[1]
        low_m = edges_m[first]
        high_m = edges_m[last]
        left = bearings[row]
        right = bearings[row] + bearings[1]
        ends = ((low_m, left), (high_m, left), (high_m, right), (low_m, right))
        corners = np.stack(
            [_polar(radius_m, bearing) for radius_m, bearing in ends], axis=1
        )
        sectors = shapely.polygons(eye_m[:2] + corners)
        # The innermost sectors are one star; to join it with the few others is quick.
        is_inner = first == 0
        star = shapely.Polygon(eye_m[:2] + corners[is_inner, 1:3].reshape(-1, 2))
        joined = shapely.union_all([star, *sectors[~is_inner]])
        # Or rounding would leave gaps between sectors.
        for width_m in (
            _HAIR_M,
            -_HAIR_M,
        ):
            joined = shapely.buffer(
                joined, width_m, join_style="mitre", mitre_limit=1.5
            )
        return shapely.simplify(joined, _HAIR_M)


def _mount_key(unit: CandidatePose) -> tuple[float, ...]:
    """Key of a view: equal for units that look from the same place.

    They may have any setting of the same lens.
    """
    return (*unit.pose.position_m.tolist(), unit.sensor.near_m)


def _polar(radius_m: FloatArray, bearing_rad: FloatArray) -> FloatArray:
    ways = np.stack(
        np.broadcast_arrays(np.cos(bearing_rad), np.sin(bearing_rad)), axis=-1
    )
    corners: FloatArray = radius_m[..., None] * ways
    return corners


def _polygon(corners_m: FloatArray) -> Any:
    import shapely

    if len(corners_m) >= 3:
        return shapely.Polygon(corners_m)
    return shapely.Polygon()
