"""Results for tests that look at a part of them."""

import msgspec

from experiments.results.result import Result

_OTHERS = {
    "schema": "place-rsus/result/1",
    "budget": None,
    "fusion": "any",
    "apr": 0.9,
    "bound": None,
    "gap": None,
    "apr_without_worst_unit": 0.5,
    "baseline": None,
    "surrogate_disagreement": None,
    "cases": ["CBTAfs-100"],
    "weathers": ["day"],
    "not_driven": [],
    "detector": "geometric",
    "vut_sensors": ["camera"],
    "packet_loss": 0.0,
    "vam_rate": 0.0,
    "seconds": {},
    "versions": {},
}


def as_result(summary):
    """The result whose plain values these are; what is left out is of no matter."""
    return msgspec.convert(_OTHERS | summary, Result)
