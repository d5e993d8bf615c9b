"""Detections as numpy finds them, array by array: the oracle of the loops in
``projecting``.

Nothing is left out: every point of every body is projected into every camera, whether
or not it is in the field of view. Sums are made in the same order, so that boxes are
the same to the last bit but for points that only rounding puts outside the convex hull.
"""

from dataclasses import dataclass, replace

import numpy as np

from geometry.image_boxes import clip_boxes
from geometry.lidar import (
    LidarModel,
    beams_per_steradian,
    load_lidar_detection,
    return_probability,
)
from geometry.poses import body_rotation, camera_rotation
from placement.detectors import VRU_CLASSES, Evidence
from placement.visibility import sensing as compiled

MIN_DEPTH_M = np.float32(0.01)


@dataclass
class NumpySensing:
    """As :class:`placement.visibility.sensing.Sensing`, which it is made of."""

    sensing: compiled.Sensing

    def evidence(self, candidate) -> Evidence:
        """Evidence of a camera for every entry, at full contrast."""
        made = self.sensing
        camera = candidate.sensor
        pose = candidate.pose
        sight = made.sight
        eye = made.eye_m.astype(np.float32)
        x, y, z = np.moveaxis(made.world.views.points_m[sight.view_index] - eye, -1, 0)
        r = camera_rotation(pose.yaw_deg, pose.pitch_deg).astype(np.float32)
        right, down, depth = (x * r[0, i] + y * r[1, i] + z * r[2, i] for i in range(3))
        per_depth = np.float32(camera.focal_length_px) / np.maximum(depth, MIN_DEPTH_M)
        width = np.float32(camera.width_px)
        height = np.float32(camera.height_px)
        half_width = np.float32(0.5) * width
        half_height = np.float32(0.5) * height
        columns = right * per_depth + half_width
        rows = down * per_depth + half_height
        nothing = np.zeros(columns.shape, dtype=bool)
        whole = boxes(columns, rows, nothing)
        # Of a body that the image cuts off, only the points inside the image count.
        limits = np.array([width, height] * 2)
        is_cut = (whole < 0.0).any(axis=1) | (whole > limits).any(axis=1)
        is_cut |= (depth <= MIN_DEPTH_M).any(axis=1)
        is_outside = is_cut[:, None] & (
            (depth <= MIN_DEPTH_M)
            | (np.abs(columns - half_width) > half_width)
            | (np.abs(rows - half_height) > half_height)
        )
        # The visible part of a body that nothing else hides has the body's own box.
        hidden = ~sight.is_visible & ~sight.is_whole[:, None]
        inside = clip_boxes(whole, width_px=camera.width_px, height_px=camera.height_px)
        return Evidence(
            visible_px=boxes(columns, rows, hidden | is_outside),
            amodal_px=boxes(columns, rows, is_outside),
            contrast=np.ones(len(whole)),
            visible_share=sight.visible_share,
            inside_share=areas(inside) / np.maximum(areas(whole), 1.0e-9),
            aspect_deg=made.aspect_deg,
            vru_class=made.vru_class,
            draw_index=np.arange(len(whole)),
        )

    def detected(self, candidate):
        """Whether each entry is detected in each weather, (n_weathers, n)."""
        made = self.sensing
        if isinstance(candidate.sensor, LidarModel):
            rotation = body_rotation(candidate.pose.yaw_deg, candidate.pose.pitch_deg)
            return count_points(made, rotation, candidate.sensor)
        evidence = self.evidence(candidate)
        found = []
        for contrast in made.contrast:
            seen = replace(evidence, contrast=contrast)
            found.append(made.detector.is_expected(seen))

        return np.array(found)


def boxes(columns, rows, hidden):
    """Boxes around the points of each entry that are not hidden, (n, 4); zeros where
    all are.
    """
    found = np.empty((len(columns), 4))
    for axis, values in enumerate((columns, rows)):
        found[:, axis] = np.where(hidden, np.inf, values).min(axis=1)
        found[:, axis + 2] = np.where(hidden, -np.inf, values).max(axis=1)

    found[found[:, 0] > found[:, 2]] = 0.0
    return found


def areas(boxes_px):
    """Areas of boxes, (n,). [px^2]"""
    return (boxes_px[:, 2:] - boxes_px[:, :2]).prod(axis=1)


def count_points(sensing, rotation, lidar):
    """Whether a LiDAR may expect enough points on each entry, in each weather,
    (n_weathers, n).

    Each visible point stands for the part of the surface around it: its solid angle,
    seen from the LiDAR, times the density of beams in that direction is the number of
    beams that hit it.
    """
    views = sensing.world.views
    sight = sensing.sight
    entries = np.arange(len(sight.view_index))
    view = sight.view_index
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
    area = areas[views.surface_index[view]] @ np.swapaxes(
        body_rotation(views.yaw_deg[view]), 1, 2
    )
    facing_m2 = np.maximum(0.0, -(area * offsets).sum(axis=-1) / distance)
    beams = is_hit * facing_m2 / distance**2 * beams_per_steradian(lidar, elevation_deg)
    cosine = facing_m2 / np.maximum(np.linalg.norm(area, axis=-1), 1.0e-12)

    detection = load_lidar_detection()
    reflectivity = np.array([detection.reflectivity[name] for name in VRU_CLASSES])
    needed = np.array([detection.min_points[name] for name in VRU_CLASSES])
    classes = sensing.vru_class[entries]

    detected = []
    for weather in views.weathers:
        returned = return_probability(
            lidar,
            distance,
            reflectivity=reflectivity[classes][:, None],
            incidence_cos=cosine,
            extinction_per_m=weather.lidar_extinction_per_m(lidar.wavelength_nm),
        )
        n_points = (beams * returned).sum(axis=1)
        detected.append(n_points >= needed[classes])
    return np.stack(detected)
