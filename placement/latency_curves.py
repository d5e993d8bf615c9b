"""APR by the latency from frame to braking."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError
from scenarios.aeb import AebRule
from scenarios.runs import find_onsets
from scenarios.weights import weight_share

from .evaluation import Evaluation, earliest_arrival_s


def apr_by_latency(
    evaluation: Evaluation,
    rule: AebRule,
    latencies_s: Sequence[float],
    *,
    vut_latency_s: float | None = None,
) -> dict[str, FloatArray]:
    """APR of every sensing party by latency, each (n_latencies,).

    Keys are "vut", each unit's id, "rsu_all", "vut_and_rsus" and so on. Detected frames
    do not depend on the latency [s]: one evaluation is enough. A unit with a latency of
    its own keeps it; so do the VUT's own sensors with `vut_latency_s` [s]. Raises
    InputError if `vut_latency_s` is negative or not finite.
    """
    if vut_latency_s is not None and not 0.0 <= vut_latency_s < math.inf:
        raise InputError("vut_latency_s", vut_latency_s, "seconds, at least 0")
    # Parties by name: what each member detects, and its own latency if it has one.
    units = {
        unit.id: (evaluation.units[unit.id].detected, unit.latency_s)
        for unit in evaluation.layout.units
    }
    rsus = [*units.values()]
    vut = (evaluation.vut.detected, vut_latency_s)
    parties = {"vut": [vut], **{name: [unit] for name, unit in units.items()}}
    parties |= {"rsu_all": rsus, "vut_and_rsus": [*rsus, vut]}
    if "vam" in evaluation.others:
        vam = (evaluation.others["vam"].detected, None)
        parties |= {"vam": [vam], "all_sources": [*rsus, vut, vam]}
    axis = evaluation.axis

    def share(party: list[tuple[BoolArray, float | None]], latency_s: float) -> float:
        """Share of the weight that a party avoids at one latency."""
        arrival_s = earliest_arrival_s(
            [(seen, latency_s if own_s is None else own_s) for seen, own_s in party],
            axis,
        )
        onsets = find_onsets(arrival_s, axis, rule=replace(rule, latency_s=latency_s))
        return weight_share(onsets.is_in_time, axis.weight)

    # One curve for each party.
    return {
        name: np.array([share(party, latency_s) for latency_s in latencies_s])
        for name, party in parties.items()
    }
