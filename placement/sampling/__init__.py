"""What is not known when a layout is chosen -> detection tables of many worlds.

``uncertainty`` says what is uncertain and how much, ``files`` reads it; ``luck`` keeps all draws
apart; ``traffic`` parks vehicles and lets others wait, ``ways`` keeps them off those of VUT and
VRU; ``samples`` draws worlds, ``drawing`` what a detector misses in them and which messages are
lost; ``tables`` stacks their detection tables for the optimiser, ``fresh`` judges a layout in
worlds that it was not chosen in, ``risk`` sums up what comes out.
"""

from .out_of_sample import (
    MeanEstimate,
    SampledApr,
    cvar,
    estimate_mean,
    out_of_sample,
    out_of_sample_layouts,
)
from .tables import SampledTable, sampled_table
from .uncertainty import (
    DEFAULT_UNCERTAINTY,
    UNCERTAINTY_NAMES,
    LatencyJitter,
    MountingErrors,
    StandingTraffic,
    Uncertainty,
    VehicleKind,
    load_uncertainty,
)
from .worlds import Sample, draw_samples

__all__ = [
    "DEFAULT_UNCERTAINTY",
    "UNCERTAINTY_NAMES",
    "LatencyJitter",
    "MeanEstimate",
    "MountingErrors",
    "Sample",
    "SampledApr",
    "SampledTable",
    "StandingTraffic",
    "Uncertainty",
    "VehicleKind",
    "cvar",
    "draw_samples",
    "estimate_mean",
    "load_uncertainty",
    "out_of_sample",
    "out_of_sample_layouts",
    "sampled_table",
]
