"""Rays of pixels, by the closed form of pinholes and by the rays of lenses."""

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray
from geometry.poses import Pose, camera_rotation
from geometry.sensors import CameraModel, picture_rays


def pixel_rays(
    columns_px: ArrayLike,
    rows_px: ArrayLike,
    pose: Pose,
    camera: CameraModel,
) -> FloatArray:
    """Directions (n, 3) through pixels' centres, world frame; 1 along the optical
    axis.
    """
    columns = np.asarray(columns_px, dtype=np.float64) + 0.5
    rows = np.asarray(rows_px, dtype=np.float64) + 0.5
    if camera.is_pinhole:
        across = (columns - 0.5 * camera.width_px) / camera.focal_length_px
        down = (rows - 0.5 * camera.height_px) / camera.focal_length_px
    else:
        across, down = picture_rays(columns, rows, camera).T
    in_camera = np.stack([across, down, np.ones_like(columns)], axis=1)
    return in_camera @ camera_rotation(pose.yaw_deg, pose.pitch_deg).T
