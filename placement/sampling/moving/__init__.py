"""Vehicles that drive by, from SUMO.

A scene's lanes become a network; demand drives on it, and windows are cut out.
``demand`` reads how much drives; ``sumo`` writes lanes for netconvert and runs
SUMO in a process of its own (``child``). All end in ``trajectories``, of which
a window is cut for each run; :mod:`placement.sampling.driving` is the way in.
"""
