"""Lenses that distort, and calibrated cameras.

There are Brown-Conrady's model, Tsai's one term, and fisheyes.

Points are at depth 1 along the optical axis: x right and y down, over the depth. A lens
shows what lies up to some angle off its axis, its :attr:`reach`; farther out its
polynomial would fold the picture back.
"""

import math
from functools import cache

import numpy as np
from msgspec import Struct

from .arrays import FloatArray

# Coefficients of a polynomial, the highest power first.
Powers = tuple[float, ...]
_STEPS = 100
# For one radius: with large terms the first guess is far off.
_MOST_STEPS = 300
# Of a shown point: where Newton's method ends.
_NEAR = 1.0e-13
# Share of a step of Newton's method below which it ends.
_LEAST_STEP = 1.0e-4
# What is farther off is not shown.
_FOUND = 1.0e-10


class _Lens(
    Struct,
    frozen=True,
    omit_defaults=True,
    forbid_unknown_fields=True,
    tag_field="model",
):
    """What all lenses have in common.

    Each lens has a `reach`, and shows points at other radii than they have.
    """

    @property
    def reach(self) -> float:
        """Radius at depth 1 up to which points are shown; may be infinite."""
        raise NotImplementedError

    @property
    def widest_rad(self) -> float:
        """Angle off the axis up to which anything is shown, in rad.

        Only a fisheye's may exceed a right angle.
        """
        return math.atan(self.reach)

    def shown_radius(self, radius: FloatArray) -> FloatArray:
        """Shown radii of radii (n,) at depth 1, without tangential terms.

        NaN where the lens shows nothing.
        """
        raise NotImplementedError

    def seen_radius(self, shown: FloatArray) -> FloatArray:
        """The inverse of :meth:`shown_radius`; NaN where the lens shows nothing."""
        raise NotImplementedError

    def distort(self, points: FloatArray) -> FloatArray:
        """Points (n, 2) at depth 1 as the lens shows them.

        NaN where it would fold them back.
        """
        radius = _radius(points)
        return _moved(points, radius, self.shown_radius(radius))

    def undistort(self, points: FloatArray) -> FloatArray:
        """The inverse of :meth:`distort`, (n, 2); NaN where the lens shows nothing."""
        shown = _radius(points)
        return _moved(points, shown, self.seen_radius(shown))

    def shown_at(self, angle_rad: float) -> float:
        """Shown radius of a ray at an angle off the axis.

        Tangential terms do not count.
        """
        return float(self.shown_radius(np.array([math.tan(angle_rad)]))[0])

    def angle_of(self, shown: float) -> float:
        """The inverse of :meth:`shown_at`, in rad.

        Not a number where the lens shows nothing.
        """
        return math.atan(float(self.seen_radius(np.array([shown]))[0]))


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
    def _powers(self) -> Powers:
        return (self.k3, 0.0, self.k2, 0.0, self.k1, 0.0, 1.0, 0.0)

    @property
    def reach(self) -> float:
        """Up to here points keep their order ahead and around.

        With tangential terms, whose derivatives are at most 6 |p| r, a little before.
        """
        bend = 6.0 * math.hypot(self.p1, self.p2)
        ahead = _slopes(self._powers)
        around = self._powers[:-1]
        return min(
            _first_turn((*one[:-2], one[-2] - bend, one[-1])) for one in (ahead, around)
        )

    def shown_radius(self, radius: FloatArray) -> FloatArray:
        """By the radial terms."""
        return np.where(radius <= self.reach, np.polyval(self._powers, radius), np.nan)

    def seen_radius(self, shown: FloatArray) -> FloatArray:
        """The inverse of the radial terms."""
        return _invert(self._powers, shown, self.reach)

    def distort(self, points: FloatArray) -> FloatArray:
        """The radial part, moved aside by the tangential terms."""
        x, y = points.T
        across = 2.0 * x * y
        square = x**2 + y**2
        aside = [
            self.p1 * across + self.p2 * (square + 2.0 * x**2),
            self.p2 * across + self.p1 * (square + 2.0 * y**2),
        ]
        return np.asarray(_Lens.distort(self, points) + np.stack(aside, axis=1))

    def undistort(self, points: FloatArray) -> FloatArray:
        """Invert :meth:`distort`; with tangential terms by Newton's method.

        Steps that lead away are shortened.

        Within its reach the lens is the slope of a convex function: there is but one
        solution.
        """
        # Radial terms alone are inverted along the radius.
        if self.p1 == self.p2 == 0.0:
            return _Lens.undistort(self, points)
        found = points / np.maximum(
            1.0, _radius(points)[:, None] / min(self.reach, 1.0)
        )
        # Newton's method for all points at once, each with its own length of step.
        lacks = self.distort(found) - points
        step = self._step(found, lacks)
        off = _radius(lacks)
        factor = np.ones(len(found))
        for _ in range(_STEPS):
            left = np.flatnonzero((off > _NEAR) & (factor > _LEAST_STEP))
            if not len(left):
                break
            tried = found[left] - factor[left, None] * step[left]
            lacks = self.distort(tried) - points[left]
            # Not where the step left the reach.
            is_better = _radius(lacks) < off[left]
            better = left[is_better]
            found[better], off[better] = tried[is_better], _radius(lacks[is_better])
            step[better] = self._step(found[better], lacks[is_better])
            factor[left] = np.where(is_better, 1.0, 0.5 * factor[left])
        found[~(off <= _FOUND)] = np.nan
        return found

    def _step(self, points: FloatArray, lacks: FloatArray) -> FloatArray:
        """Newton's steps (n, 2).

        They are the inverted derivatives of :meth:`distort` times what it
        lacks.
        """
        x, y = points.T
        square = x**2 + y**2
        radial = 1.0 + square * (self.k1 + square * (self.k2 + square * self.k3))
        rise = 2.0 * (self.k1 + square * (2.0 * self.k2 + square * 3.0 * self.k3))
        first = radial + x * x * rise + 2.0 * self.p1 * y + 6.0 * self.p2 * x
        mixed = x * y * rise + 2.0 * self.p1 * x + 2.0 * self.p2 * y
        last = radial + y * y * rise + 6.0 * self.p1 * y + 2.0 * self.p2 * x
        right, down = lacks.T / (first * last - mixed**2)
        return np.stack(
            [last * right - mixed * down, first * down - mixed * right], axis=1
        )


class TsaiRadial(_Lens, frozen=True, kw_only=True, tag="tsai"):
    """Radial distortion by one term.

    undistorted = distorted x (1 + kappa r_distorted^2).

    R. Tsai, "A versatile camera calibration technique for high-accuracy 3D machine
    vision metrology", 1987. His kappa1 is per mm^2 of the sensor; here it is times the
    focal length squared, for points at depth 1.
    """

    kappa: float

    @property
    def _powers(self) -> Powers:
        return (self.kappa, 0.0, 1.0, 0.0)

    @property
    def _turn(self) -> float:
        """With kappa < 0 the cubic r + kappa r^3 rises up to this shown radius only."""
        if self.kappa >= 0.0:
            return math.inf
        return float((-1.0 / (3.0 * self.kappa)) ** 0.5)

    @property
    def reach(self) -> float:
        """What is shown where the cubic turns."""
        return 2.0 / 3.0 * self._turn

    def shown_radius(self, radius: FloatArray) -> FloatArray:
        """The inverse of the cubic."""
        return _invert(self._powers, radius, self._turn)

    def seen_radius(self, shown: FloatArray) -> FloatArray:
        """By the cubic."""
        return np.where(shown <= self._turn, np.polyval(self._powers, shown), np.nan)


class Fisheye(_Lens, frozen=True, kw_only=True, tag="fisheye"):
    """A fisheye, whose shown radius is a polynomial of the angle.

    An angle off the axis is shown at angle (1 + k1 angle^2 + .. + k4 angle^8).

    J. Kannala, S. Brandt, "A generic camera model and calibration method for
    conventional, wide-angle, and fish-eye lenses", 2006; as ``cv::fisheye`` and ROS's
    "equidistant". A ray at a right angle or more to the axis has no point at depth 1.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0

    @property
    def _powers(self) -> Powers:
        return (self.k4, 0.0, self.k3, 0.0, self.k2, 0.0, self.k1, 0.0, 1.0, 0.0)

    @property
    def reach(self) -> float:
        """Infinite from a right angle on."""
        angle = self.widest_rad
        if angle < 0.5 * math.pi:
            return math.tan(angle)
        return math.inf

    @property
    def widest_rad(self) -> float:
        """At most half a turn."""
        return min(_first_turn(_slopes(self._powers)), math.pi)

    def shown_radius(self, radius: FloatArray) -> FloatArray:
        """By the polynomial in the angle."""
        angle = np.arctan(radius)
        return np.where(
            angle <= self.widest_rad, np.polyval(self._powers, angle), np.nan
        )

    def seen_radius(self, shown: FloatArray) -> FloatArray:
        """The tangent of the angle that is shown there."""
        angle = _invert(self._powers, shown, self.widest_rad)
        return np.where(angle < 0.5 * np.pi, np.tan(angle), np.nan)

    def shown_at(self, angle_rad: float) -> float:
        """Also of angles beyond a right one."""
        return float(np.polyval(self._powers, angle_rad))

    def angle_of(self, shown: float) -> float:
        """Also beyond a right angle."""
        return float(_invert(self._powers, np.array([shown]), self.widest_rad)[0])


def _radius(points: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(points[:, 0], points[:, 1]))


def _moved(points: FloatArray, radius: FloatArray, to_radius: FloatArray) -> FloatArray:
    """Points (n, 2) straight on or back from one radius (n,) to another."""
    share = np.divide(to_radius, radius, out=np.ones_like(radius), where=radius > 0.0)
    return np.asarray(points * share[:, None])


# What is too far out is not found.
@np.errstate(over="ignore", invalid="ignore")
def _invert(powers: Powers, values: FloatArray, most: float) -> FloatArray:
    """Arguments (n,) at which a polynomial has values >= 0.

    NaN where it does not reach them.

    By Newton's method between 0 and `most`, up to which it rises from 0. Where a step
    leaves the interval that is left, that is halved.
    """
    # The polynomial rises from 0 up to here.
    top = np.polyval(powers, most) if most < math.inf else math.inf
    wanted = np.minimum(values, top)
    slopes = _slopes(powers)
    low = np.zeros_like(values)
    high = np.full_like(values, most)
    found = np.minimum(wanted, most)
    near = 1.0 + wanted
    for _ in range(_MOST_STEPS):
        lacks = np.polyval(powers, found) - wanted
        if not (abs(lacks) > _NEAR * near).any():
            break
        low = np.where(lacks <= 0.0, found, low)
        high = np.where(lacks >= 0.0, found, high)
        slope = np.polyval(slopes, found)
        step = np.divide(
            lacks, slope, out=np.full_like(lacks, np.inf), where=slope > 0.0
        )
        there = found - step
        found = np.where((there >= low) & (there <= high), there, 0.5 * (low + high))
    off = ~(abs(np.polyval(powers, found) - values) <= _FOUND * near)
    return np.where(off, np.nan, found)


def _slopes(powers: Powers) -> Powers:
    """Derivative of a polynomial."""
    return tuple(np.polyder(powers).tolist())


@cache
def _first_turn(slopes: Powers) -> float:
    """Smallest positive root of a polynomial; infinite if there is none.

    The coefficient of the highest power comes first.
    """
    # Their inverses: the last coefficient is 1, where the first may be next to nothing.
    inverse = np.roots(slopes[::-1])
    rising = inverse[(abs(inverse.imag) < 1.0e-12) & (inverse.real > 0.0)].real
    if len(rising):
        return 1.0 / float(rising.max())
    return math.inf


Lens = BrownConrady | TsaiRadial | Fisheye
