"""Vehicles that drive by: a scene's lanes as a SUMO network, demand, simulation, windows.

``demand`` reads how much drives; ``sumo`` writes lanes for netconvert and runs SUMO in
a process of its own (``child``). All end in ``trajectories``, of which a window is cut
for each run; ``source`` is the way in.
"""

from .demand import read_body
from .sumo import MovingTraffic, load_traffic
from .trajectories import NO_TRAFFIC, TrafficCount

__all__ = ["NO_TRAFFIC", "MovingTraffic", "TrafficCount", "load_traffic", "read_body"]
