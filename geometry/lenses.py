"""Calibrated cameras whose lenses distort: Brown-Conrady's model, Tsai's one term, fisheyes.

Cameras that are placed are ideal pinholes (:mod:`geometry.sensors`); these are read from files, to
compare what real cameras recorded.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from .arrays import FloatArray, set_arrays
from .errors import InputError

_NEWTON_STEPS = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class BrownConrady:
    """Radial and tangential distortion; all zeros: none. Order and signs as in OpenCV.

    D. Brown, "Decentering distortion of lenses", 1966.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def distort(self, points: FloatArray) -> FloatArray:
        """Points (n, 2) at depth 1 as the lens shows them; NaN where it would fold them back."""
        x, y = points.T
        square = x**2 + y**2
        radial = 1.0 + square * (self.k1 + square * (self.k2 + square * self.k3))
        across = 2.0 * x * y
        distorted = np.stack(
            [
                x * radial + self.p1 * across + self.p2 * (square + 2.0 * x**2),
                y * radial + self.p2 * across + self.p1 * (square + 2.0 * y**2),
            ],
            axis=1,
        )
        # Where r (1 + k1 r^2 + k2 r^4 + k3 r^6) stops rising, by the square of r.
        turn = _first_turn([7.0 * self.k3, 5.0 * self.k2, 3.0 * self.k1, 1.0])
        distorted[square > turn] = np.nan
        return distorted


@dataclass(frozen=True, slots=True, kw_only=True)
class TsaiRadial:
    """Radial distortion by one term: undistorted = distorted x (1 + kappa r_distorted^2).

    R. Tsai, "A versatile camera calibration technique for high-accuracy 3D machine vision
    metrology", 1987. His kappa1 is per mm^2 of the sensor; here it is times the focal length
    squared, for points at depth 1.
    """

    kappa: float

    def distort(self, points: FloatArray) -> FloatArray:
        """Points (n, 2) at depth 1 as the lens shows them; not a number where it shows none."""
        radius = np.hypot(*points.T)
        # With kappa < 0 the cubic r + kappa r^3 rises up to this radius only.
        turn = np.inf if self.kappa >= 0.0 else (-1.0 / (3.0 * self.kappa)) ** 0.5
        shown = np.minimum(radius, turn)
        for _ in range(_NEWTON_STEPS):
            slope = np.maximum(1.0 + 3.0 * self.kappa * shown**2, 1.0e-6)
            step = (shown * (1.0 + self.kappa * shown**2) - radius) / slope
            shown = np.clip(shown - step, 0.0, turn)
            if not (abs(step) > 1.0e-14 * (1.0 + shown)).any():
                break
        share = np.divide(shown, radius, out=np.ones_like(radius), where=radius > 0.0)
        off = abs(shown * (1.0 + self.kappa * shown**2) - radius) > 1.0e-9 * (1.0 + radius)
        return np.asarray(np.where(off[:, None], np.nan, points * share[:, None]))

    def undistort(self, points: FloatArray) -> FloatArray:
        """The inverse of :meth:`distort`, (n, 2)."""
        return np.asarray(points * (1.0 + self.kappa * (points**2).sum(axis=1, keepdims=True)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Fisheye:
    """A fisheye: an angle off the axis is shown at angle (1 + k1 angle^2 + .. + k4 angle^8).

    J. Kannala, S. Brandt, "A generic camera model and calibration method for conventional,
    wide-angle, and fish-eye lenses", 2006; as ``cv::fisheye`` and ROS's "equidistant".
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0

    def distort(self, points: FloatArray) -> FloatArray:
        """Points (n, 2) at depth 1 as the lens shows them; not a number where it shows none."""
        radius = np.hypot(*points.T)
        angle = np.arctan(radius)
        terms = (self.k4, 0.0, self.k3, 0.0, self.k2, 0.0, self.k1, 0.0, 1.0, 0.0)
        shown = np.polyval(terms, angle)
        share = np.divide(shown, radius, out=np.ones_like(radius), where=radius > 0.0)
        share[angle > _first_turn(np.polyder(terms))] = np.nan
        return np.asarray(points * share[:, None])


def _first_turn(slope: ArrayLike) -> float:
    """Smallest positive root of a polynomial, highest power first; infinite if there is none."""
    # Their inverses: the last coefficient is 1, where the first may be next to nothing.
    inverse = np.roots(np.asarray(slope)[::-1])
    rising = inverse[(abs(inverse.imag) < 1.0e-12) & (inverse.real > 0.0)].real
    return 1.0 / float(rising.max()) if len(rising) else np.inf


Lens = BrownConrady | TsaiRadial | Fisheye


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibratedCamera:
    """A camera as its calibration file has it; a point is at R (p - position) in its frame."""

    width_px: int
    height_px: int
    fx_px: float  # focal lengths and principal point
    fy_px: float
    cx_px: float
    cy_px: float
    R_camera_world: FloatArray  # (3, 3), from the world to the camera (x right, y down, z ahead)
    position_m: FloatArray  # (3,), of the lens, world frame
    lens: Lens = field(default_factory=BrownConrady)

    def __post_init__(self) -> None:
        set_arrays(self, "camera: ", R_camera_world=(3, 3), position_m=(3,))
        for name in ("width_px", "height_px", "fx_px", "fy_px"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise InputError(f"camera: {name}", getattr(self, name), "pixels, > 0")
        if not np.allclose(self.R_camera_world @ self.R_camera_world.T, np.eye(3), atol=1.0e-3):
            raise InputError("camera: R_camera_world", self.R_camera_world.tolist(), "a rotation")


def project_distorted(points_m: ArrayLike, camera: CalibratedCamera) -> FloatArray:
    """Project points (n, 3) of the world frame into the image of a calibrated camera.

    Returns (n, 3): column and row in the calibration's pixels, and depth along the optical axis in
    metres; column and row are NaN where the depth is not positive, or the lens shows no such point.
    As ``cv::projectPoints`` and ``cv::fisheye`` of OpenCV.
    """
    offsets = np.asarray(points_m, dtype=np.float64) - camera.position_m
    in_camera = offsets @ camera.R_camera_world.T
    depth = in_camera[:, 2]
    at_depth_1 = in_camera[:, :2] / np.where(depth > 0.0, depth, np.nan)[:, None]
    shown = camera.lens.distort(at_depth_1)
    column = camera.cx_px + camera.fx_px * shown[:, 0]
    row = camera.cy_px + camera.fy_px * shown[:, 1]
    return np.stack([column, row, depth], axis=1)


def ground_points(pixels_px: ArrayLike, camera: CalibratedCamera) -> FloatArray:
    """Points (n, 3) of the plane z = 0 at pixels of a Tsai lens; NaN above the horizon."""
    if not isinstance(camera.lens, TsaiRadial):
        raise ValueError(f"lens: got {camera.lens}; expected Tsai's, whose inverse is known")
    middle, focal = np.array([camera.cx_px, camera.cy_px]), np.array([camera.fx_px, camera.fy_px])
    at_depth_1 = camera.lens.undistort((np.asarray(pixels_px, dtype=np.float64) - middle) / focal)
    rays = np.column_stack([at_depth_1, np.ones(len(at_depth_1))]) @ camera.R_camera_world
    is_below = rays[:, 2] * camera.position_m[2] < 0.0
    far = -camera.position_m[2] / np.where(is_below, rays[:, 2], np.nan)
    return np.asarray(camera.position_m + far[:, None] * rays)
