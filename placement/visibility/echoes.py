"""What comes back to a LiDAR at a mount, wherever it looks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.lidar import LidarModel, beams_per_steradian, load_lidar_detection, return_probability
from geometry.poses import body_rotation

from ..candidates import CandidatePose
from ..detectors import VRU_CLASSES
from .casting import Sight, World

_SLACK = 1.0e-12  # of a cosine and a sine: limits of a field of view count


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Echoes:
    """Points on VRUs that a LiDAR model may see from a mount, and how many beams each sends back.

    Each visible point stands for the part of the surface around it: its solid angle, seen from the
    LiDAR, times the density of beams in that direction is the number of beams that hit it.
    """

    lidar: LidarModel
    first: IntArray  # (n_entries + 1,): points from first[i] to first[i + 1] are on entry i
    directions: FloatArray  # (k, 3): unit vectors from the mount
    # (n_weathers, k): beams that come back where these are as dense as at the LiDAR's horizon
    expected: FloatArray
    needed: FloatArray  # (n_entries,): for a detection

    def detected(self, candidates: Sequence[CandidatePose], is_near: BoolArray) -> BoolArray:
        """Whether each of some of these LiDARs has enough points on each entry in each weather.

        `is_near` (n, n_entries): entries of which some part may be in its field of view. The result
        has the shape (n, n_weathers, n_entries).
        """
        from .echo_kernels import count_echoes

        found = np.zeros((len(candidates), len(self.expected), len(self.needed)), dtype=bool)
        poses = [candidate.pose for candidate in candidates]
        count_echoes(
            np.stack([body_rotation(pose.yaw_deg, pose.pitch_deg) for pose in poses]),
            is_near,
            self.first,
            self.directions,
            self.expected,
            self.needed,
            math.cos(math.radians(0.5 * self.lidar.horizontal_fov_deg)) - _SLACK,
            math.sin(math.radians(0.5 * self.lidar.vertical_fov_deg)) + _SLACK,
            found,
        )
        return found


def find_echoes(
    world: World, sight: Sight, eye_m: FloatArray, vru_class: IntArray, lidar: LidarModel
) -> Echoes:
    """All that does not depend on where a LiDAR looks; `eye_m` and classes as in ``Sensing``."""
    views = world.views
    entry, point = np.nonzero(sight.is_visible)
    view = sight.view_index[entry]
    offsets = views.points_m[view, point] - eye_m
    distance = np.linalg.norm(offsets, axis=-1)
    areas = np.stack([surface.area_m2 for surface in world.surfaces])
    area = areas[views.surface_index[view], point]
    yaw = np.radians(views.yaw_deg[view])
    cos, sin = np.cos(yaw), np.sin(yaw)
    facing_m2 = -(
        (area[:, 0] * cos - area[:, 1] * sin) * offsets[:, 0]
        + (area[:, 0] * sin + area[:, 1] * cos) * offsets[:, 1]
        + area[:, 2] * offsets[:, 2]
    ) / np.maximum(distance, 1.0e-12)
    faces = (facing_m2 > 0.0) & (distance <= lidar.range_m) & (distance >= lidar.near_m)
    entry, offsets, distance, facing_m2, area = (
        values[faces] for values in (entry, offsets, distance, facing_m2, area)
    )
    detection = load_lidar_detection()
    classes = vru_class[entry]
    reflectivity = np.array([detection.reflectivity[name] for name in VRU_CLASSES])
    needed = np.array([detection.min_points[name] for name in VRU_CLASSES], dtype=np.float64)
    beams = facing_m2 / distance**2 * beams_per_steradian(lidar, 0.0)
    cosine = facing_m2 / np.maximum(np.linalg.norm(area, axis=-1), 1.0e-12)
    expected = np.stack(
        [
            beams
            * return_probability(
                lidar,
                distance,
                reflectivity=reflectivity[classes],
                incidence_cos=cosine,
                extinction_per_m=weather.lidar_extinction_per_m(lidar.wavelength_nm),
            )
            for weather in views.weathers
        ]
    )
    counts = np.bincount(entry, minlength=len(sight.view_index))
    return Echoes(
        lidar=lidar,
        first=np.concatenate([[0], np.cumsum(counts)]),
        directions=np.ascontiguousarray(offsets / distance[:, None]),
        expected=np.ascontiguousarray(expected),
        needed=needed[vru_class],
    )
