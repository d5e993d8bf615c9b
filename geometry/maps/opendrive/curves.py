"""Shapes of the pieces of a reference line, each in its own frame: it starts at 0 along x."""

import numpy as np
from scipy.special import fresnel

from ...arrays import FloatArray

_ARC_BELOW_RAD = 1.0e-9  # a clothoid that turns by so much more or less than an arc is one
_N_ARC_LENGTH = 2049


def arc(s_m: FloatArray, curvature: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n, 2) and headings (n,) of circular arcs; of straight lines where curvature is 0.

    Parameters
    ----------
    s_m : (n,) float
        Arc lengths. [m]
    curvature : (n,) float
        Positive turns to the left. [1/m]
    """
    half = 0.5 * curvature * s_m
    chord = s_m * np.sinc(half / np.pi)
    return np.stack([chord * np.cos(half), chord * np.sin(half)], axis=1), 2.0 * half


def spiral(
    s_m: FloatArray, start_curvature: FloatArray, curvature_slope: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points (n, 2) and headings (n,) of clothoids.

    Parameters
    ----------
    s_m : (n,) float
        Arc lengths. [m]
    start_curvature : (n,) float
        [1/m]
    curvature_slope : (n,) float
        By how much curvature grows per metre. [1/m^2]

    References
    ----------
    .. [1] Abramowitz, Stegun, section 7.3: completing the square in the heading
       k0 s + k' s^2 / 2 leaves the Fresnel integrals C and S.
    """
    points, heading = arc(s_m, start_curvature + 0.5 * curvature_slope * s_m)
    bent = np.abs(curvature_slope) * s_m**2 > _ARC_BELOW_RAD
    if bent.any():
        s, k0, slope = s_m[bent], start_curvature[bent], curvature_slope[bent]
        scale = np.sqrt(np.abs(slope) / np.pi)
        begin, end = scale * k0 / slope, scale * (s + k0 / slope)
        (sine_0, cosine_0), (sine_1, cosine_1) = fresnel(begin), fresnel(end)
        along = (cosine_1 - cosine_0) / scale
        across = np.sign(slope) * (sine_1 - sine_0) / scale
        turn = -0.5 * k0**2 / slope
        points[bent] = np.stack(
            [
                along * np.cos(turn) - across * np.sin(turn),
                along * np.sin(turn) + across * np.cos(turn),
            ],
            axis=1,
        )
    return points, heading


def polynomial(p: FloatArray, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n, 2) and headings (n,) of a pair of cubics.

    Parameters
    ----------
    p : (n,) float
        Parameter.
    u, v : (4,) or (n, 4) float
        Coefficients a, b, c, d of both coordinates.
    """
    points = np.stack([_cubic(p, u), _cubic(p, v)], axis=1)
    du, dv = _slope(p, u), _slope(p, v)
    # Where the curve starts with a standstill its second derivative says where it leads.
    stands = du**2 + dv**2 < 1.0e-18
    du = np.where(stands, 2.0 * u[..., 2] + 6.0 * u[..., 3] * p, du)
    dv = np.where(stands, 2.0 * v[..., 2] + 6.0 * v[..., 3] * p, dv)
    return points, np.arctan2(dv, du)


def graph_parameter(s_m: FloatArray, v: FloatArray, length_m: float) -> FloatArray:
    """Where on its u axis a curve v(u) has a given length, (n,).

    Parameters
    ----------
    s_m : (n,) float
        Arc lengths, 0 .. `length_m`. [m]
    v : (4,) float
        Coefficients a, b, c, d.
    length_m : float
        Of the whole curve. [m]
    """
    grid = np.linspace(0.0, length_m, _N_ARC_LENGTH)
    speed = np.hypot(1.0, _slope(grid, v))
    steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(grid)
    u: FloatArray = np.interp(s_m, np.append(0.0, np.cumsum(steps)), grid)
    return u


def _cubic(p: FloatArray, k: FloatArray) -> FloatArray:
    values: FloatArray = k[..., 0] + p * (k[..., 1] + p * (k[..., 2] + p * k[..., 3]))
    return values


def _slope(p: FloatArray, k: FloatArray) -> FloatArray:
    slopes: FloatArray = k[..., 1] + p * (2.0 * k[..., 2] + 3.0 * p * k[..., 3])
    return slopes
