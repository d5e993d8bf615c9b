"""Evaluations of which nothing but the detected frames and latencies counts."""

import numpy as np
from tiny_worlds import unit_at

from placement.evaluation import Evaluation, Verdict
from placement.layout import Layout


def seen_verdict(axis, frames):
    """A party that detects in these frames, (n_frames,), and never brakes."""
    never_s = np.full(axis.n_runs, np.inf)
    return Verdict(
        detected=np.array(frames, dtype=bool),
        confirmation_time_s=never_s,
        onset_time_s=never_s,
        is_avoided=np.zeros(axis.n_runs, dtype=bool),
    )


def seen_evaluation(axis, rows, latencies_s=(), *, vut=None, others=()):
    """Units U0, U1 .. that detect in these frames, (n_units, n_frames).

    Without latencies, units have that of the rule; the VUT and other parties have the
    frames that are told, all else has those of any unit.
    """
    own_s = list(latencies_s) or [None] * len(rows)
    units = [
        unit_at(f"U{index}", latency_s=latency_s)
        for index, latency_s in enumerate(own_s)
    ]
    together = seen_verdict(axis, np.any(rows, axis=0))
    by_vut = together
    if vut is not None:
        by_vut = seen_verdict(axis, vut)

    return Evaluation(
        layout=Layout(name="mine", units=tuple(units)),
        axis=axis,
        vut=by_vut,
        units={
            unit.id: seen_verdict(axis, row)
            for unit, row in zip(units, rows, strict=True)
        },
        rsu_all=together,
        vut_and_rsus=together,
        others={
            name: seen_verdict(axis, frames) for name, frames in dict(others).items()
        },
    )
