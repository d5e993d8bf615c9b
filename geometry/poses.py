"""Poses in the world frame and the rotations that belong to them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .arrays import FloatArray, float_array

# Columns: the camera frame's axes (x right, y down, z ahead) seen from the body frame
# (x ahead, y left, z up).
R_BODY_CAMERA: FloatArray = np.array(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
)
R_BODY_CAMERA.setflags(write=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pose:
    """A position and a direction without roll, world frame.

    Attributes
    ----------
    position_m : (3,) float
        East, north, up. [m]
    yaw_deg : float
        Counter-clockwise from east. [deg]
    pitch_deg : float
        Positive up. [deg]
    """

    position_m: FloatArray
    yaw_deg: float
    pitch_deg: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "position_m", float_array(self.position_m, (3,), "position_m")
        )
        for name in ("yaw_deg", "pitch_deg"):
            object.__setattr__(
                self, name, float(float_array(getattr(self, name), (), name))
            )


def body_rotation(yaw_deg: ArrayLike, pitch_deg: ArrayLike = 0.0) -> FloatArray:
    """Rotation (..., 3, 3) from body coordinates to the world frame.

    Body coordinates are x ahead, y left and z up.

    Yaw counts counter-clockwise from east, pitch positive up.

    >>> body_rotation(90.0)[:, 0].round(12) + 0.0  # looking north
    array([0., 1., 0.])
    """
    angles = (
        np.radians(np.asarray(one, dtype=np.float64)) for one in (yaw_deg, pitch_deg)
    )
    yaw, pitch = np.broadcast_arrays(*angles)
    cos_yaw = np.cos(yaw)
    sin_yaw = np.sin(yaw)
    cos_pitch = np.cos(pitch)
    sin_pitch = np.sin(pitch)
    zero = np.zeros_like(yaw)
    # Yaw about the upward axis, after pitch about the axis to the left.
    rows = [
        [cos_pitch * cos_yaw, -sin_yaw, -sin_pitch * cos_yaw],
        [cos_pitch * sin_yaw, cos_yaw, -sin_pitch * sin_yaw],
        [sin_pitch, zero, cos_pitch],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def camera_rotation(yaw_deg: ArrayLike, pitch_deg: ArrayLike = 0.0) -> FloatArray:
    """Rotation (..., 3, 3) from camera coordinates to the world frame.

    Camera coordinates are x right, y down and z ahead.
    """
    return body_rotation(yaw_deg, pitch_deg) @ R_BODY_CAMERA


def to_world(points_body_m: ArrayLike, pose: Pose) -> FloatArray:
    """Points (n, 3) of a body in the world frame."""
    rotation = body_rotation(pose.yaw_deg, pose.pitch_deg)
    points = np.asarray(points_body_m, dtype=np.float64)
    return np.asarray(points @ rotation.T + pose.position_m)


def wrap_deg(angle_deg: ArrayLike) -> FloatArray:
    """Angles in (-180, 180].

    >>> wrap_deg([190.0, -180.0, 0.0])
    array([-170.,  180.,    0.])
    """
    wrapped: FloatArray = (
        180.0 - (180.0 - np.asarray(angle_deg, dtype=np.float64)) % 360.0
    )
    # The remainder may round to 360.
    return wrapped + 360.0 * (wrapped <= -180.0)
