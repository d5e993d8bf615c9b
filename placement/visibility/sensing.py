"""Detections of the sensors of one mount position: projects the points that the rays reach."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.catalogue import Sensor
from geometry.lidar import LidarModel, beams_per_steradian, load_lidar_detection, return_probability
from geometry.poses import body_rotation, camera_rotation
from geometry.sensors import CameraModel

from ..candidates import CandidatePose
from ..detectors import VRU_CLASSES, Evidence, PlanningDetector, aspects_deg, vru_class
from .casting import Sight, World

_MIN_DEPTH_M = 0.01  # points beside or behind the lens are projected far outside the image
_NEARLY = 0.999  # for the rounding of single precision
_PAIRS = 1 << 21  # of sensors and entries that are looked at together


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensing:
    """One mount position and all that is seen from it, whatever hangs there."""

    world: World  # what is looked at
    sight: Sight  # which points the rays reach
    detector: PlanningDetector  # of cameras
    eye_m: FloatArray  # (3,): the mount, relative to the origin of `world`. [m]
    # middle_m, distance_m: (n, 3), (n,): mean of each entry's points, from the mount, and how far
    # it is. [m]
    middle_m: FloatArray
    distance_m: FloatArray
    half_angle_rad: FloatArray  # (n,): within which the body lies around its middle. [rad]
    contrast: FloatArray  # (n_weathers, n): of the VRU in each weather
    vru_class: IntArray  # (n,): into ``VRU_CLASSES``
    aspect_deg: FloatArray  # (n,): between line of sight and heading. [deg]

    def detected(self, candidates: Sequence[CandidatePose]) -> BoolArray:
        """Whether each sensor detects each entry in each weather, (n_sensors, n_weathers, n).

        The sight must have been cast for LiDARs if one is among the sensors.
        """
        detected = np.zeros((len(candidates), *self.contrast.shape), dtype=bool)
        for row, candidate in enumerate(candidates):
            if isinstance(candidate.sensor, LidarModel):
                _, entries = self._pairs([candidate])
                rotation = body_rotation(candidate.pose.yaw_deg, candidate.pose.pitch_deg)
                detected[row][:, entries] = _count(self, entries, rotation, candidate.sensor)
        for rows, evidence in self.evidence(candidates):
            for weather, contrast in enumerate(self.contrast):
                seen = replace(evidence, contrast=contrast[evidence.draw_index])
                is_expected = self.detector.is_expected(seen)
                detected[rows[is_expected], weather, evidence.draw_index[is_expected]] = True
        return detected

    def packed(self, candidates: Sequence[CandidatePose]) -> NDArray[np.uint8]:
        """Frames of the frame axis that show a detected VRU, (n_sensors, ceil(n_frames / 8)).

        As bits, the first frame in the lowest.
        """
        from .projecting import pack_frames

        weather_of_frame = self.world.views.weather_of_frame
        packed = np.zeros((len(candidates), -(-len(weather_of_frame) // 8)), dtype=np.uint8)
        detected = self.detected(candidates)
        pack_frames(detected, weather_of_frame, self.sight.entry_of_frame, packed)
        return packed

    def evidence(self, candidates: Sequence[CandidatePose]) -> Iterator[tuple[IntArray, Evidence]]:
        """Evidence of all cameras that see enough of an entry, at full contrast.

        That is a box as high as the detector asks for. In parts: the index of each row's candidate,
        and the evidence, whose `draw_index` is the entry. LiDARs are left out.
        """
        rows = [i for i, c in enumerate(candidates) if not isinstance(c.sensor, LidarModel)]
        step = max(1, _PAIRS // max(1, len(self.distance_m)))
        for first in range(0, len(rows), step):
            some = np.array(rows[first : first + step])
            part, entries = self._pairs([candidates[row] for row in some])
            row_index, evidence = _project(self, [candidates[row] for row in some], part, entries)
            yield some[row_index], evidence

    def _pairs(self, candidates: Sequence[CandidatePose]) -> tuple[IntArray, IntArray]:
        """Index of the sensor and entry wherever one may be in the other's field of view."""
        from .projecting import pairs_in_cones

        poses = [candidate.pose for candidate in candidates]
        ahead = body_rotation([p.yaw_deg for p in poses], [p.pitch_deg for p in poses])[:, :, 0]
        half_fov = np.radians([0.5 * c.sensor.diagonal_fov_deg for c in candidates])
        row, entry = pairs_in_cones(
            self.middle_m,
            self.distance_m,
            self.half_angle_rad,
            np.ascontiguousarray(ahead),
            half_fov,
        )
        return row, entry


def build_sensing(
    world: World, sight: Sight, position_m: FloatArray, detector: PlanningDetector
) -> Sensing:
    """All that does not depend on where a sensor at a mount looks."""
    views = world.views
    eye = np.asarray(position_m, dtype=np.float64) - world.origin_m
    middle = views.middle_m[sight.view_index] - eye
    distance = np.linalg.norm(middle, axis=1)
    radius = views.radius_m[sight.view_index]
    classes = np.array([VRU_CLASSES.index(vru_class(s.actor)) for s in world.surfaces])
    return Sensing(
        world=world,
        sight=sight,
        detector=detector,
        eye_m=eye,
        middle_m=middle,
        distance_m=distance,
        half_angle_rad=np.arcsin(np.minimum(1.0, radius / np.maximum(distance, 1e-6))),
        contrast=np.stack([w.contrast * w.transmission(distance) for w in views.weathers]),
        vru_class=classes[views.surface_index[sight.view_index]],
        aspect_deg=aspects_deg(middle[:, :2], views.yaw_deg[sight.view_index]),
    )


def has_lidar(candidates: Sequence[CandidatePose]) -> bool:
    """Whether a LiDAR is among the sensors: it counts the points that a camera need not know."""
    return any(isinstance(candidate.sensor, LidarModel) for candidate in candidates)


def reach_m(sensor: Sensor, detector: PlanningDetector, world: World) -> float:
    """Distance from a mount beyond which a sensor detects no VRU, however its lens is set, in m.

    To the middle of the footprint; may be infinite.
    """
    extent_m = 2.0 * world.radius_m  # to the nearest point it is at most this much less
    if isinstance(sensor, LidarModel):
        return extent_m + sensor.range_m
    fovs_deg = sensor.fov_range_deg or (sensor.horizontal_fov_deg,)
    return extent_m + max(
        max_distance_m(replace(sensor, horizontal_fov_deg=fov), detector, vru_height_m=extent_m)
        for fov in fovs_deg  # convex in the focal length: the farthest is at either end
    )


def max_distance_m(
    camera: CameraModel, detector: PlanningDetector, *, vru_height_m: float
) -> float:
    """Distance beyond which no VRU is high enough in the image to be detected, in m.

    A body of extent h whose nearest point is at distance d from the lens spans at most h / d * f /
    cos^2(e) pixels, where e is the largest angle off the optical axis. Infinite if the detector
    takes boxes of any height.
    """
    if detector.min_box_height_px == 0.0:
        return np.inf
    stretch = 1.0 / np.cos(np.radians(0.5 * camera.diagonal_fov_deg)) ** 2
    return float(vru_height_m * camera.focal_length_px * stretch / detector.min_box_height_px)


def _project(
    sensing: Sensing, candidates: Sequence[CandidatePose], row: IntArray, entry: IntArray
) -> tuple[IntArray, Evidence]:
    """Pairs of a camera and an entry in which something is seen: the camera, and the evidence."""
    from .projecting import box_pairs

    least_px = sensing.detector.min_box_height_px
    views, sight = sensing.world.views, sensing.sight
    cameras = [c.sensor for c in candidates if isinstance(c.sensor, CameraModel)]
    poses = [candidate.pose for candidate in candidates]
    rotation = camera_rotation([p.yaw_deg for p in poses], [p.pitch_deg for p in poses])
    boxes = np.empty((len(row), 8), dtype=np.float32)
    inside_share = np.empty(len(row))
    box_pairs(
        views.axes_m,
        views.hull_m,
        sensing.eye_m.astype(np.float32),
        sight.view_index,
        sight.is_visible,
        sight.is_whole,
        rotation.astype(np.float32),
        np.array([camera.focal_length_px for camera in cameras], dtype=np.float32),
        np.array([(camera.width_px, camera.height_px) for camera in cameras], dtype=np.float32),
        np.float32(_MIN_DEPTH_M),
        np.float32(_NEARLY * least_px),
        row,
        entry,
        boxes,
        inside_share,
    )
    height_px = boxes[:, 3].astype(np.float64) - boxes[:, 1]
    seen = np.flatnonzero((height_px >= least_px) & (height_px > 0.0))
    visible, amodal = np.split(boxes[seen].astype(np.float64), 2, axis=1)
    entries = entry[seen]
    return row[seen], Evidence(
        visible_px=visible,
        amodal_px=amodal,
        contrast=np.ones(len(seen)),
        visible_share=sight.visible_share[entries],
        inside_share=inside_share[seen],
        aspect_deg=sensing.aspect_deg[entries],
        vru_class=sensing.vru_class[entries],
        draw_index=entries,
    )


def _count(
    sensing: Sensing, entries: IntArray, rotation: FloatArray, lidar: LidarModel
) -> BoolArray:
    """Whether a LiDAR may expect enough points on each entry, in each weather, (n_weathers, n).

    Each visible point stands for the part of the surface around it: its solid angle, seen from the
    LiDAR, times the density of beams in that direction is the number of beams that hit it.
    """
    views, sight = sensing.world.views, sensing.sight
    view = sight.view_index[entries]
    offsets = views.points_m[view] - sensing.eye_m
    distance = np.linalg.norm(offsets, axis=-1)
    ahead, left, up = np.moveaxis(offsets @ rotation, -1, 0)
    azimuth_deg = np.degrees(np.arctan2(left, ahead))
    elevation_deg = np.degrees(np.arctan2(up, np.hypot(ahead, left)))
    is_hit = (
        sight.is_visible[entries]
        & (np.abs(azimuth_deg) <= 0.5 * lidar.horizontal_fov_deg)
        & (np.abs(elevation_deg) <= 0.5 * lidar.vertical_fov_deg)
    )
    areas = np.stack([surface.area_m2 for surface in sensing.world.surfaces])
    area = areas[views.surface_index[view]] @ np.swapaxes(body_rotation(views.yaw_deg[view]), 1, 2)
    facing_m2 = np.maximum(0.0, -(area * offsets).sum(axis=-1) / distance)
    beams = is_hit * facing_m2 / distance**2 * beams_per_steradian(lidar, elevation_deg)
    cosine = facing_m2 / np.maximum(np.linalg.norm(area, axis=-1), 1.0e-12)
    detection = load_lidar_detection()
    reflectivity = np.array([detection.reflectivity[name] for name in VRU_CLASSES])
    needed = np.array([detection.min_points[name] for name in VRU_CLASSES])
    classes = sensing.vru_class[entries]
    return np.stack(
        [
            (
                beams
                * return_probability(
                    lidar,
                    distance,
                    reflectivity=reflectivity[classes][:, None],
                    incidence_cos=cosine,
                    extinction_per_m=weather.lidar_extinction_per_m(lidar.wavelength_nm),
                )
            ).sum(axis=1)
            >= needed[classes]
            for weather in views.weathers
        ]
    )
