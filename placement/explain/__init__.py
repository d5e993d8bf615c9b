"""Explanations of a layout: what its units contribute, what it misses, what else would do.

``contributions`` takes one or two units away, or adds one, ``other_sensors`` exchanges them;
``unavoided`` says why runs are not avoided, ``agreement`` where detection table and evaluator
differ, ``sensitivity`` what wrong assumptions and errors of mounting do. ``alternatives`` are
layouts that other priorities would choose, of which it picks one by the evaluator. ``conflicts``
finds the smallest set of demands that no layout meets, with the search of ``feasible_sets``.
"""

from .conflicts import (
    Conflict,
    Demand,
    Relaxation,
    Separation,
    build_separation,
    find_conflicts,
    find_refusal,
    relax,
)
from .contributions import Contribution, NextUnit, find_contributions, find_next_unit
from .other_sensors import OtherSensor, OtherSensors, find_other_sensors
from .unavoided import Reason, Rescue, Unavoided, find_unavoided

__all__ = [
    "Conflict",
    "Contribution",
    "Demand",
    "NextUnit",
    "OtherSensor",
    "OtherSensors",
    "Reason",
    "Relaxation",
    "Rescue",
    "Separation",
    "Unavoided",
    "build_separation",
    "find_conflicts",
    "find_contributions",
    "find_next_unit",
    "find_other_sensors",
    "find_refusal",
    "find_unavoided",
    "relax",
]
