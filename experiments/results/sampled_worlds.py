"""The part of a result about sampled worlds: what was drawn, and what layouts are worth there."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import combinations
from typing import Annotated, ClassVar, Literal, cast

import numpy as np
from msgspec import UNSET, UnsetType

from geometry.errors import InputError, Unquoted
from placement.sampling.moving import TrafficCount
from placement.sampling.out_of_sample import SampledApr, cvar, estimate_mean
from placement.sampling.uncertainty import Uncertainty

from .record import Record, RunId, Share, says


class UncertaintyMountingRecord(Record, frozen=True, kw_only=True):
    """How units are off."""

    yaw_sd_deg: Annotated[float, says("Standard deviation of the yaw, in degrees.", ge=0)]
    pitch_sd_deg: Annotated[float, says("Of the pitch, in degrees.", ge=0)]
    height_sd_m: Annotated[float, says("Of the height, in metres.", ge=0)]


class UncertaintyLatencyRecord(Record, frozen=True, kw_only=True):
    """How late messages come; either a budget or a distribution."""

    schema_rules: ClassVar[dict[str, object]] = {
        "oneOf": [{"required": ["budget"]}, {"required": ["distribution", "mean_s", "sd_s"]}]
    }
    budget: Annotated[str, says("Name of a latency budget.")] | UnsetType = UNSET
    distribution: (
        Annotated[Literal["gamma", "uniform"], says("Kind of distribution.")] | UnsetType
    ) = UNSET
    mean_s: Annotated[float, says("Its mean, in seconds.", ge=0)] | UnsetType = UNSET
    sd_s: Annotated[float, says("Its standard deviation, in seconds.", ge=0)] | UnsetType = UNSET
    drawn_per: Annotated[
        Literal["run", "sample"], says("How often it is drawn: for each run, or for each world.")
    ]


class UncertaintyMessagesRecord(Record, frozen=True, kw_only=True):
    """What gets lost."""

    packet_loss: Annotated[Share, says("Share of the messages.")]


class UncertaintyDetectorRecord(Record, frozen=True, kw_only=True):
    """What the detector does."""

    is_drawn: Annotated[bool, says("Whether detections are drawn by their probability.")]


class UncertaintyTrafficRecord(Record, frozen=True, kw_only=True):
    """What stands in the streets."""

    taken_share: Annotated[Share, says("Of the parking places.")]
    waiting_share: Annotated[Share, says("Of the lanes with a vehicle that waits.")]
    following_share: Annotated[Share, says("Of those with a further one behind it.")]
    free_place_m: Annotated[float, says("Length of a parking place, in metres.")]
    parked_gap_m: Annotated[float, says("Gap between parked vehicles, in metres.")]
    clear_of_mouth_m: Annotated[
        float, says("No parking from the mouth of the junction, in metres.")
    ]
    waiting_gap_m: Annotated[float, says("Gap between waiting vehicles, in metres.")]
    crosswalk_gap_m: Annotated[float, says("From a crosswalk to who waits at it, in metres.")]
    along_arm_m: Annotated[float, says("How far along an arm vehicles stand, in metres.")]
    clearance_m: Annotated[
        float, says("Nobody stands nearer to the way of vehicle or road user, in metres.")
    ]


class UncertaintyVehicleRecord(Record, frozen=True, kw_only=True):
    """A kind of vehicle."""

    name: Annotated[str, says("Of the actor.")]
    parked_share: Annotated[Share, says("Among parked ones.")]
    waiting_share: Annotated[Share, says("Among waiting ones.")]


class UncertaintyRecord(Record, frozen=True, kw_only=True):
    """What was drawn, as in --uncertainty."""

    name: Annotated[str, says("Of the uncertainty.")]
    mounting: Annotated[UncertaintyMountingRecord, says("How units are off.")]
    latency: Annotated[
        UncertaintyLatencyRecord, says("How late messages come; either a budget or a distribution.")
    ]
    messages: Annotated[UncertaintyMessagesRecord, says("What gets lost.")]
    detector: Annotated[UncertaintyDetectorRecord, says("What the detector does.")]
    traffic: Annotated[UncertaintyTrafficRecord, says("What stands in the streets.")]
    vehicles: Annotated[tuple[UncertaintyVehicleRecord, ...], says("The mix.")]


class UncertaintyMovingRecord(Record, frozen=True, kw_only=True):
    """What drives by."""

    source: Annotated[str, says("SUMO with its demand, or the name of a file.")]
    runs: Annotated[int, says("In all worlds together.", ge=0)]
    vehicles: Annotated[int, says("Near the junction in these runs, all added up.", ge=0)]
    left_out: Annotated[
        int, says("Of these: they would have come into the way of vehicle or road user.", ge=0)
    ]
    departed: Annotated[int, says("Vehicles that SUMO let in, in all worlds.", ge=0)]
    without_room: Annotated[int, says("Vehicles that SUMO found no room for.", ge=0)]


class LeastSureRunRecord(Record, frozen=True, kw_only=True):
    """A run that is not avoided in all worlds."""

    run: Annotated[RunId, says("Which run.")]
    avoided_share: Annotated[Share, says("Of the worlds.")]


class SampledLayoutRecord(Record, frozen=True, kw_only=True):
    """A layout in these worlds."""

    name: Annotated[str, says("Of the layout.")]
    units: Annotated[int, says("Number of its units.", ge=0)] | UnsetType = UNSET
    planned: Annotated[Share | None, says("APR with nothing uncertain.")]
    in_sample: Annotated[
        float | None,
        says("First stage in the worlds that it was chosen in; null: not chosen in worlds."),
    ]
    mean: Annotated[float | None, says("Mean.")]
    standard_error: Annotated[float | None, says("Of the mean; null for a single world.")]
    low: Annotated[float | None, says("Lower end of the 95 % interval.")]
    high: Annotated[float | None, says("Upper end of the 95 % interval.")]
    method: Annotated[str, says("How the interval was found, in words.")]
    cvar: Annotated[float | None, says("Mean APR of the worst worlds.")]
    worst: Annotated[float | None, says("APR in the very worst one.")]
    apr_by_sample: Annotated[tuple[float | None, ...], says("APR in each world.")]
    least_sure_runs: Annotated[tuple[LeastSureRunRecord, ...], says("The least sure first.")]


class SampledGainRecord(Record, frozen=True, kw_only=True):
    """The subject's APR less another one's, world by world."""

    over: Annotated[str, says("Name of the other layout.")]
    mean: Annotated[float | None, says("Mean.")]
    standard_error: Annotated[float | None, says("Of the mean; null for a single world.")]
    low: Annotated[float | None, says("Lower end of the 95 % interval.")]
    high: Annotated[float | None, says("Upper end of the 95 % interval.")]
    method: Annotated[str, says("How the interval was found, in words.")]


class SampledPairRecord(Record, frozen=True, kw_only=True):
    """Any two layouts: the first one's APR less the second one's, world by world."""

    first: Annotated[str, says("Name of the one layout.")]
    second: Annotated[str, says("Name of the other one.")]
    mean: Annotated[float | None, says("Mean.")]
    standard_error: Annotated[float | None, says("Of the mean; null for a single world.")]
    low: Annotated[float | None, says("Lower end of the 95 % interval.")]
    high: Annotated[float | None, says("Upper end of the 95 % interval.")]
    method: Annotated[str, says("How the interval was found, in words.")]
    more_share: Annotated[Share, says("Worlds in which the first one avoids more.")]
    equal_share: Annotated[Share, says("Worlds in which they avoid as much.")]
    less_share: Annotated[Share, says("Worlds in which the first one avoids less.")]


class SampledRecord(Record, frozen=True, kw_only=True):
    """APR in sampled worlds, the same fresh ones for all layouts."""

    uncertainty: Annotated[UncertaintyRecord, says("What was drawn.")]
    samples: Annotated[int, says("Number of worlds.", ge=1)]
    chosen_in: (
        Annotated[int, says("Number of other worlds that the first layout was chosen in.", ge=1)]
        | UnsetType
    ) = UNSET
    seed: Annotated[int, says("Of the draws.", ge=0)]
    moving: Annotated[UncertaintyMovingRecord, says("What drives by.")] | UnsetType = UNSET
    tail: Annotated[Share, says("Worst share of the worlds that cvar is about.")]
    layouts: Annotated[tuple[SampledLayoutRecord, ...], says("The first one is the subject.")]
    gains: Annotated[tuple[SampledGainRecord, ...], says("One for each other layout.")]
    pairs: Annotated[tuple[SampledPairRecord, ...], says("One for any two layouts.")]


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
    subject, *others = judged
    planned, chosen = planned_apr or {}, chosen_apr or {}
    return SampledRecord(
        uncertainty=build_uncertainty_record(uncertainty),
        samples=n_samples.pop(),
        chosen_in=UNSET if chosen_in is None else chosen_in,
        seed=seed,
        moving=_moving_record(uncertainty, subject.driving),
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
        gains=tuple(
            SampledGainRecord(
                over=other.layout.name,
                **asdict(
                    estimate_mean(subject.apr_by_sample - other.apr_by_sample, bounds=(-1.0, 1.0))
                ),
            )
            for other in others
        ),
        pairs=tuple(_pair(first, second) for first, second in combinations(judged, 2)),
    )


def build_uncertainty_record(uncertainty: Uncertainty) -> UncertaintyRecord:
    """An uncertainty, with the names of its TOML file."""
    latency, traffic = uncertainty.latency, uncertainty.traffic
    drawn_per = cast(Literal["run", "sample"], latency.drawn_per)
    if latency.budget is not None:
        latency_record = UncertaintyLatencyRecord(budget=latency.budget.name, drawn_per=drawn_per)
    else:
        latency_record = UncertaintyLatencyRecord(
            distribution=cast(Literal["gamma", "uniform"], latency.distribution),
            mean_s=latency.mean_s,
            sd_s=latency.sd_s,
            drawn_per=drawn_per,
        )
    return UncertaintyRecord(
        name=uncertainty.name,
        mounting=UncertaintyMountingRecord(**asdict(uncertainty.mounting)),
        latency=latency_record,
        messages=UncertaintyMessagesRecord(packet_loss=uncertainty.packet_loss),
        detector=UncertaintyDetectorRecord(is_drawn=uncertainty.draws_detections),
        traffic=UncertaintyTrafficRecord(
            **{name: getattr(traffic, name) for name in UncertaintyTrafficRecord.__struct_fields__}
        ),
        vehicles=tuple(
            UncertaintyVehicleRecord(
                name=kind.actor.name,
                parked_share=kind.parked_share,
                waiting_share=kind.waiting_share,
            )
            for kind in traffic.vehicles
        ),
    )


def _moving_record(
    uncertainty: Uncertainty, driving: TrafficCount
) -> UncertaintyMovingRecord | UnsetType:
    if uncertainty.moving is None:
        return UNSET
    return UncertaintyMovingRecord(
        source=uncertainty.moving.name,
        runs=driving.n_runs,
        vehicles=driving.n_vehicles,
        left_out=driving.n_left_out,
        departed=driving.n_departed,
        without_room=driving.n_waiting,
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
