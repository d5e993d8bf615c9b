"""Vehicles that drive by: a scene's lanes as a SUMO network, demand, simulation, FCD, windows.

``network`` writes lanes for netconvert; ``demand`` reads how much drives; ``simulate`` runs SUMO in
a process of its own (``child``); ``fcd`` reads a traffic model's own output. All end in
``trajectories``, of which ``windows`` cuts one for each run; ``source`` is the door.
"""

from .source import MovingTraffic, load_traffic
from .windows import NO_TRAFFIC, TrafficCount

__all__ = ["NO_TRAFFIC", "MovingTraffic", "TrafficCount", "load_traffic"]
