"""APR against the total latency: an exact step function, for every sensing party."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray, FloatArray, freeze
from geometry.errors import InputError
from scenarios.aeb import AebRule, is_in_time
from scenarios.exposure import weight_share
from scenarios.runs import FrameAxis, onset_times_s

from .evaluation import Evaluation, earliest_arrival_s
from .latency import LatencyBudget

_DECIMALS = 9  # of a second: as fine as the tolerance of is_in_time


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LatencyCurve:
    """What latency does to one sensing party.

    Attributes
    ----------
    last_latency_s : (n_runs,) float
        Longest latency with which each run is still avoided. Negative: with none; minus infinity:
        never confirmed, or no braking avoids; infinite: with any. [s]
    weight : (n_runs,) float
        Of the runs.
    """

    last_latency_s: FloatArray
    weight: FloatArray

    def __post_init__(self) -> None:
        for name in ("last_latency_s", "weight"):
            object.__setattr__(self, name, freeze(getattr(self, name)))

    def apr(self, latency_s: ArrayLike) -> FloatArray:
        """Accident prevention ratio when every message takes so long.

        Parameters
        ----------
        latency_s : (...,) float
            At least 0. [s]

        Returns
        -------
        apr : (...,) float
            0 .. 1.
        """
        latencies = np.asarray(latency_s, dtype=np.float64)
        ratios = [
            weight_share(is_in_time(0.0, self.last_latency_s, latency_s=latency), self.weight)
            for latency in latencies.ravel().tolist()
        ]
        return np.array(ratios).reshape(latencies.shape)

    def steps(self) -> tuple[FloatArray, FloatArray]:
        """The whole curve.

        Returns
        -------
        until_s : (n_steps,) float
            Ascending; the last one is infinite. [s]
        apr : (n_steps,) float
            Descending. Value i holds for latencies above until_s[i - 1] - from 0 on for the first
            one - up to until_s[i] itself.
        """
        last = self.last_latency_s[(self.weight > 0.0) & np.isfinite(self.last_latency_s)]
        # What is just in time with no latency counts, and its step is at 0.
        last = np.maximum(last[is_in_time(0.0, last, latency_s=0.0)], 0.0)
        until = np.append(np.unique(last.round(_DECIMALS)), np.inf)
        return until, self.apr(until)

    def longest_latency_s(self, apr: float) -> float:
        """Longest latency with which the APR is at least so much.

        Parameters
        ----------
        apr : float
            What is asked for, 0 .. 1.

        Returns
        -------
        latency_s : float
            Infinite: the APR never falls below; minus infinity: it is less with none. [s]
        """
        until, ratios = self.steps()
        holds = ratios >= apr - 1.0e-12  # ratios of rounded sums
        return float(until[holds][-1]) if holds.any() else -math.inf

    def expected_apr(self, budget: LatencyBudget) -> float:
        """Expected accident prevention ratio if the latency follows a budget; exact, not drawn.

        Parameters
        ----------
        budget : LatencyBudget
            Distribution of the latency. All messages of a run take equally long, whoever sends
            them: frames and CPM generation are periodic, so that their phase does not change.

        Returns
        -------
        apr : float
            sum of w_r P(latency <= last latency of r) / sum of w_r; NaN if there is no weight.
        """
        total = math.fsum(self.weight)
        if total <= 0.0:
            return math.nan
        return math.fsum(self.weight * budget.share_within(self.last_latency_s)) / total


def apr_by_latency(
    evaluation: Evaluation, rule: AebRule, *, vut_latency_s: float | None = None
) -> dict[str, LatencyCurve]:
    """How the APR of every sensing party depends on the latency from a frame to braking.

    Detected frames do not depend on it, so one evaluation is enough.

    Parameters
    ----------
    evaluation : Evaluation
        Of a layout.
    rule : AebRule
        Confirmation. Its latency does not count.
    vut_latency_s : float, optional
        Of the VUT's own sensors, which wait for no message; by default they take as long as all
        others, as in the study. [s]

    Returns
    -------
    curves : dict of str to LatencyCurve
        "vut", each unit's id, "rsu_all", "vut_and_rsus" and so on. At latency L a curve says what
        an evaluation with ``replace(rule, latency_s=L)`` does by the last brake time: a unit with a
        latency of its own keeps it at every L, so that its curve is flat. Fused parties mix both
        kinds frame by frame.

    Raises
    ------
    InputError
        `vut_latency_s` is negative or not finite.
    """
    if vut_latency_s is not None and not 0.0 <= vut_latency_s < math.inf:
        raise InputError("vut_latency_s", vut_latency_s, "seconds, at least 0")
    units = {
        unit.id: (evaluation.units[unit.id].detected, unit.latency_s)
        for unit in evaluation.layout.units
    }
    vut = (evaluation.vut.detected, vut_latency_s)
    parties = {
        "vut": [vut],
        **{name: [unit] for name, unit in units.items()},
        "rsu_all": [*units.values()],
        "vut_and_rsus": [*units.values(), vut],
    }
    if "vam" in evaluation.others:
        vam = (evaluation.others["vam"].detected, None)
        parties |= {"vam": [vam], "all_sources": [*units.values(), vut, vam]}
    return {
        name: LatencyCurve(
            last_latency_s=_last_latency_s(fused, evaluation.axis, rule),
            weight=evaluation.axis.weight,
        )
        for name, fused in parties.items()
    }


def _last_latency_s(
    parties: Sequence[tuple[BoolArray, float | None]], axis: FrameAxis, rule: AebRule
) -> FloatArray:
    """Longest latency of those without one of their own with which each run is still avoided.

    A frame that a party with its own latency tells in time costs the others nothing: it counts as
    known at all times. The window that is known first is then the one that leaves most time.
    """
    last_brake_s = axis.last_brake_time_s.repeat(np.diff(axis.run_start))
    frame_s = earliest_arrival_s(
        [(detected, 0.0) for detected, own_s in parties if own_s is None], axis
    )
    for detected, own_s in parties:
        if own_s is not None:
            frame_s[detected & is_in_time(axis.time_s, last_brake_s, latency_s=own_s)] = -np.inf
    _, confirmed_s = onset_times_s(frame_s, axis, n_confirmations=rule.n_confirmations)
    last: FloatArray = axis.last_brake_time_s - confirmed_s
    return last
