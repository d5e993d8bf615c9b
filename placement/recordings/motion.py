"""When braking is too late in a drive of which only distances and target speeds are recorded.

No positions are recorded, so the angle between the paths comes from the speeds v (VUT), u (VRU) and
c, at which their distance falls, by the law of cosines: c^2 = v^2 + u^2 - 2 u v cos(angle). What
this cannot know: a VUT that turns is taken as crossing; that a VRU may leave the VUT's path before
a late, braked VUT arrives is not counted on; the impact is known to a frame. The extents of the
bodies need not be known: they touch in the frame of the impact.
"""

import math

import numpy as np

from geometry.arrays import FloatArray
from scenarios.aeb import AebRule, braking_distance_m

from .folder_format import RecordingFormat


def closing_speed_mps(time_s: FloatArray, distance_m: FloatArray) -> float:
    """How fast a distance falls: minus the slope of the straight line through it.

    Parameters
    ----------
    time_s, distance_m : (n,) float
        At least two. [s], [m]

    Returns
    -------
    closing_speed_mps : float
        By least squares. [m/s]

    Examples
    --------
    >>> round(closing_speed_mps(np.array([-0.2, -0.1]), np.array([6.0, 5.5])), 9)
    5.0
    """
    time = time_s - time_s.mean()
    return -float(time @ (distance_m - distance_m.mean()) / (time @ time))


def is_same_direction(
    *,
    vut_speed_mps: float,
    vru_speed_mps: float,
    closing_speed_mps: float,
    form: RecordingFormat,
) -> bool:
    """Whether the VUT catches up with a VRU that goes its way.

    Parameters
    ----------
    vut_speed_mps, vru_speed_mps, closing_speed_mps : float
        v, u and c. [m/s]
    form : RecordingFormat
        Up to which angle the ways count as the same.

    Returns
    -------
    is_same_direction : bool
        False for a VRU that stands, or is as fast as the VUT.
    """
    v, u = vut_speed_mps, vru_speed_mps
    if not 0.0 < u < v:
        return False
    cosine = (v**2 + u**2 - closing_speed_mps**2) / (2.0 * u * v)
    return cosine > math.cos(math.radians(form.max_same_direction_deg))


def last_brake_time_s(
    *, vut_speed_mps: float, vru_speed_mps: float, is_same_direction: bool, rule: AebRule
) -> float:
    """Latest onset of braking that avoids, relative to the impact.

    Parameters
    ----------
    vut_speed_mps, vru_speed_mps : float
        v and u. [m/s]
    is_same_direction : bool
        The VUT must shed v - u only, before the gap to the VRU is closed; otherwise it must stop
        short of the place of the impact.
    rule : AebRule
        How the VUT brakes.

    Returns
    -------
    last_brake_time_s : float
        -(v - u) / (2 a) or -v / (2 a) without build-up. [s]

    Examples
    --------
    >>> from dataclasses import replace
    >>> from scenarios.aeb import load_aeb_rule
    >>> rule = replace(load_aeb_rule(), deceleration_mps2=8.0)
    >>> last_brake_time_s(
    ...     vut_speed_mps=16.0, vru_speed_mps=4.0, is_same_direction=True, rule=rule
    ... )
    -0.75
    """
    shed_mps = vut_speed_mps - vru_speed_mps if is_same_direction else vut_speed_mps
    # Relative to the VRU (or the road) the VUT needs this distance, and covers it unbraked in..
    distance_m = float(braking_distance_m(np.inf, speed_mps=shed_mps, rule=rule))
    return -distance_m / shed_mps
