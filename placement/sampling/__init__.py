"""Uncertainty -> sampled worlds -> detection tables of many worlds.

``uncertainty`` says what is uncertain and how much; ``traffic`` parks vehicles and lets others
wait, out of the way of VUT and VRU; ``moving`` lets vehicles drive by; ``worlds`` draws worlds,
each thing with random numbers of its own, and ``tables`` their detection tables, with misses and
lost messages, end to end for the optimiser. ``out_of_sample`` evaluates a layout in worlds that it
was not chosen in.
"""

from .moving import MovingTraffic, TrafficCount, load_traffic
from .out_of_sample import (
    FreshWorlds,
    MeanEstimate,
    SampledApr,
    cvar,
    estimate_mean,
    judge_layouts,
    look_at_fresh_worlds,
    out_of_sample,
    out_of_sample_layouts,
)
from .tables import SampledTable, obtain_table, sampled_table
from .uncertainty import (
    DEFAULT_UNCERTAINTY,
    UNCERTAINTY_NAMES,
    LatencyJitter,
    MountingErrors,
    StandingTraffic,
    Uncertainty,
    VehicleKind,
    load_drawn,
    load_uncertainty,
    with_moving_traffic,
)
from .worlds import Sample, draw_samples

__all__ = [
    "DEFAULT_UNCERTAINTY",
    "UNCERTAINTY_NAMES",
    "FreshWorlds",
    "LatencyJitter",
    "MeanEstimate",
    "MountingErrors",
    "MovingTraffic",
    "Sample",
    "SampledApr",
    "SampledTable",
    "StandingTraffic",
    "TrafficCount",
    "Uncertainty",
    "VehicleKind",
    "cvar",
    "draw_samples",
    "estimate_mean",
    "judge_layouts",
    "load_drawn",
    "load_traffic",
    "load_uncertainty",
    "look_at_fresh_worlds",
    "obtain_table",
    "out_of_sample",
    "out_of_sample_layouts",
    "sampled_table",
    "with_moving_traffic",
]
