"""Verdicts of a layout by full perception + AEB."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray, FloatArray, freeze
from scenarios.aeb import AebRule, is_in_time
from scenarios.exposure import weight_share
from scenarios.runs import FrameAxis, confirmation_times_s

from .layout import Layout


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict:
    """What one sensing party achieves: a unit, the VUT, or several fused.

    Attributes
    ----------
    detected : (n_frames,) bool
        Frames in which the VRU is detected.
    confirmation_time_s : (n_runs,) float
        First confirmation, relative to the impact; infinite if there is none. [s]
    is_avoided : (n_runs,) bool
        Whether braking after it avoids the impact.
    """

    detected: BoolArray
    confirmation_time_s: FloatArray
    is_avoided: BoolArray

    def __post_init__(self) -> None:
        for field in ("detected", "confirmation_time_s", "is_avoided"):
            object.__setattr__(self, field, freeze(getattr(self, field)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evaluation:
    """A layout's verdicts.

    Attributes
    ----------
    layout : Layout
        What was evaluated.
    axis : FrameAxis
        Runs and frames.
    vut : Verdict
        The VUT's own camera alone.
    units : mapping of str to Verdict
        Each unit of the layout alone, by id, in the layout's order.
    rsu_all : Verdict
        All units fused: in each frame any of them may be the detector.
    vut_and_rsus : Verdict
        The same with the VUT's camera.
    """

    layout: Layout
    axis: FrameAxis
    vut: Verdict
    units: Mapping[str, Verdict]
    rsu_all: Verdict
    vut_and_rsus: Verdict

    def __repr__(self) -> str:
        return (
            f"Evaluation({self.layout.name!r}: APR {apr(self.rsu_all, self.axis):.4f} with "
            f"{len(self.units)} units, {apr(self.vut, self.axis):.4f} by the VUT alone)"
        )


def apr(verdict: Verdict, axis: FrameAxis, run_mask: BoolArray | None = None) -> float:
    """Accident prevention ratio: weight of avoided runs / weight of all.

    Parameters
    ----------
    verdict : Verdict
        Whose.
    axis : FrameAxis
        Runs and their weights.
    run_mask : (n_runs,) bool, optional
        Count these runs only.

    Returns
    -------
    apr : float
        0 .. 1; NaN if the runs counted have no weight.
    """
    weight = axis.weight if run_mask is None else axis.weight * run_mask
    return weight_share(verdict.is_avoided, weight)


def apr_by_case(verdict: Verdict, axis: FrameAxis) -> dict[str, float]:
    """Accident prevention ratio per case, in the order in which the cases first appear."""
    cases = np.array(axis.cases)
    return {case: apr(verdict, axis, cases == case) for case in dict.fromkeys(axis.cases)}


def apr_one_failed(evaluation: Evaluation, rule: AebRule) -> float:
    """Smallest accident prevention ratio of the units, fused, that is left when one of them fails.

    Parameters
    ----------
    evaluation : Evaluation
        Of a layout.
    rule : AebRule
        Confirmation and latency.

    Returns
    -------
    apr : float
        0 .. 1; 0 for a layout of one unit.
    """
    axis = evaluation.axis
    detected = {name: verdict.detected for name, verdict in evaluation.units.items()}
    smallest = 1.0
    for failed in detected:
        left = np.zeros(axis.n_frames, dtype=bool)
        for name, frames in detected.items():
            left |= frames & (name != failed)
        confirmation = confirmation_times_s(left, axis, n_confirmations=rule.n_confirmations)
        in_time = is_in_time(confirmation, axis.last_brake_time_s, latency_s=rule.latency_s)
        smallest = min(smallest, weight_share(in_time, axis.weight))
    return smallest


def detected_share(verdict: Verdict, axis: FrameAxis, run_mask: BoolArray | None = None) -> float:
    """Share of the frames of some runs in which the VRU is detected, 0 .. 1."""
    n_frames = np.diff(axis.run_start)
    frames = np.ones(axis.n_frames, dtype=bool) if run_mask is None else run_mask.repeat(n_frames)
    return float(verdict.detected[frames].mean())
