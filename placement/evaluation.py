"""Verdicts of a layout by full perception + AEB."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Literal

import numpy as np

from geometry.arrays import BoolArray, FloatArray, freeze
from scenarios.aeb import AebRule
from scenarios.positions import sort_positions
from scenarios.runs import FrameAxis, find_onsets
from scenarios.weights import weight_share

from .layout import Layout

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict:
    """Verdict on one sensing party: a unit, the VUT, or several fused.

    Attributes
    ----------
    detected : (n_frames,) bool
        The VRU is detected, and the VUT gets to know it.
    confirmation_time_s : (n_runs,) float
        When the track was confirmed for which the VUT brakes, or would have to,
        relative to the impact; infinite if none is. See
        :class:`scenarios.runs.Onsets`. [s]
    onset_time_s : (n_runs,) float
        When braking sets in after it; infinite if it never does: also where
        every track was lost again before the last moment. [s]
    is_avoided : (n_runs,) bool
        Whether braking after it avoids the impact.
    impact_speed_kmh : (n_runs,) float, optional
        The VUT's speed when the bodies touch although it brakes then; 0 where
        they do not, its full speed where it never brakes. None: by the table or
        a recording alone. [km/h]
    """

    detected: BoolArray
    confirmation_time_s: FloatArray
    onset_time_s: FloatArray
    is_avoided: BoolArray
    impact_speed_kmh: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in (each.name for each in fields(self)):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, freeze(getattr(self, name)))


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
        The VUT's own sensors alone.
    units : mapping of str to Verdict
        Each unit of the layout alone, by id, in the layout's order.
    rsu_all : Verdict
        All units fused: in each frame any of them may be the detector.
    vut_and_rsus : Verdict
        The same with the VUT's own sensors.
    others : mapping of str to Verdict
        Further parties, where asked for: "vam", VRUs that announce themselves;
        "all_sources", they with the VUT and all units.
    cars : float
        Share of the VUTs that see, see :attr:`headline`. 0 .. 1.
    """

    layout: Layout
    axis: FrameAxis
    vut: Verdict
    units: Mapping[str, Verdict]
    rsu_all: Verdict
    vut_and_rsus: Verdict
    others: Mapping[str, Verdict] = field(default_factory=dict)
    cars: float = 0.0

    @property
    def headline(self) -> Verdict:
        """Verdict that the layout is judged by.

        It is that of all units, with the VUT where every VUT sees. Where only a
        share of them sees, this is that of the others; see ``headline_apr``.
        """
        if self.cars == 1.0:
            return self.vut_and_rsus
        return self.rsu_all

    def __repr__(self) -> str:
        return (
            f"Evaluation({self.layout.name!r}: APR {headline_apr(self):.4f} with "
            f"{len(self.units)} units, {apr(self.vut, self.axis):.4f} by the VUT alone)"
        )

    def __str__(self) -> str:
        return (
            f"{self.layout.name}: accident prevention"
            f" ratio\n{self.to_frame().to_string()}"
        )

    def _repr_html_(self) -> str:
        return str(self.to_frame().to_html())

    def to_frame(self) -> "pd.DataFrame":
        """Accident prevention ratios as a table, 0 .. 1.

        There is a row for all runs and for each case, and a column for each party.
        Columns: "rsu_all", "vut", "vut_and_rsus", what ``others`` has, then each
        unit by its id.
        """
        # Takes longer to load than all else here.
        import pandas as pd

        fused = {
            name: getattr(self, name) for name in ("rsu_all", "vut", "vut_and_rsus")
        }
        parties: dict[str, Verdict] = {**fused, **self.others, **self.units}
        return pd.DataFrame(
            {
                name: {
                    "all runs": apr(verdict, self.axis),
                    **apr_by_case(verdict, self.axis),
                }
                for name, verdict in parties.items()
            }
        )


def apr(verdict: Verdict, axis: FrameAxis, run_mask: BoolArray | None = None) -> float:
    """Accident prevention ratio: weight of avoided runs / weight of all.

    Parameters
    ----------
    verdict : Verdict
        Verdict on the party that is judged.
    axis : FrameAxis
        Runs and their weights.
    run_mask : (n_runs,) bool, optional
        Count these runs only.

    Returns
    -------
    apr : float
        0 .. 1; NaN if the runs counted have no weight.
    """
    if run_mask is None:
        weight = axis.weight
    else:
        weight = axis.weight * run_mask
    return weight_share(verdict.is_avoided, weight)


def headline_apr(evaluation: Evaluation) -> float:
    """APR that a layout is judged by, 0 .. 1.

    It is weighted by the share of the VUTs that see.
    """
    blind = apr(evaluation.rsu_all, evaluation.axis)
    return mix(blind, apr(evaluation.vut_and_rsus, evaluation.axis), evaluation.cars)


def mix(blind: float, seeing: float, cars: float) -> float:
    """Mean of the shares for VUTs that do not see and that do.

    `cars` is the share of the VUTs that see, 0 .. 1.
    """
    if cars == 0.0:
        return blind
    return cars * seeing + (1.0 - cars) * blind


def mean_impact_speed_kmh(
    verdict: Verdict, axis: FrameAxis, run_mask: BoolArray | None = None
) -> float:
    """Mean of the VUT's speed at contact over some runs by their weights, in km/h.

    Runs that are avoided count 0. NaN if the runs have no weight, or the verdict knows
    no speeds.
    """
    if run_mask is None:
        weight = axis.weight
    else:
        weight = axis.weight * run_mask
    if verdict.impact_speed_kmh is None or not weight.any():
        return math.nan
    return math.fsum(weight * verdict.impact_speed_kmh) / math.fsum(weight)


def apr_by_case(verdict: Verdict, axis: FrameAxis) -> dict[str, float]:
    """Accident prevention ratio of each case.

    Cases are in the order in which they first appear.
    """
    cases = np.array(axis.cases)
    return {
        case: apr(verdict, axis, cases == case) for case in dict.fromkeys(axis.cases)
    }


def apr_by_position(verdict: Verdict, axis: FrameAxis) -> dict[str, float]:
    """Accident prevention ratio of each position along the arms.

    Positions are in the order in which the VUT passes them.
    """
    positions = np.array(axis.positions)
    return {
        position: apr(verdict, axis, positions == position)
        for position in sort_positions(axis.positions)
    }


def earliest_arrival_s(
    parties: Sequence[tuple[BoolArray, float]], axis: FrameAxis
) -> FloatArray:
    """Time at which the VUT first knows of each frame's detection.

    Times are (n_frames,), in s; infinite where no party detects. Each party has the
    (n_frames,) frames that it detects in, and its latency [s].
    """
    arrival = np.full(axis.n_frames, np.inf)
    # The earliest message of any party counts.
    for detected, latency_s in parties:
        arrival = np.minimum(
            arrival, np.where(detected, axis.time_s + latency_s, np.inf)
        )
    return arrival


def leave_each_out(times_s: FloatArray) -> tuple[FloatArray, Iterator[FloatArray]]:
    """Column minima of an array, and those without each row in turn.

    `times_s` has a row for each party: (n, m), n at least 1 [s]. Without the only row
    all is infinite; without one that is nowhere alone the smallest, `earliest_s` itself
    is given.
    """
    earliest = times_s.min(axis=0)
    if len(times_s) == 1:
        return earliest, iter([np.full_like(earliest, np.inf)])
    # Without a row that alone has the minimum, the second smallest counts.
    second = np.partition(times_s, 1, axis=0)[1]
    alone = np.where(second > earliest, times_s.argmin(axis=0), -1)
    return earliest, (
        np.where(alone == row, second, earliest) if (alone == row).any() else earliest
        for row in range(len(times_s))
    )


def unit_arrivals_s(evaluation: Evaluation, rule: AebRule) -> FloatArray:
    """Times at which the VUT knows of each unit's detections.

    They are (n_units, n_frames), in s.
    """
    return np.stack(
        [
            earliest_arrival_s(
                [(evaluation.units[unit.id].detected, unit.latency(rule))],
                evaluation.axis,
            )
            for unit in evaluation.layout.units
        ]
    )


def apr_of_arrivals(
    evaluation: Evaluation, rule: AebRule, arrival_s: FloatArray
) -> float:
    """APR by what arrives from units, and from a VUT that sees.

    `arrival_s` has what arrives from units, (n_frames,), in s. A run counts as
    avoided where braking sets in before the last moment.
    """
    axis = evaluation.axis
    cars = evaluation.cars

    def share(arrival_s: FloatArray) -> float:
        return weight_share(
            find_onsets(arrival_s, axis, rule=rule).is_in_time, axis.weight
        )

    if cars == 0.0:
        return share(arrival_s)
    # A VUT that sees is one more party.
    own_s = earliest_arrival_s([(evaluation.vut.detected, rule.latency_s)], axis)
    seeing = share(np.minimum(arrival_s, own_s))
    if cars == 1.0:
        return seeing
    return mix(share(arrival_s), seeing, cars)


def apr_one_failed(evaluation: Evaluation, rule: AebRule) -> float:
    """APR when the unit whose loss costs most fails.

    For a layout of one unit it is what VUTs that see avoid by themselves.
    """
    left = leave_each_out(unit_arrivals_s(evaluation, rule))[1]
    return min(
        1.0, *(apr_of_arrivals(evaluation, rule, arrival_s) for arrival_s in left)
    )


def units_by_site(layout: Layout) -> dict[str, list[int]]:
    """Indices of the units at each site.

    A unit without a site is a site of its own, under its id.
    """
    sites: dict[str, list[int]] = {}
    for index, unit in enumerate(layout.units):
        sites.setdefault(unit.site_id or f"unit {unit.id}", []).append(index)
    return sites


def apr_one_site_failed(evaluation: Evaluation, rule: AebRule) -> float:
    """APR when the site whose loss costs most fails with all its units."""
    arrivals_s = unit_arrivals_s(evaluation, rule)
    left = (
        np.delete(arrivals_s, failed, axis=0).min(axis=0, initial=np.inf)
        for failed in units_by_site(evaluation.layout).values()
    )
    return min(
        1.0, *(apr_of_arrivals(evaluation, rule, arrival_s) for arrival_s in left)
    )


Outcome = Literal["avoided", "never seen", "never confirmed", "lost again", "too late"]
"""How a run ends.

"lost again": a track was confirmed, but not alive at the last moment, and none was
confirmed after it; "too late": braking set in, but the bodies touch all the same.
"""


def run_outcomes(verdict: Verdict, axis: FrameAxis) -> list[Outcome]:
    """How each run ends, in words."""
    return [run_outcome(verdict, axis, run) for run in range(axis.n_runs)]


def run_outcome(verdict: Verdict, axis: FrameAxis, run_index: int) -> Outcome:
    """How one run ends, in words."""
    if verdict.is_avoided[run_index]:
        return "avoided"
    if not verdict.detected[axis.frames_of(run_index)].any():
        return "never seen"
    if not np.isfinite(verdict.confirmation_time_s[run_index]):
        return "never confirmed"
    if np.isfinite(verdict.onset_time_s[run_index]):
        return "too late"
    return "lost again"


def detected_share(
    verdict: Verdict, axis: FrameAxis, run_mask: BoolArray | None = None
) -> float:
    """Share of the frames of some runs in which the VRU is detected, 0 .. 1."""
    n_frames = np.diff(axis.run_start)
    if run_mask is None:
        frames = np.ones(axis.n_frames, dtype=bool)
    else:
        frames = run_mask.repeat(n_frames)
    return float(verdict.detected[frames].mean())
