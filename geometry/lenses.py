"""Lenses that distort: Brown-Conrady's model, Tsai's one term, fisheyes; and calibrated cameras.

Points are at depth 1 along the optical axis: x right and y down, over the depth. A lens shows what
lies up to some angle off its axis, its :attr:`reach`; farther out its polynomial would fold the
picture back.
"""

import math
from dataclasses import dataclass, field
from functools import cache
from typing import TypeVar

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike

from .arrays import FloatArray, set_arrays
from .errors import InputError

_Number = TypeVar("_Number", float, FloatArray)
_NEWTON_STEPS = 50
_NEAR = 1.0e-13  # of a shown point: where Newton's method ends
_LEAST_STEP = 1.0e-4  # share of a step of its
_FOUND = 1.0e-10  # what is farther off is not shown


class _Lens(Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True, tag_field="model"):
    """What all lenses have in common: how they are read and written."""


class BrownConrady(_Lens, frozen=True, kw_only=True, tag="brown-conrady"):
    """Radial and tangential distortion; all zeros: none. Order and signs as in OpenCV.

    D. Brown, "Decentering distortion of lenses", 1966.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    @property
    def reach(self) -> float:
        """Radius at depth 1 up to which points are shown; may be infinite."""
        return math.sqrt(_brown_turn(self))

    @property
    def radial(self) -> "BrownConrady":
        """The same without tangential terms."""
        return BrownConrady(k1=self.k1, k2=self.k2, k3=self.k3)

    def _stretch(self, square: _Number) -> _Number:
        """How much farther out the radial terms show points, by the square of their radius."""
        return 1.0 + square * (self.k1 + square * (self.k2 + square * self.k3))

    def distort(self, points: FloatArray) -> FloatArray:
        """Points (n, 2) at depth 1 as the lens shows them; NaN where it would fold them back."""
        x, y = points.T
        square = x**2 + y**2
        radial = self._stretch(square)
        across = 2.0 * x * y
        distorted = np.stack(
            [
                x * radial + self.p1 * across + self.p2 * (square + 2.0 * x**2),
                y * radial + self.p2 * across + self.p1 * (square + 2.0 * y**2),
            ],
            axis=1,
        )
        distorted[square > _brown_turn(self)] = np.nan
        return distorted

    def undistort(self, points: FloatArray) -> FloatArray:
        """The inverse of :meth:`distort`, (n, 2); NaN where the lens shows nothing.

        By Newton's method with shorter steps where they lead away: within its reach the lens is the
        slope of a convex function, so that there is but one solution.
        """
        found = points / np.maximum(1.0, _radius(points)[:, None] / min(self.reach, 1.0))
        lacks = self.distort(found) - points
        step = _solve(self._slopes(found), lacks)
        off, factor = _radius(lacks), np.ones(len(found))
        for _ in range(2 * _NEWTON_STEPS):
            left = np.flatnonzero((off > _NEAR) & (factor > _LEAST_STEP))
            if not len(left):
                break
            tried = found[left] - factor[left, None] * step[left]
            lacks = self.distort(tried) - points[left]
            is_better = _radius(lacks) < off[left]  # not where the step left the reach
            better = left[is_better]
            found[better], off[better] = tried[is_better], _radius(lacks[is_better])
            step[better] = _solve(self._slopes(found[better]), lacks[is_better])
            factor[left] = np.where(is_better, 1.0, 0.5 * factor[left])
        found[~(off <= _FOUND)] = np.nan
        return found

    def _slopes(self, points: FloatArray) -> FloatArray:
        """Derivatives of :meth:`distort`, (3, n): of column by x, of either by the other, row."""
        x, y = points.T
        square = x**2 + y**2
        radial = self._stretch(square)
        rise = 2.0 * (self.k1 + square * (2.0 * self.k2 + square * 3.0 * self.k3))
        return np.stack(
            [
                radial + x * x * rise + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
                x * y * rise + 2.0 * self.p1 * x + 2.0 * self.p2 * y,
                radial + y * y * rise + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
            ]
        )

    def shown_at(self, angle_rad: float) -> float:
        """Distance from the middle at which a ray at an angle off the axis is shown, radially."""
        square = math.tan(angle_rad) ** 2
        radial = self._stretch(square)
        return math.tan(angle_rad) * radial

    def angle_of(self, shown: float) -> float:
        """The inverse of :meth:`shown_at`; not a number where the lens shows nothing."""
        return math.atan(float(self.radial.undistort(np.array([[shown, 0.0]]))[0, 0]))


class TsaiRadial(_Lens, frozen=True, kw_only=True, tag="tsai"):
    """Radial distortion by one term: undistorted = distorted x (1 + kappa r_distorted^2).

    R. Tsai, "A versatile camera calibration technique for high-accuracy 3D machine vision
    metrology", 1987. His kappa1 is per mm^2 of the sensor; here it is times the focal length
    squared, for points at depth 1.
    """

    kappa: float

    @property
    def _turn(self) -> float:
        """With kappa < 0 the cubic r + kappa r^3 rises up to this shown radius only."""
        return math.inf if self.kappa >= 0.0 else (-1.0 / (3.0 * self.kappa)) ** 0.5

    @property
    def reach(self) -> float:
        """Radius at depth 1 up to which points are shown; may be infinite."""
        return 2.0 / 3.0 * self._turn

    def distort(self, points: FloatArray) -> FloatArray:
        """Points (n, 2) at depth 1 as the lens shows them; not a number where it shows none."""
        radius = np.hypot(*points.T)
        turn = self._turn
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
        """The inverse of :meth:`distort`, (n, 2); NaN where the lens shows nothing."""
        square = (points**2).sum(axis=1, keepdims=True)
        found = np.asarray(points * (1.0 + self.kappa * square))
        return np.where(square > self._turn**2, np.nan, found)

    def shown_at(self, angle_rad: float) -> float:
        """Distance from the middle at which a ray at an angle off the axis is shown."""
        return float(self.distort(np.array([[math.tan(angle_rad), 0.0]]))[0, 0])

    def angle_of(self, shown: float) -> float:
        """The inverse of :meth:`shown_at`; not a number where the lens shows nothing."""
        return math.atan(float(self.undistort(np.array([[shown, 0.0]]))[0, 0]))


class Fisheye(_Lens, frozen=True, kw_only=True, tag="fisheye"):
    """A fisheye: an angle off the axis is shown at angle (1 + k1 angle^2 + .. + k4 angle^8).

    J. Kannala, S. Brandt, "A generic camera model and calibration method for conventional,
    wide-angle, and fish-eye lenses", 2006; as ``cv::fisheye`` and ROS's "equidistant".
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0

    @property
    def reach(self) -> float:
        """Radius at depth 1 up to which points are shown; infinite from a right angle on."""
        angle = self.widest_rad
        return math.tan(angle) if angle < 0.5 * math.pi else math.inf

    @property
    def widest_rad(self) -> float:
        """Angle off the axis up to which points are shown, at most half a turn."""
        return min(_fisheye_turn(self), math.pi)

    @property
    def _powers(self) -> tuple[float, ...]:
        return (self.k4, 0.0, self.k3, 0.0, self.k2, 0.0, self.k1, 0.0, 1.0, 0.0)

    def distort(self, points: FloatArray) -> FloatArray:
        """Points (n, 2) at depth 1 as the lens shows them; not a number where it shows none."""
        radius = np.hypot(*points.T)
        angle = np.arctan(radius)
        shown = np.polyval(self._powers, angle)
        share = np.divide(shown, radius, out=np.ones_like(radius), where=radius > 0.0)
        share[angle > _fisheye_turn(self)] = np.nan
        return np.asarray(points * share[:, None])

    def undistort(self, points: FloatArray) -> FloatArray:
        """The inverse of :meth:`distort`, (n, 2); NaN where the lens shows nothing.

        Nor has a ray at a right angle or more to the axis a point at depth 1.
        """
        shown = _radius(points)
        angle = self._angles(shown)
        radius = np.where(angle < 0.5 * np.pi, np.tan(angle), np.nan)
        share = np.divide(radius, shown, out=np.ones_like(radius), where=shown > 0.0)
        return np.asarray(points * share[:, None])

    def shown_at(self, angle_rad: float) -> float:
        """Distance from the middle at which a ray at an angle off the axis is shown."""
        return float(np.polyval(self._powers, angle_rad))

    def angle_of(self, shown: float) -> float:
        """The inverse of :meth:`shown_at`; not a number where the lens shows nothing."""
        return float(self._angles(np.array([shown]))[0])

    def _angles(self, shown: FloatArray) -> FloatArray:
        """Angles (n,) at which the lens shows rays so far from the middle, by Newton's method.

        Where a step leaves the interval that is left, it is halved. NaN: the lens shows none there.
        """
        powers, widest = self._powers, self.widest_rad
        low, high = np.zeros_like(shown), np.full_like(shown, widest)
        angle = np.minimum(shown, widest)
        for _ in range(2 * _NEWTON_STEPS):
            lacks = np.polyval(powers, angle) - shown
            low, high = np.where(lacks <= 0.0, angle, low), np.where(lacks >= 0.0, angle, high)
            slope = np.polyval(np.polyder(powers), angle)
            there = angle - np.divide(
                lacks, slope, out=np.full_like(lacks, np.inf), where=slope > 0
            )
            angle = np.where((there >= low) & (there <= high), there, 0.5 * (low + high))
            if not (abs(lacks) > _NEAR).any():
                break
        off = ~(abs(np.polyval(powers, angle) - shown) <= _FOUND)
        return np.where(off, np.nan, angle)


def _radius(points: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(points[:, 0], points[:, 1]))


def _solve(slopes: FloatArray, values: FloatArray) -> FloatArray:
    """Solutions (n, 2) of symmetric equations, (3, n): first, mixed and last coefficient."""
    first, mixed, last = slopes
    x, y = values.T
    solved = np.stack([last * x - mixed * y, first * y - mixed * x]) / (first * last - mixed**2)
    return np.asarray(solved.T)


@cache
def _brown_turn(lens: BrownConrady) -> float:
    """Square of the radius up to which a lens of Brown and Conrady keeps points in their order.

    Where r (1 + k1 r^2 + k2 r^4 + k3 r^6) stops rising; with tangential terms, whose derivatives
    are at most 6 |p| r, a little before, where it may still rise across and around.
    """
    bend = 6.0 * math.hypot(lens.p1, lens.p2)
    if bend == 0.0:
        return _first_turn([7.0 * lens.k3, 5.0 * lens.k2, 3.0 * lens.k1, 1.0])
    ahead = [7.0 * lens.k3, 0.0, 5.0 * lens.k2, 0.0, 3.0 * lens.k1, -bend, 1.0]
    around = [lens.k3, 0.0, lens.k2, 0.0, lens.k1, -bend, 1.0]
    return min(_first_turn(ahead), _first_turn(around)) ** 2


@cache
def _fisheye_turn(lens: Fisheye) -> float:
    return _first_turn(np.polyder(lens._powers))


def _first_turn(slope: ArrayLike) -> float:
    """Smallest positive root of a polynomial, highest power first; infinite if there is none."""
    # Their inverses: the last coefficient is 1, where the first may be next to nothing.
    inverse = np.roots(np.asarray(slope)[::-1])
    rising = inverse[(abs(inverse.imag) < 1.0e-12) & (inverse.real > 0.0)].real
    return 1.0 / float(rising.max()) if len(rising) else np.inf


Lens = BrownConrady | TsaiRadial | Fisheye


def widest_rad(lens: Lens) -> float:
    """Angle off the axis up to which a lens shows anything; only a fisheye's may exceed 90."""
    return lens.widest_rad if isinstance(lens, Fisheye) else math.atan(lens.reach)


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

    @property
    def K(self) -> FloatArray:
        """Focal lengths and principal point, (3, 3); the middle of the first pixel is (0, 0)."""
        rows = [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        return np.array(rows)

    @property
    def translation_m(self) -> FloatArray:
        """t, (3,): the world's origin as the camera sees it; x_camera = R x_world + t. [m]."""
        return self.R_camera_world @ (np.zeros(3) - self.position_m)


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
