"""APR of layouts in sampled worlds: in sentences, as a table, drawn."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple, fields, replace
from itertools import combinations
from typing import Annotated, Any

import numpy as np

from geometry.arrays import FloatArray
from placement.growth import Growth
from placement.pipeline import FOUND
from placement.question import N_JUDGED
from placement.sampling.driving import TrafficCount
from placement.sampling.out_of_sample import (
    SampledApr,
    cvar,
    estimate_mean,
    resampled_cvar,
)
from placement.sampling.uncertainty import (
    Blinding,
    MountingErrors,
    Outages,
    RoadUsers,
    Uncertainty,
)

from ..language import localized, mark, tr, trn
from ..results.numbers import or_nan, percent, shortened
from ..results.record import Record, RunId, Share, says
from .section import Section, Table, tabulate

_MAX_LEAST_SURE_RUNS = 5
# worlds that a tail must have: with fewer, choosing for the mean has better tails
_LEAST_WORST = 8
# Shares of summed weights carry rounding noise.
_SAME_APR = 1.0e-9
_AS_THEY_ARE = (
    *(
        "packet_loss",
        "burst_frames",
        "loss_shared_by",
        "outages",
        "blinding",
        "v2x_share",
    ),
    *(
        "most_draws",
        "draws_detections",
        "person_share",
        "unit_person_share",
        "road_users",
    ),
)
_MAX_NAME_LENGTH = 32


class UncertaintyRecord(Record, frozen=True, kw_only=True):
    """Uncertainty as in the file of --uncertainty."""

    name: Annotated[str, says("Of the uncertainty.")]
    mounting: Annotated[MountingErrors, says("Errors of mounting.")]
    latency: Annotated[
        dict[str, str | float], says("Delay of messages: budget or distribution.")
    ]
    packet_loss: Annotated[Share, says("Share of the messages that get lost.")]
    draws_detections: Annotated[
        bool, says("Whether detections are drawn by their probability.")
    ]
    traffic: Annotated[
        dict[str, float], says("Standing vehicles, by the names of the file.")
    ]
    vehicles: Annotated[
        dict[str, dict[str, float]], says("Kinds of vehicles, with shares.")
    ]
    road_users: Annotated[RoadUsers, says("How they move otherwise than in cases.")] = (
        RoadUsers()
    )
    person_share: Annotated[
        Share,
        says(
            "Of the noise of detections, what a person has in all frames for all units."
        ),
    ] = 0.0
    unit_person_share: Annotated[Share, says("The same for one unit.")] = 0.0
    burst_frames: Annotated[
        float, says("Frames between draws of which messages get lost.")
    ] = 1.0
    loss_shared_by: Annotated[
        str, says("Who loses the same messages: unit or pole.")
    ] = "unit"
    outages: Annotated[Outages, says("Units out of order.")] = Outages()
    blinding: Annotated[Blinding, says("Cameras that see nothing.")] = Blinding()
    v2x_share: Annotated[Share, says("Of all cars, those that hear the units.")] = 1.0
    most_draws: Annotated[
        int, says("Draws of a run of great weight in a world, at most.")
    ] = 1


class LeastSureRunRecord(Record, frozen=True, kw_only=True):
    """A run that is not avoided in all worlds."""

    run: Annotated[RunId, says("Which run.")]
    avoided_share: Annotated[Share, says("Of the worlds.")]


class EstimateRecord(Record, frozen=True, kw_only=True):
    """A mean that is estimated from sampled worlds."""

    mean: Annotated[float | None, says("Mean.")]
    standard_error: Annotated[
        float | None, says("Of the mean; null for a single world.")
    ]
    low: Annotated[float | None, says("Lower end of the 95 % interval.")]
    high: Annotated[float | None, says("Upper end of the 95 % interval.")]
    method: Annotated[str, says("How the interval was found, in words.")]


class SampledLayoutRecord(EstimateRecord, frozen=True, kw_only=True):
    """A layout in these worlds: its APR."""

    name: Annotated[str, says("Of the layout.")]
    units: Annotated[int, says("Number of its units.", ge=0)]
    planned: Annotated[Share | None, says("APR with nothing uncertain.")]
    in_sample: Annotated[
        float | None, says("Mean APR in the worlds it was chosen in; or null.")
    ]
    cvar: Annotated[float | None, says("Mean APR of the worst worlds.")]
    cvar_error: Annotated[
        float | None, says("Standard error of it; null: all count.")
    ] = None
    worst: Annotated[float | None, says("APR in the very worst one.")]
    of_all: Annotated[
        Share | None, says("Mean APR over cars with and without V2X; or null.")
    ]
    apr_by_sample: Annotated[tuple[float | None, ...], says("APR in each world.")]
    least_sure_runs: Annotated[
        tuple[LeastSureRunRecord, ...], says("The least sure first.")
    ]


class SampledPairRecord(EstimateRecord, frozen=True, kw_only=True):
    """Differences of APR of any two layouts, world by world.

    The first one's less the second one's.
    """

    first: Annotated[str, says("Name of the one layout.")]
    second: Annotated[str, says("Name of the other one.")]
    more_share: Annotated[Share, says("Worlds in which the first one avoids more.")]
    equal_share: Annotated[Share, says("Worlds in which they avoid as much.")]
    less_share: Annotated[Share, says("Worlds in which the first one avoids less.")]
    cvar_low: Annotated[
        float | None, says("Low end for the difference of cvar; or null.")
    ] = None
    cvar_high: Annotated[float | None, says("Upper end of it.")] = None


class SampledRecord(Record, frozen=True, kw_only=True):
    """APR in sampled worlds, the same fresh ones for all layouts."""

    uncertainty: Annotated[UncertaintyRecord, says("What was drawn.")]
    samples: Annotated[int, says("Number of worlds.", ge=1)]
    chosen_in: Annotated[
        int | None, says("Other worlds, to choose the first layout in.")
    ] = None
    growth: Annotated[Growth | None, says("How many are enough; null: not asked.")] = (
        None
    )
    seed: Annotated[int, says("Of the draws.", ge=0)]
    traffic_source: Annotated[
        str, says("Who drives by: SUMO with its demand; or empty.")
    ] = ""
    moving: Annotated[
        TrafficCount | None, says("Vehicles that drove by; null: none do.")
    ] = None
    tail: Annotated[Share, says("Worst share of the worlds that cvar is about.")]
    layouts: Annotated[
        tuple[SampledLayoutRecord, ...], says("The first one is the subject.")
    ]
    pairs: Annotated[
        tuple[SampledPairRecord, ...], says("Any two, the first layout's first.")
    ]

    @property
    def gains(self) -> tuple[SampledPairRecord, ...]:
        """Pairs of the subject and each other layout."""
        return self.pairs[: len(self.layouts) - 1]


def build_sampled_record(
    judged: Sequence[SampledApr],
    uncertainty: Uncertainty,
    *,
    tail: float,
    seed: int,
    planned_apr: Mapping[str, float] | None = None,
    chosen_apr: Mapping[str, float] | None = None,
    chosen_in: int | None = None,
    growth: Growth | None = None,
) -> SampledRecord:
    """Layouts in the same sampled worlds.

    The first one is the subject, the others baselines.

    `tail` is the worst share of the worlds that is summed up. By name of the layout,
    `planned_apr` is the APR with nothing uncertain, and `chosen_apr` that in the
    `chosen_in` worlds that it was chosen in; `growth` says how their number was found
    out.
    """
    subject = judged[0]
    tails = None
    if tail < 1.0:
        tails = resampled_cvar([item.apr_by_sample for item in judged], tail, seed=seed)
    planned = planned_apr or {}
    chosen = chosen_apr or {}
    heard = uncertainty.v2x_share
    return SampledRecord(
        uncertainty=build_uncertainty_record(uncertainty),
        samples=len(subject.apr_by_sample),
        chosen_in=chosen_in,
        growth=growth,
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
                cvar_error=None if tails is None else float(tails[row].std(ddof=1)),
                worst=item.worst,
                # Cars that hear nothing have what the VUT does alone.
                of_all=(
                    None
                    if heard == 1.0
                    else heard * item.estimate.mean + (1.0 - heard) * item.alone
                ),
                apr_by_sample=tuple(item.apr_by_sample.tolist()),
                least_sure_runs=_least_sure(item),
            )
            for row, item in enumerate(judged)
        ),
        pairs=tuple(
            build_pair_record(
                judged[one],
                judged[other],
                None if tails is None else tails[one] - tails[other],
            )
            for one, other in combinations(range(len(judged)), 2)
        ),
    )


def growth_sentences(growth: Growth | None) -> list[str]:
    """Sentence on how many worlds a layout was chosen in, and why not in more.

    No full stop.
    """
    if growth is None:
        return []
    last = growth.rounds[-1]
    return [
        tr(
            _WHY_NO_MORE_WORLDS[growth.stopped],
            taken=growth.taken,
            tried=last.worlds,
            others=growth.compared_in,
            low=_points(last.low),
            high=_points(last.high),
        )
    ]


_WHY_NO_MORE_WORLDS = {
    "same": mark(
        "Choosing in {taken} worlds is enough (--samples {taken}): {tried} worlds"
        " give the same layout"
    ),
    "no better": mark(
        "Choosing in {taken} worlds is enough (--samples {taken}): in {others} fresh"
        " worlds, the layout from {tried} worlds prevents {low:+.2f} to {high:+.2f}"
        " points more (95 %)"
    ),
    "time": mark(
        "The layout was chosen in {taken} worlds (--samples {taken}); there was no"
        " time for more. A longer --time-limit tries more worlds"
    ),
    "memory": mark(
        "The layout was chosen in {taken} worlds (--samples {taken}): "
        "twice as many do not fit into the memory of this machine"
    ),
    "most": mark(
        "The layout was chosen in {taken} worlds (--samples {taken}) and was still"
        " improving; no more worlds are tried"
    ),
}
"""By what ended the search for the number of worlds."""


def build_uncertainty_record(uncertainty: Uncertainty) -> UncertaintyRecord:
    """An uncertainty with the names of its TOML file."""
    latency = uncertainty.latency
    traffic = uncertainty.traffic
    drawn: dict[str, str | float] = {"drawn_per": latency.drawn_per}
    if latency.budget is not None:
        drawn["budget"] = latency.budget.name
    else:
        names = ("distribution", "mean_s", "sd_s")
        drawn |= {name: getattr(latency, name) for name in names}
    buses: dict[str, float] = {}
    if traffic.bus_lane_share:
        buses = {"bus_lane_share": traffic.bus_lane_share}
    return UncertaintyRecord(
        name=uncertainty.name,
        mounting=uncertainty.mounting,
        latency=drawn,
        **{name: getattr(uncertainty, name) for name in _AS_THEY_ARE},
        traffic={
            one.name: getattr(traffic, one.name)
            for one in fields(traffic)
            if one.name not in ("vehicles", "bus_lane_share")
        }
        | buses,
        vehicles={
            one.actor.name: {
                name: getattr(one, name) for name in ("parked_share", "waiting_share")
            }
            for one in traffic.vehicles
        },
    )


def build_pair_record(
    first: SampledApr, second: SampledApr, tails: FloatArray | None = None
) -> SampledPairRecord:
    """Two layouts in the same worlds.

    `tails` are differences of cvar in resampled worlds.
    """
    gain = first.apr_by_sample - second.apr_by_sample
    if tails is None:
        low, high = (None, None)
    else:
        low, high = np.quantile(tails, (0.025, 0.975)).tolist()
    return SampledPairRecord(
        first=first.layout.name,
        second=second.layout.name,
        **asdict(estimate_mean(gain, bounds=(-1.0, 1.0))),
        more_share=float((gain > _SAME_APR).mean()),
        equal_share=float((np.abs(gain) <= _SAME_APR).mean()),
        less_share=float((gain < -_SAME_APR).mean()),
        cvar_low=low,
        cvar_high=high,
    )


def _least_sure(item: SampledApr) -> tuple[LeastSureRunRecord, ...]:
    """Runs that are avoided in the fewest worlds, if not in all.

    Those that count.
    """
    share = item.avoided_share
    order = np.argsort(share, kind="stable")
    order = order[(share[order] < 1.0) & (item.axis.weight[order] > 0.0)]
    return tuple(
        LeastSureRunRecord(
            run=item.axis.run_ids[index], avoided_share=float(share[index])
        )
        for index in order[:_MAX_LEAST_SURE_RUNS].tolist()
    )


def uncertainty_sentences(found: SampledRecord) -> list[str]:
    """Sentences on layouts in sampled worlds; the first layout is the subject."""
    subject = found.layouts[0]
    chosen = found.layouts[0].in_sample
    n_worst = found.tail * (found.chosen_in or 0)
    n_all = found.chosen_in
    shares = {
        "mean": subject.mean,
        "low": subject.low,
        "high": subject.high,
        "chosen": chosen,
    }
    shares |= {"planned": subject.planned, "of_all": subject.of_all, "tail": found.tail}
    values: dict[str, Any] = {name: percent(share) for name, share in shares.items()}
    values |= {"drawn": what_is_uncertain(found), "layout": subject.name}
    values |= {
        "method": tr(subject.method),
        "v2x": percent(found.uncertainty.v2x_share),
    }
    sentences = [
        trn(
            "In {n} fresh sampled world ({drawn}), {layout} avoids {mean} of "
            "the accidents on average ({method}: {low} to {high})",
            "In {n} fresh sampled worlds ({drawn}), {layout} avoids {mean} of "
            "the accidents on average ({method}: {low} to {high})",
            found.samples,
            **values,
        )
    ]
    if subject.planned is not None:
        sentences[0] += tr("; as planned {planned}", **values)
    sentences += growth_sentences(found.growth)
    if subject.of_all is not None:
        sentences.append(
            tr(
                "With V2X in {v2x} of the cars, these are {of_all} of the accidents of"
                " all cars",
                **values,
            )
        )
    if chosen is not None:
        if chosen > or_nan(subject.mean):
            sentences.append(
                tr(
                    "In the worlds used to choose it, it avoids {chosen}; a layout "
                    "looks better in those worlds than in others",
                    **values,
                )
            )
        else:
            sentences.append(
                tr("In the worlds used to choose it, it avoids {chosen}", **values)
            )
    if found.tail < 1.0 and 0.0 < n_worst < _LEAST_WORST:
        values |= {"n_all": n_all, "n": max(n_worst, 1.0)}
        sentences.append(
            trn(
                "The worst {tail} of the {n_all} worlds used to choose it is {n:g} "
                "world, too few to choose by: raise --samples, or optimise the mean",
                "The worst {tail} of the {n_all} worlds used to choose it are {n:g} "
                "worlds, too few to choose by: raise --samples, or optimise the mean",
                1 if n_worst <= 1.0 else 2,
                **values,
            )
        )
    if found.moving:
        sentences.append(moving_sentence(found))
    unsure = subject.least_sure_runs
    if unsure:
        listed = ", ".join(
            f"{run.run} ({percent(run.avoided_share)})" for run in unsure
        )
        least = mark(
            "Least certain runs, with the share of worlds that avoid them: {runs}"
        )
        sentences.append(tr(least, runs=listed))
    return [f"{sentence}." for sentence in sentences]


def preferred_sentences(
    preferred: SampledPairRecord | None, chosen_in: int | None
) -> list[str]:
    """Sentence on greedy choice's layout where fresh worlds took it."""
    if preferred is None or preferred.second != FOUND:
        return []
    points, low, high = map(_points, (preferred.mean, preferred.low, preferred.high))
    values = {"n": N_JUDGED, "points": points, "low": low, "high": high}
    if chosen_in is None:
        return [
            tr(
                "The answer is the greedy layout. The plan ignores chance, but in"
                " {n} sampled worlds the greedy layout prevents {points:.2f} points"
                " more (95 %: {low:.2f} to {high:.2f}) than the optimised one.",
                **values,
            )
        ]
    return [
        tr(
            "The answer is the greedy layout. The optimised layout is better in the"
            " {chosen} worlds used for choosing, but in {n} fresh worlds the greedy"
            " layout prevents {points:.2f} points more (95 %: {low:.2f} to"
            " {high:.2f}).",
            chosen=chosen_in,
            **values,
        )
    ]


def overtaken_sentences(found: SampledRecord) -> list[str]:
    """Sentence on a layout that fresh worlds surely prefer, if any.

    It has no more units than the one found.
    """
    subject, *others = found.layouts
    # What was asked for.
    of_tail = found.tail < 1.0
    ahead = [
        (or_nan(gain.mean), gain, other)
        for gain, other in zip(found.gains, others, strict=True)
        if or_nan(gain.cvar_high if of_tail else gain.high) < -_SAME_APR
        and other.units <= subject.units
    ]
    if not ahead or found.chosen_in is None:
        return []
    _, gain, other = min(ahead, key=lambda entry: entry[0])
    points, low, high = (
        -100.0 * or_nan(share) for share in (gain.mean, gain.high, gain.low)
    )
    values: dict[str, Any] = {
        "points": points,
        "low": low,
        "high": high,
        "other": other.name,
    }
    values |= {
        "tail": percent(found.tail),
        "apr": percent(other.cvar),
        "layout": subject.name,
    }
    better = trn(
        "{other} does better in {n} fresh world: {points:.1f} points of "
        "APR more than {layout} (95 % interval {low:.1f} to {high:.1f})",
        "{other} does better in {n} fresh worlds: {points:.1f} points of "
        "APR more than {layout} (95 % interval {low:.1f} to {high:.1f})",
        found.samples,
        **values,
    )
    worst = mark("in the worst {tail} of them, {apr} instead of {layout_apr}")
    worst = tr(worst, layout_apr=percent(subject.cvar), **values)
    few = trn(
        "the {n} world used to choose {layout} is too few: raise --samples, or "
        "use {other}.",
        "the {n} worlds used to choose {layout} are too few: raise --samples, or "
        "use {other}.",
        found.chosen_in,
        **values,
    )
    return ["; ".join([better, *[worst] * of_tail, few])]


def what_is_uncertain(found: SampledRecord) -> str:
    """Words for what is drawn in the sampled worlds."""
    record = found.uncertainty
    mounting = record.mounting
    latency = record.latency
    traffic = record.traffic
    outages = record.outages
    blinding = record.blinding
    is_lost = record.packet_loss > 0.0
    drawn = []
    if any(astuple(mounting)):
        drawn.append(
            tr(
                "units off by {yaw:g}° in yaw, {pitch:g}° in pitch and {height_cm:g} cm"
                " in height",
                yaw=mounting.yaw_sd_deg,
                pitch=mounting.pitch_sd_deg,
                height_cm=100.0 * mounting.height_sd_m,
            )
        )
    if "budget" in latency:
        drawn.append(
            tr("latency drawn from the budget {budget}", budget=latency["budget"])
        )
    mean_ms = 1000.0 * float(latency.get("mean_s", 0.0))
    if mean_ms:
        drawn.append(tr("messages {mean_ms:g} ms later on average", mean_ms=mean_ms))
    lost = percent(record.packet_loss)
    has_bursts = record.burst_frames > 1.0
    if is_lost and has_bursts:
        drawn.append(
            tr(
                "{lost} of the messages lost in bursts (drawn anew after {n_frames:g}"
                " frames)",
                lost=lost,
                n_frames=record.burst_frames,
            )
        )
    elif is_lost:
        drawn.append(tr("{lost} of the messages lost", lost=lost))
    lasting = record.person_share + record.unit_person_share
    if record.draws_detections and lasting:
        drawn.append(
            tr(
                "detections drawn where the detector gives a probability "
                "({lasting} of the noise for a whole run)",
                lasting=percent(lasting),
            )
        )
    elif record.draws_detections:
        drawn.append(tr("detections drawn where the detector gives a probability"))
    if outages != Outages():
        units = percent(outages.unit_share)
        poles = percent(outages.pole_share)
        drawn.append(
            tr(
                "units out of order in {units} and poles in {poles} of the runs",
                units=units,
                poles=poles,
            )
        )
    if blinding.dirty_share:
        drawn.append(
            tr("{dirty} of the cameras dirty", dirty=percent(blinding.dirty_share))
        )
    if blinding.low_sun_share:
        drawn.append(
            tr(
                "low sun in {low_sun} of the runs by day",
                low_sun=percent(blinding.low_sun_share),
            )
        )
    if traffic["taken_share"]:
        drawn.append(
            tr(
                "{taken} of the parking places taken",
                taken=percent(traffic["taken_share"]),
            )
        )
    if traffic["waiting_share"]:
        drawn.append(
            tr(
                "vehicles waiting in {waiting} of the lanes",
                waiting=percent(traffic["waiting_share"]),
            )
        )
    if bus_lane_share := traffic.get("bus_lane_share"):
        drawn.append(
            tr("buses in {share} of the bus lanes", share=percent(bus_lane_share))
        )
    if record.road_users.measured:
        drawn.append(tr("people at measured speeds"))
    if replace(record.road_users, measured={}) != RoadUsers():
        drawn.append(tr("road users faster or slower, from nearer starts"))
    if found.moving:
        drawn.append(
            tr("vehicles that drive by ({source})", source=found.traffic_source)
        )
    return ", ".join(drawn) or tr("nothing is uncertain")


def moving_sentence(found: SampledRecord) -> str:
    """Words on the vehicles that drive by in a run; empty where none do."""
    moving = found.moving
    if not moving or not moving.n_runs:
        return ""
    if moving.n_vehicles:
        share = percent(moving.n_left_out / moving.n_vehicles)
    else:
        share = tr("none")
    per_run = moving.n_vehicles / moving.n_runs
    n_waiting = moving.n_waiting
    values: dict[str, Any] = {"n": moving.n_vehicles, "n_left_out": moving.n_left_out}
    values |= {"per_run": per_run, "source": found.traffic_source, "share": share}
    text = tr(
        "{per_run:.0f} vehicles drive by in a run ({source}); {n_left_out} of "
        "{n} ({share}) are left out of their run because they would get in the "
        "way of the car or the road user",
        **values,
    )
    if not n_waiting:
        return text
    no_room = mark("; SUMO found no room for {n} of {n_all} vehicles")
    return text + tr(no_room, n=n_waiting, n_all=moving.n_departed + n_waiting)


def is_open(difference: SampledPairRecord) -> bool:
    """True if the 95 % interval of a difference holds zero: no sure winner."""
    return or_nan(difference.low) <= 0.0 <= or_nan(difference.high)


def table(found: SampledRecord) -> Table:
    """APR of each layout.

    As planned, its mean with the interval, and in bad worlds.
    """
    tail = tr("worst {tail:g} %", tail=100.0 * found.tail)
    columns: dict[str, Callable[[SampledLayoutRecord], str]] = {
        tr("layout"): lambda one: shortened(one.name, _MAX_NAME_LENGTH),
        tr("planned"): lambda one: percent(one.planned),
        tr("mean"): lambda one: percent(one.mean),
        tr("95 % interval"): lambda one: f"{percent(one.low)} .. {percent(one.high)}",
        tail: lambda one: (
            percent(one.cvar)
            + localized(f" (\N{PLUS-MINUS SIGN}{_points(one.cvar_error):.1f})")
        ),
        tr("worst"): lambda one: percent(one.worst),
    }
    # The mean of all is there already.
    if found.tail == 1.0:
        del columns[tail]
    return tabulate(
        tr("APR in sampled worlds"), found.layouts, columns, numeric=range(1, 6)
    )


def _points(share: float | None) -> float:
    return 100.0 * or_nan(share)


def sampled_section(found: SampledRecord) -> Section:
    """The layouts in sampled worlds."""
    return Section("sampled", tr("If the world is not as planned"), [table(found)])
