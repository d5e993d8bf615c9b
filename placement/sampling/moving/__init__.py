"""Vehicles that drive by, from SUMO.

A scene's lanes become a network; demand drives on it, and windows are cut out.
``demand`` reads how much drives; ``sumo`` writes lanes for netconvert and runs
SUMO in a process of its own (``child``). All end in ``trajectories``, of which
a window is cut for each run; ``source`` is the way in.
"""

from .demand import read_body
from .sumo import MovingTraffic, load_traffic
from .trajectories import NO_TRAFFIC, TrafficCount

__all__ = ["NO_TRAFFIC", "MovingTraffic", "TrafficCount", "load_traffic", "read_body"]
