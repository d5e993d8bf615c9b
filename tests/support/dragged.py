"""What tests ask of bodies that the program itself does not."""

import numpy as np

from scenarios.aeb import find_contacts


def front_axle_at(path, distance_m):
    """Front axle's centre (..., 2) on a turn path, and direction of its line, after a
    distance.
    """
    point, angle_deg = path.turn.at(np.asarray(distance_m) - path.straight_m)
    along = point[..., 0] + path.straight_m
    left = point[..., 1]
    yaw = np.radians(path.yaw_deg)
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    aside = np.array([-np.sin(yaw), np.cos(yaw)])
    front = path.start_m + along[..., None] * ahead + left[..., None] * aside
    return front, path.yaw_deg + angle_deg


def has_contact(encounter, onset_s, rule):
    """True if the footprints touch although the VUT brakes from `onset_s` on, for each
    onset.
    """
    return np.isfinite(find_contacts(encounter, onset_s, rule).time_s)
