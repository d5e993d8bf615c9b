"""Detections of the sensors of one mount position: projects the points that the rays reach."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.catalogue import Sensor
from geometry.lidar import LidarModel, beams_per_steradian, load_lidar_detection, return_probability
from geometry.poses import body_rotation, camera_rotation
from geometry.raycast import FloatRays
from geometry.sensors import CameraModel

from ..candidates import CandidatePose
from ..detectors import VRU_CLASSES, Evidence, PlanningDetector, aspects_deg, vru_class
from .casting import Sight, World

_MIN_DEPTH_M = 0.01  # points beside or behind the lens are projected far outside the image


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensing:
    """One mount position and all that is seen from it, whatever hangs there."""

    world: World  # what is looked at
    sight: Sight  # which points the rays reach
    detector: PlanningDetector  # of cameras
    offsets_m: FloatRays  # (n, n_points, 3): points of each entry, from the mount. [m]
    # middle_m, distance_m: (n, 3), (n,): mean of the points, and how far it is. [m]
    middle_m: FloatArray
    distance_m: FloatArray
    half_angle_rad: FloatArray  # (n,): within which the body lies around its middle. [rad]
    contrast: FloatArray  # (n_weathers, n): of the VRU in each weather
    vru_class: IntArray  # (n,): into ``VRU_CLASSES``
    aspect_deg: FloatArray  # (n,): between line of sight and heading. [deg]

    def detected(self, candidate: CandidatePose) -> BoolArray:
        """Whether each entry is detected in each weather, (n_weathers, n)."""
        pose, sensor = candidate.pose, candidate.sensor
        detected = np.zeros(self.contrast.shape, dtype=bool)
        ahead = body_rotation(pose.yaw_deg, pose.pitch_deg)[:, 0]
        off_axis = np.arccos(
            np.clip(self.middle_m @ ahead / np.maximum(self.distance_m, 1e-6), -1, 1)
        )
        limit = np.radians(0.5 * sensor.diagonal_fov_deg) + self.half_angle_rad
        entries = np.flatnonzero(off_axis <= limit)
        if isinstance(sensor, LidarModel):
            rotation = body_rotation(pose.yaw_deg, pose.pitch_deg)
            detected[:, entries] = _count(self, entries, rotation, sensor)
        else:
            rotation = camera_rotation(pose.yaw_deg, pose.pitch_deg)
            evidence = _project(self, entries, rotation, sensor)
            for in_weather, contrast in zip(detected, self.contrast, strict=True):
                seen = replace(evidence, contrast=contrast[entries])
                in_weather[entries] = self.detector.is_expected(seen)
        return detected

    def frames(self, candidate: CandidatePose) -> BoolArray:
        """Whether each frame of the frame axis shows a detected VRU, (n_frames,)."""
        # One more entry, never detected, for frames in which nothing is seen (index -1).
        detected = np.pad(self.detected(candidate), ((0, 0), (0, 1)))
        in_frames: BoolArray = detected[
            self.world.views.weather_of_frame, self.sight.entry_of_frame
        ]
        return in_frames


def build_sensing(
    world: World, sight: Sight, position_m: FloatArray, detector: PlanningDetector
) -> Sensing:
    """All that does not depend on where a sensor at a mount looks."""
    views = world.views
    eye = (position_m - world.origin_m).astype(np.float32)
    offsets = views.points_m[sight.view_index] - eye
    middle = offsets.mean(axis=1).astype(np.float64)
    distance = np.linalg.norm(middle, axis=1)
    classes = np.array([VRU_CLASSES.index(vru_class(s.actor)) for s in world.surfaces])
    return Sensing(
        world=world,
        sight=sight,
        detector=detector,
        offsets_m=offsets,
        middle_m=middle,
        distance_m=distance,
        half_angle_rad=np.arcsin(np.minimum(1.0, world.radius_m / np.maximum(distance, 1e-6))),
        contrast=np.stack([w.contrast * w.transmission(distance) for w in views.weathers]),
        vru_class=classes[views.surface_index[sight.view_index]],
        aspect_deg=aspects_deg(middle[:, :2], views.yaw_deg[sight.view_index]),
    )


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
    sensing: Sensing, entries: IntArray, rotation: FloatArray, camera: CameraModel
) -> Evidence:
    """Evidence of one camera for some entries, at full contrast."""
    sight = sensing.sight
    offsets_m = sensing.offsets_m[entries]
    in_camera = offsets_m.reshape(-1, 3) @ rotation.astype(np.float32)
    shape = offsets_m.shape[:2]
    depth = in_camera[:, 2]
    per_depth = np.float32(camera.focal_length_px) / np.maximum(depth, _MIN_DEPTH_M)
    columns = (in_camera[:, 0] * per_depth + np.float32(0.5 * camera.width_px)).reshape(shape)
    rows = (in_camera[:, 1] * per_depth + np.float32(0.5 * camera.height_px)).reshape(shape)
    whole = _boxes(columns, rows)
    # Of a body that the image cuts off, only the points inside the image count.
    limits = np.array([camera.width_px, camera.height_px] * 2)
    is_cut = (whole < 0.0).any(axis=1) | (whole > limits).any(axis=1)
    is_cut |= depth.reshape(shape).min(axis=1, initial=np.float32(np.inf)) <= _MIN_DEPTH_M
    is_outside = np.zeros(shape, dtype=bool)
    cut = np.flatnonzero(is_cut)
    is_outside[cut] = (
        (depth.reshape(shape)[cut] <= _MIN_DEPTH_M)
        | (np.abs(columns[cut] - 0.5 * camera.width_px) > 0.5 * camera.width_px)
        | (np.abs(rows[cut] - 0.5 * camera.height_px) > 0.5 * camera.height_px)
    )
    amodal = whole.copy()
    amodal[cut] = _boxes(columns[cut], rows[cut], is_outside[cut])
    # The visible part of a body that nothing else hides has the body's own box.
    visible = amodal.copy()
    part = np.flatnonzero(~sight.is_whole[entries])
    hidden = ~sight.is_visible[entries[part]] | is_outside[part]
    visible[part] = _boxes(columns[part], rows[part], hidden)
    return Evidence(
        visible_px=visible,
        amodal_px=amodal,
        contrast=np.ones(len(entries)),
        visible_share=sight.visible_share[entries],
        inside_share=_areas(np.clip(whole, 0.0, limits)) / np.maximum(_areas(whole), 1.0e-9),
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
    offsets = sensing.offsets_m[entries].astype(np.float64)
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


def _areas(boxes_px: FloatArray) -> FloatArray:
    areas: FloatArray = (boxes_px[:, 2:] - boxes_px[:, :2]).prod(axis=1)
    return areas


def _boxes(
    columns: NDArray[np.floating[Any]],
    rows: NDArray[np.floating[Any]],
    hidden: BoolArray | None = None,
) -> FloatArray:
    """Boxes around the points of each entry that are not hidden, (n, 4); zeros where all are."""
    boxes = np.empty((len(columns), 4))
    for axis, values in enumerate((columns, rows)):
        low = values if hidden is None else np.where(hidden, np.float32(np.inf), values)
        high = values if hidden is None else np.where(hidden, np.float32(-np.inf), values)
        boxes[:, axis] = low.min(axis=1, initial=np.float32(np.inf))
        boxes[:, axis + 2] = high.max(axis=1, initial=np.float32(-np.inf))
    boxes[boxes[:, 0] > boxes[:, 2]] = 0.0
    return boxes
