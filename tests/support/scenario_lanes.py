"""Lanes of scenarios: those of the protocol's junction, fewer of them, or others."""

import numpy as np
from junctions import ARMS, LANE_M, lanes_of

from geometry.scene import Lane


def arm_lanes(*, without=(), **options):
    """Lanes of the protocol's junction, but for some arms; options as of lanes_of."""
    lanes = []
    for arm, bearing_deg in ARMS.items():
        if arm not in without:
            lanes += lanes_of(arm, bearing_deg, **options)
    return lanes


def build_lane(name, line_m, *, kind="driving", width_m=LANE_M):
    """A lane through points."""
    line = np.array(line_m, dtype=float)
    return Lane(id=name, kind=kind, width_m=width_m, centreline_m=line)


def exchanged(lanes, *others):
    """Lanes, of which some give way to others with their ids."""
    own = {lane.id: lane for lane in others}
    return [own.get(lane.id, lane) for lane in lanes]


def pose_at(motion, time_s=0.0):
    """Position (2,) and yaw of a motion at a time, by default at the impact."""
    position, yaw_deg = motion.path.at(motion.distance_m(time_s))
    return np.asarray(position), float(yaw_deg)
