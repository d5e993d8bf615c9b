"""APR of layouts in sampled worlds, and what was drawn there, as results have it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from itertools import combinations
from typing import Annotated

import numpy as np

from geometry.errors import InputError, Unquoted
from placement.sampling.moving.trajectories import TrafficCount
from placement.sampling.out_of_sample import SampledApr, cvar, estimate_mean
from placement.sampling.uncertainty import MountingErrors, Uncertainty

from .record import Record, RunId, Share, says


class UncertaintyRecord(Record, frozen=True, kw_only=True):
    """Uncertainty as in the file of --uncertainty."""

    name: Annotated[str, says("Of the uncertainty.")]
    mounting: Annotated[MountingErrors, says("Errors of mounting.")]
    latency: Annotated[
        dict[str, str | float],
        says("Delay of messages, by the names of the file: a budget, or a distribution."),
    ]
    packet_loss: Annotated[Share, says("Share of the messages that get lost.")]
    draws_detections: Annotated[bool, says("Whether detections are drawn by their probability.")]
    traffic: Annotated[dict[str, float], says("Standing vehicles, by the names of the file.")]
    vehicles: Annotated[
        dict[str, dict[str, float]], says("Kinds of vehicles with their shares of those parked.")
    ]


class LeastSureRunRecord(Record, frozen=True, kw_only=True):
    """A run that is not avoided in all worlds."""

    run: Annotated[RunId, says("Which run.")]
    avoided_share: Annotated[Share, says("Of the worlds.")]


class EstimateRecord(Record, frozen=True, kw_only=True):
    """A mean that is estimated from sampled worlds."""

    mean: Annotated[float | None, says("Mean.")]
    standard_error: Annotated[float | None, says("Of the mean; null for a single world.")]
    low: Annotated[float | None, says("Lower end of the 95 % interval.")]
    high: Annotated[float | None, says("Upper end of the 95 % interval.")]
    method: Annotated[str, says("How the interval was found, in words.")]


class SampledLayoutRecord(EstimateRecord, frozen=True, kw_only=True):
    """A layout in these worlds: its APR."""

    name: Annotated[str, says("Of the layout.")]
    units: Annotated[int, says("Number of its units.", ge=0)]
    planned: Annotated[Share | None, says("APR with nothing uncertain.")]
    in_sample: Annotated[
        float | None,
        says("First stage in the worlds that it was chosen in; null: not chosen in worlds."),
    ]
    cvar: Annotated[float | None, says("Mean APR of the worst worlds.")]
    worst: Annotated[float | None, says("APR in the very worst one.")]
    apr_by_sample: Annotated[tuple[float | None, ...], says("APR in each world.")]
    least_sure_runs: Annotated[tuple[LeastSureRunRecord, ...], says("The least sure first.")]


class SampledPairRecord(EstimateRecord, frozen=True, kw_only=True):
    """Any two layouts: the first one's APR less the second one's, world by world."""

    first: Annotated[str, says("Name of the one layout.")]
    second: Annotated[str, says("Name of the other one.")]
    more_share: Annotated[Share, says("Worlds in which the first one avoids more.")]
    equal_share: Annotated[Share, says("Worlds in which they avoid as much.")]
    less_share: Annotated[Share, says("Worlds in which the first one avoids less.")]


class SampledRecord(Record, frozen=True, kw_only=True):
    """APR in sampled worlds, the same fresh ones for all layouts."""

    uncertainty: Annotated[UncertaintyRecord, says("What was drawn.")]
    samples: Annotated[int, says("Number of worlds.", ge=1)]
    chosen_in: Annotated[
        int | None,
        says("Number of other worlds that the first layout was chosen in; null: chosen without."),
    ] = None
    seed: Annotated[int, says("Of the draws.", ge=0)]
    traffic_source: Annotated[
        str, says("Vehicles that drive by: SUMO with its demand, or the name of a file; or empty.")
    ] = ""
    moving: Annotated[TrafficCount | None, says("Vehicles that drove by; null: none do.")] = None
    tail: Annotated[Share, says("Worst share of the worlds that cvar is about.")]
    layouts: Annotated[tuple[SampledLayoutRecord, ...], says("The first one is the subject.")]
    pairs: Annotated[
        tuple[SampledPairRecord, ...],
        says("One for any two layouts, those of the first layout before the others."),
    ]

    @property
    def gains(self) -> tuple[SampledPairRecord, ...]:
        """Pairs of the subject and each other layout."""
        return self.pairs[: len(self.layouts) - 1]


_MAX_LEAST_SURE_RUNS = 5
_SAME_APR = 1.0e-9  # shares of summed weights carry rounding noise


def build_sampled_record(
    judged: Sequence[SampledApr],
    uncertainty: Uncertainty,
    *,
    tail: float,
    seed: int,
    planned_apr: Mapping[str, float] | None = None,
    chosen_apr: Mapping[str, float] | None = None,
    chosen_in: int | None = None,
) -> SampledRecord:
    """Layouts in the same sampled worlds: the first one is the subject, the others baselines.

    Parameters
    ----------
    judged : sequence of SampledApr
        By :func:`placement.sampling.out_of_sample_layouts`: at least one, all in the same worlds.
    uncertainty : Uncertainty
        What was drawn.
    tail : float
        The worst share of the worlds that is summed up, 0 .. 1.
    seed : int
        Of the draws.
    planned_apr, chosen_apr : mapping of str to float, optional
        By name of the layout: APR as planned, with nothing uncertain, and in the worlds that it
        was chosen in.
    chosen_in : int, optional
        How many worlds those were.

    Raises
    ------
    InputError
        There is no layout, or they were judged in different numbers of worlds.
    """
    if not judged:
        raise InputError("layouts", Unquoted("none"), "at least one")
    n_samples = {len(item.apr_by_sample) for item in judged}
    if len(n_samples) > 1:
        raise InputError("samples", sorted(n_samples), "the same number for every layout")
    subject = judged[0]
    planned, chosen = planned_apr or {}, chosen_apr or {}
    return SampledRecord(
        uncertainty=build_uncertainty_record(uncertainty),
        samples=n_samples.pop(),
        chosen_in=chosen_in,
        seed=seed,
        traffic_source="" if uncertainty.moving is None else uncertainty.moving.name,
        moving=None if uncertainty.moving is None else subject.driving,
        tail=tail,
        layouts=tuple(
            SampledLayoutRecord(
                name=item.layout.name,
                units=len(item.layout.units),
                planned=planned.get(item.layout.name),
                in_sample=chosen.get(item.layout.name),
                **asdict(item.estimate),
                cvar=cvar(item.apr_by_sample, tail),
                worst=item.worst,
                apr_by_sample=tuple(item.apr_by_sample.tolist()),
                least_sure_runs=_least_sure(item),
            )
            for item in judged
        ),
        pairs=tuple(_pair(first, second) for first, second in combinations(judged, 2)),
    )


def build_uncertainty_record(uncertainty: Uncertainty) -> UncertaintyRecord:
    """An uncertainty with the names of its TOML file."""
    latency, traffic = uncertainty.latency, uncertainty.traffic
    drawn: dict[str, str | float] = {"drawn_per": latency.drawn_per}
    if latency.budget is not None:
        drawn["budget"] = latency.budget.name
    else:
        names = ("distribution", "mean_s", "sd_s")
        drawn |= {name: getattr(latency, name) for name in names}
    return UncertaintyRecord(
        name=uncertainty.name,
        mounting=uncertainty.mounting,
        latency=drawn,
        packet_loss=uncertainty.packet_loss,
        draws_detections=uncertainty.draws_detections,
        traffic={
            field.name: getattr(traffic, field.name)
            for field in fields(traffic)
            if field.name != "vehicles"
        },
        vehicles={
            kind.actor.name: {
                "parked_share": kind.parked_share,
                "waiting_share": kind.waiting_share,
            }
            for kind in traffic.vehicles
        },
    )


def _pair(first: SampledApr, second: SampledApr) -> SampledPairRecord:
    """Two layouts in the same worlds: the difference, and who avoids more how often."""
    gain = first.apr_by_sample - second.apr_by_sample
    return SampledPairRecord(
        first=first.layout.name,
        second=second.layout.name,
        **asdict(estimate_mean(gain, bounds=(-1.0, 1.0))),
        more_share=float((gain > _SAME_APR).mean()),
        equal_share=float((np.abs(gain) <= _SAME_APR).mean()),
        less_share=float((gain < -_SAME_APR).mean()),
    )


def _least_sure(item: SampledApr) -> tuple[LeastSureRunRecord, ...]:
    """Runs that are avoided in the fewest worlds, if not in all; those that count."""
    share = item.avoided_share
    order = np.argsort(share, kind="stable")
    order = order[(share[order] < 1.0) & (item.axis.weight[order] > 0.0)]
    return tuple(
        LeastSureRunRecord(run=item.axis.run_ids[index], avoided_share=float(share[index]))
        for index in order[:_MAX_LEAST_SURE_RUNS].tolist()
    )
